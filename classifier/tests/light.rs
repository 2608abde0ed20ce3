//! Reports of the classifier on its correction of the light.

mod reference;

use config::{Config, LightConfig};
use messages::{LightCorrection, Run, RunsHeader};
use reference::Frame;
use touchline_classifier::Classifier;

const PITCH: [f64; 3] = [60.0, 64.0, 56.0];

/// Colours set for a pitch of [`PITCH`].
fn config() -> Config {
    let light = LightConfig { pitch_rgb: Some(PITCH), brightness: 1.0, ..LightConfig::default() };
    Config { light, ..Config::default() }
}

/// An empty pitch under a light that multiplies each channel, and the brightness at the right edge relative
/// to the left.
fn frame(config: &Config, light: [f64; 3], right: f64) -> Frame {
    let camera = &config.camera;
    let (width, height) = (camera.width as usize, camera.height as usize);
    let pixels = (0..width * height).map(|index| {
        let (x, y) = (index % width, index / width);
        let channel = camera.bayer_order.channel_at(x, y);
        let side = right.powf(x as f64 / width as f64);
        (PITCH[channel] * light[channel] * side).round() as u8
    });
    Frame::new(camera.width, camera.height, camera.width, camera.bayer_order, pixels.collect())
}

/// The report after a frame.
fn said(classifier: &mut Classifier, frame: &Frame) -> LightCorrection {
    let (mut header, mut runs) = (RunsHeader::default(), vec![Run::default(); 1000]);
    classifier.step(&frame.header, &frame.pixels, &mut header, &mut runs).unwrap();
    classifier.light()
}

fn assert_near(gains: &[f32], expected: &[f64]) {
    for (gain, expected) in gains.iter().zip(expected) {
        let steps_apart = (f64::from(*gain) / expected).log2().abs() * 16.0;
        assert!(steps_apart < 1.2, "{gains:?}, not {expected}");
    }
}

#[test]
fn gains_follow_a_step_of_the_light_and_back() {
    let config = config();
    let mut classifier = Classifier::new(&config).unwrap();
    let as_set = LightCorrection { flags: LightCorrection::FOLLOWED, ..LightCorrection::NONE };
    assert_eq!(classifier.light(), as_set);
    assert_eq!(said(&mut classifier, &frame(&config, [1.0; 3], 1.0)), as_set);
    let step = [1.3, 0.7, 0.8];
    for changes in [1, 1] {
        let light = said(&mut classifier, &frame(&config, step, 1.0));
        assert_near(&light.gains, &step.map(|light| 1.0 / light));
        assert_eq!((light.changes, light.flags), (changes, LightCorrection::FOLLOWED));
        assert_eq!(light.zones, [1.0; 2]);
    }
    let back = said(&mut classifier, &frame(&config, [1.0; 3], 1.0));
    assert_eq!(back, LightCorrection { changes: 2, ..as_set });
}

#[test]
fn a_disabled_correction_does_nothing() {
    let mut config = config();
    let bright = frame(&config, [1.5; 3], 2.0);
    config.light.pitch_rgb = None;
    config.light.unevenness = 1.0;
    let mut classifier = Classifier::new(&config).unwrap();
    assert_eq!(said(&mut classifier, &bright), LightCorrection::NONE);
}

#[test]
fn limits_of_the_correction_are_reported() {
    let config = config();
    let mut classifier = Classifier::new(&config).unwrap();
    let dim = said(&mut classifier, &frame(&config, [0.25; 3], 1.0));
    assert!(dim.has(LightCorrection::AT_BOUND) && !dim.has(LightCorrection::PITCH_UNSEEN));
    assert_near(&dim.gains, &[2.5; 3]);
    let dark = said(&mut classifier, &frame(&config, [0.0; 3], 1.0));
    assert!(dark.has(LightCorrection::PITCH_UNSEEN) && !dark.has(LightCorrection::AT_BOUND));
    assert_eq!(dark.gains, [1.0; 3]);
    let good = said(&mut classifier, &frame(&config, [1.0; 3], 1.0));
    assert_eq!(good.flags, LightCorrection::FOLLOWED);
}

#[test]
fn zones_report_uneven_light() {
    let mut config = config();
    config.light.unevenness = 1.0;
    let mut classifier = Classifier::new(&config).unwrap();
    assert_eq!(classifier.light().zones, [1.0; 2]);
    let light = said(&mut classifier, &frame(&config, [1.0; 3], 2.0));
    // An octave over the whole picture, most of which is pitch.
    let [least, most] = light.zones;
    assert!((0.66..0.85).contains(&least) && (1.2..1.5).contains(&most), "{light:?}");
    let even = said(&mut classifier, &frame(&config, [1.0; 3], 1.0));
    assert_eq!(even.zones, [1.0; 2]);
}
