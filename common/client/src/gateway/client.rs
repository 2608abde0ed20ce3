//! Client of the gateway, for programs in Rust; used like [`Consumer`](crate::consumer::Consumer).

use super::{Greeting, commands_type_name};
use crate::consumer::{Event, Order};
use bytemuck::{Zeroable, bytes_of, bytes_of_mut};
use messages::{Commands, WorldFrame};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::OwnedFd;
use rustix::io::Errno;
use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, SocketAddrUnix, SocketFlags, SocketType, connect, recv,
    send, socket_with,
};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Interval between checks for a group that does not exist yet.
const LOOK: Duration = Duration::from_millis(100);
/// Longest wait for the greeting.
const GREETING_PATIENCE: Duration = Duration::from_secs(2);

/// Reason why a client cannot continue.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// This user may not connect.
    #[error(
        "{0}: no right to connect; the user of this program must be in the group that the \
         configuration names in access.group (and have logged in again since)"
    )]
    Denied(PathBuf),
    /// The socket belongs to another program.
    #[error("{0}: this is not the gateway of a Touchline group: {1}")]
    Stranger(PathBuf, String),
    /// The group has another version.
    #[error("{0}: the group's messages are of another version than this program's: {1:?}")]
    Version(PathBuf, Box<Greeting>),
    /// The gateway refused this client.
    #[error("{0}: refused: {1}")]
    Refused(PathBuf, String),
    /// The operating system reported an error.
    #[error("{0}: {1}")]
    System(PathBuf, std::io::Error),
}

/// Reads `world` and sends `commands` whenever the group exists.
pub struct Client {
    path: PathBuf,
    connection: Option<OwnedFd>,
    drives: bool,
    order: Order,
    pending: Option<Box<WorldFrame>>,
}

impl Client {
    /// Creates a client of the gateway with this socket, which `touchline status` shows. It does not
    /// connect yet.
    pub fn new(path: &Path) -> Self {
        Self {
            path: path.into(),
            connection: None,
            drives: false,
            order: Order::default(),
            pending: None,
        }
    }

    /// Waits for the next event; `None` after `timeout`.
    pub fn next(
        &mut self,
        timeout: Duration,
    ) -> Result<Option<Event<Box<WorldFrame>>>, ClientError> {
        let deadline = Instant::now() + timeout;
        if let Some(world) = self.pending.take() {
            return Ok(Some(Event::Message(world)));
        }
        loop {
            let Some(connection) = &self.connection else {
                if self.connect()? {
                    return Ok(Some(Event::Joined));
                }
                let left = deadline.saturating_duration_since(Instant::now());
                if left.is_zero() {
                    return Ok(None);
                }
                std::thread::sleep(left.min(LOOK));
                continue;
            };
            let mut world: Box<WorldFrame> = Box::new(WorldFrame::zeroed());
            let received = recv(connection, bytes_of_mut(&mut *world), RecvFlags::DONTWAIT);
            match received.map(|(bytes, _)| bytes) {
                Ok(bytes) if bytes == size_of::<WorldFrame>() => {
                    let (seq, t_ns) = (world.frame.seq, world.frame.t_capture_ns);
                    // A restarted gateway may repeat messages.
                    if let Some(event) = self.order.announce(seq, t_ns, world, &mut self.pending) {
                        return Ok(Some(event));
                    }
                }
                Err(Errno::AGAIN) => {
                    let left = deadline.saturating_duration_since(Instant::now());
                    if left.is_zero() {
                        return Ok(None);
                    }
                    wait(connection, PollFlags::IN, left);
                }
                Err(Errno::INTR) => {}
                Ok(_) | Err(_) => {
                    self.leave();
                    return Ok(Some(Event::Left));
                }
            }
        }
    }

    /// Sends commands; `false` if there is no connection, or the gateway does not accept more at the
    /// moment. [`next`](Self::next) connects the client.
    pub fn send(&mut self, commands: &Commands) -> bool {
        let Some(connection) = &self.connection else { return false };
        let flags = SendFlags::DONTWAIT | SendFlags::NOSIGNAL;
        if !self.drives {
            self.drives = send(connection, commands_type_name().as_bytes(), flags).is_ok();
        }
        self.drives && send(connection, bytes_of(commands), flags).is_ok()
    }

    fn leave(&mut self) {
        self.connection = None;
        self.drives = false;
    }

    /// Tries to connect; `false` if the gateway is not there.
    fn connect(&mut self) -> Result<bool, ClientError> {
        let system = |error: Errno| ClientError::System(self.path.clone(), error.into());
        let address = SocketAddrUnix::new(&self.path).map_err(system)?;
        let socket =
            socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None)
                .map_err(system)?;
        match connect(&socket, &address) {
            Ok(()) => {}
            Err(Errno::NOENT | Errno::CONNREFUSED | Errno::AGAIN) => return Ok(false),
            Err(Errno::ACCESS) => return Err(ClientError::Denied(self.path.clone())),
            Err(error) => return Err(system(error)),
        }
        wait(&socket, PollFlags::IN, GREETING_PATIENCE);
        let mut buffer = [0; 4096];
        let bytes = match recv(&socket, &mut buffer[..], RecvFlags::DONTWAIT) {
            // The gateway closed the connection, or is too busy to greet.
            Ok((0, _)) | Err(_) => return Ok(false),
            Ok((bytes, _)) => &buffer[..bytes],
        };
        let greeting: Greeting = serde_json::from_slice(bytes)
            .map_err(|error| ClientError::Stranger(self.path.clone(), error.to_string()))?;
        if let Some(reason) = greeting.refused {
            return Err(ClientError::Refused(self.path.clone(), reason));
        }
        if !greeting.fits() {
            return Err(ClientError::Version(self.path.clone(), Box::new(greeting)));
        }
        self.connection = Some(socket);
        Ok(true)
    }
}

/// Waits until the socket is ready or the time is over.
fn wait(socket: &OwnedFd, what: PollFlags, patience: Duration) {
    let patience =
        Timespec { tv_sec: patience.as_secs() as _, tv_nsec: patience.subsec_nanos().into() };
    // The result does not matter, since the caller tries the socket.
    let _ = poll(&mut [PollFd::new(socket, what)], Some(&patience));
}
