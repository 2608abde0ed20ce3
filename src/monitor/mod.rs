//! The monitor: an independent consumer that counts, times and scores what the group does.
//!
//! It believes no stage's counters where it can see for itself: frames are counted on `frames`,
//! results on `world`, errors against `truth`. It runs on a thread of the supervisor's process,
//! polls without wake-ups (so it costs the writers next to nothing), publishes the report on
//! `status`, the supervisor's events on `events` and its sign of life on `health`, and draws the
//! console.

pub mod accuracy;
mod camera;
mod collector;
mod commanders;
mod console;
mod containment;
mod flow;
mod latency;
pub mod report;
mod strangers;
mod unknown;
mod usage;
mod view;

pub use console::{Output, summary};
pub use report::Report;
pub use view::{AttendantView, Event, GroupView, ProcessView};

use collector::Collector;
use common::bus::{Bus, BusError, Publisher};
use common::clock::monotonic_ns;
use common::config::{CameraConfig, Config};
use common::eventcount::EventCount;
use common::instance::Instance;
use common::messages::{GroupEvent, Heartbeat, MAX_STATUS_BYTES, StatusHeader};
use common::process::HEARTBEAT;
use common::topics;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The topics are emptied at least so often, for a display that moves …
const LONGEST_POLL: Duration = Duration::from_millis(50);
/// … and whenever this part of a buffer has filled, so that nothing is overwritten meanwhile.
const POLLS_PER_BUFFER: f64 = 4.0;
/// How often the status is published.
const STATUS_PERIOD: Duration = Duration::from_millis(500);

/// Between two answers to those who ask for the status, at least.
const ANSWER_PAUSE: Duration = Duration::from_millis(10);

/// Between two looks at whether the monitor has ended.
const LAST_LOOK: Duration = Duration::from_millis(1);

/// What the monitor publishes on.
struct Outlets {
    status: Publisher<u8, StatusHeader>,
    events: Publisher<GroupEvent, ()>,
    health: Publisher<Heartbeat, ()>,
    /// Advances when somebody wants a status now; without it the next regular one has to do.
    requests: Option<EventCount>,
}

