//! The recorded configurations, and the stages made from them.
//!
//! Every output names the revisions of the configuration that made it. A revision that was not recorded is
//! represented by a later one with which a stage of its kind does the same
//! ([`Snapshot::stands_for`]). Recordings of groups that name no revisions have one configuration at a time.

use classifier::Classifier;
use config::Config;
use config::snapshot::Snapshot;
use filter::Filter;
use messages::ProcessKind;
use recording::Setup;
use std::collections::{BTreeMap, VecDeque};
use tracker::Tracker;

/// Stages kept of each kind: during a change those of two revisions are in use, with rollbacks and kills of
/// some more.
const KEPT_STAGES: usize = 6;

/// Reason for which a recording cannot be checked.
#[derive(Debug, thiserror::Error)]
#[error("the recorded configuration: {0}")]
pub struct ConfigurationError(String);

/// Reason for which there is no stage to compute an output with.
#[derive(Debug, PartialEq, Eq)]
pub enum NoStage {
    /// The configuration is not in the recording.
    NotRecorded,
    /// It cannot be used; the reason.
    Unusable(String),
}

/// The configurations recorded so far.
#[derive(Default)]
pub struct Configurations {
    known: BTreeMap<u32, Snapshot>,
    classifiers: Recent<Classifier>,
    trackers: Recent<Tracker>,
}

impl Configurations {
    /// Adds one.
    pub fn add(&mut self, setup: &Setup) -> Result<(), ConfigurationError> {
        let error = |error: &dyn std::fmt::Display| ConfigurationError(error.to_string());
        let snapshot = Snapshot::parse(&setup.config_toml, "recorded").map_err(|e| error(&e))?;
        if self.known.is_empty() {
            // One that cannot be used at all is an error, not a difference.
            Classifier::new(&snapshot.config).map_err(|e| error(&e))?;
            Tracker::new(&snapshot.config).map_err(|e| error(&e))?;
            Filter::new(&snapshot.config).map_err(|e| error(&e))?;
        }
        let number = snapshot.revision.number;
        if number == 0 {
            *self = Self::default();
        }
        self.known.insert(number, snapshot);
        Ok(())
    }

    /// Whether there is none yet.
    pub fn is_empty(&self) -> bool {
        self.known.is_empty()
    }

    /// The classifier of a revision.
    pub fn classifier(&mut self, revision: u32) -> Result<&mut Classifier, NoStage> {
        let (number, config) = self.choose(revision, ProcessKind::Classifier)?;
        let config = config.clone();
        self.classifiers.get(number, || Classifier::new(&config).map_err(unusable))
    }

    /// The tracker of a revision.
    pub fn tracker(&mut self, revision: u32) -> Result<&mut Tracker, NoStage> {
        let (number, config) = self.choose(revision, ProcessKind::Tracker)?;
        let config = config.clone();
        self.trackers.get(number, || Tracker::new(&config).map_err(unusable))
    }

    /// A filter of a revision, without a state.
    pub fn filter(&self, revision: u32) -> Result<Filter, NoStage> {
        let (_, config) = self.choose(revision, ProcessKind::Filter)?;
        Filter::new(config).map_err(unusable)
    }

    /// The recorded configuration for a revision, with its number.
    fn choose(&self, revision: u32, kind: ProcessKind) -> Result<(u32, &Config), NoStage> {
        let mut later = self.known.range(revision..);
        let found = match revision {
            // A stage that was started by hand.
            0 => self.known.last_key_value(),
            _ => later
                .find(|(_, snapshot)| snapshot.stands_for(revision, kind))
                .or_else(|| self.known.get_key_value(&0)),
        };
        found.map(|(&number, snapshot)| (number, &snapshot.config)).ok_or(NoStage::NotRecorded)
    }
}

fn unusable(error: impl std::fmt::Display) -> NoStage {
    NoStage::Unusable(error.to_string())
}

/// The stages used last.
struct Recent<T>(VecDeque<(u32, T)>);

impl<T> Default for Recent<T> {
    fn default() -> Self {
        Self(VecDeque::new())
    }
}

impl<T> Recent<T> {
    fn get(
        &mut self,
        number: u32,
        make: impl FnOnce() -> Result<T, NoStage>,
    ) -> Result<&mut T, NoStage> {
        let at = self.0.iter().position(|(known, _)| *known == number);
        let found = match at.and_then(|at| self.0.remove(at)) {
            Some(found) => found,
            None => (number, make()?),
        };
        self.0.truncate(KEPT_STAGES - 1);
        self.0.push_front(found);
        Ok(&mut self.0[0].1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setup(snapshot: &Snapshot) -> Setup {
        Setup {
            touchline_version: String::new(),
            instance: String::new(),
            wall_minus_monotonic_ns: 0,
            config_toml: snapshot.to_text(),
            revision: snapshot.revision.number,
            accepted_wall_ns: 0,
        }
    }

    #[test]
    fn a_later_configuration_stands_for_one_that_was_not_recorded() {
        let first = Snapshot::first(Config::default());
        let mut config = Config::default();
        config.filter.actuation_delay_ms += 1.0;
        let second = first.next(config.clone(), Some(1));
        config.tracker.min_region_px += 1;
        let third = second.next(config, Some(2));
        let mut it = Configurations::default();
        assert_eq!(it.filter(1).err(), Some(NoStage::NotRecorded));
        it.add(&setup(&third)).unwrap();
        assert!(it.classifier(1).is_ok() && it.filter(2).is_ok() && it.tracker(3).is_ok());
        assert_eq!(it.filter(1).err(), Some(NoStage::NotRecorded));
        assert_eq!(it.tracker(2).err(), Some(NoStage::NotRecorded));
        assert_eq!(it.filter(4).err(), Some(NoStage::NotRecorded));
        it.add(&setup(&first)).unwrap();
        assert_eq!(it.choose(1, ProcessKind::Filter).unwrap().0, 1);
        assert_eq!(it.choose(2, ProcessKind::Filter).unwrap().0, 3);
    }

    #[test]
    fn without_revisions_the_last_one_counts() {
        let mut it = Configurations::default();
        for _ in 0..2 {
            it.add(&setup(&Snapshot::of_user(Config::default()))).unwrap();
            assert!(it.classifier(0).is_ok() && it.tracker(7).is_ok() && it.filter(0).is_ok());
        }
    }

    #[test]
    fn the_stages_used_last_are_kept() {
        let mut recent = Recent::default();
        for number in 0..KEPT_STAGES as u32 {
            recent.get(number, || Ok(number)).unwrap();
        }
        assert_eq!(recent.get(0, || Err(NoStage::NotRecorded)), Ok(&mut 0));
        recent.get(99, || Ok(99)).unwrap();
        assert!(
            recent.get(1, || Err(NoStage::NotRecorded)).is_err(),
            "the one not used for longest"
        );
        assert_eq!(recent.get(0, || Err(NoStage::NotRecorded)), Ok(&mut 0));
    }
}
