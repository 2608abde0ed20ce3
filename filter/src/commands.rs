//! Selection of the command that acts on a robot at a given time.
//!
//! A command acts `filter.actuation_delay_ms` after it was sent, until a later one does, or until it is older
//! than `filter.command_timeout_ms`. The queue is part of the track in the `world` message, so its capacity
//! is fixed: commands that follow each other faster than the queue can hold over the delay are merged.

use config::FilterConfig;
use messages::{MAX_QUEUED_COMMANDS, QueuedCommand};

/// Times at which commands act.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommandTiming {
    /// From sending a command until the robot obeys it.
    pub delay_ns: u64,
    /// From sending a command until it expires.
    pub timeout_ns: u64,
    /// Commands closer together than this share a place in the queue.
    pub spacing_ns: u64,
}

/// Limit of an integration step, so that pauses do not turn a curve into a line.
const MAX_SEGMENT_NS: u64 = 50_000_000;
/// Reach of the queue beyond the delay: latency from capture to filter, and one frame at 30 fps.
const QUEUE_MARGIN_NS: u64 = 60_000_000;

impl CommandTiming {
    /// From the configuration.
    pub fn new(config: &FilterConfig) -> Self {
        let delay_ns = ns_from_ms(config.actuation_delay_ms);
        Self {
            delay_ns,
            timeout_ns: ns_from_ms(config.command_timeout_ms),
            spacing_ns: (delay_ns + QUEUE_MARGIN_NS) / (MAX_QUEUED_COMMANDS as u64 - 2),
        }
    }

    fn starts_ns(&self, command: &QueuedCommand) -> u64 {
        command.t_sent_ns.saturating_add(self.delay_ns)
    }

    fn ends_ns(&self, command: &QueuedCommand) -> u64 {
        command.t_sent_ns.saturating_add(self.timeout_ns)
    }
}

/// Nanoseconds; 0 for anything negative or not a number.
pub fn ns_from_ms(ms: f64) -> u64 {
    (ms * 1e6).round() as u64
}

/// The commands that act or will act on a robot, by the time they were sent.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CommandQueue {
    entries: [QueuedCommand; MAX_QUEUED_COMMANDS],
    count: usize,
}

impl CommandQueue {
    /// The commands of a message, sorted. Commands behind the count are ignored.
    pub fn from_message(commands: &[QueuedCommand]) -> Self {
        let mut queue = Self::default();
        for command in commands {
            queue.insert_at_own_place(*command, 0);
        }
        queue
    }

    /// The commands.
    pub fn entries(&self) -> &[QueuedCommand] {
        &self.entries[..self.count]
    }

    /// The whole array, for a message; zero behind [`entries`](Self::entries).
    pub fn array(&self) -> [QueuedCommand; MAX_QUEUED_COMMANDS] {
        self.entries
    }

    /// Adds a command. One that closely follows another (see [`CommandTiming::spacing_ns`]) replaces its
    /// speeds and so acts a little early; if the queue is full, the oldest is removed.
    pub fn insert(&mut self, command: QueuedCommand, timing: &CommandTiming) {
        self.insert_at_own_place(command, timing.spacing_ns);
    }

    fn insert_at_own_place(&mut self, command: QueuedCommand, spacing_ns: u64) {
        let mut place = self.entries().partition_point(|e| e.t_sent_ns <= command.t_sent_ns);
        if let Some(previous) = place.checked_sub(1).and_then(|i| self.entries.get_mut(i)) {
            let gap_ns = command.t_sent_ns - previous.t_sent_ns;
            if gap_ns == 0 || gap_ns < spacing_ns {
                previous.left_mm_s = command.left_mm_s;
                previous.right_mm_s = command.right_mm_s;
                return;
            }
        }
        if self.count == MAX_QUEUED_COMMANDS {
            if place == 0 {
                return;
            }
            self.remove_first(1);
            place -= 1;
        }
        self.entries.copy_within(place..self.count, place + 1);
        self.entries[place] = command;
        self.count += 1;
    }

    /// Removes commands that can no longer act at or after `t_ns`.
    pub fn prune(&mut self, t_ns: u64, timing: &CommandTiming) {
        let superseded =
            self.entries().partition_point(|e| timing.starts_ns(e) <= t_ns).saturating_sub(1);
        self.remove_first(superseded);
        let expired = self.entries().partition_point(|e| timing.ends_ns(e) <= t_ns);
        self.remove_first(expired);
    }

    fn remove_first(&mut self, count: usize) {
        self.entries.copy_within(count..self.count, 0);
        self.entries[self.count - count..self.count].fill(QueuedCommand::default());
        self.count -= count;
    }

    /// The command that acts at `t_ns`: the newest that has started, unless it has expired.
    pub fn acting(&self, t_ns: u64, timing: &CommandTiming) -> Option<&QueuedCommand> {
        let started = self.entries().partition_point(|e| timing.starts_ns(e) <= t_ns);
        self.entries()[..started].last().filter(|command| t_ns < timing.ends_ns(command))
    }

