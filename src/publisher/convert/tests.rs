use super::*;
use bytemuck::Zeroable;
use config::{DistortionModel, Preset};
use messages::{
    BallState, DetectedBall, DetectedRobot, DetectionFrame, RobotId, RobotState, Team, WorldFrame,
};
use protocols::ssl_vision::{self, Source};
use protocols::{Message, ONE_FRAME_BYTES, ssl_tracked};

/// 2026-12-01, with nanoseconds that a float of 32 bits would lose.
const WALL_NS: u64 = 1_796_083_200_123_456_789;

fn scene_of(preset: Preset) -> Scene {
    Scene::new(&preset.config(), "test").unwrap()
}

fn header() -> FrameHeader {
    FrameHeader { seq: 4711, t_capture_wall_ns: WALL_NS, ..Default::default() }
}

/// Two teams of eleven with awkward values, and the ball.
fn world() -> Box<WorldFrame> {
    let mut world: Box<WorldFrame> = bytemuck::zeroed_box();
    world.frame = header();
    for (index, robot) in world.robots.iter_mut().take(22).enumerate() {
        *robot = RobotState {
            team: (index / 11) as u32,
            robot_id: (index % 11) as u32,
            status: TrackStatus::Measured as u32,
            visibility: 1.0 - index as f32 / 30.0,
            x_mm: -4_321.012_3 + 397.1 * index as f64,
            y_mm: 2_999.987_6 - 271.3 * index as f64,
            orientation: -3.1 + 0.28 * index as f64,
            v_mm_s: -2_718.281_8 + 200.0 * index as f64,
            omega: 31.415_9 - 3.0 * index as f64,
            ..Zeroable::zeroed()
        };
    }
    world.robot_count = 22;
    world.ball = BallState {
        status: TrackStatus::Coasting as u32,
        visibility: 0.25,
        x_mm: 1234.567,
        y_mm: -765.432_1,
        vx_mm_s: -6543.21,
        vy_mm_s: 12.345,
        ..Zeroable::zeroed()
    };
    world
}

#[track_caller]
fn assert_close(a: f64, b: f64) {
    // Floats of 32 bits have 24 bits of fraction.
    assert!((a - b).abs() <= 1e-7 * b.abs().max(1e-3), "{a} and {b}");
}

#[test]
fn detections_are_sent_as_they_were_found() {
    let scene = scene_of(Preset::SslDivisionB);
    let mut frame: Box<DetectionFrame> = bytemuck::zeroed_box();
    frame.frame = header();
    let robot = DetectedRobot {
        team: Team::Blue as u32,
        robot_id: RobotId::from(7),
        x_mm: -4499.5,
        y_mm: 12.25,
        orientation: 3.0,
        confidence: 0.75,
        x_px: 100.5,
        y_px: 33.25,
        ..Default::default()
    };
    assert!(frame.push_robot(robot));
    assert!(frame.push_robot(DetectedRobot { robot_id: RobotId::UNKNOWN, ..robot }));
    assert!(frame.push_robot(DetectedRobot { team: 0, robot_id: RobotId::from(0), ..robot }));
    let ball =
        DetectedBall { x_mm: 1.5, y_mm: -2.5, confidence: 0.5, region: 1, ..Default::default() };
    assert!(frame.push_ball(ball));
    frame.region_count = 2;
    frame.regions[1].pixel_count = 55;
    let packet = of_detections(&scene, &frame, 1.8e9);
    assert_eq!(packet.source(), Source::Other);
    let detection = packet.detection.unwrap();
    assert_eq!((detection.frame_number, detection.camera_id), (4711, 0));
    assert!((detection.t_capture - 1_796_083_200.123_456_8).abs() < 1e-6);
    assert_eq!(detection.t_sent, 1.8e9);
    let expected = ssl_vision::DetectionRobot {
        confidence: 0.75,
        robot_id: Some(7),
        x: -4499.5,
        y: 12.25,
        orientation: Some(3.0),
        pixel_x: 100.5,
        pixel_y: 33.25,
        height: Some(140.0),
    };
    assert_eq!(detection.robots_blue, [expected]);
    assert_eq!(detection.robots_yellow.len(), 1);
    assert!(detection.robots_yellow.iter().all(|robot| robot.robot_id.is_some()));
    assert_eq!((detection.balls[0].area, detection.balls[0].x), (Some(55), 1.5));
}

