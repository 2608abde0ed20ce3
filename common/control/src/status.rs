//! Reading the report of a running group.

use crate::Report;
use client::bus::{Bus, BusError};
use client::eventcount::EventCount;
use client::instance::Instance;
use messages::topics;
use std::time::{Duration, Instant};

/// Name of the event count that advances on a status request.
const REQUESTS: &str = "status-requests";
/// Time after which a request is repeated: a monitor answers at once, but may just have started.
const ASK_AGAIN: Duration = Duration::from_millis(100);

/// Requests a report from a running group's monitor, and reads it.
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
        // Ignore messages that are not reports of the group.
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

/// The event count of status requests; `None` if its page cannot be mapped.
pub fn requests(bus: &Bus) -> Option<EventCount> {
    EventCount::open(&bus.namespace().event_count_path(REQUESTS)).ok()
}
