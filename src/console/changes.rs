//! Addresses that change something, each by a request to the supervisor, and those that tell what can be changed.

use super::answer::{self, Failure};
use super::app::App;
use super::changing::ReloadRequest;
use super::saving;
use crate::supervisor::{Candidate, Overrides, Record, as_run};
use axum::body::{Body, to_bytes};
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use config::snapshot::Snapshot;
use config::{Config, Preset, commented_toml, schema_json};
use control::{Done, Request};
use grabber::source::Source;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// Largest body of a request, bytes.
const MOST_BYTES: usize = 1 << 20;
/// Longest time for the body of a request.
const BODY_PATIENCE: Duration = Duration::from_secs(10);
/// Longest wait for the supervisor.
const ANSWER_PATIENCE: Duration = Duration::from_secs(5);

/// The whole body of a request, if it is not too large and comes in time.
pub async fn whole(body: Body) -> Result<Vec<u8>, Failure> {
    match tokio::time::timeout(BODY_PATIENCE, to_bytes(body, MOST_BYTES)).await {
        Ok(Ok(bytes)) => Ok(bytes.to_vec()),
        Ok(Err(_)) => Err(Failure::new(
            StatusCode::PAYLOAD_TOO_LARGE,
            "the request is larger than a megabyte",
        )),
        Err(_) => Err(Failure::new(StatusCode::REQUEST_TIMEOUT, "the request does not come")),
    }
}

/// A body as JSON; an empty one is `{}`.
pub async fn parsed<T: DeserializeOwned>(body: Body) -> Result<T, Failure> {
    let bytes = whole(body).await?;
    let bytes = if bytes.trim_ascii().is_empty() { b"{}" } else { &bytes[..] };
    serde_json::from_slice(bytes).map_err(|error| Failure::bad(error.to_string()))
}

/// The group's configuration, and where it comes from.
struct Origin {
    now: Snapshot,
    overrides: Overrides,
    source: Source,
    file: Option<PathBuf>,
    instance: client::instance::Instance,
}

impl Origin {
    fn of(app: &App) -> Result<Self, Failure> {
        let now = Snapshot::load(&app.instance.config_path())
            .map_err(|error| Failure::unavailable(error.to_string()))?;
        let record = Record::read(&app.instance).unwrap_or_default();
        let source = record
            .source
            .parse()
            .map_err(|_| Failure::unavailable("the group's record cannot be read at the moment"))?;
        let saved_to = app.saved_to();
        let (overrides, file) = (record.overrides, record.config_file.or(saved_to));
        Ok(Self { now, overrides, source, file, instance: app.instance.clone() })
    }

    fn as_group(&self, text: &str) -> Option<Config> {
        Some(as_run(Config::parse(text, "file").ok()?, &self.overrides, &self.source))
    }

    /// Whether the file says what the group has ever run with.
    fn is_known(&self, config: &Config) -> bool {
        let entries = fs::read_dir(self.instance.revisions_directory()).into_iter().flatten();
        let mut kept = entries.flatten().filter_map(|entry| Config::load(&entry.path()).ok());
        self.now.config == *config || kept.any(|earlier| earlier == *config)
    }
}

/// `GET /api/config`
pub async fn config(State(app): State<Arc<App>>) -> Result<Response, Failure> {
    let origin = Origin::of(&app)?;
    let text = origin.file.as_deref().map(fs::read_to_string).and_then(Result::ok);
    let in_file = text.as_deref().and_then(|text| origin.as_group(text));
    Ok(answer::of(&json!({
        "revision": origin.now.revision.number,
        "hash": saving::hash(text.as_deref().unwrap_or_default()),
        "text": commented_toml(&origin.now.config),
        "file": origin.file,
        "file_changed": text.is_some() && !in_file.as_ref().is_some_and(|it| origin.is_known(it)),
        "saved": in_file.as_ref() == Some(&origin.now.config),
        "values": origin.now.config,
    })))
}

/// `GET /api/schema`
pub async fn schema() -> Response {
    answer::text("application/schema+json", schema_json())
}

/// `GET /api/presets`
pub async fn presets() -> Response {
    let all = Preset::ALL.map(|preset| {
        json!({ "name": preset.name(), "about": preset.describe(), "values": preset.config() })
    });
    answer::of(&json!(all))
}

/// Sends the supervisor a request, one at a time.
async fn ask(app: &App, request: Request) -> Result<Done, Failure> {
    let instance = app.instance.clone();
    let asked =
        tokio::task::spawn_blocking(move || control::ask(&instance, &request, ANSWER_PATIENCE));
    match asked.await {
        Ok(Ok(Ok(done))) => Ok(done),
        Ok(Ok(Err(refusal))) => Err(Failure::new(StatusCode::UNPROCESSABLE_ENTITY, refusal)),
        _ => Err(Failure::unavailable("the group's supervisor does not answer")
            .help("it may be stopped; see `touchline status`")),
    }
}

