//! Poses to hundredths of a pixel: from where the edges of the patches lie in the raw picture.
//!
//! Colour classes say of each pixel whether it is more inside of a patch or more outside; how much
//! is lost, and with it where between two pixels the edge lies. The error is the same for as long
//! as a robot stands, so no filter removes it. It is all in the samples themselves: lens and
//! sensor spread an edge over some pixels, and each of them says how far away the edge is.
//!
//! # The model
//!
//! A sample of colour channel c at the signed distance d inside an edge measures
//!
//! I = a + b·Φ(d / σ),
//!
//! with Φ the normal distribution function, σ the spot that lens, filter and pixel make of a point, a
//! the level outside, a + b that inside. Levels are taken from what is there, for each stretch of
//! edge and each channel: nothing needs to be known of colours and light. Nothing is demosaiced:
//! each sample counts for its own colour at its own place.
//!
//! # The fit
//!
//! Gauss and Newton's, over all samples at edges, for the step (x, y, θ) in the robot's frame. The
//! levels enter linearly, so they are eliminated: for each stretch and channel the sums over the
//! samples give the best levels, and what the step could explain beyond them. Stretches that
//! disagree with the others, because something else lies beside them or covers them, count for little
//! (iteratively reweighted, with the weights of Cauchy's distribution). What is known already, the
//! pose from the patches' centroids with its uncertainty, takes part as one more measurement.
//!
//! The normal equations also say how sure the result is.

use crate::edges::{EdgeMap, MAX_STRETCHES, NO_EDGE};
use crate::local_map::{LocalMap, RowMap};
use crate::raw::{CHANNELS, RawFrame, RawRow};
use common::geometry::{CameraModel, FieldPoint, Pose, wrap_angle};
use std::ops::Range;

/// Standard deviation of the spot, in pixels. A fit with one that is wrong by a quarter errs by a
/// hundredth of a pixel: what it takes from one side of an edge it gives to the other.
const SPOT_PX: f32 = 0.62;
/// Sensor noise, and what else is the matter with a sample, in grey levels and as a part of the step
/// between the levels.
const SAMPLE_NOISE: f64 = 2.0;
const MODEL_NOISE: f64 = 0.02;
/// What an edge as a whole may be off: patches are cut by hand, and not all spots are alike.
const EDGE_NOISE_PX: f64 = 0.03;
/// From about this far off the others an edge is not believed; in a poor picture, of which half the
/// edges are farther off, from so far as those, but never beyond the second.
const OUTLIER_PX: f64 = 0.12;
const MOST_OUTLIER_PX: f64 = 0.6;
/// Fewer samples tell nothing of two levels and a place.
const MIN_SAMPLES: f32 = 6.0;
/// Rounds over the pixels; the second is for those that began far off.
const MAX_ROUNDS: usize = 3;
/// A round that moves things by less than this was the last.
const SETTLED_PX: f64 = 0.12;
/// Rounds of weighing the stretches against each other.
const WEIGHINGS: usize = 3;
/// A result so far from where it began is of something else.
const FARTHEST_PX: f64 = 1.6;
/// An expected pose so far from the one found is not where it went.
const EXPECTED_PX: f64 = 1.0;
/// Of a row, so many pixels are looked at before those at edges are added up.
const PIXELS_AT_ONCE: usize = 64;
/// Grey levels are counted from here, so that sums of squares stay small.
const MIDDLE_LEVEL: f32 = 96.0;

/// A pose with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Fitted {
    pub pose: Pose,
    /// Upper triangle, row by row, of the covariance of x, y, heading, in mm and rad.
    pub covariance: [f64; 6],
    /// Samples at edges that took part.
    pub samples: u32,
}

/// Uncertainty of a pose before its edges were looked at, 1σ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Deviations {
    pub position_mm: f64,
    pub heading_rad: f64,
}

/// Fits poses to edges.
#[derive(Debug, Clone)]
pub(crate) struct EdgeFitter {
    map: EdgeMap,
    height_mm: f64,
    /// Headings are counted in millimetres at this distance from the centre.
    lever_mm: f64,
    /// A pose expected farther away than this is no better to begin with.
    expected_within_mm: f64,
    spot: SpotTable,
    /// By stretch, then by channel.
    sums: Box<[Sums; MAX_STRETCHES * CHANNELS]>,
    stretches: [Stretch; MAX_STRETCHES],
}

