//! Decoding of JPEG pictures from cameras.

use image::ImageDecoder;
use image::codecs::jpeg::JpegDecoder;
use std::io::Cursor;

/// Decodes a picture of this size into red, green and blue; `false` if it is damaged, cut off, of another
/// size, or without colour.
pub fn decode(jpeg: &[u8], width: u32, height: u32, rgb: &mut [u8]) -> bool {
    let Ok(decoder) = JpegDecoder::new(Cursor::new(jpeg)) else { return false };
    check_whole(jpeg).is_ok()
        && decoder.dimensions() == (width, height)
        && decoder.color_type() == image::ColorType::Rgb8
        && decoder.total_bytes() == rgb.len() as u64
        && decoder.read_image(rgb).is_ok()
}

/// A JPEG that does not contain all of its picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum JpegFault {
    /// It ends before its end marker.
    #[error("the JPEG is cut off: its end is missing")]
    CutOff,
    /// Restart markers are missing or out of order, and with them the rows between.
    #[error("the JPEG is damaged: parts of the picture are missing from its middle")]
    PartMissing,
}

/// Checks that the compressed data of every scan is complete. A decoder fills missing parts with grey, which
/// looks like floor. The markers suffice for the check, without decoding: data must extend to the
/// end-of-image marker, and if the encoder wrote restart markers, their number and order must be right. Bytes
/// lost from the middle of a picture without restart markers are not detected.
pub fn check_whole(jpeg: &[u8]) -> Result<(), JpegFault> {
    let mut rest = jpeg;
    let mut frame = None;
    let mut restart_interval = 0;
    loop {
        let (marker, after) = next_marker(rest).ok_or(JpegFault::CutOff)?;
        rest = after;
        match marker {
            END_OF_IMAGE => return Ok(()),
            // Start of image and other markers without content.
            0x01 | RESTART_FIRST..=RESTART_LAST | START_OF_IMAGE => continue,
            _ => {}
        }
        let length = usize::from(u16_at(rest, 0).ok_or(JpegFault::CutOff)?);
        let (segment, after) = rest.split_at_checked(length.max(2)).ok_or(JpegFault::CutOff)?;
        rest = after;
        match marker {
            DEFINE_RESTART_INTERVAL => restart_interval = u16_at(segment, 2).unwrap_or(0),
            // Start of frame; the others of this range define tables.
            0xC0..=0xCF if !matches!(marker, 0xC4 | 0xC8 | 0xCC) => frame = Frame::read(segment),
            START_OF_SCAN => {
                let restarts;
                (restarts, rest) = skip_scan(rest)?;
                let units = frame.as_ref().and_then(|frame| frame.units_in_scan(segment));
                if let Some(units) = units.filter(|_| restart_interval > 0) {
                    let expected = units.div_ceil(usize::from(restart_interval)).max(1) - 1;
                    // Some encoders write one more behind the last interval.
                    if restarts != expected && restarts != expected + 1 {
                        return Err(JpegFault::PartMissing);
                    }
                }
            }
            _ => {}
        }
    }
}

const START_OF_IMAGE: u8 = 0xD8;
const END_OF_IMAGE: u8 = 0xD9;
const START_OF_SCAN: u8 = 0xDA;
const DEFINE_RESTART_INTERVAL: u8 = 0xDD;
const RESTART_FIRST: u8 = 0xD0;
const RESTART_LAST: u8 = 0xD7;

/// The next marker and the bytes behind it. Bytes in front of it are skipped, as decoders do.
fn next_marker(bytes: &[u8]) -> Option<(u8, &[u8])> {
    let mut place = 0;
    loop {
        place += bytes.get(place..)?.iter().position(|&byte| byte == 0xFF)?;
        match *bytes.get(place + 1)? {
            // A byte 0xFF of compressed data is followed by 0; a marker may be preceded by any number of
            // them.
            0x00 => place += 2,
            0xFF => place += 1,
            marker => return Some((marker, &bytes[place + 2..])),
        }
    }
}

/// Skips the compressed data of a scan: the number of restart markers in it, and the bytes from the marker
/// that ends it.
fn skip_scan(data: &[u8]) -> Result<(usize, &[u8]), JpegFault> {
    let mut rest = data;
    let mut restarts = 0;
    loop {
        let (marker, after) = next_marker(rest).ok_or(JpegFault::CutOff)?;
        if !(RESTART_FIRST..=RESTART_LAST).contains(&marker) {
            // Back to the marker: two bytes.
            return Ok((restarts, &data[data.len() - after.len() - 2..]));
        }
        if usize::from(marker - RESTART_FIRST) != restarts % 8 {
            return Err(JpegFault::PartMissing);
        }
        restarts += 1;
        rest = after;
    }
}

