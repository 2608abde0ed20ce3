//! Tests of message order across a hand-over, and of waiting for a free slot on a full topic.

use messages::topics;
use messages::{Run, RunsHeader};
use std::path::PathBuf;
use touchline_client::bus::{Bus, Publisher};
use touchline_client::instance::Instance;

/// A separate instance that leaves nothing behind.
struct Place {
    base: PathBuf,
    instance: Instance,
}

impl Place {
    fn new(name: &str) -> Self {
        let base = std::env::temp_dir().join(format!("tl-{name}-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        Self { base, instance }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = self.instance.remove_namespace();
        let _ = std::fs::remove_dir_all(&self.base);
    }
}

fn publish(publisher: &mut Publisher<Run, RunsHeader>, seq: u64) {
    let mut message = publisher.loan(1).unwrap();
    message.parts().1.frame.seq = seq;
    message.send().unwrap();
}

#[test]
fn a_late_reader_gets_them_by_number_in_any_order_of_connection() {
    let place = Place::new("order");
    for old_first in [true, false] {
        let bus = Bus::join(&place.instance, "test").unwrap();
        bus.enter_roster();
        let reader = bus.subscriber(&topics::RUNS).unwrap();
        let writer = || bus.publisher(&topics::RUNS, 1).unwrap();
        let (first, second) = (writer(), writer());
        let (mut old, mut new) = if old_first { (first, second) } else { (second, first) };
        for seq in 0..20 {
            publish(&mut old, seq);
        }
        // A killed process does not withdraw its messages, so the old writer stays.
        for seq in 20..40 {
            publish(&mut new, seq);
        }
        let received: Vec<u64> = std::iter::from_fn(|| reader.receive().unwrap())
            .map(|message| message.header().frame.seq)
            .collect();
        assert_eq!(received, (0..40).collect::<Vec<u64>>(), "old writer first: {old_first}");
    }
}

#[test]
fn a_late_starter_gets_what_was_published_before_it_came() {
    let place = Place::new("history");
    let bus = Bus::join(&place.instance, "test").unwrap();
    bus.enter_roster();
    let mut writer = bus.publisher(&topics::RUNS, 1).unwrap();
    for seq in 0..10 {
        publish(&mut writer, seq);
    }
    let stage = bus.subscriber_with_history(&topics::RUNS).unwrap();
    let consumer = bus.subscriber(&topics::RUNS).unwrap();
    publish(&mut writer, 10);
    let seqs = |reader: &touchline_client::bus::Subscriber<Run, RunsHeader>| -> Vec<u64> {
        std::iter::from_fn(|| reader.receive().unwrap())
            .map(|message| message.header().frame.seq)
            .collect()
    };
    assert_eq!(seqs(&stage), (0..=10).collect::<Vec<u64>>());
    assert_eq!(seqs(&consumer), [10]);
}

#[test]
fn only_those_on_the_roster_are_believed_and_the_others_counted() {
    let place = Place::new("believed");
    let member = Bus::join(&place.instance, "member").unwrap();
    let stranger = Bus::join(&place.instance, "stranger").unwrap();
    let reader = Bus::join(&place.instance, "reader").unwrap();
    let runs = reader.subscriber(&topics::RUNS).unwrap();
    let mut own = member.publisher(&topics::RUNS, 1).unwrap();
    let mut foreign = stranger.publisher(&topics::RUNS, 1).unwrap();
    let seqs = || -> Vec<u64> {
        std::iter::from_fn(|| runs.receive().unwrap())
            .map(|message| message.header().frame.seq)
            .collect()
    };
    publish(&mut own, 1);
    assert!(seqs().is_empty(), "it is not on the roster yet");
    member.enter_roster();
    runs.take_strangers();
    for seq in 2..60 {
        publish(&mut own, seq);
        publish(&mut foreign, seq + 900);
        publish(&mut foreign, seq);
        assert_eq!(seqs(), [seq]);
    }
    let [met] = runs.take_strangers()[..] else { panic!("one stranger") };
    assert_eq!((met.messages, met.sender.pid()), (116, std::process::id()));
    let name = touchline_client::bus::participants::name_of(&place.instance, met.sender);
    assert_eq!(name.as_deref(), Some("stranger"));
    assert_eq!(runs.take_strangers(), [], "it begins anew");
    // The user permits it.
    reader.admit(met.sender);
    publish(&mut foreign, 70);
    assert_eq!(seqs(), [70]);
    // On an open topic every program is accepted.
    let commands = reader.subscriber(&topics::COMMANDS).unwrap();
    let mut strategy = stranger.publisher(&topics::COMMANDS, 1).unwrap();
    strategy.loan(1).unwrap().send().unwrap();
    assert!(commands.receive().unwrap().is_some() && commands.take_strangers().is_empty());
}

#[test]
fn a_place_that_is_taken_is_waited_for() {
    let place = Place::new("places");
    let instance = place.instance.clone();
    let bus = Bus::join(&place.instance, "test").unwrap();
    let subscribe = || bus.subscriber(&topics::TRUTH);
    let mut readers: Vec<_> =
        (0..topics::TRUTH.subscribers).map(|_| subscribe().unwrap()).collect();
    let (full, is_full) = std::sync::mpsc::channel();
    let late = std::thread::spawn(move || {
        let bus = Bus::join(&instance, "late").unwrap();
        full.send(()).unwrap();
        bus.subscriber(&topics::TRUTH).map(drop)
    });
    is_full.recv().unwrap();
    std::thread::sleep(std::time::Duration::from_millis(50));
    drop(readers.pop());
    late.join().unwrap().unwrap();
    // If no slot becomes free, the error says so.
    readers.push(subscribe().unwrap());
    let error = subscribe().err().unwrap().to_string();
    assert!(error.contains("truth") && error.contains("all places are taken"), "{error}");
}