/// Sums over the samples of one stretch and channel, in groups of four that a processor adds at once.
/// w is Φ, j its derivatives by the step, i the level.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(16))]
struct Sums {
    /// j₀, j₁, j₂, w.
    plain: [f32; 4],
    /// The same, times w.
    by_w: [f32; 4],
    /// The same, times i.
    by_i: [f32; 4],
    /// j₀j₀, j₀j₁, j₀j₂, i.
    first: [f32; 4],
    /// j₁j₁, j₁j₂, j₂j₂, ii.
    rest: [f32; 4],
    n: f32,
}

/// A pixel at an edge.
#[derive(Debug, Clone, Copy, Default)]
struct EdgePixel {
    column: u32,
    edge: u32,
}

/// What a stretch says of the step: information · step = pull.
#[derive(Debug, Clone, Copy, Default)]
struct Stretch {
    information: [f64; 6],
    pull: [f64; 3],
    samples: f32,
}

impl EdgeFitter {
    /// For bodies with these edges on a plane `height_mm` above the floor.
    pub fn new(map: EdgeMap, height_mm: f64) -> Self {
        Self {
            lever_mm: (0.6 * map.reach_mm).max(1.0),
            expected_within_mm: EXPECTED_PX * map.mm_per_px,
            map,
            height_mm,
            spot: SpotTable::new(),
            sums: Box::new([Sums::default(); MAX_STRETCHES * CHANNELS]),
            stretches: [Stretch::default(); MAX_STRETCHES],
        }
    }

    /// The pose near `start` that explains the edges in the picture best; `None` if there are too few,
    /// or they lead somewhere else. To look first where the body is `expected` saves rounds, and
    /// makes no other difference.
    pub fn fit(
        &mut self,
        camera: &CameraModel,
        frame: &RawFrame,
        start: &Pose,
        deviations: &Deviations,
        expected: Option<&Pose>,
    ) -> Option<Fitted> {
        let is_near = |expected: &&Pose| {
            let [x, y, turn] = self.step_between(start, expected);
            x.hypot(y).max(turn.abs()) < self.expected_within_mm
        };
        let mut pose = *expected.filter(is_near).unwrap_or(start);
        let mut map = LocalMap::new(camera, &pose, self.height_mm, self.map.reach_mm)?;
        let mm_per_px = f64::from(map.mm_per_px());
        let prior = [
            deviations.position_mm.powi(-2),
            deviations.position_mm.powi(-2),
            (deviations.heading_rad * self.lever_mm).powi(-2),
        ];
        for round in 0..MAX_ROUNDS {
            if round > 0 {
                map = LocalMap::new(camera, &pose, self.height_mm, self.map.reach_mm)?;
            }
            self.sum_up(frame, &map);
            self.weigh_samples(mm_per_px);
            let so_far = self.step_between(start, &pose);
            let (step, covariance, samples) = self.solve(&prior, so_far, mm_per_px)?;
            pose = self.stepped(&pose, step);
            let [x, y, turn] = self.step_between(start, &pose);
            if x.hypot(y).max(turn.abs()) > FARTHEST_PX * mm_per_px {
                return None;
            }
            let is_settled = step.iter().all(|s| s.abs() < SETTLED_PX * mm_per_px);
            if is_settled || round + 1 == MAX_ROUNDS {
                let covariance = self.in_field(&covariance, pose.orientation);
                return Some(Fitted { pose, covariance, samples: samples as u32 });
            }
        }
        None
    }

    /// Goes over the pixels around the body.
    fn sum_up(&mut self, frame: &RawFrame, map: &LocalMap) {
        self.sums[..self.map.stretch_count * CHANNELS].fill(Sums::default());
        let reach_px = map.most_px(self.map.reach_mm);
        let (center_x, center_y) = (map.center.x_px, map.center.y_px);
        // Conversion brings negative numbers to 0.
        let rows = (center_y - reach_px).ceil() as usize
            ..(((center_y + reach_px).floor() + 1.0) as usize).min(frame.height);
        for row_index in rows {
            let v = row_index as f64 - center_y;
            let half = (reach_px * reach_px - v * v).max(0.0).sqrt();
            let columns = (center_x - half).ceil() as usize
                ..(((center_x + half).floor() + 1.0) as usize).min(frame.width);
            let row = frame.row(row_index);
            let row_map = map.row(v as f32);
            let mut begin = columns.start;
            while begin < columns.end {
                let end = columns.end.min(begin + PIXELS_AT_ONCE);
                self.sum_up_stretch_of_row(&row, begin..end, center_x, &row_map, map.mm_per_px());
                begin = end;
            }
        }
    }

