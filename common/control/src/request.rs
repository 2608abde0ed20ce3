//! Requests to a running supervisor: a socket in the runtime directory, which only the group's user can
//! reach.
//!
//! Request and answer are one JSON datagram each. A datagram arrives as a whole, so a supervisor never
//! waits for a client.

use client::instance::Instance;
use client::private;
use serde::{Deserialize, Serialize};
use std::fs;
use std::io;
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

/// Longest request, and longest answer.
pub const MAX_REQUEST_BYTES: usize = 8192;

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
        let mut buffer = [0; MAX_REQUEST_BYTES];
        let length = socket.recv(&mut buffer)?;
        Ok(serde_json::from_slice(&buffer[..length])?)
    };
    let outcome = exchange();
    let _ = fs::remove_file(&own);
    outcome
}
