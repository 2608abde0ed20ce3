//! Following the lamps: colours that were set under one light are recognised under another.
//!
//! Lamps and cameras' white balance change what everything looks like, the pitch included, and of
//! the pitch it is known what it looked like when the colours were set (`light.pitch_rgb`). So each
//! channel is multiplied with a gain that makes the pitch look as it did then (the diagonal model of
//! colour constancy, von Kries). Gains go into the tables, not to the pixels: a table entry for a
//! value is that for the corrected value. What it costs a frame is a look at some thousand places.
//!
//! The pitch is measured as medians over a lattice of places on the field: of the ratios red to green
//! and blue to green, weighted by brightness because dark pixels have hardly a colour, and of the
//! brightness itself. Robots, lines, people's arms and half a pitch in shadow do not move a median
//! far. How bright patches are follows the brightness of a dark, shiny floor only in part, so of that
//! only a part counts (`light.brightness`).
//!
//! Everything is in integers, in sixteenths of an octave, so that the same frame gives the same runs
//! on every machine; and gains have steps, so that noise does not change the tables with every frame.

use crate::picture::{BayerImage, Picture, narrowed};
use crate::yuv::rgb_from_yuv;
use common::config::{Config, LightConfig};
use common::geometry::{CameraModel, FieldPoint, GeometryError, ImagePoint};
use common::prefetch::prefetch;

/// Steps of gains, and of what is measured, in an octave; a step is 4.4 %.
const STEPS_PER_OCTAVE: i32 = 16;
/// What is measured is in so many parts of a step.
const PARTS: i64 = 16;
/// No gain is beyond 2.5 or below 0.4: what needs more is a broken camera or not a pitch.
const MOST_STEPS: i32 = 21;
/// About so many places are looked at.
const SITES: f64 = 3000.0;
/// Too few usable places: the pitch is dark, or the picture is of something else.
const FEWEST_SITES: u64 = 100;
/// Pixels with a channel above this are clipped, those with less green have no colour to speak of.
const CLIPPED: u8 = 250;
const DARK: u8 = 5;

/// What is true of each channel, in steps: red, green, blue.
pub type Gains = [i32; 3];

/// The gains that change nothing.
pub const NO_GAINS: Gains = [0; 3];

/// Where the pitch is looked at.
#[derive(Debug, Clone, PartialEq)]
pub struct PitchProbe {
    /// Column and row, both even: the places of whole Bayer patterns.
    sites: Vec<[u16; 2]>,
}

/// How the pitch looks: logarithms to the base 2, in [`PARTS`] of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct PitchLooks {
    red_to_green: i64,
    blue_to_green: i64,
    green: i64,
}

/// Knows how the pitch looked when the colours were set.
#[derive(Debug, Clone, PartialEq)]
pub struct Lamp {
    probe: PitchProbe,
    reference: PitchLooks,
    /// How much of a change in brightness counts, in 256ths.
    brightness: i64,
}

impl PitchProbe {
    /// Looks at the field, without what is around it.
    pub fn new(config: &Config) -> Result<Self, GeometryError> {
        let (width, height) = (config.camera.width, config.camera.height);
        let camera = CameraModel::new(&config.geometry, width, height)?;
        let step = (f64::from(width) * f64::from(height) / SITES).sqrt() / 2.0;
        let step = (step.round() as usize).max(1) * 2;
        let is_on_field = |place: FieldPoint| {
            place.x_mm.abs() < config.field.length_mm / 2.0
                && place.y_mm.abs() < config.field.width_mm / 2.0
        };
        let end = |size: u32| u16::try_from(size.saturating_sub(1)).unwrap_or(u16::MAX);
        let mut sites = Vec::new();
        for y in (0..end(height)).step_by(step) {
            for x in (0..end(width)).step_by(step) {
                let point = ImagePoint::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                if is_on_field(camera.field_from_image(point, 0.0)) {
                    sites.push([x, y]);
                }
            }
        }
        Ok(Self { sites })
    }

    /// The places themselves, row by row.
    pub(crate) fn into_sites(self) -> Vec<[u16; 2]> {
        self.sites
    }

