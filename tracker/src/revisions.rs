//! Runs of another revision of the configuration than this process was started with.
//!
//! Class numbers have a meaning only in the configuration that the classifier ran with. At a change of
//! colours there are, for a few frames, runs of the one and of the other: whoever of classifier and tracker
//! is replaced first, and whichever is killed meanwhile. A tracker therefore works on each list of runs with
//! the configuration that the runs name.

use crate::Tracker;
use client::instance::Instance;
use config::Config;
use config::snapshot::Snapshot;
use messages::{Revision, RunsHeader};

/// A tracker for each revision that is in use.
pub struct Revisions {
    own: Tracker,
    revision: Revision,
    instance: Instance,
    other: Option<Other>,
}

/// The revision last named by runs with other colours.
struct Other {
    number: u32,
    /// `None` if there is no such configuration.
    tracker: Option<Tracker>,
}

impl Revisions {
    /// With the tracker of this process's own configuration.
    pub fn new(own: Tracker, revision: Revision, instance: &Instance) -> Self {
        let mut revisions = Self { own, revision, instance: instance.clone(), other: None };
        // The runs that wait for this process are probably still of the colours before.
        if revision.classes_since == revision.number
            && let Some(before) = revision.number.checked_sub(1).filter(|&number| number > 0)
        {
            revisions.other = Some(revisions.load(before));
        }
        revisions
    }

    /// The tracker for these runs, and the number of its revision; `None` if their configuration is
    /// unknown.
    pub fn for_runs(&mut self, header: &RunsHeader) -> Option<(&mut Tracker, u32)> {
        // A classifier started by hand names none.
        let is_own = header.revision == 0 || header.classes_since == self.revision.classes_since;
        if is_own {
            return Some((&mut self.own, self.revision.number));
        }
        if self.other.as_ref().is_none_or(|other| other.number != header.revision) {
            self.other = Some(self.load(header.revision));
        }
        let Other { number, tracker } = self.other.as_mut()?;
        tracker.as_mut().map(|tracker| (tracker, *number))
    }

    fn load(&self, number: u32) -> Other {
        let config = Snapshot::load_accepted(&self.instance.revision_path(number));
        let tracker = config
            .map(|snapshot| snapshot.config)
            .ok()
            .and_then(|config: Config| Tracker::new(&config).ok());
        Other { number, tracker }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn runs_are_worked_on_with_the_configuration_they_name() {
        let base = std::env::temp_dir().join(format!("tl-revisions-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        fs::create_dir(instance.revisions_directory()).unwrap();
        let first = Snapshot::first(Config::default());
        let mut config = Config::default();
        config.colors.swap(0, 1);
        let second = first.next(config, Some(1));
        for snapshot in [&first, &second] {
            let path = instance.revision_path(snapshot.revision.number);
            fs::write(path, snapshot.to_text()).unwrap();
        }
        let runs = |revision: Revision| RunsHeader {
            revision: revision.number,
            classes_since: revision.classes_since,
            ..RunsHeader::default()
        };
        let third = second.revision.next(true);
        let start = |snapshot: &Snapshot| {
            let tracker = Tracker::new(&snapshot.config).unwrap();
            Revisions::new(tracker, snapshot.revision, &instance)
        };
        let mut old = start(&first);
        let mut used = |header: RunsHeader| old.for_runs(&header).map(|(_, number)| number);
        assert_eq!(used(runs(first.revision)), Some(1));
        assert_eq!(used(runs(second.revision)), Some(2), "the classifier is ahead");
        assert_eq!(used(runs(third)), None, "there is no file of it");
        assert_eq!(used(runs(first.revision)), Some(1));
        assert_eq!(used(RunsHeader::default()), Some(1));

        let mut new = start(&second);
        assert!(new.other.is_some(), "prepared before the first frame");
        let mut used = |header: RunsHeader| new.for_runs(&header).map(|(_, number)| number);
        assert_eq!(used(runs(first.revision)), Some(1), "the classifier is behind");
        assert_eq!(used(runs(third)), Some(2), "the same colours");
        instance.remove_directory().unwrap();
    }
}
