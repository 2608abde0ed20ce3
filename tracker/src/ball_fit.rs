//! The ball's place to hundredths of a pixel: a circle of known size, fitted to as much of its rim as is
//! seen in the raw picture.
//!
//! # The model
//!
//! A ball is no patch: it is round, so light from one side leaves its other side dark, and it stands on the
//! floor, so lines, its own shadow, walls and robots lie beside different parts of its rim, and robots hide
//! some of it. With ρ the distance from the middle of the [outline](crate::sphere) in units of its half axes
//! and φ the direction, a sample of channel c measures
//!
//! I = a + w·b₀ + X·(b₁ cos φ + b₂ sin φ) + Z·b₃,
//!
//! where w, X and Z are what the camera's spot makes of 1, ρ and √(1 − ρ²) within the outline: a constant and
//! the three components of the surface's normal, which is how a dull ball looks under any number of lamps
//! (Lambert's law). b is one for the ball, for each channel. a, what lies beside it, is for each channel one
//! in each of sixteen sectors of the rim; where a sector has too few samples to tell, it is like the others,
//! by as much as the others are like each other.
//!
//! # The fit
//!
//! All samples within a band at the rim are summed up once by sector and channel. Then, sector by sector: how
//! far out does the rim lie, and how sure is that? Sectors in which something hides the ball explain their
//! samples badly and say little. A circle is laid through the rest: two coordinates, and a radius that is
//! known but for a small part of a pixel. Sectors off that circle count less (iteratively reweighted, with the
//! weights of Cauchy's distribution). The normal equations say how sure the place is: where half of the rim
//! is hidden, less along the line that joins the halves.

use crate::edge_pixels::{SPLINE_DEVIATIONS, SPOT_PX, spread};
use crate::linear::{inverse, times};
use crate::local_map::{LocalMap, mm_per_px};
use crate::raw::{CHANNELS, RawFrame};
use crate::sphere::{Outline, Sphere};
use common::geometry::{CameraModel, FieldPoint, Pose};
use std::f64::consts::TAU;

/// Parts of the rim.
pub(crate) const SECTORS: usize = 16;
/// How the rim is looked at, round by round: first softly, since a rim that is two pixels off shows only in a
/// slope that reaches so far, and with the same beside the ball all around; at last as the camera shows it, each
/// sector by itself.
const SOFT: Focus = Focus { spot_px: 1.3, band_px: 4.0, model_noise: 0.12, is_free: false };
const SHARP: Focus = Focus { spot_px: SPOT_PX, band_px: 2.6, model_noise: 0.08, is_free: false };
const FREE: Focus = Focus { model_noise: 0.04, is_free: true, ..SHARP };
const APPROACH: [Focus; 4] = [SOFT, SOFT, SHARP, SHARP];
/// Sigma of the start below which the fit needs no softened first pass.
const SURE_PX: f64 = 0.7;
/// Terms of a sample: a's and b's shares, by how much they change where the rim lies farther out and where the
/// spot is larger, and the value.
const TERMS: usize = 8;
const BESIDE: usize = 0;
const SHADE: usize = 1;
const SLOPE: usize = 5;
const SOFTNESS: usize = 6;
const VALUE: usize = 7;
/// Without a's.
const LEFT: usize = TERMS - 1;
/// b has so many.
const SHADES: usize = 4;
/// Grey levels are counted from here, so that sums of squares stay small.
const MIDDLE_LEVEL: f32 = 96.0;
/// Noise of a sample, in grey levels.
const SAMPLE_NOISE: f64 = 2.0;
/// By how much b₁, b₂ and b₃ may be other than 0, and a other than its neighbours even where these are all
/// alike, 1σ in grey levels.
const SHADE_SPREAD: f64 = 80.0;
const BESIDE_SPREAD: f64 = 4.0;
/// By how much the ball may be brighter or darker in a sector than its shades say, 1σ as a part of the contrast:
/// its own shadow has an edge, lamps are mirrored, balls are dirty.
const SHADE_NOISE: f64 = 0.08;
/// The spot may be larger or smaller than it is taken to be, 1σ as a part of it, for lenses are out of focus and
/// balls move; and it is somewhere between these.
const SPOT_NOISE: f64 = 0.3;
const SPOTS_PX: [f32; 2] = [0.42, 1.4];
/// A rim whose contrast is less than this part of the greatest says less: what shows there may be the border of
/// the ball's own shade, which lies within the rim.
const DIM: f64 = 0.5;
/// What the rim in a sector may be off by, and the radius of the whole: spots and balls are not all alike.
const SECTOR_NOISE_PX: f64 = 0.05;
const RADIUS_NOISE_PX: f64 = 0.25;
/// From about this far off the circle a sector is not believed; in a poor picture, of which half the sectors
/// are farther off, from so far as those, but never beyond the second.
const OUTLIER_PX: f64 = 0.12;
const MOST_OUTLIER_PX: f64 = 0.6;
/// Samples so far outside, in deviations of the spot, show nothing of the ball.
const OUTER: f32 = 2.0;
/// Weight of a sector in which the ball does not seem to show.
const HIDDEN: f64 = 1e-3;
/// Part of a sector's inner pixels that are of the ball's colour if it is seen there.
const SHOWN: f64 = 0.35;
/// Samples that a sector must have.
const MIN_SAMPLES: f64 = 5.0;
/// Rounds over the pixels, and of weighing the sectors in each.
const MAX_ROUNDS: usize = 4;
const WEIGHINGS: usize = 4;
/// A round that moves the ball by less was the last.
const SETTLED_PX: f64 = 0.1;
/// A place that is less sure than this, 1σ in its worst direction, has not been measured.
const MOST_UNSURE_PX: f64 = 0.5;

