//! `touchline doctor`: checks whether this computer is fit for a match.
//!
//! [`machine`] checks processors, clock and rights, [`places`] shared memory, directories and disks;
//! [`leftovers`] finds what dead groups have left.

mod leftovers;
mod machine;
mod places;

use super::CommandError;
use crate::cli::DoctorArgs;
use client::instance::{Instance, runtime_base};
use runtime::user_config::load_config;
use serde::Serialize;
use std::fmt;
use std::process::ExitCode;

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// No action is needed.
    Ok,
    /// A match runs, but not as well as possible.
    Warning,
    /// No match runs, or not for long.
    Problem,
}

/// A finding.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Its subject.
    pub about: &'static str,
    /// Its severity.
    pub level: Level,
    /// The state found.
    pub what: String,
    /// The remedy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice: Option<String>,
}

impl Finding {
    fn ok(about: &'static str, what: impl Into<String>) -> Self {
        Self { about, level: Level::Ok, what: what.into(), advice: None }
    }

    fn warning(about: &'static str, what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { about, level: Level::Warning, what: what.into(), advice: Some(advice.into()) }
    }

    fn problem(about: &'static str, what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { level: Level::Problem, ..Self::warning(about, what, advice) }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let level = match self.level {
            Level::Ok => "ok",
            Level::Warning => "warning",
            Level::Problem => "PROBLEM",
        };
        write!(formatter, "{level:<8} {:<18} {}", self.about, self.what)?;
        match &self.advice {
            Some(advice) => write!(formatter, "\n{:<27} → {advice}", ""),
            None => Ok(()),
        }
    }
}

/// Runs all checks, prints the findings, and fails if no match could run.
pub fn doctor(args: DoctorArgs) -> Result<ExitCode, CommandError> {
    let config = load_config(args.config.as_deref())?;
    let instance = Instance::new(&args.instance.instance)?;
    let (left, undecided) = leftovers::find(&runtime_base())?;
    let left = if args.clean { leftovers::remove(left) } else { leftovers::list(&left) };

    let mut findings = vec![places::shared_memory(&instance, &config, &args.source)];
    findings.extend([places::runtime_directory(&instance), places::disk(&config)]);
    findings.push(places::other_users(&instance, &config));
    findings.extend(places::ipc_versions(&instance));
    findings.extend(machine::findings(&config));
    findings.extend(left);
    findings.extend(undecided);
    let text = if args.json {
        serde_json::to_string_pretty(&findings)? + "\n"
    } else {
        findings.iter().map(|finding| format!("{finding}\n")).collect()
    };
    runtime::say!("{text}")?;
    let is_fit = findings.iter().all(|finding| finding.level < Level::Problem);
    Ok(if is_fit { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// "12.3 MB".
fn bytes(count: u64) -> String {
    let units = [(1e9, "GB"), (1e6, "MB"), (1e3, "kB")];
    let unit = units.into_iter().find(|(size, _)| count as f64 >= *size);
    unit.map_or_else(
        || format!("{count} bytes"),
        |(size, name)| format!("{:.1} {name}", count as f64 / size),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_readable() {
        assert_eq!(bytes(999), "999 bytes");
        assert_eq!(bytes(1500), "1.5 kB");
        assert_eq!(bytes(24_100_000_000), "24.1 GB");
    }

    #[test]
    fn advice_stands_below_the_finding() {
        let text = Finding::warning("clock", "slow", "take another").to_string();
        let (first, second) = text.split_once('\n').unwrap();
        assert!(first.starts_with("warning  clock") && first.ends_with(" slow"), "{text}");
        assert!(second.trim_start().starts_with("→ take another"), "{text}");
    }
}
