//! Prints where the robots of a group are: the smallest consumer. It waits for the group to start,
//! outlives its restarts, and says what it has missed.
//!
//! Start `touchline run` in one terminal and `cargo run --release --example poses` in another.

use client::consumer::{Consumer, Event};
use client::instance::Instance;
use messages::topics;
use std::io::Write;
use std::time::Duration;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let name = std::env::args().nth(1).unwrap_or("default".into());
    let mut world = Consumer::new(Instance::new(&name)?, "poses", &topics::WORLD);
    loop {
        match world.next(Duration::from_secs(1))? {
            Some(Event::Message(received)) => {
                for robot in received.message().into_iter().flat_map(|world| world.robots()) {
                    let degrees = robot.orientation.to_degrees();
                    let line = format!(
                        "team {} robot {}: {:.1} mm, {:.1} mm, {degrees:.1}°",
                        robot.team, robot.robot_id, robot.x_mm, robot.y_mm
                    );
                    // The reader of a pipe may have ended.
                    if writeln!(std::io::stdout(), "{line}").is_err() {
                        return Ok(());
                    }
                }
            }
            Some(Event::Missed(count)) => eprintln!("missed {count} frames"),
            Some(Event::Joined) => eprintln!("the group {name:?} is there"),
            Some(Event::Restarted) => eprintln!("another match has begun"),
            Some(Event::Left) => eprintln!("the group has ended"),
            None => {}
        }
    }
}