#[test]
fn a_world_keeps_its_values_in_every_protocol() {
    let (scene, world) = (scene_of(Preset::SslDivisionB), world());
    let detection = of_world(&scene, &world, 1.8e9).detection.unwrap();
    let tracked = tracked(&scene, &world).tracked_frame.unwrap();
    let environment = environment(&scene, &world);
    let frame = environment.frame.unwrap();
    assert_eq!(tracked.frame_number, 4711);
    assert_eq!(environment.step, 4711);
    assert!((tracked.timestamp - detection.t_capture).abs() == 0.0);
    for (index, robot) in world.robots().iter().enumerate() {
        let of_team = index % 11;
        let is_yellow = index < 11;
        let detected =
            if is_yellow { &detection.robots_yellow } else { &detection.robots_blue }[of_team];
        assert_eq!(detected.robot_id, Some(robot.robot_id));
        assert_close(detected.x.into(), robot.x_mm);
        assert_close(detected.y.into(), robot.y_mm);
        assert_close(detected.orientation.unwrap().into(), robot.orientation);
        assert_eq!(detected.confidence, robot.visibility);
        let seen =
            scene.camera.image_from_field(geometry::FieldPoint::new(robot.x_mm, robot.y_mm), 140.0);
        assert_close(detected.pixel_x.into(), seen.x_px);
        let team = if is_yellow { ssl_tracked::Team::Yellow } else { ssl_tracked::Team::Blue };
        let it = &tracked.robots[index];
        assert_eq!((it.robot_id.id, it.robot_id.team()), (Some(robot.robot_id), team));
        assert_close(it.pos.x.into(), robot.x_mm / 1000.0);
        assert_close(it.pos.y.into(), robot.y_mm / 1000.0);
        let velocity = it.vel.unwrap();
        let (vx, vy) =
            (robot.v_mm_s * robot.orientation.cos(), robot.v_mm_s * robot.orientation.sin());
        assert_close(velocity.x.into(), vx / 1000.0);
        assert_close(velocity.y.into(), vy / 1000.0);
        assert_close(it.vel_angular.unwrap().into(), robot.omega);
        assert_eq!(it.visibility, Some(robot.visibility));
        let it = if is_yellow { &frame.robots_yellow } else { &frame.robots_blue }[of_team];
        assert_eq!(it.robot_id, robot.robot_id);
        // Doubles: nothing but the unit changes.
        assert_eq!((it.x, it.y), (robot.x_mm * 1e-3, robot.y_mm * 1e-3));
        assert_eq!((it.orientation, it.vorientation), (robot.orientation, robot.omega));
        assert!((it.vx - vx * 1e-3).abs() < 1e-12);
    }
    let ball = &world.ball;
    assert_close(detection.balls[0].x.into(), ball.x_mm);
    assert_close(tracked.balls[0].pos.y.into(), ball.y_mm / 1000.0);
    assert_close(tracked.balls[0].vel.unwrap().x.into(), ball.vx_mm_s / 1000.0);
    let it = frame.ball.unwrap();
    assert_eq!((it.x, it.vy), (ball.x_mm * 1e-3, ball.vy_mm_s * 1e-3));
    assert_eq!((environment.goals_blue, environment.goals_yellow), (0, 0));
}

#[test]
fn what_is_not_known_is_absent() {
    let scene = scene_of(Preset::Vsss3v3);
    let mut world = world();
    world.ball.status = TrackStatus::Absent as u32;
    world.robots[0].status = TrackStatus::Absent as u32;
    world.robots[1].status = 99;
    world.robots[2].team = 5;
    world.robot_count = 4;
    let detection = of_world(&scene, &world, 0.0).detection.unwrap();
    assert_eq!((detection.robots_yellow.len(), detection.balls.len()), (1, 0));
    let tracked = tracked(&scene, &world);
    assert_eq!(tracked.source_name.as_deref(), Some("Touchline"));
    let frame = tracked.tracked_frame.unwrap();
    assert_eq!((frame.robots.len(), frame.balls.len()), (1, 0));
    let frame = environment(&scene, &world).frame.unwrap();
    assert_eq!((frame.robots_yellow.len(), frame.ball), (1, None));
    let text = String::from_utf8(json(&world, 0.0)).unwrap();
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert!(value["ball"].is_null() && value["yellow"].as_object().unwrap().len() == 1, "{text}");
}

