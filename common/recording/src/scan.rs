//! The scanner, through which all recordings are read: sequentially, piece by piece, without trusting
//! any length.
//!
//! * A length counts only as far as the file has bytes, and memory is allocated for existing data, not
//!   for claimed data. A chunk that claims to be large is first decompressed in small steps to check
//!   that.
//! * Messages are taken only from chunks with the right checksum.
//! * A chunk has its length twice. If one is wrong, the other is tried, and the checksum decides.
//! * Where no record can be recognised, the next one is searched byte by byte, and the bytes up to it
//!   are reported as damaged. The time is proportional to the size of the file, since failed
//!   decompression has a budget.
//! * The summary at the end counts only if its checksum is right. It then gives the end of the messages
//!   and the channels, even if the chunk that describes them is damaged.

use crate::bytes::Bytes;
use crate::damage::Fault;
use crate::wire::{
    CHUNK_PEEK_BYTES, ChunkHeader, Cursor, FOOTER_BYTES, HEAD_BYTES, Head, MAGIC, Packing, channel,
    message, message_index, op, schema, zstd_window,
};
use std::fs::File;
use std::io::{self, Read};

/// Chunks up to this size are decompressed at once.
const DIRECT_BYTES: u64 = 16 << 20;
/// Largest chunk accepted: more than the largest frame of the largest camera.
const MAX_CHUNK_BYTES: u64 = 1 << 30;
/// Largest window (log2) in the compression of a large chunk.
const WINDOW_LOG: u32 = 24;
/// Largest window that other readers accept.
const MAX_WINDOW_BYTES: u64 = 1 << 27;
/// Bytes at the beginning of a zstd frame that contain its window.
pub(crate) const ZSTD_PEEK_BYTES: usize = 8;
/// Largest total size of the schemas and channels in a summary.
const MAX_DESCRIPTION_BYTES: usize = 16 << 20;
/// Largest size of the first record, which names the library that wrote the file.
pub(crate) const MAX_HEADER_BYTES: u64 = 128;
/// Length of the record that ends the data.
const DATA_END_BYTES: u64 = HEAD_BYTES + 4;

/// A piece of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Piece {
    pub at: u64,
    pub length: u64,
    pub kind: Kind,
}

/// Kind of a piece.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A chunk, with its decompressed records in [`Scanner::records`]. `is_framed`: everything around
    /// the records is right too.
    Chunk { header: ChunkHeader, is_framed: bool },
    /// A schema, channel or message outside of chunks, in [`Scanner::records`].
    Loose,
    /// The index of a chunk's messages of one channel, in [`Scanner::records`].
    MessageIndex,
    /// A record without messages.
    Other,
    /// An unusable part.
    Damaged(Fault),
    /// The end of the data: the position of its mark, present or not.
    End { is_marked: bool },
}

/// The summary of a finished recording.
#[derive(Debug, Clone, Copy)]
struct Summary {
    start: u64,
    footer: u64,
}

/// Reads a recording piece by piece.
pub(crate) struct Scanner {
    bytes: Bytes,
    unpacker: zstd::bulk::Decompressor<'static>,
    records: Vec<u8>,
    place: u64,
    /// Upper bound of the end of the data.
    limit: u64,
    summary: Option<Summary>,
    /// Remaining budget of bytes decompressed in vain.
    patience: u64,
    /// Chunks may lack a checksum, because another program wrote them.
    may_lack_checksums: bool,
    has_chunks: bool,
    is_over: bool,
}

impl Scanner {
    /// Starts reading; `None` if the file does not begin like a recording.
    pub fn new(file: File) -> io::Result<Option<Self>> {
        let mut bytes = Bytes::new(file)?;
        let length = bytes.length();
        if bytes.at(0, MAGIC.len())? != MAGIC {
            return Ok(None);
        }
        let summary = summary(&mut bytes)?;
        let may_lack_checksums = !is_ours(&mut bytes)?;
        Ok(Some(Self {
            bytes,
            unpacker: zstd::bulk::Decompressor::new()?,
            records: Vec::new(),
            place: MAGIC.len() as u64,
            limit: summary.map_or(length, |summary| summary.start),
            summary,
            patience: 4 * length + 4 * DIRECT_BYTES,
            may_lack_checksums,
            has_chunks: false,
            is_over: false,
        }))
    }

