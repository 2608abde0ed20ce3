//! The geometry of an SSL field and of the cameras above it. Lengths in mm.

use prost::{Enumeration, Message};

/// The field and its cameras: `SSL_GeometryData`.
#[derive(Clone, PartialEq, Message)]
pub struct GeometryData {
    /// The field.
    #[prost(message, required, tag = "1")]
    pub field: FieldSize,
    /// The cameras.
    #[prost(message, repeated, tag = "2")]
    pub calib: Vec<CameraCalibration>,
}

/// The field: `SSL_GeometryFieldSize`.
#[derive(Clone, PartialEq, Message)]
pub struct FieldSize {
    /// Between the goal lines.
    #[prost(int32, required, tag = "1")]
    pub field_length: i32,
    /// Between the touch lines.
    #[prost(int32, required, tag = "2")]
    pub field_width: i32,
    /// Between the posts.
    #[prost(int32, required, tag = "3")]
    pub goal_width: i32,
    /// Behind the goal line.
    #[prost(int32, required, tag = "4")]
    pub goal_depth: i32,
    /// Between the touch line and the edge of the carpet.
    #[prost(int32, required, tag = "5")]
    pub boundary_width: i32,
    /// Lines.
    #[prost(message, repeated, tag = "6")]
    pub field_lines: Vec<LineSegment>,
    /// Arcs.
    #[prost(message, repeated, tag = "7")]
    pub field_arcs: Vec<CircularArc>,
    /// From the goal line into the field.
    #[prost(int32, optional, tag = "8")]
    pub penalty_area_depth: Option<i32>,
    /// Along the goal line.
    #[prost(int32, optional, tag = "9")]
    pub penalty_area_width: Option<i32>,
    /// Radius of the centre circle.
    #[prost(int32, optional, tag = "10")]
    pub center_circle_radius: Option<i32>,
    /// Width of the lines.
    #[prost(int32, optional, tag = "11")]
    pub line_thickness: Option<i32>,
    /// From the goal's centre to the penalty mark.
    #[prost(int32, optional, tag = "12")]
    pub goal_center_to_penalty_mark: Option<i32>,
    /// Height of the goals.
    #[prost(int32, optional, tag = "13")]
    pub goal_height: Option<i32>,
    /// Radius of the ball.
    #[prost(float, optional, tag = "14")]
    pub ball_radius: Option<f32>,
    /// Largest radius of a robot.
    #[prost(float, optional, tag = "15")]
    pub max_robot_radius: Option<f32>,
    /// Between the goal line and the edge of the carpet.
    #[prost(int32, optional, tag = "16")]
    pub boundary_width_goal_line: Option<i32>,
    /// Width of the area beside a goal where robots are substituted.
    #[prost(int32, optional, tag = "17")]
    pub goal_substitution_area_width: Option<i32>,
}

/// A point or vector: `Vector2f`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Vector2 {
    /// Along the field.
    #[prost(float, required, tag = "1")]
    pub x: f32,
    /// Across the field.
    #[prost(float, required, tag = "2")]
    pub y: f32,
}

/// A line: `SSL_FieldLineSegment`.
#[derive(Clone, PartialEq, Message)]
pub struct LineSegment {
    /// The name of its kind.
    #[prost(string, required, tag = "1")]
    pub name: String,
    /// One end.
    #[prost(message, required, tag = "2")]
    pub p1: Vector2,
    /// The other end.
    #[prost(message, required, tag = "3")]
    pub p2: Vector2,
    /// Its width.
    #[prost(float, required, tag = "4")]
    pub thickness: f32,
    /// Its kind.
    #[prost(enumeration = "ShapeType", optional, tag = "5")]
    pub kind: Option<i32>,
}

/// An arc: `SSL_FieldCircularArc`.
#[derive(Clone, PartialEq, Message)]
pub struct CircularArc {
    /// The name of its kind.
    #[prost(string, required, tag = "1")]
    pub name: String,
    /// Its centre.
    #[prost(message, required, tag = "2")]
    pub center: Vector2,
    /// Its radius.
    #[prost(float, required, tag = "3")]
    pub radius: f32,
    /// Where it begins, rad.
    #[prost(float, required, tag = "4")]
    pub a1: f32,
    /// Where it ends, rad.
    #[prost(float, required, tag = "5")]
    pub a2: f32,
    /// Width of its line.
    #[prost(float, required, tag = "6")]
    pub thickness: f32,
    /// Its kind.
    #[prost(enumeration = "ShapeType", optional, tag = "7")]
    pub kind: Option<i32>,
}

