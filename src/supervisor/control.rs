//! What one may ask of a running supervisor: a socket in the runtime directory, which nobody but the
//! group's user can reach.
//!
//! Request and answer are one datagram each, JSON. So a supervisor never waits for anybody who has
//! something to ask: what has arrived has arrived as a whole.

use super::sys::{self, Call};
use common::instance::Instance;
use common::private;
use serde::{Deserialize, Serialize};
use std::fs;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::path::PathBuf;
use std::time::Duration;

/// Something to be done in the middle of a match.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// Replace the active processes of these stages, each by its spare.
    Restart(Vec<String>),
    /// Go on as this program.
    Upgrade(PathBuf),
}

/// `Ok` when it is being done; otherwise why not.
pub type Answer = Result<(), String>;

/// Requests are short.
const MAX_BYTES: usize = 8192;

/// The supervisor's end.
pub struct Control {
    socket: UnixDatagram,
    path: PathBuf,
    inode: u64,
}

impl Control {
    /// Opens the socket in the place of one that a dead supervisor has left. Only for the holder of
    /// the instance's lock.
    pub fn open(instance: &Instance) -> io::Result<Self> {
        let path = instance.control_path();
        if let Err(error) = fs::remove_file(&path)
            && error.kind() != io::ErrorKind::NotFound
        {
            return Err(error);
        }
        let socket = sys::ask(Call::OpenControl, || private::bind_datagram(&path))?;
        socket.set_nonblocking(true)?;
        let inode = fs::symlink_metadata(&path)?.ino();
        Ok(Self { socket, path, inode })
    }

    /// Whether it can still be found: somebody may have removed its name.
    pub fn is_reachable(&self) -> bool {
        fs::symlink_metadata(&self.path).is_ok_and(|data| data.ino() == self.inode)
    }

    /// Becomes readable when there is a request.
    pub fn fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }

    /// The next request and whom to answer. What is no request is answered at once.
    pub fn next(&self) -> Option<(Request, SocketAddr)> {
        let mut buffer = [0; MAX_BYTES];
        loop {
            let receive = || self.socket.recv_from(&mut buffer);
            let (length, sender) = sys::ask(Call::ReceiveRequest, receive).ok()?;
            match serde_json::from_slice(&buffer[..length]) {
                Ok(request) => return Some((request, sender)),
                Err(error) => {
                    self.answer(&sender, &Err(format!("this is no request: {error}")));
                }
            }
        }
    }

    /// Answers. That the other one is gone or does not listen is its own affair.
    pub fn answer(&self, to: &SocketAddr, answer: &Answer) {
        if let Ok(text) = serde_json::to_vec(answer) {
            let answer = || self.socket.send_to_addr(&text, to);
            // Once more for a refusal that passes, as when buffers are full.
            let _ = sys::ask(Call::AnswerRequest, answer).or_else(|_| answer());
        }
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        if self.is_reachable() {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Asks the supervisor of a group for something. The error says what was wrong with the way to it;
/// what it answers is inside.
pub fn ask(instance: &Instance, request: &Request, patience: Duration) -> io::Result<Answer> {
    let own = instance.directory().join(format!("control-{}", std::process::id()));
    let _ = fs::remove_file(&own);
    let socket = private::bind_datagram(&own)?;
    let exchange = || {
        socket.set_read_timeout(Some(patience))?;
        socket.set_write_timeout(Some(patience))?;
        socket.send_to(&serde_json::to_vec(request)?, instance.control_path())?;
        let mut buffer = [0; MAX_BYTES];
        let length = socket.recv(&mut buffer)?;
        Ok(serde_json::from_slice(&buffer[..length])?)
    };
    let outcome = exchange();
    let _ = fs::remove_file(&own);
    outcome
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ffi::OsString;

    #[test]
    fn requests_are_answered_and_rubbish_is_refused() {
        let base = std::env::temp_dir().join(format!("tl-control-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        let request = Request::Restart(vec!["tracker".into()]);
        let patience = Duration::from_secs(10);
        assert!(ask(&instance, &request, patience).is_err(), "nobody is there");

        // A dead supervisor leaves its socket.
        std::mem::forget(Control::open(&instance).unwrap());
        let control = Control::open(&instance).unwrap();
        assert_eq!(fs::symlink_metadata(&control.path).unwrap().mode() & 0o777, 0o600);
        let server = std::thread::spawn(move || {
            let stranger = UnixDatagram::unbound().unwrap();
            stranger.send_to(b"\xff{", &control.path).unwrap();
            loop {
                if let Some((request, sender)) = control.next() {
                    control.answer(&sender, &Err("busy".into()));
                    return request;
                }
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        assert_eq!(ask(&instance, &request, patience).unwrap(), Err("busy".into()));
        assert_eq!(server.join().unwrap(), request);
        let entries = fs::read_dir(instance.directory()).unwrap().flatten();
        let left: Vec<_> = entries.map(|entry| entry.file_name()).collect();
        let is_socket = |name: &OsString| name.to_string_lossy().starts_with("control");
        assert!(!left.iter().any(is_socket), "{left:?}");
        instance.remove_directory().unwrap();
    }
}
