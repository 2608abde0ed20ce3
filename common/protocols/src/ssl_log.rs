//! Log files of the SSL: packets with the times at which they were received.
//!
//! All numbers are big-endian. The file begins with `SSL_LOG_FILE` and a version (4 bytes). Then follow
//! messages: time of receipt in nanoseconds since 1970 (8), kind (4), length (4), and the packet. The last
//! message may be an index: the places of all messages in the file (8 each), its own whole length (8), and
//! `INDEXED`. A file whose name ends in `.gz` is compressed as a whole; places are those in the plain file.

use std::io::{self, ErrorKind, Read, Write};

/// The first bytes of a file.
pub const MAGIC: &[u8; 12] = b"SSL_LOG_FILE";
const VERSION: i32 = 1;
/// The last bytes of a file with an index.
const INDEXED: &[u8; 7] = b"INDEXED";
/// Bytes before a packet.
const HEAD: usize = 16;
/// Longest packet: what fits into a datagram, with some reserve.
const MAX_PACKET_BYTES: usize = 1 << 17;
/// Longest index: of eight million messages.
const MAX_INDEX_BYTES: usize = 1 << 26;

/// Kinds of messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Not known here.
    Other(i32),
    /// SSL-Vision until 2014.
    Vision2010,
    /// Referee.
    Referee,
    /// SSL-Vision.
    Vision2014,
    /// A tracker.
    Tracker2020,
    /// The index.
    Index2021,
}

impl Kind {
    /// The kind with this number.
    pub fn from_number(number: i32) -> Self {
        match number {
            2 => Self::Vision2010,
            3 => Self::Referee,
            4 => Self::Vision2014,
            5 => Self::Tracker2020,
            6 => Self::Index2021,
            other => Self::Other(other),
        }
    }

    /// Its number.
    pub fn number(self) -> i32 {
        match self {
            Self::Other(number) => number,
            Self::Vision2010 => 2,
            Self::Referee => 3,
            Self::Vision2014 => 4,
            Self::Tracker2020 => 5,
            Self::Index2021 => 6,
        }
    }

    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Other(_) => "other",
            Self::Vision2010 => "vision_2010",
            Self::Referee => "referee",
            Self::Vision2014 => "vision_2014",
            Self::Tracker2020 => "tracker_2020",
            Self::Index2021 => "index_2021",
        }
    }
}

/// A message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogMessage {
    /// Time of receipt, nanoseconds since 1970.
    pub t_received_ns: i64,
    /// Its kind.
    pub kind: Kind,
    /// The packet.
    pub packet: Vec<u8>,
}

/// Writes a log file.
pub struct LogWriter<W: Write> {
    to: W,
    place: u64,
    index: Vec<u64>,
    last_ns: i64,
}

impl<W: Write> LogWriter<W> {
    /// Begins a file.
    pub fn new(mut to: W) -> io::Result<Self> {
        to.write_all(MAGIC)?;
        to.write_all(&VERSION.to_be_bytes())?;
        Ok(Self { to, place: (MAGIC.len() + 4) as u64, index: vec![], last_ns: 0 })
    }

    /// Appends a message.
    pub fn write(&mut self, t_received_ns: i64, kind: Kind, packet: &[u8]) -> io::Result<()> {
        self.index.push(self.place);
        self.append(t_received_ns, kind, packet)
    }

    /// Number of messages written.
    pub fn messages(&self) -> u64 {
        self.index.len() as u64
    }

    /// Appends the index, and returns what was written to.
    pub fn finish(mut self) -> io::Result<W> {
        let mut packet: Vec<u8> = self.index.iter().flat_map(|place| place.to_be_bytes()).collect();
        let length = (HEAD + packet.len() + 8 + INDEXED.len()) as u64;
        packet.extend(length.to_be_bytes());
        packet.extend(INDEXED);
        self.append(self.last_ns, Kind::Index2021, &packet)?;
        self.to.flush()?;
        Ok(self.to)
    }

    fn append(&mut self, t_received_ns: i64, kind: Kind, packet: &[u8]) -> io::Result<()> {
        let length = i32::try_from(packet.len()).map_err(|_| {
            io::Error::new(ErrorKind::InvalidInput, "the packet is too long for a log")
        })?;
        self.to.write_all(&t_received_ns.to_be_bytes())?;
        self.to.write_all(&kind.number().to_be_bytes())?;
        self.to.write_all(&length.to_be_bytes())?;
        self.to.write_all(packet)?;
        self.place += (HEAD + packet.len()) as u64;
        self.last_ns = self.last_ns.max(t_received_ns);
        Ok(())
    }
}

/// Reads a log file, message by message, the index included.
pub struct LogReader<R: Read> {
    from: R,
    is_over: bool,
}

impl<R: Read> LogReader<R> {
    /// Reads the beginning of a file.
    pub fn new(mut from: R) -> io::Result<Self> {
        let mut head = [0; MAGIC.len() + 4];
        from.read_exact(&mut head)?;
        let (magic, version) = head.split_at(MAGIC.len());
        if magic != MAGIC {
            return Err(bad("this is no log file of the SSL"));
        }
        let version = i32::from_be_bytes([version[0], version[1], version[2], version[3]]);
        if version != VERSION {
            return Err(bad(&format!(
                "version {version} of log files is not known, only {VERSION}"
            )));
        }
        Ok(Self { from, is_over: false })
    }

