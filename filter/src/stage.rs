//! The stage's core: detections and commands in, world out.

use crate::ball::BallMotion;
use crate::commands::{CommandQueue, CommandTiming};
use crate::gaussian::cholesky;
use crate::message::{self, BallTrack, RobotTrack};
use crate::robot::{Drive, RobotMotion};
use crate::track::{Candidate, Motion, Track, TrackRules};
use crate::unknown::{SeenPatch, UnknownRobots};
use config::{Config, FilterConfig};
use geometry::rolling_shutter::RollingShutter;
use geometry::wrap_angle;
use messages::{
    BALL_HYPOTHESES, Commands, CommandsName, DetectedBall, DetectedRobot, DetectionFrame,
    MAX_ROBOTS, MAX_USED_COMMANDS, QueuedCommand, Team, WorldFrame, are_possible_speeds,
};
use nalgebra::{Matrix2, Matrix3, SMatrix, Vector2, Vector3, Vector4, Vector5};

/// Pause between two frames after which, as when time runs backwards, all tracks start over.
const MAX_PAUSE_NS: u64 = 1_000_000_000;
/// Limit of the tracker's latency; a later `t_sent_ns` is ignored.
const MAX_LATENCY_NS: u64 = 1_000_000_000;
/// Commands sent later than this after the newest capture are ignored.
const MAX_COMMAND_AHEAD_NS: u64 = 1_000_000_000;
/// Detections farther from the middle of the pitch are ignored.
const MAX_DISTANCE_MM: f64 = 100_000.0;

/// Tracks every configured robot and the ball from frame to frame.
///
/// Its whole state goes out with every [`WorldFrame`] and comes back through [`resume`](Self::resume).
#[derive(Debug)]
pub struct Filter {
    identities: Vec<(Team, u32)>,
    robot_motion: RobotMotion,
    ball_motion: BallMotion,
    rules: TrackRules,
    timing: CommandTiming,
    shutter: RollingShutter,
    /// Sorted by team and number.
    robots: Vec<RobotTrack>,
    /// Robots of which only the team is known, if they are tracked.
    unknown: Option<UnknownRobots>,
    ball: Option<BallTrack>,
    /// Capture time of the newest frame.
    t_ns: Option<u64>,
    /// Number of the newest frame, or [`WorldFrame::NO_WORLD`].
    seq: u64,
    commands_seq: u64,
    /// Commands accepted since that frame.
    used: Vec<CommandsName>,
}

/// The configuration cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FilterError {
    /// A number that no filter can work with.
    #[error("{key} = {value}: must be {expected}")]
    Impossible {
        /// Key in the configuration.
        key: &'static str,
        /// Its value.
        value: f64,
        /// The permitted values.
        expected: &'static str,
    },
}

impl Filter {
    /// A filter without tracks.
    pub fn new(config: &Config) -> Result<Self, FilterError> {
        check(config)?;
        let mut identities: Vec<(Team, u32)> =
            config.robots.identities.iter().map(|robot| (robot.team, robot.id)).collect();
        identities.sort_unstable();
        identities.dedup();
        identities.truncate(MAX_ROBOTS);
        Ok(Self {
            robots: Vec::with_capacity(identities.len()),
            identities,
            robot_motion: RobotMotion::new(config),
            ball_motion: BallMotion::new(&config.filter),
            rules: TrackRules::new(&config.filter),
            timing: CommandTiming::new(&config.filter),
            shutter: config.camera.rolling_shutter(),
            unknown: config.robots.report_unknown.then(|| UnknownRobots::new(config)),
            ball: None,
            t_ns: None,
            seq: WorldFrame::NO_WORLD,
            commands_seq: WorldFrame::NO_COMMANDS,
            used: Vec::with_capacity(MAX_USED_COMMANDS),
        })
    }

    /// Continues exactly from the last output of a predecessor with the same configuration. Parts that cannot
    /// be tracks of configured robots are left out.
    pub fn resume(&mut self, last: &WorldFrame) {
        let t_ns = last.frame.t_capture_ns;
        self.t_ns = Some(t_ns);
        self.seq = last.frame.seq;
        self.commands_seq = last.commands_seq;
        self.used.clear();
        self.robots.clear();
        for (state, memory) in last.robots().iter().zip(&last.robot_memories) {
            let track = RobotTrack::from_message(state, memory, t_ns, &self.robot_motion);
            if let Some(track) = track
                && self.identities.contains(&(track.team, track.robot_id))
                && let Err(place) = self.find(track.team, track.robot_id)
            {
                self.robots.insert(place, track);
            }
        }
        if let Some(unknown) = &mut self.unknown {
            unknown.resume(last);
        }
        self.ball =
            message::ball_from_message(&last.ball, &last.ball_memory, t_ns, &self.ball_motion);
    }

