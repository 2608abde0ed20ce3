//! From samples to bounds: boxes in red, green and blue, and sectors in hue and saturation, that
//! hold one colour each, leave out the others and the background, and have the widest margins.
//!
//! A pixel's class is that of the first colour all of whose ten bounds it meets, so what a bound is
//! worth can be told for every value it could have: moving it gives the pixels it passes to this
//! colour, or to whatever comes behind it. [`learn`] takes one bound after the other, adds up what
//! each sample would gain, smooths that over the distance by which colours wander (so that a bound
//! between two well separated colours ends up in the middle of the gap, where the two tails are
//! equal), and moves the bound to the best place; again and again, until nothing changes much
//! (coordinate ascent). Samples count by patch, not by pixel, and patches that are not recognised
//! well count more in the next round: of twenty well lit patches and a dark one, it is the dark one
//! that needs the bound.

use crate::samples::Samples;
use common::config::ColorConfig;

/// What is wanted of a set of colours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wishes {
    /// How far red, green and blue of a colour may wander beyond its samples, in grey levels …
    pub spread: f64,
    /// … its hue, in degrees …
    pub hue_spread_deg: f64,
    /// … and its saturation.
    pub saturation_spread: f64,
    /// What all pixels of a picture's background count against all samples of a colour, if they
    /// were taken for a colour.
    pub background_weight: f64,
    /// What all pixels at the rims of patches count, if they were taken for a colour that is not
    /// beside them.
    pub rim_weight: f64,
    /// Elsewhere on the pitch samples may be so many times as bright; and what each counts then,
    /// against 1 for what was seen.
    pub other_lights: [(f64, f64); 3],
}

impl Default for Wishes {
    fn default() -> Self {
        Self {
            spread: 6.0,
            hue_spread_deg: 5.0,
            saturation_spread: 0.03,
            background_weight: 5.0,
            rim_weight: 2.0,
            other_lights: [(0.5, 0.1), (0.75, 0.2), (1.25, 0.2)],
        }
    }
}

/// Why colours cannot be learned.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LearnError {
    /// Nothing shows a colour.
    #[error(
        "no pixel of the colour \"{0}\" is labelled; label robots that wear it, or add it to \"samples\""
    )]
    NoSamples(String),
}

/// Red, green, blue, hue, saturation.
const AXES: usize = 5;
const HUE: usize = 3;
const SATURATION: usize = 4;
/// Places a bound can have.
const BINS: usize = 256;
const ROUNDS: u32 = 8;

/// One colour's bounds, in bins: first and last, both included. Hue is measured from the middle of
/// the samples' hues, which lies in the middle of the bins.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Bounds {
    bins: [[i32; 2]; AXES],
    middle_hue_deg: f64,
}

/// A sample, or a colour of the background.
#[derive(Debug, Clone, Copy)]
struct Point {
    rgb: [u8; 3],
    hue_deg: f64,
    saturation: f64,
    /// `None` for background and rims.
    class: Option<u8>,
    /// Bit i: it does not matter if it is taken for class i.
    indifferent: u32,
    patch: u32,
    /// How many pixels there are of it; for a rim and for what a sample would be in another light,
    /// how much it counts.
    pixels: f64,
    /// A sample in another light, or a rim: neither is asked whether it is recognised.
    is_imagined: bool,
    weight: f64,
}

/// Learns bounds for the colours that `samples` show, and returns them in the order in which they
/// are to be looked at: most saturated first. Those of `colors` that are not `needed` and not shown
/// are left out; one that is needed and not shown is an error. Samples name colours by their place in
/// `colors`.
pub fn learn(
    colors: &[ColorConfig],
    is_needed: impl Fn(&ColorConfig) -> bool,
    samples: &Samples,
    wishes: &Wishes,
) -> Result<Vec<ColorConfig>, LearnError> {
    for (class, color) in colors.iter().enumerate() {
        let is_shown = samples.pixels.iter().any(|sample| usize::from(sample.class) == class);
        if is_needed(color) && !is_shown {
            return Err(LearnError::NoSamples(color.name.clone()));
        }
    }
    let mut learner = Learner::new(colors.len(), samples, wishes);
    for round in 0..ROUNDS {
        learner.improve(round);
    }
    let learned = learner.order.iter().filter_map(|&class| {
        let bounds = learner.bounds[class]?;
        Some(bounds.color(&colors[class], looks(samples, class as u8)))
    });
    Ok(learned.collect())
}