    /// First finds out which pixels are at edges, then adds those: what is done for each pixel is
    /// without branches, which a processor could not foretell.
    #[inline(always)]
    fn sum_up_stretch_of_row(
        &mut self,
        row: &RawRow,
        columns: Range<usize>,
        center_x: f64,
        &[[x0, x1, x2], [y0, y1, y2]]: &RowMap,
        mm_per_px: f32,
    ) {
        let place = |column: u32| {
            let u = (f64::from(column) - center_x) as f32;
            [x0 + u * (x1 + u * x2), y0 + u * (y1 + u * y2)]
        };
        let mut found = [EdgePixel::default(); PIXELS_AT_ONCE];
        let mut count = 0;
        for column in columns.start as u32..columns.end as u32 {
            let [x, y] = place(column);
            let edge = self.map.index_at(x, y);
            found[count] = EdgePixel { column, edge: u32::from(edge) };
            count += usize::from(edge != NO_EDGE);
        }
        let per_sigma = 1.0 / (SPOT_PX * mm_per_px);
        let per_lever = 1.0 / self.lever_mm as f32;
        for pixel in &found[..count] {
            let edge = self.map.edge(pixel.edge);
            let [x, y] = place(pixel.column);
            let [nx, ny] = edge.normal;
            let (w, density) = self.spot.at((nx * x + ny * y - edge.offset_mm) * per_sigma);
            // The body moves on by the step, so the pixel moves back within it.
            let slope = -density * per_sigma;
            let j = [slope * nx, slope * ny, slope * (ny * x - nx * y) * per_lever];
            let sums = &mut self.sums[edge.stretch as usize * CHANNELS..][..CHANNELS];
            row.samples(pixel.column as usize, |channel, value| {
                sums[channel].add(w, j, value - MIDDLE_LEVEL);
            });
        }
    }

    /// From sums to what each stretch says.
    fn weigh_samples(&mut self, mm_per_px: f64) {
        let count = self.map.stretch_count;
        let by_stretch = self.sums.chunks_exact(CHANNELS);
        for (stretch, channels) in self.stretches[..count].iter_mut().zip(by_stretch) {
            *stretch = Stretch::default();
            for sums in channels {
                sums.add_to(stretch);
            }
            // However many samples: an edge as a whole may be off.
            let [xx, _, _, yy, _, _] = stretch.information;
            let edge_variance = (EDGE_NOISE_PX * mm_per_px).powi(2);
            stretch.scale(1.0 / (1.0 + edge_variance * (xx + yy)));
        }
    }

    /// The step that fits all stretches that agree, its covariance, and how many samples took part.
    fn solve(
        &self,
        prior: &[f64; 3],
        so_far: [f64; 3],
        mm_per_px: f64,
    ) -> Option<([f64; 3], [f64; 6], f32)> {
        let stretches = &self.stretches[..self.map.stretch_count];
        let mut weights = [1.0; MAX_STRETCHES];
        let mut result = None;
        for _ in 0..WEIGHINGS {
            let mut information = [prior[0], 0.0, 0.0, prior[1], 0.0, prior[2]];
            let mut pull = [0, 1, 2].map(|axis| -prior[axis] * so_far[axis]);
            let mut samples = 0.0;
            for (stretch, weight) in stretches.iter().zip(&weights) {
                for (sum, term) in information.iter_mut().zip(stretch.information) {
                    *sum += weight * term;
                }
                for (sum, term) in pull.iter_mut().zip(stretch.pull) {
                    *sum += weight * term;
                }
                if *weight > 0.5 {
                    samples += stretch.samples;
                }
            }
            if samples < 3.0 * MIN_SAMPLES {
                return None;
            }
            let covariance = inverse(&information)?;
            let step = times(&covariance, &pull);
            let mut off_px = [0.0; MAX_STRETCHES];
            for (off_px, stretch) in off_px.iter_mut().zip(stretches) {
                *off_px = stretch.off_mm(&step) / mm_per_px;
            }
            let outlier_px = typical_px(stretches, &off_px).clamp(OUTLIER_PX, MOST_OUTLIER_PX);
            for (weight, off_px) in weights.iter_mut().zip(off_px) {
                *weight = 1.0 / (1.0 + (off_px / outlier_px).powi(2));
            }
            result = Some((step, covariance, samples));
        }
        result
    }

