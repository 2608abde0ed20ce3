//! The runtime of every attendant: a process of a group that serves users or other programs, and that
//! no stage needs.
//!
//! An attendant reads topics like any consumer. The supervisor starts it when the group is complete,
//! restarts it when it ends or sends no heartbeat, and ends it with the group. When memory runs out,
//! the system kills attendants among the first. SIGTERM asks an attendant to end.

use crate::memory_rank::{self, MemoryRank};
use crate::orphan::OrphanTimer;
use crate::process::{HEARTBEAT, ProcessError, system};
use client::bus::{Bus, Publisher};
use client::clock::monotonic_ns;
use client::instance::Instance;
use config::Config;
use messages::topics;
use messages::{Attendant, Heartbeat, ProcessState};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The process of an attendant.
pub struct AttendantProcess {
    /// The process's membership in the group.
    pub bus: Bus,
    /// Counters so far; sent with every heartbeat.
    counters: Heartbeat,
    health: Publisher<Heartbeat, ()>,
    stop: Arc<AtomicBool>,
    orphan_timer: OrphanTimer,
    beat_ns: u64,
}

impl AttendantProcess {
    /// Joins the group, and handles signals from here on.
    pub fn start(
        attendant: Attendant,
        instance: &Instance,
        config: &Config,
        supervised: bool,
    ) -> Result<Self, ProcessError> {
        // An error is ignored: the rank is only a preference.
        let _ = memory_rank::set(MemoryRank::Attendant);
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
            signal_hook::flag::register(signal, Arc::clone(&stop))
                .map_err(system("handle signals"))?;
        }
        let bus = Bus::join(instance, attendant.name())?;
        bus.enter_roster();
        Ok(Self {
            health: bus.publisher(&topics::HEALTH, 1)?,
            bus,
            counters: Heartbeat::new(attendant as u32, ProcessState::Active),
            stop,
            orphan_timer: OrphanTimer::new(instance, config, supervised),
            beat_ns: 0,
        })
    }

    /// A flag that becomes true when the process is to end, for its other threads.
    pub fn stop(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.stop)
    }

    /// Sends the heartbeat when it is due, after `count` has updated the counters, and returns whether
    /// to continue. To be called at least every [`MAX_WAIT`](crate::process::MAX_WAIT).
    pub fn keep_running(
        &mut self,
        count: impl FnOnce(&mut Heartbeat),
    ) -> Result<bool, ProcessError> {
        if self.stop.load(Ordering::Relaxed) {
            return Ok(false);
        }
        let now_ns = monotonic_ns();
        if now_ns.saturating_sub(self.beat_ns) < HEARTBEAT.as_nanos() as u64 {
            return Ok(true);
        }
        self.beat_ns = now_ns;
        count(&mut self.counters);
        self.counters.t_sent_ns = now_ns;
        self.health.publish(&self.counters)?;
        self.bus.refresh(false)?;
        Ok(self.orphan_timer.may_continue(now_ns))
    }
}
