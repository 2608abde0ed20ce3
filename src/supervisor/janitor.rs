//! Removes from shared memory what dead processes have left: on a thread of its own, since that takes
//! tens of milliseconds, in which deaths must be noticed.
//!
//! Consumers die too, and nobody reports it: a logger that is killed again and again would soon hold
//! every place that a topic has for subscribers. So the janitor also looks around by itself.

use common::bus::Bus;
use common::instance::Instance;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Between two looks at who is alive. A topic has places for some six extra subscribers: even one
/// that dies and comes back every 100 ms leaves some free.
const ROUND: Duration = Duration::from_millis(400);

/// The thread that cleans up.
pub struct Janitor {
    call: Sender<()>,
    thread: JoinHandle<()>,
}

impl Janitor {
    /// Starts looking around.
    pub fn start(instance: &Instance) -> Self {
        let instance = instance.clone();
        let (call, calls) = channel();
        let thread = std::thread::spawn(move || {
            let mut last_error = String::new();
            while calls.recv_timeout(ROUND) != Err(RecvTimeoutError::Disconnected) {
                let error = match Bus::clean_up_dead(&instance) {
                    Ok(_) => String::new(),
                    Err(error) => error.to_string(),
                };
                // What cannot be removed is tried again and again, but told once.
                if error != last_error && !error.is_empty() {
                    eprintln!("touchline: clean-up after a dead process: {error}");
                }
                last_error = error;
            }
        });
        Self { call, thread }
    }

    /// Has it look now.
    pub fn call(&self) {
        // It is there as long as this is.
        let _ = self.call.send(());
    }

    /// Ends it, after what it is doing: half a clean-up is worse than none.
    pub fn finish(self) {
        drop(self.call);
        let _ = self.thread.join();
    }
}
