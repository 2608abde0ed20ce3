//! Attaches to the group of another user and says how late its messages come.
//!
//! Name the users who may in the group's configuration (`access.group`), and let its owner tell you the
//! socket (`touchline status`):
//!
//! ```text
//! cargo run --release --example gateway -- /run/touchline-match/match.gateway/socket
//! ```
//!
//! With the name of the group as second argument its owner can compare: the same messages are then
//! also read from shared memory.

use client::clock::monotonic_ns;
use client::consumer::{Consumer, Event};
use client::gateway::Client;
use client::instance::Instance;
use messages::WorldFrame;
use messages::topics;
use std::error::Error;
use std::path::Path;
use std::time::Duration;

/// Frames between two lines.
const FRAMES: usize = 400;

/// How late messages come.
struct Delays {
    way: &'static str,
    us: Vec<u64>,
}

impl Delays {
    fn note(&mut self, world: &WorldFrame) {
        self.us.push(monotonic_ns().saturating_sub(world.t_sent_ns) / 1000);
        if self.us.len() == FRAMES {
            self.us.sort_unstable();
            let (half, most) = (self.us[FRAMES / 2], self.us[FRAMES * 99 / 100]);
            let robots = world.robots().len();
            println!("{}: {half} µs (half), {most} µs (99 of 100); {robots} robots", self.way);
            self.us.clear();
        }
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("which socket?")?;
    if let Some(name) = std::env::args().nth(2) {
        let instance = Instance::new(&name)?;
        std::thread::spawn(move || {
            let mut consumer = Consumer::new(instance, "compare", &topics::WORLD);
            let mut delays = Delays { way: "shared memory", us: Vec::new() };
            while let Ok(event) = consumer.next(Duration::from_secs(1)) {
                if let Some(Event::Message(received)) = event {
                    received.message().into_iter().for_each(|world| delays.note(world));
                }
            }
        });
    }
    let mut client = Client::new(Path::new(&path));
    let mut delays = Delays { way: "gateway", us: Vec::new() };
    loop {
        match client.next(Duration::from_secs(1))? {
            Some(Event::Message(world)) => delays.note(&world),
            Some(other) => println!("{other:?}"),
            None => println!("nothing comes"),
        }
    }
}
