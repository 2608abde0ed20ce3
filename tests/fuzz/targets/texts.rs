//! Whatever is read as text: configurations, labels, handover notes, sources of frames. Nothing in a text
//! makes a program fall; and what is accepted as a configuration can be used, written and read again.
#![no_main]

use common::config::{Config, check, commented_toml};
use common::handover::Handover;
use grabber::source::Source;
use learning::labels::Labels;
use libfuzzer_sys::fuzz_target;
use std::path::Path;

/// Cameras with more pixels than this are left to the tests: tables for them take their time.
const MOST_PIXELS: u32 = 1 << 20;

fuzz_target!(|text: &str| {
    let _ = Handover::parse(text);
    let _ = Labels::parse(text, Path::new("fuzz.json"));
    if let Ok(source) = text.parse::<Source>() {
        assert_eq!(source.to_string().parse::<Source>().ok(), Some(source));
    }
    let Ok((config, _)) = check(text, "fuzz.toml") else { return };
    let written = commented_toml(&config);
    assert_eq!(Config::parse(&written, "written").ok().as_ref(), Some(&config), "{written}");
    if config.camera.width.saturating_mul(config.camera.height) <= MOST_PIXELS {
        // May be refused with a reason, but not fall.
        let _ = classifier::Classifier::new(&config);
        let _ = tracker::Tracker::new(&config);
        let _ = filter::Filter::new(&config);
    }
});
