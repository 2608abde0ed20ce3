//! Attached clients, each with its unsent messages.
//!
//! Two threads share this. One sends every `world` to all clients, straight out of shared memory into the
//! sockets; the other admits and drops clients, receives their messages, and sends what did not fit into a
//! socket at once.

use super::intake::{Intake, Said};
use super::ration::Rations;
use super::seats::{Seat, seat_for};
use client::gateway::{KEPT, MAX_BYTES};
use rustix::event::{EventfdFlags, eventfd};
use rustix::io::Errno;
use rustix::net::{RecvFlags, SendFlags, recv, send, sockopt};
use std::collections::{BTreeSet, VecDeque};
use std::os::fd::OwnedFd;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Send buffer of a socket, for some messages; the system may give less.
const SOCKET_BYTES: usize = 1 << 20;

/// All attached clients.
pub struct Clients {
    inner: Mutex<Inner>,
    /// Becomes readable when there are unsent messages or clients to drop.
    pub wake: OwnedFd,
}

struct Inner {
    clients: Vec<Client>,
    counters: Counters,
    rations: Rations,
}

/// Counters so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// Clients attached now.
    pub clients: u32,
    /// Messages sent to clients.
    pub given: u64,
    /// Messages that a client lost because it was too slow.
    pub lost: u64,
    /// Client messages of a wrong size.
    pub wrong_size: u64,
    /// Client messages with impossible content.
    pub impossible: u64,
    /// Client messages with commands for a team that their user may not command.
    pub not_permitted: u64,
}

struct Client {
    id: u64,
    uid: u32,
    socket: Arc<OwnedFd>,
    intake: Intake,
    unsent: VecDeque<Arc<[u8]>>,
    is_gone: bool,
}

/// A client that asks to be admitted.
pub struct Arrival {
    /// Its identifier.
    pub id: u64,
    /// Its user.
    pub uid: u32,
    /// Time of its arrival.
    pub at_ns: u64,
}

/// A valid message from a client.
pub struct Heard {
    /// Its user.
    pub uid: u32,
    /// The message.
    pub said: Said,
}

/// Events to wait for on a client's socket.
pub struct Interest {
    /// The client.
    pub id: u64,
    /// Its socket.
    pub socket: Arc<OwnedFd>,
    /// Wait until it has sent something: it may send now.
    pub reads: bool,
    /// Wait until it can receive: it has unsent messages.
    pub writes: bool,
}

impl Clients {
    /// Creates an empty set of clients, in a group with a camera of this rate.
    pub fn new(fps: f64, now_ns: u64) -> Result<Self, Errno> {
        let wake = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
        let rations = Rations::new(fps, now_ns);
        let inner = Inner { clients: Vec::new(), counters: Counters::default(), rations };
        Ok(Self { inner: Mutex::new(inner), wake })
    }

    /// Admits and greets a client, if there is a [seat](seat_for). Returns the user whose youngest
    /// client lost its seat, if one did.
    pub fn admit(
        &self,
        who: Arrival,
        socket: OwnedFd,
        most: usize,
        greeting: &[u8],
    ) -> Result<Option<u32>, (OwnedFd, String)> {
        let Arrival { id, uid, at_ns } = who;
        let mut inner = self.lock();
        let is_there = |client: &&mut Client| !client.is_gone;
        let taken = inner.clients.iter_mut().filter(is_there).map(|client| client.uid);
        let gives_up = match seat_for(uid, taken, most) {
            Seat::Refused(reason) => return Err((socket, reason)),
            Seat::Free => None,
            Seat::InsteadOf(other) => {
                let is_others = |client: &&mut Client| !client.is_gone && client.uid == other;
                if let Some(youngest) = inner.clients.iter_mut().rev().find(is_others) {
                    youngest.is_gone = true;
                }
                Some(other)
            }
        };
        // If the system gives fewer bytes, more is kept here.
        let _ = sockopt::set_socket_send_buffer_size(&socket, SOCKET_BYTES);
        // Under the lock, so that no message precedes the greeting.
        let is_gone = !matches!(offer(&socket, greeting), Offered::Taken);
        inner.clients.push(Client {
            id,
            uid,
            socket: Arc::new(socket),
            intake: Intake::default(),
            unsent: VecDeque::new(),
            is_gone,
        });
        inner.rations.enter(uid, id, at_ns);
        Ok(gives_up)
    }