    /// Length of the file.
    pub fn length(&self) -> u64 {
        self.bytes.length()
    }

    /// Upper bound of the end of the data.
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// The file.
    pub fn bytes(&mut self) -> &mut Bytes {
        &mut self.bytes
    }

    /// Whether the file ends with a valid summary.
    pub fn has_summary(&self) -> bool {
        self.summary.is_some()
    }

    /// The records of the last piece.
    pub fn records(&self) -> &[u8] {
        &self.records
    }

    /// Schemas and channels from the summary.
    pub fn descriptions(&mut self) -> io::Result<Vec<(u8, Vec<u8>)>> {
        let (mut room, mut found) = (MAX_DESCRIPTION_BYTES, Vec::new());
        self.read_summary(&[op::SCHEMA, op::CHANNEL], |opcode, body| {
            if body.len() <= room {
                room -= body.len();
                found.push((opcode, body.to_vec()));
            }
        })?;
        Ok(found)
    }

    /// Calls `take` with operation code and body of each record of these kinds in the summary.
    pub fn read_summary(
        &mut self,
        kinds: &[u8],
        mut take: impl FnMut(u8, &[u8]),
    ) -> io::Result<()> {
        let Some(summary) = self.summary else { return Ok(()) };
        let mut place = summary.start;
        while let Some(head) = Head::parse(self.bytes.at(place, HEAD_BYTES as usize)?) {
            let rest = summary.footer.saturating_sub(place + HEAD_BYTES);
            if place >= summary.footer || head.length > rest {
                break;
            }
            if kinds.contains(&head.opcode) {
                let body = self.bytes.at(place + HEAD_BYTES, head.length as usize)?;
                take(head.opcode, body);
            }
            place += HEAD_BYTES + head.length;
        }
        Ok(())
    }

    /// Goes on at this offset of the file.
    pub fn seek(&mut self, at: u64) {
        self.place = at;
        self.is_over = false;
    }

    /// The next piece; `None` after the end.
    pub fn next(&mut self) -> io::Result<Option<Piece>> {
        self.records.clear();
        if self.is_over {
            return Ok(None);
        }
        let at = self.place;
        let piece = match self.piece_at(at)? {
            Some(piece) => piece,
            None => {
                let next = self.find(at + 1)?;
                let length = next - at;
                Piece { at, length, kind: Kind::Damaged(self.fault_of(at, next)?) }
            }
        };
        self.has_chunks |= matches!(piece.kind, Kind::Chunk { .. });
        self.is_over = matches!(piece.kind, Kind::End { .. });
        self.place = at + piece.length;
        Ok(Some(piece))
    }

    /// Fault of a range of bytes without a recognisable record.
    fn fault_of(&mut self, at: u64, next: u64) -> io::Result<Fault> {
        let is_at_end = next == self.limit && self.summary.is_none();
        let head = Head::parse(self.bytes.at(at, HEAD_BYTES as usize)?);
        let goes_beyond = head.is_none_or(|head| {
            head.is_plausible(u64::MAX) && !head.is_plausible(next - at - HEAD_BYTES.min(next - at))
        });
        Ok(match () {
            () if is_at_end && goes_beyond => Fault::CutOff,
            // No message precedes the end of the header, or lies between the last chunk and the
            // summary.
            () if at == MAGIC.len() as u64 && next - at <= MAX_HEADER_BYTES => Fault::Framing,
            () if self.summary.is_some() && next == self.limit && next - at == DATA_END_BYTES => {
                Fault::Framing
            }
            () => Fault::Unreadable,
        })
    }