/// What a colour looks like: the median of each channel.
fn looks(samples: &Samples, class: u8) -> [u8; 3] {
    [0, 1, 2].map(|channel: usize| {
        let own = samples.pixels.iter().filter(|sample| sample.class == class);
        let mut values: Vec<f64> = own.map(|sample| f64::from(sample.rgb[channel])).collect();
        quantile(&mut values, 0.5) as u8
    })
}

struct Learner<'a> {
    wishes: &'a Wishes,
    points: Vec<Point>,
    patch_count: usize,
    /// By class; `None` without samples.
    bounds: Vec<Option<Bounds>>,
    /// Classes with samples, in the order in which they are looked at.
    order: Vec<usize>,
}

impl<'a> Learner<'a> {
    fn new(classes: usize, samples: &Samples, wishes: &'a Wishes) -> Self {
        let mut points: Vec<Point> = samples
            .pixels
            .iter()
            .map(|sample| Point::new(sample.rgb, Some(sample.class), sample.patch, 1.0))
            .collect();
        for (light, counts) in wishes.other_lights {
            let imagined = samples.pixels.iter().map(|sample| {
                let rgb = sample.rgb.map(|value| (f64::from(value) * light).min(255.0) as u8);
                let point = Point::new(rgb, Some(sample.class), sample.patch, counts);
                Point { is_imagined: true, ..point }
            });
            points.extend(imagined);
        }
        let rim_pixels = wishes.rim_weight / samples.rims.len().max(1) as f64;
        points.extend(samples.rims.iter().map(|rim| Point {
            indifferent: rim.beside,
            is_imagined: true,
            ..Point::new(rim.rgb, None, 0, rim_pixels)
        }));
        let background = samples.background.iter();
        points.extend(background.map(|&(rgb, pixels)| Point::new(rgb, None, 0, pixels)));
        let of_class = |class: usize| -> Vec<&Point> {
            let is_own = |point: &&Point| point.class == Some(class as u8) && !point.is_imagined;
            points.iter().filter(is_own).collect()
        };
        let bounds: Vec<Option<Bounds>> = (0..classes)
            .map(|class| {
                let own = of_class(class);
                (!own.is_empty()).then(|| Bounds::around(&own))
            })
            .collect();
        let saturation = |&class: &usize| {
            quantile(&mut of_class(class).iter().map(|p| p.saturation).collect::<Vec<_>>(), 0.5)
        };
        let mut order: Vec<usize> = (0..classes).filter(|&class| bounds[class].is_some()).collect();
        order.sort_by(|a, b| saturation(b).total_cmp(&saturation(a)));
        Self { wishes, points, patch_count: samples.patches as usize, bounds, order }
    }

    /// Moves every bound once or twice.
    fn improve(&mut self, round: u32) {
        self.weigh(round);
        for position in 0..self.order.len() {
            let gains = self.gains(position);
            for _ in 0..2 {
                for axis in 0..AXES {
                    for side in [Side::Low, Side::High] {
                        self.move_bound(self.order[position], axis, side, &gains);
                    }
                }
            }
        }
    }

    /// Sets the points' weights: each class 1 in all, shared among its patches by how badly they
    /// are recognised; the background little at first, since a colour that begins with too wide
    /// bounds must shrink, not vanish.
    fn weigh(&mut self, round: u32) {
        let (mut pixels, mut right) = (vec![0.0; self.patch_count], vec![0.0; self.patch_count]);
        let mut patches_of_class = vec![0.0; self.bounds.len()];
        let mut background = 0.0;
        for point in &self.points {
            if point.is_imagined {
                continue;
            }
            let Some(class) = point.class else {
                background += point.pixels;
                continue;
            };
            let patch = point.patch as usize;
            if pixels[patch] == 0.0 {
                patches_of_class[usize::from(class)] += 1.0;
            }
            pixels[patch] += 1.0;
            if self.class_behind(point, 0) == Some(class) {
                right[patch] += 1.0;
            }
        }
        let fade_in = (0.05 * 2f64.powi(round as i32)).min(1.0);
        let background_factor = self.wishes.background_weight * fade_in / f64::max(background, 1.0);
        for point in &mut self.points {
            let patch = point.patch as usize;
            point.weight = match point.class {
                Some(class) => {
                    let share = if round == 0 {
                        1.0f64
                    } else {
                        (1.6f64 - right[patch] / pixels[patch]).powi(2)
                    };
                    point.pixels * share / pixels[patch] / patches_of_class[usize::from(class)]
                }
                None if point.is_imagined => point.pixels,
                None => point.pixels * background_factor,
            };
        }
    }