    /// Whether further commands can be accepted before the next frame: every `world` names those it used, and
    /// has limited room. Further commands should wait.
    pub fn takes_commands(&self) -> bool {
        self.used.len() < MAX_USED_COMMANDS
    }

    /// Accepts commands. Those for robots without a track are dropped, and so are invalid ones.
    pub fn command(&mut self, commands: &Commands) {
        let Some(t_ns) = self.t_ns else { return };
        if !self.takes_commands() {
            return;
        }
        let t_sent_ns = commands.t_sent_ns;
        if t_sent_ns > t_ns.saturating_add(MAX_COMMAND_AHEAD_NS)
            || t_sent_ns.saturating_add(self.timing.timeout_ns) < t_ns
        {
            return;
        }
        let mut is_used = false;
        for wheels in commands.wheels() {
            let (left_mm_s, right_mm_s) = (wheels.left_mm_s, wheels.right_mm_s);
            if let Some(team) = Team::from_number(wheels.team)
                && are_possible_speeds(left_mm_s, right_mm_s)
                && let Ok(index) = self.find(team, wheels.robot_id)
            {
                let command = QueuedCommand { t_sent_ns, left_mm_s, right_mm_s };
                self.robots[index].commands.insert(command, &self.timing);
                is_used = true;
            }
        }
        if is_used {
            self.commands_seq = commands.seq;
            self.used.push(CommandsName { seq: commands.seq, t_sent_ns });
        }
    }

    /// Processes one frame and writes the result. Fills everything except `t_detections_taken_ns` and
    /// `t_sent_ns`, which are set to 0, and list elements behind their count, which are left as they are.
    pub fn step(&mut self, detections: &DetectionFrame, out: &mut WorldFrame) {
        let t_ns = detections.frame.t_capture_ns;
        let from_ns = self.start_over_unless_continuous(t_ns);
        self.t_ns = Some(t_ns);
        self.follow_robots(detections, from_ns, t_ns);
        self.follow_unknown(detections, from_ns, t_ns);
        self.follow_ball(detections, from_ns, t_ns);
        self.write(detections, t_ns, out);
        self.seq = detections.frame.seq;
        self.used.clear();
    }

    /// The capture time of the frame that the tracks come from; drops the tracks if the new frame does not
    /// follow it.
    fn start_over_unless_continuous(&mut self, t_ns: u64) -> u64 {
        let before_ns = self.t_ns.unwrap_or(t_ns);
        if t_ns < before_ns || t_ns - before_ns > MAX_PAUSE_NS {
            self.robots.clear();
            self.unknown.iter_mut().for_each(UnknownRobots::clear);
            self.ball = None;
            return t_ns;
        }
        before_ns
    }

    fn follow_robots(&mut self, detections: &DetectionFrame, from_ns: u64, t_ns: u64) {
        let Self { robots, robot_motion, rules, timing, shutter, .. } = self;
        let detected = detections.robots();
        let candidates = |team: Team, robot_id: u32| {
            detected
                .iter()
                .filter(move |robot| {
                    robot.team == team as u32 && robot.robot_id.number() == Some(robot_id)
                })
                .filter_map(|robot| {
                    let delay_s = shutter.delay_s(robot.y_px.into());
                    Some((delay_s, robot_candidate(robot, robot_motion)?))
                })
        };
        robots.retain_mut(|robot| {
            let seen = candidates(robot.team, robot.robot_id);
            let path_mm = predict_robot(robot, from_ns, t_ns, robot_motion, timing);
            robot.commands.prune(t_ns, timing);
            let track = &mut robot.track;
            let rates = shutter
                .is_rolling()
                .then(|| robot_motion.rates(&track.imm.merged(RobotMotion::WRAP)));
            let wrap = RobotMotion::WRAP_MEASURED;
            let seen = seen.map(|(delay_s, it)| match &rates {
                Some(rates) => rates.at_frame_time(delay_s, it, wrap),
                None => it,
            });
            track.observe(seen, &robot_motion.repeats(path_mm), t_ns, robot_motion, rules);
            track.imm.is_possible(&robot_motion.limits()) && !track.is_forgotten(t_ns, rules)
        });
        for &(team, robot_id) in &self.identities {
            let place = robots
                .binary_search_by_key(&(team, robot_id), |robot| (robot.team, robot.robot_id));
            if let Err(place) = place
                // The speed of an object seen for the first time is unknown.
                && let Some(first) = best(candidates(team, robot_id).map(|(_, it)| it), rules)
            {
                let track = Track::start(&first.measured, t_ns, robot_motion);
                let commands = CommandQueue::default();
                robots.insert(place, RobotTrack { team, robot_id, track, commands });
            }
        }
    }

