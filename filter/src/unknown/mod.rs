//! Tracking of robots of which only the team is known.
//!
//! A team often does not know the patches of its opponents. The tracker gives such robots a position in each
//! frame; here those positions become tracks with velocity and a persistent number. The state is that of the
//! team patch, (x, y, vx, vy); [`motion`] has the model. Detections and tracks are associated for the whole
//! frame at once (`association.rs`).
//!
//! # One robot, one track
//!
//! An identified robot must not have an unidentified duplicate.
//!
//! * An unidentified detection may be an identified robot with a hidden identification patch. So identified
//!   robots that were not recognised in this frame take part in the association, with their estimated
//!   heading, on equal terms. A detection associated with one starts no track. If the association is
//!   unambiguous, the detection also corrects the robot's position ([`team_patch`]), since prediction alone,
//!   with or without commands, is off by centimetres after a tenth of a second. It does not confirm the
//!   identity: a robot that is not recognised for `filter.forget_after_ms` loses it and is tracked without.
//! * No second robot of the team can be where a robot was just identified. An unidentified track that leads
//!   there and was not seen was that robot, and ends.
//!
//! # Track states
//!
//! A detection that belongs to no track starts a tentative track. Seen in [`FRAMES_TO_CONFIRM`] frames in a
//! row, it is confirmed, gets the next number, and goes out with `world`. Unseen for
//! `filter.forget_after_ms`, it ends.

mod assignment;
mod association;
mod message;
pub mod motion;

use crate::message::RobotTrack;
use crate::robot::RobotMotion;
use crate::rolling::Rates;
use crate::team_patch;
use crate::track::{Candidate, Motion, Track, TrackRules};
use association::Association;
use config::Config;
use messages::{MAX_UNKNOWN_ROBOTS, Team, TrackStatus, UNKNOWN_HYPOTHESES};
use motion::UnknownMotion;
use nalgebra::{Matrix2, Vector2};

/// Consecutive frames in which a track must be seen before it is published.
pub const FRAMES_TO_CONFIRM: u32 = 3;

/// A tracked robot.
#[derive(Debug, Clone, Copy, PartialEq)]
struct UnknownTrack {
    team: Team,
    /// 0 while tentative.
    track_id: u32,
    /// Frames since it was first seen, that one included.
    frames_tracked: u32,
    /// Track of the team patch.
    track: Track<4, UNKNOWN_HYPOTHESES, 2>,
}

/// An unidentified detection.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SeenPatch {
    /// Its team.
    pub team: Team,
    /// Seconds after the frame's time at which its row was captured.
    pub delay_s: f64,
    /// Position of the patch.
    pub candidate: Candidate<2>,
}

/// Tracks them from frame to frame. The whole state goes out with every [`WorldFrame`] and comes back through
/// [`resume`](Self::resume).
#[derive(Debug)]
pub(crate) struct UnknownRobots {
    motion: UnknownMotion,
    half_size_mm: f64,
    /// Sorted by team and number.
    confirmed: Vec<UnknownTrack>,
    /// In the order of first sight.
    tentative: Vec<UnknownTrack>,
    last_track_id: u32,
    seen: Vec<SeenPatch>,
    association: Association,
}

impl UnknownRobots {
    /// From the configuration, without tracks.
    pub fn new(config: &Config) -> Self {
        Self {
            motion: UnknownMotion::new(config),
            half_size_mm: config.robots.size_mm / 2.0,
            confirmed: Vec::with_capacity(MAX_UNKNOWN_ROBOTS),
            tentative: Vec::with_capacity(MAX_UNKNOWN_ROBOTS),
            last_track_id: 0,
            seen: Vec::with_capacity(MAX_UNKNOWN_ROBOTS),
            association: Association::default(),
        }
    }

    /// Removes all tracks. Numbers continue.
    pub fn clear(&mut self) {
        self.confirmed.clear();
        self.tentative.clear();
    }

    /// Variance of each coordinate of a robot's centre, given its team patch.
    pub fn center_variance(&self) -> f64 {
        self.motion.center_variance()
    }

