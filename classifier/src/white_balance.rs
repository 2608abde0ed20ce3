//! White balance from the pitch: colours that were set under one light are recognised under another.
//!
//! The estimate is the diagonal model of colour constancy (von Kries). Lamps and the camera's own white
//! balance scale each channel, and the colour of the pitch when the colours were set is known
//! (`light.pitch_rgb`), so each channel is multiplied with the gain that takes the pitch back to that colour.
//! The gains act on tables where a whole row has the same ones: the entry for a value is the one for the
//! corrected value. Where zones with different gains meet ([`shading`](crate::shading)), pixels are
//! corrected. Apart from that, a frame costs a look at some thousand places.
//!
//! The pitch is measured by medians over a lattice of places on the field, in logarithms: `r` of red / green
//! and `b` of blue / green, weighted by brightness because dark pixels have hardly a colour, and `g` of green.
//! Robots, lines, arms and half a pitch in shadow move a median little. With r₀, b₀, g₀ for the colour
//! `light.pitch_rgb`, the logarithms of the gains are
//!
//! ```text
//! green = share · (g₀ − g)     red = green + r₀ − r     blue = green + b₀ − b
//! ```
//!
//! The share (`light.brightness`) is below 1 where the brightness of patches follows that of a dark, shiny
//! floor only in part.
//!
//! All of it is computed in integers, in sixteenths of an octave, so the same frame gives the same runs on
//! every machine. Gains have steps so that noise does not change the tables with every frame.

use crate::lattice::{Grid, Lattice};
use config::{Config, LightConfig};
use geometry::{CameraModel, FieldPoint, GeometryError, ImagePoint};
use std::ops::Range;

/// Gain steps in an octave; a step is 4.4 %.
const STEPS_PER_OCTAVE: i32 = 16;
/// Resolution of measurements, parts per gain step.
const PARTS: i64 = 16;
/// Limit of a gain, steps: factors 0.4 to 2.5. A pitch that needs more is a broken camera or not a pitch.
const MAX_STEPS: i32 = 21;
/// Minimum usable places: with fewer, the pitch is dark or the picture shows something else.
const MIN_SITES: u32 = 100;
/// Pixels with a channel above this are clipped; pixels with less green than `DARK` have hardly a colour.
const CLIPPED: u8 = 250;
const DARK: u8 = 5;

/// Gain of each channel (red, green, blue), 1/16 octave.
pub type Gains = [i32; 3];

/// The gains that change nothing.
pub const NO_GAINS: Gains = [0; 3];

/// The lattice's places on the pitch.
#[derive(Debug, Clone, PartialEq)]
pub struct PitchProbe {
    /// Ranges of consecutive places.
    stretches: Vec<Range<usize>>,
}

/// Colour of the pitch: logarithms to the base 2, in [`PARTS`] of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct PitchColor {
    red_to_green: i64,
    blue_to_green: i64,
    green: i64,
}

/// Estimates gains from the pitch's colour, given its colour when the colours were set.
#[derive(Debug, Clone, PartialEq)]
pub struct WhiteBalance {
    probe: PitchProbe,
    reference: PitchColor,
    /// Share of a change in brightness that patches follow, 256ths.
    brightness: i64,
}

impl PitchProbe {
    /// Covers the field, without its surroundings.
    pub fn new(config: &Config) -> Result<Self, GeometryError> {
        let (width, height) = (config.camera.width, config.camera.height);
        let camera = CameraModel::new(&config.geometry, width, height)?;
        let is_on_field = |place: FieldPoint| {
            place.x_mm.abs() < config.field.length_mm / 2.0
                && place.y_mm.abs() < config.field.width_mm / 2.0
        };
        let mut stretches: Vec<Range<usize>> = Vec::new();
        for (index, [x, y]) in Grid::new(&config.camera).places().enumerate() {
            let point = ImagePoint::new(x as f64 + 0.5, y as f64 + 0.5);
            if is_on_field(camera.field_from_image(point, 0.0)) {
                match stretches.last_mut().filter(|last| last.end == index) {
                    Some(last) => last.end += 1,
                    None => stretches.push(index..index + 1),
                }
            }
        }
        Ok(Self { stretches })
    }

