//! Order in which the messages of a recording are read.

use std::path::PathBuf;
use touchline_recording::{Channel, Reader, Setup, Writer};

struct Scratch(PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Time of sending and channel of everything read from a file with these messages, in nanoseconds.
fn read_back(name: &str, messages: &[(Channel, u64)]) -> Vec<(Channel, u64)> {
    let name = format!("touchline-order-{name}-{}.mcap", std::process::id());
    let path = Scratch(std::env::temp_dir().join(name));
    let setup = Setup {
        touchline_version: "test".into(),
        instance: "test".into(),
        wall_minus_monotonic_ns: 0,
        config_toml: String::new(),
        revision: 1,
        accepted_wall_ns: 0,
    };
    let mut writer =
        Writer::create(&path.0, &[Channel::Setup, Channel::Frames, Channel::World]).unwrap();
    for &(channel, t_ns) in messages {
        let data = if channel == Channel::Setup { setup.encode() } else { vec![7; 100] };
        writer.write(channel, t_ns, t_ns, &data).unwrap();
    }
    writer.finish().unwrap();
    let entries = Reader::open(&path.0).unwrap().map(Result::unwrap);
    entries.map(|entry| (entry.channel, entry.t_sent_ns)).collect()
}

#[test]
fn messages_are_read_in_the_order_of_sending() {
    let read =
        read_back("sent", &[(Channel::World, 300), (Channel::Frames, 200), (Channel::World, 400)]);
    assert_eq!(read, [(Channel::Frames, 200), (Channel::World, 300), (Channel::World, 400)]);
}

#[test]
fn the_configuration_that_a_file_begins_with_precedes_messages_sent_before_it() {
    let messages = [(Channel::Setup, 250), (Channel::Frames, 200), (Channel::World, 300)];
    assert_eq!(read_back("begin", &messages), messages);
    // Later ones have their place in time.
    let messages = [(Channel::World, 300), (Channel::Setup, 250), (Channel::Frames, 200)];
    let read = read_back("later", &messages);
    assert_eq!(read, [(Channel::Frames, 200), (Channel::Setup, 250), (Channel::World, 300)]);
}
