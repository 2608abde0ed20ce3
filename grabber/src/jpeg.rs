//! Pictures that a camera sends as JPEG.

use image::ImageDecoder;
use image::codecs::jpeg::JpegDecoder;
use std::io::Cursor;

/// Decodes a picture of this size into red, green and blue; `false` when it is damaged, of another
/// size, or without colour.
pub fn decode(jpeg: &[u8], width: u32, height: u32, rgb: &mut [u8]) -> bool {
    let Ok(decoder) = JpegDecoder::new(Cursor::new(jpeg)) else { return false };
    decoder.dimensions() == (width, height)
        && decoder.color_type() == image::ColorType::Rgb8
        && decoder.total_bytes() == rgb.len() as u64
        && decoder.read_image(rgb).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::ExtendedColorType;
    use image::codecs::jpeg::JpegEncoder;
    use proptest::prelude::*;

    const SIZE: (u32, u32) = (32, 16);

    fn jpeg() -> Vec<u8> {
        let pixels = [200, 100, 30].repeat((SIZE.0 * SIZE.1) as usize);
        let mut bytes = Vec::new();
        let mut encoder = JpegEncoder::new_with_quality(&mut bytes, 95);
        encoder.encode(&pixels, SIZE.0, SIZE.1, ExtendedColorType::Rgb8).unwrap();
        bytes
    }

    fn decoded(bytes: &[u8], (width, height): (u32, u32)) -> Option<Vec<u8>> {
        let mut rgb = vec![0; (3 * width * height) as usize];
        decode(bytes, width, height, &mut rgb).then_some(rgb)
    }

    #[test]
    fn colours_come_back() {
        let rgb = decoded(&jpeg(), SIZE).unwrap();
        for pixel in rgb.chunks_exact(3) {
            let errors = [200, 100, 30].iter().zip(pixel).map(|(a, &b)| b.abs_diff(*a));
            assert!(errors.max().unwrap() <= 4, "{pixel:?}");
        }
    }

    #[test]
    fn another_size_is_refused() {
        assert_eq!(decoded(&jpeg(), (16, 32)), None);
    }

    proptest! {
        #[test]
        fn rubbish_is_refused_without_harm(
            cut in 0..600_usize,
            damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8),
        ) {
            let mut bytes = jpeg();
            for (place, value) in damage {
                let place = place.index(bytes.len());
                bytes[place] = value;
            }
            bytes.truncate(bytes.len().saturating_sub(cut));
            let _ = decoded(&bytes, SIZE);
        }
    }
}
