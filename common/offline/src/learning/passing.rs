//! The cost of a configuration's colours in the classifier: the share of a pitch's pixels that pass the
//! colours' boxes, so that hue and saturation have to be checked.
//!
//! The boxes are compared with many pixels at a time; the check of hue and saturation takes one pixel
//! after the other. A frame is nearly all floor, so the share of the floor that passes determines its
//! classification time.

use super::LearnError;
use crate::learning::picture::Picture;
use classifier::ClassTables;
use config::Config;

/// Above this share of the floor the second look takes longer than the rest of the classifier.
const MUCH: f64 = 0.1;
/// A colour that passes a smaller share is not mentioned.
const LITTLE: f64 = 0.001;

/// Number of pixels that pass to the second look.
pub struct Passing {
    tables: ClassTables,
    names: Vec<String>,
    pixels: u64,
    passing: u64,
    /// Indexed by colour.
    by_color: Vec<u64>,
}

impl Passing {
    /// Starts counting for the configured colours.
    pub fn none(config: &Config) -> Result<Self, LearnError> {
        Ok(Self {
            tables: ClassTables::new(&config.colors)?,
            names: config.colors.iter().map(|color| color.name.clone()).collect(),
            pixels: 0,
            passing: 0,
            by_color: vec![0; config.colors.len()],
        })
    }

    /// Adds the pixels of a picture for which `counts` is true. The picture is in the light for which
    /// the colours are made.
    pub fn add(&mut self, picture: &Picture, counts: &[bool]) {
        for (&rgb, _) in picture.rgb.iter().zip(counts).filter(|(_, counts)| **counts) {
            self.add_pixel(rgb);
        }
    }

    fn add_pixel(&mut self, rgb: [u8; 3]) {
        self.pixels += 1;
        let mut colors = self.tables.boxes(rgb) & self.tables.colors_with_second_look();
        self.passing += u64::from(colors != 0);
        while colors != 0 {
            self.by_color[colors.trailing_zeros() as usize] += 1;
            colors &= colors - 1;
        }
    }

    /// Adds pixels of a floor of this colour, from 0.7 to 1.4 times as bright.
    pub fn add_floor(&mut self, pitch_rgb: [f64; 3]) {
        const NOISE: [f64; 5] = [-6.0, -3.0, 0.0, 3.0, 6.0];
        for step in 0..=14 {
            let brightness = 0.7 + f64::from(step) * 0.05;
            for red in NOISE {
                for green in NOISE {
                    for blue in NOISE {
                        let noise = [red, green, blue];
                        self.add_pixel([0, 1, 2].map(|channel: usize| {
                            (pitch_rgb[channel] * brightness + noise[channel]).clamp(0.0, 255.0)
                                as u8
                        }));
                    }
                }
            }
        }
    }

    /// Adds all possible colours, evenly.
    pub fn add_everything(&mut self) {
        for index in 0..32usize.pow(3) {
            self.add_pixel([1024, 32, 1].map(|unit| (index / unit % 32 * 8 + 4) as u8));
        }
    }

    /// The share that passes.
    pub fn share(&self) -> f64 {
        self.passing as f64 / self.pixels.max(1) as f64
    }

    /// One line, and a second one if the share is large; `what` names the origin of the pixels.
    pub fn text(&self, what: &str) -> String {
        let part = |count: u64| count as f64 / self.pixels.max(1) as f64;
        let percent = |part: f64| match part {
            part if part >= 0.0995 => format!("{:.0} %", 100.0 * part),
            part => format!("{:.1} %", 100.0 * part),
        };
        let mut colors: Vec<(&str, f64)> = self
            .names
            .iter()
            .zip(&self.by_color)
            .map(|(name, &count)| (name.as_str(), part(count)))
            .filter(|&(_, part)| part >= LITTLE)
            .collect();
        colors.sort_by(|a, b| b.1.total_cmp(&a.1));
        let by_color: Vec<String> =
            colors.iter().map(|(name, part)| format!("{name} {}", percent(*part))).collect();
        let by_color = match by_color.is_empty() {
            true => String::new(),
            false => format!(" ({})", by_color.join(", ")),
        };
        let mut text =
            format!("{} of {what} passes to the second look{by_color}", percent(self.share()));
        if self.share() > MUCH {
            text += "; narrower boxes in red, green and blue would make the classifier faster";
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn passing(change: impl FnOnce(&mut Config)) -> Passing {
        let mut config = Config::default();
        change(&mut config);
        Passing::none(&config).unwrap()
    }

    fn open(config: &mut Config) {
        let color = &mut config.colors[0];
        (color.red, color.green, color.blue) = ([0, 255], [0, 255], [0, 255]);
        (color.hue_deg, color.saturation) = (Some([10.0, 40.0]), Some([0.4, 1.0]));
    }

    #[test]
    fn open_boxes_pass_everything_and_are_named() {
        let mut open = passing(open);
        open.add_floor([40.0, 60.0, 50.0]);
        assert_eq!(open.share(), 1.0);
        let text = open.text("the pitch");
        assert!(text.starts_with("100 % of the pitch passes to the second look (orange 100 %)"));
        assert!(text.contains("narrower boxes"), "{text}");
    }

    #[test]
    fn boxes_beside_the_floor_pass_nothing() {
        let mut closed = passing(|config| {
            open(config);
            config.colors[0].red = [150, 255];
        });
        closed.add_floor([40.0, 60.0, 50.0]);
        assert_eq!(closed.text("the pitch"), "0.0 % of the pitch passes to the second look");
        closed.add_everything();
        assert!((0.1..0.5).contains(&closed.share()), "{}", closed.share());
    }

    #[test]
    fn a_box_without_hue_and_saturation_needs_no_second_look() {
        let mut plain = passing(|config| {
            open(config);
            (config.colors[0].hue_deg, config.colors[0].saturation) = (None, None);
        });
        plain.add_everything();
        assert_eq!(plain.share(), 0.0);
    }
}
