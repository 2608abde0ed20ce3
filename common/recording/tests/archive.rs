//! Looking around in recordings, finished or not, damaged or not.

use proptest::prelude::*;
use std::path::PathBuf;
use touchline_recording::{Archive, Channel, Entry, Reader, Writer};

const CHUNKS: u64 = 40;
const IN_CHUNK: u64 = 3;
const APART_NS: u64 = 12_500_000;

struct Scratch(PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// A recording of frames and detections, with an event in every tenth chunk.
fn recorded(name: &str, channels: &[Channel], is_finished: bool) -> Scratch {
    let name = format!("touchline-archive-{name}-{}.mcap", std::process::id());
    let scratch = Scratch(std::env::temp_dir().join(name));
    let mut writer = Writer::create(&scratch.0, channels).unwrap();
    for number in 0..CHUNKS * IN_CHUNK {
        let t_ns = 1_000_000_000 + number * APART_NS;
        let data = number.to_le_bytes().repeat(20);
        // As the recorder does: the last topic first.
        writer.write(Channel::Detections, t_ns + 2_000_000, t_ns, &data).unwrap();
        writer.write(Channel::Frames, t_ns, t_ns, &data).unwrap();
        if number % (10 * IN_CHUNK) == 0 {
            writer.write(Channel::Events, t_ns, t_ns, &data).unwrap();
        }
        if number % IN_CHUNK == IN_CHUNK - 1 {
            writer.flush().unwrap();
        }
    }
    match is_finished {
        true => drop(writer.finish().unwrap()),
        false => drop(writer),
    }
    scratch
}

const ALL: [Channel; 3] = [Channel::Frames, Channel::Detections, Channel::Events];

fn everything(archive: &mut Archive) -> Vec<Entry> {
    let mut all = Vec::new();
    for chunk in 0..archive.chunks() {
        all.extend(archive.read(chunk).unwrap());
    }
    all.sort_by_key(|entry| (entry.t_sent_ns, entry.channel));
    all
}

#[test]
fn every_moment_is_found_with_and_without_an_index() {
    for is_finished in [true, false] {
        let file = recorded(&format!("moments-{is_finished}"), &ALL, is_finished);
        let mut archive = Archive::open(&file.0).unwrap();
        assert_eq!(archive.lead(), Channel::Frames);
        assert_eq!(archive.moments().len() as u64, CHUNKS * IN_CHUNK);
        assert!(archive.moments().is_sorted());
        for (at, t_ns) in [(0, 0), (0, 1_006_000_000), (1, 1_007_000_000), (119, u64::MAX)] {
            assert_eq!(archive.nearest(t_ns), Some(at), "{t_ns}");
        }
        let moment = archive.moments()[50];
        let entries = archive.read(moment.chunk as usize).unwrap();
        let is_it = |it: &&Entry| it.channel == Channel::Frames && it.t_sent_ns == moment.t_sent_ns;
        assert_eq!(entries.iter().find(is_it).unwrap().data[..8], 50u64.to_le_bytes());
        let with_events =
            (0..archive.chunks()).filter(|&chunk| archive.has(chunk, Channel::Events));
        assert_eq!(with_events.count(), 4);
        let mut read: Vec<Entry> = Reader::open(&file.0).unwrap().map(Result::unwrap).collect();
        read.sort_by_key(|entry| (entry.t_sent_ns, entry.channel));
        assert_eq!(everything(&mut archive), read);
    }
}

#[test]
fn without_frames_results_give_the_moments() {
    let file = recorded("results", &[Channel::Detections], true);
    let archive = Archive::open(&file.0).unwrap();
    assert_eq!(archive.lead(), Channel::Detections);
    assert_eq!(archive.moments()[0].t_sent_ns, 1_002_000_000);
    let file = recorded("nothing", &[Channel::Events], true);
    let archive = Archive::open(&file.0).unwrap();
    assert_eq!((archive.moments().len(), archive.nearest(5)), (0, None));
}

#[test]
fn a_damaged_chunk_costs_its_own_messages_only() {
    let file = recorded("damage", &ALL, true);
    let mut archive = Archive::open(&file.0).unwrap();
    let whole = everything(&mut archive).len();
    let chunk = archive.moments()[60].chunk as usize;
    let lost = archive.read(chunk).unwrap().len();
    let mut bytes = std::fs::read(&file.0).unwrap();
    // The file is nothing but chunks of about equal size before its index.
    let middle = bytes.len() / 2;
    bytes[middle - 40..middle].fill(0xa5);
    std::fs::write(&file.0, bytes).unwrap();
    let mut archive = Archive::open(&file.0).unwrap();
    let left = everything(&mut archive).len();
    assert!(left < whole && left >= whole - 2 * (lost + 1), "{left} of {whole}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn no_damage_leads_astray(changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..20)) {
        let file = recorded(&format!("fuzz-{:?}", std::thread::current().id()), &ALL, true);
        let mut bytes = std::fs::read(&file.0).unwrap();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        std::fs::write(&file.0, bytes).unwrap();
        if let Ok(mut archive) = Archive::open(&file.0) {
            prop_assert!(everything(&mut archive).len() as u64 <= 3 * CHUNKS * IN_CHUNK);
            for moment in archive.moments().to_vec() {
                prop_assert!((moment.chunk as usize) < archive.chunks());
            }
        }
    }
}