/// Division of a picture into units of compressed data.
struct Frame {
    width: usize,
    height: usize,
    /// Identifier, and samples across and down in a unit.
    components: Vec<(u8, [usize; 2])>,
}

impl Frame {
    /// From the segment of a start-of-frame marker; `None` if the height follows later or something is
    /// missing.
    fn read(segment: &[u8]) -> Option<Self> {
        let height = usize::from(u16_at(segment, 3)?);
        let width = usize::from(u16_at(segment, 5)?);
        let count = usize::from(*segment.get(7)?);
        let components: Vec<_> = segment
            .get(8..8 + 3 * count)?
            .chunks_exact(3)
            .map(|part| (part[0], [usize::from(part[1] >> 4), usize::from(part[1] & 15)]))
            .collect();
        let is_usable = height > 0 && components.iter().all(|(_, [h, v])| *h > 0 && *v > 0);
        is_usable.then_some(Self { width, height, components })
    }

    /// Units in a scan with this header.
    fn units_in_scan(&self, segment: &[u8]) -> Option<usize> {
        let most = |axis: usize| self.components.iter().map(|(_, samples)| samples[axis]).max();
        let most = [most(0)?, most(1)?];
        let size = [self.width, self.height];
        let units = if *segment.get(2)? == 1 {
            // A component alone: a unit is one block of it.
            let id = segment.get(3)?;
            let (_, samples) = self.components.iter().find(|(component, _)| component == id)?;
            [0, 1].map(|axis| (size[axis] * samples[axis]).div_ceil(most[axis]).div_ceil(8))
        } else {
            [0, 1].map(|axis| size[axis].div_ceil(8 * most[axis]))
        };
        Some(units[0] * units[1])
    }
}

fn u16_at(bytes: &[u8], place: usize) -> Option<u16> {
    let pair = bytes.get(place..place + 2)?;
    Some(u16::from_be_bytes([pair[0], pair[1]]))
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
    fn colours_survive_encoding_and_decoding() {
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

    /// Cameras pad their buffers.
    #[test]
    fn bytes_behind_the_end_are_ignored() {
        for padding in [0x00, 0xFF, 0xD9] {
            let mut bytes = jpeg();
            bytes.resize(bytes.len() + 1000, padding);
            assert!(decoded(&bytes, SIZE).is_some(), "{padding}");
        }
    }

    #[test]
    fn a_cut_behind_a_whole_preview_is_detected() {
        let preview = jpeg();
        let mut bytes = vec![0xFF, START_OF_IMAGE, 0xFF, 0xE1];
        bytes.extend_from_slice(&((preview.len() + 2) as u16).to_be_bytes());
        bytes.extend_from_slice(&preview);
        bytes.extend_from_slice(&preview[2..]);
        assert_eq!(check_whole(&bytes), Ok(()));
        bytes.truncate(bytes.len() - 2);
        assert_eq!(check_whole(&bytes), Err(JpegFault::CutOff));
    }

    /// Two by two units of three components, with a restart marker behind each; `parts` lists the intervals
    /// that are present, by the number of their restart marker.
    fn with_restarts(parts: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0xFF, START_OF_IMAGE];
        bytes.extend([0xFF, 0xC0, 0, 17, 8, 0, 16, 0, 16, 3]);
        bytes.extend([1, 0x11, 0, 2, 0x11, 0, 3, 0x11, 0]);
        bytes.extend([0xFF, DEFINE_RESTART_INTERVAL, 0, 4, 0, 1]);
        bytes.extend([0xFF, START_OF_SCAN, 0, 12, 3, 1, 0, 2, 0, 3, 0, 0, 63, 0, 0x12, 0xFF, 0]);
        for part in parts {
            bytes.extend([0xFF, RESTART_FIRST + part, 0x34, 0x56]);
        }
        bytes.extend([0xFF, END_OF_IMAGE]);
        bytes
    }

    #[test]
    fn a_missing_restart_marker_is_detected() {
        assert_eq!(check_whole(&with_restarts(&[0, 1, 2])), Ok(()));
        assert_eq!(check_whole(&with_restarts(&[0, 1, 2, 3])), Ok(()));
        for parts in [&[0, 1][..], &[0, 2], &[1, 2], &[0, 1, 2, 3, 4], &[]] {
            assert_eq!(
                check_whole(&with_restarts(parts)),
                Err(JpegFault::PartMissing),
                "{parts:?}"
            );
        }
    }

    proptest! {
        #[test]
        fn a_picture_cut_anywhere_is_refused(cut in any::<prop::sample::Index>()) {
            let mut bytes = jpeg();
            bytes.truncate(cut.index(bytes.len()));
            prop_assert_eq!(decoded(&bytes, SIZE), None);
        }

        #[test]
        fn invalid_data_is_refused(
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
