//! The end of a recording: the mark after the data, and the summary, which gives viewers chunks,
//! channels and counts.

use crate::wire::{
    ChunkHeader, Encoder, FOOTER_BYTES, Head, MAGIC, Packing, body, channel_schema, op,
};
use crc32fast::Hasher;
use mcap::records;
use std::collections::BTreeMap;
use std::io::{self, BufWriter, Read, Write};

/// Offsets of a chunk and of the indexes of its messages.
#[derive(Debug, Clone)]
pub(crate) struct ChunkLocation {
    pub at: u64,
    pub length: u64,
    pub header: ChunkHeader,
    /// Offset of the message index of each channel.
    pub indexes: BTreeMap<u16, u64>,
    /// End of the last index.
    pub indexes_end: u64,
}

/// Content of a summary besides the index of chunks, which may be too long to be kept in memory.
#[derive(Debug, Clone, Default)]
pub(crate) struct Summary {
    /// Bodies of the schema records.
    pub schemas: BTreeMap<u16, Vec<u8>>,
    /// Bodies of the channel records.
    pub channels: BTreeMap<u16, Vec<u8>>,
    /// Number of messages per channel.
    pub counts: BTreeMap<u16, u64>,
    /// Times of the earliest and the latest message.
    pub times_ns: Option<(u64, u64)>,
    pub attachments: u32,
    pub metadata: u32,
}

/// The index of chunks: its records, as read from anywhere, and their number.
pub(crate) struct ChunkIndex<R> {
    pub records: R,
    pub count: u32,
}

impl Summary {
    /// Counts a message.
    pub fn count(&mut self, channel_id: u16, log_ns: u64) {
        *self.counts.entry(channel_id).or_default() += 1;
        self.times_ns = Some(widened(self.times_ns, log_ns));
    }

    /// Stands in for a channel of which nothing but its messages is left. Viewers show these without a
    /// meaning.
    pub fn add_unknown_channel(&mut self, id: u16) {
        let channel = records::Channel {
            id,
            schema_id: 0,
            topic: format!("unknown-{id}"),
            message_encoding: String::new(),
            metadata: BTreeMap::new(),
        };
        self.channels.insert(id, body(&channel));
    }

    /// Stands in for schemas that only a channel names: other programs refuse a file without them.
    pub fn complete_schemas(&mut self) {
        for id in self.channels.values().filter_map(|body| channel_schema(body)) {
            self.schemas.entry(id).or_insert_with(|| {
                let name = format!("unknown-{id}");
                schema_body(records::SchemaHeader { id, name, encoding: String::new() }, b"")
            });
        }
    }

    /// Number of messages in all channels.
    pub fn messages(&self) -> u64 {
        self.counts.values().sum()
    }

    /// Writes everything after the data, which ends at this offset.
    pub fn write(
        &self,
        data_end: u64,
        mut index: ChunkIndex<impl Read>,
        to: impl Write,
    ) -> io::Result<()> {
        let mut end = Ending { to: BufWriter::new(to), place: data_end, crc: Hasher::new() };
        // Without a checksum of the data: each chunk has its own.
        end.records([(op::DATA_END, &body(&records::DataEnd::default())[..])])?;
        // The checksum begins here.
        end.crc = Hasher::new();
        let start = end.place;
        let schemas = self.schemas.values().map(|body| (op::SCHEMA, &body[..]));
        let schemas = end.records(schemas)?;
        let channels = self.channels.values().map(|body| (op::CHANNEL, &body[..]));
        let channels = end.records(channels)?;
        let statistics = end.records([(op::STATISTICS, &self.statistics(index.count)[..])])?;
        let chunks_at = end.place;
        io::copy(&mut index.records, &mut end)?;
        let chunks =
            Group { opcode: op::CHUNK_INDEX, at: chunks_at, length: end.place - chunks_at };
        let offsets_at = end.place;
        for group in [schemas, channels, statistics, chunks].iter().filter(|it| it.length > 0) {
            let offset = records::SummaryOffset {
                group_opcode: group.opcode,
                group_start: group.at,
                group_length: group.length,
            };
            end.records([(op::SUMMARY_OFFSET, &body(&offset)[..])])?;
        }
        let footer = |crc| records::Footer {
            summary_start: start,
            summary_offset_start: offsets_at,
            summary_crc: crc,
        };
        end.write_all(&Head { opcode: op::FOOTER, length: FOOTER_BYTES }.encode())?;
        // The checksum is the last field, and covers everything before it.
        let before_crc = &body(&footer(0))[..FOOTER_BYTES as usize - 4];
        end.write_all(before_crc)?;
        let crc = end.crc.clone().finalize();
        end.write_all(&body(&footer(crc))[before_crc.len()..])?;
        end.write_all(MAGIC)?;
        end.flush()
    }

    fn statistics(&self, chunks: u32) -> Vec<u8> {
        let (first_ns, last_ns) = self.times_ns.unwrap_or_default();
        body(&records::Statistics {
            message_count: self.messages(),
            schema_count: self.schemas.len() as u16,
            channel_count: self.channels.len() as u32,
            attachment_count: self.attachments,
            metadata_count: self.metadata,
            chunk_count: chunks,
            message_start_time: first_ns,
            message_end_time: last_ns,
            channel_message_counts: self.counts.clone(),
        })
    }
}

/// Consecutive records of one kind in a summary.
struct Group {
    opcode: u8,
    at: u64,
    length: u64,
}

/// Writes the end of a file, with a checksum and the offset reached.
struct Ending<W: Write> {
    to: BufWriter<W>,
    place: u64,
    crc: Hasher,
}

impl<W: Write> Ending<W> {
    /// Writes records of one kind.
    fn records<'a>(
        &mut self,
        records: impl IntoIterator<Item = (u8, &'a [u8])>,
    ) -> io::Result<Group> {
        let (at, mut kind) = (self.place, 0);
        for (opcode, body) in records {
            kind = opcode;
            self.write_all(&Head { opcode, length: body.len() as u64 }.encode())?;
            self.write_all(body)?;
        }
        Ok(Group { opcode: kind, at, length: self.place - at })
    }
}

impl<W: Write> Write for Ending<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.to.write(bytes)?;
        self.crc.update(&bytes[..count]);
        self.place += count as u64;
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.to.flush()
    }
}

/// The time span extended to include this time.
pub(crate) fn widened(times_ns: Option<(u64, u64)>, t_ns: u64) -> (u64, u64) {
    let (first_ns, last_ns) = times_ns.unwrap_or((t_ns, t_ns));
    (first_ns.min(t_ns), last_ns.max(t_ns))
}

impl ChunkLocation {
    /// The record of this chunk in the index.
    pub fn record(&self) -> Vec<u8> {
        let Self { at, length, header, indexes, indexes_end } = self;
        let index = records::ChunkIndex {
            message_start_time: header.start_ns,
            message_end_time: header.end_ns,
            chunk_start_offset: *at,
            chunk_length: *length,
            message_index_offsets: indexes.clone(),
            message_index_length: indexes_end.saturating_sub(at + length),
            compression: header.packing.map_or("", Packing::name).into(),
            compressed_size: header.packed_bytes,
            uncompressed_size: header.unpacked_bytes,
        };
        let mut record = Encoder::default();
        record.record(op::CHUNK_INDEX, &body(&index));
        record.0
    }
}

/// The body of a schema's record: its header and its text.
pub(crate) fn schema_body(header: records::SchemaHeader, text: &[u8]) -> Vec<u8> {
    let mut schema = Encoder(body(&header));
    schema.prefixed(text);
    schema.0
}
