//! The filter: from the detections of one frame to filtered and predicted poses (section 6.2 of the paper).
//!
//! * Consumes: `detections`, `commands`; at its start also the last `world` of its predecessor.
//! * Produces: one `world` for each frame of detections.
//! * Guarantees: no input makes it fail. Time is taken from the frames' capture stamps. The same inputs in
//!   the same order give the same output, bit for bit, whether or not the filter was replaced in between
//!   ([`Filter::resume`]), since its whole state is in the `world` it sends. A step allocates no memory.
//!
//! # From equations to code
//!
//! | paper | here |
//! |---|---|
//! | differential drive, eq. (7) | [`robot::Drive::Steered`]: v = (v_R + v_L)/2, ω = (v_R − v_L)/b |
//! | measurement z, eqs. (8), (9) | [`track::Candidate`]; R is [`track::Candidate::noise`] |
//! | state x̂ and P, eq. (10) | [`gaussian::Gaussian`] |
//! | x̂⁻ = f(x̂, u), eq. (11) | [`robot::RobotMotion::advance`] |
//! | P⁻ = A P Aᵀ + Q, eq. (12) | [`robot::RobotMotion::predict`] |
//! | A = ∂f/∂x, eq. (13) | [`robot::RobotMotion::jacobian`] |
//! | K, x̂, P, eq. (14) | [`gaussian::Gaussian::correct`] |
//! | x̂(0), P(0) | [`track::Motion::initial`] |
//! | outliers "simply ignored" | the gate in [`track::Track::observe`] |
//! | collisions: "initialise the filter" | the struck hypothesis, and starting over after a jump |
//! | prediction over the delay | [`commands::CommandQueue::segments`] up to `t_predicted_ns` |
//!
//! # Beyond the paper
//!
//! A robot's commands may be unknown, late, or not obeyed, and robots stand, drive and collide. So each robot
//! has three filters, one per hypothesis: it obeys its command (or stands, without one), it drives freely, it
//! was struck. They are the same extended Kalman filter ([`robot`]) with different inputs and noises,
//! combined by the interacting-multiple-model scheme ([`imm`]). The ball ([`ball`]) has two hypotheses:
//! rolling and struck.
//!
//! Robots of which only the team is known are tracked without heading, by the position of their team patch
//! ([`unknown`]).
//!
//! # Track states
//!
//! | in this frame | status | what happens |
//! |---|---|---|
//! | seen for the first time, with `filter.start_confidence` | `Initialised` | starts at the measurement, speed unknown |
//! | seen within the gate | `Measured` | predicted and corrected |
//! | seen outside the gate | `Gated` | predicted only |
//! | … for the `filter.reinit_after`th time in a row, in places that one robot can reach | `Initialised` | starts over from the measurement |
//! | not recognised, but one of its team is seen there | `Located` | predicted, and corrected in place; `visibility` falls |
//! | not seen | `Coasting` | predicted only; `visibility` falls |
//! | not used for `filter.forget_after_ms` | – | forgotten |
//! | frame more than a second after the last, or before it | `Initialised` | everything starts over |
//! | frame of the same instant as the last | `Measured` | corrected once more, not predicted |

// A process outlives the reader of its output: see `runtime::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

pub mod ball;
pub mod commands;
pub mod constant_velocity;
pub mod gaussian;
pub mod imm;
pub mod intake;
mod message;
pub mod process;
pub mod robot;
pub mod rolling;
pub mod stage;
pub mod team_patch;
pub mod track;
pub mod unknown;

pub use stage::{Filter, FilterError};
