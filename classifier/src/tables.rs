//! The three tables of section 4.2: two AND operations test a pixel against every colour box at once.
//!
//! Bit i of entry v in the red table is set if v lies in the red range of colour i; likewise for green and
//! blue. The AND of the entries for a pixel's R, G and B has a bit for each colour whose box holds the pixel.
//!
//! Pixels of YUV pictures have three further tables, for the colours that have a box in YUV. The other
//! colours are tested with the pixel converted to RGB.

use crate::correction::Correction;
use crate::second_look::{HueSaturation, SecondLook};
use crate::second_look_tables::SecondLookTables;
use crate::white_balance::{Gains, NO_GAINS};
use crate::yuv::rgb_from_yuv;
use crate::{ClassifierError, MAX_CLASSES};
use config::ColorConfig;
use std::sync::Arc;

/// The configured colours, prepared for classification.
#[derive(Debug, Clone, PartialEq)]
pub struct ClassTables {
    rgb: Boxes,
    /// Boxes of the colours that have one in YUV. These and the second looks are independent of the light, so
    /// the tables for all lights share them.
    yuv: Arc<Boxes>,
    /// Bit set of the colours without a box in YUV.
    rgb_only_bits: u32,
    /// Bit set of the colours that have a second look.
    second_look_bits: u32,
    second_looks: Arc<SecondLooks>,
    /// Applied to a pixel before its colour is looked up.
    correction: Correction,
    version: u64,
}

/// The second looks of the colours, and tables of the colours that may admit a pixel.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SecondLooks {
    of_class: [SecondLook; MAX_CLASSES],
    pub tables: SecondLookTables,
    /// Box in RGB and second look of each colour.
    pub classes: Vec<([[u8; 2]; 3], SecondLook)>,
}

/// A table for each channel, with a bit for each colour.
#[derive(Debug, Clone, PartialEq)]
struct Boxes([[u32; 256]; 3]);

impl Boxes {
    const NONE: Self = Self([[0; 256]; 3]);

