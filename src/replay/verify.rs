//! Recomputes every output in a recording and compares it, bit for bit, with the recorded one.
//!
//! Every output names the inputs it was made from: runs their frame, detections their runs and the
//! `world` they took as a prediction, a `world` its detections, the `world` before it and the commands
//! used in between. A stage's whole state is in its last output. So each output can be checked by itself,
//! from recorded inputs, even after faults of the stages: a take-over by a spare affects only the times.

use super::inputs::Inputs;
use classifier::Classifier;
use config::Config;
use filter::Filter;
use messages::structure::{Structure, name_at, structures_of};
use messages::{ClearStale, DetectionFrame, MAX_RUNS, Run, RunsHeader, WorldFrame};
use recording::{Channel, Entry, Setup, decode_frame, decode_list, decode_message};
use std::collections::{BTreeMap, VecDeque};
use tracker::Tracker;

/// Delay in recorded time before an output is checked: with invalid time stamps, inputs may be
/// recorded a little after the outputs made from them.
const PATIENCE_NS: u64 = 300_000_000;
/// Most differences described.
const MAX_DESCRIBED: usize = 10;

/// Findings of a check.
#[derive(Debug, Default)]
pub struct Findings {
    /// Tallies by the channel of a stage's output.
    pub outputs: BTreeMap<Channel, Tally>,
    /// Descriptions of the first differences.
    pub differences: Vec<String>,
    /// Filters that started without a state: at the start of the match, and where filter and spare
    /// died together.
    pub filter_starts: u64,
    /// Invalid messages in the recording.
    pub rubbish: u64,
}

/// Tally of one kind of output.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub struct Tally {
    /// Recomputed with a bit-identical result.
    pub equal: u64,
    /// Recomputed with a different result.
    pub different: u64,
    /// Not recomputed because an input is not in the recording, by missing input.
    pub without: BTreeMap<&'static str, u64>,
}

/// Checks a recording, message by message.
#[derive(Default)]
pub struct Verifier {
    stages: Option<Stages>,
    inputs: Inputs,
    waiting: VecDeque<(u64, Output)>,
    findings: Findings,
}

enum Output {
    Runs(RunsHeader, Vec<Run>),
    Detections(u64),
    World(u64),
}

struct Stages {
    config: Config,
    classifier: Classifier,
    tracker: Tracker,
    detections: Box<DetectionFrame>,
    world: Box<WorldFrame>,
    detection_structures: Vec<Structure>,
    world_structures: Vec<Structure>,
}

/// Reason for which a recording cannot be checked.
#[derive(Debug, thiserror::Error)]
#[error("the recorded configuration: {0}")]
pub struct ConfigurationError(String);

impl Verifier {
    /// Processes the next message.
    pub fn take(&mut self, entry: &Entry) -> Result<(), ConfigurationError> {
        if self.stages.is_some() {
            self.work_off(Some(entry.t_sent_ns));
        }
        if entry.channel == Channel::Setup {
            // All outputs up to here were made with the previous configuration, if there was one:
            // messages in flight when the recording began were sent a moment before its first
            // message.
            if self.stages.is_some() {
                self.work_off(None);
            }
            let Some(setup) = Setup::decode(&entry.data) else {
                self.findings.rubbish += 1;
                return Ok(());
            };
            self.stages = Some(Stages::new(&setup.config_toml)?);
            return Ok(());
        }
        if self.note(entry).is_none() {
            self.findings.rubbish += 1;
        }
        Ok(())
    }

    /// Completes the check.
    pub fn finish(mut self) -> Findings {
        self.work_off(None);
        self.findings
    }