    fn piece_at(&mut self, at: u64) -> io::Result<Option<Piece>> {
        let rest = self.limit.saturating_sub(at);
        if rest == 0 {
            let kind = Kind::End { is_marked: false };
            return Ok(Some(Piece { at, length: 0, kind }));
        }
        let peek = self.bytes.at(at, CHUNK_PEEK_BYTES as usize)?;
        let Some(head) = Head::parse(peek).filter(|_| rest >= HEAD_BYTES) else { return Ok(None) };
        let header = ChunkHeader::parse(&peek[HEAD_BYTES as usize..]);
        let room = rest - HEAD_BYTES;
        if let Some(header) = header.filter(|_| head.opcode != op::FENCED_OFF)
            && let Some(piece) = self.chunk_at(at, head, header, room)?
        {
            return Ok(Some(piece));
        }
        if !head.is_plausible(room) {
            return Ok(None);
        }
        let length = HEAD_BYTES + head.length;
        let piece = |kind| Some(Piece { at, length, kind });
        let is_followed = self.is_plausible_at(at + length)?;
        Ok(match head.opcode {
            op::HEADER if at == MAGIC.len() as u64 => {
                let mut cursor = Cursor(self.bytes.at(at, length as usize)?);
                let body = cursor.record().map(|(_, body)| body).unwrap_or_default();
                let mut body = Cursor(body);
                let is_right = body.prefixed().is_some() && body.prefixed().is_some();
                piece(Kind::Other).filter(|_| is_right && body.0.is_empty())
            }
            // A message outside of a chunk has no checksum, so in a file with chunks it counts as
            // damage.
            op::MESSAGE if self.has_chunks => self.damaged_index_at(at, length, is_followed)?,
            op::SCHEMA | op::CHANNEL | op::MESSAGE if is_followed => {
                let makes_sense = match (head.opcode, self.load(at, length)?) {
                    (op::SCHEMA, body) => schema(body).is_some(),
                    (op::CHANNEL, body) => channel(body).is_some(),
                    (_, body) => message(body).is_some(),
                };
                piece(Kind::Loose).filter(|_| makes_sense)
            }
            op::MESSAGE_INDEX => {
                let makes_sense = message_index(self.load(at, length)?).is_some();
                piece(Kind::MessageIndex).filter(|_| makes_sense)
            }
            op::FENCED_OFF if is_followed => piece(Kind::Damaged(Fault::FencedOff)),
            op::ATTACHMENT | op::METADATA | op::FIRST_PRIVATE.. if is_followed => {
                let index = self.damaged_index_at(at, length, is_followed)?;
                index.or(piece(Kind::Other))
            }
            op::DATA_END if length == DATA_END_BYTES && is_followed => {
                let is_right = self.summary.is_none_or(|summary| at + length == summary.start);
                let kind = Kind::End { is_marked: true };
                Some(Piece { at, length: 0, kind }).filter(|_| is_right)
            }
            _ => self.damaged_index_at(at, length, is_followed)?,
        })
    }

    /// A message index under a wrong operation code; no message is lost with it.
    fn damaged_index_at(
        &mut self,
        at: u64,
        length: u64,
        is_followed: bool,
    ) -> io::Result<Option<Piece>> {
        let is_index = is_followed && message_index(self.load(at, length)?).is_some();
        let kind = Kind::Damaged(Fault::Index);
        Ok(is_index.then_some(Piece { at, length, kind }))
    }

    /// Loads a whole record into `records`, and returns its body.
    fn load(&mut self, at: u64, length: u64) -> io::Result<&[u8]> {
        let record = self.bytes.at(at, length as usize)?;
        self.records.clear();
        self.records.extend_from_slice(record);
        Ok(&self.records[HEAD_BYTES as usize..])
    }

    /// Whether a record or the end of the data may be at this offset.
    fn is_plausible_at(&mut self, at: u64) -> io::Result<bool> {
        if at == self.limit {
            return Ok(true);
        }
        let rest = self.limit.saturating_sub(at + HEAD_BYTES);
        let head = Head::parse(self.bytes.at(at, HEAD_BYTES as usize)?);
        Ok(head.is_some_and(|head| head.is_plausible(rest)))
    }

