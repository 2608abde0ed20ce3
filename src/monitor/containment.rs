//! Containment: a fault in the monitor's thread does not end the supervisor's process.
//!
//! The monitor runs beside the supervisor in one process, and in release builds a panic anywhere ends the
//! process, as does a SIGBUS (shared memory that the system cannot provide, a truncated file). Both are
//! caught here first: if the monitor's thread causes them, that thread stops for good where it is, and the
//! supervisor starts another one. Its slots on topics and its memory are lost until the supervisor ends, so
//! the number of restarts is limited
//! ([`Monitor::has_fallen`](super::Monitor::has_fallen)).

use std::io;
use std::panic;
use std::sync::Once;
use std::sync::atomic::{AtomicI32, AtomicU32, Ordering};
use std::time::Duration;

/// System id of the contained thread; 0 if there is none.
static CONTAINED: AtomicI32 = AtomicI32::new(0);
/// Number of stopped threads.
static FALLEN: AtomicU32 = AtomicU32::new(0);

/// Contains faults of the calling thread from now on.
pub fn contain_this_thread() {
    static PREPARED: Once = Once::new();
    PREPARED.call_once(|| {
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |panic| {
            if !is_contained() {
                return before(panic);
            }
            runtime::tell!("touchline: the monitor has panicked: {panic}");
            fall();
        }));
        // Without it, a SIGBUS ends the group's supervisor, and the next one takes over.
        let _ = catch_bus_errors();
    });
    CONTAINED.store(own_number(), Ordering::Release);
}

/// Number of contained threads stopped so far.
pub fn fallen() -> u32 {
    FALLEN.load(Ordering::Acquire)
}

fn own_number() -> i32 {
    rustix::thread::gettid().as_raw_nonzero().get()
}

fn is_contained() -> bool {
    CONTAINED.load(Ordering::Acquire) == own_number()
}

/// Stops this thread for good. Async-signal-safe.
fn fall() -> ! {
    FALLEN.fetch_add(1, Ordering::Release);
    loop {
        std::thread::sleep(Duration::from_secs(3600));
    }
}

#[allow(unsafe_code)] // handlers of signals may do but little
fn catch_bus_errors() -> io::Result<()> {
    let handler = || {
        if is_contained() {
            fall();
        }
        let _ = signal_hook::low_level::emulate_default_handler(signal_hook::consts::SIGBUS);
    };
    // SAFETY: the handler reads and adds to atomic numbers, asks for the thread's id, sleeps, or performs
    // the signal's default action. None of this takes a lock or memory.
    unsafe { signal_hook::low_level::register(signal_hook::consts::SIGBUS, handler) }.map(drop)
}