    /// From one pose to another, in the frame of the second, the heading times the lever.
    fn step_between(&self, from: &Pose, to: &Pose) -> [f64; 3] {
        let (sin, cos) = to.orientation.sin_cos();
        let dx = to.position.x_mm - from.position.x_mm;
        let dy = to.position.y_mm - from.position.y_mm;
        let turn = wrap_angle(to.orientation - from.orientation);
        [cos * dx + sin * dy, cos * dy - sin * dx, turn * self.lever_mm]
    }

    fn stepped(&self, pose: &Pose, [x, y, turn]: [f64; 3]) -> Pose {
        let FieldPoint { x_mm, y_mm } = pose.field_from_robot([x, y]);
        Pose {
            position: FieldPoint::new(x_mm, y_mm),
            orientation: wrap_angle(pose.orientation + turn / self.lever_mm),
        }
    }

    /// A covariance of a step as one on the field, in millimetres and radians.
    fn in_field(&self, covariance: &[f64; 6], orientation: f64) -> [f64; 6] {
        let [xx, xy, xt, yy, yt, tt] = *covariance;
        let (s, c) = orientation.sin_cos();
        let per_lever = 1.0 / self.lever_mm;
        [
            c * c * xx - 2.0 * s * c * xy + s * s * yy,
            s * c * (xx - yy) + (c * c - s * s) * xy,
            (c * xt - s * yt) * per_lever,
            s * s * xx + 2.0 * s * c * xy + c * c * yy,
            (s * xt + c * yt) * per_lever,
            tt * per_lever * per_lever,
        ]
    }
}

impl Sums {
    #[inline(always)]
    fn add(&mut self, w: f32, [j0, j1, j2]: [f32; 3], i: f32) {
        let sample = [j0, j1, j2, w];
        let (first, rest) =
            ([[j0, j0, j0, i], [j0, j1, j2, 1.0]], [[j1, j1, j2, i], [j1, j2, j2, i]]);
        for lane in 0..4 {
            self.plain[lane] += sample[lane];
            self.by_w[lane] += w * sample[lane];
            self.by_i[lane] += i * sample[lane];
            self.first[lane] += first[0][lane] * first[1][lane];
            self.rest[lane] += rest[0][lane] * rest[1][lane];
        }
        self.n += 1.0;
    }

    /// Eliminates the levels and adds what is left to the stretch.
    fn add_to(&self, stretch: &mut Stretch) {
        if self.n < MIN_SAMPLES {
            return;
        }
        let f = f64::from;
        let Self { plain, by_w, by_i, first, rest, n } = *self;
        let (n, w, ww) = (f(n), f(plain[3]), f(by_w[3]));
        let determinant = n * ww - w * w;
        // All on one side: the levels cannot be told apart.
        if determinant < 0.02 * n * n {
            return;
        }
        let (i, wi, ii) = (f(first[3]), f(by_i[3]), f(rest[3]));
        let jj = [first[0], first[1], first[2], rest[0], rest[1], rest[2]];
        let a = (ww * i - w * wi) / determinant;
        let b = (n * wi - w * i) / determinant;
        let pull =
            [0, 1, 2].map(|axis| b * (f(by_i[axis]) - a * f(plain[axis]) - b * f(by_w[axis])));
        let mut information = [0.0; 6];
        for ((term, jj), (row, column)) in information.iter_mut().zip(jj).zip(UPPER) {
            let (j, wj) = (f(plain[row]), f(by_w[row]));
            let (k, wk) = (f(plain[column]), f(by_w[column]));
            // What the levels explain of the derivatives.
            let explained = (ww * j * k - w * (j * wk + wj * k) + n * wj * wk) / determinant;
            *term = b * b * (f(jj) - explained);
        }
        let across = information[0] + information[3];
        let by_place =
            if across > 1e-9 { (pull[0].powi(2) + pull[1].powi(2)) / across } else { 0.0 };
        let left = ii - a * i - b * wi - by_place;
        let least = SAMPLE_NOISE.powi(2) + (MODEL_NOISE * b).powi(2);
        let variance = (left / (n - 3.0)).max(least);
        for (sum, term) in stretch.information.iter_mut().zip(information) {
            *sum += term / variance;
        }
        for (sum, term) in stretch.pull.iter_mut().zip(pull) {
            *sum += term / variance;
        }
        stretch.samples += self.n;
    }
}