    /// Divides the time between two instants where commands start or end to act: durations in seconds, each
    /// with the command that acts throughout.
    pub fn segments<'a>(
        &'a self,
        from_ns: u64,
        to_ns: u64,
        timing: &'a CommandTiming,
    ) -> impl Iterator<Item = (f64, Option<&'a QueuedCommand>)> + Clone {
        let mut t_ns = from_ns;
        std::iter::from_fn(move || {
            if t_ns >= to_ns {
                return None;
            }
            let end_ns = self
                .entries()
                .iter()
                .flat_map(|command| [timing.starts_ns(command), timing.ends_ns(command)])
                .filter(|&change_ns| change_ns > t_ns)
                .fold(to_ns.min(t_ns.saturating_add(MAX_SEGMENT_NS)), u64::min);
            let segment = ((end_ns - t_ns) as f64 * 1e-9, self.acting(t_ns, timing));
            t_ns = end_ns;
            Some(segment)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Config;
    use proptest::prelude::*;

    const MS: u64 = 1_000_000;

    fn timing() -> CommandTiming {
        CommandTiming { delay_ns: 50 * MS, timeout_ns: 250 * MS, spacing_ns: 10 * MS }
    }

    fn command(t_ms: u64, speed: f64) -> QueuedCommand {
        QueuedCommand { t_sent_ns: t_ms * MS, left_mm_s: speed, right_mm_s: speed }
    }

    fn queue(commands: &[(u64, f64)]) -> CommandQueue {
        let mut queue = CommandQueue::default();
        for &(t_ms, speed) in commands {
            queue.insert(command(t_ms, speed), &timing());
        }
        queue
    }

    fn speed_at(queue: &CommandQueue, t_ms: u64) -> Option<f64> {
        queue.acting(t_ms * MS, &timing()).map(|command| command.left_mm_s)
    }

    #[test]
    fn a_command_acts_after_the_delay_until_the_next_or_the_timeout() {
        let queue = queue(&[(1000, 1.0), (1020, 2.0)]);
        assert_eq!(speed_at(&queue, 1049), None);
        assert_eq!(speed_at(&queue, 1050), Some(1.0));
        assert_eq!(speed_at(&queue, 1069), Some(1.0));
        assert_eq!(speed_at(&queue, 1070), Some(2.0));
        assert_eq!(speed_at(&queue, 1269), Some(2.0));
        assert_eq!(speed_at(&queue, 1270), None);
    }

    #[test]
    fn segments_are_cut_where_commands_change() {
        let queue = queue(&[(1000, 1.0), (1020, 2.0)]);
        let timing = timing();
        let segments: Vec<_> = queue
            .segments(1045 * MS, 1080 * MS, &timing)
            .map(|(dt_s, command)| ((dt_s * 1e3).round() as u64, command.map(|c| c.left_mm_s)))
            .collect();
        assert_eq!(segments, [(5, None), (20, Some(1.0)), (10, Some(2.0))]);
        assert_eq!(queue.segments(1080 * MS, 1080 * MS, &timing).count(), 0);
        assert_eq!(queue.segments(1080 * MS, 1000 * MS, &timing).count(), 0);
    }

    #[test]
    fn late_commands_are_sorted_and_close_ones_merged() {
        let mut queue = queue(&[(1000, 1.0), (1040, 3.0), (1020, 2.0), (1025, 2.5)]);
        let speeds: Vec<f64> = queue.entries().iter().map(|e| e.left_mm_s).collect();
        assert_eq!(speeds, [1.0, 2.5, 3.0]);
        // The same message twice.
        queue.insert(command(1040, 3.0), &timing());
        assert_eq!(queue.entries().len(), 3);
    }

    #[test]
    fn expired_commands_are_removed() {
        let mut queue = queue(&[(1000, 1.0), (1020, 2.0), (1040, 3.0)]);
        queue.prune(1069 * MS, &timing());
        assert_eq!(queue.entries().len(), 3);
        queue.prune(1070 * MS, &timing());
        assert_eq!(queue.entries()[0].left_mm_s, 2.0);
        queue.prune(1290 * MS, &timing());
        assert_eq!(queue.entries().len(), 0);
    }

    #[test]
    fn the_default_queue_holds_every_command_of_an_80_hz_strategy() {
        let timing = CommandTiming::new(&Config::default().filter);
        assert!(timing.spacing_ns < 12_500_000, "{timing:?}");
    }

    proptest! {
        /// After any insertions, the queue is sorted and contains the newest command.
        #[test]
        fn any_order_of_commands_is_sorted(
            commands in prop::collection::vec((0u64..400, -9.0..9.0), 1..60),
            prune_ms in 0u64..500,
        ) {
            let mut queue = queue(&commands);
            prop_assert!(queue.entries().is_sorted_by_key(|e| e.t_sent_ns));
            let newest = commands.iter().map(|c| c.0).max().unwrap() * MS;
            let last = queue.entries().last().unwrap().t_sent_ns;
            prop_assert!(last <= newest && newest - last < 10 * MS);
            let later = (prune_ms..600).step_by(7).map(|t| queue.acting(t * MS, &timing()).copied());
            let before: Vec<_> = later.collect();
            queue.prune(prune_ms * MS, &timing());
            let later = (prune_ms..600).step_by(7).map(|t| queue.acting(t * MS, &timing()).copied());
            prop_assert_eq!(before, later.collect::<Vec<_>>());
            prop_assert_eq!(CommandQueue::from_message(queue.entries()), queue);
        }

        /// Segments fill the time between two instants exactly.
        #[test]
        fn segments_fill_the_time(
            sent in prop::collection::vec(any::<u64>(), 0..20),
            from in any::<u64>(),
            length in 0u64..2_000_000_000,
        ) {
            let mut queue = CommandQueue::default();
            for t_sent_ns in sent {
                let command = QueuedCommand { t_sent_ns, ..Default::default() };
                queue.insert(command, &timing());
            }
            let to = from.saturating_add(length);
            let timing = timing();
            let total: f64 = queue.segments(from, to, &timing).map(|segment| segment.0).sum();
            prop_assert!((total - (to - from) as f64 * 1e-9).abs() < 1e-9);
        }
    }
}
