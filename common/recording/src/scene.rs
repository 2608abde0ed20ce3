//! The scene for viewers: `world` in Foxglove's schemas, lengths in metres.
//!
//! Only the used parts of the schemas are defined here; viewers treat missing parts as empty.

use config::FieldConfig;
use messages::{RobotState, Team, TrackStatus, UnknownRobotState, WorldFrame};
use schemars::JsonSchema;
use serde::Serialize;

/// Frame of reference: the field, see [`common`].
const FRAME_ID: &str = "field";
/// Height at which robots are drawn.
const ROBOT_HEIGHT_M: f64 = 0.05;

/// Seconds and nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, JsonSchema)]
pub struct Time {
    sec: u64,
    nsec: u32,
}

/// `foxglove.Vector3`
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, JsonSchema)]
pub struct Vector3 {
    x: f64,
    y: f64,
    z: f64,
}

/// `foxglove.Quaternion`
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

/// `foxglove.Pose`
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct Pose {
    position: Vector3,
    orientation: Quaternion,
}

/// `foxglove.Color`
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct Color {
    r: f64,
    g: f64,
    b: f64,
    a: f64,
}

/// `foxglove.PoseInFrame`
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct PoseInFrame {
    timestamp: Time,
    frame_id: &'static str,
    pose: Pose,
}

/// `foxglove.PosesInFrame`
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct PosesInFrame {
    timestamp: Time,
    frame_id: &'static str,
    poses: Vec<Pose>,
}

/// `foxglove.SceneUpdate`
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct SceneUpdate {
    deletions: Vec<Deletion>,
    entities: Vec<Entity>,
}

/// `foxglove.SceneEntityDeletion`
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Deletion {
    timestamp: Time,
    #[serde(rename = "type")]
    kind: u8,
    id: String,
}

/// `foxglove.SceneEntity`
#[derive(Debug, Clone, PartialEq, Default, Serialize, JsonSchema)]
pub struct Entity {
    timestamp: Time,
    frame_id: &'static str,
    id: String,
    lifetime: Time,
    frame_locked: bool,
    metadata: Vec<KeyValue>,
    arrows: Vec<Arrow>,
    cubes: Vec<Cube>,
    spheres: Vec<Cube>,
    lines: Vec<Line>,
    texts: Vec<Text>,
}

/// `foxglove.KeyValuePair`
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct KeyValue {
    key: String,
    value: String,
}

/// `foxglove.ArrowPrimitive`
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Arrow {
    pose: Pose,
    shaft_length: f64,
    shaft_diameter: f64,
    head_length: f64,
    head_diameter: f64,
    color: Color,
}

/// `foxglove.CubePrimitive`, and `foxglove.SpherePrimitive`, which has the same fields.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Cube {
    pose: Pose,
    size: Vector3,
    color: Color,
}

/// `foxglove.LinePrimitive`
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Line {
    #[serde(rename = "type")]
    kind: u8,
    pose: Pose,
    thickness: f64,
    scale_invariant: bool,
    points: Vec<Vector3>,
    color: Color,
    colors: Vec<Color>,
    indices: Vec<u32>,
}

/// `foxglove.TextPrimitive`
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Text {
    pose: Pose,
    billboard: bool,
    font_size: f64,
    scale_invariant: bool,
    color: Color,
    text: String,
}

const WHITE: Color = Color { r: 1.0, g: 1.0, b: 1.0, a: 1.0 };
const ORANGE: Color = Color { r: 1.0, g: 0.5, b: 0.0, a: 1.0 };
/// Line type: closed line.
const LINE_LOOP: u8 = 1;
/// Line type: each pair of points is a line.
const LINE_LIST: u8 = 2;
/// Time after which a robot or ball disappears if it is not updated.
const LIFETIME: Time = Time { sec: 0, nsec: 500_000_000 };

fn time(ns: u64) -> Time {
    Time { sec: ns / 1_000_000_000, nsec: (ns % 1_000_000_000) as u32 }
}

/// A position on the field, `z_m` above it. Viewers do not accept NaN, so it is replaced.
fn pose(x_mm: f64, y_mm: f64, z_m: f64, heading: f64) -> Pose {
    let finite = |value: f64| if value.is_finite() { value } else { 0.0 };
    let (sin, cos) = (finite(heading) / 2.0).sin_cos();
    Pose {
        position: Vector3 { x: finite(x_mm) / 1000.0, y: finite(y_mm) / 1000.0, z: z_m },
        orientation: Quaternion { x: 0.0, y: 0.0, z: sin, w: cos },
    }
}

