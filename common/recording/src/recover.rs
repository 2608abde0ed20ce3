//! Recovery: makes a proper recording of one that was never finished (its recorder was killed, the disk
//! was full, the power failed) or was damaged later.
//!
//! The scanner (`scan.rs`) splits the file into good pieces and damaged parts, from which a plan of
//! repairs is made. The file is then repaired in place, so that a recovery also works on a full disk:
//!
//! * A damaged part becomes a private record, which all readers skip: its first nine bytes are
//!   overwritten with a record head, the rest stays as it is.
//! * Wrong lengths and times around good messages are corrected.
//! * An incomplete chunk at the end is cut off, and the summary is written after the last good record.
//!
//! Each step leaves a file that can be read and recovered, so an interrupted recovery loses nothing.
//! [`recover_to`] leaves the file unchanged and writes its good pieces to another file, without the
//! damaged bytes. The file format is MCAP (mcap.dev/spec).

use crate::RecordingError;
use crate::damage::{Damages, Fault};
use crate::reader::open;
use crate::scan::{Kind, MAX_HEADER_BYTES, Piece, Scanner, ZSTD_PEEK_BYTES};
use crate::summary::{ChunkIndex, ChunkLocation, Summary, widened};
use crate::wire::{
    ChunkHeader, Cursor, Encoder, HEAD_BYTES, Head, MAGIC, Packing, body, channel, chunk_index,
    message, message_index, op, schema, zstd_window, zstd_window_for,
};
use config::input;
use mcap::records;
use rustix::fs::{FlockOperation, flock};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Length of a new header if there is room, and the shortest possible one.
const HEADER_BYTES: u64 = 64;
const MIN_HEADER_BYTES: u64 = HEAD_BYTES + 8;

/// Result of a recovery.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Recovery {
    /// The recording is intact; nothing was done.
    NotNeeded,
    /// Another process is writing it; nothing was done.
    BeingWritten,
    /// It is a proper recording now.
    Recovered {
        /// Messages in it.
        messages: u64,
        /// The damage found.
        damages: Damages,
    },
}

/// Progress: called with the number of bytes checked and the size of the file.
pub type Progress<'a> = &'a mut dyn FnMut(u64, u64);

/// Whether a recording has a valid summary. Its content is not checked.
pub fn is_finished(path: &Path) -> Result<bool, RecordingError> {
    let io = |source| RecordingError::Io { path: path.into(), action: "open", source };
    Ok(open(path, input::open(path).map_err(io)?)?.has_summary())
}

/// Recovers a recording in place.
pub fn recover(path: &Path, tell: Progress) -> Result<Recovery, RecordingError> {
    let io = |action| move |source| RecordingError::Io { path: path.into(), action, source };
    let file = input::open_to_change(path).map_err(io("open"))?;
    if !lock(&file).map_err(io("lock"))? {
        return Ok(Recovery::BeingWritten);
    }
    let handle = file.try_clone().map_err(io("open"))?;
    let plan = Plan::make(open(path, file)?, tell).map_err(io("read"))?;
    if !plan.damages.is_recoverable() {
        return Ok(Recovery::NotNeeded);
    }
    plan.carry_out(&handle).map_err(io("complete"))?;
    Ok(Recovery::Recovered { messages: plan.summary.messages(), damages: plan.damages })
}

/// Writes the good pieces of a recording to an empty file. An intact recording is copied.
pub fn recover_to(path: &Path, to: &File, tell: Progress) -> Result<Recovery, RecordingError> {
    let io = |action| move |source| RecordingError::Io { path: path.into(), action, source };
    let file = input::open(path).map_err(io("open"))?;
    if !lock(&file).map_err(io("lock"))? {
        return Ok(Recovery::BeingWritten);
    }
    // The lock keeps other processes from taking the copy for an abandoned recording.
    lock(to).map_err(io("lock the copy of"))?;
    let handle = file.try_clone().map_err(io("open"))?;
    let mut plan = Plan::make(open(path, file)?, tell).map_err(io("read"))?;
    plan.copy(&handle, to).map_err(io("write the copy of"))?;
    Ok(Recovery::Recovered { messages: plan.summary.messages(), damages: plan.damages })
}

