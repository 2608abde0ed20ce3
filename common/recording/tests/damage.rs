//! Tests of damaged recordings: whatever happens to the bytes, reading takes little memory and yields
//! nothing that was not recorded, and a recovery makes a proper recording.
//!
//! `TOUCHLINE_MUTATIONS=1000000 cargo test --release -p touchline-recording --test damage` tests a
//! million damaged files instead of some hundreds; `TOUCHLINE_SEED` selects others, and `TOUCHLINE_FIRST`
//! begins with a later one.

mod memory;

use memory::most_bytes_in;
use std::collections::HashSet;
use std::fs::File;
use std::path::{Path, PathBuf};
use touchline_recording::recover::{Recovery, recover, recover_to};
use touchline_recording::{Channel, Damages, Fault, Reader, Setup, Writer};

/// Bytes before the first record.
const MAGIC_BYTES: usize = 8;
/// Damaged files tested by default.
const MUTATIONS: u64 = 600;
/// Memory that reading and recovering may take, besides three times the size of the file.
const MEMORY: u64 = 64 << 20;

type Message = (Channel, u64, Vec<u8>);

/// A folder that is removed at the end of the test.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let name = format!("touchline-damage-{name}-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Pseudo-random numbers (SplitMix64), the same in every run.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut value = self.0;
        value = (value ^ (value >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        value = (value ^ (value >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        value ^ (value >> 31)
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.next() % limit.max(1) as u64) as usize
    }
}

const BEGIN_NS: u64 = 1_700_000_000_000_000_000;
/// Chunks of the sample, and messages in each.
const CHUNKS: u64 = 24;
const IN_CHUNK: u64 = 6;

/// A recording of about a second. One chunk is mostly noise, like camera frames.
fn sample(scratch: &Scratch, is_finished: bool) -> Vec<u8> {
    let path = scratch.0.join("sample.mcap");
    let _ = std::fs::remove_file(&path);
    let channels = [Channel::Setup, Channel::Frames, Channel::World, Channel::Commands];
    let mut writer = Writer::create(&path, &channels).unwrap();
    let setup = Setup {
        touchline_version: "1".into(),
        instance: "test".into(),
        wall_minus_monotonic_ns: 0,
        config_toml: "# a comment\n".repeat(20),
        revision: 1,
        accepted_wall_ns: 0,
    };
    writer.write(Channel::Setup, BEGIN_NS, BEGIN_NS, &setup.encode()).unwrap();
    let mut random = Random(7);
    for chunk in 0..CHUNKS {
        for number in 0..IN_CHUNK {
            let t_ns = BEGIN_NS + (chunk * IN_CHUNK + number) * 7_000_000;
            let channel = channels[1 + (number % 3) as usize];
            let length = 20 + random.below(400);
            let data: Vec<u8> = (0..length)
                .map(|_| (random.next() % if number % 3 == 0 { 256 } else { 3 }) as u8)
                .collect();
            writer.write(channel, t_ns, t_ns, &data).unwrap();
        }
        writer.flush().unwrap();
    }
    let bytes = if is_finished {
        writer.finish().unwrap();
        std::fs::read(&path).unwrap()
    } else {
        // The file as left by a killed process.
        std::fs::read(&path).unwrap()
    };
    std::fs::remove_file(&path).unwrap();
    bytes
}

fn read(path: &Path) -> (Vec<Message>, Damages) {
    let mut reader = Reader::open(path).unwrap();
    let messages = reader
        .by_ref()
        .map(Result::unwrap)
        .map(|entry| (entry.channel, entry.t_sent_ns, entry.data.into_owned()))
        .collect();
    (messages, reader.damages().clone())
}

fn recovered(path: &Path) -> Recovery {
    recover(path, &mut |_, _| ()).unwrap()
}

/// Asserts that another program would accept the file as a proper recording, with this many messages
/// of known channels.
fn assert_proper(path: &Path, messages: usize) {
    let bytes = std::fs::read(path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap_or_else(|error| panic!("{error}: {path:?}"));
    let summary = summary.expect("a summary");
    let (mut in_chunks, mut of_known) = (0, 0);
    for chunk in &summary.chunk_indexes {
        for message in summary.stream_chunk(&bytes, chunk).unwrap() {
            let is_known = !message.unwrap().channel.topic.starts_with("unknown-");
            in_chunks += 1;
            of_known += usize::from(is_known);
        }
        if chunk.message_index_offsets.is_empty() {
            continue;
        }
        for (channel, entries) in summary
            .read_message_indexes(&bytes, chunk)
            .unwrap_or_else(|error| panic!("{error}: {chunk:?}"))
        {
            assert!(summary.channels.contains_key(&channel.id) && !entries.is_empty());
        }
    }
    assert_eq!(of_known, messages);
    assert_eq!(summary.stats.as_ref().unwrap().message_count, in_chunks);
}

#[test]
fn a_whole_recording_is_read_whole() {
    let scratch = Scratch::new("whole");
    let path = scratch.file("whole.mcap", &sample(&scratch, true));
    let (messages, damages) = read(&path);
    assert_eq!(messages.len() as u64, CHUNKS * IN_CHUNK + 1);
    assert!(damages.is_empty() && !damages.is_recoverable(), "{damages:?}");
    assert_eq!(recovered(&path), Recovery::NotNeeded);
    assert_proper(&path, messages.len());
}

#[test]
fn an_unfinished_recording_is_completed_in_place() {
    let scratch = Scratch::new("unfinished");
    let mut bytes = sample(&scratch, false);
    let path = scratch.file("cut.mcap", &bytes);
    let (before, damages) = read(&path);
    assert_eq!((damages.count, damages.is_finished), (0, false));
    assert!(matches!(recovered(&path), Recovery::Recovered { .. }));
    // Existing bytes stay in place.
    assert!(std::fs::read(&path).unwrap().starts_with(&bytes));
    let (after, damages) = read(&path);
    assert!(after == before && damages.is_empty(), "{damages:?}");
    assert_proper(&path, before.len());

    bytes.truncate(bytes.len() - 700);
    let path = scratch.file("cut.mcap", &bytes);
    let (cut, damages) = read(&path);
    assert_eq!(damages.parts[0].fault, Fault::CutOff, "{damages:?}");
    assert!(cut.len() < before.len() && before.starts_with(&cut));
    assert!(matches!(recovered(&path), Recovery::Recovered { .. }));
    assert_eq!(recovered(&path), Recovery::NotNeeded);
    assert_proper(&path, cut.len());
}

#[test]
fn any_damaged_byte_costs_one_chunk_at_most() {
    let scratch = Scratch::new("byte");
    let bytes = sample(&scratch, true);
    let whole: HashSet<Message> = read(&scratch.file("whole.mcap", &bytes)).0.into_iter().collect();
    for at in (8..bytes.len() - 8).step_by(if cfg!(debug_assertions) { 211 } else { 3 }) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1 << (at % 8);
        let path = scratch.file("damaged.mcap", &damaged);
        let (messages, damages) = read(&path);
        assert!(whole.len() - messages.len() <= IN_CHUNK as usize + 1, "byte {at}: {damages:?}");
        assert!(messages.iter().all(|message| whole.contains(message)), "byte {at}");
        let is_told = damages.parts.iter().any(|part| part.fault.has_lost_messages());
        assert!(messages.len() == whole.len() || is_told, "byte {at}: {damages:?}");
        recovered(&path);
        assert_eq!(read(&path).0, messages, "byte {at}: {damages:?}");
        assert_eq!(recovered(&path), Recovery::NotNeeded, "byte {at}: {damages:?}");
        assert_proper(&path, messages.len());
    }
}

#[test]
fn damage_is_told_with_its_place_and_time() {
    let scratch = Scratch::new("told");
    let bytes = sample(&scratch, true);
    let mut damaged = bytes.clone();
    // In a chunk about in the middle of the file.
    let chunks: Vec<usize> = (0..bytes.len() - 4).filter(|&at| bytes[at..at + 4] == ZSTD).collect();
    // The first chunk has the channels, the second one the first messages.
    let number = 11;
    damaged[chunks[number] + 40] ^= 1;
    let path = scratch.file("damaged.mcap", &damaged);
    let (_, damages) = read(&path);
    assert_eq!((damages.count, damages.parts[0].fault), (1, Fault::Checksum), "{damages:?}");
    let begin_s = ((number as u64 - 1) * IN_CHUNK - 1) as f64 * 0.007;
    let lost_s = (IN_CHUNK + 1) as f64 * 0.007;
    let text = damages.parts[0].to_string();
    let times = format!("{lost_s:.2} s of the recording, from {begin_s:.2} s to");
    assert!(text.contains(&times), "{text}");
    assert!((damages.seconds() - lost_s).abs() < 1e-6, "{damages:?}");

    let Recovery::Recovered { damages: told, .. } = recovered(&path) else { panic!() };
    assert_eq!(told, damages);
    // The recovered file still records the damage.
    let (_, damages) = read(&path);
    assert_eq!(damages.parts[0].fault, Fault::FencedOff);
    assert!(!damages.is_recoverable() && !damages.is_empty());
    // The bytes are still there, except for the beginning of the part and the index.
    let mended = std::fs::read(&path).unwrap();
    assert_eq!(
        mended[chunks[number]..chunks[number + 1]],
        damaged[chunks[number]..chunks[number + 1]]
    );
}

#[test]
fn a_copy_leaves_out_what_is_damaged() {
    let scratch = Scratch::new("copy");
    let mut damaged = sample(&scratch, true);
    for at in (3000..damaged.len() - 3000).step_by(4001) {
        damaged[at] ^= 0x10;
    }
    let path = scratch.file("damaged.mcap", &damaged);
    let (messages, damages) = read(&path);
    assert!(damages.count > 1, "{damages:?}");
    let to = scratch.0.join("copy.mcap");
    let file = File::options().read(true).write(true).create_new(true).open(&to).unwrap();
    recover_to(&path, &file, &mut |_, _| ()).unwrap();
    drop(file);
    assert_eq!(std::fs::read(&path).unwrap(), damaged, "the file itself was changed");
    let (copied, damages) = read(&to);
    assert_eq!(copied, messages);
    assert!(damages.is_empty(), "{damages:?}");
    assert_proper(&to, messages.len());
}

#[test]
fn a_length_around_the_largest_number_goes_nowhere() {
    let scratch = Scratch::new("wrap");
    let bytes = sample(&scratch, true);
    let whole = read(&scratch.file("whole.mcap", &bytes)).0;
    let chunk = (8000..bytes.len()).find(|&at| bytes[at..].starts_with(&ZSTD)).unwrap() - 53;
    assert_eq!(bytes[chunk], 6);
    // Some of these lead back to an earlier record if they are added to the offset unchecked.
    for below in (0..chunk as u64).chain([u64::MAX / 2, u64::MAX - 5]) {
        let mut damaged = bytes.clone();
        damaged[chunk + 1..chunk + 9].copy_from_slice(&(u64::MAX - below).to_le_bytes());
        let path = scratch.file("damaged.mcap", &damaged);
        let mut reader = Reader::open(&path).unwrap();
        assert_eq!(reader.by_ref().take(2 * whole.len()).count(), whole.len(), "2⁶⁴ - 1 - {below}");
        assert_eq!(reader.damages().parts[0].fault, Fault::Framing);
    }
}

/// Typical corrupt lengths.
const LENGTHS: [u64; 10] = [
    0,
    1,
    8,
    0xFFFF,
    3_000_000_000,
    u32::MAX as u64,
    512 << 30,
    1 << 62,
    i64::MAX as u64,
    u64::MAX,
];

/// Typical corruption of files by disks, memory and people.
fn mutate(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..1 + random.below(3) {
        let at = random.below(bytes.len());
        let length = (1 + random.below(600)).min(bytes.len() - at);
        match random.below(10) {
            9 => damage_frame(bytes, at, random),
            0 | 1 => bytes[at] ^= 1 << random.below(8),
            2 => bytes[at] = random.next() as u8,
            3 => {
                let value = LENGTHS[random.below(LENGTHS.len())].to_le_bytes();
                let width = if random.below(2) == 0 { 4 } else { 8 };
                let end = (at + width).min(bytes.len());
                bytes[at..end].copy_from_slice(&value[..end - at]);
            }
            4 => bytes[at..at + length].fill(0),
            5 => bytes[at..at + length].iter_mut().for_each(|byte| *byte = random.next() as u8),
            6 => drop(bytes.drain(at..at + length)),
            7 => {
                let part = bytes[at..at + length].to_vec();
                let to = random.below(bytes.len());
                bytes.splice(to..to, part);
            }
            _ => bytes.truncate(at),
        }
        if bytes.len() < 16 {
            break;
        }
    }
}

/// First bytes of a zstd frame; its descriptor and, in most frames, its window follow.
const ZSTD: [u8; 4] = [0x28, 0xB5, 0x2F, 0xFD];

/// Makes the next zstd frame after an offset ask for another window.
fn damage_frame(bytes: &mut [u8], from: usize, random: &mut Random) {
    let frame = (from..bytes.len().saturating_sub(6)).find(|&at| bytes[at..].starts_with(&ZSTD));
    let Some(frame) = frame else { return };
    match random.below(3) {
        0 => bytes[frame + 4] = random.next() as u8,
        1 => bytes[frame + 5] = random.next() as u8,
        _ => {
            // Neither the length of a frame that is one segment nor a window stops a reader.
            bytes[frame + 4] &= !0x20;
            bytes[frame + 5] = 0xFF - random.below(64) as u8;
        }
    }
}

/// A file with right checksums and arbitrary content, as only an attacker would write it: record
/// lengths in a chunk are wrong, and it grows when decompressed.
fn hostile(random: &mut Random) -> Vec<u8> {
    let mut records = Vec::new();
    let mut record = |opcode: u8, length: u64, body: &[u8]| {
        records.push(opcode);
        records.extend(length.to_le_bytes());
        records.extend(body);
    };
    let mut channel = vec![1, 0, 0, 0];
    for text in ["frames", "protobuf"] {
        channel.extend((text.len() as u32).to_le_bytes());
        channel.extend(text.as_bytes());
    }
    channel.extend([0; 4]);
    record(4, channel.len() as u64, &channel);
    for _ in 0..random.below(20) {
        let most = if random.below(8) == 0 { 6 << 20 } else { 2000 };
        let mut body = vec![0; 22 + random.below(most)];
        body[0] = 1;
        body[6] = random.next() as u8;
        let claimed = match random.below(6) {
            0 => LENGTHS[random.below(LENGTHS.len())],
            _ => body.len() as u64,
        };
        record(5, claimed, &body);
    }
    let packed = zstd::bulk::compress(&records, 1).unwrap();
    let claimed = match random.below(4) {
        0 => LENGTHS[random.below(LENGTHS.len())],
        _ => records.len() as u64,
    };
    let mut file = b"\x89MCAP0\r\n".to_vec();
    file.extend([1, 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    for _ in 0..1 + random.below(4) {
        file.push(6);
        file.extend((44 + packed.len() as u64).to_le_bytes());
        file.extend([0; 16]);
        file.extend(claimed.to_le_bytes());
        let crc = if random.below(3) == 0 { 0 } else { crc32fast::hash(&records) };
        file.extend(crc.to_le_bytes());
        file.extend(4u32.to_le_bytes());
        file.extend(b"zstd");
        file.extend((packed.len() as u64).to_le_bytes());
        file.extend(&packed);
    }
    file
}

/// A file with a chunk for each list of records, as a program writes it that compresses in a stream.
fn file_of(chunks: &[Vec<(u8, Vec<u8>)>]) -> Vec<u8> {
    let mut file = b"\x89MCAP0\r\n".to_vec();
    file.extend([1, 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    for chunk in chunks {
        let mut records = Vec::new();
        for (opcode, body) in chunk {
            records.push(*opcode);
            records.extend((body.len() as u64).to_le_bytes());
            records.extend(body);
        }
        let packed = zstd::stream::encode_all(&records[..], 1).unwrap();
        file.push(6);
        file.extend((44 + packed.len() as u64).to_le_bytes());
        file.extend([0; 16]);
        file.extend((records.len() as u64).to_le_bytes());
        file.extend(crc32fast::hash(&records).to_le_bytes());
        file.extend(4u32.to_le_bytes());
        file.extend(b"zstd");
        file.extend((packed.len() as u64).to_le_bytes());
        file.extend(&packed);
    }
    file
}

/// The description of channel 1, the commands.
fn channel_record() -> (u8, Vec<u8>) {
    let mut channel = vec![1, 0, 0, 0];
    for text in ["commands", "protobuf"] {
        channel.extend((text.len() as u32).to_le_bytes());
        channel.extend(text.as_bytes());
    }
    channel.extend([0; 4]);
    (4, channel)
}

fn message_record(channel: u8, data: impl Iterator<Item = u8>) -> (u8, Vec<u8>) {
    let mut message = vec![0; 22];
    message[0] = channel;
    message.extend(data);
    (5, message)
}

/// Most resident memory of this process so far, in bytes.
fn most_resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    line.trim().trim_end_matches(" kB").parse::<u64>().unwrap() << 10
}

#[test]
fn messages_beside_those_of_an_unknown_channel_are_recovered() {
    let scratch = Scratch::new("unknown");
    let message = |channel| message_record(channel, std::iter::repeat_n(7, 50));
    let first = vec![channel_record(), message(1), message(2)];
    let bytes = file_of(&[first, vec![message(2), message(1), message(1)], vec![message(9)]]);
    let path = scratch.file("unknown.mcap", &bytes);
    let (before, damages) = read(&path);
    assert_eq!(before.len(), 3, "{damages:?}");
    assert!(damages.parts.iter().all(|part| part.fault == Fault::UnknownChannel), "{damages:?}");
    assert!(matches!(recovered(&path), Recovery::Recovered { .. }));
    assert_eq!(read(&path).0, before);
    assert_eq!(recovered(&path), Recovery::NotNeeded);
    assert_proper(&path, 3);
}

#[test]
fn a_channel_whose_schema_is_lost_is_recovered() {
    let scratch = Scratch::new("schema");
    let (opcode, mut channel) = channel_record();
    channel[2] = 4;
    let message = message_record(1, std::iter::repeat_n(7, 50));
    let path = scratch.file("schema.mcap", &file_of(&[vec![(opcode, channel), message]]));
    let (before, _) = read(&path);
    assert!(matches!(recovered(&path), Recovery::Recovered { .. }));
    assert_eq!((before.len(), read(&path).0), (1, before));
    assert_eq!(recovered(&path), Recovery::NotNeeded);
    assert_proper(&path, 1);
}

#[test]
fn a_frame_that_asks_for_a_huge_window_gets_none() {
    let scratch = Scratch::new("window");
    let mut random = Random(3);
    let chunks = [3 << 20, 20 << 20].map(|length| {
        let data = (0..length).map(|_| (random.next() % 3) as u8);
        vec![channel_record(), message_record(1, data)]
    });
    let bytes = file_of(&chunks);
    let frames: Vec<usize> =
        (0..bytes.len() - 6).filter(|&at| bytes[at..].starts_with(&ZSTD)).collect();
    let whole = read(&scratch.file("whole.mcap", &bytes)).0.len();
    assert_eq!((whole, frames.len()), (2, 2));
    // The largest window of the format is 3.75 TB.
    for window in (0x00..=0xFF).step_by(15) {
        for &frame in &frames {
            let mut damaged = bytes.clone();
            // A window, and no length of the content.
            damaged[frame + 4] &= !0xE0;
            damaged[frame + 5] = window;
            let path = scratch.file("damaged.mcap", &damaged);
            let mut reader = Reader::open(&path).unwrap();
            let messages = reader.by_ref().map(Result::unwrap).count();
            assert!(messages <= whole, "window {window:#x}");
            let is_told = messages == whole || !reader.damages().parts.is_empty();
            assert!(is_told, "window {window:#x}: {:?}", reader.damages());
            recovered(&path);
            assert_eq!(Reader::open(&path).unwrap().count(), messages, "window {window:#x}");
        }
    }
    // With the memory of the tests that run at the same time.
    assert!(most_resident() < 600 << 20, "{} MB", most_resident() >> 20);
}

/// A checksum of zeros means that there is none, which is normal in recordings of other programs only.
#[test]
fn a_checksum_that_was_wiped_out_does_not_hide_damage() {
    let scratch = Scratch::new("wiped");
    let whole = sample(&scratch, true);
    let (recorded, _) = read(&scratch.file("whole.mcap", &whole));
    let length_at = |at: usize| u64::from_le_bytes(whole[at + 1..at + 9].try_into().unwrap());
    // Header, then the chunk with the descriptions; the next is the first with messages.
    let mut at = MAGIC_BYTES;
    for _ in 0..2 {
        at += 9 + length_at(at) as usize;
    }
    while whole[at] != 6 {
        at += 9 + length_at(at) as usize;
    }
    let (crc_at, end) = (at + 9 + 24, at + 9 + length_at(at) as usize);
    for flipped in crc_at + 20..end {
        let mut bytes = whole.clone();
        bytes[crc_at..crc_at + 4].fill(0);
        bytes[flipped] ^= 4;
        let (messages, damages) = read(&scratch.file("damaged.mcap", &bytes));
        assert!(messages.iter().all(|message| recorded.contains(message)), "byte {flipped}");
        assert!(!damages.is_empty(), "byte {flipped}");
    }
}

#[test]
fn damaged_files_take_little_memory_and_give_nothing_wrong() {
    let scratch = Scratch::new("mutations");
    let count =
        std::env::var("TOUCHLINE_MUTATIONS").map_or(MUTATIONS, |text| text.parse().unwrap());
    let samples = [sample(&scratch, true), sample(&scratch, false)];
    let whole: HashSet<Message> =
        read(&scratch.file("whole.mcap", &samples[0])).0.into_iter().collect();
    let seed = std::env::var("TOUCHLINE_SEED").map_or(1, |text| text.parse().unwrap());
    let first = std::env::var("TOUCHLINE_FIRST").map_or(0, |text| text.parse().unwrap());
    let mut random = Random(seed);
    let (mut read_messages, mut most_memory, mut unreadable, mut copied) = (0, 0, 0, 0);
    for number in 0..count {
        let is_hostile = number % 50 == 49;
        let mut bytes = samples[(number % 2) as usize].clone();
        if is_hostile {
            bytes = hostile(&mut random);
        } else {
            mutate(&mut bytes, &mut random);
        }
        if number < first {
            continue;
        }
        let path = scratch.file("damaged.mcap", &bytes);
        let room = 3 * bytes.len() as u64 + MEMORY;
        let mut messages = Vec::new();
        let memory = most_bytes_in(|| {
            let Ok(mut reader) = Reader::open(&path) else { return };
            // Read messages are not kept, since their memory would not be the reader's.
            for entry in reader.by_ref() {
                let entry = entry.unwrap();
                if !is_hostile {
                    messages.push((entry.channel, entry.t_sent_ns, entry.data.into_owned()));
                }
            }
        });
        assert!(memory <= room, "file {number} of {} bytes: {memory} bytes", bytes.len());
        most_memory = most_memory.max(memory);
        for message in &messages {
            assert!(whole.contains(message), "file {number}: {message:?} was never recorded");
        }
        read_messages += messages.len() as u64;
        let memory = most_bytes_in(|| {
            let outcome = recover(&path, &mut |_, _| ());
            if outcome.is_ok() || Reader::open(&path).is_err() {
                unreadable += u64::from(outcome.is_err());
                return;
            }
            // There was no room for a mark; the error says so, and a copy has it.
            let to = scratch.0.join("copy.mcap");
            let _ = std::fs::remove_file(&to);
            let file = File::options().read(true).write(true).create_new(true).open(&to).unwrap();
            recover_to(&path, &file, &mut |_, _| ()).unwrap();
            std::fs::rename(&to, &path).unwrap();
            copied += 1;
        });
        assert!(memory <= room, "recovering file {number}: {memory} bytes");
        if let Ok(mut reader) = Reader::open(&path) {
            let mut again = 0;
            reader.by_ref().for_each(|entry| again += usize::from(entry.is_ok()));
            assert!(!reader.damages().is_recoverable(), "file {number}: {:?}", reader.damages());
            assert!(
                is_hostile || again == messages.len(),
                "file {number}: {again} messages after the recovery, {} before: {:?}",
                messages.len(),
                reader.damages()
            );
            if !is_hostile {
                assert_proper(&path, again);
            }
        }
    }
    println!(
        "{count} damaged files: {unreadable} were no recordings any more, {copied} could only be \
         copied; of {} messages in a whole one, {:.1} were read in the mean; most memory {:.1} MB",
        whole.len(),
        read_messages as f64 / count as f64,
        most_memory as f64 / 1e6
    );
}
