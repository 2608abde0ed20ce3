//! Texts: configurations, labels, sources of frames. No text makes a program crash, and an accepted
//! configuration can be used, written and read again.
#![no_main]

use config::{Config, check, commented_toml};
use grabber::source::Source;
use offline::learning::labels::Labels;
use libfuzzer_sys::fuzz_target;
use std::path::Path;
use std::sync::LazyLock;

/// Cameras with more pixels than this are left to the tests: their tables take long.
const MOST_PIXELS: u32 = 10_000;

/// The lines of a configuration with all keys, without comments.
static LINES: LazyLock<Vec<String>> = LazyLock::new(|| {
    let mut config = Config::default();
    (config.camera.width, config.camera.height) = (100, 75);
    let text = commented_toml(&config);
    let lines = text.lines().filter(|line| !line.starts_with('#') && !line.is_empty());
    lines.map(str::to_string).collect()
});

/// A whole configuration in which one key, selected by the first character, has another value.
fn with_one_value_changed(text: &str) -> Option<String> {
    let mut chars = text.chars();
    let place = chars.next()? as usize % LINES.len();
    let key = LINES[place].split_once('=')?.0;
    let changed = format!("{key}= {}", chars.as_str());
    let lines = LINES.iter().enumerate();
    let lines: Vec<&str> =
        lines.map(|(i, line)| if i == place { &changed } else { line.as_str() }).collect();
    Some(lines.join("\n"))
}

fn check_config(text: &str) {
    let Ok((config, _)) = check(text, "fuzz.toml") else { return };
    let written = commented_toml(&config);
    assert_eq!(Config::parse(&written, "written").ok().as_ref(), Some(&config), "{written}");
    if config.camera.width.saturating_mul(config.camera.height) <= MOST_PIXELS {
        // It may be refused with a reason, but must not crash.
        let _ = classifier::Classifier::new(&config);
        let _ = tracker::Tracker::new(&config);
        let _ = filter::Filter::new(&config);
    }
}

fuzz_target!(|text: &str| {
    let _ = Labels::parse(text, Path::new("fuzz.json"));
    if let Ok(source) = text.parse::<Source>() {
        assert_eq!(source.to_string().parse::<Source>().ok(), Some(source));
    }
    check_config(text);
    if let Some(text) = with_one_value_changed(text) {
        check_config(&text);
    }
});
