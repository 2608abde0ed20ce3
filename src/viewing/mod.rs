//! Looking at a recording, as a library call for a process of its own: requests come as lines of JSON, and each is
//! answered by a header in JSON and bytes, both preceded by their length (`u32`, little-endian).
//!
//! | request | answer |
//! |---|---|
//! | `{"do": "open"}` | what is in it: frames, seconds, configurations |
//! | `{"do": "frame", "at": …}` | a frame: everything found on it, in the terms of the console's live view; the picture as bytes |
//! | `{"do": "still", "index": N}` | a frame in colour, as PNG |
//! | `{"do": "survey", "bins": N}` | for the time line: what was found when, gaps, events; more of it each time until `done` is 1 |
//! | `{"do": "model", "revision": N}` | what is needed to draw with a configuration of the recording, or (`"other": true`) of the comparison |
//! | `{"do": "compare", "with": …, "from_s": …, "to_s": …}` | begins a comparison with another configuration; `survey` tells its counts |
//! | `{"do": "stop"}` | ends the comparison where it is |
//!
//! [`recorded`] reads, [`survey`] looks over the whole file, [`comparison`] computes. Survey and comparison go on
//! between requests. Nothing is ever written.

mod comparison;
mod recorded;
mod survey;

use crate::console::pictures::{Wish, encoded};
use crate::console::scene::messages::runs_list;
use crate::setup_worker::input::assumed;
use client::instance::Instance;
use comparison::Comparison;
use config::{Config, Preset};
use messages::DetectionFrame;
use recorded::{At, Recorded};
use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::error::Error;
use std::io::{self, BufRead, Write};
use std::path::Path;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use survey::Survey;

/// Most parts of a time line.
const MOST_BINS: usize = 4000;

/// Reason for which there is no answer; its text is for the user.
pub type ViewingError = Box<dyn Error + Send + Sync>;

/// A question about the recording.
#[derive(Debug, Deserialize)]
#[serde(tag = "do", rename_all = "lowercase", deny_unknown_fields)]
enum Request {
    Open,
    Frame {
        at: Place,
        #[serde(default)]
        picture: Wish,
        #[serde(default)]
        runs: bool,
    },
    Still {
        index: usize,
    },
    Survey {
        bins: usize,
    },
    Model {
        #[serde(default)]
        revision: u32,
        #[serde(default)]
        other: bool,
    },
    Compare {
        with: With,
        from_s: f64,
        to_s: f64,
    },
    Stop,
}

/// Which frame.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Place {
    /// By number, from 0.
    Index(usize),
    /// The one that is nearest to a time, seconds since the first one.
    TimeS(f64),
    /// The next after (or before) this one where a comparison differs.
    DifferenceAfter(usize),
    DifferenceBefore(usize),
}

/// Another configuration.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum With {
    Preset(String),
    /// A file's name and its text.
    Text {
        name: String,
        text: String,
    },
    /// Another one of the recording.
    Revision(u32),
    /// That of the running group, with these changes.
    Group {
        set: Map<String, Value>,
    },
}

/// Header and bytes of an answer.
type Answer = (Value, Vec<u8>);

/// Answers requests until there are no more.
pub fn serve(
    path: &Path,
    instance: &Instance,
    input: impl BufRead + Send + 'static,
    mut output: impl Write,
) -> io::Result<()> {
    let (sender, requests) = channel();
    std::thread::spawn(move || {
        for line in input.lines() {
            // An end of the input ends the requests.
            let Ok(line) = line else { break };
            if sender.send(line).is_err() {
                break;
            }
        }
    });
    let mut viewing = match Viewing::open(path, instance) {
        Ok(viewing) => viewing,
        Err(error) => return refuse_all(&requests, &error, &mut output),
    };
    loop {
        let request = if viewing.has_work() {
            match requests.try_recv() {
                Ok(request) => Some(request),
                Err(TryRecvError::Empty) => None,
                Err(TryRecvError::Disconnected) => return Ok(()),
            }
        } else {
            match requests.recv() {
                Ok(request) => Some(request),
                Err(_) => return Ok(()),
            }
        };
        match request {
            None => viewing.work(),
            Some(request) => {
                let (header, bytes) = viewing.answer(&request).unwrap_or_else(|error| {
                    (json!({ "error": { "message": error.to_string() } }), Vec::new())
                });
                send(&mut output, &header, &bytes)?;
            }
        }
    }
}

