//! State of the grabber's camera.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;

/// State of a camera, or the reason why it delivers nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum CameraState {
    /// It is being looked for, opened and set up.
    Opening = 0,
    /// Frames arrive as configured.
    Streaming = 1,
    /// Frames arrive, but fewer than configured.
    Slow = 2,
    /// No such device: unplugged, switched off, or under another name.
    Missing = 3,
    /// Opening it is not permitted.
    NoRights = 4,
    /// Another program uses it.
    Busy = 5,
    /// It cannot deliver the configured picture.
    WrongFormat = 6,
    /// It refuses a configured setting.
    WrongSetting = 7,
    /// It is there but delivers no frames.
    Hung = 8,
    /// The library that drives it is not installed.
    NoLibrary = 9,
    /// Something else went wrong.
    Failed = 10,
}

impl CameraState {
    /// All states, in the order of their numbers.
    pub const ALL: [Self; 11] = [
        Self::Opening,
        Self::Streaming,
        Self::Slow,
        Self::Missing,
        Self::NoRights,
        Self::Busy,
        Self::WrongFormat,
        Self::WrongSetting,
        Self::Hung,
        Self::NoLibrary,
        Self::Failed,
    ];

    /// The state with this number in a message, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.get(number as usize).copied()
    }

    /// Key in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Opening => "opening",
            Self::Streaming => "streaming",
            Self::Slow => "slow",
            Self::Missing => "missing",
            Self::NoRights => "no_rights",
            Self::Busy => "busy",
            Self::WrongFormat => "wrong_format",
            Self::WrongSetting => "wrong_setting",
            Self::Hung => "hung",
            Self::NoLibrary => "no_library",
            Self::Failed => "failed",
        }
    }

    /// Whether frames arrive.
    pub fn is_delivering(self) -> bool {
        matches!(self, Self::Streaming | Self::Slow)
    }
}

/// Published by a grabber with a real camera, at every change and several times a second.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/CameraReport/1")]
#[repr(C)]
pub struct CameraReport {
    /// Time of publication.
    pub t_sent_ns: u64,
    /// Frames dropped because parts of them were missing or damaged.
    pub incomplete: u64,
    /// Frames the camera captured but of which nothing arrived.
    pub lost: u64,
    /// Number of starts; more than one means that the camera was away.
    pub starts: u64,
    /// A [`CameraState`] number.
    pub state: u32,
    /// Which camera, counted from 0.
    pub camera_id: u32,
    /// Frames a second promised by the camera or its driver; 0 when unknown.
    pub promised_fps: f32,
    /// Frames a second that arrived complete; 0 when not measured yet.
    pub delivered_fps: f32,
    /// Frame source, as named on the command line: UTF-8, ended by a zero.
    #[cfg_attr(feature = "schema", schemars(with = "crate::structure::List<u8, 96>"))]
    pub device: [u8; 96],
    /// Model, format and transfer, in the same form.
    #[cfg_attr(feature = "schema", schemars(with = "crate::structure::List<u8, 160>"))]
    pub description: [u8; 160],
    /// Problem and remedy, in the same form; empty when there is none.
    #[cfg_attr(feature = "schema", schemars(with = "crate::structure::List<u8, 384>"))]
    pub problem: [u8; 384],
}

const _: () = assert!(size_of::<CameraReport>() == 688);

/// Writes a text into a field of fixed size. A text that is too long is cut between characters.
pub fn write_text(field: &mut [u8], text: &str) {
    let mut end = text.len().min(field.len().saturating_sub(1));
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    field.fill(0);
    field[..end].copy_from_slice(&text.as_bytes()[..end]);
}

/// The text in a field of fixed size; invalid UTF-8 is replaced.
pub fn read_text(field: &[u8]) -> String {
    let end = field.iter().position(|&byte| byte == 0).unwrap_or(field.len());
    String::from_utf8_lossy(&field[..end]).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_cut_between_characters() {
        let mut field = [7; 6];
        write_text(&mut field, "abcdé");
        assert_eq!((read_text(&field), field), ("abcd".to_string(), *b"abcd\0\0"));
        write_text(&mut field, "é");
        assert_eq!(read_text(&field), "é");
        assert_eq!(read_text(b"full"), "full");
        write_text(&mut [], "nothing fits");
    }

    #[test]
    fn states_are_found_by_their_numbers() {
        for (number, state) in CameraState::ALL.into_iter().enumerate() {
            assert_eq!(state as usize, number);
            assert_eq!(CameraState::from_number(number as u32), Some(state));
        }
        assert_eq!(CameraState::from_number(11), None);
    }
}
