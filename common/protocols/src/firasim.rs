//! What FIRASim, the simulator of the IEEE VSSS, sends to teams, and the commands that teams send to it.
//! Metres, m/s, rad.

use prost::Message;

/// Multicast group of the simulator.
pub const ADDRESS: [u8; 4] = [224, 0, 0, 1];
/// Port of the simulator.
pub const PORT: u16 = 10_002;
/// Port at which the simulator receives commands.
pub const COMMANDS_PORT: u16 = 20_011;

/// The state of the match: `Environment`.
#[derive(Clone, PartialEq, Message)]
pub struct Environment {
    /// Number of the frame.
    #[prost(uint32, tag = "1")]
    pub step: u32,
    /// Robots and ball.
    #[prost(message, optional, tag = "2")]
    pub frame: Option<Frame>,
    /// The field.
    #[prost(message, optional, tag = "3")]
    pub field: Option<Field>,
    /// Goals of the blue team.
    #[prost(uint32, tag = "4")]
    pub goals_blue: u32,
    /// Goals of the yellow team.
    #[prost(uint32, tag = "5")]
    pub goals_yellow: u32,
}

/// Robots and ball: `Frame`.
#[derive(Clone, PartialEq, Message)]
pub struct Frame {
    /// The ball.
    #[prost(message, optional, tag = "1")]
    pub ball: Option<Ball>,
    /// Robots of the yellow team.
    #[prost(message, repeated, tag = "2")]
    pub robots_yellow: Vec<Robot>,
    /// Robots of the blue team.
    #[prost(message, repeated, tag = "3")]
    pub robots_blue: Vec<Robot>,
}

/// The ball: `Ball`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Ball {
    /// m.
    #[prost(double, tag = "1")]
    pub x: f64,
    /// m.
    #[prost(double, tag = "2")]
    pub y: f64,
    /// Height of its centre, m.
    #[prost(double, tag = "3")]
    pub z: f64,
    /// m/s.
    #[prost(double, tag = "4")]
    pub vx: f64,
    /// m/s.
    #[prost(double, tag = "5")]
    pub vy: f64,
    /// m/s.
    #[prost(double, tag = "6")]
    pub vz: f64,
}

/// A robot: `Robot`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Robot {
    /// Number in its team.
    #[prost(uint32, tag = "1")]
    pub robot_id: u32,
    /// m.
    #[prost(double, tag = "2")]
    pub x: f64,
    /// m.
    #[prost(double, tag = "3")]
    pub y: f64,
    /// rad.
    #[prost(double, tag = "4")]
    pub orientation: f64,
    /// m/s.
    #[prost(double, tag = "5")]
    pub vx: f64,
    /// m/s.
    #[prost(double, tag = "6")]
    pub vy: f64,
    /// rad/s.
    #[prost(double, tag = "7")]
    pub vorientation: f64,
}

/// The field: `Field`. m.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Field {
    /// Between the side walls.
    #[prost(double, tag = "1")]
    pub width: f64,
    /// Between the goal lines.
    #[prost(double, tag = "2")]
    pub length: f64,
    /// Between the posts.
    #[prost(double, tag = "3")]
    pub goal_width: f64,
    /// Behind the goal line.
    #[prost(double, tag = "4")]
    pub goal_depth: f64,
    /// Radius of the centre circle.
    #[prost(double, tag = "5")]
    pub center_radius: f64,
    /// Along the goal line.
    #[prost(double, tag = "6")]
    pub penalty_width: f64,
    /// From the goal line into the field.
    #[prost(double, tag = "7")]
    pub penalty_depth: f64,
    /// From the goal line to the penalty mark.
    #[prost(double, tag = "8")]
    pub penalty_point: f64,
}

/// What teams send: `Packet`.
#[derive(Clone, PartialEq, Message)]
pub struct Packet {
    /// Commands.
    #[prost(message, optional, tag = "1")]
    pub cmd: Option<Commands>,
    /// Places to which ball and robots are to be moved.
    #[prost(message, optional, tag = "2")]
    pub replace: Option<Replacement>,
}

/// Commands: `Commands`.
#[derive(Clone, PartialEq, Message)]
pub struct Commands {
    /// One per robot.
    #[prost(message, repeated, tag = "1")]
    pub robot_commands: Vec<Command>,
}

/// One robot's command: `Command`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Command {
    /// Number in its team.
    #[prost(uint32, tag = "1")]
    pub id: u32,
    /// Whether its team is the yellow one.
    #[prost(bool, tag = "2")]
    pub yellowteam: bool,
    /// Angular speed of the left wheel, rad/s.
    #[prost(double, tag = "6")]
    pub wheel_left: f64,
    /// Angular speed of the right wheel, rad/s.
    #[prost(double, tag = "7")]
    pub wheel_right: f64,
}

/// Places to which ball and robots are to be moved: `Replacement`.
#[derive(Clone, PartialEq, Message)]
pub struct Replacement {
    /// The ball.
    #[prost(message, optional, tag = "1")]
    pub ball: Option<BallReplacement>,
    /// Robots.
    #[prost(message, repeated, tag = "2")]
    pub robots: Vec<RobotReplacement>,
}

/// The ball's place: `BallReplacement`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct BallReplacement {
    /// m.
    #[prost(double, tag = "1")]
    pub x: f64,
    /// m.
    #[prost(double, tag = "2")]
    pub y: f64,
    /// m/s.
    #[prost(double, tag = "3")]
    pub vx: f64,
    /// m/s.
    #[prost(double, tag = "4")]
    pub vy: f64,
}

/// A robot's place: `RobotReplacement`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct RobotReplacement {
    /// Its number and place.
    #[prost(message, optional, tag = "1")]
    pub position: Option<Robot>,
    /// Whether its team is the yellow one.
    #[prost(bool, tag = "5")]
    pub yellowteam: bool,
    /// Whether it is switched on.
    #[prost(bool, tag = "6")]
    pub turnon: bool,
}
