//! What a change of the configuration amounts to, and why it is refused: pure.

use super::answer::Failure;
use axum::http::StatusCode;
use config::change::{Effect, changes};
use config::edit::{EditError, with_pairs};
use config::snapshot::{Snapshot, concerned};
use config::{Config, ConfigError, Diagnostic};
use grabber::source::Source;
use serde::Deserialize;
use serde_json::{Map, Value, json};

use crate::supervisor::{Overrides, as_run};

/// A request for another configuration.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReloadRequest {
    /// The revision that the client has seen.
    base_revision: u32,
    /// Keys and their values, on top of what the group runs with.
    #[serde(default)]
    set: Option<Map<String, Value>>,
    /// The text of a whole file.
    #[serde(default)]
    text: Option<String>,
    /// Only tell what would change.
    #[serde(default)]
    pub dry_run: bool,
}

/// What would change.
pub struct Plan {
    /// The configuration to go over to.
    pub config: Config,
    /// The answer to the client, but for the new revision.
    pub answer: Map<String, Value>,
    /// Nothing differs.
    pub is_empty: bool,
}

impl ReloadRequest {
    /// Parses a request.
    pub fn parse(body: &[u8]) -> Result<Self, Failure> {
        serde_json::from_slice(body).map_err(|error| Failure::bad(error.to_string()))
    }

    /// Finds out what it changes in a group with these overrides and this source.
    pub fn plan(
        &self,
        now: &Snapshot,
        overrides: &Overrides,
        source: &Source,
    ) -> Result<Plan, Failure> {
        let revision = now.revision.number;
        if self.base_revision != revision {
            let message = format!(
                "the configuration was changed meanwhile: it is revision {revision}, not {}",
                self.base_revision
            );
            return Err(
                Failure::new(StatusCode::CONFLICT, message).help("look at it and try again")
            );
        }
        let mut warnings = Vec::new();
        let config = match (&self.set, &self.text) {
            (Some(set), None) => with_pairs(&now.config, pairs(set)?).map_err(of_edit)?,
            (None, Some(text)) => {
                let (config, found) = config::check(text, "configuration").map_err(of_config)?;
                warnings.extend(found.list.iter().map(ToString::to_string));
                as_run(config, overrides, source)
            }
            _ => return Err(Failure::bad("either `set` or `text` is needed")),
        };
        let changes = changes(&now.config, &config);
        for change in &changes {
            if let Effect::NewGroup(reason) = change.effect() {
                let message =
                    format!("{}: a running group cannot take this over: {reason}", change.key);
                let failure = Failure::new(StatusCode::UNPROCESSABLE_ENTITY, message)
                    .help("change it in the file, stop the group and start it again");
                return Err(Failure { key: Some(change.key.clone()), ..failure });
            }
        }
        let stages: Vec<&str> = concerned(&changes).iter().map(|kind| kind.name()).collect();
        let changed: Vec<Value> = changes
            .iter()
            .map(|it| json!({ "key": it.key, "from": it.old, "to": it.new }))
            .collect();
        let answer = json!({
            "revision": revision, "changed": changed, "camera_gap": stages.contains(&"grabber"),
            "stages": stages, "warnings": warnings,
        });
        let answer = answer.as_object().cloned().unwrap_or_default();
        Ok(Plan { config, answer, is_empty: changes.is_empty() })
    }
}

/// JSON as values of the configuration.
fn pairs(set: &Map<String, Value>) -> Result<Vec<(String, toml::Value)>, Failure> {
    let pair = |(key, value): (&String, &Value)| {
        let value = toml::Value::try_from(value).map_err(|error| Failure {
            key: Some(key.clone()),
            ..Failure::new(StatusCode::UNPROCESSABLE_ENTITY, format!("{key}: {error}"))
        })?;
        Ok((key.clone(), value))
    };
    set.iter().map(pair).collect()
}