    fn follow_unknown(&mut self, detections: &DetectionFrame, from_ns: u64, t_ns: u64) {
        let Self { robots, unknown, robot_motion, rules, shutter, .. } = self;
        let Some(unknown) = unknown else { return };
        let noise = *unknown.noise();
        let centers = unknown.center_variance();
        let seen = detections.robots().iter().filter(|robot| !robot.is_identified());
        let seen = seen.filter_map(|robot| patch_candidate(robot, centers, &noise, shutter));
        unknown.follow(seen, robots, robot_motion, (from_ns, t_ns), rules);
    }

    fn follow_ball(&mut self, detections: &DetectionFrame, from_ns: u64, t_ns: u64) {
        let Self { ball, ball_motion, rules, shutter, .. } = self;
        let candidates = detections.balls().iter().filter_map(|ball| {
            let delay_s = shutter.delay_s(ball.y_px.into());
            Some((delay_s, ball_candidate(ball, ball_motion)?))
        });
        if let Some(track) = ball {
            predict_ball(track, from_ns, t_ns, ball_motion);
            let rates = ball_motion.rates(&track.imm.merged(BallMotion::WRAP));
            let seen = candidates
                .clone()
                .map(|(delay_s, it)| rates.at_frame_time(delay_s, it, BallMotion::WRAP_MEASURED));
            track.observe(seen, &[1.0; BALL_HYPOTHESES], t_ns, ball_motion, rules);
        }
        *ball = ball
            .filter(|track| {
                track.imm.is_possible(&ball_motion.limits()) && !track.is_forgotten(t_ns, rules)
            })
            .or_else(|| {
                best(candidates.map(|(_, it)| it), rules)
                    .map(|first| Track::start(&first.measured, t_ns, ball_motion))
            });
    }

    fn write(&self, detections: &DetectionFrame, t_ns: u64, out: &mut WorldFrame) {
        let handed_on_ns = Some(detections.t_sent_ns)
            .filter(|&sent_ns| (t_ns..=t_ns.saturating_add(MAX_LATENCY_NS)).contains(&sent_ns))
            .unwrap_or(t_ns);
        let t_predicted_ns = handed_on_ns.saturating_add(self.timing.delay_ns);
        out.frame = detections.frame;
        out.t_frame_taken_ns = detections.t_frame_taken_ns;
        out.t_runs_ns = detections.t_runs_ns;
        out.t_runs_taken_ns = detections.t_runs_taken_ns;
        out.t_detections_ns = detections.t_sent_ns;
        out.t_detections_taken_ns = 0;
        out.t_sent_ns = 0;
        out.t_predicted_ns = t_predicted_ns;
        out.prior_world_seq = self.seq;
        out.commands_seq = self.commands_seq;
        out.robot_count = self.robots.len() as u32;
        out.command_count = self.used.len() as u32;
        out.commands[..self.used.len()].copy_from_slice(&self.used);
        let slots = out.robots.iter_mut().zip(&mut out.robot_memories);
        for (robot, (state, memory)) in self.robots.iter().zip(slots) {
            let predicted = self.predicted_robot(robot, t_ns, t_predicted_ns);
            *state = robot.state(&predicted, robot.track.visibility(t_ns, &self.rules));
            *memory = robot.memory();
        }
        (out.unknown_robot_count, out.unknown_memory_count) = (0, 0);
        out.last_track_id = 0;
        out.classifier_revision = detections.classifier_revision;
        out.tracker_revision = detections.revision;
        out.revision = 0;
        if let Some(unknown) = &self.unknown {
            unknown.write(t_ns, t_predicted_ns, &self.rules, out);
        }
        let ball = self.ball.as_ref();
        let predicted = ball.map(|ball| self.predicted_ball(ball, t_ns, t_predicted_ns));
        let visibility = ball.map_or(0.0, |ball| ball.visibility(t_ns, &self.rules));
        out.ball = message::ball_state(ball, &predicted.unwrap_or_default(), visibility);
        out.ball_memory = message::ball_memory(ball);
    }