    fn add(
        &mut self,
        class: usize,
        color: &ColorConfig,
        ranges: [(&'static str, [u8; 2]); 3],
    ) -> Result<(), ClassifierError> {
        for (table, (channel, [low, high])) in self.0.iter_mut().zip(ranges) {
            if low > high {
                let (color, low, high) = (color.name.clone(), low.into(), high.into());
                return Err(ClassifierError::EmptyRange { color, channel, low, high });
            }
            for entry in &mut table[usize::from(low)..=usize::from(high)] {
                *entry |= 1 << class;
            }
        }
        Ok(())
    }

    #[inline(always)]
    fn holding(&self, pixel: [u8; 3]) -> u32 {
        let [first, second, third] = &self.0;
        let [a, b, c] = pixel.map(usize::from);
        first[a] & second[b] & third[c]
    }
}

impl ClassTables {
    /// Colour i of the list becomes class i.
    pub fn new(colors: &[ColorConfig]) -> Result<Self, ClassifierError> {
        if colors.len() > MAX_CLASSES {
            return Err(ClassifierError::TooManyColors(colors.len()));
        }
        let (mut rgb, mut yuv) = (Boxes::NONE, Boxes::NONE);
        let mut second_looks = [SecondLook::ANY; MAX_CLASSES];
        let (mut rgb_only_bits, mut second_look_bits) = (0, 0);
        for (class, color) in colors.iter().enumerate() {
            let ranges = [("red", color.red), ("green", color.green), ("blue", color.blue)];
            rgb.add(class, color, ranges)?;
            if let Some([y, u, v]) = color.yuv_box() {
                yuv.add(class, color, [("y", y), ("u", u), ("v", v)])?;
            } else {
                rgb_only_bits |= 1 << class;
            }
            if let Some(look) = SecondLook::new(color)? {
                second_look_bits |= 1 << class;
                second_looks[class] = look;
            }
        }
        let all = ((1u64 << colors.len()) - 1) as u32;
        let others = all & !second_look_bits;
        let tables = SecondLookTables::new(&second_looks, second_look_bits, others);
        let boxes = colors.iter().map(|color| [color.red, color.green, color.blue]);
        let classes = boxes.zip(second_looks).collect();
        Ok(Self {
            rgb,
            yuv: Arc::new(yuv),
            rgb_only_bits,
            second_look_bits,
            second_looks: Arc::new(SecondLooks { of_class: second_looks, tables, classes }),
            correction: Correction::NONE,
            version: version(colors),
        })
    }

    /// The tables for another light: they classify a pixel as these tables, which must be those for the light
    /// in which the colours were set, classify the pixel with corrected channels. Boxes in YUV stay as they
    /// are.
    pub fn corrected(&self, gains: Gains) -> Self {
        self.corrected_with_haze(gains, 0)
    }

    /// The tables for another light, with white light of `haze` grey levels on top of it.
    pub fn corrected_with_haze(&self, gains: Gains, haze: u8) -> Self {
        debug_assert_eq!(self.correction, Correction::NONE);
        let mut hash = Fnv1a(self.version);
        if gains != NO_GAINS {
            gains.iter().for_each(|steps| hash.write(&steps.to_le_bytes()));
        }
        if haze > 0 {
            hash.write(b"haze");
            hash.write(&[haze]);
        }
        let correction = Correction::new(gains, haze);
        if correction == Correction::NONE {
            return self.clone();
        }
        let mut rgb = Boxes::NONE;
        let boxes = rgb.0.iter_mut().zip(&self.rgb.0);
        for ((table, before), values) in boxes.zip(&correction.tables()) {
            for (entry, value) in table.iter_mut().zip(values) {
                *entry = before[usize::from(*value)];
            }
        }
        Self {
            rgb,
            yuv: Arc::clone(&self.yuv),
            rgb_only_bits: self.rgb_only_bits,
            second_look_bits: self.second_look_bits,
            second_looks: Arc::clone(&self.second_looks),
            correction,
            version: hash.0,
        }
    }

    /// The colours whose RGB box holds the pixel, as a bit set.
    #[inline(always)]
    pub fn boxes(&self, rgb: [u8; 3]) -> u32 {
        self.rgb.holding(rgb)
    }

    /// The colours whose box holds the pixel of a YUV picture, as a bit set: their box in YUV if they have
    /// one, else their box in RGB.
    #[inline(always)]
    pub fn boxes_yuv(&self, yuv: [u8; 3]) -> u32 {
        let mut boxes = self.yuv.holding(yuv);
        if self.rgb_only_bits != 0 {
            boxes |= self.rgb.holding(rgb_from_yuv(yuv)) & self.rgb_only_bits;
        }
        boxes
    }

    /// The colours that have a second look, as a bit set.
    pub fn colors_with_second_look(&self) -> u32 {
        self.second_look_bits
    }

    /// The pixel's class: the first configured colour whose box holds it and whose second look, if it has
    /// one, admits it; `BACKGROUND` if there is none.
    #[inline(always)]
    pub fn classify(&self, rgb: [u8; 3]) -> u8 {
        let boxes = self.boxes(rgb);
        if boxes & self.second_look_bits == 0 {
            first(boxes)
        } else {
            self.first_admitted(boxes, rgb)
        }
    }

    /// The class of a pixel of a YUV picture. The second look tests hue and saturation of the pixel converted
    /// to RGB.
    #[inline(always)]
    pub fn classify_yuv(&self, yuv: [u8; 3]) -> u8 {
        let boxes = self.boxes_yuv(yuv);
        if boxes & self.second_look_bits == 0 {
            first(boxes)
        } else {
            self.first_admitted(boxes, rgb_from_yuv(yuv))
        }
    }

    #[inline(never)]
    fn first_admitted(&self, boxes: u32, rgb: [u8; 3]) -> u8 {
        let seen = HueSaturation::new(
            [0, 1, 2].map(|channel| self.correction.apply(channel, rgb[channel])),
        );
        let mut admitting = boxes & !self.second_look_bits;
        let mut looking = boxes & self.second_look_bits;
        while looking != 0 {
            let class = looking.trailing_zeros();
            let look = &self.second_looks.of_class[class as usize % MAX_CLASSES];
            admitting |= u32::from(look.admits_hue_saturation(&seen)) << class;
            looking &= looking - 1;
        }
        first(admitting)
    }

    /// The tables of red, green and blue.
    pub(crate) fn rgb(&self) -> &[[u32; 256]; 3] {
        &self.rgb.0
    }

    /// The tables of Y, U and V, for the colours that have a box in YUV.
    pub(crate) fn yuv(&self) -> &[[u32; 256]; 3] {
        &self.yuv.0
    }

    /// Whether any colour has a second look.
    pub(crate) fn has_second_looks(&self) -> bool {
        self.second_look_bits != 0
    }

    /// The second looks, which are independent of the light.
    pub(crate) fn second_looks(&self) -> &Arc<SecondLooks> {
        &self.second_looks
    }

    /// The correction that is built into these tables.
    pub(crate) fn correction(&self) -> Correction {
        self.correction
    }

    /// Whether some colours have no box in YUV: pixels of YUV pictures are converted to RGB for them.
    pub(crate) fn has_colors_without_yuv(&self) -> bool {
        self.rgb_only_bits != 0
    }

    /// Identifies the classification: a hash of the numbers that define it, the same in every run of every
    /// build. Names and display colours do not enter.
    pub fn version(&self) -> u64 {
        self.version
    }
}

/// The lowest class of a bit set, or [`BACKGROUND`]; without branches, which would often be mispredicted at
/// edges of patches.
#[inline(always)]
fn first(boxes: u32) -> u8 {
    let class = boxes.trailing_zeros() as u8;
    // 32, if there is none, becomes 255.
    class | 0u8.wrapping_sub(class >> 5)
}

/// FNV-1a, 64 bits, over the colours' ranges and bounds. The number of colours, and a mark in front of each
/// optional bound, make different lists hash differently. Boxes in YUV were added to the format later: they
/// come last, with the numbers of their colours, and only if there are any, so hashes of configurations
/// without them are unchanged.
fn version(colors: &[ColorConfig]) -> u64 {
    let mut hash = Fnv1a::new();
    // Must change together with the meaning of the numbers.
    hash.write(b"touchline colour tables 1");
    hash.write(&(colors.len() as u64).to_le_bytes());
    for color in colors {
        for range in [color.red, color.green, color.blue] {
            hash.write(&range);
        }
        for bounds in [color.hue_deg, color.saturation] {
            hash.write(&[u8::from(bounds.is_some())]);
            for bound in bounds.iter().flatten() {
                // −0 and 0 are the same bound.
                hash.write(&(bound + 0.0).to_bits().to_le_bytes());
            }
        }
    }
    for (class, color) in colors.iter().enumerate() {
        if let Some(ranges) = color.yuv_box() {
            hash.write(&[class as u8]);
            hash.write(ranges.as_flattened());
        }
    }
    hash.0
}

/// A version derived from that of some tables, a label, and the zones of a picture's parts.
pub(crate) fn version_by_parts(tables: u64, what: &[u8], parts: &[u8]) -> u64 {
    let mut hash = Fnv1a(tables);
    hash.write(what);
    hash.write(parts);
    hash.0
}

struct Fnv1a(u64);

impl Fnv1a {
    fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BACKGROUND;

    fn color(red: [u8; 2], green: [u8; 2], blue: [u8; 2]) -> ColorConfig {
        let name = "test".into();
        ColorConfig {
            name,
            red,
            green,
            blue,
            hue_deg: None,
            saturation: None,
            y: None,
            u: None,
            v: None,
            looks: [0; 3],
        }
    }

    fn paper_yellow() -> ColorConfig {
        color([200, 220], [230, 250], [10, 30])
    }

    /// 31 colours whose boxes each hold a single dark blue.
    fn thirty_one_blues() -> Vec<ColorConfig> {
        (0..31).map(|i| color([0, 0], [0, 0], [100 + i, 100 + i])).collect()
    }

    #[test]
    fn the_papers_yellow_is_the_highest_bit() {
        let mut colors = thirty_one_blues();
        colors.push(paper_yellow());
        let tables = ClassTables::new(&colors).unwrap();
        for value in 0..=255u8 {
            let [red, green, blue] = tables.rgb.0.map(|table| table[usize::from(value)] >> 31 == 1);
            assert_eq!(red, (200..=220).contains(&value));
            assert_eq!(green, (230..=250).contains(&value));
            assert_eq!(blue, (10..=30).contains(&value));
        }
        assert_eq!(tables.boxes([210, 240, 20]), 1 << 31);
        for (rgb, class) in [
            ([200, 230, 10], 31),
            ([220, 250, 30], 31),
            ([199, 240, 20], BACKGROUND),
            ([221, 240, 20], BACKGROUND),
            ([210, 229, 20], BACKGROUND),
            ([210, 251, 20], BACKGROUND),
            ([210, 240, 9], BACKGROUND),
            ([210, 240, 31], BACKGROUND),
            ([0, 0, 100], 0),
            ([0, 0, 130], 30),
        ] {
            assert_eq!(tables.classify(rgb), class, "{rgb:?}");
        }
    }

    #[test]
    fn the_first_of_overlapping_boxes_counts() {
        let wide = color([0, 255], [0, 255], [0, 255]);
        let tables = ClassTables::new(&[paper_yellow(), wide.clone()]).unwrap();
        assert_eq!(tables.boxes([210, 240, 20]), 0b11);
        assert_eq!(tables.classify([210, 240, 20]), 0);
        assert_eq!(tables.classify([0, 0, 0]), 1);
        let tables = ClassTables::new(&[wide, paper_yellow()]).unwrap();
        assert_eq!(tables.classify([210, 240, 20]), 0);
    }

    #[test]
    fn a_failed_second_look_leaves_the_pixel_to_the_next_color() {
        let all = color([0, 255], [0, 255], [0, 255]);
        let red = ColorConfig { hue_deg: Some([350.0, 10.0]), ..all.clone() };
        let vivid = ColorConfig { saturation: Some([0.5, 1.0]), ..all.clone() };
        let tables = ClassTables::new(&[red.clone(), vivid.clone(), all]).unwrap();
        assert_eq!(tables.classify([255, 0, 0]), 0);
        assert_eq!(tables.classify([0, 255, 0]), 1);
        assert_eq!(tables.classify([90, 100, 90]), 2);
        let tables = ClassTables::new(&[red, vivid]).unwrap();
        assert_eq!(tables.classify([90, 100, 90]), BACKGROUND);
    }

    #[test]
    fn a_second_look_does_not_admit_what_the_box_refuses() {
        let yellow = ColorConfig { hue_deg: Some([0.0, 360.0]), ..paper_yellow() };
        let tables = ClassTables::new(&[yellow]).unwrap();
        assert_eq!(tables.classify([210, 240, 20]), 0);
        assert_eq!(tables.classify([210, 240, 40]), BACKGROUND);
    }

    #[test]
    fn yuv_pixels_are_tested_with_yuv_boxes_or_as_rgb() {
        // Orange, (255, 169, 43) in RGB.
        let orange = [171, 60, 175];
        let in_rgb = color([250, 255], [165, 170], [40, 50]);
        let in_yuv = ColorConfig { v: Some([170, 180]), ..color([0, 0], [0, 0], [0, 0]) };
        let tables = ClassTables::new(std::slice::from_ref(&in_rgb)).unwrap();
        assert_eq!(tables.classify_yuv(orange), 0);
        assert_eq!(tables.classify_yuv([171, 60, 128]), BACKGROUND);
        let tables = ClassTables::new(&[in_yuv.clone(), in_rgb.clone()]).unwrap();
        assert_eq!(tables.boxes_yuv(orange), 0b11);
        assert_eq!(tables.boxes_yuv([0, 255, 180]), 0b01);
        assert_eq!(tables.boxes_yuv([171, 60, 181]), 0b00);
        // A colour that has a box in YUV is not tested with its box in RGB.
        let elsewhere = ColorConfig { y: Some([0, 9]), ..in_rgb };
        let tables = ClassTables::new(&[elsewhere, in_yuv.clone()]).unwrap();
        assert_eq!(tables.classify_yuv(orange), 1);
        // The second look tests the colour in RGB: a hue of about 36°.
        let other_hue = ColorConfig { hue_deg: Some([40.0, 60.0]), ..in_yuv.clone() };
        let hue = ColorConfig { hue_deg: Some([20.0, 40.0]), ..in_yuv };
        let tables = ClassTables::new(&[other_hue, hue]).unwrap();
        assert_eq!(tables.classify_yuv(orange), 1);
    }

    #[test]
    fn corrected_tables_equal_corrected_pixels() {
        let red =
            ColorConfig { hue_deg: Some([340.0, 20.0]), ..color([90, 255], [0, 90], [0, 90]) };
        let grey =
            ColorConfig { saturation: Some([0.0, 0.1]), ..color([0, 200], [0, 200], [0, 200]) };
        let tables = ClassTables::new(&[red, paper_yellow(), grey]).unwrap();
        assert_eq!(tables.corrected(NO_GAINS), tables);
        for gains in [[3, -2, 10], [-21, 0, 21], [5, 5, 5]] {
            let corrections = Correction::new(gains, 0).tables();
            let corrected_tables = tables.corrected(gains);
            assert_ne!(corrected_tables.version(), tables.version());
            for index in 0..17u32.pow(3) {
                let rgb =
                    [index % 17, index / 17 % 17, index / 289].map(|value| (15 * value) as u8);
                let corrected =
                    [0, 1, 2].map(|channel: usize| corrections[channel][usize::from(rgb[channel])]);
                assert_eq!(
                    corrected_tables.classify(rgb),
                    tables.classify(corrected),
                    "{rgb:?} {gains:?}"
                );
            }
        }
    }

    #[test]
    fn impossible_colors_are_refused() {
        let too_many = vec![paper_yellow(); 33];
        assert_eq!(ClassTables::new(&too_many), Err(ClassifierError::TooManyColors(33)));
        assert!(ClassTables::new(&too_many[..32]).is_ok());
        let empty = color([0, 255], [9, 8], [0, 255]);
        assert_eq!(
            ClassTables::new(&[empty]).unwrap_err().to_string(),
            "colour \"test\": green from 9 to 8 is empty"
        );
        assert!(ClassTables::new(&[]).is_ok());
    }

    #[test]
    fn the_version_depends_on_the_numbers_only() {
        let yellow = paper_yellow();
        let of = |colors: &[ColorConfig]| ClassTables::new(colors).unwrap().version();
        let reference = of(std::slice::from_ref(&yellow));
        // Computed by another program. Recordings refer to it, so it must never change.
        assert_eq!(reference, 0x7c3e_5061_fece_13e5);

        let renamed = ColorConfig { name: "gold".into(), looks: [9; 3], ..yellow.clone() };
        assert_eq!(of(&[renamed]), reference);

        let bounds = Some([0.25, 0.75]);
        let others = [
            vec![],
            vec![yellow.clone(), yellow.clone()],
            vec![color([200, 221], [230, 250], [10, 30])],
            vec![color([200, 220], [230, 250], [10, 31])],
            vec![color([230, 250], [200, 220], [10, 30])],
            vec![ColorConfig { hue_deg: bounds, ..yellow.clone() }],
            vec![ColorConfig { saturation: bounds, ..yellow.clone() }],
            vec![ColorConfig { y: Some([1, 2]), ..yellow.clone() }],
            vec![ColorConfig { u: Some([1, 2]), ..yellow }],
        ];
        let mut versions: Vec<u64> = others.iter().map(|colors| of(colors)).collect();
        versions.push(reference);
        versions.sort_unstable();
        versions.dedup();
        assert_eq!(versions.len(), others.len() + 1);
    }
}