/// A key that cannot be set.
fn of_edit(error: EditError) -> Failure {
    let failure = Failure::new(StatusCode::UNPROCESSABLE_ENTITY, error.to_string());
    match error {
        EditError::Key { key, .. } | EditError::Element(key) => {
            Failure { key: Some(key), ..failure }
        }
        EditError::Form(_) => failure,
        // The place is one in a text that the client has never seen.
        EditError::Config(error) => Failure { place: None, ..of_config(error) },
    }
}

/// A configuration that is not valid: its first problem.
pub fn of_config(error: ConfigError) -> Failure {
    let whole = error.to_string();
    let ConfigError::Invalid(diagnostics) = error else {
        return Failure::new(StatusCode::UNPROCESSABLE_ENTITY, whole);
    };
    let Some(Diagnostic { problem, place, .. }) = diagnostics.list.into_iter().next() else {
        return Failure::new(StatusCode::UNPROCESSABLE_ENTITY, whole);
    };
    Failure {
        status: StatusCode::UNPROCESSABLE_ENTITY,
        message: problem.message,
        help: problem.help,
        place: place.map(|place| (place.line, place.column)),
        key: Some(problem.path).filter(|path| !path.is_empty()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Preset;

    fn plan(body: &Value) -> Result<Plan, Failure> {
        let now = Snapshot::first(Preset::Mirosot5v5.config());
        let request = ReloadRequest::parse(body.to_string().as_bytes())?;
        request.plan(&now, &Overrides::default(), &Source::External)
    }

    fn failure(body: &Value) -> Failure {
        plan(body).err().unwrap_or_else(|| panic!("{body} is accepted"))
    }

    #[test]
    fn changes_are_told_with_the_stages_they_concern() {
        let set = json!({ "filter.actuation_delay_ms": 61, "colors.orange.red": [200, 255] });
        let plan_of = plan(&json!({ "base_revision": 1, "set": set })).unwrap();
        assert_eq!(plan_of.config.filter.actuation_delay_ms, 61.0);
        assert_eq!(plan_of.answer["stages"], json!(["classifier", "tracker", "filter"]));
        assert_eq!(plan_of.answer["changed"][0]["key"], "colors.orange.red");
        assert_eq!(plan_of.answer["camera_gap"], false);
        let text = "[camera]\nexposure_us = 1234\n";
        let plan_of = plan(&json!({ "base_revision": 1, "text": text })).unwrap();
        assert_eq!(plan_of.answer["camera_gap"], true);
        assert!(plan(&json!({ "base_revision": 1, "set": {} })).unwrap().is_empty);
    }

    #[test]
    fn refusals_say_where() {
        let stale = failure(&json!({ "base_revision": 2, "set": {} }));
        assert_eq!(stale.status, StatusCode::CONFLICT);
        let text = "[filter]\n\nactuation_delay = 5\n";
        let wrong = failure(&json!({ "base_revision": 1, "text": text }));
        assert_eq!((wrong.status.as_u16(), wrong.place), (422, Some((3, 1))), "{wrong:?}");
        assert_eq!(wrong.key.as_deref(), Some("filter.actuation_delay"));
        for (set, key) in [
            (json!({ "filter.actuation_delay_ms": -1 }), "filter.actuation_delay_ms"),
            (json!({ "filter.nonsense": 1 }), "filter.nonsense"),
            (json!({ "colors.mauve.red": [1, 2] }), "colors.mauve.red"),
            (json!({ "camera.width": 320 }), "camera.width"),
            (json!({ "filter.actuation_delay_ms": null }), "filter.actuation_delay_ms"),
        ] {
            let wrong = failure(&json!({ "base_revision": 1, "set": set }));
            assert_eq!(
                (wrong.status.as_u16(), wrong.key.as_deref()),
                (422, Some(key)),
                "{wrong:?}"
            );
            assert_eq!(wrong.place, None);
        }
        for nonsense in [
            json!({}),
            json!({ "base_revision": 1 }),
            json!(3),
            json!({ "base_revision": 1, "sett": 1 }),
        ] {
            assert_eq!(failure(&nonsense).status, StatusCode::BAD_REQUEST, "{nonsense}");
        }
    }
}
