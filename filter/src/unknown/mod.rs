//! Robots of which only the team is known, followed without names.
//!
//! A team often does not know which patches its opponents wear. The tracker gives such robots a place
//! in each frame; here those places become tracks, with a velocity and a number that stays.
//!
//! # One robot, one track
//!
//! A robot that is known by name must never have a nameless twin.
//!
//! * A detection without a name may be a named robot whose identification patch is hidden. So named
//!   robots that were not recognised in this frame take part in the association, with the heading that
//!   is believed of them, on equal terms. What is theirs founds no track. If nothing else could be
//!   meant, it also corrects the robot's place ([`place`]): commands or no commands,
//!   prediction alone is off by centimetres after a tenth of a second. It does not confirm the name.
//!   A robot that is not recognised for `filter.forget_after_ms` loses it and is followed without.
//! * Where a robot has just been seen by name nobody else of its team can be. A nameless track that
//!   leads there and was not seen was that robot, and ends.
//!
//! # The life of a track
//!
//! What belongs to no track is noted. Seen in [`FRAMES_TO_TRUST`] frames in a row, it becomes a track,
//! gets the next number, and goes out with `world`. Unseen for `filter.forget_after_ms`, it ends.

mod assignment;
mod association;
mod message;
pub mod motion;

use crate::message::RobotTrack;
use crate::place;
use crate::robot::RobotMotion;
use crate::rolling::Rates;
use crate::track::{Candidate, Motion, Track, TrackRules};
use association::Association;
use common::config::Config;
use common::messages::{MAX_UNKNOWN_ROBOTS, Team, TrackStatus, UNKNOWN_HYPOTHESES};
use motion::UnknownMotion;
use nalgebra::{Matrix2, Vector2};

/// Before a track is shown to anybody it must have been seen in so many frames in a row.
pub const FRAMES_TO_TRUST: u32 = 3;

/// One that is followed.
#[derive(Debug, Clone, Copy, PartialEq)]
struct UnknownTrack {
    team: Team,
    /// 0 while it is not trusted.
    track_id: u32,
    /// Since it was first seen, that frame included.
    frames_tracked: u32,
    /// Of the team patch.
    track: Track<4, UNKNOWN_HYPOTHESES, 2>,
}

/// A detection without a name.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SeenPatch {
    /// Of which team.
    pub team: Team,
    /// Seconds after the frame's time at which its row was captured.
    pub delay_s: f64,
    /// Where the patch is.
    pub candidate: Candidate<2>,
}

/// Follows them from frame to frame. All of its state goes out with every [`WorldFrame`] and comes back
/// through [`resume`](Self::resume).
#[derive(Debug)]
pub(crate) struct UnknownRobots {
    motion: UnknownMotion,
    half_size_mm: f64,
    /// By team and number.
    trusted: Vec<UnknownTrack>,
    /// By first sight.
    noted: Vec<UnknownTrack>,
    last_track_id: u32,
    seen: Vec<SeenPatch>,
    association: Association,
}

impl UnknownRobots {
    /// As configured; nobody has been seen.
    pub fn new(config: &Config) -> Self {
        Self {
            motion: UnknownMotion::new(config),
            half_size_mm: config.robots.size_mm / 2.0,
            trusted: Vec::with_capacity(MAX_UNKNOWN_ROBOTS),
            noted: Vec::with_capacity(MAX_UNKNOWN_ROBOTS),
            last_track_id: 0,
            seen: Vec::with_capacity(MAX_UNKNOWN_ROBOTS),
            association: Association::default(),
        }
    }

    /// Loses sight of everybody. Numbers go on.
    pub fn clear(&mut self) {
        self.trusted.clear();
        self.noted.clear();
    }

    /// Variance of each coordinate of a robot's centre as seen from its team patch.
    pub fn center_variance(&self) -> f64 {
        self.motion.center_variance()
    }

    /// Covariance of a patch's place in a detection that does not say how uncertain it is.
    pub fn noise(&self) -> &Matrix2<f64> {
        self.motion.noise()
    }

