//! The monitor: an independent consumer that counts frames, measures latency and scores results.
//!
//! It counts for itself where it can, instead of using the stages' counters: frames on `frames`, results
//! on `world`, errors against `truth`. It runs on a thread of the supervisor's process, polls without
//! wake-ups (so it costs the writers next to nothing), publishes the report on `status`, the supervisor's
//! events on `events` and its heartbeat on `health`, and draws the console.

pub mod accuracy;
mod camera;
mod collector;
mod commanders;
mod console;
mod containment;
mod flow;
mod gateway;
mod latency;
mod publisher;
mod strangers;
mod unknown;
mod usage;
mod view;

pub use console::{Output, summary};
pub use view::{AttendantView, GroupView, ProcessView};

use client::bus::{BusError, Publisher};
use client::clock::monotonic_ns;
use client::eventcount::EventCount;
use client::instance::Instance;
use collector::Collector;
use config::Config;
use control::Report;
use messages::{GroupEvent, Heartbeat, MAX_STATUS_BYTES, StatusHeader};
use runtime::process::HEARTBEAT;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest time between two rounds of reading, so that the display moves …
const LONGEST_POLL: Duration = Duration::from_millis(50);
/// … and the number of rounds in which a buffer would fill, so that nothing is overwritten
/// meanwhile.
const POLLS_PER_BUFFER: f64 = 4.0;
/// Time between two regular reports.
const STATUS_PERIOD: Duration = Duration::from_millis(500);

/// Shortest time between two answers to status requests.
const ANSWER_PAUSE: Duration = Duration::from_millis(10);

/// Time between two checks whether the monitor has ended.
const LAST_LOOK: Duration = Duration::from_millis(1);

/// The monitor's publishers.
struct Outlets {
    status: Publisher<u8, StatusHeader>,
    events: Publisher<GroupEvent, ()>,
    health: Publisher<Heartbeat, ()>,
    /// Advances on a status request; without it, clients wait for the next regular report.
    requests: Option<EventCount>,
}

/// The running monitor.
pub struct Monitor {
    thread: JoinHandle<Report>,
    stop: Arc<AtomicBool>,
    /// Number of monitors stopped by faults before this one.
    fallen_before: u32,
}

impl Monitor {
    /// Connects to the group's topics and starts watching.
    pub fn start(
        instance: &Instance,
        source: String,
        config: &Config,
        view: Arc<GroupView>,
        output: Output,
    ) -> Result<Self, BusError> {
        let stop = Arc::new(AtomicBool::new(false));
        let stop_requested = Arc::clone(&stop);
        let (instance, config) = (instance.clone(), config.clone());
        let (connected, is_connected) = std::sync::mpsc::channel();
        let fallen_before = containment::fallen();
        // Ports belong to the thread that creates them.
        let count = move || {
            containment::contain_this_thread();
            match Collector::new(&instance, source, &config, view) {
                Ok((mut collector, outlets)) => {
                    let _ = connected.send(Ok(()));
                    watch(&mut collector, outlets, output, &stop_requested)
                }
                Err(error) => {
                    let _ = connected.send(Err(error));
                    Report::default()
                }
            }
        };
        let thread =
            std::thread::Builder::new().name("monitor".into()).spawn(count).map_err(|error| {
                BusError::Ipc {
                    topic: "all".into(),
                    action: "start the monitor's thread",
                    reason: error.to_string(),
                }
            })?;
        let monitor = Self { thread, stop, fallen_before };
        // A thread that is stopped by a fault gives no answer.
        loop {
            match is_connected.recv_timeout(LONGEST_POLL) {
                Ok(outcome) => return outcome.map(|()| monitor),
                Err(RecvTimeoutError::Timeout) if !monitor.has_fallen() => {}
                Err(_) => return Ok(monitor),
            }
        }
    }

    /// Whether a fault has stopped it; the group is no longer counted.
    pub fn has_fallen(&self) -> bool {
        containment::fallen() > self.fallen_before || self.thread.is_finished()
    }

    /// Ends the monitor and returns the final report; empty if a fault has stopped it.
    pub fn finish(self) -> Report {
        self.stop.store(true, Ordering::Relaxed);
        while !self.thread.is_finished() {
            if containment::fallen() > self.fallen_before {
                return Report::default();
            }
            std::thread::sleep(LAST_LOOK);
        }
        self.thread.join().unwrap_or_default()
    }
}