fn color(team: u32) -> Color {
    match Team::from_number(team) {
        Some(Team::Yellow) => Color { r: 0.95, g: 0.85, b: 0.1, a: 1.0 },
        Some(Team::Blue) => Color { r: 0.1, g: 0.35, b: 0.95, a: 1.0 },
        None => Color { r: 0.6, g: 0.6, b: 0.6, a: 1.0 },
    }
}

fn team(number: u32) -> &'static str {
    Team::from_number(number).map_or("unknown", Team::name)
}

fn name(robot: &RobotState) -> String {
    format!("{} {}", team(robot.team), robot.robot_id)
}

/// The number after a question mark is that of a track, not of a robot.
fn name_of_unknown(robot: &UnknownRobotState) -> String {
    format!("{} ?{}", team(robot.team), robot.track_id)
}

fn is_present(status: u32) -> bool {
    TrackStatus::from_number(status).is_some_and(|status| status != TrackStatus::Absent)
}

fn robots(world: &WorldFrame) -> impl Iterator<Item = &RobotState> {
    world.robots().iter().filter(|robot| is_present(robot.status))
}

fn json<T: Serialize>(message: &T) -> Vec<u8> {
    serde_json::to_vec(message).unwrap_or_default()
}

/// The lines of the pitch, drawn once at the start: a `foxglove.SceneUpdate`.
pub fn field_scene(field: &FieldConfig, t_wall_ns: u64) -> Vec<u8> {
    let point = |x_mm: f64, y_mm: f64| Vector3 { x: x_mm / 1000.0, y: y_mm / 1000.0, z: 0.0 };
    let line = |kind, points| Line {
        kind,
        pose: pose(0.0, 0.0, 0.0, 0.0),
        thickness: 2.0,
        scale_invariant: true,
        points,
        color: WHITE,
        colors: Vec::new(),
        indices: Vec::new(),
    };
    let (x, y) = (field.length_mm / 2.0, field.width_mm / 2.0);
    let circle = (0..64).map(|step| {
        let (sin, cos) = (f64::from(step) * std::f64::consts::TAU / 64.0).sin_cos();
        point(field.center_circle_radius_mm * cos, field.center_circle_radius_mm * sin)
    });
    let goals = [-1.0, 1.0].into_iter().flat_map(|side| {
        let (post, back) = (side * x, side * (x + field.goal_depth_mm));
        let half = field.goal_width_mm / 2.0;
        [(post, -half), (back, -half), (back, -half), (back, half), (back, half), (post, half)]
    });
    let entity = Entity {
        timestamp: time(t_wall_ns),
        frame_id: FRAME_ID,
        id: "pitch".into(),
        lines: vec![
            line(LINE_LOOP, vec![point(-x, -y), point(x, -y), point(x, y), point(-x, y)]),
            line(LINE_LIST, vec![point(0.0, -y), point(0.0, y)]),
            line(LINE_LOOP, circle.collect()),
            line(LINE_LIST, goals.map(|(x, y)| point(x, y)).collect()),
        ],
        ..Default::default()
    };
    json(&SceneUpdate { deletions: Vec::new(), entities: vec![entity] })
}

/// A robot's name, above it.
fn label(pose: Pose, text: String) -> Text {
    Text { pose, billboard: true, font_size: 14.0, scale_invariant: true, color: WHITE, text }
}