    fn message(&mut self) -> io::Result<Option<LogMessage>> {
        let mut head = [0; HEAD];
        let mut length = 0;
        while length < HEAD {
            match self.from.read(&mut head[length..]) {
                Ok(0) if length == 0 => return Ok(None),
                Ok(0) => return Err(bad("the file ends within a message")),
                Ok(more) => length += more,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        let [a, b, c, d, e, f, g, h, k, l, m, n, rest @ ..] = head;
        let kind = Kind::from_number(i32::from_be_bytes([k, l, m, n]));
        let length = i32::from_be_bytes(rest);
        let most = if kind == Kind::Index2021 { MAX_INDEX_BYTES } else { MAX_PACKET_BYTES };
        let length = usize::try_from(length).ok().filter(|&length| length <= most);
        let length = length.ok_or_else(|| bad("a message has an impossible length"))?;
        let mut packet = vec![];
        // Read as much as there is, so that a wrong length costs no memory.
        self.from.by_ref().take(length as u64).read_to_end(&mut packet)?;
        if packet.len() < length {
            return Err(bad("the file ends within a message"));
        }
        Ok(Some(LogMessage {
            t_received_ns: i64::from_be_bytes([a, b, c, d, e, f, g, h]),
            kind,
            packet,
        }))
    }
}

/// After an error there are no more messages.
impl<R: Read> Iterator for LogReader<R> {
    type Item = io::Result<LogMessage>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.is_over {
            return None;
        }
        let next = self.message().transpose();
        self.is_over = !matches!(next, Some(Ok(_)));
        next
    }
}

fn bad(what: &str) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, what)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn log() -> Vec<u8> {
        let mut log = LogWriter::new(vec![]).unwrap();
        log.write(7, Kind::Vision2014, b"first").unwrap();
        log.write(9, Kind::Tracker2020, b"").unwrap();
        assert_eq!(log.messages(), 2);
        log.finish().unwrap()
    }

    #[test]
    fn the_bytes_are_those_of_the_league() {
        let mut expected = b"SSL_LOG_FILE\0\0\0\x01".to_vec();
        expected.extend(b"\0\0\0\0\0\0\0\x07\0\0\0\x04\0\0\0\x05first");
        expected.extend(b"\0\0\0\0\0\0\0\x09\0\0\0\x05\0\0\0\0");
        // Two places, and the length of all that follows here with its head: 16 + 2 · 8 + 8 + 7.
        expected.extend(b"\0\0\0\0\0\0\0\x09\0\0\0\x06\0\0\0\x1f");
        expected.extend(b"\0\0\0\0\0\0\0\x10\0\0\0\0\0\0\0\x25");
        expected.extend(b"\0\0\0\0\0\0\0\x2fINDEXED");
        assert_eq!(log(), expected);
    }

    #[test]
    fn messages_are_read_back_and_the_index_leads_to_them() {
        let log = log();
        let all: Vec<LogMessage> =
            LogReader::new(&log[..]).unwrap().collect::<Result<_, _>>().unwrap();
        assert_eq!(all.len(), 3);
        assert_eq!((all[0].t_received_ns, all[0].kind), (7, Kind::Vision2014));
        assert_eq!(all[0].packet, b"first");
        let index = &all[2].packet;
        for (place, message) in index.chunks(8).zip(&all[..2]) {
            let place = u64::from_be_bytes(place.try_into().unwrap()) as usize;
            assert_eq!(log[place..place + 8], message.t_received_ns.to_be_bytes());
        }
        let back = log.len() - 0x2f;
        assert_eq!(log[back + 8..back + 12], 6i32.to_be_bytes(), "where the index begins");
    }

    #[test]
    fn damaged_files_have_an_end() {
        let log = log();
        for length in 0..log.len() {
            let Ok(reader) = LogReader::new(&log[..length]) else { continue };
            let read: Vec<_> = reader.collect();
            assert!(read.len() <= 3);
        }
        for wrong in [-1i32, i32::MAX, i32::MIN] {
            let mut log = log.clone();
            log[28..32].copy_from_slice(&wrong.to_be_bytes());
            let read: Vec<_> = LogReader::new(&log[..]).unwrap().collect();
            assert!(read.len() == 1 && read[0].is_err(), "{wrong}");
        }
        assert!(LogReader::new(&b"SSL_LOG_FILE\0\0\0\x02"[..]).is_err());
    }

    proptest! {
        #[test]
        fn no_bytes_bring_the_reader_down(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let with_head = [&b"SSL_LOG_FILE\0\0\0\x01"[..], &bytes].concat();
            for bytes in [&bytes, &with_head] {
                if let Ok(reader) = LogReader::new(&bytes[..]) {
                    prop_assert!(reader.count() <= bytes.len());
                }
            }
        }
    }
}
