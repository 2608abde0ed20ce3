//! The three tables of section 4.2: every colour box is tested at once by two AND operations.
//!
//! Bit i of entry v in the red table says whether v lies in the red range of colour i; likewise for
//! green and blue. The AND of the entries for a pixel's R, G and B has one bit for each colour
//! whose box holds the pixel.

use crate::second_look::SecondLook;
use crate::{BACKGROUND, ClassifierError, MAX_CLASSES};
use common::config::ColorConfig;

/// The configured colours, ready for classifying pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct ClassTables {
    red: [u32; 256],
    green: [u32; 256],
    blue: [u32; 256],
    /// Bit set of the colours that have a second look.
    second_look_bits: u32,
    second_looks: [SecondLook; MAX_CLASSES],
    version: u64,
}

impl ClassTables {
    /// Colour i of the list becomes class i.
    pub fn new(colors: &[ColorConfig]) -> Result<Self, ClassifierError> {
        if colors.len() > MAX_CLASSES {
            return Err(ClassifierError::TooManyColors(colors.len()));
        }
        let mut tables = Self {
            red: [0; 256],
            green: [0; 256],
            blue: [0; 256],
            second_look_bits: 0,
            second_looks: [SecondLook::ANY; MAX_CLASSES],
            version: version(colors),
        };
        for (class, color) in colors.iter().enumerate() {
            let bit = 1 << class;
            for (table, range, channel) in [
                (&mut tables.red, color.red, "red"),
                (&mut tables.green, color.green, "green"),
                (&mut tables.blue, color.blue, "blue"),
            ] {
                let [low, high] = range;
                if low > high {
                    return Err(ClassifierError::EmptyRange {
                        color: color.name.clone(),
                        channel,
                        low: low.into(),
                        high: high.into(),
                    });
                }
                for entry in &mut table[usize::from(low)..=usize::from(high)] {
                    *entry |= bit;
                }
            }
            if let Some(look) = SecondLook::new(color)? {
                tables.second_look_bits |= bit;
                tables.second_looks[class] = look;
            }
        }
        Ok(tables)
    }

    /// The colours whose RGB box holds the pixel, as a bit set.
    #[inline]
    pub fn boxes(&self, [red, green, blue]: [u8; 3]) -> u32 {
        self.red[usize::from(red)] & self.green[usize::from(green)] & self.blue[usize::from(blue)]
    }

    /// The pixel's class: the first of the configured colours whose box holds it and whose second
    /// look, if it has one, admits it; [`BACKGROUND`] if there is none.
    #[inline]
    pub fn classify(&self, rgb: [u8; 3]) -> u8 {
        let boxes = self.boxes(rgb);
        if boxes == 0 { BACKGROUND } else { self.first_admitted(boxes, rgb) }
    }

    fn first_admitted(&self, mut boxes: u32, rgb: [u8; 3]) -> u8 {
        while boxes != 0 {
            let class = boxes.trailing_zeros();
            let has_second_look = self.second_look_bits >> class & 1 == 1;
            if !has_second_look || self.second_looks[class as usize].admits(rgb) {
                return class as u8;
            }
            boxes &= boxes - 1;
        }
        BACKGROUND
    }

    /// Identifies the classification: a hash of the numbers that define it, the same in every run
    /// of every build. Names and looks of the colours do not matter.
    pub fn version(&self) -> u64 {
        self.version
    }
}

/// FNV-1a, 64 bits, over the colours' ranges and bounds, with their count and with a mark in front
/// of optional bounds so that no two lists read the same.
fn version(colors: &[ColorConfig]) -> u64 {
    let mut hash = Fnv1a::new();
    // To be changed together with the meaning of the numbers.
    hash.write(b"touchline colour tables 1");
    hash.write(&(colors.len() as u64).to_le_bytes());
    for color in colors {
        for range in [color.red, color.green, color.blue] {
            hash.write(&range);
        }
        for bounds in [color.hue_deg, color.saturation] {
            hash.write(&[u8::from(bounds.is_some())]);
            for bound in bounds.iter().flatten() {
                // −0 and 0 bound the same.
                hash.write(&(bound + 0.0).to_bits().to_le_bytes());
            }
        }
    }
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

    fn color(red: [u8; 2], green: [u8; 2], blue: [u8; 2]) -> ColorConfig {
        let name = "test".into();
        ColorConfig { name, red, green, blue, hue_deg: None, saturation: None, looks: [0; 3] }
    }

    fn paper_yellow() -> ColorConfig {
        color([200, 220], [230, 250], [10, 30])
    }

    /// 31 colours that hold nothing but one dark blue each.
    fn thirty_one_blues() -> Vec<ColorConfig> {
        (0..31).map(|i| color([0, 0], [0, 0], [100 + i, 100 + i])).collect()
    }

    #[test]
    fn the_papers_yellow_is_the_highest_bit() {
        let mut colors = thirty_one_blues();
        colors.push(paper_yellow());
        let tables = ClassTables::new(&colors).unwrap();
        for value in 0..=255u8 {
            let entry = |table: &[u32; 256]| table[usize::from(value)] >> 31 == 1;
            assert_eq!(entry(&tables.red), (200..=220).contains(&value));
            assert_eq!(entry(&tables.green), (230..=250).contains(&value));
            assert_eq!(entry(&tables.blue), (10..=30).contains(&value));
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
    fn of_overlapping_boxes_the_first_counts() {
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
    fn the_version_names_the_numbers_and_nothing_else() {
        let yellow = paper_yellow();
        let of = |colors: &[ColorConfig]| ClassTables::new(colors).unwrap().version();
        let reference = of(std::slice::from_ref(&yellow));
        // Computed by another program: recordings refer to it, so it must never change by itself.
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
            vec![ColorConfig { saturation: bounds, ..yellow }],
        ];
        let mut versions: Vec<u64> = others.iter().map(|colors| of(colors)).collect();
        versions.push(reference);
        versions.sort_unstable();
        versions.dedup();
        assert_eq!(versions.len(), others.len() + 1);
    }
}