    /// The paper's prediction over the delay: the state at `to_ns` under the commands under way.
    fn predicted_robot(&self, robot: &RobotTrack, from_ns: u64, to_ns: u64) -> Vector5<f64> {
        let mut imm = robot.track.imm;
        for (dt_s, command) in robot.commands.segments(from_ns, to_ns, &self.timing) {
            for (hypothesis, drive) in imm.hypotheses.iter_mut().zip(Drive::hypotheses(command)) {
                let mean = &mut hypothesis.belief.mean;
                *mean = self.robot_motion.advance(mean, drive, dt_s);
            }
        }
        imm.merged_mean(RobotMotion::WRAP)
    }

    fn predicted_ball(&self, ball: &BallTrack, from_ns: u64, to_ns: u64) -> Vector4<f64> {
        let now = ball.imm.merged_mean(BallMotion::WRAP);
        self.ball_motion.advance(&now, to_ns.saturating_sub(from_ns) as f64 * 1e-9)
    }

    /// Index of a robot's track in `robots`, or the index at which to insert it.
    fn find(&self, team: Team, robot_id: u32) -> Result<usize, usize> {
        self.robots.binary_search_by_key(&(team, robot_id), |robot| (robot.team, robot.robot_id))
    }
}

/// Predicts a track; returns the distance its wheels have rolled if it obeyed. Nothing moves between two
/// frames of the same instant.
fn predict_robot(
    robot: &mut RobotTrack,
    from_ns: u64,
    to_ns: u64,
    motion: &RobotMotion,
    timing: &CommandTiming,
) -> f64 {
    let RobotTrack { track, commands, .. } = robot;
    if from_ns < to_ns {
        track.imm.mix(&RobotMotion::TRANSITIONS, RobotMotion::WRAP);
    }
    let mut path_mm = 0.0;
    for (dt_s, command) in commands.segments(from_ns, to_ns, timing) {
        let hypotheses = track.imm.hypotheses.iter_mut().zip(Drive::hypotheses(command));
        let paths_mm = hypotheses
            .map(|(hypothesis, drive)| motion.predict(&mut hypothesis.belief, drive, dt_s));
        // Evaluates all, so that all are predicted; the first is the steered one.
        path_mm += paths_mm.reduce(|steered_mm, _| steered_mm).unwrap_or(0.0);
    }
    path_mm
}

fn predict_ball(track: &mut BallTrack, from_ns: u64, to_ns: u64, motion: &BallMotion) {
    if from_ns < to_ns {
        track.imm.mix(&BallMotion::TRANSITIONS, BallMotion::WRAP);
        let dt_s = (to_ns - from_ns) as f64 * 1e-9;
        for (index, hypothesis) in track.imm.hypotheses.iter_mut().enumerate() {
            motion.predict(&mut hypothesis.belief, index, dt_s);
        }
    }
}

/// The most confident candidate, if it suffices to start a track.
fn best<const Z: usize>(
    candidates: impl Iterator<Item = Candidate<Z>>,
    rules: &TrackRules,
) -> Option<Candidate<Z>> {
    candidates
        .max_by(|a, b| a.confidence.total_cmp(&b.confidence))
        .filter(|candidate| candidate.confidence >= rules.start_confidence)
}

/// A detection as a measurement (eq. 8) with its covariance; `None` if it is invalid.
fn robot_candidate(robot: &DetectedRobot, motion: &RobotMotion) -> Option<Candidate<3>> {
    let orientation = f64::from(robot.orientation);
    let position = position(robot.x_mm, robot.y_mm)?;
    let confidence = confidence(robot.confidence)?;
    let [xx, xy, xt, yy, yt, tt] = robot.covariance.map(f64::from);
    let given = Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt);
    orientation.is_finite().then(|| Candidate {
        measured: Vector3::new(position.x, position.y, wrap_angle(orientation)),
        noise: usable_noise(given).unwrap_or(*motion.noise()),
        confidence,
    })
}

/// An unidentified detection as a measurement of its team patch. The tracker's covariance allows for the
/// unknown direction from patch to centre by `centers`, which is removed: that error is constant, not noise.
fn patch_candidate(
    robot: &DetectedRobot,
    centers: f64,
    noise: &Matrix2<f64>,
    shutter: &RollingShutter,
) -> Option<SeenPatch> {
    let [xx, xy, _, yy, ..] = robot.covariance.map(f64::from);
    let given = Matrix2::new(xx - centers, xy, xy, yy - centers);
    Some(SeenPatch {
        team: Team::from_number(robot.team)?,
        delay_s: shutter.delay_s(robot.y_px.into()),
        candidate: Candidate {
            measured: position(robot.x_mm, robot.y_mm)?,
            noise: usable_noise(given).unwrap_or(*noise),
            // Confidence plays no role here: a track is confirmed by being seen repeatedly.
            confidence: confidence(robot.confidence).map(|_| 1.0)?,
        },
    })
}