    /// Sends a message to all clients. Never blocks.
    pub fn give(&self, message: &[u8]) {
        let mut inner = self.lock();
        let Inner { clients, counters, .. } = &mut *inner;
        let mut kept: Option<Arc<[u8]>> = None;
        let mut has_work = false;
        for client in clients.iter_mut().filter(|client| !client.is_gone) {
            // Keep the order: unsent messages go first.
            if client.unsent.is_empty() {
                match offer(&client.socket, message) {
                    Offered::Taken => {
                        counters.given += 1;
                        continue;
                    }
                    Offered::Gone => {
                        client.is_gone = true;
                        has_work = true;
                        continue;
                    }
                    Offered::Full => has_work = true,
                }
            }
            if client.unsent.len() == KEPT {
                client.unsent.pop_front();
                counters.lost += 1;
            }
            client.unsent.push_back(Arc::clone(kept.get_or_insert_with(|| message.into())));
        }
        drop(inner);
        if has_work {
            // The descriptor lives as long as this, and the counter cannot be full.
            let _ = rustix::io::write(&self.wake, &1u64.to_ne_bytes());
        }
    }

    /// Sends a client's unsent messages, as far as they fit.
    pub fn hand_on(&self, id: u64) {
        let mut inner = self.lock();
        let Inner { clients, counters, .. } = &mut *inner;
        let Some(client) = clients.iter_mut().find(|client| client.id == id) else { return };
        while let Some(message) = client.unsent.front() {
            match offer(&client.socket, message) {
                Offered::Taken => {
                    counters.given += 1;
                    client.unsent.pop_front();
                }
                Offered::Full => return,
                Offered::Gone => {
                    client.is_gone = true;
                    return;
                }
            }
        }
    }

    /// Receives the next message of the clients in `speakers`, in the order of the
    /// [rations](super::ration). A client whose socket is empty is removed from `speakers`. `None`
    /// when no client may send now.
    pub fn hear(&self, speakers: &mut BTreeSet<u64>, now_ns: u64) -> Option<Heard> {
        let mut inner = self.lock();
        let Inner { clients, counters, rations } = &mut *inner;
        while let Some(id) = rations.next(|id| speakers.contains(&id), now_ns) {
            let Some(client) = clients.iter_mut().find(|client| client.id == id) else {
                speakers.remove(&id);
                continue;
            };
            let mut buffer = [0; MAX_BYTES];
            let flags = RecvFlags::DONTWAIT | RecvFlags::TRUNC;
            let (bytes, length) = match recv(&*client.socket, &mut buffer[..], flags) {
                _ if client.is_gone => {
                    speakers.remove(&id);
                    continue;
                }
                Err(Errno::AGAIN | Errno::INTR) => {
                    speakers.remove(&id);
                    continue;
                }
                // An empty message looks like the end of the connection, and is treated as such.
                Ok((0, _)) | Err(_) => {
                    client.is_gone = true;
                    continue;
                }
                Ok((bytes, length)) => (&buffer[..bytes.min(MAX_BYTES)], length),
            };
            rations.take(client.uid, id);
            match client.intake.take(bytes, length) {
                Said::Rubbish(client::gateway::CommandsFault::Size(_)) => counters.wrong_size += 1,
                Said::Rubbish(_) => counters.impossible += 1,
                Said::Nonsense => {
                    counters.impossible += 1;
                    client.is_gone = true;
                }
                Said::WillDrive => {}
                said => return Some(Heard { uid: client.uid, said }),
            }
        }
        None
    }

    /// Counts a message with commands for a team that the user may not command.
    pub fn count_not_permitted(&self) {
        self.lock().counters.not_permitted += 1;
    }

    /// Records that a client has closed its socket.
    pub fn hung_up(&self, id: u64) {
        let mut inner = self.lock();
        if let Some(client) = inner.clients.iter_mut().find(|client| client.id == id) {
            client.is_gone = true;
        }
    }

    /// Drops clients that have gone, and returns the events to wait for.
    pub fn interests(&self, now_ns: u64) -> Vec<Interest> {
        let mut inner = self.lock();
        let Inner { clients, rations, .. } = &mut *inner;
        clients.retain(|client| {
            if client.is_gone {
                rations.leave(client.uid, client.id, now_ns);
            }
            !client.is_gone
        });
        let interest = |client: &mut Client| Interest {
            id: client.id,
            socket: Arc::clone(&client.socket),
            reads: rations.may_speak(client.uid, client.id, now_ns),
            writes: !client.unsent.is_empty(),
        };
        clients.iter_mut().map(interest).collect()
    }

    /// The counters so far.
    pub fn counters(&self) -> Counters {
        let inner = self.lock();
        Counters { clients: inner.clients.len() as u32, ..inner.counters }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // The lock is never poisoned: a panic ends the process.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

enum Offered {
    Taken,
    Full,
    Gone,
}

fn offer(socket: &OwnedFd, message: &[u8]) -> Offered {
    match send(socket, message, SendFlags::DONTWAIT | SendFlags::NOSIGNAL) {
        Ok(_) => Offered::Taken,
        Err(Errno::AGAIN | Errno::INTR | Errno::NOBUFS | Errno::NOMEM) => Offered::Full,
        Err(_) => Offered::Gone,
    }
}
