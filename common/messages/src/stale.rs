//! Clearing the stale elements behind the ends of lists.

use super::{Commands, DetectionFrame, Heartbeat, TruthFrame, WorldFrame};
use bytemuck::Zeroable;

/// Messages live in memory that is reused, so elements beyond the count of a list are stale. Programs
/// that keep or compare messages byte by byte clear them with this.
pub trait ClearStale {
    /// Fills everything beyond the counts of lists with zeros.
    fn clear_stale(&mut self);
}

fn clear<T: Zeroable>(items: &mut [T], count: u32) {
    if let Some(stale) = items.get_mut(count as usize..) {
        stale.fill_with(T::zeroed);
    }
}

impl ClearStale for DetectionFrame {
    fn clear_stale(&mut self) {
        clear(&mut self.robots, self.robot_count);
        clear(&mut self.balls, self.ball_count);
        clear(&mut self.rejected, self.rejected_count);
        clear(&mut self.regions, self.region_count);
        clear(&mut self.runs, self.run_count);
    }
}

impl ClearStale for WorldFrame {
    fn clear_stale(&mut self) {
        clear(&mut self.commands, self.command_count);
        clear(&mut self.robots, self.robot_count);
        clear(&mut self.robot_memories, self.robot_count);
        clear(&mut self.unknown_robots, self.unknown_robot_count);
        clear(&mut self.unknown_robot_memories, self.unknown_memory_count);
    }
}

impl ClearStale for Commands {
    fn clear_stale(&mut self) {
        clear(&mut self.wheels, self.wheel_count);
    }
}

impl ClearStale for TruthFrame {
    fn clear_stale(&mut self) {
        clear(&mut self.robots, self.robot_count);
    }
}

impl ClearStale for Heartbeat {
    fn clear_stale(&mut self) {}
}
