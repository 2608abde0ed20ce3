//! The bytes on the wire: field numbers and types, compared with bytes put together here by hand.

use touchline_protocols::firasim::{Command, Commands, Environment, Packet};
use touchline_protocols::ssl_geometry::{
    CameraCalibration, FieldSize, GeometryData, LineSegment, ShapeType,
};
use touchline_protocols::ssl_tracked::{Capability, RobotId, Team, TrackedFrame, TrackerPacket};
use touchline_protocols::ssl_vision::{
    DetectionBall, DetectionFrame, DetectionRobot, Source, WrapperPacket,
};
use touchline_protocols::{Message, firasim, ssl_geometry, ssl_tracked};

/// A field's head: its number and its wire type.
fn head(number: u32, wire_type: u32) -> Vec<u8> {
    varint(u64::from(number << 3 | wire_type))
}

fn varint(mut value: u64) -> Vec<u8> {
    let mut bytes = vec![];
    while value >= 0x80 {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
    bytes
}

fn number(field: u32, value: u64) -> Vec<u8> {
    [head(field, 0), varint(value)].concat()
}

fn double(field: u32, value: f64) -> Vec<u8> {
    [head(field, 1), value.to_le_bytes().to_vec()].concat()
}

fn float(field: u32, value: f32) -> Vec<u8> {
    [head(field, 5), value.to_le_bytes().to_vec()].concat()
}

fn bytes(field: u32, value: &[u8]) -> Vec<u8> {
    [head(field, 2), varint(value.len() as u64), value.to_vec()].concat()
}

#[test]
fn a_detection_frame_has_the_fields_of_the_league() {
    let ball = DetectionBall {
        confidence: 0.5,
        area: Some(300),
        x: -1.5,
        y: 2.0,
        z: Some(0.0),
        pixel_x: 10.25,
        pixel_y: 0.0,
    };
    let robot = DetectionRobot {
        confidence: 1.0,
        robot_id: Some(0),
        x: 1.0,
        y: 2.0,
        orientation: Some(-3.0),
        pixel_x: 4.0,
        pixel_y: 5.0,
        height: Some(140.0),
    };
    let packet = WrapperPacket {
        detection: Some(DetectionFrame {
            frame_number: 300,
            t_capture: 1.7e9 + 0.25,
            t_sent: 1.7e9 + 0.5,
            camera_id: 3,
            balls: vec![ball],
            robots_yellow: vec![robot],
            robots_blue: vec![DetectionRobot { robot_id: Some(15), ..robot }],
            t_capture_camera: None,
        }),
        geometry: None,
        source: Some(Source::Other as i32),
    };
    let robot = |id| {
        [
            float(1, 1.0),
            number(2, id),
            float(3, 1.0),
            float(4, 2.0),
            float(5, -3.0),
            float(6, 4.0),
            float(7, 5.0),
            float(8, 140.0),
        ]
        .concat()
    };
    let ball = [
        float(1, 0.5),
        number(2, 300),
        float(3, -1.5),
        float(4, 2.0),
        float(5, 0.0),
        float(6, 10.25),
        // Required fields are sent although they are 0.
        float(7, 0.0),
    ]
    .concat();
    let frame = [
        number(1, 300),
        double(2, 1.7e9 + 0.25),
        double(3, 1.7e9 + 0.5),
        number(4, 3),
        bytes(5, &ball),
        bytes(6, &robot(0)),
        bytes(7, &robot(15)),
    ]
    .concat();
    let expected = [bytes(1, &frame), number(3, 1)].concat();
    assert_eq!(packet.encode_to_vec(), expected);
    assert_eq!(WrapperPacket::decode(&expected[..]).unwrap(), packet);
}

#[test]
fn geometry_has_the_fields_of_the_league() {
    let point = |x, y| ssl_geometry::Vector2 { x, y };
    let packet = WrapperPacket {
        geometry: Some(GeometryData {
            field: FieldSize {
                field_length: 9000,
                field_width: 6000,
                goal_width: 1000,
                goal_depth: 180,
                boundary_width: 300,
                field_lines: vec![LineSegment {
                    name: ShapeType::HalfwayLine.name().into(),
                    p1: point(0.0, -3000.0),
                    p2: point(0.0, 3000.0),
                    thickness: 10.0,
                    kind: Some(ShapeType::HalfwayLine as i32),
                }],
                goal_substitution_area_width: Some(1),
                ball_radius: Some(21.5),
                ..FieldSize::default()
            },
            calib: vec![CameraCalibration {
                camera_id: 0,
                q3: 1.0,
                tz: 4000.0,
                pixel_image_height: Some(1200),
                ..CameraCalibration::default()
            }],
        }),
        ..WrapperPacket::default()
    };
    let line = [
        bytes(1, b"HalfwayLine"),
        bytes(2, &[float(1, 0.0), float(2, -3000.0)].concat()),
        bytes(3, &[float(1, 0.0), float(2, 3000.0)].concat()),
        float(4, 10.0),
        number(5, 6),
    ]
    .concat();
    let field = [
        number(1, 9000),
        number(2, 6000),
        number(3, 1000),
        number(4, 180),
        number(5, 300),
        bytes(6, &line),
        float(14, 21.5),
        number(17, 1),
    ]
    .concat();
    let zero = |fields: std::ops::RangeInclusive<u32>| fields.flat_map(|it| float(it, 0.0));
    let calib: Vec<u8> = [
        number(1, 0),
        zero(2..=8).collect(),
        float(9, 1.0),
        zero(10..=11).collect(),
        float(12, 4000.0),
        number(17, 1200),
    ]
    .concat();
    let expected = bytes(2, &[bytes(1, &field), bytes(2, &calib)].concat());
    assert_eq!(packet.encode_to_vec(), expected);
    assert_eq!(WrapperPacket::decode(&expected[..]).unwrap(), packet);
}

#[test]
fn a_tracked_frame_has_the_fields_of_the_league() {
    let packet = TrackerPacket {
        uuid: "u".into(),
        source_name: Some("touchline".into()),
        tracked_frame: Some(TrackedFrame {
            frame_number: 7,
            timestamp: 2.5,
            balls: vec![ssl_tracked::TrackedBall {
                pos: ssl_tracked::Vector3 { x: 1.0, y: 2.0, z: 0.0 },
                vel: None,
                visibility: Some(1.0),
            }],
            robots: vec![ssl_tracked::TrackedRobot {
                robot_id: RobotId { id: Some(4), team: Some(Team::Blue as i32) },
                pos: ssl_tracked::Vector2 { x: 1.0, y: 2.0 },
                orientation: 0.5,
                vel: Some(ssl_tracked::Vector2 { x: 0.0, y: 1.0 }),
                vel_angular: Some(2.0),
                visibility: Some(0.5),
            }],
            kicked_ball: None,
            capabilities: vec![Capability::MultipleBalls as i32, Capability::KickedBalls as i32],
        }),
    };
    let ball =
        [bytes(1, &[float(1, 1.0), float(2, 2.0), float(3, 0.0)].concat()), float(3, 1.0)].concat();
    let robot = [
        bytes(1, &[number(1, 4), number(2, 2)].concat()),
        bytes(2, &[float(1, 1.0), float(2, 2.0)].concat()),
        float(3, 0.5),
        bytes(4, &[float(1, 0.0), float(2, 1.0)].concat()),
        float(5, 2.0),
        float(6, 0.5),
    ]
    .concat();
    let frame = [
        number(1, 7),
        double(2, 2.5),
        bytes(3, &ball),
        bytes(4, &robot),
        number(6, 2),
        number(6, 3),
    ]
    .concat();
    let expected = [bytes(1, b"u"), bytes(2, b"touchline"), bytes(3, &frame)].concat();
    assert_eq!(packet.encode_to_vec(), expected);
    assert_eq!(TrackerPacket::decode(&expected[..]).unwrap(), packet);
}

#[test]
fn firasim_has_the_fields_of_the_simulator() {
    let packet = Environment {
        step: 9,
        frame: Some(firasim::Frame {
            ball: Some(firasim::Ball { x: 0.5, vz: 1.0, ..Default::default() }),
            robots_yellow: vec![firasim::Robot {
                robot_id: 2,
                vorientation: -1.0,
                ..Default::default()
            }],
            robots_blue: vec![],
        }),
        field: Some(firasim::Field { width: 1.3, penalty_point: 0.4, ..Default::default() }),
        goals_blue: 1,
        goals_yellow: 0,
    };
    let frame = [
        bytes(1, &[double(1, 0.5), double(6, 1.0)].concat()),
        bytes(2, &[number(1, 2), double(7, -1.0)].concat()),
    ]
    .concat();
    let field = [double(1, 1.3), double(8, 0.4)].concat();
    let expected = [number(1, 9), bytes(2, &frame), bytes(3, &field), number(4, 1)].concat();
    assert_eq!(packet.encode_to_vec(), expected);

    let command = [number(1, 2), number(2, 1), double(6, 10.0), double(7, -10.0)].concat();
    let wire = bytes(1, &bytes(1, &command));
    let expected = Command { id: 2, yellowteam: true, wheel_left: 10.0, wheel_right: -10.0 };
    let packet = Packet { cmd: Some(Commands { robot_commands: vec![expected] }), replace: None };
    assert_eq!(Packet::decode(&wire[..]).unwrap(), packet);
    assert_eq!(packet.encode_to_vec(), wire);
}