    /// The colour of the pitch in a picture; `None` when it is too dark or too little is seen of it.
    pub fn measure(&self, picture: &Picture) -> Option<[f64; 3]> {
        let looks = self.looks(picture)?;
        let value =
            |parts: i64| (parts as f64 / (PARTS * i64::from(STEPS_PER_OCTAVE)) as f64).exp2();
        let green = value(looks.green);
        Some([green * value(looks.red_to_green), green, green * value(looks.blue_to_green)])
    }

    fn looks(&self, picture: &Picture) -> Option<PitchLooks> {
        let mut ratios = [[0u64; RATIO_BINS]; 2];
        let mut levels = [0u64; LEVEL_BINS];
        for_each_color(picture, &self.sites, |[red, green, blue]| {
            levels[LOG[usize::from(green)] as usize] += 1;
            if green <= DARK || red.max(green).max(blue) > CLIPPED {
                return;
            }
            for (bins, value) in ratios.iter_mut().zip([red, blue]) {
                let ratio = i32::from(LOG[usize::from(value)]) - i32::from(LOG[usize::from(green)]);
                bins[(ratio + RATIO_ZERO) as usize] += u64::from(green);
            }
        });
        let is_enough = ratios[0].iter().sum::<u64>() >= FEWEST_SITES * u64::from(DARK);
        is_enough.then_some(())?;
        Some(PitchLooks {
            red_to_green: median(&ratios[0])? - i64::from(RATIO_ZERO) * PARTS_PER_UNIT,
            blue_to_green: median(&ratios[1])? - i64::from(RATIO_ZERO) * PARTS_PER_UNIT,
            green: median(&levels)?,
        })
    }
}

impl Lamp {
    /// The configured light; `None` if the lamps are not to be followed.
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
            reference: PitchLooks { red_to_green: red - green, blue_to_green: blue - green, green },
            brightness: (brightness * 256.0).round() as i64,
        }))
    }

    /// The gains that make the picture's pitch look as it did when the colours were set; `None` if it
    /// cannot be seen.
    pub fn gains(&self, picture: &Picture) -> Option<Gains> {
        let looks = self.probe.looks(picture)?;
        let level = (self.reference.green - looks.green) * self.brightness / 256;
        let red = self.reference.red_to_green - looks.red_to_green + level;
        let blue = self.reference.blue_to_green - looks.blue_to_green + level;
        Some([red, level, blue].map(|parts| {
            let steps = (parts + PARTS / 2).div_euclid(PARTS) as i32;
            steps.clamp(-MOST_STEPS, MOST_STEPS)
        }))
    }
}

/// Whether a gain is as far from 1 as gains go.
pub fn is_at_bound(gains: Gains) -> bool {
    gains.iter().any(|steps| steps.abs() >= MOST_STEPS)
}

/// What a gain multiplies with.
pub fn factor(steps: i32) -> f32 {
    gain_of(steps) as f32 / 65536.0
}

/// The same, 16 bits behind the point, for gains from 1/8 to 16.
fn gain_of(steps: i32) -> u64 {
    let (octaves, rest) = (steps.div_euclid(STEPS_PER_OCTAVE), steps.rem_euclid(STEPS_PER_OCTAVE));
    SIXTEENTHS[rest as usize] << 3 >> (3 - octaves.clamp(-3, 3))
}

/// For each channel, what each value becomes.
pub fn corrections(gains: Gains) -> [[u8; 256]; 3] {
    gains.map(|steps| {
        let gain = gain_of(steps);
        let mut table = [0; 256];
        for (value, corrected) in (0u64..).zip(&mut table) {
            *corrected = ((value * gain + (1 << 15)) >> 16).min(255) as u8;
        }
        table
    })
}

/// 2^(i/16), 16 bits behind the point.
const SIXTEENTHS: [u64; 16] = [
    65536, 68438, 71468, 74632, 77936, 81386, 84990, 88752, 92682, 96785, 101070, 105545, 110218,
    115098, 120194, 125515,
];

/// Units of [`LOG`] in an octave.
pub(crate) const UNITS_PER_OCTAVE: i32 = 64;
/// Parts of a step in a unit.
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

