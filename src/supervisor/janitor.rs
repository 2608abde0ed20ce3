//! Removes the garbage of dead processes from shared memory, on a thread of its own: it takes tens of
//! milliseconds, during which the supervisor must still notice deaths.
//!
//! Deaths of consumers are not reported: a logger that is killed again and again would soon hold every
//! subscriber slot of a topic. So the janitor also looks by itself when a process has joined, which may
//! be a restarted one, and now and then in any case.

use super::reserve;
use super::sys::{self, Call};
use client::bus::participants::{self, HalfJoined};
use client::instance::Instance;
use std::collections::BTreeSet;
use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Time between two looks for joined processes. A topic has some six extra subscriber slots: even a
/// consumer that dies and returns every 100 ms leaves some free.
const ROUND: Duration = Duration::from_millis(300);
/// Quiet rounds after which the janitor checks which processes are alive, which takes two
/// milliseconds: a death alone is not announced.
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
    /// Starts the thread; if that fails, [`keep_running`](Self::keep_running) retries it.
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

    /// Makes it look now.
    pub fn call(&self) {
        if let Some(running) = &self.running {
            // The receiver lives as long as the thread.
            let _ = running.call.send(());
        }
    }

    /// Ends the thread after the clean-up in progress: half a clean-up is worse than none.
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
                runtime::tell!("touchline: {strange}");
            }
        }
        let error = removed.err().unwrap_or_default();
        if !error.is_empty() {
            // Descriptors may have run out.
            reserve::raise_limit();
        }
        // A failed removal is retried, but reported once.
        if error != last_error && !error.is_empty() {
            runtime::tell!("touchline: clean-up after a dead process: {error}; it is tried again");
        }
        last_error = error;
        if !last_error.is_empty() {
            known = None;
        }
    }
}

/// Warnings about files that programs with other versions of iceoryx2 made in the group.
fn strange_versions(instance: &Instance) -> Vec<String> {
    let namespace = instance.namespace().ok().flatten();
    namespace.and_then(|namespace| namespace.strange_versions().ok()).unwrap_or_default()
}