    /// Indices of the places, row by row.
    pub(crate) fn places(&self) -> impl Iterator<Item = usize> {
        self.stretches.iter().cloned().flatten()
    }

    /// Colour of the pitch in the picture that the lattice has sampled; `None` if it is too dark or too
    /// little of it is seen.
    pub fn measure(&self, lattice: &Lattice) -> Option<[f64; 3]> {
        let color = self.color(lattice)?;
        let value =
            |parts: i64| (parts as f64 / (PARTS * i64::from(STEPS_PER_OCTAVE)) as f64).exp2();
        let green = value(color.green);
        Some([green * value(color.red_to_green), green, green * value(color.blue_to_green)])
    }

    fn color(&self, lattice: &Lattice) -> Option<PitchColor> {
        let mut ratios = [[0u32; RATIO_BINS]; 2];
        let mut levels = [0u32; LEVEL_BINS];
        for stretch in &self.stretches {
            let [reds, greens, blues] = lattice.channels().map(|channel| &channel[stretch.clone()]);
            for ((&red, &green), &blue) in reds.iter().zip(greens).zip(blues) {
                let log = i32::from(LOG[usize::from(green)]);
                levels[log as usize] += 1;
                if green <= DARK || red.max(green).max(blue) > CLIPPED {
                    continue;
                }
                for (bins, value) in ratios.iter_mut().zip([red, blue]) {
                    let ratio = i32::from(LOG[usize::from(value)]) - log;
                    bins[(ratio + RATIO_ZERO) as usize] += u32::from(green);
                }
            }
        }
        let is_enough = ratios[0].iter().sum::<u32>() >= MIN_SITES * u32::from(DARK);
        is_enough.then_some(())?;
        Some(PitchColor {
            red_to_green: median(&ratios[0])? - i64::from(RATIO_ZERO) * PARTS_PER_UNIT,
            blue_to_green: median(&ratios[1])? - i64::from(RATIO_ZERO) * PARTS_PER_UNIT,
            green: median(&levels)?,
        })
    }
}

impl WhiteBalance {
    /// For the configured light; `None` if the lamps are not to be followed.
    pub fn new(config: &Config) -> Result<Option<Self>, GeometryError> {
        let LightConfig { follow: true, pitch_rgb: Some(rgb), brightness, .. } = config.light
        else {
            return Ok(None);
        };
        let parts = |value: f64| {
            let log = value.max(0.5).log2() * f64::from(STEPS_PER_OCTAVE);
            (log * PARTS as f64).round() as i64
        };
        let [red, green, blue] = rgb.map(parts);
        Ok(Some(Self {
            probe: PitchProbe::new(config)?,
            reference: PitchColor { red_to_green: red - green, blue_to_green: blue - green, green },
            brightness: (brightness * 256.0).round() as i64,
        }))
    }

    /// The gains that take the pitch, as the lattice has sampled it, back to its colour when the colours were
    /// set; `None` if it cannot be measured.
    pub fn gains(&self, lattice: &Lattice) -> Option<Gains> {
        let color = self.probe.color(lattice)?;
        let level = (self.reference.green - color.green) * self.brightness / 256;
        let red = self.reference.red_to_green - color.red_to_green + level;
        let blue = self.reference.blue_to_green - color.blue_to_green + level;
        Some([red, level, blue].map(|parts| {
            let steps = (parts + PARTS / 2).div_euclid(PARTS) as i32;
            steps.clamp(-MAX_STEPS, MAX_STEPS)
        }))
    }
}

/// Whether a gain is at its limit.
pub fn is_at_bound(gains: Gains) -> bool {
    gains.iter().any(|steps| steps.abs() >= MAX_STEPS)
}

