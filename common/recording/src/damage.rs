//! Damage in a recording: position, size, and the part of the match that it affects.

use serde::Serialize;
use std::fmt;

/// Damaged parts listed individually; further ones are only counted.
const MAX_PARTS: usize = 100;

/// Kind of damage in a part of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// The checksum shows that these messages are not what was recorded.
    Checksum,
    /// The bytes contain no recognisable record.
    Unreadable,
    /// The chunk has a compression that this program cannot read.
    Compression,
    /// The records of a chunk are inconsistent, although its checksum is right.
    Records,
    /// Messages of a channel that no readable part of the file describes.
    UnknownChannel,
    /// The messages are intact, but a length, a time or a mark around them is wrong.
    Framing,
    /// The messages are intact, but viewers lack their index.
    Index,
    /// The file ends inside a chunk.
    CutOff,
    /// A damaged part that an earlier recovery has fenced off.
    FencedOff,
}

impl Fault {
    /// Whether messages are lost with it.
    pub fn has_lost_messages(self) -> bool {
        !matches!(self, Self::Framing | Self::Index)
    }

    fn text(self) -> &'static str {
        match self {
            Self::Checksum => "are not what was recorded (wrong checksum)",
            Self::Unreadable => "are not valid records",
            Self::Compression => "are compressed with a method that this program cannot read",
            Self::Records => "contradict themselves",
            Self::UnknownChannel => "are of channels that nothing describes",
            Self::Framing => "have a wrong length or mark; no messages are lost",
            Self::Index => "of the index are wrong; no messages are lost",
            Self::CutOff => "at the end are an incomplete chunk",
            Self::FencedOff => "are damaged and fenced off by `touchline recover`",
        }
    }
}

/// A damaged part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Damage {
    /// Kind of damage.
    pub fault: Fault,
    /// File offset of its beginning.
    pub at_byte: u64,
    /// Its length.
    pub bytes: u64,
    /// Time of the newest message before it.
    pub after_ns: Option<u64>,
    /// Time of the first message after it.
    pub until_ns: Option<u64>,
    /// Time of the first message of the recording.
    pub begin_ns: Option<u64>,
}

impl Damage {
    /// Duration of the affected part of the recording, if there are messages before and after it.
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
            (Some(after), None, _) => write!(f, "; everything after {:.2} s", second(after)),
            (None, Some(_), _) => write!(f, "; everything before the first message"),
            _ => Ok(()),
        }
    }
}

/// All damage in a recording, in file order.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Damages {
    /// The first damaged parts.
    pub parts: Vec<Damage>,
    /// Number of damaged parts.
    pub count: u64,
    /// Total size of the damaged parts.
    pub bytes: u64,
    /// Whether the file is finished.
    pub is_finished: bool,
    #[serde(skip)]
    begin_ns: Option<u64>,
    #[serde(skip)]
    newest_ns: Option<u64>,
    /// Index of the first part without a message after it so far.
    #[serde(skip)]
    open_from: usize,
}

impl Damages {
    /// Whether there is no damage, past damage included.
    pub fn is_empty(&self) -> bool {
        self.count == 0 && self.is_finished
    }

    /// Whether a recovery would change the file.
    pub fn is_recoverable(&self) -> bool {
        !self.is_finished
            || self.count > self.parts.len() as u64
            || self.parts.iter().any(|part| part.fault != Fault::FencedOff)
    }

    /// Seconds lost in the listed parts, as far as known.
    pub fn seconds(&self) -> f64 {
        self.parts.iter().filter_map(Damage::seconds).fold(0.0, |sum, seconds| sum + seconds)
    }

    /// Records a damaged part, and merges it with an adjacent part of the same kind.
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
        if self.parts.len() < MAX_PARTS {
            let (after_ns, begin_ns) = (self.newest_ns, self.begin_ns);
            self.parts.push(Damage { fault, at_byte, bytes, after_ns, until_ns: None, begin_ns });
        }
    }

    /// Records the time of a message that was read.
    pub(crate) fn note_time(&mut self, t_ns: u64) {
        self.begin_ns = Some(self.begin_ns.map_or(t_ns, |begin_ns| begin_ns.min(t_ns)));
        self.newest_ns = Some(self.newest_ns.map_or(t_ns, |newest_ns| newest_ns.max(t_ns)));
        for part in &mut self.parts[self.open_from..] {
            part.until_ns = Some(t_ns);
        }
        self.open_from = self.parts.len();
    }
}