impl Stretch {
    fn scale(&mut self, factor: f64) {
        self.information.iter_mut().chain(&mut self.pull).for_each(|term| *term *= factor);
    }

    /// How far the edge lies from where a step would put it.
    fn off_mm(&self, step: &[f64; 3]) -> f64 {
        let moved = times(&self.information, step);
        let left = [self.pull[0] - moved[0], self.pull[1] - moved[1]];
        let across = self.information[0] + self.information[3];
        if across > 1e-12 { left[0].hypot(left[1]) / across } else { 0.0 }
    }
}

/// What half of the edges that can be seen are off by, at most.
fn typical_px(stretches: &[Stretch], off_px: &[f64; MAX_STRETCHES]) -> f64 {
    let mut seen = [0.0; MAX_STRETCHES];
    let mut count = 0;
    for (stretch, off_px) in stretches.iter().zip(off_px) {
        if stretch.samples > 0.0 {
            seen[count] = *off_px;
            count += 1;
        }
    }
    let seen = &mut seen[..count];
    if seen.is_empty() {
        return 0.0;
    }
    *seen.select_nth_unstable_by(count / 2, f64::total_cmp).1
}

/// Rows and columns of an upper triangle.
const UPPER: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

/// A symmetric matrix, as its upper triangle, times a vector.
fn times(m: &[f64; 6], v: &[f64; 3]) -> [f64; 3] {
    [
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[1] * v[0] + m[3] * v[1] + m[4] * v[2],
        m[2] * v[0] + m[4] * v[1] + m[5] * v[2],
    ]
}

/// Inverse of a positive definite matrix.
fn inverse(&[xx, xy, xz, yy, yz, zz]: &[f64; 6]) -> Option<[f64; 6]> {
    let (a, b, c) = (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy);
    let determinant = xx * a + xy * b + xz * c;
    let inverse = [a, b, c, xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy]
        .map(|cofactor| cofactor / determinant);
    let is_positive = [0, 3, 5].iter().all(|&index| inverse[index] > 0.0);
    (determinant > 0.0 && is_positive && inverse.iter().all(|term| term.is_finite()))
        .then_some(inverse)
}

/// The normal distribution, tabulated: function and density.
#[derive(Debug, Clone)]
struct SpotTable(Box<[[f32; 2]; SpotTable::ENTRIES]>);

impl SpotTable {
    const REACH: f32 = 4.0;
    const PER_SIGMA: f32 = 32.0;
    const ENTRIES: usize = 2 * (Self::REACH * Self::PER_SIGMA) as usize + 1;

    fn new() -> Self {
        let mut entries = Box::new([[0.0; 2]; Self::ENTRIES]);
        for (index, entry) in entries.iter_mut().enumerate() {
            let z = index as f64 / f64::from(Self::PER_SIGMA) - f64::from(Self::REACH);
            let density = (-z * z / 2.0).exp() / std::f64::consts::TAU.sqrt();
            // Its power series.
            let (mut term, mut sum) = (z, z);
            for k in 1..80 {
                term *= z * z / f64::from(2 * k + 1);
                sum += term;
            }
            *entry = [(0.5 + density * sum) as f32, density as f32];
        }
        Self(entries)
    }

    #[inline(always)]
    fn at(&self, z: f32) -> (f32, f32) {
        let place = (z + Self::REACH) * Self::PER_SIGMA + 0.5;
        // Conversion brings negative numbers and NaN to 0.
        let index = (place as usize).min(Self::ENTRIES - 1);
        let [w, density] = self.0[index];
        let off = z - (index as f32 / Self::PER_SIGMA - Self::REACH);
        // This way round it is false for NaN.
        if off.abs() < 1.0 / Self::PER_SIGMA {
            (w + density * off, density * (1.0 - z * off))
        } else {
            (w, density)
        }
    }
}

#[cfg(test)]
mod tests;