/// The factor of a gain.
pub fn factor(steps: i32) -> f32 {
    gain_of(steps) as f32 / 65536.0
}

/// The factor in fixed point with 16 fractional bits, for gains from 1/8 to 16.
fn gain_of(steps: i32) -> u32 {
    let (octaves, rest) = (steps.div_euclid(STEPS_PER_OCTAVE), steps.rem_euclid(STEPS_PER_OCTAVE));
    SIXTEENTHS[rest as usize] << 3 >> (3 - octaves.clamp(-3, 3))
}

/// The factor in 256ths.
pub(crate) fn gain_in_256ths(steps: i32) -> u16 {
    ((gain_of(steps) + 128) >> 8) as u16
}

/// 2^(i/16) in fixed point with 16 fractional bits.
const SIXTEENTHS: [u32; 16] = [
    65536, 68438, 71468, 74632, 77936, 81386, 84990, 88752, 92682, 96785, 101070, 105545, 110218,
    115098, 120194, 125515,
];

/// Units of [`LOG`] in an octave.
pub(crate) const UNITS_PER_OCTAVE: i32 = 64;
/// Parts (1/[`PARTS`] step) per [`LOG`] unit.
const PARTS_PER_UNIT: i64 = PARTS * STEPS_PER_OCTAVE as i64 / UNITS_PER_OCTAVE as i64;

/// For each byte, its logarithm to the base 2 in units, rounded; 0 counts as 1.
pub(crate) const LOG: [u16; 256] = {
    let mut table = [0; 256];
    let mut value = 1;
    while value < 256 {
        // One bit of the logarithm after the other: squaring a number doubles its logarithm.
        let octave = (value as u64).ilog2();
        let mut mantissa = (value as u64) << (31 - octave);
        let mut log = octave as u16;
        let mut bit = 0;
        while bit < 7 {
            mantissa = (mantissa * mantissa) >> 31;
            log <<= 1;
            if mantissa >> 32 != 0 {
                mantissa >>= 1;
                log |= 1;
            }
            bit += 1;
        }
        table[value] = log.div_ceil(2);
        value += 1;
    }
    table
};
const LEVEL_BINS: usize = 8 * UNITS_PER_OCTAVE as usize + 1;
const RATIO_ZERO: i32 = LEVEL_BINS as i32 - 1;
const RATIO_BINS: usize = 2 * LEVEL_BINS - 1;