/// The median of a histogram in [`PARTS`] of a step, in the middle of a bin when all lies in it.
/// `None` if it is empty.
fn median(bins: &[u64]) -> Option<i64> {
    let total: u64 = bins.iter().sum();
    let mut before = 0;
    for (bin, &count) in (0i64..).zip(bins) {
        if 2 * (before + count) >= total && count > 0 {
            let part = (total - 2 * before) * PARTS_PER_UNIT as u64 / (2 * count);
            return Some(bin * PARTS_PER_UNIT + part as i64 - PARTS_PER_UNIT / 2);
        }
        before += count;
    }
    None
}

/// The colours of places, one after the other, as [`rgb_at`] gives them. Quick where many of one row, or a
/// few, stand together.
pub(crate) fn for_each_color(picture: &Picture, sites: &[[u16; 2]], mut take: impl FnMut([u8; 3])) {
    let image = match picture {
        Picture::Bayer(image) if image.shift().is_none() => image,
        _ => {
            let color = |&[x, y]: &[u16; 2]| rgb_at(picture, usize::from(x), usize::from(y));
            return sites.iter().map(color).for_each(take);
        }
    };
    // All places begin the pattern at the same of its pixels.
    let channels = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(x, y)| image.order().channel_at(x, y));
    let [red, blue] =
        [0, 2].map(|channel| channels.iter().position(|&c| c == channel).unwrap_or(0));
    let is_green_first = channels[0] == 1;
    let mut rows = sites.chunk_by(|a, b| a[1] == b[1]).peekable();
    while let Some(row) = rows.next() {
        let y = usize::from(row[0][1]);
        let (upper, lower) = (image.row(y), image.row(y + 1));
        if let Some(next) = rows.peek() {
            let (y, end) = (usize::from(next[0][1]), usize::from(next[next.len() - 1][0]) + 2);
            for next_row in [y, y + 1] {
                prefetch(&image.row(next_row)[usize::from(next[0][0])..end]);
            }
        }
        for &[x, _] in row {
            let x = usize::from(x);
            let (a, b) = (&upper[x..x + 2], &lower[x..x + 2]);
            let pattern = [a[0], a[1], b[0], b[1]];
            let greens = if is_green_first { [a[0], b[1]] } else { [a[1], b[0]] };
            let green = (u16::from(greens[0]) + u16::from(greens[1])) / 2;
            take([pattern[red], green as u8, pattern[blue]]);
        }
    }
}

/// The colour of a place: of a Bayer picture, that of the four pixels from there on.
pub(crate) fn rgb_at(picture: &Picture, x: usize, y: usize) -> [u8; 3] {
    match picture {
        Picture::Bayer(image) => {
            let mut sums = [0u16; 3];
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let value = bayer_byte(image, x + dx, y + dy);
                sums[image.order().channel_at(x + dx, y + dy)] += u16::from(value);
            }
            [sums[0] as u8, (sums[1] / 2) as u8, sums[2] as u8]
        }
        Picture::Color(image) => {
            let color = image.row(y).pixel(x);
            if image.is_yuv() { rgb_from_yuv(color) } else { color }
        }
    }
}

