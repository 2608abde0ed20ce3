//! `protoc` agrees with us about every field: it reads our bytes as text with definitions written for this
//! test, and writes the same bytes from that text.

use std::io::Write;
use std::process::{Command, Stdio};
use touchline_protocols::Message;
use touchline_protocols::firasim::{self, Environment, Packet};
use touchline_protocols::ssl_geometry::{
    self, CameraCalibration, CircularArc, FieldSize, GeometryData, LineSegment, ShapeType,
};
use touchline_protocols::ssl_tracked::{
    self, Capability, KickedBall, RobotId, Team, TrackedBall, TrackedFrame, TrackedRobot,
    TrackerPacket,
};
use touchline_protocols::ssl_vision::{
    DetectionBall, DetectionFrame, DetectionRobot, Source, WrapperPacket,
};

fn protoc(argument: &str, file: &str, input: &[u8]) -> Vec<u8> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/proto");
    let mut child = Command::new("protoc")
        .args([argument, &format!("--proto_path={folder}"), file])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("protoc: Debian's protobuf-compiler");
    child.stdin.take().unwrap().write_all(input).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "protoc {argument} {file}");
    output.stdout
}

/// Asserts that protoc knows all fields of a message, sees `fields` of them, and writes the same bytes.
#[track_caller]
fn agrees(message: &impl Message, name: &str, file: &str, fields: usize) {
    let bytes = message.encode_to_vec();
    let text = protoc(&format!("--decode={name}"), file, &bytes);
    let lines = String::from_utf8(text.clone()).unwrap();
    // An unknown field has its number instead of a name.
    let is_unknown = |line: &&str| line.trim_start().starts_with(|c: char| c.is_ascii_digit());
    assert_eq!(lines.lines().find(is_unknown), None, "{lines}");
    assert_eq!(lines.lines().filter(|line| line.contains(':')).count(), fields, "{lines}");
    assert_eq!(protoc(&format!("--encode={name}"), file, &text), bytes, "{lines}");
}

#[test]
#[ignore = "needs protoc: Debian's protobuf-compiler"]
fn protoc_agrees_about_ssl_vision() {
    let ball = DetectionBall {
        confidence: 0.1,
        area: Some(2),
        x: 3.5,
        y: -4.25,
        z: Some(5.125),
        pixel_x: 6.0,
        pixel_y: 7.0,
    };
    let robot = DetectionRobot {
        confidence: 0.3,
        robot_id: Some(2),
        x: 3e-3,
        y: -4e3,
        orientation: Some(-3.1),
        pixel_x: 6.0,
        pixel_y: 7.0,
        height: Some(8.0),
    };
    let detection = DetectionFrame {
        frame_number: u32::MAX,
        t_capture: 1.796_083_200_123_456e9,
        t_sent: 1.796_083_200_125e9,
        camera_id: 3,
        balls: vec![ball; 2],
        robots_yellow: vec![robot],
        robots_blue: vec![robot],
        t_capture_camera: Some(0.5),
    };
    let source = Some(Source::Other as i32);
    let packet = WrapperPacket { detection: Some(detection), geometry: None, source };
    agrees(&packet, "WrapperPacket", "ssl.proto", 5 + 2 * 7 + 2 * 8 + 1);
}

#[test]
#[ignore = "needs protoc: Debian's protobuf-compiler"]
fn protoc_agrees_about_geometry() {
    let point = ssl_geometry::Vector2 { x: 1.5, y: -2.5 };
    let all = (1..=13).map(|kind| ShapeType::try_from(kind).unwrap());
    let lines = all.map(|kind| LineSegment {
        name: kind.name().into(),
        p1: point,
        p2: point,
        thickness: 10.0,
        kind: Some(kind as i32),
    });
    let field = FieldSize {
        field_length: 1,
        field_width: 2,
        goal_width: 3,
        goal_depth: 4,
        boundary_width: -5,
        field_lines: lines.collect(),
        field_arcs: vec![CircularArc {
            name: "CenterCircle".into(),
            center: point,
            radius: 3.0,
            a1: 4.0,
            a2: 5.0,
            thickness: 6.0,
            kind: Some(ShapeType::CenterCircle as i32),
        }],
        penalty_area_depth: Some(8),
        penalty_area_width: Some(9),
        center_circle_radius: Some(10),
        line_thickness: Some(11),
        goal_center_to_penalty_mark: Some(12),
        goal_height: Some(13),
        ball_radius: Some(14.5),
        max_robot_radius: Some(15.5),
        boundary_width_goal_line: Some(16),
        goal_substitution_area_width: Some(17),
    };
    let calib = CameraCalibration {
        camera_id: 1,
        focal_length: 2.0,
        principal_point_x: 3.0,
        principal_point_y: 4.0,
        distortion: 5.0,
        q0: 6.0,
        q1: 7.0,
        q2: 8.0,
        q3: 9.0,
        tx: 10.0,
        ty: 11.0,
        tz: 12.0,
        derived_camera_world_tx: Some(13.0),
        derived_camera_world_ty: Some(14.0),
        derived_camera_world_tz: Some(15.0),
        pixel_image_width: Some(16),
        pixel_image_height: Some(17),
    };
    let packet = WrapperPacket {
        geometry: Some(GeometryData { field, calib: vec![calib] }),
        ..Default::default()
    };
    agrees(&packet, "WrapperPacket", "ssl.proto", 5 + 13 * 7 + 8 + 10 + 17);
    let text = protoc("--decode=WrapperPacket", "ssl.proto", &packet.encode_to_vec());
    let text = String::from_utf8(text).unwrap();
    // Each line's name equals its type's.
    for kind in (1..=13).map(|kind| ShapeType::try_from(kind).unwrap().name()) {
        assert!(text.contains(&format!("name: \"{kind}\"")), "{text}");
        assert!(text.contains(&format!("type: {kind}\n")), "{text}");
    }
}