    /// The chunk at this offset, good or damaged, if there is one. A wrong operation code or one wrong
    /// length is corrected from the rest of the head.
    fn chunk_at(
        &mut self,
        at: u64,
        head: Head,
        header: ChunkHeader,
        room: u64,
    ) -> io::Result<Option<Piece>> {
        let (is_named, outer) = (head.opcode == op::CHUNK, head.length.checked_sub(header.length));
        let claimed = HEAD_BYTES.saturating_add(head.length);
        let is_framed = is_named
            && head.length <= room
            && outer.is_some_and(|outer| outer >= header.packed_bytes);
        let agrees = outer == Some(header.packed_bytes) && header.packed_bytes > 0;
        if !is_named && !agrees {
            return Ok(None);
        }
        let data_at = at + HEAD_BYTES + header.length;
        let most = room.saturating_sub(header.length);
        let is_checked = header.crc != 0 || (is_named && agrees);
        if let Some(packing) = header.packing.filter(|_| is_checked) {
            let second = outer.filter(|&outer| outer != header.packed_bytes);
            for packed in [Some(header.packed_bytes), second].into_iter().flatten() {
                if packed > most || !self.unpack(data_at, packed, packing, &header)? {
                    continue;
                }
                // Extra bytes after the compressed data are allowed.
                let mut length = data_at + packed - at;
                let frame = self.bytes.at(data_at, (packed as usize).min(ZSTD_PEEK_BYTES))?;
                let is_far = packing == Packing::Zstd
                    && zstd_window(frame).is_some_and(|(_, window)| window > MAX_WINDOW_BYTES);
                let mut is_framed = is_framed && packed == header.packed_bytes && !is_far;
                if claimed != length {
                    is_framed = is_framed && self.is_plausible_at(at + claimed)?;
                    length = if is_framed { claimed } else { length };
                }
                let header = ChunkHeader { packed_bytes: packed, ..header };
                return Ok(Some(Piece { at, length, kind: Kind::Chunk { header, is_framed } }));
            }
        }
        if is_named && agrees && head.length <= room {
            let length = claimed;
            let fault = if header.packing.is_some() { Fault::Checksum } else { Fault::Compression };
            return Ok(Some(Piece { at, length, kind: Kind::Damaged(fault) }));
        }
        Ok(None)
    }

    /// Decompresses a chunk's records; `false` if they are not what the header claims.
    fn unpack(
        &mut self,
        at: u64,
        packed: u64,
        packing: Packing,
        header: &ChunkHeader,
    ) -> io::Result<bool> {
        let unpacked = header.unpacked_bytes;
        // Compression enlarges data by less than this.
        let most_packed = unpacked.saturating_add(unpacked / 64 + 4096);
        if unpacked > MAX_CHUNK_BYTES || packed > most_packed || self.patience == 0 {
            return Ok(false);
        }
        let may_lack = self.may_lack_checksums;
        let data = self.bytes.at(at, packed as usize)?;
        let is_right = match packing {
            Packing::Plain => {
                let is_right = packed == unpacked && has_crc(header, data, may_lack);
                if is_right {
                    make_room(&mut self.records, data.len());
                    self.records.extend_from_slice(data);
                }
                is_right
            }
            Packing::Zstd => {
                let is_believed = unpacked <= DIRECT_BYTES || is_as_long(data, unpacked);
                is_believed && {
                    make_room(&mut self.records, unpacked as usize);
                    let count = self.unpacker.decompress_to_buffer(data, &mut self.records);
                    count.is_ok_and(|count| count as u64 == unpacked)
                        && has_crc(header, &self.records, may_lack)
                }
            }
        };
        if !is_right {
            self.records.clear();
            self.patience = self.patience.saturating_sub(packed + unpacked.min(DIRECT_BYTES));
        }
        Ok(is_right)
    }

    /// Offset of the next record that can be recognised without context; the end if there is none.
    fn find(&mut self, from: u64) -> io::Result<u64> {
        const STEP: usize = 32 << 10;
        let mut at = from;
        while at + HEAD_BYTES <= self.limit {
            let step = STEP.min((self.limit - at) as usize);
            let window = self.bytes.at(at, step + CHUNK_PEEK_BYTES as usize)?;
            let limit = self.limit;
            let found = (0..step)
                .find(|&offset| is_beginning(&window[offset..], limit - at - offset as u64));
            let Some(offset) = found else {
                at += step as u64;
                continue;
            };
            at += offset as u64;
            let head = Head::parse(self.bytes.at(at, HEAD_BYTES as usize)?);
            let length = head.map_or(0, |head| HEAD_BYTES + head.length);
            let is_chunk = head.is_some_and(|head| head.opcode == op::CHUNK);
            if is_chunk || self.is_plausible_at(at + length)? {
                return Ok(at);
            }
            at += 1;
        }
        Ok(self.limit)
    }
}