/// The running monitor.
pub struct Monitor {
    thread: JoinHandle<Report>,
    stop: Arc<AtomicBool>,
    /// How many monitors had fallen before this one.
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
        // Ports belong to the thread that made them, so they are made there.
        let count = move || {
            containment::contain_this_thread();
            match Collector::new(&instance, source, &config, view) {
                Ok((mut collector, outlets)) => {
                    let _ = connected.send(Ok(()));
                    let poll = poll_period(&config.camera);
                    watch(&mut collector, outlets, output, poll, &stop_requested)
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
        // One that falls gives no answer.
        loop {
            match is_connected.recv_timeout(LONGEST_POLL) {
                Ok(outcome) => return outcome.map(|()| monitor),
                Err(RecvTimeoutError::Timeout) if !monitor.has_fallen() => {}
                Err(_) => return Ok(monitor),
            }
        }
    }

    /// Whether it has met a fault and will not go on; the group is no longer counted.
    pub fn has_fallen(&self) -> bool {
        containment::fallen() > self.fallen_before || self.thread.is_finished()
    }

    /// Ends the monitor; the report is complete. That of one that has fallen is empty.
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
    poll: Duration,
    stop: &AtomicBool,
) -> Report {
    let mut display = console::Display::new(output);
    let mut published = Instant::now();
    let mut beat = Instant::now();
    let mut asked = Asked::default();
    loop {
        // Looked at first: what was published before the request is still collected.
        let last_round = stop.load(Ordering::Relaxed);
        if let Err(error) = collector.collect() {
            common::tell!("touchline: monitor: {error}");
        }
        let events = collector.take_new_events();
        for event in &events {
            // Nobody may be listening, and the log has it.
            let _ = outlets.events.publish(&event.message());
        }
        display.events(&events);
        // After the events: whoever reads of one in a heartbeat finds it.
        if beat.elapsed() >= HEARTBEAT || !events.is_empty() {
            beat = Instant::now();
            let _ = collector.heartbeat().map(|beat| outlets.health.publish(&beat));
        }
        let is_due = published.elapsed() >= STATUS_PERIOD;
        if is_due || asked.is_to_answer(outlets.requests.as_ref()) || last_round {
            let report = collector.report(last_round);
            publish(&mut outlets.status, &report);
            if last_round {
                display.clear();
                return report;
            }
            // What is asked for does not make the display flicker.
            if is_due {
                published = Instant::now();
                display.draw(&report);
            }
        }
        asked.sleep(outlets.requests.as_ref(), poll);
    }
}

/// What has become of those who ask for a status.
#[derive(Default)]
struct Asked {
    seen: u32,
    is_open: bool,
    answered: Option<Instant>,
}

impl Asked {
    /// Whether somebody is to be answered now. A program that asks all the time gets an answer now and
    /// then.
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

    /// Sleeps for so long, or until somebody asks.
    fn sleep(&self, requests: Option<&EventCount>, poll: Duration) {
        match requests {
            Some(requests) if !self.is_open => requests.sleep(self.seen, poll),
            Some(_) => std::thread::sleep(ANSWER_PAUSE.min(poll)),
            None => std::thread::sleep(poll),
        }
    }
}

/// How often the topics are emptied.
fn poll_period(camera: &CameraConfig) -> Duration {
    let buffer = topics::frames(camera.frame_bytes()).buffer as f64;
    Duration::from_secs_f64(buffer / POLLS_PER_BUFFER / camera.fps).min(LONGEST_POLL)
}

fn publish(status: &mut Publisher<u8, StatusHeader>, report: &Report) {
    let Ok(mut text) = serde_json::to_vec(report) else { return };
    if text.len() > MAX_STATUS_BYTES {
        // The events' evidence is the only part without a bound.
        let shorter = Report { events: Vec::new(), ..report.clone() };
        text = serde_json::to_vec(&shorter).unwrap_or_default();
    }
    let Ok(mut message) = status.loan(MAX_STATUS_BYTES) else { return };
    let (bytes, header) = message.parts();
    bytes[..text.len()].copy_from_slice(&text);
    *header = StatusHeader { t_sent_ns: monotonic_ns(), bytes: text.len() as u64 };
    // Nobody may be listening; then nobody misses it.
    let _ = message.send();
}

/// Name of the count that advances when somebody asks for a status.
const REQUESTS: &str = "status-requests";
/// A monitor answers at once. After so long it is asked again: it may just have started.
const ASK_AGAIN: Duration = Duration::from_millis(100);

/// Has the monitor of a running group publish its status, and reads it.
pub fn read_status(instance: &Instance, patience: Duration) -> Result<Option<Report>, BusError> {
    let bus = Bus::join(instance, "status")?;
    let subscriber = bus.subscriber(&topics::STATUS)?;
    let mut arrives = bus.wake_up(&topics::STATUS)?;
    let requests = requests(&bus);
    let deadline = Instant::now() + patience;
    let mut asked: Option<Instant> = None;
    while Instant::now() < deadline {
        if asked.is_none_or(|asked| asked.elapsed() >= ASK_AGAIN) {
            asked = Some(Instant::now());
            if let Some(requests) = &requests {
                requests.advance();
            }
        }
        // Whatever else is published there: what is no report is not the group's.
        while let Some(message) = subscriber.receive()? {
            let length = (message.header().bytes as usize).min(message.elements().len());
            if let Ok(report) = serde_json::from_slice(&message.elements()[..length]) {
                return Ok(Some(report));
            }
        }
        arrives.wait(ASK_AGAIN);
    }
    Ok(None)
}

/// The count of those who have asked for a status; `None` where its page cannot be had.
fn requests(bus: &Bus) -> Option<EventCount> {
    EventCount::open(&bus.namespace().event_count_path(REQUESTS)).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_asks_is_answered_at_once_and_who_asks_all_the_time_now_and_then() {
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
