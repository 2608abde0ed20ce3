//! The end of a recording: the mark after the data, and the summary, which gives viewers chunks,
//! channels and counts. [`mcap`] writes the summary of a file it has written itself; this module writes
//! it for existing files.

use crate::wire::{ChunkHeader, Encoder, FOOTER_BYTES, Head, MAGIC, op};
use std::collections::BTreeMap;

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

/// Content of a summary.
#[derive(Debug, Clone, Default)]
pub(crate) struct Summary {
    /// Bodies of the schema records.
    pub schemas: BTreeMap<u16, Vec<u8>>,
    /// Bodies of the channel records.
    pub channels: BTreeMap<u16, Vec<u8>>,
    pub chunks: Vec<ChunkLocation>,
    /// Number of messages per channel.
    pub counts: BTreeMap<u16, u64>,
    /// Times of the earliest and the latest message.
    pub times_ns: Option<(u64, u64)>,
    pub attachments: u32,
    pub metadata: u32,
}

impl Summary {
    /// Counts a message.
    pub fn count(&mut self, channel_id: u16, log_ns: u64) {
        *self.counts.entry(channel_id).or_default() += 1;
        self.times_ns = Some(widened(self.times_ns, log_ns));
    }

    /// Number of messages in all channels.
    pub fn messages(&self) -> u64 {
        self.counts.values().sum()
    }

    /// Everything after the data, which ends at this offset.
    pub fn encode(&self, data_end: u64) -> Vec<u8> {
        let mut end = Encoder::default();
        end.record(op::DATA_END, &0u32.to_le_bytes());
        let start = end.0.len();
        let mut groups = Vec::new();
        let mut group = |end: &mut Encoder, opcode: u8, bodies: Vec<Vec<u8>>| {
            let from = end.0.len();
            for body in &bodies {
                end.record(opcode, body);
            }
            if !bodies.is_empty() {
                groups.push((opcode, data_end + from as u64, (end.0.len() - from) as u64));
            }
        };
        group(&mut end, op::SCHEMA, self.schemas.values().cloned().collect());
        group(&mut end, op::CHANNEL, self.channels.values().cloned().collect());
        group(&mut end, op::STATISTICS, vec![self.statistics()]);
        group(&mut end, op::CHUNK_INDEX, self.chunks.iter().map(chunk_index).collect());
        let offsets_at = end.0.len();
        for (opcode, from, length) in groups {
            let mut body = Encoder(vec![opcode]);
            body.u64(from).u64(length);
            end.record(op::SUMMARY_OFFSET, &body.0);
        }
        end.0.extend(Head { opcode: op::FOOTER, length: FOOTER_BYTES }.encode());
        end.u64(data_end + start as u64).u64(data_end + offsets_at as u64);
        let crc = crc32fast::hash(&end.0[start..]);
        end.u32(crc);
        end.0.extend(MAGIC);
        end.0
    }

    fn statistics(&self) -> Vec<u8> {
        let (first_ns, last_ns) = self.times_ns.unwrap_or_default();
        let mut body = Encoder::default();
        body.u64(self.messages())
            .u16(self.schemas.len() as u16)
            .u32(self.channels.len() as u32)
            .u32(self.attachments)
            .u32(self.metadata)
            .u32(self.chunks.len() as u32)
            .u64(first_ns)
            .u64(last_ns)
            .map(self.counts.iter().map(|(&id, &count)| (id, count)));
        body.0
    }
}

/// The time span extended to include this time.
pub(crate) fn widened(times_ns: Option<(u64, u64)>, t_ns: u64) -> (u64, u64) {
    let (first_ns, last_ns) = times_ns.unwrap_or((t_ns, t_ns));
    (first_ns.min(t_ns), last_ns.max(t_ns))
}

fn chunk_index(chunk: &ChunkLocation) -> Vec<u8> {
    let ChunkLocation { at, length, header, indexes, indexes_end } = chunk;
    let mut body = Encoder::default();
    body.u64(header.start_ns)
        .u64(header.end_ns)
        .u64(*at)
        .u64(*length)
        .map(indexes.iter().map(|(&id, &place)| (id, place)))
        .u64(indexes_end.saturating_sub(at + length))
        .prefixed(header.packing.map_or("", |packing| packing.name()).as_bytes())
        .u64(header.packed_bytes)
        .u64(header.unpacked_bytes);
    body.0
}