/// Whether these bytes, with `rest` bytes left, look like the beginning of a chunk, a fenced-off part,
/// or the end of the data.
fn is_beginning(bytes: &[u8], rest: u64) -> bool {
    let Some(&opcode) = bytes.first() else { return false };
    if !matches!(opcode, op::CHUNK | op::FENCED_OFF | op::DATA_END) {
        return false;
    }
    let Some(head) = Head::parse(bytes).filter(|_| rest >= HEAD_BYTES) else { return false };
    let is_inside = head.length <= rest - HEAD_BYTES;
    match opcode {
        op::DATA_END => is_inside && head.length == DATA_END_BYTES - HEAD_BYTES,
        op::CHUNK => ChunkHeader::parse(&bytes[HEAD_BYTES as usize..]).is_some_and(|header| {
            header.packing.is_some()
                && header.packed_bytes > 0
                && head.length.checked_sub(header.length) == Some(header.packed_bytes)
                && is_inside
        }),
        _ => is_inside,
    }
}

/// Empties a buffer and gives it at least this capacity, but not far more.
fn make_room(buffer: &mut Vec<u8>, bytes: usize) {
    buffer.clear();
    if buffer.capacity() as u64 > DIRECT_BYTES.max(bytes as u64) {
        *buffer = Vec::new();
    }
    buffer.reserve_exact(bytes);
}

/// Whether the file is as this program wrote it, by its header: then every chunk has a checksum, and one
/// of zeros is damage. A repaired file may be another program's.
fn is_ours(bytes: &mut Bytes) -> io::Result<bool> {
    let start = bytes.at(MAGIC.len() as u64, MAX_HEADER_BYTES as usize)?;
    let library = Cursor(start).record().and_then(|(opcode, body)| {
        let mut cursor = Cursor(body);
        let _profile = cursor.prefixed()?;
        cursor.text().filter(|_| opcode == op::HEADER)
    });
    Ok(library.is_some_and(|name| name.starts_with("touchline ") && !name.contains("recovered")))
}

fn has_crc(header: &ChunkHeader, records: &[u8], may_lack: bool) -> bool {
    header.crc == 0 && may_lack || crc32fast::hash(records) == header.crc
}

/// Whether compressed bytes expand to exactly this many. Takes little memory at any size.
fn is_as_long(packed: &[u8], unpacked: u64) -> bool {
    let Ok(mut decoder) = zstd::stream::read::Decoder::with_buffer(packed) else { return false };
    if decoder.window_log_max(WINDOW_LOG).is_err() {
        return false;
    }
    let counted = io::copy(&mut decoder.take(unpacked + 1), &mut io::sink());
    counted.is_ok_and(|count| count == unpacked)
}

/// The summary at the end of a file, if there is one with a right checksum.
fn summary(bytes: &mut Bytes) -> io::Result<Option<Summary>> {
    let least = MAGIC.len() as u64 + DATA_END_BYTES;
    let ending = HEAD_BYTES + FOOTER_BYTES + MAGIC.len() as u64;
    let Some(footer) = bytes.length().checked_sub(ending).filter(|&footer| footer >= least) else {
        return Ok(None);
    };
    let end = bytes.at(footer, ending as usize)?;
    let mut cursor = Cursor(end);
    let head = cursor.bytes(HEAD_BYTES as usize).and_then(Head::parse);
    let (start, _offsets, crc) = (cursor.u64(), cursor.u64(), cursor.u32());
    let is_footer = head == Some(Head { opcode: op::FOOTER, length: FOOTER_BYTES });
    let (Some(start), Some(crc)) = (start, crc) else { return Ok(None) };
    let start = if start == 0 { footer } else { start };
    if !is_footer || !end.ends_with(MAGIC) || !(least..=footer).contains(&start) {
        return Ok(None);
    }
    let is_right = if crc == 0 {
        let data_end = Head { opcode: op::DATA_END, length: DATA_END_BYTES - HEAD_BYTES };
        Head::parse(bytes.at(start - DATA_END_BYTES, HEAD_BYTES as usize)?) == Some(data_end)
    } else {
        // The checksum covers the footer except for itself.
        crc == crc_of(bytes, start, footer + HEAD_BYTES + FOOTER_BYTES - 4)?
    };
    Ok(is_right.then_some(Summary { start, footer }))
}

/// The checksum of a range of a file.
pub(crate) fn crc_of(bytes: &mut Bytes, from: u64, to: u64) -> io::Result<u32> {
    const STEP: u64 = 64 << 10;
    let mut hasher = crc32fast::Hasher::new();
    let mut place = from;
    while place < to {
        let part = bytes.at(place, STEP.min(to - place) as usize)?;
        if part.is_empty() {
            break;
        }
        hasher.update(part);
        place += part.len() as u64;
    }
    Ok(hasher.finalize())
}
