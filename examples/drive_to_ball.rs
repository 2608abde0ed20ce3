//! Drives one robot to the ball: the smallest strategy. The same in Python:
//! `scripts/python/drive_to_ball.py`.
//!
//! Start `touchline run` in one terminal and `cargo run --release --example drive_to_ball` in another;
//! robots of the synthetic match obey.

use bytemuck::Zeroable;
use client::bus::Bus;
use client::clock::monotonic_ns;
use client::consumer::{Consumer, Event};
use client::instance::Instance;
use geometry::wrap_angle;
use messages::topics;
use messages::{BallState, Commands, RobotState, Team, WheelCommand};
use std::time::Duration;

const TEAM: u32 = Team::Blue as u32;
const ROBOT_ID: u32 = 1;
const WHEEL_BASE_MM: f64 = 70.0;
const FASTEST_MM_S: f64 = 500.0;
const NEAR_MM: f64 = 70.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let name = std::env::args().nth(1).unwrap_or("default".into());
    let instance = Instance::new(&name)?;
    let mut world = Consumer::new(instance.clone(), "drive_to_ball", &topics::WORLD);
    let mut output = None;
    let mut seq = 0;
    loop {
        match world.next(Duration::from_secs(1))? {
            Some(Event::Message(received)) => {
                let Some(world) = received.message() else { continue };
                let mut robots = world.robots().iter();
                let Some(robot) = robots.find(|r| (r.team, r.robot_id) == (TEAM, ROBOT_ID)) else {
                    continue;
                };
                // Who sends commands is part of the group, for as long as the group is there.
                if output.is_none() {
                    let bus = Bus::join(&instance, "drive_to_ball")?;
                    output = Some((bus.publisher(&topics::COMMANDS, 1)?, bus));
                }
                let Some((commands, _)) = &mut output else { continue };
                let mut message = Commands { seq, t_sent_ns: monotonic_ns(), ..Zeroable::zeroed() };
                (message.wheels[0], message.wheel_count) = (towards(robot, &world.ball), 1);
                commands.publish(&message)?;
                seq += 1;
            }
            Some(Event::Left) => output = None,
            _ => {}
        }
    }
}

/// The wheel speeds that bring the robot nearer to the ball. What counts is where both will be when
/// the command acts.
fn towards(robot: &RobotState, ball: &BallState) -> WheelCommand {
    let x = ball.predicted_x_mm - robot.predicted_x_mm;
    let y = ball.predicted_y_mm - robot.predicted_y_mm;
    let turn = wrap_angle(y.atan2(x) - robot.predicted_orientation);
    let distance = (x.hypot(y) - NEAR_MM).max(0.0);
    // Straight ahead only when it looks at the ball.
    let speed = (3.0 * distance).min(FASTEST_MM_S) * turn.cos().max(0.0);
    let difference = (4.0 * turn * WHEEL_BASE_MM / 2.0).clamp(-200.0, 200.0);
    WheelCommand {
        team: TEAM,
        robot_id: ROBOT_ID,
        left_mm_s: speed - difference,
        right_mm_s: speed + difference,
    }
}
