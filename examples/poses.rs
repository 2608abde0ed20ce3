//! Prints where the robots of a running group are: the smallest consumer.
//!
//! Start `touchline run` in one terminal and `cargo run --release --example poses` in another.

use common::{bus::Bus, instance::Instance, topics};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let name = std::env::args().nth(1).unwrap_or("default".into());
    let bus = Bus::join(&Instance::new(&name)?, "poses")?;
    let world = bus.subscriber(&topics::WORLD)?;
    let mut wake_up = bus.wake_up(&topics::WORLD)?;
    loop {
        while let Some(received) = world.receive()? {
            for robot in received.message().into_iter().flat_map(|world| world.robots()) {
                let degrees = robot.orientation.to_degrees();
                println!(
                    "team {} robot {}: {:.1} mm, {:.1} mm, {degrees:.1}°",
                    robot.team, robot.robot_id, robot.x_mm, robot.y_mm
                );
            }
        }
        wake_up.wait(std::time::Duration::from_millis(100));
    }
}
