//! Tests of long recordings: the writer's memory does not depend on the length of the recording.

mod memory;

use memory::most_bytes_in;
use std::path::{Path, PathBuf};
use touchline_recording::{Channel, Writer};

/// Chunks of a quarter of an hour: the recorder writes 25 in a second.
const CHUNKS: u64 = 22_500;
/// 0.5 MB in an hour.
const MOST_GROWTH: u64 = (1 << 19) / 4;

struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("touchline-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Records this many chunks with a message of each channel; returns the most memory taken.
fn record(path: &Path, chunks: u64) -> u64 {
    most_bytes_in(|| {
        let channels = [Channel::World, Channel::Commands, Channel::Health];
        let mut writer = Writer::create(path, &channels).unwrap();
        for chunk in 0..chunks {
            for channel in channels {
                writer.write(channel, chunk * 40_000_000, chunk * 40_000_000, &[7; 300]).unwrap();
            }
            writer.flush().unwrap();
        }
        writer.finish().unwrap();
    })
}

#[test]
fn a_long_recording_takes_no_more_memory_than_a_short_one() {
    let scratch = Scratch::new("long");
    let short = record(&scratch.0.join("short.mcap"), 100);
    let path = scratch.0.join("long.mcap");
    let long = record(&path, CHUNKS);
    assert!(long < short + MOST_GROWTH, "{short} bytes for a short one, {long} for a long one");

    let bytes = std::fs::read(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().expect("a summary");
    // The first chunk describes the channels.
    assert_eq!(summary.chunk_indexes.len() as u64, CHUNKS + 1);
    assert_eq!(summary.stats.as_ref().unwrap().message_count, 3 * CHUNKS);
    let last = summary.chunk_indexes.last().unwrap();
    let messages: Vec<_> =
        summary.stream_chunk(&bytes, last).unwrap().map(Result::unwrap).collect();
    assert_eq!(messages.len(), 3);
    let newest_ns = (CHUNKS - 1) * 40_000_000;
    assert!(messages.iter().all(|it| it.log_time == newest_ns && *it.data == [7; 300]));
    assert_eq!(summary.read_message_indexes(&bytes, last).unwrap().len(), 3);
    // Nothing but the recordings: the file with the index had no name.
    assert_eq!(std::fs::read_dir(&scratch.0).unwrap().count(), 2);
}
