//! Sums over the samples in a band at the ball's rim, by sector and channel.
//!
//! Each sample gives a row of terms: the shares of background and shading in it, their derivatives by the
//! rim's offset and by the point spread function's size, and its value. The sums of the products of all terms
//! are all that the fit needs, so each pixel is read once in a pass.

use super::{HIDDEN, Pass, SECTORS};
use crate::ball::sphere::Outline;
use crate::edges::edge_pixels::{SPLINE_DEVIATIONS, spread};
use crate::edges::local_map::LocalMap;
use crate::raw::{CHANNELS, RawFrame};
use fearless_simd::{Level, dispatch};
use std::f64::consts::TAU;

/// Terms of a sample: shares of the background and of the four shades, derivatives by the rim's offset and by
/// the point spread function's size, value.
pub(super) const TERMS: usize = 8;
pub(super) const BACKGROUND: usize = 0;
pub(super) const SHADE: usize = 1;
pub(super) const SLOPE: usize = 5;
pub(super) const SOFTNESS: usize = 6;
pub(super) const VALUE: usize = 7;
/// Offset of grey levels that keeps sums of squares small, and so exact in single precision.
const MIDDLE_LEVEL: f32 = 96.0;
/// Distance outside the rim, in standard deviations of the point spread function, beyond which a sample shows
/// only background.
const OUTER: f32 = 2.0;
/// Fraction of a sector's inner pixels with the ball's colour from which the ball counts as visible there.
const SHOWN: f64 = 0.35;

/// Sums of the products of all terms.
pub(super) type Sums = [[f32; TERMS]; TERMS];

/// Accumulates the sums, reusing its memory.
#[derive(Debug, Clone)]
pub(super) struct RimSamples {
    level: Level,
    /// Indexed by sector, then by channel.
    sums: Box<[Sums; SECTORS * CHANNELS]>,
    /// Samples in each sector.
    pub counts: [f64; SECTORS],
    /// Outline units in a pixel, in each sector.
    pub per_px: [f32; SECTORS],
    /// Values of the samples that show only background, by channel.
    pub outer: [Vec<f32>; CHANNELS],
    /// Unit vectors to the middles of the sectors.
    pub directions: [[f64; 2]; SECTORS],
    roots: Box<[f32; ROOTS + 1]>,
}

impl RimSamples {
    pub fn new() -> Self {
        let step = TAU / SECTORS as f64;
        Self {
            level: Level::new(),
            sums: Box::new([[[0.0; TERMS]; TERMS]; SECTORS * CHANNELS]),
            counts: [0.0; SECTORS],
            per_px: [0.0; SECTORS],
            outer: std::array::from_fn(|_| Vec::with_capacity(256)),
            directions: std::array::from_fn(|sector| {
                let (sin, cos) = ((sector as f64 + 0.5) * step).sin_cos();
                [cos, sin]
            }),
            roots: Box::new(blurred_roots()),
        }
    }

    /// The sums of a sector and channel.
    pub fn sums(&self, sector: usize, channel: usize) -> &Sums {
        &self.sums[sector * CHANNELS + channel]
    }

    /// Adds up the samples of the band. Returns a weight for each sector: 1 if the ball's colour shows in its
    /// inner pixels, else [`HIDDEN`].
    pub fn sum_up(
        &mut self,
        frame: &RawFrame,
        map: &LocalMap,
        outline: &Outline,
        pass: &Pass,
        shows: Option<&impl Fn(usize, usize) -> bool>,
    ) -> [f64; SECTORS] {
        dispatch!(self.level, _simd => self.add_band(frame, map, outline, pass, shows))
    }

