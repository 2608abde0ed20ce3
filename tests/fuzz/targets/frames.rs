//! The classifier with any header and any bytes. Runs are well formed, or the frame is refused.
#![no_main]

use bytemuck::{Zeroable, bytes_of_mut};
use classifier::Classifier;
use config::{Config, GeometryConfig};
use messages::{FrameHeader, Run, RunsHeader};
use libfuzzer_sys::fuzz_target;
use std::cell::RefCell;

const WIDTH: u32 = 18;
const HEIGHT: u32 = 7;
/// Smaller than a full picture.
const CAPACITY: usize = 60;

thread_local! {
    static CLASSIFIER: RefCell<Classifier> = RefCell::new({
        let mut config = Config::default();
        (config.camera.width, config.camera.height) = (WIDTH, HEIGHT);
        config.geometry = GeometryConfig::above(&config.field, config.camera.picture_px(), 2200.0);
        Classifier::new(&config).expect("the default colours can be used")
    });
}

fuzz_target!(|bytes: &[u8]| {
    let Some((&kind, rest)) = bytes.split_first() else { return };
    let mut header = FrameHeader::zeroed();
    let pixels = match rest.split_at_checked(size_of::<FrameHeader>()) {
        Some((first, pixels)) if kind & 1 == 0 => {
            bytes_of_mut(&mut header).copy_from_slice(first);
            pixels
        }
        _ => rest,
    };
    if kind & 2 == 0 {
        (header.width, header.height) = (WIDTH, HEIGHT);
    }
    if kind & 4 == 0 {
        header.stride = header.stride % 8 + WIDTH * (u32::from(kind) >> 6);
        header.pixel_format = header.pixel_format % 6 + 1;
        header.bayer_order %= 4;
    }
    let mut out = [Run::zeroed(); CAPACITY];
    let mut out_header = RunsHeader::zeroed();
    CLASSIFIER.with_borrow_mut(|classifier| {
        let checked = classifier.check(&header, pixels.len());
        let stepped = classifier.step(&header, pixels, &mut out_header, &mut out);
        assert_eq!(checked.is_ok(), stepped.is_ok());
        if stepped.is_err() {
            assert_eq!(out_header, RunsHeader::zeroed());
            return;
        }
        let runs = out_header.valid(&out);
        assert_eq!(runs.len(), out_header.run_count as usize);
        for run in runs {
            assert!(run.begin < run.end && u32::from(run.end) <= WIDTH, "{run:?}");
            assert!(u32::from(run.row) < HEIGHT && run.class < 32, "{run:?}");
        }
        let in_order = |a: &Run, b: &Run| a.row < b.row || a.row == b.row && a.end <= b.begin;
        assert!(runs.windows(2).all(|pair| in_order(&pair[0], &pair[1])), "{runs:?}");
    });
});