#[test]
#[ignore = "needs protoc: Debian's protobuf-compiler"]
fn protoc_agrees_about_trackers() {
    let (flat, space) =
        (ssl_tracked::Vector2 { x: 1.0, y: 2.0 }, ssl_tracked::Vector3 { x: 1.0, y: 2.0, z: 3.0 });
    let robot_id = RobotId { id: Some(0), team: Some(Team::Blue as i32) };
    let packet = TrackerPacket {
        uuid: "uuid".into(),
        source_name: Some("Touchline".into()),
        tracked_frame: Some(TrackedFrame {
            frame_number: 1,
            timestamp: 2.0,
            balls: vec![TrackedBall { pos: space, vel: Some(space), visibility: Some(1.0) }],
            robots: vec![TrackedRobot {
                robot_id,
                pos: flat,
                orientation: 3.0,
                vel: Some(flat),
                vel_angular: Some(5.0),
                visibility: Some(0.5),
            }],
            kicked_ball: Some(KickedBall {
                pos: flat,
                vel: space,
                start_timestamp: 3.0,
                stop_timestamp: Some(4.0),
                stop_pos: Some(flat),
                robot_id: Some(robot_id),
            }),
            capabilities: vec![Capability::FlyingBalls as i32, Capability::KickedBalls as i32],
        }),
    };
    agrees(&packet, "TrackerPacket", "ssl.proto", 2 + 2 + 7 + 9 + 11 + 2);
}

#[test]
#[ignore = "needs protoc: Debian's protobuf-compiler"]
fn protoc_agrees_about_firasim() {
    let robot = firasim::Robot {
        robot_id: 1,
        x: 0.1,
        y: -0.2,
        orientation: 0.3,
        vx: 0.4,
        vy: 0.5,
        vorientation: 1.0 / 3.0,
    };
    let packet = Environment {
        step: 1,
        frame: Some(firasim::Frame {
            ball: Some(firasim::Ball { x: 1.0, y: 2.0, z: 3.0, vx: 4.0, vy: 5.0, vz: 6.0 }),
            robots_yellow: vec![robot],
            robots_blue: vec![robot; 2],
        }),
        field: Some(firasim::Field {
            width: 1.0,
            length: 2.0,
            goal_width: 3.0,
            goal_depth: 4.0,
            center_radius: 5.0,
            penalty_width: 6.0,
            penalty_depth: 7.0,
            penalty_point: 8.0,
        }),
        goals_blue: 4,
        goals_yellow: 5,
    };
    agrees(&packet, "Environment", "firasim.proto", 3 + 6 + 3 * 7 + 8);
    let packet = Packet {
        cmd: Some(firasim::Commands {
            robot_commands: vec![firasim::Command {
                id: 1,
                yellowteam: true,
                wheel_left: 6.5,
                wheel_right: -7.5,
            }],
        }),
        replace: Some(firasim::Replacement {
            ball: Some(firasim::BallReplacement { x: 1.0, y: 2.0, vx: 3.0, vy: 4.0 }),
            robots: vec![firasim::RobotReplacement {
                position: Some(robot),
                yellowteam: true,
                turnon: true,
            }],
        }),
    };
    agrees(&packet, "Packet", "firasim.proto", 4 + 4 + 7 + 2);
}
