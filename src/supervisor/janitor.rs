//! Removes from shared memory what dead processes have left: on a thread of its own, since that takes
//! tens of milliseconds, in which deaths must be noticed.
//!
//! Consumers die too, and nobody reports it: a logger that is killed again and again would soon hold
//! every place that a topic has for subscribers. So the janitor looks around by itself when somebody has
//! come, who may have come again, and now and then in any case.

use super::reserve;
use super::sys::{self, Call};
use common::bus::participants::{self, HalfJoined};
use common::instance::Instance;
use std::collections::BTreeSet;
use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Between two looks at whether somebody has come or gone. A topic has places for some six extra
/// subscribers: even one that dies and comes back every 100 ms leaves some free.
const ROUND: Duration = Duration::from_millis(300);
/// Who is alive takes two milliseconds to find out. After so many quiet rounds it is done all the same:
/// a death alone is heard of nowhere.
const QUIET_ROUNDS: u32 = 30;

/// The thread that cleans up.
pub struct Janitor {
    instance: Instance,
    running: Option<Running>,
}

struct Running {
    call: Sender<()>,
    thread: JoinHandle<()>,
}

impl Janitor {
    /// Starts looking around, now or, where no thread can be had, later.
    pub fn start(instance: &Instance) -> Self {
        let mut janitor = Self { instance: instance.clone(), running: None };
        let _ = janitor.keep_running();
        janitor
    }

    /// Starts the thread if there is none.
    pub fn keep_running(&mut self) -> io::Result<()> {
        if self.running.is_none() {
            let instance = self.instance.clone();
            let (call, calls) = channel();
            let start = || {
                let thread = std::thread::Builder::new().name("janitor".into());
                thread.spawn(move || clean_up(&instance, &calls))
            };
            let thread = sys::ask(Call::StartThread, start)?;
            self.running = Some(Running { call, thread });
        }
        Ok(())
    }

    /// Has it look now.
    pub fn call(&self) {
        if let Some(running) = &self.running {
            // It is there as long as this is.
            let _ = running.call.send(());
        }
    }

    /// Ends it, after what it is doing: half a clean-up is worse than none.
    pub fn finish(self) {
        if let Some(Running { call, thread }) = self.running {
            drop(call);
            let _ = thread.join();
        }
    }
}

fn clean_up(instance: &Instance, calls: &Receiver<()>) {
    let mut last_error = String::new();
    let mut half_joined = HalfJoined::default();
    let mut told = BTreeSet::new();
    let (mut known, mut quiet_rounds) = (None, 0);
    loop {
        let called = match calls.recv_timeout(ROUND) {
            Ok(()) => true,
            Err(RecvTimeoutError::Timeout) => false,
            Err(RecvTimeoutError::Disconnected) => break,
        };
        let changed_at = participants::changed_at(instance);
        quiet_rounds += 1;
        if !called && changed_at == known && quiet_rounds < QUIET_ROUNDS {
            continue;
        }
        (known, quiet_rounds) = (changed_at, 0);
        let removed = match sys::fault(Call::ListProcesses) {
            Some(error) => Err(error.to_string()),
            None => participants::remove_dead(instance)
                .and_then(|_| half_joined.remove(instance))
                .map_err(|error| error.to_string()),
        };
        for strange in strange_versions(instance) {
            if told.insert(strange.clone()) {
                common::tell!("touchline: {strange}");
            }
        }
        let error = removed.err().unwrap_or_default();
        if !error.is_empty() {
            // It may have been for want of descriptors.
            reserve::raise_limit();
        }
        // A failed removal is retried, but reported once.
        if error != last_error && !error.is_empty() {
            common::tell!("touchline: clean-up after a dead process: {error}; it is tried again");
        }
        last_error = error;
        if !last_error.is_empty() {
            known = None;
        }
    }
}

/// What programs with other versions of iceoryx2 have made in the group, in words.
fn strange_versions(instance: &Instance) -> Vec<String> {
    let namespace = instance.namespace().ok().flatten();
    namespace.and_then(|namespace| namespace.strange_versions().ok()).unwrap_or_default()
}
