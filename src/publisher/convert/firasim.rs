//! FIRASim's environment.

use super::{Scene, exists, frame_number};
use messages::{RobotState, Team, WorldFrame};
use protocols::firasim::{Ball, Environment, Field, Frame, Robot};

/// Metres per millimetre.
const M: f64 = 1e-3;

/// Positions and velocities at the time of capture. Goals are not counted, and a ball that is not known is
/// absent.
pub fn environment(scene: &Scene, world: &WorldFrame) -> Environment {
    let of_team = |team: Team| {
        let robots = world.robots().iter();
        robots
            .filter(|robot| robot.team == team as u32 && exists(robot.status))
            .map(robot)
            .collect()
    };
    let ball = &world.ball;
    Environment {
        step: frame_number(&world.frame),
        frame: Some(Frame {
            ball: exists(ball.status).then(|| Ball {
                x: ball.x_mm * M,
                y: ball.y_mm * M,
                z: scene.ball_radius_mm() * M,
                vx: ball.vx_mm_s * M,
                vy: ball.vy_mm_s * M,
                vz: 0.0,
            }),
            robots_yellow: of_team(Team::Yellow),
            robots_blue: of_team(Team::Blue),
        }),
        field: Some(field(scene)),
        goals_blue: 0,
        goals_yellow: 0,
    }
}

fn robot(robot: &RobotState) -> Robot {
    let (sin, cos) = robot.orientation.sin_cos();
    Robot {
        robot_id: robot.robot_id,
        x: robot.x_mm * M,
        y: robot.y_mm * M,
        orientation: robot.orientation,
        vx: robot.v_mm_s * cos * M,
        vy: robot.v_mm_s * sin * M,
        vorientation: robot.omega,
    }
}

fn field(scene: &Scene) -> Field {
    let (field, markings) = (&scene.config.field, &scene.config.publish.markings);
    Field {
        width: field.width_mm * M,
        length: field.length_mm * M,
        goal_width: field.goal_width_mm * M,
        goal_depth: field.goal_depth_mm * M,
        center_radius: field.center_circle_radius_mm * M,
        penalty_width: markings.penalty_width_mm * M,
        penalty_depth: markings.penalty_depth_mm * M,
        penalty_point: markings.penalty_mark_mm * M,
    }
}