    /// The compiler makes vector instructions of the sums. The order of additions does not depend on their
    /// width.
    #[inline(always)]
    fn add_band(
        &mut self,
        frame: &RawFrame,
        map: &LocalMap,
        outline: &Outline,
        pass: &Pass,
        shows: Option<&impl Fn(usize, usize) -> bool>,
    ) -> [f64; SECTORS] {
        self.sums.fill([[0.0; TERMS]; TERMS]);
        self.outer.iter_mut().for_each(Vec::clear);
        self.counts = [0.0; SECTORS];
        let axes = [outline.long_mm as f32, outline.short_mm as f32];
        let per_px =
            self.directions.map(|[x, y]| map.slope([x as f32 / axes[0], y as f32 / axes[1]]));
        self.per_px = per_px;
        let widest = per_px.iter().copied().fold(0.0, f32::max);
        let (inner, outer) = (1.0 - pass.band_px * widest, 1.0 + pass.band_px * widest);
        let reach_px = map.most_px(f64::from(outer) * outline.long_mm);
        let (center_x, center_y) = (map.center.x_px, map.center.y_px);
        // The conversion to usize saturates negative numbers at 0.
        let rows = (center_y - reach_px).ceil() as usize
            ..(((center_y + reach_px).floor() + 1.0) as usize).min(frame.height);
        let (mut inside, mut shown) = ([0.0; SECTORS], [0.0; SECTORS]);
        for row in rows {
            let v = row as f64 - center_y;
            let half = (reach_px * reach_px - v * v).max(0.0).sqrt();
            let columns = (center_x - half).ceil() as usize
                ..(((center_x + half).floor() + 1.0) as usize).min(frame.width);
            let [[x0, x1, x2], [y0, y1, y2]] = map.row(v as f32);
            for column in columns {
                let u = (column as f64 - center_x) as f32;
                let x = (x0 + u * (x1 + u * x2)) / axes[0];
                let y = (y0 + u * (y1 + u * y2)) / axes[1];
                let rho = (x * x + y * y).sqrt();
                if rho < inner || rho > outer {
                    continue;
                }
                let sector = sector_of(x, y);
                let psf = per_px[sector] * pass.psf_px;
                let depth = (1.0 - rho) / psf;
                if depth.abs() * pass.psf_px > pass.band_px {
                    continue;
                }
                // Curvature: a straight edge that looks the same lies a little farther inside.
                let bent = depth - 0.5 * psf;
                let (w, density) = spread(bent / SPLINE_DEVIATIONS);
                let density = density / SPLINE_DEVIATIONS;
                let along = (rho * w - psf * density) / rho.max(0.1);
                let up = self.root(bent) * ((1.0 + rho) * psf).sqrt();
                let terms = [1.0 - w, w, along * x, along * y, up, density / psf, -bent * density];
                if let Some(shows) = shows
                    && bent > 1.0
                {
                    inside[sector] += 1.0;
                    shown[sector] += if shows(row, column) { 1.0 } else { 0.0 };
                }
                for index in 0..frame.samples_per_pixel {
                    let (channel, value) = frame.sample(row, column, index);
                    let value = value - MIDDLE_LEVEL;
                    let [a, b, c, d, e, f, g] = terms;
                    add(&mut self.sums[sector * CHANNELS + channel], [a, b, c, d, e, f, g, value]);
                    self.counts[sector] += 1.0;
                    if bent < -OUTER {
                        self.outer[channel].push(value);
                    }
                }
            }
        }
        let is_shown =
            |sector: usize| inside[sector] > 0.0 && shown[sector] >= SHOWN * inside[sector];
        let takes_all = shows.is_none() || !(0..SECTORS).any(is_shown);
        std::array::from_fn(|sector| if takes_all || is_shown(sector) { 1.0 } else { HIDDEN })
    }

    /// √max(depth, 0) convolved with the point spread function.
    #[inline(always)]
    fn root(&self, depth: f32) -> f32 {
        let place = ((depth + ROOTS_FROM) * ROOTS_PER_DEVIATION).max(0.0);
        let index = (place as usize).min(ROOTS - 1);
        let part = (place - index as f32).min(1.0);
        if place >= ROOTS as f32 {
            return depth.sqrt();
        }
        self.roots[index] + part * (self.roots[index + 1] - self.roots[index])
    }
}

#[inline(always)]
fn add(sums: &mut Sums, terms: [f32; TERMS]) {
    for (row, term) in sums.iter_mut().zip(terms) {
        for (sum, other) in row.iter_mut().zip(terms) {
            *sum += term * other;
        }
    }
}

/// Index of the sector of 22.5°, counted from x towards y, in which a direction lies.
#[inline(always)]
fn sector_of(x: f32, y: f32) -> usize {
    // tan 22.5°
    const HALF: f32 = 0.414_213_56;
    let (across, along) = (x.abs(), y.abs());
    let is_steep = along > across;
    let is_half = across.min(along) > HALF * across.max(along);
    let quarter = if is_steep { 3 - usize::from(is_half) } else { usize::from(is_half) };
    let half = if x < 0.0 { 7 - quarter } else { quarter };
    if y < 0.0 { 15 - half } else { half }
}

/// Table of [`RimSamples::root`]: entries, depth of the first one, entries in a standard deviation.
const ROOTS: usize = 96;
const ROOTS_FROM: f32 = 3.5;
const ROOTS_PER_DEVIATION: f32 = 12.0;

/// √max(depth, 0) convolved with the point spread function, by depth in its standard deviations.
fn blurred_roots() -> [f32; ROOTS + 1] {
    std::array::from_fn(|index| {
        let depth = index as f32 / ROOTS_PER_DEVIATION - ROOTS_FROM;
        const LOOKS: i32 = 200;
        let (mut sum, mut weights) = (0.0, 0.0);
        for look in -LOOKS..=LOOKS {
            let off = 3.5 * look as f32 / LOOKS as f32;
            let weight = spread(off / SPLINE_DEVIATIONS).1;
            sum += weight * (depth + off).max(0.0).sqrt();
            weights += weight;
        }
        sum / weights
    })
}