    /// What a point is taken for by the colours from `position` of the order on.
    fn class_behind(&self, point: &Point, position: usize) -> Option<u8> {
        let admits = |class: &&usize| {
            self.bounds[**class].as_ref().is_some_and(|bounds| bounds.admit(point))
        };
        self.order[position..].iter().find(admits).map(|&class| class as u8)
    }

    /// For each point, what is gained if the colour at `position` takes it; 0 when an earlier one
    /// has it anyway.
    fn gains(&self, position: usize) -> Vec<f64> {
        let class = self.order[position] as u8;
        self.points
            .iter()
            .map(|point| {
                let is_taken = self.order[..position].iter().any(|&before| {
                    self.bounds[before].as_ref().is_some_and(|bounds| bounds.admit(point))
                });
                if is_taken {
                    return 0.0;
                }
                let otherwise = self.class_behind(point, position + 1);
                point.value(Some(class)) - point.value(otherwise)
            })
            .collect()
    }

    /// Moves one bound of a colour to where most is gained, all others staying where they are.
    fn move_bound(&mut self, class: usize, axis: usize, side: Side, gains: &[f64]) {
        let Some(bounds) = self.bounds[class] else { return };
        let spread_bins = match axis {
            HUE => self.wishes.hue_spread_deg / 360.0,
            SATURATION => self.wishes.saturation_spread,
            _ => self.wishes.spread / BINS as f64,
        } * BINS as f64;
        let mut free = bounds;
        free.bins[axis][side as usize] = side.end();
        let mut gain_at = [0.0; BINS];
        for (point, &gain) in self.points.iter().zip(gains) {
            if gain != 0.0 && free.admit(point) {
                gain_at[bounds.bin(point, axis) as usize] += gain;
            }
        }
        let best = best_bound(&gain_at, spread_bins, side);
        let other = bounds.bins[axis][1 - side as usize];
        let moved = match side {
            Side::Low => best.min(other),
            Side::High => best.max(other),
        };
        if let Some(bounds) = &mut self.bounds[class] {
            bounds.bins[axis][side as usize] = moved;
        }
    }
}

/// Which end of a range.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Side {
    Low = 0,
    High = 1,
}

impl Side {
    /// The bin that leaves nothing out.
    fn end(self) -> i32 {
        match self {
            Side::Low => 0,
            Side::High => BINS as i32 - 1,
        }
    }
}

/// The bin at which a bound gains most, when all that is beyond it is left out and every gain is
/// spread around its place, falling off exponentially.
fn best_bound(gain_at: &[f64; BINS], spread_bins: f64, side: Side) -> i32 {
    // Twice a one-sided exponential is a two-sided one, and takes two passes instead of a kernel.
    let keep = (-1.0 / spread_bins.max(1e-3)).exp();
    let mut smooth = [0.0; BINS];
    let mut carried = 0.0;
    for bin in 0..BINS {
        carried = carried * keep + gain_at[bin];
        smooth[bin] += carried;
    }
    carried = 0.0;
    for bin in (0..BINS).rev() {
        smooth[bin] += carried;
        carried = (carried + gain_at[bin]) * keep;
    }
    // What would be spread beyond the last bin stays in it.
    let tail = keep / (1.0 - keep);
    smooth[0] += gain_at.iter().rev().fold(0.0, |sum, gain| sum * keep + gain) * tail;
    smooth[BINS - 1] += gain_at.iter().fold(0.0, |sum, gain| sum * keep + gain) * tail;

    let (mut sum, mut best, mut best_sum) = (0.0, side.end(), f64::NEG_INFINITY);
    // From the end where nothing is admitted.
    for step in 0..BINS as i32 {
        let bin = match side {
            Side::Low => BINS as i32 - 1 - step,
            Side::High => step,
        };
        sum += smooth[bin as usize];
        // Of equals the widest, but for rounding.
        if sum > best_sum - 1e-12 {
            (best, best_sum) = (bin, best_sum.max(sum));
        }
    }
    best
}

impl Point {
    fn new(rgb: [u8; 3], class: Option<u8>, patch: u32, pixels: f64) -> Self {
        let [red, green, blue] = rgb.map(f64::from);
        let hue = (3f64.sqrt() * (green - blue)).atan2(2.0 * red - green - blue);
        let sum = red + green + blue;
        let saturation = if sum > 0.0 { 1.0 - 3.0 * red.min(green).min(blue) / sum } else { 0.0 };
        Self {
            rgb,
            hue_deg: hue.to_degrees(),
            saturation,
            class,
            indifferent: 0,
            patch,
            pixels,
            is_imagined: false,
            weight: 0.0,
        }
    }

