//! What trackers of the SSL send: filtered positions and velocities. Metres, m/s, rad.

use prost::{Enumeration, Message};

/// Multicast group of trackers in the SSL.
pub const ADDRESS: [u8; 4] = [224, 5, 23, 2];
/// Port of trackers in the SSL.
pub const PORT: u16 = 10_010;

/// One packet: `TrackerWrapperPacket`.
#[derive(Clone, PartialEq, Message)]
pub struct TrackerPacket {
    /// Identifies the sender; constant while it runs.
    #[prost(string, required, tag = "1")]
    pub uuid: String,
    /// Name of the sender. Some receivers crash without it.
    #[prost(string, optional, tag = "2")]
    pub source_name: Option<String>,
    /// The frame.
    #[prost(message, optional, tag = "3")]
    pub tracked_frame: Option<TrackedFrame>,
}

/// The field at one time: `TrackedFrame`.
#[derive(Clone, PartialEq, Message)]
pub struct TrackedFrame {
    /// Number of the frame.
    #[prost(uint32, required, tag = "1")]
    pub frame_number: u32,
    /// Time of the positions, seconds since 1970.
    #[prost(double, required, tag = "2")]
    pub timestamp: f64,
    /// Balls, the most important first.
    #[prost(message, repeated, tag = "3")]
    pub balls: Vec<TrackedBall>,
    /// Robots of both teams.
    #[prost(message, repeated, tag = "4")]
    pub robots: Vec<TrackedRobot>,
    /// The ball, if it was kicked.
    #[prost(message, optional, tag = "5")]
    pub kicked_ball: Option<KickedBall>,
    /// What the tracker can do.
    #[prost(enumeration = "Capability", repeated, packed = "false", tag = "6")]
    pub capabilities: Vec<i32>,
}

/// What a tracker can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Enumeration)]
#[repr(i32)]
pub enum Capability {
    /// Not known.
    Unknown = 0,
    /// It follows a ball in the air.
    FlyingBalls = 1,
    /// It follows several balls.
    MultipleBalls = 2,
    /// It tells of kicks.
    KickedBalls = 3,
}

/// A vector on the floor.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Vector2 {
    /// Along the field.
    #[prost(float, required, tag = "1")]
    pub x: f32,
    /// Across the field.
    #[prost(float, required, tag = "2")]
    pub y: f32,
}

/// A vector in space.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Vector3 {
    /// Along the field.
    #[prost(float, required, tag = "1")]
    pub x: f32,
    /// Across the field.
    #[prost(float, required, tag = "2")]
    pub y: f32,
    /// Up.
    #[prost(float, required, tag = "3")]
    pub z: f32,
}

/// The ball: `TrackedBall`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct TrackedBall {
    /// m.
    #[prost(message, required, tag = "1")]
    pub pos: Vector3,
    /// m/s.
    #[prost(message, optional, tag = "2")]
    pub vel: Option<Vector3>,
    /// 0–1: 1 when seen.
    #[prost(float, optional, tag = "3")]
    pub visibility: Option<f32>,
}

/// A robot: `TrackedRobot`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct TrackedRobot {
    /// Which robot.
    #[prost(message, required, tag = "1")]
    pub robot_id: RobotId,
    /// m.
    #[prost(message, required, tag = "2")]
    pub pos: Vector2,
    /// rad.
    #[prost(float, required, tag = "3")]
    pub orientation: f32,
    /// m/s.
    #[prost(message, optional, tag = "4")]
    pub vel: Option<Vector2>,
    /// rad/s.
    #[prost(float, optional, tag = "5")]
    pub vel_angular: Option<f32>,
    /// 0–1: 1 when seen.
    #[prost(float, optional, tag = "6")]
    pub visibility: Option<f32>,
}

/// A kicked ball: `KickedBall`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct KickedBall {
    /// Where it was kicked, m.
    #[prost(message, required, tag = "1")]
    pub pos: Vector2,
    /// Its velocity after the kick, m/s.
    #[prost(message, required, tag = "2")]
    pub vel: Vector3,
    /// Time of the kick, seconds since 1970.
    #[prost(double, required, tag = "3")]
    pub start_timestamp: f64,
    /// Time at which it will stop, seconds since 1970.
    #[prost(double, optional, tag = "4")]
    pub stop_timestamp: Option<f64>,
    /// Where it will stop, m.
    #[prost(message, optional, tag = "5")]
    pub stop_pos: Option<Vector2>,
    /// The robot that kicked it.
    #[prost(message, optional, tag = "6")]
    pub robot_id: Option<RobotId>,
}

/// A robot's number and team: `RobotId`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct RobotId {
    /// Number in its team.
    #[prost(uint32, optional, tag = "1")]
    pub id: Option<u32>,
    /// Its team.
    #[prost(enumeration = "Team", optional, tag = "2")]
    pub team: Option<i32>,
}

/// Teams in tracked frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Enumeration)]
#[repr(i32)]
pub enum Team {
    /// Not known.
    Unknown = 0,
    /// Wears yellow.
    Yellow = 1,
    /// Wears blue.
    Blue = 2,
}
