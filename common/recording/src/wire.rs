//! The records of an MCAP file as bytes. Every length is checked against the available bytes before
//! use; no allocation depends on a claimed length.

use binrw::BinWrite;
use mcap::records;
use std::collections::BTreeMap;
use std::io;

/// First and last bytes of a file.
pub(crate) const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";
/// Operation code and length before every record.
pub(crate) const HEAD_BYTES: u64 = 9;
/// Bytes of a chunk's header without the name of its compression.
const CHUNK_HEADER_BYTES: u64 = 40;
/// Bytes of a message's header.
const MESSAGE_HEADER_BYTES: usize = 22;
/// Bytes of a footer's body.
pub(crate) const FOOTER_BYTES: u64 = 20;
/// Longest accepted name of a compression.
const MAX_NAME_BYTES: u64 = 16;
/// Bytes that hold a chunk's head and header.
pub(crate) const CHUNK_PEEK_BYTES: u64 = HEAD_BYTES + CHUNK_HEADER_BYTES + MAX_NAME_BYTES;

/// Operation codes: those of the format, and ours.
pub(crate) mod op {
    pub use mcap::records::op::*;

    /// Private records begin here; other programs skip them.
    pub const FIRST_PRIVATE: u8 = 0x80;
    /// Damaged bytes that a recovery has fenced off. Its bits are the complement of a chunk's code, so
    /// that no flipped bit turns one into the other.
    pub const FENCED_OFF: u8 = !CHUNK;
}

/// The body of a record.
pub(crate) fn body(record: &impl BinWrite<Args<'static> = ()>) -> Vec<u8> {
    let mut bytes = io::Cursor::new(Vec::new());
    // Memory takes everything, and texts and lists here are far shorter than 4 GB.
    record.write_le_args(&mut bytes, ()).expect("a record can be written to memory");
    bytes.into_inner()
}

/// Reads values from the front of bytes; `None` if there are too few.
pub(crate) struct Cursor<'a>(pub &'a [u8]);

impl<'a> Cursor<'a> {
    pub fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.bytes(N)?.try_into().ok()
    }

    pub fn u8(&mut self) -> Option<u8> {
        self.array::<1>().map(|[byte]| byte)
    }

    pub fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// A text or list preceded by its length.
    pub fn prefixed(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()?;
        self.bytes(length as usize)
    }

    pub fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.prefixed()?).ok()
    }

    /// A record preceded by its head: operation code and body.
    pub fn record(&mut self) -> Option<(u8, &'a [u8])> {
        let mut ahead = Cursor(self.0);
        let (opcode, length) = (ahead.u8()?, ahead.u64()?);
        let body = ahead.bytes(usize::try_from(length).ok()?)?;
        self.0 = ahead.0;
        Some((opcode, body))
    }
}

/// The head of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Head {
    pub opcode: u8,
    /// Length of the body claimed by the file.
    pub length: u64,
}

impl Head {
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let mut cursor = Cursor(bytes);
        Some(Self { opcode: cursor.u8()?, length: cursor.u64()? })
    }

    /// Whether a record can begin like this, with this many bytes after its head.
    pub fn is_plausible(self, rest: u64) -> bool {
        let is_known = (op::HEADER..=op::DATA_END).contains(&self.opcode);
        (is_known || self.opcode >= op::FIRST_PRIVATE) && self.length <= rest
    }

    pub fn encode(self) -> [u8; HEAD_BYTES as usize] {
        let mut bytes = [0; HEAD_BYTES as usize];
        bytes[0] = self.opcode;
        bytes[1..].copy_from_slice(&self.length.to_le_bytes());
        bytes
    }
}

/// Compression of a chunk's records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Packing {
    Plain,
    Zstd,
}

impl Packing {
    pub fn name(self) -> &'static str {
        match self {
            Self::Plain => "",
            Self::Zstd => "zstd",
        }
    }
}

/// The header of a chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ChunkHeader {
    pub start_ns: u64,
    pub end_ns: u64,
    pub unpacked_bytes: u64,
    /// CRC-32 of the decompressed records; 0 if there is none.
    pub crc: u32,
    /// `None` for an unknown compression.
    pub packing: Option<Packing>,
    pub packed_bytes: u64,
    /// Length of the header itself.
    pub length: u64,
}

impl ChunkHeader {
    /// Length of a header that names this compression.
    pub fn length_with(packing: Packing) -> u64 {
        CHUNK_HEADER_BYTES + packing.name().len() as u64
    }

    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let mut cursor = Cursor(bytes);
        let (start_ns, end_ns) = (cursor.u64()?, cursor.u64()?);
        let (unpacked_bytes, crc) = (cursor.u64()?, cursor.u32()?);
        let name = cursor.prefixed()?;
        let packed_bytes = cursor.u64()?;
        let length = CHUNK_HEADER_BYTES + name.len() as u64;
        let packing = match name {
            b"" => Some(Packing::Plain),
            b"zstd" => Some(Packing::Zstd),
            _ => None,
        };
        Some(Self { start_ns, end_ns, unpacked_bytes, crc, packing, packed_bytes, length })
    }
}

/// Offset of the byte with a zstd frame's window, and the size of that window. It is not needed to
/// decompress a frame at once, but a reader that decompresses in steps allocates that much memory, or
/// refuses to.
pub(crate) fn zstd_window(frame: &[u8]) -> Option<(usize, u64)> {
    const DESCRIPTOR: usize = 4;
    const WINDOW: usize = 5;
    let (descriptor, window) = (*frame.get(DESCRIPTOR)?, *frame.get(WINDOW)?);
    // A single-segment frame has no window byte.
    let has_window = descriptor & 0x20 == 0;
    let base = 1u64 << (10 + (window >> 3));
    has_window.then_some((WINDOW, base + base / 8 * u64::from(window & 7)))
}