/// How the rim is looked at.
#[derive(Debug, Clone, Copy)]
struct Focus {
    /// Standard deviation of the spot.
    spot_px: f32,
    /// The band reaches so far to each side of the rim.
    band_px: f32,
    /// Noise of a sample as a part of the contrast at the rim.
    model_noise: f64,
    /// Whether sectors may differ in more than where the rim lies.
    is_free: bool,
}

/// Where the fit begins.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Start {
    pub position: FieldPoint,
    /// How far off that may be, 1σ.
    pub deviation_mm: f64,
    /// A result farther away is of something else.
    pub reach_mm: f64,
}

/// A place with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Fitted {
    pub position: FieldPoint,
    /// xx, xy, yy in mm².
    pub covariance: [f64; 3],
    /// Samples at the rim that took part.
    pub samples: u32,
}

type Sums = [[f32; TERMS]; TERMS];

/// Fits circles to rims.
#[derive(Debug, Clone)]
pub(crate) struct BallFitter {
    sphere: Sphere,
    /// Indexed by sector, then by channel.
    sums: Box<[Sums; SECTORS * CHANNELS]>,
    /// Samples in each sector.
    counts: [f64; SECTORS],
    rim: [Sector; SECTORS],
    /// Samples well outside of the ball, by channel.
    outer: [Vec<f32>; CHANNELS],
    off: Vec<f32>,
    /// √ of a ramp behind the camera's spot, by depth in deviations of the spot.
    roots: Box<[f32; ROOTS + 1]>,
    directions: [[f64; 2]; SECTORS],
}

/// Measurement of one sector.
#[derive(Debug, Clone, Copy, Default)]
struct Sector {
    /// How far the rim lies outside of the outline, in units of its half axes.
    out: f64,
    information: f64,
    samples: f64,
    /// Between the ball and what is beside it, in grey levels.
    contrast: f64,
    /// 1 where the ball explains the samples as well as it should, less where it does not.
    trust: f64,
    /// Outline units in a pixel.
    per_px: f64,
}

/// A step towards the rim, in units of the half axes.
#[derive(Debug, Clone, Copy)]
struct Step {
    by: [f64; 2],
    /// Relative excess of the spot's true size over the assumed one.
    softer: f64,
    /// xx, xy, yy.
    covariance: [f64; 3],
    samples: f64,
}