/// Robots and ball: a `foxglove.SceneUpdate`. Robots of which only the team is known are drawn as discs
/// around their team patch.
pub fn world_scene(world: &WorldFrame, robot_size_mm: f64, ball_diameter_mm: f64) -> Vec<u8> {
    let timestamp = time(world.frame.t_capture_wall_ns);
    let size = robot_size_mm / 1000.0;
    let visibility = |visibility: f32| {
        vec![KeyValue { key: "visibility".into(), value: format!("{visibility:.2}") }]
    };
    let mut entities: Vec<Entity> = robots(world)
        .map(|robot| {
            let at = |z_m| pose(robot.x_mm, robot.y_mm, z_m, robot.orientation);
            Entity {
                timestamp,
                frame_id: FRAME_ID,
                id: name(robot),
                lifetime: LIFETIME,
                metadata: visibility(robot.visibility),
                cubes: vec![Cube {
                    pose: at(ROBOT_HEIGHT_M / 2.0),
                    size: Vector3 { x: size, y: size, z: ROBOT_HEIGHT_M },
                    color: color(robot.team),
                }],
                arrows: vec![Arrow {
                    pose: at(ROBOT_HEIGHT_M),
                    shaft_length: 0.6 * size,
                    shaft_diameter: 0.15 * size,
                    head_length: 0.4 * size,
                    head_diameter: 0.4 * size,
                    color: WHITE,
                }],
                texts: vec![label(at(2.5 * ROBOT_HEIGHT_M), name(robot))],
                ..Default::default()
            }
        })
        .collect();
    let unknown = world.unknown_robots().iter().filter(|robot| is_present(robot.status));
    entities.extend(unknown.map(|robot| {
        let at = |z_m| pose(robot.x_mm, robot.y_mm, z_m, 0.0);
        Entity {
            timestamp,
            frame_id: FRAME_ID,
            id: name_of_unknown(robot),
            lifetime: LIFETIME,
            metadata: visibility(robot.visibility),
            spheres: vec![Cube {
                pose: at(ROBOT_HEIGHT_M / 2.0),
                size: Vector3 { x: size, y: size, z: ROBOT_HEIGHT_M },
                color: Color { a: 0.5, ..color(robot.team) },
            }],
            texts: vec![label(at(2.5 * ROBOT_HEIGHT_M), name_of_unknown(robot))],
            ..Default::default()
        }
    }));
    if is_present(world.ball.status) {
        let diameter = ball_diameter_mm / 1000.0;
        entities.push(Entity {
            timestamp,
            frame_id: FRAME_ID,
            id: "ball".into(),
            lifetime: LIFETIME,
            spheres: vec![Cube {
                pose: pose(world.ball.x_mm, world.ball.y_mm, diameter / 2.0, 0.0),
                size: Vector3 { x: diameter, y: diameter, z: diameter },
                color: ORANGE,
            }],
            ..Default::default()
        });
    }
    json(&SceneUpdate { deletions: Vec::new(), entities })
}

/// The robots: a `foxglove.PosesInFrame`.
pub fn robot_poses(world: &WorldFrame) -> Vec<u8> {
    let poses =
        robots(world).map(|robot| pose(robot.x_mm, robot.y_mm, 0.0, robot.orientation)).collect();
    json(&PosesInFrame {
        timestamp: time(world.frame.t_capture_wall_ns),
        frame_id: FRAME_ID,
        poses,
    })
}

/// The ball: a `foxglove.PoseInFrame`; `None` while there is none.
pub fn ball_pose(world: &WorldFrame) -> Option<Vec<u8>> {
    let ball = &world.ball;
    is_present(ball.status).then(|| {
        json(&PoseInFrame {
            timestamp: time(world.frame.t_capture_wall_ns),
            frame_id: FRAME_ID,
            pose: pose(ball.x_mm, ball.y_mm, 0.0, 0.0),
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use config::Config;

    fn world() -> Box<WorldFrame> {
        let mut world = bytemuck::allocation::zeroed_box::<WorldFrame>();
        world.robot_count = 2;
        world.robots[0] = RobotState {
            team: Team::Blue as u32,
            robot_id: 3,
            status: TrackStatus::Measured as u32,
            x_mm: 250.0,
            y_mm: f64::NAN,
            orientation: std::f64::consts::PI,
            ..RobotState::zeroed()
        };
        world.unknown_robot_count = 1;
        world.unknown_robots[0] = UnknownRobotState {
            team: Team::Yellow as u32,
            track_id: 12,
            status: TrackStatus::Measured as u32,
            x_mm: -100.0,
            ..UnknownRobotState::zeroed()
        };
        world.ball.status = TrackStatus::Coasting as u32;
        world
    }

    #[test]
    fn existing_objects_are_drawn() {
        let scene: serde_json::Value =
            serde_json::from_slice(&world_scene(&world(), 75.0, 42.7)).unwrap();
        let entities = scene["entities"].as_array().unwrap();
        let ids: Vec<&str> = entities.iter().map(|e| e["id"].as_str().unwrap()).collect();
        assert_eq!(ids, ["blue 3", "yellow ?12", "ball"], "the second robot has no track");
        assert!(entities[1]["arrows"].as_array().unwrap().is_empty());
        assert_eq!(entities[1]["spheres"][0]["pose"]["position"]["x"], -0.1);
        let pose = &entities[0]["cubes"][0]["pose"];
        assert_eq!((&pose["position"]["x"], &pose["position"]["y"]), (&0.25.into(), &0.0.into()));
        assert_eq!(pose["orientation"]["z"], 1.0);
        let field = field_scene(&Config::default().field, 5);
        let field: serde_json::Value = serde_json::from_slice(&field).unwrap();
        assert_eq!(field["entities"][0]["lines"][0]["points"][1]["x"], 1.1);
    }
}