/// `POST /api/reload`
pub async fn reload(State(app): State<Arc<App>>, body: Body) -> Result<Response, Failure> {
    let request = ReloadRequest::parse(&whole(body).await?)?;
    let _turn = app.changes.lock().await;
    let origin = Origin::of(&app)?;
    let mut plan = request.plan(&origin.now, &origin.overrides, &origin.source)?;
    if !request.dry_run && !plan.is_empty {
        let candidate = Candidate::write(&app.instance, &plan.config)
            .map_err(|error| Failure::unavailable(error.to_string()))?;
        // The supervisor looks at the revision too: other programs may have changed it by then.
        let base = Some(origin.now.revision.number);
        let request = Request::Reload { file: candidate.path.clone(), base };
        let done = ask(&app, request).await.map_err(|refusal| match Origin::of(&app) {
            Ok(newest) if Some(newest.now.revision.number) != base => {
                Failure { status: StatusCode::CONFLICT, ..refusal }
            }
            _ => refusal,
        })?;
        if let Some(revision) = done.revision {
            plan.answer.insert("revision".into(), revision.into());
        }
    }
    Ok(answer::of(&Value::Object(plan.answer)))
}

/// `POST /api/rollback`
pub async fn rollback(State(app): State<Arc<App>>) -> Result<Response, Failure> {
    let _turn = app.changes.lock().await;
    let before = Origin::of(&app)?.now;
    let done = ask(&app, Request::Rollback).await?;
    let now = Origin::of(&app)?.now;
    let changed: Vec<Value> = config::change::changes(&before.config, &now.config)
        .iter()
        .map(|it| json!({ "key": it.key, "from": it.old, "to": it.new }))
        .collect();
    Ok(answer::of(&json!({ "revision": done.revision, "changed": changed })))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SaveRequest {
    /// A new file; the group's own one if there is none.
    #[serde(default)]
    path: Option<PathBuf>,
    /// Hash of the file that the client has seen.
    #[serde(default)]
    base_hash: Option<String>,
}

/// `POST /api/save`
pub async fn save(State(app): State<Arc<App>>, body: Body) -> Result<Response, Failure> {
    let request: SaveRequest = parsed(body).await?;
    let _turn = app.changes.lock().await;
    let origin = Origin::of(&app)?;
    let own =
        origin.file.as_deref().filter(|own| request.path.as_deref().is_none_or(|it| it == *own));
    let (path, merged) = match (own, &request.path) {
        (Some(own), _) => {
            let text = fs::read_to_string(own).unwrap_or_default();
            if request.base_hash.is_some_and(|base| base != saving::hash(&text)) {
                let message = format!("{} was changed elsewhere meanwhile", own.display());
                return Err(Failure::new(StatusCode::CONFLICT, message)
                    .help("look at it, then save again or go over to it with `touchline reload`"));
            }
            let merged =
                saving::merge(&text, &origin.now.config, &origin.overrides, &origin.source);
            let invalid = || {
                Failure::new(
                    StatusCode::UNPROCESSABLE_ENTITY,
                    format!("{} is no valid configuration", own.display()),
                )
                .help("`touchline config check` says why; or save under another name")
            };
            (own.to_path_buf(), merged.ok_or_else(invalid)?)
        }
        (None, Some(path)) => {
            let path = new_file(path)?;
            let text = commented_toml(&origin.now.config);
            (path, saving::Merged { text, rewritten: Vec::new() })
        }
        (None, None) => {
            return Err(Failure::new(
                StatusCode::UNPROCESSABLE_ENTITY,
                "the group was started without a file",
            )
            .help("name one"));
        }
    };
    saving::replace(&path, &merged.text).map_err(|error| {
        let message = format!("{} cannot be written: {error}", path.display());
        Failure::new(StatusCode::UNPROCESSABLE_ENTITY, message)
    })?;
    app.save_to(&path);
    Ok(answer::of(&json!({
        "path": path, "hash": saving::hash(&merged.text), "rewritten": merged.rewritten,
    })))
}

/// A file that does not exist yet: a page must not overwrite what is no configuration.
fn new_file(path: &Path) -> Result<PathBuf, Failure> {
    let wrong = |message: &str| Failure::new(StatusCode::UNPROCESSABLE_ENTITY, message);
    if path.extension().is_none_or(|it| it != "toml") {
        return Err(wrong("the name of a configuration ends with .toml"));
    }
    if fs::symlink_metadata(path).is_ok() {
        return Err(wrong("there is such a file already").help("choose another name"));
    }
    std::path::absolute(path).map_err(|error| wrong(&error.to_string()))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RestartRequest {
    process: String,
}

/// `POST /api/restart`
pub async fn restart(State(app): State<Arc<App>>, body: Body) -> Result<Response, Failure> {
    let RestartRequest { process } = parsed(body).await?;
    let _turn = app.changes.lock().await;
    ask(&app, Request::Restart(vec![process])).await?;
    Ok(answer::of(&json!({})))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MarkRequest {
    text: String,
}

/// `POST /api/mark`
pub async fn mark(State(app): State<Arc<App>>, body: Body) -> Result<Response, Failure> {
    let MarkRequest { text } = parsed(body).await?;
    let _turn = app.changes.lock().await;
    // A request is one datagram.
    let text = text.chars().take(200).collect();
    ask(&app, Request::Mark(text)).await?;
    Ok(answer::of(&json!({})))
}