    /// Keeps inputs, and queues outputs to be checked.
    fn note(&mut self, entry: &Entry) -> Option<()> {
        let Self { inputs, waiting, .. } = self;
        let output = match entry.channel {
            Channel::Frames => {
                inputs.add_frame(&decode_frame(&entry.data)?);
                return Some(());
            }
            Channel::Commands => {
                inputs.add_commands(decode_message(&entry.data)?);
                return Some(());
            }
            Channel::Runs => {
                let (header, runs) = decode_list(&entry.data)?;
                Output::Runs(header, runs)
            }
            Channel::Detections => {
                let detections = decode_message::<DetectionFrame>(&entry.data)?;
                let seq = detections.frame.seq;
                inputs.add_detections(detections);
                Output::Detections(seq)
            }
            Channel::World => {
                let world = decode_message::<WorldFrame>(&entry.data)?;
                let seq = world.frame.seq;
                inputs.add_world(world);
                Output::World(seq)
            }
            _ => return Some(()),
        };
        waiting.push_back((entry.t_sent_ns, output));
        Some(())
    }

    /// Checks outputs sent long enough before `now_ns`, or all.
    fn work_off(&mut self, now_ns: Option<u64>) {
        while let Some((t_ns, _)) = self.waiting.front()
            && now_ns.is_none_or(|now_ns| now_ns.saturating_sub(*t_ns) > PATIENCE_NS)
        {
            let Some((_, output)) = self.waiting.pop_front() else { break };
            let Some(stages) = &mut self.stages else {
                self.findings.rubbish += 1;
                continue;
            };
            let (channel, verdict) = match output {
                Output::Runs(header, runs) => {
                    (Channel::Runs, stages.check_runs(&self.inputs, header, &runs))
                }
                Output::Detections(seq) => {
                    (Channel::Detections, stages.check_detections(&self.inputs, seq))
                }
                Output::World(seq) => {
                    let prior = self.inputs.world(seq).map(|world| world.prior_world_seq);
                    let is_start = prior == Some(WorldFrame::NO_WORLD);
                    self.findings.filter_starts += u64::from(is_start);
                    (Channel::World, stages.check_world(&self.inputs, seq))
                }
            };
            let tally = self.findings.outputs.entry(channel).or_default();
            match verdict {
                Ok(()) => tally.equal += 1,
                Err(Verdict::Without(what)) => *tally.without.entry(what).or_default() += 1,
                Err(Verdict::Different(how)) => {
                    tally.different += 1;
                    if self.findings.differences.len() < MAX_DESCRIBED {
                        self.findings.differences.push(how);
                    }
                }
            }
        }
    }
}

/// Reason for which an output is not equal.
enum Verdict {
    Without(&'static str),
    Different(String),
}

impl Stages {
    fn new(config_toml: &str) -> Result<Self, ConfigurationError> {
        let error = |error: &dyn std::fmt::Display| ConfigurationError(error.to_string());
        let config = Config::parse(config_toml, "recorded").map_err(|e| error(&e))?;
        // Validate the filter's configuration now, so that it need not be checked later.
        Filter::new(&config).map_err(|e| error(&e))?;
        Ok(Self {
            classifier: Classifier::new(&config).map_err(|e| error(&e))?,
            tracker: Tracker::new(&config).map_err(|e| error(&e))?,
            config,
            detections: bytemuck::allocation::zeroed_box(),
            world: bytemuck::allocation::zeroed_box(),
            detection_structures: structures_of::<DetectionFrame>(),
            world_structures: structures_of::<WorldFrame>(),
        })
    }

    /// The classifier's output for a recorded frame.
    fn classify(&mut self, inputs: &Inputs, seq: u64) -> Result<(RunsHeader, Vec<Run>), Verdict> {
        let frame = inputs.frame(seq).ok_or(Verdict::Without("its frame"))?;
        let mut header = RunsHeader::default();
        let mut runs = vec![bytemuck::Zeroable::zeroed(); MAX_RUNS];
        self.classifier.step(&frame.header, &frame.pixels, &mut header, &mut runs).map_err(
            |fault| Verdict::Different(format!("frame {seq} was classified, but: {fault}")),
        )?;
        runs.truncate(header.run_count as usize);
        Ok((header, runs))
    }