fn refuse_all(
    requests: &Receiver<String>,
    error: &ViewingError,
    output: &mut impl Write,
) -> io::Result<()> {
    let refusal = json!({ "error": { "message": error.to_string() } });
    requests.iter().try_for_each(|_| send(output, &refusal, &[]))
}

fn send(output: &mut impl Write, header: &Value, bytes: &[u8]) -> io::Result<()> {
    let header = header.to_string();
    output.write_all(&(header.len() as u32).to_le_bytes())?;
    output.write_all(header.as_bytes())?;
    output.write_all(&(bytes.len() as u32).to_le_bytes())?;
    output.write_all(bytes)?;
    output.flush()
}

/// An opened recording, and what is being found out about it.
struct Viewing {
    instance: Instance,
    recorded: Recorded,
    survey: Survey,
    comparison: Option<Comparison>,
}

impl Viewing {
    fn open(path: &Path, instance: &Instance) -> Result<Self, ViewingError> {
        let recorded = Recorded::open(path)?;
        let survey = Survey::new(&recorded);
        Ok(Self { instance: instance.clone(), recorded, survey, comparison: None })
    }

    fn has_work(&self) -> bool {
        !self.survey.is_done(&self.recorded)
            || self.comparison.as_ref().is_some_and(|it| !it.is_done())
    }

    /// A small part of what is to be done: somebody waits for the comparison, so it comes first.
    fn work(&mut self) {
        match self.comparison.as_mut().filter(|it| !it.is_done()) {
            Some(comparison) => comparison.step(&mut self.recorded),
            None => self.survey.step(&mut self.recorded),
        }
    }

    fn answer(&mut self, request: &str) -> Result<Answer, ViewingError> {
        let request: Request =
            serde_json::from_str(request).map_err(|error| format!("the request: {error}"))?;
        let header = match request {
            Request::Open => self.recorded.describe(),
            Request::Frame { at, picture, runs } => return self.frame(&at, picture, runs),
            Request::Still { index } => {
                let at = self.recorded.at(index)?;
                let frame =
                    at.and_then(|at| at.frame).ok_or("there is no picture of this frame")?;
                let png = frame.rgb().and_then(|picture| picture.png().ok());
                return Ok((json!({}), png.ok_or("it cannot be encoded")?));
            }
            Request::Survey { bins } => self.survey_report(bins.clamp(1, MOST_BINS)),
            Request::Model { revision, other: false } => {
                self.recorded.configuration(revision, u64::MAX).scene.model()
            }
            Request::Model { other: true, .. } => {
                let comparison = self.comparison.as_ref().ok_or("nothing is compared")?;
                comparison.scene.model()
            }
            Request::Compare { with, from_s, to_s } => self.compare(with, from_s, to_s)?,
            Request::Stop => {
                if let Some(comparison) = &mut self.comparison {
                    comparison.stop();
                }
                json!({})
            }
        };
        Ok((header, Vec::new()))
    }

    fn survey_report(&self, bins: usize) -> Value {
        let comparison = self.comparison.as_ref();
        let different = |index| comparison.map_or(0, |it| it.different(index));
        let mut report = self.survey.report(&self.recorded, bins, different);
        report["comparison"] = comparison.map_or(Value::Null, |it| it.report(&self.recorded));
        report
    }

