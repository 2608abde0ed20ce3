//! A classifier allocates nothing after the first frame of a format.

#[path = "../../tests/counting/mod.rs"]
mod counting;
mod reference;

use config::Config;
use counting::allocations_in;
use messages::{BayerOrder, PixelFormat, Run, RunsHeader};
use reference::{Frame, Noise};
use touchline_classifier::{Classifier, SimdLevel};

#[test]
fn steps_after_the_first_allocate_nothing() {
    let mut config = Config::default();
    // With all corrections of the light.
    config.light.pitch_rgb = Some([100.0, 120.0, 110.0]);
    config.light.unevenness = 0.5;
    let mut noise = Noise(5);
    for level in SimdLevel::available() {
        let mut classifier = Classifier::with_level(&config, level).unwrap();
        let mut header = RunsHeader::default();
        let mut runs = vec![Run::default(); 32_768];
        for format in PixelFormat::ALL {
            let stride = format.row_bytes(640) as u32;
            let bytes = format.frame_bytes(640, 480, stride);
            let pixels = (0..bytes).map(|_| noise.next_u32() as u8).collect();
            let mut frame = Frame::new(640, 480, stride, BayerOrder::Gbrg, pixels);
            frame.header.pixel_format = format as u32;
            // Half as bright as the last frame will be.
            frame.pixels.iter_mut().for_each(|pixel| *pixel /= 2);
            let mut step = |pixels: &[u8]| {
                allocations_in(|| {
                    classifier.step(&frame.header, pixels, &mut header, &mut runs).unwrap();
                })
            };
            step(&frame.pixels);
            assert_eq!(step(&frame.pixels), 0, "{level}, {format}");
            let brighter: Vec<u8> = frame.pixels.iter().map(|pixel| 2 * pixel).collect();
            assert_eq!(step(&brighter), 0, "{level}, {format}, brighter");
        }
    }
}
