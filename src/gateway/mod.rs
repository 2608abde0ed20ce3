//! The gateway: lets users of a configured group read `world` and send `commands`, over a socket.
//!
//! Shared memory cannot do that: a reader can also write it, and an attached program creates memory of its
//! own that the writers must be able to open. So this process attaches like any consumer of the owner, and
//! serves all other users; the protocol is in [`client::gateway`]. It is a process of its own because its
//! clients are not trusted: they can bring down only this process, and the supervisor restarts it.
//!
//! [`users`] looks up users and groups, [`place`] creates the directory and the socket, [`seats`] assigns
//! the seats, [`intake`] parses client messages, [`ration`] limits their rate, [`permissions`] decides which
//! team a user may command, and [`clients`] keeps unsent messages. This file is the process: a thread that
//! sleeps on `world`, and one that sleeps on the sockets.

mod clients;
mod intake;
pub mod permissions;
pub mod place;
pub(crate) mod ration;
mod seats;
mod users;

use crate::attendants::Row;
use bytemuck::Zeroable;
use client::bus::{Bus, BusError, Publisher};
use client::clock::monotonic_ns;
use client::gateway::Greeting;
use client::instance::Instance;
use clients::{Arrival, Clients, Heard, Interest};
use config::Config;
use intake::Said;
use messages::topics;
use messages::{Attendant, Commands, DropReason, FrameHeader, GatewayReport, Heartbeat};
use permissions::Permissions;
use place::PlaceError;
use runtime::attendant::AttendantProcess;
use runtime::process::{HEARTBEAT, MAX_WAIT, ProcessError};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::net::{SendFlags, SocketFlags, accept_with, send, sockopt};
use std::collections::BTreeSet;
use std::fs;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// Most clients admitted in one round.
const ADMITTED_AT_A_TIME: usize = 4;
/// Wait while a client's message is held back by its ration.
const SHORT_WAIT: Duration = Duration::from_millis(5);
/// Most client messages received in one round, so that other work is not delayed.
const HEARD_AT_A_TIME: usize = 64;
/// Longest round of the thread that sends `world`, which then counts as stuck; it normally makes at
/// least twenty rounds a second.
const LONGEST_ROUND_NS: u64 = 2_000_000_000;
/// Most lines in the log, so that clients that come and go all the time do not fill a disk.
const MOST_LINES: u32 = 200;