    /// What it is worth to take the point for this.
    fn value(&self, class: Option<u8>) -> f64 {
        match (self.class, class) {
            (_, None) => 0.0,
            (Some(own), Some(class)) if own == class => self.weight,
            (None, Some(class)) if self.indifferent >> class & 1 == 1 => 0.0,
            _ => -self.weight,
        }
    }
}

impl Bounds {
    /// As narrow as a colour's own samples allow, but for a few.
    fn around(own: &[&Point]) -> Self {
        let direction = own.iter().fold([0.0, 0.0], |[x, y], point| {
            let (sin, cos) = point.hue_deg.to_radians().sin_cos();
            [x + point.saturation * cos, y + point.saturation * sin]
        });
        let middle_hue_deg = direction[1].atan2(direction[0]).to_degrees();
        let mut bounds = Self { bins: [[0, BINS as i32 - 1]; AXES], middle_hue_deg };
        for axis in 0..AXES {
            let mut bins: Vec<f64> =
                own.iter().map(|point| f64::from(bounds.bin(point, axis))).collect();
            bounds.bins[axis] = [0.01, 0.99].map(|part| quantile(&mut bins, part) as i32);
        }
        bounds
    }

    /// Where a point lies on an axis.
    fn bin(&self, point: &Point, axis: usize) -> i32 {
        let part = match axis {
            HUE => (point.hue_deg - self.middle_hue_deg + 180.0).rem_euclid(360.0) / 360.0,
            SATURATION => point.saturation,
            _ => return i32::from(point.rgb[axis]),
        };
        ((part * BINS as f64) as i32).clamp(0, BINS as i32 - 1)
    }

    fn admit(&self, point: &Point) -> bool {
        (0..AXES).all(|axis| {
            let [low, high] = self.bins[axis];
            (low..=high).contains(&self.bin(point, axis))
        })
    }

    /// The bounds as configured.
    fn color(&self, color: &ColorConfig, looks: [u8; 3]) -> ColorConfig {
        let range = |axis: usize| self.bins[axis].map(|bin| bin as u8);
        let last = BINS as i32 - 1;
        let edge = |bin: i32| f64::from(bin) / BINS as f64;
        let rounded = |value: f64, unit: f64| (value / unit).round() * unit;
        let [hue_low, hue_high] = self.bins[HUE];
        let hue = |bin: i32| {
            rounded((edge(bin) * 360.0 - 180.0 + self.middle_hue_deg).rem_euclid(360.0), 0.1)
        };
        let [saturation_low, saturation_high] = self.bins[SATURATION];
        let saturation = [edge(saturation_low), edge(saturation_high + 1)];
        ColorConfig {
            name: color.name.clone(),
            red: range(0),
            green: range(1),
            blue: range(2),
            hue_deg: (hue_low > 0 || hue_high < last).then(|| {
                [hue(hue_low), hue(hue_high + 1)].map(|degrees| (degrees * 10.0).round() / 10.0)
            }),
            saturation: (saturation_low > 0 || saturation_high < last)
                .then(|| saturation.map(|value| (value * 1000.0).round() / 1000.0)),
            looks,
            ..color.clone()
        }
    }
}