impl BallFitter {
    pub fn new(sphere: Sphere) -> Self {
        let step = TAU / SECTORS as f64;
        Self {
            sphere,
            sums: Box::new([[[0.0; TERMS]; TERMS]; SECTORS * CHANNELS]),
            counts: [0.0; SECTORS],
            rim: [Sector::default(); SECTORS],
            outer: std::array::from_fn(|_| Vec::with_capacity(256)),
            off: Vec::with_capacity(256),
            roots: Box::new(blurred_roots()),
            directions: std::array::from_fn(|sector| {
                let (sin, cos) = ((sector as f64 + 0.5) * step).sin_cos();
                [cos, sin]
            }),
        }
    }

    /// The place near `start` that explains the rim in the picture best; `None` if there is too little of it,
    /// or it leads somewhere else. `shows` says whether the ball's colour was seen at a pixel; without it all
    /// of the ball is taken to be seen at first.
    pub fn fit(
        &mut self,
        camera: &CameraModel,
        frame: &RawFrame,
        start: &Start,
        shows: Option<impl Fn(usize, usize) -> bool>,
    ) -> Option<Fitted> {
        let mut position = start.position;
        let mut spot_px = FREE.spot_px;
        let scale = mm_per_px(camera, position, self.sphere.radius_mm);
        let approach: &[Focus] = if start.deviation_mm > SURE_PX * scale { &APPROACH } else { &[] };
        let last = approach.len() + MAX_ROUNDS - 1;
        for round in 0..=last {
            let mut focus = *approach.get(round).unwrap_or(&FREE);
            if focus.is_free {
                focus.spot_px = spot_px;
            }
            let focus = &focus;
            let outline = self.sphere.outline(position);
            let (sin, cos) = outline.direction.sin_cos();
            let middle = FieldPoint::new(
                position.x_mm + cos * outline.beyond_mm,
                position.y_mm + sin * outline.beyond_mm,
            );
            let pose = Pose { position: middle, orientation: outline.direction };
            let axes = [outline.long_mm, outline.short_mm];
            let nominal = mm_per_px(camera, middle, self.sphere.radius_mm);
            let height_mm = self.sphere.radius_mm;
            let map = LocalMap::new(camera, &pose, height_mm, axes[0], nominal)?;
            let shown = self.sum_up(frame, &map, &outline, focus, shows.as_ref());
            let so_far = [start.position.x_mm - position.x_mm, start.position.y_mm - position.y_mm];
            let so_far = [
                (cos * so_far[0] + sin * so_far[1]) / axes[0],
                (cos * so_far[1] - sin * so_far[0]) / axes[1],
            ];
            let prior = axes.map(|axis| (axis / start.deviation_mm).powi(2));
            let Step { by: step, softer, covariance, samples } =
                self.solve(&prior, so_far, &shown, focus)?;
            let [x, y] = [step[0] * axes[0], step[1] * axes[1]];
            position = FieldPoint::new(
                position.x_mm + cos * x - sin * y,
                position.y_mm + sin * x + cos * y,
            );
            if approach.get(round).is_none_or(|focus| focus.spot_px <= SPOT_PX) {
                let larger = 1.0 + softer.clamp(-0.25, 0.4) as f32;
                spot_px = (focus.spot_px * larger).clamp(SPOTS_PX[0], SPOTS_PX[1]);
            }
            let off_mm = position.distance(start.position);
            if off_mm.is_nan() || off_mm > start.reach_mm {
                return None;
            }
            let is_settled = x.hypot(y) < SETTLED_PX * nominal && focus.is_free;
            if is_settled || round == last {
                let [xx, xy, yy] = covariance;
                let [xx, xy, yy] =
                    [xx * axes[0] * axes[0], xy * axes[0] * axes[1], yy * axes[1] * axes[1]];
                let most = (xx + yy) / 2.0 + ((xx - yy) / 2.0).hypot(xy);
                if most > (MOST_UNSURE_PX * nominal).powi(2) {
                    return None;
                }
                let covariance = [
                    cos * cos * xx - 2.0 * sin * cos * xy + sin * sin * yy,
                    sin * cos * (xx - yy) + (cos * cos - sin * sin) * xy,
                    sin * sin * xx + 2.0 * sin * cos * xy + cos * cos * yy,
                ];
                return Some(Fitted { position, covariance, samples: samples as u32 });
            }
        }
        None
    }

