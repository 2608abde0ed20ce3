//! A look over the whole recording, chunk by chunk, for the time line: what was found when, gaps, and events.

use super::recorded::{Recorded, frame_seq};
use crate::console::reading::event_json;
use messages::{DetectionFrame, GroupEvent};
use recording::{Channel, Entry, decode_message};
use serde_json::{Value, json};
use std::collections::HashMap;

/// Most events and gaps that are told; there are hundreds only if something is very wrong.
const MOST_EVENTS: usize = 1000;
const MOST_GAPS: usize = 1000;
/// Chunks after which results without a frame are given up.
const PATIENCE: usize = 128;

/// What is known of a frame.
#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    /// Its number, once its chunk was read.
    seq: Option<u64>,
    /// Robots with a name, and whether there is a ball; `None` without results.
    found: Option<(u8, bool)>,
}

/// The look over a recording.
pub struct Survey {
    next_chunk: usize,
    seen: Vec<Seen>,
    /// Places of frames by their number.
    by_seq: HashMap<u64, usize>,
    /// Results whose frame comes in a later chunk, with the number of the chunk.
    early: Vec<(usize, u64, (u8, bool))>,
    events: Vec<(u64, Value)>,
}

impl Survey {
    /// Nothing was looked at yet.
    pub fn new(recorded: &Recorded) -> Self {
        Self {
            next_chunk: 0,
            seen: vec![Seen::default(); recorded.archive().moments().len()],
            by_seq: HashMap::new(),
            early: Vec::new(),
            events: Vec::new(),
        }
    }

    /// Whether everything was looked at.
    pub fn is_done(&self, recorded: &Recorded) -> bool {
        self.next_chunk >= recorded.archive().chunks()
    }

    /// Looks at the next chunk. A damaged one has nothing.
    pub fn step(&mut self, recorded: &mut Recorded) {
        let chunk = self.next_chunk;
        self.next_chunk += 1;
        let Ok(entries) = recorded.chunk(chunk) else { return };
        for entry in entries.iter() {
            if entry.channel == recorded.archive().lead() {
                self.take_lead(recorded, chunk, entry);
            }
            match entry.channel {
                Channel::Detections => self.take_detections(chunk, entry),
                Channel::Events => self.take_event(entry),
                _ => {}
            }
        }
        let early = std::mem::take(&mut self.early);
        for (since, seq, found) in early {
            match self.by_seq.get(&seq) {
                Some(&at) => self.seen[at].found = Some(found),
                None if chunk < since + PATIENCE => self.early.push((since, seq, found)),
                None => {}
            }
        }
    }

    fn take_lead(&mut self, recorded: &Recorded, chunk: usize, entry: &Entry) {
        let moment = recording::Moment { t_sent_ns: entry.t_sent_ns, chunk: chunk as u32 };
        let place = recorded.archive().moments().binary_search(&moment);
        if let (Ok(at), Some(seq)) = (place, frame_seq(entry)) {
            self.seen[at].seq = Some(seq);
            self.by_seq.insert(seq, at);
        }
    }

    fn take_detections(&mut self, chunk: usize, entry: &Entry) {
        let Some(seen) = decode_message::<DetectionFrame>(&entry.data) else { return };
        let named = seen.robots().iter().filter(|robot| robot.is_identified()).count();
        let found = (named.min(255) as u8, !seen.balls().is_empty());
        match self.by_seq.get(&seen.frame.seq) {
            Some(&at) => self.seen[at].found = Some(found),
            None => self.early.push((chunk, seen.frame.seq, found)),
        }
    }

    fn take_event(&mut self, entry: &Entry) {
        if self.events.len() >= MOST_EVENTS {
            return;
        }
        if let Some(event) = decode_message::<GroupEvent>(&entry.data) {
            self.events.push((entry.t_sent_ns, event_json(&event)));
        }
    }

    /// What was found so far, in this many equal parts of the time. `different`: how much a comparison differs at
    /// a frame.
    pub fn report(
        &self,
        recorded: &Recorded,
        bins: usize,
        different: impl Fn(usize) -> u32,
    ) -> Value {
        let moments = recorded.archive().moments();
        let (begin_ns, end_ns) = (recorded.begin_ns(), moments.last().map_or(0, |it| it.t_sent_ns));
        let length_ns = end_ns.saturating_sub(begin_ns).max(1);
        let mut parts = vec![Bin::default(); bins.max(1)];
        let mut gaps = Vec::new();
        let mut before: Option<(u64, u64)> = None;
        for (at, (moment, seen)) in moments.iter().zip(&self.seen).enumerate() {
            let since_ns = u128::from(moment.t_sent_ns.saturating_sub(begin_ns));
            let bin = (since_ns * parts.len() as u128 / u128::from(length_ns)) as usize;
            let last = parts.len() - 1;
            let part = &mut parts[bin.min(last)];
            part.different = part.different.max(different(at));
            if let Some((robots, ball)) = seen.found {
                part.robots = Some(part.robots.map_or(robots, |least| least.min(robots)));
                part.ball = Some(part.ball.unwrap_or(true) && ball);
            }
            let Some(seq) = seen.seq else { continue };
            if let Some((last_seq, t_ns)) = before
                && seq > last_seq + 1
                && gaps.len() < MOST_GAPS
            {
                gaps.push(json!({
                    "from_s": recorded.after_s(t_ns), "to_s": recorded.after_s(moment.t_sent_ns),
                    "missing": seq - last_seq - 1,
                }));
            }
            before = Some((seq, moment.t_sent_ns));
        }
        let events = self.events.iter().map(|(t_ns, event)| {
            let mut event = event.clone();
            event["after_s"] = json!(recorded.after_s(*t_ns));
            event
        });
        json!({
            "done": self.next_chunk as f64 / recorded.archive().chunks().max(1) as f64,
            "robots": parts.iter().map(|it| it.robots).collect::<Vec<_>>(),
            "ball": parts.iter().map(|it| it.ball).collect::<Vec<_>>(),
            "different": parts.iter().map(|it| it.different).collect::<Vec<_>>(),
            "gaps": gaps, "events": events.collect::<Vec<_>>(),
        })
    }
}

/// What is found in a part of the time: the least in one of its frames.
#[derive(Debug, Clone, Copy, Default)]
struct Bin {
    robots: Option<u8>,
    ball: Option<bool>,
    different: u32,
}