/// The value below which a part of them lies. Sorts them.
fn quantile(values: &mut [f64], part: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let index = (part * values.len() as f64) as usize;
    values.get(index.min(values.len().saturating_sub(1))).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::Sample;

    fn color(name: &str) -> ColorConfig {
        ColorConfig {
            name: name.into(),
            red: [0, 255],
            green: [0, 255],
            blue: [0, 255],
            hue_deg: None,
            saturation: None,
            y: None,
            u: None,
            v: None,
            looks: [0; 3],
        }
    }

    /// A few shades around each of these, each a patch of its own.
    fn samples(classes: &[&[[u8; 3]]], background: &[[u8; 3]]) -> Samples {
        let mut samples = Samples { pictures: 1, ..Samples::default() };
        for (class, patches) in (0u8..).zip(classes) {
            for &rgb in *patches {
                let patch = samples.patches;
                samples.patches += 1;
                samples.pixels.extend(shades(rgb).map(|rgb| Sample { rgb, class, patch }));
            }
        }
        samples.background =
            background.iter().flat_map(|&rgb| shades(rgb).map(|rgb| (rgb, 5000.0))).collect();
        samples
    }

    fn shades(rgb: [u8; 3]) -> impl Iterator<Item = [u8; 3]> {
        (0..27u8).map(move |index| {
            let shift = [index % 3, index / 3 % 3, index / 9];
            [0, 1, 2].map(|channel| rgb[channel].saturating_add(4 * shift[channel]).max(4) - 4)
        })
    }

    fn admits(color: &ColorConfig, rgb: [u8; 3]) -> bool {
        let point = Point::new(rgb, None, 0, 1.0);
        let within = |value: u8, [low, high]: [u8; 2]| (low..=high).contains(&value);
        let hue = point.hue_deg.rem_euclid(360.0);
        within(rgb[0], color.red)
            && within(rgb[1], color.green)
            && within(rgb[2], color.blue)
            && color.saturation.is_none_or(|[a, b]| (a..=b).contains(&point.saturation))
            && color.hue_deg.is_none_or(|[a, b]| {
                if a <= b { (a..=b).contains(&hue) } else { hue >= a || hue <= b }
            })
    }

    fn classify(colors: &[ColorConfig], rgb: [u8; 3]) -> Option<&str> {
        colors.iter().find(|color| admits(color, rgb)).map(|color| color.name.as_str())
    }

    const RED: [u8; 3] = [150, 40, 40];
    const VIOLET: [u8; 3] = [120, 60, 150];
    const GREEN: [u8; 3] = [50, 130, 60];
    const FLOOR: [u8; 3] = [60, 62, 58];

    fn learned() -> Vec<ColorConfig> {
        let colors = ["red", "violet", "green"].map(color);
        let dark = |rgb: [u8; 3]| rgb.map(|value| value / 2);
        let samples = samples(
            &[&[RED, dark(RED)], &[VIOLET, dark(VIOLET)], &[GREEN, dark(GREEN)]],
            &[FLOOR, [20, 20, 20], [200, 200, 200]],
        );
        learn(&colors, |_| true, &samples, &Wishes::default()).unwrap()
    }

    #[test]
    fn colors_are_told_apart_and_from_the_floor() {
        let colors = learned();
        for (rgb, name) in [(RED, "red"), (VIOLET, "violet"), (GREEN, "green")] {
            for part in [0.5, 0.75, 1.0, 1.15] {
                let shade = rgb.map(|value| (f64::from(value) * part) as u8);
                assert_eq!(classify(&colors, shade), Some(name), "{shade:?} {colors:#?}");
            }
        }
        for grey in [FLOOR, [20, 20, 20], [200, 200, 200], [120, 120, 120]] {
            assert_eq!(classify(&colors, grey), None, "{grey:?} {colors:#?}");
        }
    }

    #[test]
    fn margins_are_wide_and_even() {
        // The gap between red (0°) and violet (about 280°) belongs to both in equal parts.
        let colors = learned();
        let hue_of = |name: &str| {
            let color = colors.iter().find(|color| color.name == name).unwrap();
            color.hue_deg.unwrap_or_else(|| panic!("{colors:#?}"))
        };
        let bounds = [hue_of("red")[0], hue_of("violet")[1]];
        assert!(bounds.iter().any(|bound| (300.0..345.0).contains(bound)), "{bounds:?}");
    }

    #[test]
    fn what_nobody_showed_is_asked_for() {
        let colors = ["red", "blue"].map(color);
        let samples = samples(&[&[RED]], &[FLOOR]);
        let error = learn(&colors, |_| true, &samples, &Wishes::default()).unwrap_err();
        assert_eq!(error, LearnError::NoSamples("blue".into()));
        let colors = learn(&colors, |c| c.name == "red", &samples, &Wishes::default()).unwrap();
        assert_eq!(colors.len(), 1);
    }

    #[test]
    fn a_bound_lies_where_two_tails_are_equal() {
        let mut gains = [0.0; BINS];
        gains[100] = 1.0;
        gains[140] = -1.0;
        let bound = best_bound(&gains, 6.0, Side::High);
        assert!((118..=121).contains(&bound), "{bound}");
        assert_eq!(best_bound(&gains, 6.0, Side::Low), 0);
        (gains[60], gains[140]) = (-1.0, 0.0);
        let bound = best_bound(&gains, 6.0, Side::Low);
        assert!((79..=82).contains(&bound), "{bound}");
    }
}