fn ball_candidate(ball: &DetectedBall, motion: &BallMotion) -> Option<Candidate<2>> {
    let measured = position(ball.x_mm, ball.y_mm)?;
    let [xx, xy, yy] = ball.covariance.map(f64::from);
    let noise = usable_noise(Matrix2::new(xx, xy, xy, yy)).unwrap_or(*motion.noise());
    Some(Candidate { measured, noise, confidence: confidence(ball.confidence)? })
}

/// A valid covariance: positive definite, and neither too small nor too large. Other trackers mostly send
/// zeros, for unknown.
fn usable_noise<const Z: usize>(noise: SMatrix<f64, Z, Z>) -> Option<SMatrix<f64, Z, Z>> {
    const MAX_VARIANCE: f64 = 1e6;
    const MIN_VARIANCE: f64 = 1e-9;
    let is_usable = noise.diagonal().iter().all(|v| (MIN_VARIANCE..=MAX_VARIANCE).contains(v))
        && cholesky(&noise).is_some();
    is_usable.then_some(noise)
}

fn position(x_mm: f32, y_mm: f32) -> Option<Vector2<f64>> {
    let position = Vector2::new(f64::from(x_mm), f64::from(y_mm));
    (position.amax() <= MAX_DISTANCE_MM && position.sum().is_finite()).then_some(position)
}

fn confidence(value: f32) -> Option<f64> {
    (value > 0.0 && value.is_finite()).then(|| f64::from(value.min(1.0)))
}

fn check(config: &Config) -> Result<(), FilterError> {
    let FilterConfig {
        position_noise_mm,
        heading_noise_deg,
        acceleration_noise_mm_s2,
        angular_acceleration_noise_deg_s2,
        command_noise_mm_s,
        command_noise_deg_s,
        lateral_noise_mm_s,
        collision_factor,
        repeat_distance_mm,
        command_lag_ms,
        command_timeout_ms,
        actuation_delay_ms,
        gate_chi2,
        reinit_after: _,
        start_confidence,
        forget_after_ms,
        ball_noise_mm,
        ball_acceleration_noise_mm_s2,
        ball_kick_factor,
        ball_friction_per_s,
    } = config.filter;
    let positive = [
        ("robots.wheel_base_mm", config.robots.wheel_base_mm),
        ("filter.position_noise_mm", position_noise_mm),
        ("filter.heading_noise_deg", heading_noise_deg),
        ("filter.collision_factor", collision_factor),
        ("filter.gate_chi2", gate_chi2),
        ("filter.forget_after_ms", forget_after_ms),
        ("filter.ball_noise_mm", ball_noise_mm),
        ("filter.ball_kick_factor", ball_kick_factor),
    ];
    let not_negative = [
        ("filter.acceleration_noise_mm_s2", acceleration_noise_mm_s2),
        ("filter.angular_acceleration_noise_deg_s2", angular_acceleration_noise_deg_s2),
        ("filter.command_noise_mm_s", command_noise_mm_s),
        ("filter.command_noise_deg_s", command_noise_deg_s),
        ("filter.lateral_noise_mm_s", lateral_noise_mm_s),
        ("filter.repeat_distance_mm", repeat_distance_mm),
        ("filter.command_lag_ms", command_lag_ms),
        ("filter.command_timeout_ms", command_timeout_ms),
        ("filter.actuation_delay_ms", actuation_delay_ms),
        ("filter.start_confidence", start_confidence),
        ("filter.ball_acceleration_noise_mm_s2", ball_acceleration_noise_mm_s2),
        ("filter.ball_friction_per_s", ball_friction_per_s),
    ];
    let impossible = |expected, test: fn(f64) -> bool, values: &[(&'static str, f64)]| {
        let wrong = values.iter().find(|(_, value)| !value.is_finite() || !test(*value));
        wrong.map_or(Ok(()), |&(key, value)| Err(FilterError::Impossible { key, value, expected }))
    };
    impossible("greater than 0", |value| value > 0.0, &positive)?;
    impossible("0 or more", |value| value >= 0.0, &not_negative)
}