    /// Adds up the samples of the band, and says for each sector how much of the ball shows there.
    fn sum_up(
        &mut self,
        frame: &RawFrame,
        map: &LocalMap,
        outline: &Outline,
        focus: &Focus,
        shows: Option<&impl Fn(usize, usize) -> bool>,
    ) -> [f64; SECTORS] {
        self.sums.fill([[0.0; TERMS]; TERMS]);
        self.outer.iter_mut().for_each(Vec::clear);
        self.counts = [0.0; SECTORS];
        let axes = [outline.long_mm as f32, outline.short_mm as f32];
        let mut per_px = [0.0; SECTORS];
        for ((per_px, direction), sector) in
            per_px.iter_mut().zip(&self.directions).zip(&mut self.rim)
        {
            let slope = map.slope([direction[0] as f32 / axes[0], direction[1] as f32 / axes[1]]);
            *per_px = slope;
            sector.per_px = f64::from(slope);
        }
        let widest = per_px.iter().copied().fold(0.0, f32::max);
        let (inner, outer) = (1.0 - focus.band_px * widest, 1.0 + focus.band_px * widest);
        let reach_px = map.most_px(f64::from(outer) * outline.long_mm);
        let (center_x, center_y) = (map.center.x_px, map.center.y_px);
        // Conversion brings negative numbers to 0.
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
                let spot = per_px[sector] * focus.spot_px;
                let depth = (1.0 - rho) / spot;
                if depth.abs() * focus.spot_px > focus.band_px {
                    continue;
                }
                // A rim that is bent lies a little inside of where a straight one would look the same.
                let bent = depth - 0.5 * spot;
                let (w, density) = spread(bent / SPLINE_DEVIATIONS);
                let density = density / SPLINE_DEVIATIONS;
                let along = (rho * w - spot * density) / rho.max(0.1);
                let up = self.root(bent) * ((1.0 + rho) * spot).sqrt();
                let terms = [1.0 - w, w, along * x, along * y, up, density / spot, -bent * density];
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

    fn root(&self, depth: f32) -> f32 {
        let place = ((depth + ROOTS_FROM) * ROOTS_PER_DEVIATION).max(0.0);
        let index = (place as usize).min(ROOTS - 1);
        let part = (place - index as f32).min(1.0);
        if place >= ROOTS as f32 {
            return depth.sqrt();
        }
        self.roots[index] + part * (self.roots[index + 1] - self.roots[index])
    }

    /// The step that fits the sectors that agree.
    fn solve(
        &mut self,
        prior: &[f64; 2],
        so_far: [f64; 2],
        shown: &[f64; SECTORS],
        focus: &Focus,
    ) -> Option<Step> {
        let mut weights = *shown;
        let mut weighings = 0;
        loop {
            let softer = self.measure_rim(&weights, focus)?;
            let per_px = self.rim.iter().map(|sector| sector.per_px).sum::<f64>() / SECTORS as f64;
            let radius = (RADIUS_NOISE_PX * per_px).powi(-2);
            let (mut step, mut off_px) = ([0.0; 3], [0.0; SECTORS]);
            let mut covariance = [0.0; 6];
            let mut robust = [1.0; SECTORS];
            let (mut worth, mut samples, mut squares) = (0.0, 0.0, 0.0);
            for _ in 0..3 {
                let mut information = [prior[0], 0.0, 0.0, prior[1], 0.0, radius];
                let mut pull = [prior[0] * so_far[0], prior[1] * so_far[1], 0.0];
                (worth, samples, squares) = (0.0, 0.0, 0.0);
                for (index, sector) in self.rim.iter().enumerate() {
                    let [cos, sin] = self.directions[index];
                    let noise = (SECTOR_NOISE_PX * sector.per_px).powi(2);
                    let weight = shown[index] * robust[index] * sector.information
                        / (1.0 + noise * sector.information);
                    let terms = [cos * cos, cos * sin, cos, sin * sin, sin, 1.0];
                    information.iter_mut().zip(terms).for_each(|(sum, it)| *sum += weight * it);
                    let terms = [cos, sin, 1.0];
                    pull.iter_mut()
                        .zip(terms)
                        .for_each(|(sum, it)| *sum += weight * it * sector.out);
                    worth += weight * noise;
                    squares += weight * (off_px[index] * sector.per_px).powi(2);
                    if robust[index] > 0.5 && weight * noise > 0.2 {
                        samples += sector.samples;
                    }
                }
                covariance = inverse(&information)?;
                step = times(&covariance, &pull);
                for ((off_px, sector), [cos, sin]) in
                    off_px.iter_mut().zip(&self.rim).zip(self.directions)
                {
                    let expected = cos * step[0] + sin * step[1] + step[2];
                    *off_px = (sector.out - expected) / sector.per_px;
                }
                let outlier = self.typical_px(&off_px).clamp(OUTLIER_PX, MOST_OUTLIER_PX);
                for (robust, off_px) in robust.iter_mut().zip(off_px) {
                    *robust = 1.0 / (1.0 + (off_px / outlier).powi(2));
                }
            }
            weighings += 1;
            if weighings == WEIGHINGS {
                let disagreement = (squares / worth.max(1.0)).max(1.0);
                let [xx, xy, _, yy, _, _] = covariance.map(|term| term * disagreement);
                return Some(Step {
                    by: [step[0], step[1]],
                    softer,
                    covariance: [xx, xy, yy],
                    samples,
                });
            }
            for (index, weight) in weights.iter_mut().enumerate() {
                *weight = (shown[index] * robust[index] * self.rim[index].trust).max(HIDDEN);
            }
        }
    }

    /// Median residual of the usable sectors.
    fn typical_px(&self, off_px: &[f64; SECTORS]) -> f64 {
        let mut seen = [0.0; SECTORS];
        let mut count = 0;
        for (sector, off_px) in self.rim.iter().zip(off_px) {
            if sector.information * (SECTOR_NOISE_PX * sector.per_px).powi(2) > 0.2 {
                seen[count] = off_px.abs();
                count += 1;
            }
        }
        match &mut seen[..count] {
            [] => 0.0,
            seen => *seen.select_nth_unstable_by(count / 2, f64::total_cmp).1,
        }
    }

    /// How far out the rim lies in each sector, the ball's shades being taken from sectors by their weights.
    fn measure_rim(&mut self, weights: &[f64; SECTORS], focus: &Focus) -> Option<f64> {
        let mut blocks = [[Block::default(); CHANNELS]; SECTORS];
        let mut shades = [[0.0; SHADES]; CHANNELS];
        for (channel, shades) in shades.iter_mut().enumerate() {
            let (level, variance) = self.beside(channel, focus);
            let mut normal = [[0.0; SHADES + 1]; SHADES];
            for (row, term) in normal.iter_mut().enumerate() {
                term[row] = if row == 0 { 1e-6 } else { (SAMPLE_NOISE / SHADE_SPREAD).powi(2) };
            }
            for (sector, weight) in weights.iter().enumerate() {
                let sums = &self.sums[sector * CHANNELS + channel];
                let block = &mut blocks[sector][channel];
                *block = Block::new(sums, level, SAMPLE_NOISE.powi(2) / variance);
                block.add_to(&mut normal, *weight);
            }
            *shades = solve(normal)?;
        }
        let mut softer = [0.0, SPOT_NOISE.powi(-2)];
        for (sector, by_channel) in blocks.iter().enumerate() {
            let direction = self.directions[sector];
            let rim = &mut self.rim[sector];
            rim.samples = self.counts[sector];
            let (mut pull, mut information, mut squares, mut greatest) = (0.0, 0.0, 0.0, 0.0f64);
            let (mut softness, mut hardness) = (0.0, 0.0);
            for (block, shades) in by_channel.iter().zip(&shades) {
                let at_rim = shades[0] + direction[0] * shades[1] + direction[1] * shades[2];
                let contrast = at_rim - block.level(shades);
                let [ee, er, rr, hh, hr] = block.rim(shades, contrast, focus);
                softness += contrast * hr;
                hardness += contrast * contrast * hh;
                pull += contrast * er;
                information += contrast * contrast * ee;
                squares += rr;
                greatest = greatest.max(contrast.abs());
            }
            if rim.samples < MIN_SAMPLES || information < 1e-9 {
                *rim = Sector { per_px: rim.per_px, samples: rim.samples, ..Sector::default() };
                continue;
            }
            rim.out = pull / information;
            let least = SAMPLE_NOISE.powi(2) + (focus.model_noise * greatest).powi(2);
            let left = (squares - pull * rim.out) / (rim.samples - 4.0).max(1.0);
            rim.information = information / left.max(least);
            rim.trust = least / left.max(least);
            rim.contrast = greatest;
            let weight = weights[sector] / left.max(least);
            softer[0] += weight * softness;
            softer[1] += weight * hardness;
        }
        let most = self.rim.iter().zip(weights).filter(|(_, weight)| **weight > 0.1);
        let most = most.map(|(rim, _)| rim.contrast).fold(0.0, f64::max);
        for rim in &mut self.rim {
            rim.information *= (rim.contrast / (DIM * most)).min(1.0).powi(4);
        }
        Some(softer[0] / softer[1])
    }

    /// Level of what lies beside the ball, over all of the rim, and its variance; of most of it, if what is
    /// elsewhere is not to count.
    fn beside(&mut self, channel: usize, focus: &Focus) -> (f64, f64) {
        let outer = &mut self.outer[channel];
        let Some(middle) = outer.len().checked_sub(1).map(|last| last / 2) else {
            return (0.0, SHADE_SPREAD.powi(2));
        };
        let (level, variance) = if focus.is_free {
            let count = outer.len() as f64;
            let mean = outer.iter().map(|&value| f64::from(value)).sum::<f64>() / count;
            let squares = outer.iter().map(|&value| (f64::from(value) - mean).powi(2));
            (mean, squares.sum::<f64>() / count)
        } else {
            let level = *outer.select_nth_unstable_by(middle, f32::total_cmp).1;
            self.off.clear();
            self.off.extend(outer.iter().map(|value| (value - level).abs()));
            let off = *self.off.select_nth_unstable_by(middle, f32::total_cmp).1;
            (f64::from(level), (1.5 * f64::from(off)).powi(2))
        };
        (level, variance + BESIDE_SPREAD.powi(2))
    }
}

/// Sums of a sector and channel, without what a free level beside the ball explains of them.
#[derive(Debug, Clone, Copy, Default)]
struct Block {
    sums: [[f64; LEFT]; LEFT],
    /// The level is that of the value − those of the shades · shades.
    levels: [f64; LEFT],
}

impl Block {
    /// The level is taken to be about `level`, as if so many samples had said so.
    fn new(sums: &Sums, level: f64, samples: f64) -> Self {
        let f = |row: usize, column: usize| f64::from(sums[row][column]);
        let own = f(BESIDE, BESIDE) + samples;
        let mut shares: [f64; LEFT] = std::array::from_fn(|index| f(BESIDE, index + 1));
        shares[VALUE - 1] += samples * level;
        let mut left = [[0.0; LEFT]; LEFT];
        for (row, left) in left.iter_mut().enumerate() {
            for (column, left) in left.iter_mut().enumerate() {
                *left = f(row + 1, column + 1) - shares[row] * shares[column] / own;
            }
        }
        left[VALUE - 1][VALUE - 1] += samples * level * level;
        Self { sums: left, levels: shares.map(|share| share / own) }
    }

