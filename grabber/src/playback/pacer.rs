//! Pacing of recordings that are not played with their own timing: the group, or a person, decides when the
//! next frame is shown.

use super::Pace;
use crate::source::Source;
use client::bus::{BusError, Subscriber};
use client::clock::monotonic_ns;
use client::instance::Instance;
use client::wake_up::WakeUp;
use messages::WorldFrame;
use messages::topics;
use runtime::process::{MAX_WAIT, Process, ProcessError};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::fs;
use std::io;
use std::os::unix::net::UnixDatagram;

/// Time after which a frame without `world` counts as dropped by a stage.
const WORLD_TIMEOUT_NS: u64 = 1_000_000_000;
/// Longest request: a number.
const MAX_BYTES: usize = 20;

/// Decides when the next frame of a recording may be shown: when the `world` of the previous one has arrived.
/// Every stage thus processes the same sequence of messages as in the match, at any speed.
pub struct Pacer {
    world: Subscriber<WorldFrame, ()>,
    wake_up: WakeUp,
    /// Number and time of the last frame shown, until its `world` arrives.
    under_way: Option<(u64, u64)>,
    steps: Option<Steps>,
}

impl Pacer {
    /// `None` for sources that have a clock of their own.
    pub fn new(
        process: &Process,
        instance: &Instance,
        source: &Source,
    ) -> Result<Option<Self>, ProcessError> {
        let steps = match source {
            Source::Recording(playlist) => match playlist.pace {
                Pace::Recorded => return Ok(None),
                Pace::Group => None,
                Pace::Steps => Some(Steps::open(instance).map_err(|source| {
                    ProcessError::System { action: "open a socket for steps", source }
                })?),
            },
            _ => return Ok(None),
        };
        let world = process.bus.subscriber(&topics::WORLD)?;
        let wake_up = process.wake_up(&topics::WORLD)?;
        Ok(Some(Self { world, wake_up, under_way: None, steps }))
    }

    /// Waits until the next frame may be shown, but not longer than [`MAX_WAIT`]; returns whether it may.
    pub fn may_show(&mut self) -> Result<bool, BusError> {
        while let Some(received) = self.world.receive()? {
            let seq = received.message().map(|world| world.frame.seq);
            self.under_way = self.under_way.filter(|&(shown, _)| seq < Some(shown));
        }
        let now_ns = monotonic_ns();
        self.under_way = self.under_way.filter(|&(_, t_ns)| now_ns < t_ns + WORLD_TIMEOUT_NS);
        if self.under_way.is_some() {
            self.wake_up.wait(MAX_WAIT);
            return Ok(false);
        }
        let Some(steps) = &mut self.steps else { return Ok(true) };
        steps.listen();
        Ok(steps.left > 0)
    }

    /// Whether it is waiting for a person.
    pub fn is_waiting_for_person(&self) -> bool {
        self.under_way.is_none() && self.steps.as_ref().is_some_and(|steps| steps.left == 0)
    }

    /// Records that a frame was shown.
    pub fn shown(&mut self, seq: u64) {
        self.under_way = Some((seq, monotonic_ns()));
        if let Some(steps) = &mut self.steps {
            steps.left = steps.left.saturating_sub(1);
        }
    }
}

/// Steps requested by a person: numbers of frames, received on a socket in the runtime directory, which only
/// the group's user can access.
struct Steps {
    socket: UnixDatagram,
    left: u64,
}

impl Steps {
    fn open(instance: &Instance) -> io::Result<Self> {
        let path = instance.step_path();
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            // Left by a predecessor.
            _ => {}
        }
        let socket = client::private::bind_datagram(&path)?;
        socket.set_nonblocking(true)?;
        Ok(Self { socket, left: 0 })
    }

    /// Receives requests; waits for one if no step is left.
    fn listen(&mut self) {
        if self.left == 0 {
            let timeout = Timespec { tv_sec: 0, tv_nsec: MAX_WAIT.as_nanos() as _ };
            // An error here has no effect: the function is called again.
            let _ = poll(&mut [PollFd::new(&self.socket, PollFlags::IN)], Some(&timeout));
        }
        let mut buffer = [0; MAX_BYTES];
        while let Ok(length) = self.socket.recv(&mut buffer) {
            let text = std::str::from_utf8(&buffer[..length]).unwrap_or_default();
            self.left = self.left.saturating_add(text.parse().unwrap_or(0));
        }
    }
}

/// Requests frames from the grabber of a group that plays a recording step by step.
pub fn request_steps(instance: &Instance, frames: u64) -> io::Result<()> {
    let socket = UnixDatagram::unbound()?;
    socket.send_to(frames.to_string().as_bytes(), instance.step_path())?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_add_up_and_invalid_requests_are_ignored() {
        let base = std::env::temp_dir().join(format!("tl-steps-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        assert!(request_steps(&instance, 1).is_err(), "nobody is there");
        std::mem::forget(Steps::open(&instance).unwrap());
        let mut steps = Steps::open(&instance).unwrap();
        for frames in [3, 4] {
            request_steps(&instance, frames).unwrap();
        }
        let stranger = UnixDatagram::unbound().unwrap();
        for rubbish in [&b"-1"[..], b"", b"\xff\xfe", b"99999999999999999999999999", b"5 "] {
            stranger.send_to(rubbish, instance.step_path()).unwrap();
        }
        steps.listen();
        assert_eq!(steps.left, 7);
        request_steps(&instance, u64::MAX).unwrap();
        steps.listen();
        assert_eq!(steps.left, u64::MAX);
        drop(steps);
        fs::remove_file(instance.step_path()).unwrap();
        instance.remove_directory().unwrap();
    }
}