    /// Covariance of a patch in a detection that does not state its own.
    pub fn noise(&self) -> &Matrix2<f64> {
        self.motion.noise()
    }

    /// Processes the unidentified detections of the frame captured at `t_ns`; `from_ns` is the time of the
    /// previous frame. `robots` are the identified robots, already predicted to this frame and corrected by
    /// it.
    pub fn follow(
        &mut self,
        seen: impl Iterator<Item = SeenPatch>,
        robots: &mut [RobotTrack],
        robot_motion: &RobotMotion,
        (from_ns, t_ns): (u64, u64),
        rules: &TrackRules,
    ) {
        self.seen.clear();
        self.seen.extend(seen.take(MAX_UNKNOWN_ROBOTS));
        if self.seen.is_empty() && self.confirmed.is_empty() && self.tentative.is_empty() {
            return;
        }
        let Self { motion, confirmed, tentative, .. } = self;
        for unknown in confirmed.iter_mut().chain(tentative) {
            predict(&mut unknown.track, from_ns, t_ns, motion);
        }
        self.associate(robots, robot_motion, rules);
        self.locate_robots(robots, robot_motion);
        self.observe(robots.len(), t_ns, rules);
        self.end_duplicates(robots);
        self.start_tentative(t_ns);
        self.confirm_tracks();
    }

    /// Associates detections with tracks: identified robots that were not recognised first, by their indices,
    /// then confirmed tracks, then tentative ones.
    fn associate(&mut self, robots: &[RobotTrack], robot_motion: &RobotMotion, rules: &TrackRules) {
        let Self { association, motion, confirmed, tentative, seen, .. } = self;
        association.start(seen.len());
        let of_team =
            |team: Team| seen.iter().enumerate().filter(move |(_, patch)| patch.team == team);
        let is_missing = |robot: &RobotTrack| robot.track.status == TrackStatus::Coasting;
        for (index, robot) in robots.iter().enumerate().filter(|(_, robot)| is_missing(robot)) {
            let rates = position_rates(robot, robot_motion);
            let density = |(index, patch): (usize, &SeenPatch)| {
                let candidate = patch.at_frame(&rates);
                let patch_mm = motion.patch_mm();
                let density =
                    team_patch::density(&robot.track, patch_mm, &candidate, rules.gate_chi2);
                Some((index, density?))
            };
            association.add(index, of_team(robot.team).filter_map(density));
        }
        for (index, unknown) in confirmed.iter().chain(tentative.iter()).enumerate() {
            let rates = motion.rates(&unknown.track.imm.merged(UnknownMotion::WRAP));
            let density = |(index, patch): (usize, &SeenPatch)| {
                let candidate = patch.at_frame(&rates);
                Some((index, unknown.track.density::<UnknownMotion>(&candidate, rules)?))
            };
            association.add(robots.len() + index, of_team(unknown.team).filter_map(density));
        }
        association.solve();
    }

    fn locate_robots(&self, robots: &mut [RobotTrack], robot_motion: &RobotMotion) {
        for (index, robot) in robots.iter_mut().enumerate() {
            if let Some(seen) = self.association.detection_of(index)
                && self.association.is_unambiguous(index, seen)
            {
                let candidate = self.seen[seen].at_frame(&position_rates(robot, robot_motion));
                team_patch::correct(&mut robot.track, self.motion.patch_mm(), &candidate);
            }
        }
    }

    /// Corrects all tracks by their detections, and ends forgotten and invalid ones.
    fn observe(&mut self, first: usize, t_ns: u64, rules: &TrackRules) {
        let Self { association, motion, confirmed, tentative, seen, .. } = self;
        let mut index = first;
        let mut observe = |unknown: &mut UnknownTrack| {
            let track = &mut unknown.track;
            let rates = motion.rates(&track.imm.merged(UnknownMotion::WRAP));
            let own = association.detection_of(index).map(|own| seen[own].at_frame(&rates));
            track.observe(own.into_iter(), &[1.0; UNKNOWN_HYPOTHESES], t_ns, motion, rules);
            unknown.frames_tracked = unknown.frames_tracked.saturating_add(1);
            index += 1;
            track.imm.is_possible(&motion.limits()) && !track.is_forgotten(t_ns, rules)
        };
        confirmed.retain_mut(&mut observe);
        tentative.retain_mut(|unknown| observe(unknown) && unknown.track.frames_unseen == 0);
    }

