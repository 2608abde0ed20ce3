//! SSL-Vision's geometry: the field's sizes, lines and arcs, and the calibration of the camera.

use super::Scene;
use offline::calibration::Pinhole;
use protocols::ssl_geometry::{
    CameraCalibration, CircularArc, FieldSize, GeometryData, LineSegment, ShapeType, Vector2,
};
use protocols::ssl_vision::{Source, WrapperPacket};
use std::f32::consts::TAU;

/// The geometry. Without a pinhole camera close to ours there is no calibration.
pub fn geometry(scene: &Scene) -> WrapperPacket {
    let calib = scene.pinhole.iter().map(|pinhole| calibration(scene, pinhole)).collect();
    WrapperPacket {
        detection: None,
        geometry: Some(GeometryData { field: field(scene), calib }),
        source: Some(Source::Other as i32),
    }
}

fn field(scene: &Scene) -> FieldSize {
    let config = &scene.config;
    let (field, markings) = (&config.field, &config.publish.markings);
    let mm = |value: f64| value.round() as i32;
    FieldSize {
        field_length: mm(field.length_mm),
        field_width: mm(field.width_mm),
        goal_width: mm(field.goal_width_mm),
        goal_depth: mm(field.goal_depth_mm),
        boundary_width: mm(markings.boundary_mm),
        field_lines: lines(scene),
        field_arcs: vec![CircularArc {
            name: ShapeType::CenterCircle.name().into(),
            center: Vector2 { x: 0.0, y: 0.0 },
            radius: field.center_circle_radius_mm as f32,
            a1: 0.0,
            a2: TAU,
            thickness: markings.line_width_mm as f32,
            kind: Some(ShapeType::CenterCircle as i32),
        }],
        penalty_area_depth: Some(mm(markings.penalty_depth_mm)),
        penalty_area_width: Some(mm(markings.penalty_width_mm)),
        center_circle_radius: Some(mm(field.center_circle_radius_mm)),
        line_thickness: Some(mm(markings.line_width_mm)),
        goal_center_to_penalty_mark: Some(mm(markings.penalty_mark_mm)),
        goal_height: Some(mm(markings.goal_height_mm)),
        ball_radius: Some(scene.ball_radius_mm() as f32),
        max_robot_radius: Some((config.robots.size_mm / 2.0) as f32),
        boundary_width_goal_line: Some(mm(markings.goal_boundary_mm)),
        goal_substitution_area_width: Some(0),
    }
}

fn lines(scene: &Scene) -> Vec<LineSegment> {
    use ShapeType::*;
    let (field, markings) = (&scene.config.field, &scene.config.publish.markings);
    let (x, y) = (field.length_mm / 2.0, field.width_mm / 2.0);
    let (front, side) = (x - markings.penalty_depth_mm, markings.penalty_width_mm / 2.0);
    let point = |[x, y]: [f64; 2]| Vector2 { x: x as f32, y: y as f32 };
    let line = |kind: ShapeType, from, to| LineSegment {
        name: kind.name().into(),
        p1: point(from),
        p2: point(to),
        thickness: markings.line_width_mm as f32,
        kind: Some(kind as i32),
    };
    let mut lines = vec![
        line(TopTouchLine, [-x, y], [x, y]),
        line(BottomTouchLine, [-x, -y], [x, -y]),
        line(LeftGoalLine, [-x, -y], [-x, y]),
        line(RightGoalLine, [x, -y], [x, y]),
        line(HalfwayLine, [0.0, -y], [0.0, y]),
        line(CenterLine, [-x, 0.0], [x, 0.0]),
    ];
    if markings.penalty_depth_mm > 0.0 && markings.penalty_width_mm > 0.0 {
        lines.extend([
            line(LeftPenaltyStretch, [-front, -side], [-front, side]),
            line(RightPenaltyStretch, [front, -side], [front, side]),
            line(LeftFieldLeftPenaltyStretch, [-x, -side], [-front, -side]),
            line(LeftFieldRightPenaltyStretch, [-x, side], [-front, side]),
            line(RightFieldLeftPenaltyStretch, [x, side], [front, side]),
            line(RightFieldRightPenaltyStretch, [x, -side], [front, -side]),
        ]);
    }
    lines
}

fn calibration(scene: &Scene, pinhole: &Pinhole) -> CameraCalibration {
    let camera = &scene.config.camera;
    let [q0, q1, q2, q3] = pinhole.camera_from_field.map(|part| part as f32);
    let [tx, ty, tz] = pinhole.translation_mm.map(|part| part as f32);
    let [x, y, z] = pinhole.position_mm.map(|part| part as f32);
    CameraCalibration {
        camera_id: scene.camera_id(0),
        focal_length: pinhole.focal_px as f32,
        principal_point_x: pinhole.principal_point_px[0] as f32,
        principal_point_y: pinhole.principal_point_px[1] as f32,
        distortion: pinhole.distortion as f32,
        q0,
        q1,
        q2,
        q3,
        tx,
        ty,
        tz,
        derived_camera_world_tx: Some(x),
        derived_camera_world_ty: Some(y),
        derived_camera_world_tz: Some(z),
        pixel_image_width: Some(camera.width),
        pixel_image_height: Some(camera.height),
    }
}
