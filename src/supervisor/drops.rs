//! Events about dropped inputs and the reasons, limited in rate so that a flood of invalid input causes
//! no flood of events.

use messages::DropReason;
use messages::stages::StageId;
use std::collections::BTreeMap;

/// Drops by reason, in the order of [`DropReason::ALL`].
pub type Dropped = [u64; DropReason::ALL.len()];

/// Shortest time between two events about a process's drops.
const PAUSE_NS: u64 = 1_000_000_000;

/// Follows the counters of all processes.
#[derive(Debug, Default)]
pub struct Drops {
    processes: BTreeMap<u32, Counted>,
}

#[derive(Debug)]
struct Counted {
    stage: StageId,
    now: Dropped,
    told: Dropped,
    /// `None` before the first event.
    told_ns: Option<u64>,
}

/// An event about drops.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DropNotice {
    /// The stage.
    pub stage: StageId,
    /// Its process.
    pub pid: u32,
    /// Numbers of drops, by reason.
    pub what: String,
}

impl Drops {
    /// Records a process's counters. Returns whether it has dropped an input that is invalid for
    /// every process; one refused only because of the process's own count of numbers might be valid
    /// for another.
    pub fn note(&mut self, stage: StageId, pid: u32, dropped: Dropped) -> bool {
        let counted = self.processes.entry(pid).or_insert(Counted {
            stage,
            now: [0; DropReason::ALL.len()],
            told: [0; DropReason::ALL.len()],
            told_ns: None,
        });
        let before = std::mem::replace(&mut counted.now, dropped);
        let is_unusable =
            |reason: &DropReason| !matches!(reason, DropReason::OutOfOrder | DropReason::BadHeader);
        let mut reasons = DropReason::ALL.into_iter().filter(is_unusable);
        reasons.any(|reason| before[reason as usize] != dropped[reason as usize])
    }

    /// Events that are due now.
    pub fn tell(&mut self, now_ns: u64) -> Vec<DropNotice> {
        let mut notices = Vec::new();
        for (&pid, counted) in &mut self.processes {
            let is_due = counted.told_ns.is_none_or(|told| now_ns.saturating_sub(told) >= PAUSE_NS);
            if is_due && counted.now != counted.told {
                notices.push(DropNotice { stage: counted.stage, pid, what: counted.difference() });
                (counted.told, counted.told_ns) = (counted.now, Some(now_ns));
            }
        }
        notices
    }

    /// Forgets a process that has ended, and returns its drops not reported yet.
    pub fn forget(&mut self, pid: u32) -> Option<DropNotice> {
        let counted = self.processes.remove(&pid)?;
        let has_more = counted.now != counted.told;
        has_more.then(|| DropNotice { stage: counted.stage, pid, what: counted.difference() })
    }
}

impl Counted {
    fn difference(&self) -> String {
        let new = |reason: DropReason| {
            self.now[reason as usize].saturating_sub(self.told[reason as usize])
        };
        let words: Vec<String> = DropReason::ALL
            .into_iter()
            .filter(|&reason| new(reason) > 0)
            .map(|reason| format!("{} {}", new(reason), reason.name()))
            .collect();
        format!("dropped input: {}", words.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::ProcessKind;

    const MS: u64 = 1_000_000;
    const TRACKER: StageId = StageId::new(ProcessKind::Tracker, 0);

    fn dropped(wrong_size: u64, bad_header: u64) -> Dropped {
        let mut dropped = Dropped::default();
        dropped[DropReason::WrongSize as usize] = wrong_size;
        dropped[DropReason::BadHeader as usize] = bad_header;
        dropped
    }

    fn texts(notices: Vec<DropNotice>) -> Vec<String> {
        notices.into_iter().map(|notice| notice.what).collect()
    }

    #[test]
    fn the_first_drop_is_reported_at_once_and_a_flood_once_a_second() {
        let mut drops = Drops::default();
        assert!(!drops.note(TRACKER, 7, dropped(0, 0)), "nothing happened");
        assert!(drops.note(TRACKER, 7, dropped(1, 0)));
        assert!(!drops.note(TRACKER, 7, dropped(1, 0)), "nothing new");
        assert_eq!(texts(drops.tell(0)), ["dropped input: 1 wrong_size"]);
        let mut told = Vec::new();
        for step in 1..=200 {
            drops.note(TRACKER, 7, dropped(1 + step, step / 10));
            told.extend(texts(drops.tell(step * 10 * MS)));
        }
        let second = "dropped input: 10 bad_header, 100 wrong_size".to_string();
        assert_eq!(told, [second.clone(), second]);
    }

    #[test]
    fn unreported_drops_of_a_dead_process_are_reported() {
        let mut drops = Drops::default();
        drops.note(StageId::FILTER, 7, dropped(1, 0));
        drops.tell(0);
        drops.note(StageId::FILTER, 7, dropped(3, 0));
        let notice = drops.forget(7).unwrap();
        assert_eq!((notice.pid, notice.what.as_str()), (7, "dropped input: 2 wrong_size"));
        assert_eq!(drops.forget(7), None);
        // The pid is reused.
        assert!(drops.note(StageId::FILTER, 7, dropped(1, 0)));
    }

    #[test]
    fn an_input_that_another_process_could_work_on_is_not_handled() {
        let mut drops = Drops::default();
        assert!(!drops.note(TRACKER, 7, dropped(0, 3)), "numbers");
        assert!(drops.note(TRACKER, 7, dropped(1, 3)), "a wrong size");
        assert_eq!(texts(drops.tell(0)), ["dropped input: 3 bad_header, 1 wrong_size"]);
    }
}