/// `false` if another process has locked it.
fn lock(file: &File) -> io::Result<bool> {
    match flock(file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Ok(true),
        Err(rustix::io::Errno::WOULDBLOCK) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// Planned repairs of a file.
#[derive(Debug, Default)]
struct Plan {
    damages: Damages,
    summary: Summary,
    chunks: Vec<ChunkLocation>,
    /// Bytes to write over good records: offset and content.
    patches: Vec<(u64, Vec<u8>)>,
    /// Unusable parts: offset and length.
    fences: Vec<(u64, u64)>,
    /// Offset of the mark that ends the data.
    data_end: u64,
    /// Messages of the last chunk: channel, and time and offset of each, as the message indexes should
    /// have them.
    expected: BTreeMap<u16, Vec<(u64, u64)>>,
    /// Whether the previous piece was a chunk or belongs to one.
    is_in_chunk: bool,
    /// There is no room for the header record at the beginning.
    lacks_header: bool,
    /// The last piece that was good, and is not fenced off.
    before: Option<Piece>,
}

impl Plan {
    fn make(mut scanner: Scanner, tell: Progress) -> io::Result<Self> {
        let mut plan = Self::default();
        for (opcode, body) in scanner.descriptions()? {
            plan.describe(opcode, &body);
        }
        let (has_summary, length) = (scanner.has_summary(), scanner.length());
        while let Some(piece) = scanner.next()? {
            tell(piece.at, length);
            let fences = plan.fences.len();
            match piece.kind {
                Kind::Chunk { header, is_framed } => {
                    plan.take_chunk(piece, header, is_framed, scanner.records());
                    let is_kept = plan.chunks.last().is_some_and(|c| c.at == piece.at);
                    if is_kept && !is_framed {
                        plan.mend_window(piece, header, &mut scanner)?;
                    }
                }
                Kind::Loose => plan.take_loose(piece, scanner.records()),
                Kind::MessageIndex => plan.take_index(piece, scanner.records()),
                Kind::Other => plan.take_other(piece, &mut scanner)?,
                Kind::Damaged(fault) => {
                    let is_last = has_summary && piece.at + piece.length == scanner.limit();
                    plan.take_damaged(piece, fault, is_last);
                }
                Kind::End { is_marked } => {
                    if plan.data_end == 0 {
                        plan.data_end = piece.at;
                    }
                    plan.damages.is_finished = is_marked || has_summary;
                    if is_marked && !has_summary {
                        plan.damages.add(Fault::Index, piece.at, length - piece.at);
                    }
                }
            }
            plan.before = Some(piece).filter(|_| plan.fences.len() == fences);
        }
        plan.summary.complete_schemas();
        plan.check_summary(&mut scanner)?;
        Ok(plan)
    }

    /// Compares the chunks found with those in the summary.
    fn check_summary(&mut self, scanner: &mut Scanner) -> io::Result<()> {
        // If there is other damage, the summary is rewritten anyway.
        if !scanner.has_summary() || self.damages.is_recoverable() {
            return Ok(());
        }
        let mut number = 0;
        let mut is_right = true;
        let chunks = &self.chunks;
        scanner.read_summary(&[op::CHUNK_INDEX], |_, body| {
            let there = chunks.get(number).map(|chunk| (chunk.at, &chunk.indexes));
            let told = chunk_index(body);
            is_right &= there == told.as_ref().map(|(at, indexes)| (*at, indexes));
            number += 1;
        })?;
        // Not every program writes an index.
        if !is_right || (number > 0 && number != chunks.len()) {
            self.damages.add(Fault::Index, scanner.limit(), scanner.length() - scanner.limit());
        }
        Ok(())
    }

    fn describe(&mut self, opcode: u8, body: &[u8]) {
        match opcode {
            op::SCHEMA => {
                if let Some(id) = schema(body) {
                    self.summary.schemas.entry(id).or_insert_with(|| body.to_vec());
                }
            }
            op::CHANNEL => {
                if let Some((id, _)) = channel(body) {
                    self.summary.channels.entry(id).or_insert_with(|| body.to_vec());
                }
            }
            _ => {}
        }
    }

    fn fence_off(&mut self, piece: Piece, fault: Fault) {
        self.is_in_chunk = false;
        self.damages.add(fault, piece.at, piece.length);
        self.fence(piece);
    }

    /// Makes a damaged part, together with a fenced-off part right before it, one record that readers
    /// skip. A part too short for a record head is joined to the record before it.
    fn fence(&mut self, piece: Piece) {
        let Piece { at, length, .. } = piece;
        let end = at + length;
        if let Some(last) = self.fences.last_mut().filter(|last| last.0 + last.1 == at) {
            last.1 += length;
            return;
        }
        if length >= HEAD_BYTES {
            self.fences.push((at, length));
            return;
        }
        match self.before {
            Some(before) if before.at == MAGIC.len() as u64 => {
                self.patches.push((before.at, header_record(end - before.at)));
            }
            Some(Piece { at, kind: Kind::MessageIndex, .. }) => {
                self.fences.push((at, end - at));
                if let Some(chunk) = self.chunks.last_mut() {
                    chunk.indexes.retain(|_, place| *place != at);
                }
            }
            Some(Piece { at, kind: Kind::Damaged(Fault::FencedOff), .. }) => {
                self.fences.push((at, end - at));
            }
            // A chunk may have extra bytes after its compressed data.
            Some(Piece { at, kind: Kind::Chunk { .. }, .. }) => {
                let head = Head { opcode: op::CHUNK, length: end - at - HEAD_BYTES };
                self.patches.push((at, head.encode().to_vec()));
                if let Some(chunk) = self.chunks.last_mut() {
                    (chunk.length, chunk.indexes_end) = (end - at, end);
                }
            }
            _ => self.fences.push((at, length)),
        }
    }

    fn take_chunk(&mut self, piece: Piece, header: ChunkHeader, is_framed: bool, records: &[u8]) {
        let mut messages = BTreeMap::<u16, Vec<(u64, u64)>>::new();
        let mut times_ns = None;
        let (mut unknown, mut knows_any) = (BTreeSet::new(), false);
        let mut cursor = Cursor(records);
        while !cursor.0.is_empty() {
            let place = (records.len() - cursor.0.len()) as u64;
            let Some((opcode, body)) = cursor.record() else {
                return self.fence_off(piece, Fault::Records);
            };
            self.describe(opcode, body);
            if opcode != op::MESSAGE {
                continue;
            }
            let Some((header, _)) = message(body) else {
                return self.fence_off(piece, Fault::Records);
            };
            match self.summary.channels.contains_key(&header.channel_id) {
                true => knows_any = true,
                false => _ = unknown.insert(header.channel_id),
            }
            messages.entry(header.channel_id).or_default().push((header.log_ns, place));
            times_ns = Some(widened(times_ns, header.log_ns));
        }
        if !unknown.is_empty() {
            if !knows_any {
                return self.fence_off(piece, Fault::UnknownChannel);
            }
            self.damages.add(Fault::UnknownChannel, piece.at, piece.length);
            // The other messages of the chunk can be read, so it stays. Viewers show these ones without
            // a meaning.
            unknown.into_iter().for_each(|id| self.summary.add_unknown_channel(id));
        }
        let (start_ns, end_ns) = times_ns.unwrap_or_default();
        let is_right = is_framed && (header.start_ns, header.end_ns) == (start_ns, end_ns);
        let header = ChunkHeader { start_ns, end_ns, ..header };
        if !is_right {
            self.damages.add(Fault::Framing, piece.at, piece.length);
            let head = Head { opcode: op::CHUNK, length: piece.length - HEAD_BYTES };
            let mut patch = Encoder(head.encode().to_vec());
            patch.u64(start_ns).u64(end_ns);
            self.patches.push((piece.at, patch.0));
            let sizes_at = piece.at + HEAD_BYTES + header.length - 8;
            self.patches.push((sizes_at, header.packed_bytes.to_le_bytes().to_vec()));
        }
        for (&channel_id, entries) in &messages {
            for &(log_ns, _) in entries {
                self.summary.count(channel_id, log_ns);
            }
        }
        for t_ns in times_ns.into_iter().flat_map(|(first_ns, last_ns)| [first_ns, last_ns]) {
            self.damages.note_time(t_ns);
        }
        self.expected = messages;
        self.is_in_chunk = true;
        let indexes_end = piece.at + piece.length;
        let (at, length, indexes) = (piece.at, piece.length, BTreeMap::new());
        self.chunks.push(ChunkLocation { at, length, header, indexes, indexes_end });
    }

    /// Reduces a window that is longer than the content.
    fn mend_window(
        &mut self,
        piece: Piece,
        header: ChunkHeader,
        scanner: &mut Scanner,
    ) -> io::Result<()> {
        let place = piece.at + HEAD_BYTES + header.length;
        let window = match header.packing {
            Some(Packing::Zstd) => zstd_window(scanner.bytes().at(place, ZSTD_PEEK_BYTES)?),
            _ => None,
        };
        let shortest = zstd_window_for(header.unpacked_bytes);
        if let Some((offset, _)) = window.filter(|&(_, bytes)| bytes > header.unpacked_bytes) {
            self.patches.push((place + offset as u64, vec![shortest]));
        }
        Ok(())
    }

    fn take_loose(&mut self, piece: Piece, record: &[u8]) {
        self.is_in_chunk = false;
        let Some((opcode, body)) = Cursor(record).record() else { return };
        self.describe(opcode, body);
        let header = message(body).filter(|_| opcode == op::MESSAGE).map(|(header, _)| header);
        match header {
            Some(header) if !self.summary.channels.contains_key(&header.channel_id) => {
                self.fence_off(piece, Fault::UnknownChannel);
            }
            Some(header) => {
                self.damages.note_time(header.log_ns);
                self.summary.count(header.channel_id, header.log_ns);
            }
            None => {}
        }
    }

    fn take_index(&mut self, piece: Piece, record: &[u8]) {
        let index = Cursor(record).record().and_then(|(_, body)| message_index(body));
        let (Some((channel_id, mut entries)), true) = (index, self.is_in_chunk) else { return };
        let mut expected = self.expected.get(&channel_id).cloned().unwrap_or_default();
        entries.sort_unstable();
        expected.sort_unstable();
        if entries != expected {
            // Later indexes are left out of the summary too, as they will be when the fence is read.
            self.fence_off(piece, Fault::Index);
        } else if let Some(chunk) = self.chunks.last_mut() {
            chunk.indexes.insert(channel_id, piece.at);
            chunk.indexes_end = piece.at + piece.length;
        }
    }

    fn take_other(&mut self, piece: Piece, scanner: &mut Scanner) -> io::Result<()> {
        self.is_in_chunk = false;
        match scanner.bytes().at(piece.at, 1)?.first() {
            Some(&op::ATTACHMENT) => self.summary.attachments += 1,
            Some(&op::METADATA) => self.summary.metadata += 1,
            _ => {}
        }
        Ok(())
    }

    fn take_damaged(&mut self, piece: Piece, fault: Fault, is_last: bool) {
        match fault {
            Fault::CutOff => {
                self.damages.add(fault, piece.at, piece.length);
                self.data_end = piece.at;
            }
            // The end mark itself; it is rewritten.
            Fault::Framing if is_last => {
                self.damages.add(fault, piece.at, piece.length);
                self.data_end = piece.at;
            }
            _ if piece.at == MAGIC.len() as u64 => {
                // Every file begins with a header; the rest of the damaged part is fenced off after it.
                self.damages.add(fault, piece.at, piece.length);
                if piece.length < MIN_HEADER_BYTES {
                    self.lacks_header = true;
                    self.fences.push((piece.at, piece.length));
                    return;
                }
                let is_long = piece.length > MAX_HEADER_BYTES;
                let length = if is_long { HEADER_BYTES } else { piece.length };
                self.patches.push((piece.at, header_record(length)));
                if piece.length > length {
                    let (at, length) = (piece.at + length, piece.length - length);
                    self.fence(Piece { at, length, ..piece });
                }
            }
            Fault::FencedOff => {
                self.is_in_chunk = false;
                self.damages.add(fault, piece.at, piece.length);
            }
            _ => self.fence_off(piece, fault),
        }
    }

    /// Repairs the file in place.
    fn carry_out(&self, file: &File) -> io::Result<()> {
        if self.lacks_header || self.fences.iter().any(|&(_, length)| length < HEAD_BYTES) {
            let problem = "a damaged part is too short to be mended in place; use --output";
            return Err(io::Error::other(problem));
        }
        for (at, bytes) in &self.patches {
            file.write_all_at(bytes, *at)?;
        }
        for &(at, length) in &self.fences {
            let head = Head { opcode: op::FENCED_OFF, length: length.saturating_sub(HEAD_BYTES) };
            file.write_all_at(&head.encode(), at)?;
        }
        // The good data must reach the disk before the summary that declares it complete.
        file.sync_data()?;
        file.set_len(self.data_end)?;
        let end = self.end(self.data_end)?;
        if let Err(error) = file.write_all_at(&end, self.data_end) {
            // Half a summary is useless, and may be what filled the disk.
            let _ = file.set_len(self.data_end);
            let problem = format!(
                "{error}; no message is lost, but the index takes {} kB more on the disk",
                end.len().div_ceil(1000)
            );
            return Err(io::Error::new(error.kind(), problem));
        }
        file.sync_all()
    }

    /// Writes the good pieces to another file.
    fn copy(&mut self, mut from: &File, mut to: &File) -> io::Result<()> {
        let mut place = 0;
        let header = if self.lacks_header { header_record(HEADER_BYTES) } else { Vec::new() };
        if self.lacks_header {
            to.write_all(MAGIC)?;
            to.write_all(&header)?;
            place = MAGIC.len() as u64;
        }
        let moved = |place: u64| moved(&self.fences, place) + header.len() as u64;
        for &(at, length) in self.fences.iter().chain([&(self.data_end, 0)]) {
            from.seek(SeekFrom::Start(place))?;
            io::copy(&mut from.take(at.saturating_sub(place)), &mut to)?;
            place = at + length;
        }
        for (at, bytes) in &self.patches {
            to.write_all_at(bytes, moved(*at))?;
        }
        for chunk in &mut self.chunks {
            chunk.at = moved(chunk.at);
            chunk.indexes_end = moved(chunk.indexes_end);
            for place in chunk.indexes.values_mut() {
                *place = moved(*place);
            }
        }
        let data_end = moved(self.data_end);
        to.write_all_at(&self.end(data_end)?, data_end)?;
        to.sync_all()
    }

    /// Everything after the data, which ends at this offset.
    fn end(&self, data_end: u64) -> io::Result<Vec<u8>> {
        let records: Vec<u8> = self.chunks.iter().flat_map(ChunkLocation::record).collect();
        let index = ChunkIndex { records: &records[..], count: self.chunks.len() as u32 };
        let mut end = Vec::new();
        self.summary.write(data_end, index, &mut end)?;
        Ok(end)
    }
}

/// Offset of a position after the parts before it have been left out.
fn moved(left_out: &[(u64, u64)], place: u64) -> u64 {
    let before = left_out.iter().take_while(|(at, _)| *at < place);
    place - before.map(|(_, length)| length).sum::<u64>()
}

/// The header record of a file, of a given length.
fn header_record(length: u64) -> Vec<u8> {
    let name = concat!("touchline ", env!("CARGO_PKG_VERSION"), ", recovered");
    // Record head, and the lengths of both texts.
    let room = (length as usize).saturating_sub(HEAD_BYTES as usize + 8);
    let text: String = name.chars().chain(std::iter::repeat(' ')).take(room).collect();
    let header = records::Header { profile: String::new(), library: text };
    let mut record = Encoder::default();
    record.record(op::HEADER, &body(&header));
    record.0
}