    /// Adds what it says of the shades to normal equations, wherever the rim may lie in it.
    fn add_to(&self, normal: &mut [[f64; SHADES + 1]; SHADES], weight: f64) {
        let mut left = self.sums;
        eliminate(&mut left, SLOPE - 1, 1e-3);
        for (normal, left) in normal.iter_mut().zip(&left) {
            for (normal, left) in normal.iter_mut().zip(&left[..SHADES]) {
                *normal += weight * left;
            }
            normal[SHADES] += weight * left[VALUE - 1];
        }
    }

    /// Level of what lies beside the ball.
    fn level(&self, shades: &[f64; SHADES]) -> f64 {
        let of_shades: f64 =
            self.levels.iter().zip(shades).map(|(level, shade)| level * shade).sum();
        self.levels[VALUE - 1] - of_shades
    }

    /// Slope times slope, slope times what the shades leave of the values, and the squares of that, where the
    /// ball may be a little brighter or darker than its shades say; and the same of the spot's size, wherever the
    /// rim lies.
    fn rim(&self, shades: &[f64; SHADES], contrast: f64, focus: &Focus) -> [f64; 5] {
        // The shade itself, slope, softness, what is left.
        const KEPT: [usize; 4] = [SHADE - 1, SLOPE - 1, SOFTNESS - 1, VALUE - 1];
        let mut left = [[0.0; 4]; 4];
        for (row, &from) in left[..3].iter_mut().zip(&KEPT) {
            for (column, &to) in row[..3].iter_mut().zip(&KEPT) {
                *column = self.sums[from][to];
            }
            let of_shades: f64 =
                self.sums[from].iter().zip(shades).map(|(sum, shade)| sum * shade).sum();
            row[3] = self.sums[from][VALUE - 1] - of_shades;
        }
        let mut squares = self.sums[VALUE - 1][VALUE - 1];
        for (sums, shade) in self.sums.iter().zip(shades) {
            let of_shades: f64 = sums.iter().zip(shades).map(|(sum, shade)| sum * shade).sum();
            squares += shade * (of_shades - 2.0 * sums[VALUE - 1]);
        }
        let [a, b, c] = [left[0][3], left[1][3], left[2][3]];
        left[3] = [a, b, c, squares];
        if focus.is_free {
            let deviation = SHADE_NOISE * contrast.abs() + 1.0;
            eliminate(&mut left, 0, (SAMPLE_NOISE / deviation).powi(2));
        }
        let ([ee, er], rr) = ([left[1][1], left[1][3]], left[3][3].max(0.0));
        eliminate(&mut left, 1, 1e-3);
        [ee, er, rr, left[2][2], left[2][3]]
    }
}

/// Takes off what one quantity explains of all, if it is 0 as surely as so many samples would say.
fn eliminate<const N: usize>(sums: &mut [[f64; N]; N], index: usize, samples: f64) {
    let by = sums[index];
    let own = by[index] + samples;
    for (row, factor) in sums.iter_mut().zip(by) {
        row.iter_mut().zip(by).for_each(|(sum, by)| *sum -= factor * by / own);
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

/// In which of sixteen equal sectors, counted from x towards y, a direction lies.
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

const ROOTS: usize = 96;
const ROOTS_FROM: f32 = 3.5;
const ROOTS_PER_DEVIATION: f32 = 12.0;

/// √ of a ramp that begins at 0, as the spot shows it.
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

/// Solves symmetric equations by elimination; the last column is the right side.
fn solve(mut rows: [[f64; SHADES + 1]; SHADES]) -> Option<[f64; SHADES]> {
    for pivot in 0..SHADES {
        let by = rows[pivot][pivot];
        if by.is_nan() || by < 1e-12 {
            return None;
        }
        let above = rows[pivot];
        for row in rows.iter_mut().skip(pivot + 1) {
            let factor = row[pivot] / by;
            row.iter_mut().zip(above).for_each(|(it, above)| *it -= factor * above);
        }
    }
    let mut solution = [0.0; SHADES];
    for row in (0..SHADES).rev() {
        let known: f64 = (row + 1..SHADES).map(|column| rows[row][column] * solution[column]).sum();
        solution[row] = (rows[row][SHADES] - known) / rows[row][row];
    }
    Some(solution)
}