#[test]
fn two_full_teams_fit_into_one_ethernet_frame() {
    let (scene, world) = (scene_of(Preset::SslDivisionB), world());
    let lengths = [
        of_world(&scene, &world, 1.8e9).encoded_len(),
        tracked(&scene, &world).encoded_len(),
        json(&world, 1.8e9).len(),
        geometry(&scene).encoded_len(),
        environment(&scene, &world).encoded_len(),
    ];
    assert!(lengths.iter().all(|&length| length <= ONE_FRAME_BYTES), "{lengths:?}");
    // Some receivers of SSL-Vision read no more than this, and some of the VSSS.
    assert!(lengths[0] <= 1024 && lengths[3] <= 1024, "{lengths:?}");
    // More robots than any league has, and phantom balls: the least likely of these are left out.
    let mut frame: Box<DetectionFrame> = bytemuck::zeroed_box();
    for id in 0..32 {
        let robot = DetectedRobot { robot_id: RobotId::from(id), ..Default::default() };
        assert!(frame.push_robot(robot));
    }
    for index in 0..8 {
        let confidence = 1.0 - index as f32 / 10.0;
        assert!(frame.push_ball(DetectedBall { confidence, ..Default::default() }));
    }
    let packet = of_detections(&scene, &frame, 1.8e9);
    assert!(packet.encoded_len() <= ONE_FRAME_BYTES);
    let balls = packet.detection.unwrap().balls;
    assert!(!balls.is_empty() && balls.len() < 8 && balls[0].confidence == 1.0);
}

#[test]
fn the_geometry_is_the_field_s() {
    let scene = scene_of(Preset::SslDivisionB);
    let data = geometry(&scene).geometry.unwrap();
    let field = &data.field;
    assert_eq!((field.field_length, field.field_width), (9000, 6000));
    assert_eq!((field.goal_width, field.goal_depth, field.boundary_width), (1000, 180, 300));
    for size in [
        field.penalty_area_depth,
        field.penalty_area_width,
        field.center_circle_radius,
        field.goal_center_to_penalty_mark,
        field.boundary_width_goal_line,
        field.goal_substitution_area_width,
    ] {
        assert!(size.is_some(), "{field:?}");
    }
    assert_eq!(field.field_lines.len(), 12);
    for line in &field.field_lines {
        assert_eq!(line.name, line.kind().name());
        for end in [line.p1, line.p2] {
            assert!(end.x.abs() <= 4500.0 && end.y.abs() <= 3000.0, "{line:?}");
        }
        let length = (line.p1.x - line.p2.x).hypot(line.p1.y - line.p2.y);
        let expected = match line.name.as_str() {
            "TopTouchLine" | "BottomTouchLine" | "CenterLine" => 9000.0,
            "LeftGoalLine" | "RightGoalLine" | "HalfwayLine" => 6000.0,
            "LeftPenaltyStretch" | "RightPenaltyStretch" => 2000.0,
            _ => 1000.0,
        };
        assert_eq!(length, expected, "{line:?}");
        let side = if line.name.starts_with("Left") { -1.0 } else { 1.0 };
        if line.name.starts_with("Left") || line.name.starts_with("Right") {
            assert!(line.p1.x * side > 0.0 && line.p2.x * side > 0.0, "{line:?}");
        }
    }
    assert_eq!(field.field_arcs[0].radius, 500.0);
}