/// Reason for which the gateway cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum GatewayError {
    /// No other user may attach.
    #[error("access.group is empty: nobody but the owner may attach")]
    NotConfigured,
    /// The directory or the socket failed.
    #[error(transparent)]
    Place(#[from] PlaceError),
    /// Shared memory failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Its process failed.
    #[error(transparent)]
    Process(#[from] ProcessError),
    /// Setting up signals, or waiting, failed.
    #[error("{0}: {1}")]
    System(&'static str, std::io::Error),
    /// The other thread has ended, or is stuck.
    #[error("the thread that gives `world` to the clients {0}")]
    Stuck(&'static str),
}

/// State shared by the thread that sends `world`.
#[derive(Default)]
struct Given {
    /// Time of its last round.
    round_ns: AtomicU64,
    frames: AtomicU64,
    newest: AtomicU64,
}

/// The gateway's row in the table of attendants.
pub const ROW: Row = Row {
    attendant: Attendant::Gateway,
    about: "The gateway alone: `world` and `commands` for users of the group `access.group`",
    prepare: |instance, config| Ok(prepare(instance, config)?),
    run: |instance, config, supervised| Ok(run(instance, config, supervised)?),
    reads: &["access", "camera.fps"],
    remove: Instance::remove_gateway_directory,
};

/// Prepares the directory for the configured group of users; `false` when there is none.
fn prepare(instance: &Instance, config: &Config) -> Result<bool, PlaceError> {
    let Some(group) = config.access.group() else {
        // An earlier group with another configuration may have left it.
        instance.remove_gateway_directory()?;
        return Ok(false);
    };
    Permissions::of(&config.access)?;
    if let Some(closed) = place::prepare(instance, group)? {
        runtime::tell!("touchline: {}", place::advice(&closed, group));
    }
    Ok(true)
}

/// Runs until it is told to end, or its group is gone.
fn run(instance: &Instance, config: &Config, supervised: bool) -> Result<(), GatewayError> {
    let name = config.access.group().ok_or(GatewayError::NotConfigured)?;
    let process = AttendantProcess::start(Attendant::Gateway, instance, config, supervised)?;
    let stop = process.stop();
    let clients = Clients::new(config.camera.fps, monotonic_ns());
    let clients = Arc::new(clients.map_err(system("make an event"))?);
    let given = Arc::new(Given::default());
    let listener = Listener::open(&process, instance, config, name, Arc::clone(&clients))?;
    let thread = {
        let (instance, stop) = (instance.clone(), Arc::clone(&stop));
        let (clients, given) = (Arc::clone(&clients), Arc::clone(&given));
        let fps = config.camera.fps;
        std::thread::spawn(move || give_world(&instance, fps, &clients, &given, &stop))
    };
    given.round_ns.store(monotonic_ns(), Ordering::Relaxed);
    let outcome = listener.tend(process, &given, || thread.is_finished());
    stop.store(true, Ordering::Relaxed);
    // A stuck thread cannot be joined, and ends with the process.
    match outcome {
        Err(GatewayError::Stuck("does not get on")) => outcome,
        outcome => match thread.join() {
            Ok(given) => given.and(outcome),
            Err(_) => Err(GatewayError::Stuck("has panicked")),
        },
    }
}

/// Sends every `world` to all clients.
fn give_world(
    instance: &Instance,
    fps: f64,
    clients: &Clients,
    given: &Given,
    stop: &AtomicBool,
) -> Result<(), GatewayError> {
    let bus = Bus::join(instance, Attendant::Gateway.name())?;
    let worlds = bus.subscriber(&topics::WORLD)?;
    let mut wake_up = bus.wake_up(&topics::WORLD)?;
    let mut last: Option<FrameHeader> = None;
    while !stop.load(Ordering::Relaxed) {
        while let Some(received) = worlds.receive()? {
            let Some(world) = received.message() else { continue };
            // Skip a `world` that is repeated after a hand-over, or impossible.
            if world.frame.follows(last.as_ref(), monotonic_ns(), fps) {
                last = Some(world.frame);
                clients.give(bytemuck::bytes_of(world));
                given.frames.fetch_add(1, Ordering::Relaxed);
                given.newest.store(world.frame.seq, Ordering::Relaxed);
            }
        }
        given.round_ns.store(monotonic_ns(), Ordering::Relaxed);
        wake_up.wait(MAX_WAIT);
    }
    Ok(())
}

/// The listening socket and its clients.
struct Listener {
    instance: Instance,
    socket: OwnedFd,
    clients: Arc<Clients>,
    most_clients: usize,
    permissions: Permissions,
    /// Users for which the log already says that they send commands without permission.
    told: BTreeSet<u32>,
    greeting: Vec<u8>,
    commands: Publisher<Commands, ()>,
    next_id: u64,
    lines_left: u32,
}

impl Listener {
    fn open(
        process: &AttendantProcess,
        instance: &Instance,
        config: &Config,
        name: &str,
        clients: Arc<Clients>,
    ) -> Result<Self, GatewayError> {
        let group = place::group_number(name)?;
        place::prepare(instance, name)?;
        Ok(Self {
            socket: place::open(instance, group)?,
            instance: instance.clone(),
            clients,
            most_clients: config.access.clients as usize,
            permissions: Permissions::of(&config.access)?,
            told: BTreeSet::new(),
            greeting: serde_json::to_vec(&Greeting::new(instance.name())).unwrap_or_default(),
            commands: process.bus.publisher(&topics::COMMANDS, 1)?,
            next_id: 0,
            lines_left: MOST_LINES,
        })
    }

    /// Admits clients and serves them.
    fn tend(
        mut self,
        mut process: AttendantProcess,
        given: &Given,
        is_finished: impl Fn() -> bool,
    ) -> Result<(), GatewayError> {
        let mut reports = process.bus.publisher(&topics::GATEWAY, 1)?;
        let mut report = GatewayReport { pid: std::process::id(), ..Zeroable::zeroed() };
        while process.keep_running(|beat| self.count(given, beat))? {
            let now_ns = monotonic_ns();
            let counters = self.clients.counters();
            if counters.clients != report.clients
                || now_ns.saturating_sub(report.t_sent_ns) >= HEARTBEAT.as_nanos() as u64
            {
                report = GatewayReport {
                    t_sent_ns: now_ns,
                    given: counters.given,
                    lost: counters.lost,
                    not_permitted: counters.not_permitted,
                    refused: counters.wrong_size + counters.impossible + counters.not_permitted,
                    clients: counters.clients,
                    ..report
                };
                reports.publish(&report)?;
            }
            if is_finished() {
                return Err(GatewayError::Stuck("has ended"));
            }
            let round_ns = given.round_ns.load(Ordering::Relaxed);
            if monotonic_ns().saturating_sub(round_ns) > LONGEST_ROUND_NS {
                return Err(GatewayError::Stuck("does not get on"));
            }
            self.round()?;
        }
        let _ = fs::remove_file(self.instance.gateway_path());
        Ok(())
    }

    /// Waits for events, and handles them.
    fn round(&mut self) -> Result<(), GatewayError> {
        let mut interests = self.clients.interests(monotonic_ns());
        let clients = Arc::clone(&self.clients);
        let mut fds = vec![
            PollFd::new(&self.socket, PollFlags::IN),
            PollFd::new(&clients.wake, PollFlags::IN),
        ];
        for Interest { socket, reads, writes, .. } in &interests {
            let mut flags = PollFlags::empty();
            flags.set(PollFlags::IN, *reads);
            flags.set(PollFlags::OUT, *writes);
            fds.push(PollFd::new(&**socket, flags));
        }
        let is_held_back = interests.iter().any(|interest| !interest.reads);
        let patience = if is_held_back { SHORT_WAIT } else { MAX_WAIT };
        let patience = Timespec { tv_sec: 0, tv_nsec: patience.as_nanos() as _ };
        match poll(&mut fds, Some(&patience)) {
            Ok(_) => {}
            Err(Errno::INTR) => return Ok(()),
            Err(error) => return Err(system("wait for clients")(error)),
        }
        let happened: Vec<PollFlags> = fds.iter().map(PollFd::revents).collect();
        drop(fds);
        if !happened[1].is_empty() {
            let _ = rustix::io::read(&clients.wake, &mut [0; 8]);
        }
        let mut speakers = BTreeSet::new();
        for (Interest { id, .. }, happened) in interests.drain(..).zip(&happened[2..]) {
            if happened.contains(PollFlags::OUT) {
                self.clients.hand_on(id);
            }
            if happened.contains(PollFlags::IN) {
                speakers.insert(id);
            } else if happened.intersects(PollFlags::HUP | PollFlags::ERR) {
                self.clients.hung_up(id);
            }
        }
        for _ in 0..HEARD_AT_A_TIME {
            let Some(heard) = self.clients.hear(&mut speakers, monotonic_ns()) else { break };
            self.obey(heard)?;
        }
        if !happened[0].is_empty() {
            self.admit();
        }
        Ok(())
    }

    /// Publishes the permitted part of a user's commands.
    fn obey(&mut self, Heard { uid, said }: Heard) -> Result<(), GatewayError> {
        let Said::Drive(mut commands) = said else { return Ok(()) };
        if self.permissions.restrict(uid, &mut commands) > 0 {
            self.clients.count_not_permitted();
            if self.told.insert(uid) {
                self.say(format!(
                    "user {uid} commands a team for which access.teams does not name it"
                ));
            }
            if commands.wheel_count == 0 {
                return Ok(());
            }
        }
        commands.user = uid;
        Ok(self.commands.publish(&commands)?)
    }

    fn admit(&mut self) {
        for _ in 0..ADMITTED_AT_A_TIME {
            let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
            // No more clients, or no more descriptors, which some client will free.
            let Ok(socket) = accept_with(&self.socket, flags) else { return };
            // A client that could connect has the right to; the system names its user.
            let Ok(who) = sockopt::socket_peercred(&socket) else { continue };
            let uid = who.uid.as_raw();
            self.next_id += 1;
            let arrival = Arrival { id: self.next_id, uid, at_ns: monotonic_ns() };
            match self.clients.admit(arrival, socket, self.most_clients, &self.greeting) {
                Ok(gives_up) => {
                    self.say(format!("user {uid} (pid {}) has attached", who.pid));
                    if let Some(other) = gives_up {
                        self.say(format!(
                            "user {other}, which has the most places, has given one up"
                        ));
                    }
                }
                Err((socket, reason)) => {
                    self.say(format!("user {uid} (pid {}) is refused: {reason}", who.pid));
                    let refusal =
                        Greeting { refused: Some(reason), ..Greeting::new(self.instance.name()) };
                    let text = serde_json::to_vec(&refusal).unwrap_or_default();
                    let _ = send(&socket, &text, SendFlags::DONTWAIT | SendFlags::NOSIGNAL);
                }
            }
        }
    }

    fn say(&mut self, what: String) {
        if self.lines_left > 0 {
            self.lines_left -= 1;
            runtime::tell!("{}: {what}", Attendant::Gateway.name());
        }
    }

    /// Writes the counters into a heartbeat.
    fn count(&self, given: &Given, beat: &mut Heartbeat) {
        let counters = self.clients.counters();
        beat.frames_in = given.frames.load(Ordering::Relaxed);
        beat.frames_out = counters.given;
        beat.frames_missed = counters.lost;
        if beat.frames_in > 0 {
            beat.seq_in = given.newest.load(Ordering::Relaxed);
            beat.seq_out = beat.seq_in;
        }
        beat.dropped[DropReason::WrongSize as usize] = counters.wrong_size;
        beat.dropped[DropReason::BadHeader as usize] = counters.impossible;
        beat.dropped[DropReason::NotPermitted as usize] = counters.not_permitted;
    }
}

fn system(action: &'static str) -> impl FnOnce(Errno) -> GatewayError {
    move |error| GatewayError::System(action, error.into())
}
