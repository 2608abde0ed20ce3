//! Wheel speeds that strategies send to the robots: the input u of the extended Kalman filter.

use super::filled;
use super::json;
use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use serde::Serialize;

/// Most robots one message commands.
pub const MAX_COMMANDS: usize = 32;

/// Reference speeds of one robot's wheels (v_L,ref and v_R,ref of eq. 11).
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/WheelCommand/1")]
#[repr(C)]
pub struct WheelCommand {
    /// A [`Team`](super::Team) number.
    #[serde(serialize_with = "json::team")]
    pub team: u32,
    /// Number of the robot in its team.
    pub robot_id: u32,
    /// Circumferential speed of the left wheel.
    pub left_mm_s: f64,
    /// Circumferential speed of the right wheel.
    pub right_mm_s: f64,
}

/// Highest possible speed of a wheel, mm/s.
const MAX_WHEEL_MM_S: f64 = 20_000.0;

/// Whether wheels can turn at these speeds; NaN is no speed.
pub fn are_possible_speeds(left_mm_s: f64, right_mm_s: f64) -> bool {
    // NaN compares as false.
    left_mm_s.abs() <= MAX_WHEEL_MM_S && right_mm_s.abs() <= MAX_WHEEL_MM_S
}

/// The speeds a strategy has just sent. If several senders command a robot, the command sent last
/// (`t_sent_ns`) acts, whatever its sender. A robot that is not listed keeps its last command until the
/// filter forgets it (`filter.command_timeout_ms`).
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/Commands/2")]
#[repr(C)]
pub struct Commands {
    /// Sequence number of the sender.
    pub seq: u64,
    /// When the commands went out to the robots.
    pub t_sent_ns: u64,
    /// Valid elements of `wheels`.
    pub wheel_count: u32,
    /// User id of the sender, filled in by the gateway; 0 from programs that publish themselves.
    pub user: u32,
    /// One element per robot.
    pub wheels: [WheelCommand; MAX_COMMANDS],
}

const _: () = assert!(size_of::<Commands>() == 24 + MAX_COMMANDS * 24);

impl Commands {
    /// The valid commands.
    pub fn wheels(&self) -> &[WheelCommand] {
        filled(&self.wheels, self.wheel_count)
    }
}