/// The median of a histogram in [`PARTS`] of a step, or the middle of the bin that holds everything. `None`
/// if the histogram is empty.
fn median(bins: &[u32]) -> Option<i64> {
    let total: u32 = bins.iter().sum();
    let mut before = 0;
    for (bin, &count) in (0i64..).zip(bins) {
        if 2 * (before + count) >= total && count > 0 {
            let part = i64::from(total - 2 * before) * PARTS_PER_UNIT / i64::from(2 * count);
            return Some(bin * PARTS_PER_UNIT + part - PARTS_PER_UNIT / 2);
        }
        before += count;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Correction, Picture};
    use messages::{BayerOrder, PixelFormat, PixelLayout};

    /// A pitch of one colour, part of it covered by another colour.
    fn frame(config: &Config, pitch: [u8; 3], cover: [u8; 3], covered_rows: usize) -> Vec<u8> {
        let width = config.camera.width as usize;
        let order = config.camera.bayer_order;
        (0..width * config.camera.height as usize)
            .map(|index| {
                let (x, y) = (index % width, index / width);
                let color = if y < covered_rows { cover } else { pitch };
                color[order.channel_at(x, y)]
            })
            .collect()
    }

    fn looked_at(config: &Config, frame: &[u8]) -> Lattice {
        let (width, height) = (config.camera.width, config.camera.height);
        let layout = PixelLayout { format: PixelFormat::Bayer8, order: config.camera.bayer_order };
        let mut lattice = Lattice::new(&config.camera);
        lattice.sample(&Picture::new(frame, width, height, width, layout).unwrap());
        lattice
    }

    fn set_for(pitch: [f64; 3], order: BayerOrder) -> Config {
        let mut config = Config::default();
        config.camera.bayer_order = order;
        config.light =
            LightConfig { pitch_rgb: Some(pitch), brightness: 1.0, ..LightConfig::default() };
        config
    }

    #[test]
    fn gains_bring_the_pitch_back() {
        for order in BayerOrder::ALL {
            let config = set_for([60.0, 60.0, 48.0], order);
            let white_balance = WhiteBalance::new(&config).unwrap().unwrap();
            let gains = |pitch| {
                white_balance.gains(&looked_at(&config, &frame(&config, pitch, [0; 3], 0))).unwrap()
            };
            assert_eq!(gains([60, 60, 48]), NO_GAINS);
            // An octave less red, an octave more blue.
            assert_eq!(gains([30, 60, 96]), [16, 0, -16]);
            assert_eq!(gains([120, 120, 96]), [-16, -16, -16]);
            let corrected = Correction::new(gains([45, 52, 70]), 0).tables();
            for (channel, (seen, expected)) in [(45u8, 60), (52, 60), (70, 48)].iter().enumerate() {
                let value = corrected[channel][usize::from(*seen)];
                assert!(value.abs_diff(*expected) <= 2, "{channel}: {value}, not {expected}");
            }
        }
    }

    #[test]
    fn gains_follow_brightness_by_the_configured_share() {
        let mut config = set_for([60.0, 60.0, 48.0], BayerOrder::Rggb);
        for (brightness, steps) in [(0.0, 0), (0.5, 8), (1.0, 16)] {
            config.light.brightness = brightness;
            let white_balance = WhiteBalance::new(&config).unwrap().unwrap();
            let dark = frame(&config, [30, 30, 24], [0; 3], 0);
            assert_eq!(white_balance.gains(&looked_at(&config, &dark)), Some([steps; 3]));
        }
    }

    #[test]
    fn an_arm_across_the_pitch_changes_little() {
        let config = set_for([60.0, 60.0, 48.0], BayerOrder::Rggb);
        let white_balance = WhiteBalance::new(&config).unwrap().unwrap();
        let arm = frame(&config, [60, 60, 48], [200, 40, 30], 90);
        let gains = white_balance.gains(&looked_at(&config, &arm)).unwrap();
        assert!(gains.iter().all(|steps| steps.abs() <= 1), "{gains:?}");
    }

    #[test]
    fn pictures_without_a_pitch_give_no_gains() {
        let config = set_for([60.0, 60.0, 48.0], BayerOrder::Rggb);
        let white_balance = WhiteBalance::new(&config).unwrap().unwrap();
        for color in [[0; 3], [3; 3], [255; 3]] {
            let gains = white_balance.gains(&looked_at(&config, &frame(&config, color, [0; 3], 0)));
            assert_eq!(gains, None, "{color:?}");
        }
        let magenta = frame(&config, [250, 6, 250], [0; 3], 0);
        let strange = white_balance.gains(&looked_at(&config, &magenta)).unwrap();
        assert!(strange.iter().all(|steps| steps.abs() <= MAX_STEPS), "{strange:?}");
        assert!(is_at_bound(strange) && !is_at_bound([20, -20, 0]), "{strange:?}");
        let of = |light| WhiteBalance::new(&Config { light, ..Config::default() }).unwrap();
        let off = LightConfig { follow: false, ..config.light.clone() };
        assert!(of(config.light.clone()).is_some() && of(off).is_none());
        assert_eq!(of(LightConfig::default()), None);
    }

    #[test]
    fn the_table_holds_rounded_logarithms() {
        for (value, &log) in LOG.iter().enumerate().skip(1) {
            let exact = (value as f64).log2() * f64::from(UNITS_PER_OCTAVE);
            assert!((f64::from(log) - exact).abs() <= 0.51, "{value}: {log}, not {exact}");
        }
    }
}
