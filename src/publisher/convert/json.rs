//! Positions and velocities as JSON.
//!
//! ```json
//! {"frame": 17, "t_capture": 1.7e9, "t_sent": 1.7e9,
//!  "columns": ["x_mm", "y_mm", "orientation_rad", "vx_mm_s", "vy_mm_s", "turn_rad_s", "visibility"],
//!  "yellow": {"0": [-500.0, 20.5, 1.5708, 300.0, 0.0, 0.0, 1.0]}, "blue": {},
//!  "ball": {"x_mm": 0.0, "y_mm": 0.0, "vx_mm_s": 0.0, "vy_mm_s": 0.0, "visibility": 1.0}}
//! ```
//!
//! A robot is a list by its number, so that two teams of eleven fit into one Ethernet frame. `ball` is null
//! when it is not known.

use super::{captured_s, exists, frame_number};
use messages::{RobotState, Team, WorldFrame};
use serde::Serialize;
use std::collections::BTreeMap;

/// Meaning of the numbers of a robot.
const COLUMNS: [&str; 7] =
    ["x_mm", "y_mm", "orientation_rad", "vx_mm_s", "vy_mm_s", "turn_rad_s", "visibility"];

#[derive(Serialize)]
struct Packet {
    frame: u32,
    t_capture: f64,
    t_sent: f64,
    columns: [&'static str; 7],
    yellow: BTreeMap<u32, [f64; 7]>,
    blue: BTreeMap<u32, [f64; 7]>,
    ball: Option<Ball>,
}

#[derive(Serialize)]
struct Ball {
    x_mm: f64,
    y_mm: f64,
    vx_mm_s: f64,
    vy_mm_s: f64,
    visibility: f64,
}

/// The text of a packet.
pub fn json(world: &WorldFrame, t_sent_s: f64) -> Vec<u8> {
    let of_team = |team: Team| {
        let robots = world.robots().iter();
        let robots = robots.filter(|robot| robot.team == team as u32 && exists(robot.status));
        robots.map(|it| (it.robot_id, robot(it))).collect()
    };
    let ball = &world.ball;
    let packet = Packet {
        frame: frame_number(&world.frame),
        t_capture: rounded(captured_s(&world.frame), 1e6),
        t_sent: rounded(t_sent_s, 1e6),
        columns: COLUMNS,
        yellow: of_team(Team::Yellow),
        blue: of_team(Team::Blue),
        ball: exists(ball.status).then(|| Ball {
            x_mm: rounded(ball.x_mm, 10.0),
            y_mm: rounded(ball.y_mm, 10.0),
            vx_mm_s: rounded(ball.vx_mm_s, 1.0),
            vy_mm_s: rounded(ball.vy_mm_s, 1.0),
            visibility: rounded(ball.visibility.into(), 100.0),
        }),
    };
    serde_json::to_vec(&packet).unwrap_or_default()
}

fn robot(robot: &RobotState) -> [f64; 7] {
    let (sin, cos) = robot.orientation.sin_cos();
    [
        rounded(robot.x_mm, 10.0),
        rounded(robot.y_mm, 10.0),
        rounded(robot.orientation, 1e4),
        rounded(robot.v_mm_s * cos, 1.0),
        rounded(robot.v_mm_s * sin, 1.0),
        rounded(robot.omega, 100.0),
        rounded(robot.visibility.into(), 100.0),
    ]
}

/// Rounded to so many parts of one; −0 becomes 0.
fn rounded(value: f64, parts: f64) -> f64 {
    (value * parts).round() / parts + 0.0
}