    fn check_runs(
        &mut self,
        inputs: &Inputs,
        recorded: RunsHeader,
        recorded_runs: &[Run],
    ) -> Result<(), Verdict> {
        let seq = recorded.frame.seq;
        let (mut header, runs) = self.classify(inputs, seq)?;
        header.t_frame_taken_ns = recorded.t_frame_taken_ns;
        header.t_sent_ns = recorded.t_sent_ns;
        header.revision = recorded.revision;
        header.classes_since = recorded.classes_since;
        if bytemuck::bytes_of(&header) != bytemuck::bytes_of(&recorded) {
            return Err(Verdict::Different(format!(
                "runs of frame {seq}: recorded {recorded:?}, now {header:?}"
            )));
        }
        match runs.iter().zip(recorded_runs).position(|(now, then)| now != then) {
            None if runs.len() == recorded_runs.len() => Ok(()),
            at => Err(Verdict::Different(format!("runs of frame {seq}: from run {at:?} on"))),
        }
    }

    fn check_detections(&mut self, inputs: &Inputs, seq: u64) -> Result<(), Verdict> {
        let recorded = inputs.detections(seq).ok_or(Verdict::Without("itself"))?;
        let (mut header, runs) = self.classify(inputs, seq)?;
        header.t_frame_taken_ns = recorded.t_frame_taken_ns;
        header.t_sent_ns = recorded.t_runs_ns;
        header.revision = recorded.classifier_revision;
        let prior = match recorded.prior_world_seq {
            DetectionFrame::NO_WORLD => None,
            prior => Some(inputs.world(prior).ok_or(Verdict::Without("the world it used"))?),
        };
        // The tracker either had the frame or did not.
        let frame = (recorded.flags & DetectionFrame::FRAME_USED != 0).then(|| inputs.frame(seq));
        let pixels = frame.flatten().map(|frame| &frame.pixels[..]);
        self.tracker.step(&header, &runs, pixels, prior, &mut self.detections);
        self.detections.clear_stale();
        self.detections.t_runs_taken_ns = recorded.t_runs_taken_ns;
        self.detections.t_sent_ns = recorded.t_sent_ns;
        self.detections.revision = recorded.revision;
        compare("detections", seq, &*self.detections, recorded, &self.detection_structures)
    }

    fn check_world(&mut self, inputs: &Inputs, seq: u64) -> Result<(), Verdict> {
        let recorded = inputs.world(seq).ok_or(Verdict::Without("itself"))?;
        let detections = inputs.detections(seq).ok_or(Verdict::Without("its detections"))?;
        let mut filter = Filter::new(&self.config)
            .map_err(|error| Verdict::Different(format!("world of frame {seq}: {error}")))?;
        if recorded.prior_world_seq != WorldFrame::NO_WORLD {
            let prior = inputs.world(recorded.prior_world_seq);
            filter.resume(prior.ok_or(Verdict::Without("the world before it"))?);
        }
        for name in recorded.commands() {
            let commands = inputs.commands(name).ok_or(Verdict::Without("its commands"))?;
            filter.command(commands);
        }
        filter.step(detections, &mut self.world);
        self.world.clear_stale();
        self.world.t_detections_taken_ns = recorded.t_detections_taken_ns;
        self.world.t_sent_ns = recorded.t_sent_ns;
        self.world.revision = recorded.revision;
        compare("world", seq, &*self.world, recorded, &self.world_structures)
    }
}

fn compare<T: bytemuck::Pod>(
    what: &str,
    seq: u64,
    now: &T,
    recorded: &T,
    structures: &[Structure],
) -> Result<(), Verdict> {
    let (now, recorded) = (bytemuck::bytes_of(now), bytemuck::bytes_of(recorded));
    match now.iter().zip(recorded).position(|(now, recorded)| now != recorded) {
        None => Ok(()),
        Some(offset) => Err(Verdict::Different(format!(
            "{what} of frame {seq}: from {} on",
            name_at(structures, offset)
        ))),
    }
}
