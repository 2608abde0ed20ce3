//! What is wrong with a recording: where, how much, and how long a part of the match it concerns.

use serde::Serialize;
use std::fmt;

/// Damaged parts that are listed one by one; further ones are only added up.
const MOST_PARTS: usize = 100;

/// What is wrong with a part of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// The check sum says that these messages are not what was recorded.
    Checksum,
    /// No record can be made out.
    Unreadable,
    /// The chunk is compressed in a way that this program does not read.
    Compression,
    /// The records of a chunk contradict each other, though its check sum is right.
    Records,
    /// Messages of a channel that no readable part of the file describes.
    UnknownChannel,
    /// The messages are there; what is wrong is a length, a time or a mark around them.
    Framing,
    /// The messages are there; viewers miss their index.
    Index,
    /// The file ends in the middle of a chunk.
    CutOff,
    /// A damaged part that an earlier recovery has fenced off.
    FencedOff,
}

impl Fault {
    /// Whether messages are missing because of it.
    pub fn has_lost_messages(self) -> bool {
        !matches!(self, Self::Framing | Self::Index)
    }

    fn text(self) -> &'static str {
        match self {
            Self::Checksum => "are not what was recorded (wrong check sum)",
            Self::Unreadable => "are no records",
            Self::Compression => "are compressed in a way that this program cannot read",
            Self::Records => "contradict themselves",
            Self::UnknownChannel => "are of channels that are not described",
            Self::Framing => "have a wrong length or mark; their messages are all there",
            Self::Index => "of the index are wrong; messages are all there",
            Self::CutOff => "at the end are a chunk that was not completed",
            Self::FencedOff => "are damaged and fenced off by `touchline recover`",
        }
    }
}

/// A damaged part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Damage {
    /// What is wrong with it.
    pub fault: Fault,
    /// Where it begins in the file.
    pub at_byte: u64,
    /// How long it is.
    pub bytes: u64,
    /// Time of the newest message before it.
    pub after_ns: Option<u64>,
    /// Time of the first message behind it.
    pub until_ns: Option<u64>,
    /// Time of the first message of the recording.
    pub begin_ns: Option<u64>,
}

impl Damage {
    /// So many seconds of the recording it concerns, if messages frame it on both sides.
    pub fn seconds(&self) -> Option<f64> {
        match (self.after_ns, self.until_ns) {
            (Some(after), Some(until)) if self.fault.has_lost_messages() => {
                Some(until.saturating_sub(after) as f64 / 1e9)
            }
            _ => None,
        }
    }
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { fault, at_byte, bytes, .. } = self;
        write!(f, "{bytes} bytes from byte {at_byte} on {}", fault.text())?;
        if !fault.has_lost_messages() {
            return Ok(());
        }
        let second = |t_ns: u64| t_ns.saturating_sub(self.begin_ns.unwrap_or(t_ns)) as f64 / 1e9;
        match (self.after_ns, self.until_ns, self.seconds()) {
            (Some(after), Some(until), Some(lost)) => write!(
                f,
                "; {lost:.2} s of the recording, from {:.2} s to {:.2} s",
                second(after),
                second(until.max(after))
            ),
            (Some(after), None, _) => write!(f, "; what came after {:.2} s", second(after)),
            (None, Some(_), _) => write!(f, "; what came before the first message"),
            _ => Ok(()),
        }
    }
}

/// All that is wrong with a recording, in the order of the file.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Damages {
    /// The first of them.
    pub parts: Vec<Damage>,
    /// How many there are.
    pub count: u64,
    /// How many bytes they have together.
    pub bytes: u64,
    /// Whether the file has a proper end.
    pub is_finished: bool,
    #[serde(skip)]
    begin_ns: Option<u64>,
    #[serde(skip)]
    newest_ns: Option<u64>,
    /// Parts from here on have no message behind them yet.
    #[serde(skip)]
    open_from: usize,
}

impl Damages {
    /// Whether nothing is wrong, or ever was.
    pub fn is_empty(&self) -> bool {
        self.count == 0 && self.is_finished
    }

    /// Whether a recovery would change the file.
    pub fn is_recoverable(&self) -> bool {
        !self.is_finished
            || self.count > self.parts.len() as u64
            || self.parts.iter().any(|part| part.fault != Fault::FencedOff)
    }

    /// Seconds of the recording that are missing in the listed parts, as far as can be told.
    pub fn seconds(&self) -> f64 {
        self.parts.iter().filter_map(Damage::seconds).fold(0.0, |sum, seconds| sum + seconds)
    }

    /// Notes a damaged part. What continues the part before it is added to that.
    pub(crate) fn add(&mut self, fault: Fault, at_byte: u64, bytes: u64) {
        let is_noted =
            |part: &Damage| part.at_byte == at_byte && part.fault == fault && part.bytes == bytes;
        if self.parts.last().is_some_and(is_noted) {
            return;
        }
        self.bytes += bytes;
        if let Some(last) = self.parts.last_mut()
            && last.at_byte + last.bytes == at_byte
            && last.fault == fault
            && last.until_ns.is_none()
        {
            last.bytes += bytes;
            return;
        }
        self.count += 1;
        if self.parts.len() < MOST_PARTS {
            let (after_ns, begin_ns) = (self.newest_ns, self.begin_ns);
            self.parts.push(Damage { fault, at_byte, bytes, after_ns, until_ns: None, begin_ns });
        }
    }

    /// Notes the time of a message that was read.
    pub(crate) fn heard(&mut self, t_ns: u64) {
        self.begin_ns = Some(self.begin_ns.map_or(t_ns, |begin_ns| begin_ns.min(t_ns)));
        self.newest_ns = Some(self.newest_ns.map_or(t_ns, |newest_ns| newest_ns.max(t_ns)));
        for part in &mut self.parts[self.open_from..] {
            part.until_ns = Some(t_ns);
        }
        self.open_from = self.parts.len();
    }
}