    /// Ends tracks that have turned out to be identified robots.
    fn end_duplicates(&mut self, robots: &[RobotTrack]) {
        let half_size_mm = self.half_size_mm;
        let is_seen = |robot: &&RobotTrack| {
            matches!(
                robot.track.status,
                TrackStatus::Measured | TrackStatus::Initialised | TrackStatus::Located
            )
        };
        self.confirmed.retain(|unknown| {
            let [x_mm, y_mm] = position_of(unknown);
            let is_there = |robot: &RobotTrack| {
                let center = robot.track.imm.merged(RobotMotion::WRAP).mean;
                robot.team == unknown.team
                    && (center[0] - x_mm).hypot(center[1] - y_mm) < half_size_mm
            };
            unknown.track.frames_unseen == 0 || !robots.iter().filter(is_seen).any(is_there)
        });
    }

    /// Starts tentative tracks at detections that belong to no track.
    fn start_tentative(&mut self, t_ns: u64) {
        for (index, patch) in self.seen.iter().enumerate() {
            if !self.association.is_owned(index)
                && self.confirmed.len() + self.tentative.len() < MAX_UNKNOWN_ROBOTS
            {
                self.tentative.push(UnknownTrack {
                    team: patch.team,
                    track_id: 0,
                    frames_tracked: 1,
                    track: Track::start(&patch.candidate.measured, t_ns, &self.motion),
                });
            }
        }
    }

    fn confirm_tracks(&mut self) {
        let Self { confirmed, tentative, last_track_id, .. } = self;
        tentative.retain_mut(|unknown| {
            if unknown.frames_tracked < FRAMES_TO_CONFIRM {
                return true;
            }
            // After the last number they begin anew, and some may still be in use.
            loop {
                *last_track_id = last_track_id.wrapping_add(1).max(1);
                unknown.track_id = *last_track_id;
                if insert(confirmed, *unknown) {
                    return false;
                }
            }
        });
    }
}

impl SeenPatch {
    /// The measurement converted to the frame's time, for an object that moves at these rates.
    fn at_frame(&self, rates: &Rates<2>) -> Candidate<2> {
        rates.at_frame_time(self.delay_s, self.candidate, UnknownMotion::WRAP_MEASURED)
    }
}

fn position_of(unknown: &UnknownTrack) -> [f64; 2] {
    let mean = unknown.track.imm.merged(UnknownMotion::WRAP).mean;
    [mean[0], mean[1]]
}

/// Rates of change of an identified robot's position.
fn position_rates(robot: &RobotTrack, motion: &RobotMotion) -> Rates<2> {
    let rates = motion.rates(&robot.track.imm.merged(RobotMotion::WRAP));
    Rates {
        mean: Vector2::new(rates.mean[0], rates.mean[1]),
        covariance: rates.covariance.fixed_view::<2, 2>(0, 0).into_owned(),
    }
}

/// Inserts a track in order of team and number; `false` if its number is in use, by either team.
fn insert(tracks: &mut Vec<UnknownTrack>, new: UnknownTrack) -> bool {
    let is_free = tracks.iter().all(|unknown| unknown.track_id != new.track_id);
    if is_free {
        let key = |unknown: &UnknownTrack| (unknown.team, unknown.track_id);
        tracks.insert(tracks.partition_point(|unknown| key(unknown) < key(&new)), new);
    }
    is_free
}

fn predict(
    track: &mut Track<4, UNKNOWN_HYPOTHESES, 2>,
    from_ns: u64,
    to_ns: u64,
    motion: &UnknownMotion,
) {
    if from_ns < to_ns {
        track.imm.mix(&UnknownMotion::TRANSITIONS, UnknownMotion::WRAP);
        let dt_s = (to_ns - from_ns) as f64 * 1e-9;
        for (index, hypothesis) in track.imm.hypotheses.iter_mut().enumerate() {
            motion.predict(&mut hypothesis.belief, index, dt_s);
        }
    }
}
