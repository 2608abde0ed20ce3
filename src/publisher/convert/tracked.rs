//! Frames of an SSL tracker.

use super::{Scene, captured_s, exists, frame_number};
use messages::{BallState, RobotState, Team, WorldFrame};
use protocols::ssl_tracked::{
    self, RobotId, TrackedBall, TrackedFrame, TrackedRobot, TrackerPacket, Vector2, Vector3,
};

/// Metres per millimetre.
const M: f64 = 1e-3;

/// Positions and velocities at the time of capture.
///
/// No capability is claimed: one ball is followed, on the floor, and kicks are not told.
pub fn tracked(scene: &Scene, world: &WorldFrame) -> TrackerPacket {
    let robots = world.robots().iter().filter(|robot| exists(robot.status));
    TrackerPacket {
        uuid: scene.uuid.clone(),
        source_name: Some(scene.config.publish.tracked.source_name.clone()),
        tracked_frame: Some(TrackedFrame {
            frame_number: frame_number(&world.frame),
            timestamp: captured_s(&world.frame),
            balls: exists(world.ball.status).then(|| ball(&world.ball)).into_iter().collect(),
            robots: robots.filter_map(robot).collect(),
            kicked_ball: None,
            capabilities: vec![],
        }),
    }
}

fn ball(ball: &BallState) -> TrackedBall {
    let vector = |x: f64, y: f64| Vector3 { x: (x * M) as f32, y: (y * M) as f32, z: 0.0 };
    TrackedBall {
        pos: vector(ball.x_mm, ball.y_mm),
        vel: Some(vector(ball.vx_mm_s, ball.vy_mm_s)),
        visibility: Some(ball.visibility),
    }
}

fn robot(robot: &RobotState) -> Option<TrackedRobot> {
    let team = match Team::from_number(robot.team)? {
        Team::Yellow => ssl_tracked::Team::Yellow,
        Team::Blue => ssl_tracked::Team::Blue,
    };
    let (sin, cos) = robot.orientation.sin_cos();
    let vector = |x: f64, y: f64| Vector2 { x: (x * M) as f32, y: (y * M) as f32 };
    Some(TrackedRobot {
        robot_id: RobotId { id: Some(robot.robot_id), team: Some(team as i32) },
        pos: vector(robot.x_mm, robot.y_mm),
        orientation: robot.orientation as f32,
        vel: Some(vector(robot.v_mm_s * cos, robot.v_mm_s * sin)),
        vel_angular: Some(robot.omega as f32),
        visibility: Some(robot.visibility),
    })
}
