//! SSL-Vision's detection frames.

use super::{Scene, captured_s, exists, frame_number};
use geometry::FieldPoint;
use messages::{DetectionFrame, FrameHeader, Team, WorldFrame};
use protocols::ssl_vision::{self, DetectionBall, DetectionRobot, Source, WrapperPacket};
use protocols::{Message, ONE_FRAME_BYTES};

/// A frame as the tracker found it: robots and balls of this frame alone.
pub fn of_detections(scene: &Scene, frame: &DetectionFrame, t_sent_s: f64) -> WrapperPacket {
    let mut out = begun(scene, &frame.frame, t_sent_s);
    for robot in frame.robots() {
        let Some(robot_id) = robot.robot_id.number() else { continue };
        let detected = DetectionRobot {
            confidence: robot.confidence,
            robot_id: Some(robot_id),
            x: robot.x_mm,
            y: robot.y_mm,
            orientation: Some(robot.orientation),
            pixel_x: robot.x_px,
            pixel_y: robot.y_px,
            height: Some(scene.config.top(robot.team, Some(robot_id)).height_mm as f32),
        };
        add(&mut out, robot.team, detected);
    }
    out.balls = frame
        .balls()
        .iter()
        .map(|ball| DetectionBall {
            confidence: ball.confidence,
            area: frame.regions().get(ball.region as usize).map(|region| region.pixel_count),
            x: ball.x_mm,
            y: ball.y_mm,
            z: Some(0.0),
            pixel_x: ball.x_px,
            pixel_y: ball.y_px,
        })
        .collect();
    packet(out)
}

/// A frame as the filter knows it: robots and ball without gaps. The confidence is the visibility, which
/// falls while something is not seen.
pub fn of_world(scene: &Scene, world: &WorldFrame, t_sent_s: f64) -> WrapperPacket {
    let mut out = begun(scene, &world.frame, t_sent_s);
    let pixel = |x_mm, y_mm, height_mm| {
        let seen = scene.camera.image_from_field(FieldPoint::new(x_mm, y_mm), height_mm);
        (seen.x_px as f32, seen.y_px as f32)
    };
    for robot in world.robots().iter().filter(|robot| exists(robot.status)) {
        let height_mm = scene.config.top(robot.team, Some(robot.robot_id)).height_mm;
        let (pixel_x, pixel_y) = pixel(robot.x_mm, robot.y_mm, height_mm);
        let detected = DetectionRobot {
            confidence: robot.visibility,
            robot_id: Some(robot.robot_id),
            x: robot.x_mm as f32,
            y: robot.y_mm as f32,
            orientation: Some(robot.orientation as f32),
            pixel_x,
            pixel_y,
            height: Some(height_mm as f32),
        };
        add(&mut out, robot.team, detected);
    }
    let ball = &world.ball;
    if exists(ball.status) {
        let (pixel_x, pixel_y) = pixel(ball.x_mm, ball.y_mm, scene.ball_radius_mm());
        out.balls.push(DetectionBall {
            confidence: ball.visibility,
            area: None,
            x: ball.x_mm as f32,
            y: ball.y_mm as f32,
            z: Some(0.0),
            pixel_x,
            pixel_y,
        });
    }
    packet(out)
}

fn begun(scene: &Scene, frame: &FrameHeader, t_sent_s: f64) -> ssl_vision::DetectionFrame {
    ssl_vision::DetectionFrame {
        frame_number: frame_number(frame),
        t_capture: captured_s(frame),
        t_sent: t_sent_s,
        camera_id: scene.camera_id(frame.camera_id),
        ..Default::default()
    }
}

fn add(out: &mut ssl_vision::DetectionFrame, team: u32, robot: DetectionRobot) {
    match Team::from_number(team) {
        Some(Team::Yellow) => out.robots_yellow.push(robot),
        Some(Team::Blue) => out.robots_blue.push(robot),
        None => {}
    }
}

/// The packet; the least likely balls are left out if it would not fit into one Ethernet frame.
fn packet(detection: ssl_vision::DetectionFrame) -> WrapperPacket {
    let mut packet = WrapperPacket {
        detection: Some(detection),
        geometry: None,
        source: Some(Source::Other as i32),
    };
    while packet.encoded_len() > ONE_FRAME_BYTES
        && packet.detection.as_mut().is_some_and(|detection| detection.balls.pop().is_some())
    {}
    packet
}