fn watch(
    collector: &mut Collector,
    mut outlets: Outlets,
    output: Output,
    stop: &AtomicBool,
) -> Report {
    let mut display = console::Display::new(output);
    let mut published = Instant::now();
    let mut beat = Instant::now();
    let mut asked = Asked::default();
    loop {
        // Read first: messages published before the request are still collected.
        let last_round = stop.load(Ordering::Relaxed);
        if let Err(error) = collector.collect() {
            runtime::tell!("touchline: monitor: {error}");
        }
        let events = collector.take_new_events();
        for event in &events {
            // Ignore failures: the log has the event.
            let _ = outlets.events.publish(&event.message());
        }
        display.events(&events);
        // After the events, so that an event announced in a heartbeat can be read.
        if beat.elapsed() >= HEARTBEAT || !events.is_empty() {
            beat = Instant::now();
            let _ = collector.heartbeat().map(|beat| outlets.health.publish(&beat));
            // An error is that of a reader or writer, and the next round of reading meets it too.
            let _ = collector.refresh();
        }
        let is_due = published.elapsed() >= STATUS_PERIOD;
        if is_due || asked.is_to_answer(outlets.requests.as_ref()) || last_round {
            let report = collector.report(last_round);
            publish(&mut outlets.status, &report);
            if last_round {
                display.clear();
                return report;
            }
            // Reports on request do not redraw the display.
            if is_due {
                published = Instant::now();
                display.draw(&report);
            }
        }
        asked.sleep(outlets.requests.as_ref(), collector.poll_period());
    }
}

/// State of status requests.
#[derive(Default)]
struct Asked {
    seen: u32,
    is_open: bool,
    answered: Option<Instant>,
}

impl Asked {
    /// Whether to answer a request now. Answers are limited in rate, whatever the rate of requests.
    fn is_to_answer(&mut self, requests: Option<&EventCount>) -> bool {
        let newest = requests.map_or(self.seen, EventCount::read);
        self.is_open |= newest != self.seen;
        self.seen = newest;
        let may_answer = self.answered.is_none_or(|answered| answered.elapsed() >= ANSWER_PAUSE);
        let answers = self.is_open && may_answer;
        if answers {
            (self.is_open, self.answered) = (false, Some(Instant::now()));
        }
        answers
    }

    /// Sleeps for `poll`, or until a request arrives.
    fn sleep(&self, requests: Option<&EventCount>, poll: Duration) {
        match requests {
            Some(requests) if !self.is_open => requests.sleep(self.seen, poll),
            Some(_) => std::thread::sleep(ANSWER_PAUSE.min(poll)),
            None => std::thread::sleep(poll),
        }
    }
}

/// Time between two rounds of reading, for a buffer of so many frames.
fn poll_period(buffer: usize, fps: f64) -> Duration {
    Duration::from_secs_f64(buffer as f64 / POLLS_PER_BUFFER / fps).min(LONGEST_POLL)
}

fn publish(status: &mut Publisher<u8, StatusHeader>, report: &Report) {
    let Ok(mut text) = serde_json::to_vec(report) else { return };
    if text.len() > MAX_STATUS_BYTES {
        // Only the events' evidence is unbounded.
        let shorter = Report { events: Vec::new(), ..report.clone() };
        text = serde_json::to_vec(&shorter).unwrap_or_default();
    }
    let Ok(mut message) = status.loan(MAX_STATUS_BYTES) else { return };
    let (bytes, header) = message.parts();
    bytes[..text.len()].copy_from_slice(&text);
    *header = StatusHeader { t_sent_ns: monotonic_ns(), bytes: text.len() as u64 };
    // Ignore failures: without subscribers no report is needed.
    let _ = message.send();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_answered_at_once_and_floods_of_them_at_a_limited_rate() {
        let path = std::env::temp_dir().join(format!("tl-asked-{}", std::process::id()));
        let requests = EventCount::open(&path).unwrap();
        let mut asked = Asked::default();
        assert!(!asked.is_to_answer(Some(&requests)), "nobody has asked");
        requests.advance();
        // Returns at once.
        asked.sleep(Some(&requests), Duration::from_secs(3600));
        assert!(asked.is_to_answer(Some(&requests)));
        assert!(!asked.is_to_answer(Some(&requests)), "it is answered");
        let began = Instant::now();
        let mut answers = 0;
        while answers < 3 {
            requests.advance();
            answers += u32::from(asked.is_to_answer(Some(&requests)));
            asked.sleep(Some(&requests), Duration::from_millis(1));
        }
        assert!(began.elapsed() >= ANSWER_PAUSE * 2, "{:?}", began.elapsed());
        std::fs::remove_file(&path).unwrap();
    }
}
