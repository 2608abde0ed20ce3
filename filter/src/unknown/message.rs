//! Conversion of these tracks to and from the `world` message; see [`message`](crate::message).

use super::{UnknownMotion, UnknownRobots, UnknownTrack, insert};
use crate::gaussian::Gaussian;
use crate::imm::{Hypothesis, Imm};
use crate::message::present;
use crate::track::{Motion, Suspect, Track, TrackRules};
use messages::{
    MAX_UNKNOWN_ROBOTS, Team, UnknownRobotHypothesis, UnknownRobotMemory, UnknownRobotState,
    WorldFrame,
};
use nalgebra::Vector2;

impl UnknownRobots {
    /// Continues from the last output of a predecessor. Parts that cannot be tracks are left out.
    pub fn resume(&mut self, last: &WorldFrame) {
        self.clear();
        self.last_track_id = last.last_track_id;
        let count = (last.unknown_memory_count as usize).min(MAX_UNKNOWN_ROBOTS);
        for memory in &last.unknown_robot_memories[..count] {
            match from_message(memory, last.frame.t_capture_ns, &self.motion) {
                Some(tentative) if tentative.track_id == 0 => self.tentative.push(tentative),
                Some(confirmed) => {
                    insert(&mut self.confirmed, confirmed);
                }
                None => {}
            }
        }
    }

    /// Writes all tracks; confirmed ones predicted to `t_predicted_ns`.
    pub fn write(&self, t_ns: u64, t_predicted_ns: u64, rules: &TrackRules, out: &mut WorldFrame) {
        out.last_track_id = self.last_track_id;
        out.unknown_robot_count = self.confirmed.len() as u32;
        out.unknown_memory_count = (self.confirmed.len() + self.tentative.len()) as u32;
        let ahead_s = t_predicted_ns.saturating_sub(t_ns) as f64 * 1e-9;
        for (slot, unknown) in out.unknown_robots.iter_mut().zip(&self.confirmed) {
            let visibility = unknown.track.visibility(t_ns, rules);
            *slot = state(unknown, ahead_s, visibility, &self.motion);
        }
        let all = self.confirmed.iter().chain(&self.tentative);
        for (slot, unknown) in out.unknown_robot_memories.iter_mut().zip(all) {
            *slot = memory(unknown);
        }
    }
}

/// The part for consumers.
fn state(
    unknown: &UnknownTrack,
    ahead_s: f64,
    visibility: f32,
    motion: &UnknownMotion,
) -> UnknownRobotState {
    let patch = unknown.track.imm.merged(UnknownMotion::WRAP);
    let predicted = motion.advance(&patch.mean, ahead_s);
    let [x_mm, y_mm, vx_mm_s, vy_mm_s] = patch.mean.into();
    UnknownRobotState {
        team: unknown.team as u32,
        track_id: unknown.track_id,
        status: unknown.track.status as u32,
        frames_unseen: unknown.track.frames_unseen,
        frames_tracked: unknown.frames_tracked,
        visibility,
        x_mm,
        y_mm,
        vx_mm_s,
        vy_mm_s,
        covariance: motion.center(patch).covariance_rows(),
        predicted_x_mm: predicted[0],
        predicted_y_mm: predicted[1],
    }
}

/// The part for a successor.
fn memory(unknown: &UnknownTrack) -> UnknownRobotMemory {
    let Track { imm, status, frames_unseen, t_seen_ns, .. } = &unknown.track;
    UnknownRobotMemory {
        team: unknown.team as u32,
        track_id: unknown.track_id,
        status: *status as u32,
        frames_unseen: *frames_unseen,
        frames_tracked: unknown.frames_tracked,
        reserved: 0,
        t_seen_ns: *t_seen_ns,
        hypotheses: imm.hypotheses.map(|hypothesis| UnknownRobotHypothesis {
            probability: hypothesis.probability,
            mean: hypothesis.belief.mean.into(),
            covariance: hypothesis.belief.packed_covariance(),
        }),
    }
}

/// The track that was written as `memory` with a frame captured at `t_ns`; `None` if there is none or it is
/// invalid.
fn from_message(
    memory: &UnknownRobotMemory,
    t_ns: u64,
    motion: &UnknownMotion,
) -> Option<UnknownTrack> {
    let imm = Imm {
        hypotheses: memory.hypotheses.map(|hypothesis| Hypothesis {
            probability: hypothesis.probability,
            belief: Gaussian::from_packed(hypothesis.mean, &hypothesis.covariance),
        }),
    };
    (imm.is_possible(&motion.limits()) && memory.t_seen_ns <= t_ns).then_some(())?;
    Some(UnknownTrack {
        team: Team::from_number(memory.team)?,
        track_id: memory.track_id,
        frames_tracked: memory.frames_tracked,
        track: Track {
            imm,
            status: present(memory.status)?,
            frames_unseen: memory.frames_unseen,
            frames_gated: 0,
            t_seen_ns: memory.t_seen_ns,
            // The association leaves no measurements outside the gate.
            suspect: Suspect { t_ns: 0, measured: Vector2::zeros(), agreeing: 0 },
        },
    })
}
