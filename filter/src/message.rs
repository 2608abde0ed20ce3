//! Conversion of tracks to and from the `world` message.
//!
//! A track has no other state: after writing and reading it is equal bit for bit, so a filter that resumes
//! continues as if it had not been replaced. Messages that are read may be invalid; impossible tracks are
//! refused.

use crate::ball::BallMotion;
use crate::commands::CommandQueue;
use crate::gaussian::Gaussian;
use crate::imm::{Hypothesis, Imm};
use crate::robot::RobotMotion;
use crate::track::{Motion, Suspect, Track};
use bytemuck::Zeroable;
use messages::{
    BALL_HYPOTHESES, BallHypothesis, BallMemory, BallState, QueuedCommand, ROBOT_HYPOTHESES,
    RobotHypothesis, RobotMemory, RobotState, Team, TrackStatus, are_possible_speeds,
};
use nalgebra::{Vector4, Vector5};

/// The ball's track.
pub type BallTrack = Track<4, BALL_HYPOTHESES, 2>;

/// A robot's track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotTrack {
    /// Its team.
    pub team: Team,
    /// Its number in the team.
    pub robot_id: u32,
    /// Its pose and motion.
    pub track: Track<5, ROBOT_HYPOTHESES, 3>,
    /// Its commands.
    pub commands: CommandQueue,
}

impl RobotTrack {
    /// The part for consumers. `predicted` is the state at the time to which poses are predicted.
    pub fn state(&self, predicted: &Vector5<f64>, visibility: f32) -> RobotState {
        let merged = self.track.imm.merged(RobotMotion::WRAP);
        let [x_mm, y_mm, orientation, v_mm_s, omega] = merged.mean.into();
        RobotState {
            team: self.team as u32,
            robot_id: self.robot_id,
            status: self.track.status as u32,
            frames_unseen: self.track.frames_unseen,
            frames_gated: self.track.frames_gated,
            visibility,
            x_mm,
            y_mm,
            orientation,
            v_mm_s,
            omega,
            vx_mm_s: v_mm_s * orientation.cos(),
            vy_mm_s: v_mm_s * orientation.sin(),
            covariance: merged.covariance_rows(),
            predicted_x_mm: predicted[0],
            predicted_y_mm: predicted[1],
            predicted_orientation: predicted[2],
        }
    }

    /// The part for a successor.
    pub fn memory(&self) -> RobotMemory {
        let Track { imm, t_seen_ns, suspect, .. } = &self.track;
        RobotMemory {
            hypotheses: std::array::from_fn(|index| {
                // In place: `map` would move all of them first.
                let Hypothesis { probability, belief } = &imm.hypotheses[index];
                RobotHypothesis {
                    probability: *probability,
                    mean: belief.mean.into(),
                    covariance: belief.packed_covariance(),
                }
            }),
            t_seen_ns: *t_seen_ns,
            t_gated_ns: suspect.t_ns,
            gated_pose: suspect.measured.into(),
            gated_agreeing: suspect.agreeing,
            command_count: self.commands.entries().len() as u32,
            commands: self.commands.array(),
        }
    }

    /// The track that was written as `state` and `memory` with a frame captured at `t_ns`; `None` if there is
    /// none or it is invalid.
    pub fn from_message(
        state: &RobotState,
        memory: &RobotMemory,
        t_ns: u64,
        motion: &RobotMotion,
    ) -> Option<Self> {
        let imm = Imm {
            hypotheses: memory.hypotheses.map(|hypothesis| Hypothesis {
                probability: hypothesis.probability,
                belief: Gaussian::from_packed(hypothesis.mean, &hypothesis.covariance),
            }),
        };
        let commands = memory.commands.get(..memory.command_count as usize)?;
        let possible = |c: &QueuedCommand| are_possible_speeds(c.left_mm_s, c.right_mm_s);
        (imm.is_possible(&motion.limits())
            && memory.t_seen_ns <= t_ns
            && memory.gated_pose.iter().all(|value| value.is_finite())
            && commands.iter().all(possible))
        .then_some(())?;
        Some(Self {
            team: Team::from_number(state.team)?,
            robot_id: state.robot_id,
            track: Track {
                imm,
                status: present(state.status)?,
                frames_unseen: state.frames_unseen,
                frames_gated: state.frames_gated,
                t_seen_ns: memory.t_seen_ns,
                suspect: Suspect {
                    t_ns: memory.t_gated_ns,
                    measured: memory.gated_pose.into(),
                    agreeing: memory.gated_agreeing,
                },
            },
            commands: CommandQueue::from_message(commands),
        })
    }
}

/// The ball's part for consumers.
pub fn ball_state(
    track: Option<&BallTrack>,
    predicted: &Vector4<f64>,
    visibility: f32,
) -> BallState {
    let Some(track) = track else { return BallState::zeroed() };
    let merged = track.imm.merged(BallMotion::WRAP);
    let [x_mm, y_mm, vx_mm_s, vy_mm_s] = merged.mean.into();
    BallState {
        status: track.status as u32,
        frames_unseen: track.frames_unseen,
        frames_gated: track.frames_gated,
        visibility,
        x_mm,
        y_mm,
        vx_mm_s,
        vy_mm_s,
        covariance: merged.covariance_rows(),
        predicted_x_mm: predicted[0],
        predicted_y_mm: predicted[1],
    }
}

/// The ball's part for a successor.
pub fn ball_memory(track: Option<&BallTrack>) -> BallMemory {
    let Some(track) = track else { return BallMemory::zeroed() };
    BallMemory {
        hypotheses: track.imm.hypotheses.map(|hypothesis| BallHypothesis {
            probability: hypothesis.probability,
            mean: hypothesis.belief.mean.into(),
            covariance: hypothesis.belief.packed_covariance(),
        }),
        t_seen_ns: track.t_seen_ns,
        t_gated_ns: track.suspect.t_ns,
        gated_position: track.suspect.measured.into(),
        gated_agreeing: track.suspect.agreeing,
        reserved: 0,
    }
}

/// The track that was written as `state` and `memory` with a frame captured at `t_ns`; `None` if there is
/// none or it is invalid.
pub fn ball_from_message(
    state: &BallState,
    memory: &BallMemory,
    t_ns: u64,
    motion: &BallMotion,
) -> Option<BallTrack> {
    let imm = Imm {
        hypotheses: memory.hypotheses.map(|hypothesis| Hypothesis {
            probability: hypothesis.probability,
            belief: Gaussian::from_packed(hypothesis.mean, &hypothesis.covariance),
        }),
    };
    (imm.is_possible(&motion.limits())
        && memory.t_seen_ns <= t_ns
        && memory.gated_position.iter().all(|value| value.is_finite()))
    .then_some(())?;
    Some(Track {
        imm,
        status: present(state.status)?,
        frames_unseen: state.frames_unseen,
        frames_gated: state.frames_gated,
        t_seen_ns: memory.t_seen_ns,
        suspect: Suspect {
            t_ns: memory.t_gated_ns,
            measured: memory.gated_position.into(),
            agreeing: memory.gated_agreeing,
        },
    })
}

/// The status with this number; `None` if it means that there is no track.
pub fn present(number: u32) -> Option<TrackStatus> {
    TrackStatus::from_number(number).filter(|&status| status != TrackStatus::Absent)
}