    /// Takes in the detections without a name of the frame captured at `t_ns`, `from_ns` being the frame
    /// before. `robots` are those with a name, which have already been moved on to this frame and
    /// corrected by it.
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
        if self.seen.is_empty() && self.trusted.is_empty() && self.noted.is_empty() {
            return;
        }
        let Self { motion, trusted, noted, .. } = self;
        for unknown in trusted.iter_mut().chain(noted) {
            predict(&mut unknown.track, from_ns, t_ns, motion);
        }
        self.associate(robots, robot_motion, rules);
        self.locate_robots(robots, robot_motion);
        self.observe(robots.len(), t_ns, rules);
        self.end_twins(robots);
        self.note_new(t_ns);
        self.trust_those_seen_often();
    }

    /// Gives detections to tracks: named robots that were not recognised first, by their indices, then
    /// those trusted, then those noted.
    fn associate(&mut self, robots: &[RobotTrack], robot_motion: &RobotMotion, rules: &TrackRules) {
        let Self { association, motion, trusted, noted, seen, .. } = self;
        association.start(seen.len());
        let of_team =
            |team: Team| seen.iter().enumerate().filter(move |(_, patch)| patch.team == team);
        let is_missing = |robot: &RobotTrack| robot.track.status == TrackStatus::Coasting;
        for (index, robot) in robots.iter().enumerate().filter(|(_, robot)| is_missing(robot)) {
            let rates = place_rates(robot, robot_motion);
            let density = |(index, patch): (usize, &SeenPatch)| {
                let candidate = patch.at_frame(&rates);
                let patch_mm = motion.patch_mm();
                let density = place::density(&robot.track, patch_mm, &candidate, rules.gate_chi2);
                Some((index, density?))
            };
            association.add(index, of_team(robot.team).filter_map(density));
        }
        for (index, unknown) in trusted.iter().chain(noted.iter()).enumerate() {
            let rates = motion.rates(&unknown.track.blend.merged(UnknownMotion::WRAP));
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
            if let Some(seen) = self.association.seen_as(index)
                && self.association.is_only_one(index, seen)
            {
                let candidate = self.seen[seen].at_frame(&place_rates(robot, robot_motion));
                place::correct(&mut robot.track, self.motion.patch_mm(), &candidate);
            }
        }
    }

    /// Corrects all tracks by what belongs to them, and ends those that nobody can be any more.
    fn observe(&mut self, first: usize, t_ns: u64, rules: &TrackRules) {
        let Self { association, motion, trusted, noted, seen, .. } = self;
        let mut index = first;
        let mut observe = |unknown: &mut UnknownTrack| {
            let track = &mut unknown.track;
            let rates = motion.rates(&track.blend.merged(UnknownMotion::WRAP));
            let own = association.seen_as(index).map(|seen_as| seen[seen_as].at_frame(&rates));
            track.observe(own.into_iter(), &[1.0; UNKNOWN_HYPOTHESES], t_ns, motion, rules);
            unknown.frames_tracked = unknown.frames_tracked.saturating_add(1);
            index += 1;
            track.blend.is_possible(&motion.limits()) && !track.is_forgotten(t_ns, rules)
        };
        trusted.retain_mut(&mut observe);
        noted.retain_mut(|unknown| observe(unknown) && unknown.track.frames_unseen == 0);
    }

    /// Ends tracks that have turned out to be of a robot with a name.
    fn end_twins(&mut self, robots: &[RobotTrack]) {
        let half_size_mm = self.half_size_mm;
        let is_seen = |robot: &&RobotTrack| {
            matches!(
                robot.track.status,
                TrackStatus::Measured | TrackStatus::Initialised | TrackStatus::Located
            )
        };
        self.trusted.retain(|unknown| {
            let [x_mm, y_mm] = place_of(unknown);
            let is_there = |robot: &RobotTrack| {
                let center = robot.track.blend.merged(RobotMotion::WRAP).mean;
                robot.team == unknown.team
                    && (center[0] - x_mm).hypot(center[1] - y_mm) < half_size_mm
            };
            unknown.track.frames_unseen == 0 || !robots.iter().filter(is_seen).any(is_there)
        });
    }

    /// Notes what belongs to nobody.
    fn note_new(&mut self, t_ns: u64) {
        for (index, patch) in self.seen.iter().enumerate() {
            if !self.association.is_owned(index)
                && self.trusted.len() + self.noted.len() < MAX_UNKNOWN_ROBOTS
            {
                self.noted.push(UnknownTrack {
                    team: patch.team,
                    track_id: 0,
                    frames_tracked: 1,
                    track: Track::start(&patch.candidate.measured, t_ns, &self.motion),
                });
            }
        }
    }

    fn trust_those_seen_often(&mut self) {
        let Self { trusted, noted, last_track_id, .. } = self;
        noted.retain_mut(|unknown| {
            if unknown.frames_tracked < FRAMES_TO_TRUST {
                return true;
            }
            // After the last number there is they start anew, and some may still be somebody's.
            loop {
                *last_track_id = last_track_id.wrapping_add(1).max(1);
                unknown.track_id = *last_track_id;
                if insert(trusted, *unknown) {
                    return false;
                }
            }
        });
    }
}

impl SeenPatch {
    /// As it would have been measured at the frame's time, by something that moves so.
    fn at_frame(&self, rates: &Rates<2>) -> Candidate<2> {
        rates.take_off(self.delay_s, self.candidate, UnknownMotion::WRAP_MEASURED)
    }
}

fn place_of(unknown: &UnknownTrack) -> [f64; 2] {
    let mean = unknown.track.blend.merged(UnknownMotion::WRAP).mean;
    [mean[0], mean[1]]
}

/// How fast a named robot's place changes.
fn place_rates(robot: &RobotTrack, motion: &RobotMotion) -> Rates<2> {
    let rates = motion.rates(&robot.track.blend.merged(RobotMotion::WRAP));
    Rates {
        mean: Vector2::new(rates.mean[0], rates.mean[1]),
        covariance: rates.covariance.fixed_view::<2, 2>(0, 0).into_owned(),
    }
}

/// Puts a track where it belongs, by team and number; `false` if its number is another's, of either team.
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
        track.blend.mix(&UnknownMotion::ODDS, UnknownMotion::WRAP);
        let dt_s = (to_ns - from_ns) as f64 * 1e-9;
        for (index, hypothesis) in track.blend.hypotheses.iter_mut().enumerate() {
            motion.predict(&mut hypothesis.belief, index, dt_s);
        }
    }
}
