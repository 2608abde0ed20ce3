//! The supervisor's end of the socket for [requests](control::Request).

use super::sys::{self, Call};
use client::instance::Instance;
use client::private;
use control::{Answer, MAX_REQUEST_BYTES, Request};
use std::fs;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::path::PathBuf;

/// Receives requests and answers them.
pub struct RequestSocket {
    socket: UnixDatagram,
    path: PathBuf,
    inode: u64,
}

impl RequestSocket {
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
        let mut buffer = [0; MAX_REQUEST_BYTES];
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

impl Drop for RequestSocket {
    fn drop(&mut self) {
        if self.is_reachable() {
            let _ = fs::remove_file(&self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use control::ask;
    use std::ffi::OsString;
    use std::time::Duration;

    #[test]
    fn requests_are_answered_and_invalid_ones_are_refused() {
        let base = std::env::temp_dir().join(format!("tl-control-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        let request = Request::Restart(vec!["tracker".into()]);
        let patience = Duration::from_secs(10);
        assert!(ask(&instance, &request, patience).is_err(), "nobody is there");

        // A dead supervisor's socket file stays.
        std::mem::forget(RequestSocket::open(&instance).unwrap());
        let control = RequestSocket::open(&instance).unwrap();
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
