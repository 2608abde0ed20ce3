//! `/api/recordings`: the list, and everything about one of them. What is computed is computed by the processes of
//! [`viewers`](super::viewers).

use super::answer::{self, Failure};
use super::app::App;
use super::changes::whole;
use super::export;
use super::routes::query;
use super::shelf::{self, Place};
use crate::supervisor::{Record, evidence_directory};
use axum::Router;
use axum::body::Body;
use axum::extract::{Path, RawQuery, State};
use axum::http::StatusCode;
use axum::response::Response;
use axum::routing::{get, post};
use client::instance::Instance;
use grabber::source::Source;
use serde_json::{Map, Value, json};
use std::path::PathBuf;
use std::sync::Arc;

/// The addresses.
pub fn router() -> Router<Arc<App>> {
    let one = |rest: &str| format!("/api/recordings/{{place}}/{{name}}{rest}");
    Router::new()
        .route("/api/recordings", get(list))
        .route(&one(""), get(open))
        .route(&one("/frame"), get(frame))
        .route(&one("/frame.png"), get(still))
        .route(&one("/survey"), get(survey))
        .route(&one("/model"), get(model))
        .route(&one("/compare"), post(compare))
        .route(&one("/stop"), post(stop))
        .route(&one("/export/{form}"), get(export::export))
}

/// Where recordings are that the console of a group with this configuration starts.
pub fn own_directory() -> PathBuf {
    evidence_directory().join("recordings")
}

/// The recording that the group plays.
fn played(instance: &Instance) -> Option<PathBuf> {
    match Record::read(instance)?.source.parse() {
        Ok(Source::Recording(playlist)) => Some(playlist.path),
        _ => None,
    }
}

fn places(app: &App) -> Vec<Place> {
    let own = [own_directory()];
    let directories = own.iter().chain(&app.recording_directories).map(|it| Place::directory(it));
    let files = played(&app.instance).into_iter().chain(app.recordings.paths());
    directories.chain(files.filter_map(|path| Place::file(&path))).collect()
}

/// The file that an address names.
pub async fn file(app: &Arc<App>, place: String, name: String) -> Result<PathBuf, Failure> {
    let app = Arc::clone(app);
    // The directory may be on a disk that is far away.
    let found = tokio::task::spawn_blocking(move || shelf::find(&places(&app), &place, &name));
    found.await.unwrap_or_else(|_| Err(Failure::unavailable("the directory cannot be read")))
}

/// `GET /api/recordings`
async fn list(State(app): State<Arc<App>>) -> Result<Response, Failure> {
    let listing = tokio::task::spawn_blocking(move || {
        let own = [own_directory()];
        let directories: Vec<_> = own.iter().chain(&app.recording_directories).collect();
        json!({
            "recordings": shelf::list(&places(&app)), "directories": directories,
            "played": played(&app.instance),
        })
    });
    let listed = listing.await.map_err(|_| Failure::unavailable("the list cannot be made"))?;
    Ok(answer::of(&listed))
}

async fn ask(
    app: &Arc<App>,
    (place, name): (String, String),
    question: &Value,
) -> Result<(Value, Vec<u8>), Failure> {
    let path = file(app, place, name).await?;
    app.viewers.ask(&path, question, question["do"] == "open").await
}

/// `GET /api/recordings/PLACE/NAME`
async fn open(
    State(app): State<Arc<App>>,
    Path(address): Path<(String, String)>,
) -> Result<Response, Failure> {
    Ok(answer::of(&ask(&app, address, &json!({ "do": "open" })).await?.0))
}