/// A receiver computes pixels from the calibration as the league documents it.
#[test]
fn the_calibration_leads_to_our_pixels() {
    for preset in Preset::ALL {
        let scene = scene_of(preset);
        let calib = geometry(&scene).geometry.unwrap().calib[0];
        let pixel = |[x, y, z]: [f64; 3]| {
            let [qx, qy, qz, qw] = [calib.q0, calib.q1, calib.q2, calib.q3].map(f64::from);
            let row = |a: f64, b: f64, c: f64, t: f32| a * x + b * y + c * z + f64::from(t);
            let across = row(
                1.0 - 2.0 * (qy * qy + qz * qz),
                2.0 * (qx * qy - qz * qw),
                2.0 * (qx * qz + qy * qw),
                calib.tx,
            );
            let down = row(
                2.0 * (qx * qy + qz * qw),
                1.0 - 2.0 * (qx * qx + qz * qz),
                2.0 * (qy * qz - qx * qw),
                calib.ty,
            );
            let along = row(
                2.0 * (qx * qz - qy * qw),
                2.0 * (qy * qz + qx * qw),
                1.0 - 2.0 * (qx * qx + qy * qy),
                calib.tz,
            );
            let (u, v) = (across / along, down / along);
            let (wanted, k) = (u.hypot(v), f64::from(calib.distortion));
            let mut radius = wanted;
            for _ in 0..50 {
                radius = wanted / (1.0 + k * radius * radius);
            }
            let scale = if wanted > 0.0 { radius / wanted } else { 1.0 };
            let focal = f64::from(calib.focal_length);
            [
                focal * u * scale + f64::from(calib.principal_point_x),
                focal * v * scale + f64::from(calib.principal_point_y),
            ]
        };
        let worst_px = scene.pinhole.as_ref().unwrap().worst_px;
        let field = &scene.config.field;
        for (x, y, z) in [(0.0, 0.0, 0.0), (0.4, 0.3, 0.0), (-0.45, 0.45, 50.0)] {
            let point = [x * field.length_mm, y * field.width_mm, z];
            let ours = scene
                .camera
                .image_from_field(geometry::FieldPoint::new(point[0], point[1]), point[2]);
            let theirs = pixel(point);
            let apart = (ours.x_px - theirs[0]).hypot(ours.y_px - theirs[1]);
            assert!(apart <= worst_px + 0.1, "{}: {apart} px at {point:?}", preset.name());
        }
        let position = [
            calib.derived_camera_world_tx,
            calib.derived_camera_world_ty,
            calib.derived_camera_world_tz,
        ];
        let height = f64::from(position[2].unwrap());
        let configured = scene.config.geometry.camera_mm[2];
        assert!((height - configured).abs() < 0.1 * configured, "{}: {position:?}", preset.name());
    }
}

#[test]
fn a_geometry_goes_out_without_calibration_if_there_is_no_pinhole() {
    let mut config = Preset::Vsss3v3.config();
    for pair in &mut config.geometry.points {
        pair.image_px[0] = 639.0 - pair.image_px[0];
    }
    let data = geometry(&Scene::new(&config, "test").unwrap()).geometry.unwrap();
    assert!(data.calib.is_empty() && data.field.field_length == 1500);
    config.geometry.distortion.model = DistortionModel::Fisheye;
    assert!(Scene::new(&config, "test").is_ok());
}

#[test]
fn a_group_keeps_its_uuid() {
    let [a, b, again] = ["a on x", "b on x", "a on x"].map(uuid);
    assert_eq!(a, again);
    assert_ne!(a, b);
    let parts: Vec<usize> = a.split('-').map(str::len).collect();
    assert_eq!(parts, [8, 4, 4, 4, 12], "{a}");
    assert!(a.as_bytes()[14] == b'8' && b"89ab".contains(&a.as_bytes()[19]), "{a}");
}

#[test]
fn cameras_are_numbered_as_on_the_league_s_fields() {
    assert_eq!(league_camera_ids(&[[30.0, -20.0, 6000.0]]), [0]);
    assert_eq!(league_camera_ids(&[[2250.0, 5.0, 6000.0], [-2240.0, 20.0, 6000.0]]), [1, 0]);
    let four = [[-2250.0, 1500.0], [2251.0, 1500.0], [2249.0, -1500.0], [-2251.0, -1501.0]];
    assert_eq!(league_camera_ids(&four.map(|[x, y]| [x, y, 6000.0])), [1, 3, 2, 0]);
}

#[test]
fn json_has_every_robot_and_the_ball() {
    let text = String::from_utf8(json(&world(), 1_796_083_200.125)).unwrap();
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(value["frame"], 4711);
    assert_eq!(value["t_sent"], 1_796_083_200.125);
    let columns = value["columns"].as_array().unwrap();
    let robot = value["blue"]["10"].as_array().unwrap();
    assert_eq!(columns.len(), robot.len());
    assert_eq!(columns[0], "x_mm");
    assert!((robot[0].as_f64().unwrap() - (-4_321.012_3 + 397.1 * 21.0)).abs() <= 0.05, "{text}");
    assert_eq!(value["ball"]["x_mm"], 1234.6);
}
