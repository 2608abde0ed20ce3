//! `touchline run --watch`: goes over to the configuration file whenever somebody has changed it.

use client::instance::Instance;
use config::Config;
use config::change::changes;
use config::snapshot::Snapshot;
use control::Request;
use grabber::source::Source;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;
use touchline::supervisor::{Candidate, Launch, Overrides, as_run};

/// Time between two looks. Editors write a file in several steps; one look later it is complete.
const LOOK: Duration = Duration::from_millis(300);
/// The supervisor answers within milliseconds.
const PATIENCE: Duration = Duration::from_secs(5);

struct Watch {
    file: PathBuf,
    instance: Instance,
    overrides: Overrides,
    source: Source,
}

/// Watches the file from a thread of its own, until the process ends.
pub fn start(file: PathBuf, launch: &Launch) -> io::Result<()> {
    let watch = Watch {
        file,
        instance: launch.instance.clone(),
        overrides: launch.overrides.clone(),
        source: launch.source.clone(),
    };
    std::thread::Builder::new().name("watch".into()).spawn(move || watch.run())?;
    Ok(())
}

impl Watch {
    fn run(&self) {
        let mut known = std::fs::read(&self.file).ok();
        let mut last = known.clone();
        loop {
            std::thread::sleep(LOOK);
            let now = std::fs::read(&self.file).ok();
            // It may be in the middle of being written.
            let is_settled = now.is_some() && now == std::mem::replace(&mut last, now.clone());
            if is_settled && now != known {
                known = now;
                self.reload();
            }
        }
    }

    fn reload(&self) {
        let file: &Path = &self.file;
        let outcome = match Config::load(file) {
            Ok(config) => self.ask(&as_run(config, &self.overrides, &self.source)),
            Err(error) => Err(error.to_string()),
        };
        if let Err(error) = outcome {
            runtime::tell!("{error}\ntouchline: {} has changed, and is not used", file.display());
        }
    }

    fn ask(&self, wanted: &Config) -> Result<(), String> {
        let now =
            Snapshot::load(&self.instance.config_path()).map_err(|error| error.to_string())?;
        if changes(&now.config, wanted).is_empty() {
            return Ok(());
        }
        let candidate =
            Candidate::write(&self.instance, wanted).map_err(|error| error.to_string())?;
        // What the file says is wanted, whatever was changed meanwhile.
        let request = Request::Reload { file: candidate.path.clone(), base: None };
        let answer = control::ask(&self.instance, &request, PATIENCE);
        answer.map_err(|error| error.to_string())?.map(drop)
    }
}