fn bayer_byte(image: &BayerImage, x: usize, y: usize) -> u8 {
    let row = image.row(y);
    match image.shift() {
        None => row[x],
        Some(shift) => narrowed(row[2 * x], row[2 * x + 1], shift),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use common::messages::{BayerOrder, PixelFormat, PixelLayout};

    /// A pitch of one colour, with a part of it covered by another.
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

    fn picture<'a>(config: &Config, frame: &'a [u8]) -> Picture<'a> {
        let (width, height) = (config.camera.width, config.camera.height);
        let layout = PixelLayout { format: PixelFormat::Bayer8, order: config.camera.bayer_order };
        Picture::new(frame, width, height, width, layout).unwrap()
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
            let lamp = Lamp::new(&config).unwrap().unwrap();
            let gains =
                |pitch| lamp.gains(&picture(&config, &frame(&config, pitch, [0; 3], 0))).unwrap();
            assert_eq!(gains([60, 60, 48]), NO_GAINS);
            // An octave less red, an octave more blue.
            assert_eq!(gains([30, 60, 96]), [16, 0, -16]);
            assert_eq!(gains([120, 120, 96]), [-16, -16, -16]);
            let corrected = corrections(gains([45, 52, 70]));
            for (channel, (seen, expected)) in [(45u8, 60), (52, 60), (70, 48)].iter().enumerate() {
                let value = corrected[channel][usize::from(*seen)];
                assert!(value.abs_diff(*expected) <= 2, "{channel}: {value}, not {expected}");
            }
        }
    }

    #[test]
    fn many_colors_are_the_same_as_each() {
        for order in BayerOrder::ALL {
            let config = set_for([60.0, 60.0, 48.0], order);
            let frame: Vec<u8> =
                (0..640 * 480u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
            let picture = picture(&config, &frame);
            let mut sites = PitchProbe::new(&config).unwrap().into_sites();
            sites.extend([[0, 0], [638, 478], [638, 0], [0, 478]]);
            let mut found = Vec::new();
            for_each_color(&picture, &sites, |color| found.push(color));
            let each = sites.iter().map(|&[x, y]| rgb_at(&picture, x.into(), y.into()));
            assert!(found.len() > 1000 && each.eq(found), "{order:?}");
        }
    }

    #[test]
    fn brightness_counts_as_much_as_configured() {
        let mut config = set_for([60.0, 60.0, 48.0], BayerOrder::Rggb);
        for (brightness, steps) in [(0.0, 0), (0.5, 8), (1.0, 16)] {
            config.light.brightness = brightness;
            let lamp = Lamp::new(&config).unwrap().unwrap();
            let dark = frame(&config, [30, 30, 24], [0; 3], 0);
            assert_eq!(lamp.gains(&picture(&config, &dark)), Some([steps; 3]));
        }
    }

    #[test]
    fn an_arm_across_the_pitch_changes_little() {
        let config = set_for([60.0, 60.0, 48.0], BayerOrder::Rggb);
        let lamp = Lamp::new(&config).unwrap().unwrap();
        let arm = frame(&config, [60, 60, 48], [200, 40, 30], 90);
        let gains = lamp.gains(&picture(&config, &arm)).unwrap();
        assert!(gains.iter().all(|steps| steps.abs() <= 1), "{gains:?}");
    }

    #[test]
    fn what_is_no_pitch_gives_no_gains() {
        let config = set_for([60.0, 60.0, 48.0], BayerOrder::Rggb);
        let lamp = Lamp::new(&config).unwrap().unwrap();
        for color in [[0; 3], [3; 3], [255; 3]] {
            let gains = lamp.gains(&picture(&config, &frame(&config, color, [0; 3], 0)));
            assert_eq!(gains, None, "{color:?}");
        }
        let magenta = frame(&config, [250, 6, 250], [0; 3], 0);
        let strange = lamp.gains(&picture(&config, &magenta)).unwrap();
        assert!(strange.iter().all(|steps| steps.abs() <= MOST_STEPS), "{strange:?}");
        assert!(is_at_bound(strange) && !is_at_bound([20, -20, 0]), "{strange:?}");
        let of = |light| Lamp::new(&Config { light, ..Config::default() }).unwrap();
        let off = LightConfig { follow: false, ..config.light.clone() };
        assert!(of(config.light.clone()).is_some() && of(off).is_none());
        assert_eq!(of(LightConfig::default()), None);
    }

    #[test]
    fn logarithms_are_logarithms() {
        for (value, &log) in LOG.iter().enumerate().skip(1) {
            let exact = (value as f64).log2() * f64::from(UNITS_PER_OCTAVE);
            assert!((f64::from(log) - exact).abs() <= 0.51, "{value}: {log}, not {exact}");
        }
    }

    #[test]
    fn corrections_are_what_gains_say() {
        assert_eq!(corrections(NO_GAINS)[0].to_vec(), (0..=255).collect::<Vec<u8>>());
        for steps in -MOST_STEPS..=MOST_STEPS {
            let gain = (f64::from(steps) / 16.0).exp2();
            for (value, &corrected) in corrections([steps; 3])[2].iter().enumerate() {
                let exact = (value as f64 * gain).min(255.0);
                assert!((f64::from(corrected) - exact).abs() <= 0.52, "{steps}: {value}");
            }
        }
    }
}
