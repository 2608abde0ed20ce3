//! The runtime of every attendant: a process of a group that serves people or programs and no stage needs.
//!
//! An attendant reads topics as any consumer does. The supervisor starts it when the group is complete, starts it
//! again when it ends or gives no sign of life, and ends it with the group; it is among the first that the
//! system kills when memory runs out. SIGTERM asks it to end.

use crate::bus::{Bus, Publisher};
use crate::clock::monotonic_ns;
use crate::config::Config;
use crate::instance::Instance;
use crate::memory_rank::{self, MemoryRank};
use crate::messages::{Attendant, Heartbeat, ProcessState};
use crate::orphan::Orphanhood;
use crate::process::{HEARTBEAT, ProcessError, system};
use crate::topics;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// An attendant's process, from its start to its end.
pub struct AttendantProcess {
    /// Its membership in the group.
    pub bus: Bus,
    /// Goes out with every heartbeat.
    counters: Heartbeat,
    health: Publisher<Heartbeat, ()>,
    stop: Arc<AtomicBool>,
    orphanhood: Orphanhood,
    beat_ns: u64,
}

impl AttendantProcess {
    /// Joins the group. Signals are handled from here on.
    pub fn start(
        attendant: Attendant,
        instance: &Instance,
        config: &Config,
        supervised: bool,
    ) -> Result<Self, ProcessError> {
        // The match can do without it; that it cannot be said is no reason not to work.
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
            orphanhood: Orphanhood::new(instance, config, supervised),
            beat_ns: 0,
        })
    }

    /// Becomes true when the process is to end; for its other threads.
    pub fn stop(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.stop)
    }

    /// Sends the heartbeat when it is due, after `count` has entered what there is to count, and says whether to
    /// go on. To be called at least every [`LOOK_AROUND`](crate::process::LOOK_AROUND).
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
        Ok(self.orphanhood.may_go_on(now_ns))
    }
}
