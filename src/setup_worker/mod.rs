//! Setting a pitch up on pictures of a running group, as a library call for a process of its own: requests
//! and answers are JSON, for the page of the console and for other programs.
//!
//! | request | answer |
//! |---|---|
//! | `find-field` | where the pitch is seen, without any marks |
//! | `calibrate` | the camera, from marked points and the lines of the pitch |
//! | `learn` | colours, from what robots and marked places show |
//! | `try` | what is found in a frame under a changed configuration |
//!
//! No request changes anything. An answer has `set`, the keys of the configuration and their values, which its
//! sender applies by a reload of the group if a person agrees. Every request may have `set` too: changes that are
//! assumed. Pixels: the centre of the top-left pixel is (0, 0), x right, y down.

mod colors;
mod field;
pub(crate) mod input;
mod trial;

use client::instance::Instance;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::error::Error;

/// What can be asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// See [`FindField`](field::FindField).
    FindField,
    /// See [`Calibrate`](field::Calibrate).
    Calibrate,
    /// See [`Learn`](colors::Learn).
    Learn,
    /// See [`Try`](trial::Try).
    Try,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::FindField, Self::Calibrate, Self::Learn, Self::Try];

    /// Its name on the command line and in addresses.
    pub fn name(self) -> &'static str {
        match self {
            Self::FindField => "find-field",
            Self::Calibrate => "calibrate",
            Self::Learn => "learn",
            Self::Try => "try",
        }
    }

    /// The kind of this name, if there is one.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// Reason for which there is no answer; its text is for the user.
pub type SetupError = Box<dyn Error + Send + Sync>;

/// Carries out a request for a running group.
pub fn answer(kind: Kind, request: &[u8], instance: &Instance) -> Result<Value, SetupError> {
    match kind {
        Kind::FindField => answered(request, instance, field::find_field),
        Kind::Calibrate => answered(request, instance, field::calibrate),
        Kind::Learn => answered(request, instance, colors::learn),
        Kind::Try => answered(request, instance, trial::attempt),
    }
}

/// An error as it is sent.
pub fn refusal(error: &SetupError) -> Value {
    json!({ "error": { "message": error.to_string() } })
}

fn answered<Q: DeserializeOwned, A: Serialize>(
    request: &[u8],
    instance: &Instance,
    work: fn(&Q, &Instance) -> Result<A, SetupError>,
) -> Result<Value, SetupError> {
    // Without a body, everything is as usual.
    let request = if request.trim_ascii().is_empty() { b"{}" } else { request };
    let request =
        serde_json::from_slice(request).map_err(|error| format!("the request: {error}"))?;
    Ok(serde_json::to_value(work(&request, instance)?)?)
}
