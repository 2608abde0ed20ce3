//! `touchline step`: shows the next frames of a recording that is played step by step.

use super::CommandError;
use super::group::running;
use crate::cli::StepArgs;
use client::consumer::{Consumer, Event};
use grabber::playback::request_steps;
use messages::topics;
use messages::{Team, TrackStatus, WorldFrame};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// A working group answers within milliseconds; one whose stages are being replaced takes longer.
const PATIENCE: Duration = Duration::from_secs(10);

/// Requests frames, and prints the poses of each.
pub fn step(args: StepArgs) -> Result<ExitCode, CommandError> {
    let instance = running(&args.instance)?;
    let mut world = Consumer::new(instance.clone(), "step", &topics::WORLD);
    // Connected before the request, so that no answer is missed.
    while world.next(Duration::ZERO)?.is_some() {}
    request_steps(&instance, args.frames).map_err(|error| {
        format!(
            "the group {:?} is not waiting for steps ({error}); start one with `touchline run --source \
             recording:FILE,step`",
            instance.name()
        )
    })?;
    let mut left = args.frames;
    let mut heard = Instant::now();
    while left > 0 {
        match world.next(Duration::from_millis(100))? {
            Some(Event::Message(received)) => {
                heard = Instant::now();
                left -= 1;
                if let Some(world) = received.message() {
                    runtime::say_line!("{}", line(world))?;
                }
            }
            // Numbers missing in the recording, or steps requested by another program, too fast to be
            // read.
            Some(Event::Missed(_) | Event::Joined | Event::Restarted) => {}
            Some(Event::Left) => return Err("the group has ended".into()),
            None if heard.elapsed() > PATIENCE => {
                return Err(format!("{left} of {} frames did not come", args.frames).into());
            }
            None => {}
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// A frame with the poses of robots and ball, in millimetres and degrees; in parentheses those not seen
/// or not recognised. Robots of which only the team is known have the number of their track after a `?`.
fn line(world: &WorldFrame) -> String {
    let text = |status: u32, text: String| match TrackStatus::from_number(status) {
        None | Some(TrackStatus::Absent) => String::new(),
        Some(TrackStatus::Initialised | TrackStatus::Measured) => format!("  {text}"),
        Some(TrackStatus::Coasting | TrackStatus::Gated | TrackStatus::Located) => {
            format!("  ({text})")
        }
    };
    let robots = world.robots().iter().map(|robot| {
        let team = Team::from_number(robot.team).map_or("?", Team::name);
        let (x, y, degrees) = (robot.x_mm, robot.y_mm, robot.orientation.to_degrees());
        text(robot.status, format!("{team} {} {x:.0} {y:.0} {degrees:.0}°", robot.robot_id))
    });
    let unknown = world.unknown_robots().iter().map(|robot| {
        let team = Team::from_number(robot.team).map_or("?", Team::name);
        let (x, y) = (robot.x_mm, robot.y_mm);
        text(robot.status, format!("{team} ?{} {x:.0} {y:.0}", robot.track_id))
    });
    let ball = &world.ball;
    let ball = text(ball.status, format!("ball {:.0} {:.0}", ball.x_mm, ball.y_mm));
    format!("frame {}:{}{ball}", world.frame.seq, robots.chain(unknown).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn unseen_robots_are_in_parentheses() {
        let mut world = WorldFrame::zeroed();
        world.frame.seq = 17;
        assert_eq!(line(&world), "frame 17:");
        world.robot_count = 2;
        for (robot, status) in
            world.robots.iter_mut().zip([TrackStatus::Measured, TrackStatus::Coasting])
        {
            (robot.status, robot.team, robot.robot_id) = (status as u32, Team::Blue as u32, 3);
            (robot.x_mm, robot.orientation) = (-12.4, std::f64::consts::FRAC_PI_2);
        }
        (world.ball.status, world.ball.y_mm) = (TrackStatus::Measured as u32, 5.0);
        assert_eq!(line(&world), "frame 17:  blue 3 -12 0 90°  (blue 3 -12 0 90°)  ball 0 5");
        (world.robot_count, world.unknown_robot_count) = (0, 1);
        let unknown = &mut world.unknown_robots[0];
        (unknown.status, unknown.track_id, unknown.x_mm) = (TrackStatus::Measured as u32, 12, 7.0);
        assert_eq!(line(&world), "frame 17:  yellow ?12 7 0  ball 0 5");
    }
}