/// `GET …/frame?index=N`, or `time_s`, `difference_after`, `difference_before`; `scale`, `format`, `runs=1`.
async fn frame(
    State(app): State<Arc<App>>,
    Path(address): Path<(String, String)>,
    RawQuery(asked): RawQuery,
) -> Result<Response, Failure> {
    let asked = asked.unwrap_or_default();
    let names = ["index", "time_s", "difference_after", "difference_before"];
    let place = names.into_iter().find_map(|name| Some((name, query(&asked, name)?)));
    let (name, text) =
        place.ok_or_else(|| Failure::bad("which frame? name its index or time_s"))?;
    let question = json!({
        "do": "frame", "at": Map::from_iter([(name.to_string(), number(name, text)?)]),
        "picture": {
            "scale": query(&asked, "scale").map_or(Ok(json!(2)), |text| number("scale", text))?,
            "format": query(&asked, "format").unwrap_or("jpeg"),
        },
        "runs": query(&asked, "runs") == Some("1"),
    });
    let (header, picture) = ask(&app, address, &question).await?;
    let header = header.to_string();
    let mut body = Vec::with_capacity(4 + header.len() + picture.len());
    body.extend((header.len() as u32).to_le_bytes());
    body.extend(header.as_bytes());
    body.extend(picture);
    Ok(answer::text("application/octet-stream", body))
}

/// `GET …/frame.png?index=N`
async fn still(
    State(app): State<Arc<App>>,
    Path(address): Path<(String, String)>,
    RawQuery(asked): RawQuery,
) -> Result<Response, Failure> {
    let index = numbered(asked, "index", 0)?;
    let (_, png) = ask(&app, address, &json!({ "do": "still", "index": index })).await?;
    Ok(answer::text("image/png", png))
}

/// `GET …/survey?bins=N`
async fn survey(
    State(app): State<Arc<App>>,
    Path(address): Path<(String, String)>,
    RawQuery(asked): RawQuery,
) -> Result<Response, Failure> {
    let bins = numbered(asked, "bins", 400)?;
    Ok(answer::of(&ask(&app, address, &json!({ "do": "survey", "bins": bins })).await?.0))
}

/// `GET …/model?revision=N`, or `other=1` for the configuration that is compared.
async fn model(
    State(app): State<Arc<App>>,
    Path(address): Path<(String, String)>,
    RawQuery(asked): RawQuery,
) -> Result<Response, Failure> {
    let other = query(asked.as_deref().unwrap_or_default(), "other") == Some("1");
    let revision = numbered(asked, "revision", 0)?;
    let question = json!({ "do": "model", "revision": revision, "other": other });
    Ok(answer::of(&ask(&app, address, &question).await?.0))
}

/// `POST …/compare {"with", "from_s", "to_s"}`
async fn compare(
    State(app): State<Arc<App>>,
    Path(address): Path<(String, String)>,
    body: Body,
) -> Result<Response, Failure> {
    let asked: Map<String, Value> = serde_json::from_slice(&whole(body).await?)
        .map_err(|error| Failure::bad(error.to_string()))?;
    let part = |name: &str| asked.get(name).cloned().unwrap_or_default();
    let question = json!({
        "do": "compare", "with": part("with"), "from_s": part("from_s"), "to_s": part("to_s"),
    });
    Ok(answer::of(&ask(&app, address, &question).await?.0))
}

/// `POST …/stop`
async fn stop(
    State(app): State<Arc<App>>,
    Path(address): Path<(String, String)>,
) -> Result<Response, Failure> {
    Ok(answer::of(&ask(&app, address, &json!({ "do": "stop" })).await?.0))
}

/// A number of a query: whole, or in `time_s` with decimals.
fn number(name: &str, text: &str) -> Result<Value, Failure> {
    let parsed = match name {
        "time_s" => text.parse::<f64>().ok().filter(|it| it.is_finite()).map(|it| json!(it)),
        _ => text.parse::<u64>().ok().map(|it| json!(it)),
    };
    parsed.ok_or_else(|| Failure::new(StatusCode::BAD_REQUEST, format!("{name} is not a number")))
}

fn numbered(asked: Option<String>, name: &str, usual: u64) -> Result<Value, Failure> {
    let asked = asked.unwrap_or_default();
    query(&asked, name).map_or(Ok(json!(usual)), |text| number(name, text))
}