/// Kinds of lines and arcs: `SSL_FieldShapeType`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Enumeration)]
#[repr(i32)]
pub enum ShapeType {
    /// None of the others.
    Undefined = 0,
    /// The circle in the middle.
    CenterCircle = 1,
    /// The touch line at y > 0.
    TopTouchLine = 2,
    /// The touch line at y < 0.
    BottomTouchLine = 3,
    /// The goal line at x < 0.
    LeftGoalLine = 4,
    /// The goal line at x > 0.
    RightGoalLine = 5,
    /// Between the halves.
    HalfwayLine = 6,
    /// From goal to goal.
    CenterLine = 7,
    /// The penalty area at x < 0, parallel to the goal line.
    LeftPenaltyStretch = 8,
    /// The penalty area at x > 0, parallel to the goal line.
    RightPenaltyStretch = 9,
    /// The penalty area at x < 0, y < 0.
    LeftFieldLeftPenaltyStretch = 10,
    /// The penalty area at x < 0, y > 0.
    LeftFieldRightPenaltyStretch = 11,
    /// The penalty area at x > 0, y > 0.
    RightFieldLeftPenaltyStretch = 12,
    /// The penalty area at x > 0, y < 0.
    RightFieldRightPenaltyStretch = 13,
}

impl ShapeType {
    /// The name that lines and arcs of this kind have.
    pub fn name(self) -> &'static str {
        match self {
            Self::Undefined => "Undefined",
            Self::CenterCircle => "CenterCircle",
            Self::TopTouchLine => "TopTouchLine",
            Self::BottomTouchLine => "BottomTouchLine",
            Self::LeftGoalLine => "LeftGoalLine",
            Self::RightGoalLine => "RightGoalLine",
            Self::HalfwayLine => "HalfwayLine",
            Self::CenterLine => "CenterLine",
            Self::LeftPenaltyStretch => "LeftPenaltyStretch",
            Self::RightPenaltyStretch => "RightPenaltyStretch",
            Self::LeftFieldLeftPenaltyStretch => "LeftFieldLeftPenaltyStretch",
            Self::LeftFieldRightPenaltyStretch => "LeftFieldRightPenaltyStretch",
            Self::RightFieldLeftPenaltyStretch => "RightFieldLeftPenaltyStretch",
            Self::RightFieldRightPenaltyStretch => "RightFieldRightPenaltyStretch",
        }
    }
}

/// A camera as a pinhole with one radial term: `SSL_GeometryCameraCalibration`.
///
/// A point p of the field is at R·p + t in the camera's axes (right, down, forward), where R is the
/// rotation of the quaternion. Its projection, divided by the distance along the axis, is the undistorted
/// point u; the distorted point d fulfils |u| = |d|·(1 + distortion·|d|²), and its pixel is focal_length·d
/// plus the principal point.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct CameraCalibration {
    /// Number of the camera.
    #[prost(uint32, required, tag = "1")]
    pub camera_id: u32,
    /// Pixels.
    #[prost(float, required, tag = "2")]
    pub focal_length: f32,
    /// Column.
    #[prost(float, required, tag = "3")]
    pub principal_point_x: f32,
    /// Row.
    #[prost(float, required, tag = "4")]
    pub principal_point_y: f32,
    /// The radial term.
    #[prost(float, required, tag = "5")]
    pub distortion: f32,
    /// x of the quaternion.
    #[prost(float, required, tag = "6")]
    pub q0: f32,
    /// y of the quaternion.
    #[prost(float, required, tag = "7")]
    pub q1: f32,
    /// z of the quaternion.
    #[prost(float, required, tag = "8")]
    pub q2: f32,
    /// w of the quaternion.
    #[prost(float, required, tag = "9")]
    pub q3: f32,
    /// The field's origin in the camera's axes.
    #[prost(float, required, tag = "10")]
    pub tx: f32,
    /// The field's origin in the camera's axes.
    #[prost(float, required, tag = "11")]
    pub ty: f32,
    /// The field's origin in the camera's axes.
    #[prost(float, required, tag = "12")]
    pub tz: f32,
    /// The camera on the field.
    #[prost(float, optional, tag = "13")]
    pub derived_camera_world_tx: Option<f32>,
    /// The camera on the field.
    #[prost(float, optional, tag = "14")]
    pub derived_camera_world_ty: Option<f32>,
    /// The camera's height above the floor.
    #[prost(float, optional, tag = "15")]
    pub derived_camera_world_tz: Option<f32>,
    /// Width of the picture.
    #[prost(uint32, optional, tag = "16")]
    pub pixel_image_width: Option<u32>,
    /// Height of the picture.
    #[prost(uint32, optional, tag = "17")]
    pub pixel_image_height: Option<u32>,
}
