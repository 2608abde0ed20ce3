//! Requests to a running supervisor: a socket in the runtime directory, which only the group's user can
//! reach.
//!
//! Request and answer are one JSON datagram each. A datagram arrives as a whole, so a supervisor never
//! waits for a client.

use super::sys::{self, Call};
use client::instance::Instance;
use client::private;
use serde::{Deserialize, Serialize};
use std::fs;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::path::PathBuf;
use std::time::Duration;

/// A request during a match.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// Replace the active processes of these stages, each by its spare.
    Restart(Vec<String>),
    /// Hand over to this program.
    Upgrade(PathBuf),
    /// Go over to the configuration in a file.
    Reload {
        /// The file.
        file: PathBuf,
        /// The revision that the change was made from; the request is refused if there is a newer one by now.
        /// `None` for a configuration that is wanted whatever the group runs with.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        base: Option<u32>,
    },
    /// Go back to the configuration before the present one.
    Rollback,
    /// Write these words among the events, to be found again in the log and in recordings.
    Mark(String),
}

/// `Ok` if the request is carried out; otherwise the reason for refusing it.
pub type Answer = Result<Done, String>;

/// A request that is carried out.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Done {
    /// The new revision of the configuration; `None` if it stays.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub revision: Option<u32>,
}

/// Longest request.
const MAX_BYTES: usize = 8192;

/// The supervisor's end of the socket.
pub struct Control {
    socket: UnixDatagram,
    path: PathBuf,
    inode: u64,
}

impl Control {
    /// Opens the socket, replacing one that a dead supervisor left. Only for the holder of the
    /// instance's lock.
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

    /// Whether the socket still has its name, which other programs can remove.
    pub fn is_reachable(&self) -> bool {
        fs::symlink_metadata(&self.path).is_ok_and(|data| data.ino() == self.inode)
    }

    /// Becomes readable when a request arrives.
    pub fn fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }

    /// The next request and its sender. An invalid request is refused at once.
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

    /// Answers. A client that is gone or does not listen is ignored.
    pub fn answer(&self, to: &SocketAddr, answer: &Answer) {
        if let Ok(text) = serde_json::to_vec(answer) {
            let answer = || self.socket.send_to_addr(&text, to);
            // Retry once: full buffers, for example, may have been emptied.
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

/// Sends a request to a group's supervisor. The outer error is a failed exchange; the inner result
/// is the answer.
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
    fn requests_are_answered_and_invalid_ones_are_refused() {
        let base = std::env::temp_dir().join(format!("tl-control-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        let request = Request::Restart(vec!["tracker".into()]);
        let patience = Duration::from_secs(10);
        assert!(ask(&instance, &request, patience).is_err(), "nobody is there");

        // A dead supervisor's socket file stays.
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