/// Encoded size of the shortest window that is as long as the content.
pub(crate) fn zstd_window_for(unpacked_bytes: u64) -> u8 {
    let log = unpacked_bytes.max(1 << 10).next_power_of_two().trailing_zeros();
    ((log - 10) << 3) as u8
}

/// The header of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct MessageHeader {
    pub channel_id: u16,
    pub log_ns: u64,
}

/// Header and data of a message.
pub(crate) fn message(body: &[u8]) -> Option<(MessageHeader, &[u8])> {
    let (header, data) = body.split_at_checked(MESSAGE_HEADER_BYTES)?;
    let mut cursor = Cursor(header);
    let channel_id = cursor.u16()?;
    let _sequence = cursor.u32()?;
    Some((MessageHeader { channel_id, log_ns: cursor.u64()? }, data))
}

/// Id and topic of a channel; `None` if the record is malformed.
pub(crate) fn channel(body: &[u8]) -> Option<(u16, &str)> {
    let mut cursor = Cursor(body);
    let (id, _schema) = (cursor.u16()?, cursor.u16()?);
    let (topic, _encoding) = (cursor.text()?, cursor.text()?);
    let mut metadata = Cursor(cursor.prefixed()?);
    while !metadata.0.is_empty() {
        let (_key, _value) = (metadata.text()?, metadata.text()?);
    }
    cursor.0.is_empty().then_some((id, topic))
}

/// Id of a channel's schema; `None` if it has none.
pub(crate) fn channel_schema(body: &[u8]) -> Option<u16> {
    let mut cursor = Cursor(body);
    let (_id, schema) = (cursor.u16()?, cursor.u16()?);
    Some(schema).filter(|&id| id != 0)
}

/// Id of a schema; `None` if the record is malformed.
pub(crate) fn schema(body: &[u8]) -> Option<u16> {
    let mut cursor = Cursor(body);
    let id = cursor.u16()?;
    let (_name, _encoding) = (cursor.text()?, cursor.text()?);
    cursor.prefixed()?;
    (id != 0 && cursor.0.is_empty()).then_some(id)
}

/// Channel and entries (log time, offset in the chunk) of a message index; `None` if its lengths are
/// inconsistent.
pub(crate) fn message_index(body: &[u8]) -> Option<(u16, Vec<(u64, u64)>)> {
    let mut cursor = Cursor(body);
    let channel_id = cursor.u16()?;
    let entries = cursor.prefixed()?;
    if !cursor.0.is_empty() || !entries.len().is_multiple_of(16) {
        return None;
    }
    let entries = entries.chunks_exact(16).map(|entry| {
        let mut cursor = Cursor(entry);
        (cursor.u64().unwrap_or(0), cursor.u64().unwrap_or(0))
    });
    Some((channel_id, entries.collect()))
}

/// Offsets of a chunk and its message indexes, from a summary.
pub(crate) fn chunk_index(body: &[u8]) -> Option<(u64, BTreeMap<u16, u64>)> {
    let mut cursor = Cursor(body);
    let (_start_ns, _end_ns) = (cursor.u64()?, cursor.u64()?);
    let (at, _length) = (cursor.u64()?, cursor.u64()?);
    let mut entries = Cursor(cursor.prefixed()?);
    let indexes = std::iter::from_fn(|| Some((entries.u16()?, entries.u64()?))).collect();
    Some((at, indexes))
}

/// Times of the earliest and the latest message of a chunk, from a summary.
pub(crate) fn chunk_times(body: &[u8]) -> Option<(u64, u64)> {
    let mut cursor = Cursor(body);
    Some((cursor.u64()?, cursor.u64()?))
}

/// Writes consecutive values.
#[derive(Debug, Default)]
pub(crate) struct Encoder(pub Vec<u8>);

impl Encoder {
    pub fn u32(&mut self, value: u32) -> &mut Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    pub fn u64(&mut self, value: u64) -> &mut Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    pub fn prefixed(&mut self, bytes: &[u8]) -> &mut Self {
        self.u32(bytes.len() as u32);
        self.0.extend(bytes);
        self
    }

    pub fn record(&mut self, opcode: u8, body: &[u8]) -> &mut Self {
        self.head(opcode, body.len() as u64);
        self.0.extend(body);
        self
    }

    fn head(&mut self, opcode: u8, length: u64) -> &mut Self {
        self.0.extend(Head { opcode, length }.encode());
        self
    }

    /// A message's record.
    pub fn message(&mut self, header: records::MessageHeader, data: &[u8]) -> &mut Self {
        let header = body(&header);
        self.head(op::MESSAGE, (header.len() + data.len()) as u64);
        self.0.extend(header);
        self.0.extend(data);
        self
    }

    /// A chunk's record.
    pub fn chunk(&mut self, header: &ChunkHeader, packed: &[u8]) -> &mut Self {
        self.head(op::CHUNK, header.length + header.packed_bytes);
        self.0.extend(body(&records::ChunkHeader {
            message_start_time: header.start_ns,
            message_end_time: header.end_ns,
            uncompressed_size: header.unpacked_bytes,
            uncompressed_crc: header.crc,
            compression: header.packing.map_or("", Packing::name).into(),
            compressed_size: header.packed_bytes,
        }));
        self.0.extend(packed);
        self
    }

    /// The record that gives time and offset of each of a channel's messages in a chunk.
    pub fn message_index(&mut self, channel_id: u16, entries: &[(u64, u64)]) -> &mut Self {
        let entry = |&(log_time, offset)| records::MessageIndexEntry { log_time, offset };
        let records = entries.iter().map(entry).collect();
        self.record(op::MESSAGE_INDEX, &body(&records::MessageIndex { channel_id, records }))
    }
}
