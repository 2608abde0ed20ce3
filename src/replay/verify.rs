//! Recomputes every output in a recording and compares it, bit for bit, with the recorded one.
//!
//! Every output names the inputs it was made from: runs their frame, detections their runs and the
//! `world` they took as a prediction, a `world` its detections, the `world` before it and the commands
//! used in between. A stage's whole state is in its last output. So each output can be checked by itself,
//! from recorded inputs, even after faults of the stages: a take-over by a spare affects only the times.

use super::configurations::{ConfigurationError, Configurations, NoStage};
use super::inputs::Inputs;
use messages::structure::{Structure, name_at, structures_of};
use messages::{ClearStale, DetectionFrame, MAX_RUNS, Run, RunsHeader, WorldFrame};
use recording::{Channel, Entry, Setup, decode_frame, decode_list, decode_message};
use std::collections::{BTreeMap, VecDeque};

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
    configurations: Configurations,
    results: Results,
    inputs: Inputs,
    waiting: VecDeque<(u64, Output)>,
    findings: Findings,
}

enum Output {
    Runs(RunsHeader, Vec<Run>),
    Detections(u64),
    World(u64),
}

/// Reused outputs, and the structures to name differences with.
struct Results {
    detections: Box<DetectionFrame>,
    world: Box<WorldFrame>,
    detection_structures: Vec<Structure>,
    world_structures: Vec<Structure>,
}

impl Default for Results {
    fn default() -> Self {
        Self {
            detections: bytemuck::allocation::zeroed_box(),
            world: bytemuck::allocation::zeroed_box(),
            detection_structures: structures_of::<DetectionFrame>(),
            world_structures: structures_of::<WorldFrame>(),
        }
    }
}

impl Verifier {
    /// Processes the next message.
    pub fn take(&mut self, entry: &Entry) -> Result<(), ConfigurationError> {
        if !self.configurations.is_empty() {
            self.work_off(Some(entry.t_sent_ns));
        }
        if entry.channel == Channel::Setup {
            let Some(setup) = Setup::decode(&entry.data) else {
                self.findings.rubbish += 1;
                return Ok(());
            };
            // Where outputs name no revision, all those up to here were made with the configuration before, if
            // there was one: messages in flight when the recording began were sent a moment before its first
            // message.
            if setup.revision == 0 && !self.configurations.is_empty() {
                self.work_off(None);
            }
            return self.configurations.add(&setup);
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
            if self.configurations.is_empty() {
                self.findings.rubbish += 1;
                continue;
            }
            let mut check = Check {
                inputs: &self.inputs,
                configurations: &mut self.configurations,
                results: &mut self.results,
            };
            let (channel, verdict) = match output {
                Output::Runs(header, runs) => (Channel::Runs, check.runs(header, &runs)),
                Output::Detections(seq) => (Channel::Detections, check.detections(seq)),
                Output::World(seq) => {
                    let prior = self.inputs.world(seq).map(|world| world.prior_world_seq);
                    let is_start = prior == Some(WorldFrame::NO_WORLD);
                    self.findings.filter_starts += u64::from(is_start);
                    (Channel::World, check.world(seq))
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

impl From<NoStage> for Verdict {
    fn from(reason: NoStage) -> Self {
        match reason {
            NoStage::NotRecorded => Self::Without("its configuration"),
            NoStage::Unusable(why) => Self::Different(format!("its configuration: {why}")),
        }
    }
}

/// What an output is computed from.
struct Check<'a> {
    inputs: &'a Inputs,
    configurations: &'a mut Configurations,
    results: &'a mut Results,
}

impl Check<'_> {
    /// The classifier's output for a recorded frame, with a revision of the configuration.
    fn classify(&mut self, seq: u64, revision: u32) -> Result<(RunsHeader, Vec<Run>), Verdict> {
        let frame = self.inputs.frame(seq).ok_or(Verdict::Without("its frame"))?;
        let mut header = RunsHeader::default();
        let mut runs = vec![bytemuck::Zeroable::zeroed(); MAX_RUNS];
        let classifier = self.configurations.classifier(revision)?;
        classifier.step(&frame.header, &frame.pixels, &mut header, &mut runs).map_err(|fault| {
            Verdict::Different(format!("frame {seq} was classified, but: {fault}"))
        })?;
        runs.truncate(header.run_count as usize);
        header.revision = revision;
        Ok((header, runs))
    }

    fn runs(&mut self, recorded: RunsHeader, recorded_runs: &[Run]) -> Result<(), Verdict> {
        let seq = recorded.frame.seq;
        let (mut header, runs) = self.classify(seq, recorded.revision)?;
        header.t_frame_taken_ns = recorded.t_frame_taken_ns;
        header.t_sent_ns = recorded.t_sent_ns;
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

    fn detections(&mut self, seq: u64) -> Result<(), Verdict> {
        let inputs = self.inputs;
        let recorded = inputs.detections(seq).ok_or(Verdict::Without("itself"))?;
        let (mut header, runs) = self.classify(seq, recorded.classifier_revision)?;
        header.t_frame_taken_ns = recorded.t_frame_taken_ns;
        header.t_sent_ns = recorded.t_runs_ns;
        let prior = match recorded.prior_world_seq {
            DetectionFrame::NO_WORLD => None,
            prior => Some(inputs.world(prior).ok_or(Verdict::Without("the world it used"))?),
        };
        // The tracker either had the frame or did not.
        let frame = (recorded.flags & DetectionFrame::FRAME_USED != 0).then(|| inputs.frame(seq));
        let pixels = frame.flatten().map(|frame| &frame.pixels[..]);
        let Results { detections, detection_structures, .. } = &mut *self.results;
        let tracker = self.configurations.tracker(recorded.revision)?;
        tracker.step(&header, &runs, pixels, prior, detections);
        detections.clear_stale();
        detections.t_runs_taken_ns = recorded.t_runs_taken_ns;
        detections.t_sent_ns = recorded.t_sent_ns;
        detections.revision = recorded.revision;
        compare("detections", seq, &**detections, recorded, detection_structures)
    }

    fn world(&mut self, seq: u64) -> Result<(), Verdict> {
        let inputs = self.inputs;
        let recorded = inputs.world(seq).ok_or(Verdict::Without("itself"))?;
        let detections = inputs.detections(seq).ok_or(Verdict::Without("its detections"))?;
        let mut filter = self.configurations.filter(recorded.revision)?;
        if recorded.prior_world_seq != WorldFrame::NO_WORLD {
            let prior = inputs.world(recorded.prior_world_seq);
            filter.resume(prior.ok_or(Verdict::Without("the world before it"))?);
        }
        for name in recorded.commands() {
            let commands = inputs.commands(name).ok_or(Verdict::Without("its commands"))?;
            filter.command(commands);
        }
        let Results { world, world_structures, .. } = &mut *self.results;
        filter.step(detections, world);
        world.clear_stale();
        world.t_detections_taken_ns = recorded.t_detections_taken_ns;
        world.t_sent_ns = recorded.t_sent_ns;
        world.revision = recorded.revision;
        compare("world", seq, &**world, recorded, world_structures)
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