    fn frame(&mut self, at: &Place, wish: Wish, runs: bool) -> Result<Answer, ViewingError> {
        if !wish.is_possible() {
            return Err("the scale of a picture is 1, 2 or 4".into());
        }
        let last = self.recorded.archive().moments().len() - 1;
        let comparison = self.comparison.as_ref();
        let index = match *at {
            Place::Index(index) => index.min(last),
            Place::TimeS(time_s) => self.recorded.nearest(time_s),
            Place::DifferenceAfter(index) => comparison
                .and_then(|it| it.next_difference(index, true))
                .ok_or("there is no difference after this frame")?,
            Place::DifferenceBefore(index) => comparison
                .and_then(|it| it.next_difference(index, false))
                .ok_or("there is no difference before this frame")?,
        };
        let Some(at) = self.recorded.at(index)? else {
            // The next ones may be good.
            let moment = self.recorded.archive().moments()[index];
            let time_s = self.recorded.after_s(moment.t_sent_ns);
            return Ok((json!({ "index": index, "time_s": time_s, "damaged": true }), Vec::new()));
        };
        let (picture, bytes) = match &at.frame {
            Some(frame) => encoded(frame, wish).ok_or("the picture cannot be encoded")?,
            None => (Value::Null, Vec::new()),
        };
        let mut header = self.found(&at, runs);
        header["picture"] = picture;
        header["other"] = comparison.and_then(|it| it.shown(index)).unwrap_or(Value::Null);
        Ok((header, bytes))
    }

    /// Everything that was recorded of a frame, in the terms of the live view.
    fn found(&self, at: &At, with_runs: bool) -> Value {
        let configuration = self.recorded.configuration(at.revision(), at.t_ns);
        let scene = &configuration.scene;
        let runs = with_runs.then(|| match (&at.runs, &at.detections) {
            (Some((header, runs)), _) => Some(runs_list(header.valid(runs).iter())),
            (None, Some(detections)) => Some(runs_of(detections)),
            (None, None) => None,
        });
        json!({
            "index": at.index, "time_s": self.recorded.after_s(at.t_ns),
            "clock_s": at.t_ns as f64 * 1e-9, "seq": at.seq,
            "revision": configuration.setup.revision,
            "detections": at.detections.as_ref().map(|seen| scene.detections(seen)),
            "world": at.world.as_ref().map(|world| scene.world(world)),
            "runs": runs.flatten(),
        })
    }

    fn compare(&mut self, with: With, from_s: f64, to_s: f64) -> Result<Value, ViewingError> {
        if !(from_s.is_finite() && to_s.is_finite()) {
            return Err("the times are not finite".into());
        }
        let (name, config) = match with {
            With::Preset(name) => {
                let preset = Preset::ALL.into_iter().find(|preset| preset.name() == name);
                let preset = preset.ok_or_else(|| format!("there is no preset {name:?}"))?;
                (format!("preset {name}"), preset.config())
            }
            With::Text { name, text } => {
                let config = Config::parse(&text, &name)?;
                (name, config)
            }
            With::Revision(number) => {
                let all = self.recorded.configurations().iter();
                let found = all.rev().find(|it| it.setup.revision == number);
                let found = found.ok_or_else(|| format!("it has no revision {number}"))?;
                (format!("revision {number}"), found.scene.config.clone())
            }
            With::Group { set } => {
                let name = if set.is_empty() { "the running group" } else { "the proposal" };
                (name.into(), assumed(&self.instance, &set)?)
            }
        };
        let range = self.recorded.nearest(from_s)..self.recorded.nearest(to_s) + 1;
        // An earlier one is given up.
        self.comparison = Some(Comparison::new(&self.recorded, name, config, range)?);
        Ok(json!({ "most_frames": comparison::MOST_FRAMES }))
    }
}

/// The pixels of the regions, as the live view has runs.
fn runs_of(seen: &DetectionFrame) -> Vec<u16> {
    let regions = seen.regions().iter();
    runs_list(regions.flat_map(|region| seen.runs_of(region)))
}
