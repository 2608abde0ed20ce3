//! Who is attached: each with what it has not read yet.
//!
//! Two threads share this. One gives every `world` to everybody, straight out of shared memory into
//! the sockets; the other lets clients in and out, listens to them, and hands on what did not fit into
//! a socket at once.

use super::intake::{Allowance, Intake, Said};
use common::gateway::{KEPT, MOST_BYTES};
use rustix::event::{EventfdFlags, eventfd};
use rustix::io::Errno;
use rustix::net::{RecvFlags, SendFlags, recv, send, sockopt};
use std::collections::VecDeque;
use std::os::fd::OwnedFd;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// More than a strategy needs that sends commands for all robots together …
const PER_CLIENT_PER_S: f64 = 500.0;
/// … or, after a pause, all that have piled up.
const PER_CLIENT_AT_ONCE: f64 = 64.0;
/// The filter notes 32 messages a frame; some places are left to programs of the owner.
const ALL_PER_S: f64 = 1500.0;
const ALL_AT_ONCE: f64 = 128.0;
/// Messages of one client in a row, so that others have their turn.
const AT_A_TIME: usize = 4;
/// Room for some messages in a socket; the system may give less.
const SOCKET_BYTES: usize = 1 << 20;

/// Everybody who is attached.
pub struct Clients {
    inner: Mutex<Inner>,
    /// Readable when there is something to be handed on or somebody to be let go.
    pub wake: OwnedFd,
}

#[derive(Default)]
struct Inner {
    clients: Vec<Client>,
    counters: Counters,
    allowance: Option<Allowance>,
}

/// What has happened so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// Clients now.
    pub clients: u32,
    /// Messages given to clients.
    pub given: u64,
    /// Messages that a client lost because it was too slow.
    pub lost: u64,
    /// Messages of clients of a wrong size.
    pub wrong_size: u64,
    /// Messages of clients with impossible content.
    pub impossible: u64,
}

struct Client {
    id: u64,
    uid: u32,
    socket: Arc<OwnedFd>,
    intake: Intake,
    allowance: Allowance,
    unsent: VecDeque<Arc<[u8]>>,
    is_gone: bool,
}

/// Somebody who wants to be let in.
pub struct Arrival {
    /// What it is called here.
    pub id: u64,
    /// Its user.
    pub uid: u32,
    /// When it came.
    pub at_ns: u64,
}

/// What to wait for.
pub struct Interest {
    /// Which client.
    pub id: u64,
    /// Its socket.
    pub socket: Arc<OwnedFd>,
    /// It may say something.
    pub reads: bool,
    /// There is something to be handed on.
    pub writes: bool,
}

impl Clients {
    /// Nobody yet.
    pub fn new() -> Result<Self, Errno> {
        let wake = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
        Ok(Self { inner: Mutex::default(), wake })
    }

    /// Lets somebody in and greets them, unless all places, or half of them by the same user, are
    /// taken.
    pub fn admit(
        &self,
        who: Arrival,
        socket: OwnedFd,
        most: usize,
        greeting: &[u8],
    ) -> Result<(), (OwnedFd, String)> {
        let Arrival { id, uid, at_ns } = who;
        let mut inner = self.lock();
        let of_user = inner.clients.iter().filter(|client| client.uid == uid).count();
        if inner.clients.len() >= most {
            return Err((socket, format!("all {most} places are taken (access.clients)")));
        }
        if of_user >= most / 2 {
            return Err((socket, format!("user {uid} has {of_user} of {most} places already")));
        }
        // Fewer bytes than asked for, where the system is set up so, only mean that we keep more.
        let _ = sockopt::set_socket_send_buffer_size(&socket, SOCKET_BYTES);
        // Under the lock: nothing comes before the greeting.
        let is_gone = !matches!(offer(&socket, greeting), Offered::Taken);
        inner.clients.push(Client {
            id,
            uid,
            socket: Arc::new(socket),
            intake: Intake::default(),
            allowance: Allowance::new(PER_CLIENT_PER_S, PER_CLIENT_AT_ONCE, at_ns),
            unsent: VecDeque::new(),
            is_gone,
        });
        Ok(())
    }

    /// Gives a message to everybody. Waits for nobody.
    pub fn give(&self, message: &[u8]) {
        let mut inner = self.lock();
        let Inner { clients, counters, .. } = &mut *inner;
        let mut kept: Option<Arc<[u8]>> = None;
        let mut has_work = false;
        for client in clients.iter_mut().filter(|client| !client.is_gone) {
            // In order: what is kept goes first.
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
            // It is there as long as this is, and cannot be full.
            let _ = rustix::io::write(&self.wake, &1u64.to_ne_bytes());
        }
    }

    /// Hands on to a client what was kept for it, as far as it fits.
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

    /// Takes what a client says, as much as it may say now. What makes sense is returned.
    pub fn listen_to(&self, id: u64, now_ns: u64) -> Vec<Said> {
        let mut inner = self.lock();
        let Inner { clients, counters, allowance } = &mut *inner;
        let all = allowance.get_or_insert_with(|| Allowance::new(ALL_PER_S, ALL_AT_ONCE, now_ns));
        let Some(client) = clients.iter_mut().find(|client| client.id == id) else {
            return Vec::new();
        };
        let may = client.allowance.left(now_ns).min(all.left(now_ns)).min(AT_A_TIME);
        let mut said = Vec::new();
        for _ in 0..may {
            let mut buffer = [0; MOST_BYTES];
            let flags = RecvFlags::DONTWAIT | RecvFlags::TRUNC;
            let (bytes, length) = match recv(&*client.socket, &mut buffer[..], flags) {
                Err(Errno::AGAIN | Errno::INTR) => break,
                // An empty message looks like the end, and is as good.
                Ok((0, _)) | Err(_) => {
                    client.is_gone = true;
                    break;
                }
                Ok((bytes, length)) => (&buffer[..bytes.min(MOST_BYTES)], length),
            };
            client.allowance.take();
            all.take();
            match client.intake.take(bytes, length) {
                Said::Rubbish(common::gateway::CommandsFault::Size(_)) => counters.wrong_size += 1,
                Said::Rubbish(_) => counters.impossible += 1,
                Said::Nonsense => {
                    counters.impossible += 1;
                    client.is_gone = true;
                    break;
                }
                Said::WillDrive => {}
                sense => said.push(sense),
            }
        }
        said
    }

    /// A client's socket has been closed at the other end.
    pub fn hung_up(&self, id: u64) {
        let mut inner = self.lock();
        if let Some(client) = inner.clients.iter_mut().find(|client| client.id == id) {
            client.is_gone = true;
        }
    }

    /// Lets go of those who have gone, and says what to wait for.
    pub fn interests(&self, now_ns: u64) -> Vec<Interest> {
        let mut inner = self.lock();
        inner.clients.retain(|client| !client.is_gone);
        let all = inner.allowance.as_mut().is_none_or(|all| all.left(now_ns) > 0);
        let interest = |client: &mut Client| Interest {
            id: client.id,
            socket: Arc::clone(&client.socket),
            reads: all && client.allowance.left(now_ns) > 0,
            writes: !client.unsent.is_empty(),
        };
        inner.clients.iter_mut().map(interest).collect()
    }

    /// What has happened so far.
    pub fn counters(&self) -> Counters {
        let inner = self.lock();
        Counters { clients: inner.clients.len() as u32, ..inner.counters }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // A panic ends the process.
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
