//! What SSL-Vision sends: robots and balls of one camera's frame, and now and then the geometry.

use crate::ssl_geometry::GeometryData;
use prost::{Enumeration, Message};

/// Multicast group of vision systems in the SSL.
pub const ADDRESS: [u8; 4] = [224, 5, 23, 2];
/// Port of vision systems in the SSL.
pub const PORT: u16 = 10_006;

/// One packet: `SSL_WrapperPacket`.
#[derive(Clone, PartialEq, Message)]
pub struct WrapperPacket {
    /// Robots and balls of one camera's frame.
    #[prost(message, optional, tag = "1")]
    pub detection: Option<DetectionFrame>,
    /// The field and the calibration of the cameras.
    #[prost(message, optional, tag = "2")]
    pub geometry: Option<GeometryData>,
    /// Kind of the program that sends it.
    #[prost(enumeration = "Source", optional, tag = "3")]
    pub source: Option<i32>,
}

/// Kinds of programs that send SSL packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Enumeration)]
#[repr(i32)]
pub enum Source {
    /// Not known.
    Unknown = 0,
    /// None of the others. Touchline is one.
    Other = 1,
    /// The league's own vision.
    SslVision = 2,
    /// The league's own vision, one program per camera.
    VisionProcessor = 3,
    /// The simulator grSim.
    GrSim = 4,
    /// ER-Force's simulator.
    ErForceSim = 5,
}

/// What one camera saw in one frame: `SSL_DetectionFrame`.
#[derive(Clone, PartialEq, Message)]
pub struct DetectionFrame {
    /// Number of the frame. Receivers count gaps as lost frames.
    #[prost(uint32, required, tag = "1")]
    pub frame_number: u32,
    /// Time of capture, seconds since 1970.
    #[prost(double, required, tag = "2")]
    pub t_capture: f64,
    /// Time of sending, seconds since 1970.
    #[prost(double, required, tag = "3")]
    pub t_sent: f64,
    /// Number of the camera.
    #[prost(uint32, required, tag = "4")]
    pub camera_id: u32,
    /// Balls.
    #[prost(message, repeated, tag = "5")]
    pub balls: Vec<DetectionBall>,
    /// Robots of the yellow team.
    #[prost(message, repeated, tag = "6")]
    pub robots_yellow: Vec<DetectionRobot>,
    /// Robots of the blue team.
    #[prost(message, repeated, tag = "7")]
    pub robots_blue: Vec<DetectionRobot>,
    /// Time of capture on the camera's own clock, seconds.
    #[prost(double, optional, tag = "8")]
    pub t_capture_camera: Option<f64>,
}

/// A ball: `SSL_DetectionBall`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct DetectionBall {
    /// 0–1.
    #[prost(float, required, tag = "1")]
    pub confidence: f32,
    /// Pixels.
    #[prost(uint32, optional, tag = "2")]
    pub area: Option<u32>,
    /// mm.
    #[prost(float, required, tag = "3")]
    pub x: f32,
    /// mm.
    #[prost(float, required, tag = "4")]
    pub y: f32,
    /// Height above the floor, mm.
    #[prost(float, optional, tag = "5")]
    pub z: Option<f32>,
    /// Column in the picture.
    #[prost(float, required, tag = "6")]
    pub pixel_x: f32,
    /// Row in the picture.
    #[prost(float, required, tag = "7")]
    pub pixel_y: f32,
}

/// A robot: `SSL_DetectionRobot`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct DetectionRobot {
    /// 0–1.
    #[prost(float, required, tag = "1")]
    pub confidence: f32,
    /// Number in its team. Some receivers crash on a robot without one.
    #[prost(uint32, optional, tag = "2")]
    pub robot_id: Option<u32>,
    /// mm.
    #[prost(float, required, tag = "3")]
    pub x: f32,
    /// mm.
    #[prost(float, required, tag = "4")]
    pub y: f32,
    /// rad.
    #[prost(float, optional, tag = "5")]
    pub orientation: Option<f32>,
    /// Column in the picture.
    #[prost(float, required, tag = "6")]
    pub pixel_x: f32,
    /// Row in the picture.
    #[prost(float, required, tag = "7")]
    pub pixel_y: f32,
    /// Height of its top above the floor, mm.
    #[prost(float, optional, tag = "8")]
    pub height: Option<f32>,
}
