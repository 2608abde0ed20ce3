//! Attaches to the group of another user and says how late its messages come.
//!
//! Name the users who may in the group's configuration (`access.group`), and let its owner tell you the
//! socket (`touchline status`):
//!
//! ```text
//! cargo run --example gateway -- /run/touchline-match/match.gateway/socket
//! ```

use common::clock::monotonic_ns;
use common::gateway::{Client, Event};
use std::error::Error;
use std::path::Path;
use std::time::Duration;

/// Frames between two lines.
const FRAMES: usize = 400;

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("which socket?")?;
    let mut client = Client::new(Path::new(&path));
    let mut late_us = Vec::with_capacity(FRAMES);
    loop {
        match client.next(Duration::from_secs(1))? {
            Some(Event::World(world)) => {
                late_us.push(monotonic_ns().saturating_sub(world.t_sent_ns) / 1000);
                if late_us.len() == FRAMES {
                    late_us.sort_unstable();
                    println!(
                        "{} robots; after the filter has sent it, `world` is here within {} µs (half), {} \
                         µs (99 of 100)",
                        world.robots().len(),
                        late_us[FRAMES / 2],
                        late_us[FRAMES * 99 / 100]
                    );
                    late_us.clear();
                }
            }
            Some(other) => println!("{other:?}"),
            None => println!("nothing comes"),
        }
    }
}
