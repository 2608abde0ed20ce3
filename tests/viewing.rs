//! Looking at a recording: a synthetic match, recorded without processes, and the questions of a page about it.

mod offline;

use client::instance::Instance;
use config::Config;
use config::snapshot::Snapshot;
use messages::{ClearStale, EventKind, GroupEvent, write_text};
use offline::Offline;
use proptest::prelude::*;
use recording::{Channel, Setup, Writer, encode_frame, encode_message};
use serde_json::{Value, json};
use std::io::{BufReader, PipeReader, PipeWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::thread::JoinHandle;

const FRAMES: u64 = 120;
/// Frames of these numbers are not recorded.
const GAP: std::ops::Range<u64> = 70..74;
/// The recorder sleeps while these frames are sent, and then takes their results first.
const PAUSE: std::ops::Range<u64> = 20..40;
/// From this frame on the group has another configuration.
const CHANGED: u64 = 90;
const WALL_NS: u64 = 1_700_000_000_000_000_000;

struct Scratch(PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

fn setup(snapshot: &Snapshot) -> Vec<u8> {
    let setup = Setup {
        touchline_version: "test".into(),
        instance: "test".into(),
        wall_minus_monotonic_ns: WALL_NS as i64,
        config_toml: snapshot.to_text(),
        revision: snapshot.revision.number,
        accepted_wall_ns: 0,
    };
    setup.encode()
}

/// Records the match.
fn record(path: &Path) {
    let first = Snapshot::first(Config::default());
    let mut config = Config::default();
    config.filter.actuation_delay_ms += 1.0;
    let second = first.next(config, Some(1));
    let channels =
        [Channel::Setup, Channel::Frames, Channel::Detections, Channel::World, Channel::Events];
    let mut writer = Writer::create(path, &channels).unwrap();
    let mut game = Offline::new(&first.config);
    let mut data = Vec::new();
    let mut late: Vec<(u64, Vec<u8>)> = Vec::new();
    for number in 0..FRAMES {
        let mut pixels = Vec::new();
        game.look(|picture| pixels = picture.to_vec());
        game.think();
        let (header, t_ns) = (game.header, WALL_NS + game.header.t_capture_ns);
        let snapshot = if number < CHANGED { &first } else { &second };
        if number == 0 || number == CHANGED {
            writer.write(Channel::Setup, t_ns, t_ns, &setup(snapshot)).unwrap();
        }
        let mut world = *game.world();
        world.revision = snapshot.revision.number;
        // As the recorder does: results before their frame.
        encode_message(&world, &mut data);
        if !GAP.contains(&number) {
            writer.write(Channel::World, t_ns + 1_000_000, t_ns, &data).unwrap();
        }
        let mut seen = bytemuck::allocation::zeroed_box();
        bytemuck::bytes_of_mut::<messages::DetectionFrame>(&mut *seen)
            .copy_from_slice(bytemuck::bytes_of(game.seen()));
        seen.clear_stale();
        seen.revision = snapshot.revision.number;
        encode_message(&*seen, &mut data);
        if !GAP.contains(&number) {
            writer.write(Channel::Detections, t_ns + 500_000, t_ns, &data).unwrap();
            encode_frame(&header, &pixels, &mut data);
            late.push((t_ns, data.clone()));
        }
        if !PAUSE.contains(&number) {
            for (t_ns, data) in late.drain(..) {
                writer.write(Channel::Frames, t_ns, t_ns, &data).unwrap();
            }
        }
        if number == 50 {
            let mut event: GroupEvent = bytemuck::Zeroable::zeroed();
            (event.t_wall_ns, event.kind) = (t_ns, EventKind::Marked as u32);
            write_text(&mut event.what, "a goal");
            encode_message(&event, &mut data);
            writer.write(Channel::Events, t_ns, t_ns, &data).unwrap();
        }
        // After a pause many results come before their frames, which fill several chunks.
        let after_pause = PAUSE.contains(&number);
        if number % 3 == 2 && !after_pause {
            writer.flush().unwrap();
        }
        game.advance();
    }
    writer.finish().unwrap();
}

/// A file of this test with the match, as it is after `spoil`.
fn recorded(name: &str, spoil: impl FnOnce(&mut Vec<u8>)) -> Scratch {
    static MATCH: OnceLock<Vec<u8>> = OnceLock::new();
    let place = |name: &str| {
        let name = format!("touchline-viewing-{name}-{}.mcap", std::process::id());
        Scratch(std::env::temp_dir().join(name))
    };
    let bytes = MATCH.get_or_init(|| {
        let first = place("first");
        record(&first.0);
        std::fs::read(&first.0).unwrap()
    });
    let mut bytes = bytes.clone();
    spoil(&mut bytes);
    let scratch = place(name);
    std::fs::write(&scratch.0, bytes).unwrap();
    scratch
}

/// The other end of a viewer.
struct Viewer {
    questions: Option<PipeWriter>,
    answers: PipeReader,
    thread: Option<JoinHandle<()>>,
}

impl Viewer {
    fn open(path: &Path) -> Self {
        let (input, questions) = std::io::pipe().unwrap();
        let (answers, output) = std::io::pipe().unwrap();
        let path = path.to_path_buf();
        let thread = std::thread::spawn(move || {
            let instance = Instance::below(Path::new("/nowhere"), "test").unwrap();
            touchline::viewing::serve(&path, &instance, BufReader::new(input), output).unwrap();
        });
        Self { questions: Some(questions), answers, thread: Some(thread) }
    }

    fn say(&mut self, line: &str) -> (Value, Vec<u8>) {
        writeln!(self.questions.as_mut().unwrap(), "{line}").unwrap();
        let header = self.part();
        (serde_json::from_slice(&header).unwrap(), self.part())
    }

    fn part(&mut self) -> Vec<u8> {
        let mut length = [0; 4];
        self.answers.read_exact(&mut length).unwrap();
        let mut bytes = vec![0; u32::from_le_bytes(length) as usize];
        self.answers.read_exact(&mut bytes).unwrap();
        bytes
    }

    fn ask(&mut self, question: Value) -> Value {
        self.say(&question.to_string()).0
    }

    fn frame(&mut self, at: Value) -> Value {
        self.ask(json!({ "do": "frame", "at": at }))
    }

    /// The survey when everything was looked at, and compared.
    fn survey(&mut self) -> Value {
        loop {
            let survey = self.ask(json!({ "do": "survey", "bins": 10 }));
            let comparison = &survey["comparison"];
            if survey["done"] == 1.0 && (comparison.is_null() || comparison["is_done"] == true) {
                return survey;
            }
        }
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        self.questions = None;
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(std::thread::panicking() || ended.is_some_and(|ended| ended.is_ok()));
    }
}

#[test]
fn everything_of_a_frame_is_shown() {
    let file = recorded("frames", |_| ());
    let mut viewer = Viewer::open(&file.0);
    let about = viewer.ask(json!({ "do": "open" }));
    let frames = FRAMES - (GAP.end - GAP.start);
    assert_eq!(about["frames"], frames);
    let seconds = about["seconds"].as_f64().unwrap();
    let fps = Config::default().camera.fps;
    assert!((seconds - (FRAMES - 1) as f64 / fps).abs() < 1e-3, "{seconds}");
    let configurations = about["configurations"].as_array().unwrap();
    assert_eq!(configurations.len(), 2);
    let changes = configurations[1]["changes"].to_string();
    assert!(changes.contains("filter.actuation_delay_ms"), "{changes}");

    let question =
        json!({ "do": "frame", "at": { "index": 60 }, "picture": { "scale": 2 }, "runs": true });
    let (frame, picture) = viewer.say(&question.to_string());
    assert_eq!(
        (&frame["index"], &frame["seq"], &frame["revision"]),
        (&json!(60), &json!(60), &json!(1))
    );
    for part in ["detections", "world"] {
        assert_eq!(frame[part]["seq"], 60, "{part}");
        assert_eq!(frame[part]["robots"].as_array().unwrap().len(), 10, "{part}");
    }
    assert!(frame["runs"].as_array().unwrap().len() > 100);
    assert_eq!(frame["picture"]["width"], 320);
    assert_eq!(image::load_from_memory(&picture).unwrap().width(), 320);
    assert!(frame["other"].is_null());
    for index in PAUSE {
        let frame = viewer.frame(json!({ "index": index }));
        assert_eq!(frame["world"]["seq"], index, "recorded after a pause");
        assert_eq!(frame["detections"]["seq"], index);
    }
    // By time, and with the configuration of that time.
    let late = viewer.frame(json!({ "time_s": 1e9 }));
    assert_eq!((&late["index"], &late["revision"]), (&json!(frames - 1), &json!(2)));
    assert_eq!(viewer.frame(json!({ "time_s": 20.2 / fps }))["seq"], 20);
    assert_eq!(viewer.frame(json!({ "index": 1_000_000 }))["index"], frames - 1);
    let model = viewer.ask(json!({ "do": "model", "revision": 2 }));
    assert_eq!((&model["revision"], model["robots"].as_array().unwrap().len()), (&json!(2), 10));
    let (_, png) = viewer.say(&json!({ "do": "still", "index": 3 }).to_string());
    assert_eq!(image::load_from_memory(&png).unwrap().width(), 640);

    let survey = viewer.survey();
    assert_eq!(survey["gaps"][0]["missing"], GAP.end - GAP.start);
    assert_eq!(survey["gaps"].as_array().unwrap().len(), 1);
    assert_eq!(
        (&survey["events"][0]["kind"], &survey["events"][0]["what"]),
        (&json!("marked"), &json!("a goal"))
    );
    let after_s = survey["events"][0]["after_s"].as_f64().unwrap();
    assert!((after_s - 50.0 / fps).abs() < 1e-3, "{after_s}");
    assert_eq!(survey["robots"].as_array().unwrap().len(), 10);
    for found in survey["robots"].as_array().unwrap() {
        assert_eq!(found, 10, "{survey:#}");
    }
}

#[test]
fn another_configuration_is_compared_robot_by_robot() {
    let file = recorded("compare", |_| ());
    let mut viewer = Viewer::open(&file.0);
    let fps = Config::default().camera.fps;
    let mut compare = |with: Value| {
        let question =
            json!({ "do": "compare", "with": with, "from_s": 40.0 / fps, "to_s": 100.0 / fps });
        let answer = viewer.ask(question);
        (answer, viewer.survey()["comparison"].clone())
    };
    // The same finds the same.
    let (_, same) = compare(json!({ "revision": 1 }));
    let frames = 61 - (GAP.end - GAP.start);
    assert_eq!((&same["frames"], &same["different"]), (&json!(frames), &json!(0)), "{same:#}");
    for row in same["rows"].as_array().unwrap() {
        assert_eq!((&row["recorded"], &row["both"]), (&row["other"], &row["other"]), "{row}");
    }
    // Without one of its patches' colours a robot has no name.
    let mut config = Config::default();
    let lacking = config.robots.identities[0].clone();
    config.robots.identities.remove(0);
    let text = json!({ "text": { "name": "other.toml", "text": config::commented_toml(&config) } });
    let (_, other) = compare(text);
    assert_eq!((&other["name"], &other["different"]), (&json!("other.toml"), &json!(frames)));
    let rows = other["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 11, "ten robots and the ball");
    for row in rows {
        let is_it = row["team"] == lacking.team.name() && row["identity"] == lacking.id;
        assert_eq!(row["recorded"] != row["other"], is_it, "{row}");
        if is_it {
            assert_eq!((&row["other"], row["why_other"].is_string()), (&json!(0), true), "{row}");
        }
    }
    let frame = viewer.frame(json!({ "index": 60 }));
    assert_eq!(frame["detections"]["robots"].as_array().unwrap().len(), 10);
    let found = frame["other"]["detections"]["robots"].as_array().unwrap();
    assert!(found.iter().filter(|robot| !robot["identity"].is_null()).count() == 9, "{found:#?}");
    assert_eq!(viewer.frame(json!({ "difference_after": 45 }))["index"], 46);
    assert_eq!(viewer.frame(json!({ "difference_before": 45 }))["index"], 44);
    assert_eq!(viewer.frame(json!({ "difference_after": 0 }))["index"], 40);
    assert!(viewer.frame(json!({ "difference_before": 40 }))["error"]["message"].is_string());
    assert!(viewer.frame(json!({ "index": 10 }))["other"].is_null(), "not compared there");
    let model = viewer.ask(json!({ "do": "model", "other": true }));
    assert_eq!(model["robots"].as_array().unwrap().len(), 9);
    // Stopped in the middle.
    let all = json!({ "do": "compare", "with": { "revision": 2 }, "from_s": 0.0, "to_s": 1e9 });
    viewer.ask(all);
    viewer.ask(json!({ "do": "stop" }));
    let stopped = viewer.survey()["comparison"].clone();
    assert!(stopped["frames"].as_u64().unwrap() < FRAMES - 10, "{stopped}");
}

#[test]
fn nonsense_is_refused_with_words() {
    let file = recorded("nonsense", |_| ());
    let mut viewer = Viewer::open(&file.0);
    let large = "[camera]\nwidth = 1280\nheight = 960\n";
    for question in [
        "".to_string(),
        "{".into(),
        r#"{"do":"remove"}"#.into(),
        r#"{"do":"frame","at":{"index":-1}}"#.into(),
        r#"{"do":"frame","at":{"index":1},"picture":{"scale":3}}"#.into(),
        r#"{"do":"model","other":true}"#.into(),
        r#"{"do":"frame","at":{"difference_after":1}}"#.into(),
        json!({ "do": "compare", "with": { "preset": "chess" }, "from_s": 0, "to_s": 1 }).to_string(),
        json!({ "do": "compare", "with": { "group": { "set": {} } }, "from_s": 0, "to_s": 1 }).to_string(),
        json!({ "do": "compare", "with": { "text": { "name": "a", "text": "[nonsense" } }, "from_s": 0, "to_s": 1 })
            .to_string(),
        json!({ "do": "compare", "with": { "text": { "name": "a", "text": large } }, "from_s": 0, "to_s": 1 })
            .to_string(),
    ] {
        let (answer, _) = viewer.say(&question);
        assert!(answer["error"]["message"].as_str().is_some_and(|it| it.len() > 5), "{question}: {answer}");
    }
    assert!(viewer.ask(json!({ "do": "stop" })).is_object());
    let nothing =
        Scratch(std::env::temp_dir().join(format!("tl-nothing-{}.mcap", std::process::id())));
    std::fs::write(&nothing.0, "no recording at all").unwrap();
    let mut viewer = Viewer::open(&nothing.0);
    let answer = viewer.ask(json!({ "do": "open" }));
    assert!(answer["error"]["message"].as_str().unwrap().contains("not a recording"), "{answer}");
}

#[test]
fn an_unfinished_recording_is_shown_as_a_finished_one() {
    let file = recorded("unfinished", |bytes| bytes.truncate(bytes.len() * 9 / 10));
    let mut viewer = Viewer::open(&file.0);
    let about = viewer.ask(json!({ "do": "open" }));
    let frames = about["frames"].as_u64().unwrap();
    assert!((90..115).contains(&frames), "{about}");
    assert_eq!(viewer.frame(json!({ "index": 60 }))["detections"]["seq"], 60);
    assert_eq!(viewer.survey()["gaps"].as_array().unwrap().len(), 1);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn damage_never_ends_a_viewer(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..40),
    ) {
        let file = recorded("damaged", |bytes| {
            for (at, value) in changes {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
        });
        let mut viewer = Viewer::open(&file.0);
        let about = viewer.ask(json!({ "do": "open" }));
        if about["error"].is_null() {
            viewer.survey();
            for index in (0..about["frames"].as_u64().unwrap()).step_by(11) {
                let frame = viewer.frame(json!({ "index": index }));
                prop_assert!(frame["index"].is_u64(), "{frame}");
            }
        }
    }
}
