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
//! I = a + b·w(d / σ),
//!
//! with w the share of light from inside (nearly the normal distribution function), σ the spot that
//! lens, filter and pixel make of a point, a the level outside, a + b that inside. Levels are taken
//! from what is there, for each stretch of edge and each channel: nothing needs to be known of
//! colours and light. Nothing is demosaiced: each sample counts for its own colour at its own place.
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
//! The normal equations also say how sure the result is; less so where stretches disagree more than
//! they do in a good picture.

use crate::edge_pixels::{EdgePixels, Sums};
use crate::edges::{EdgeMap, MAX_STRETCHES};
use crate::linear::{UPPER, inverse, times};
use crate::local_map::LocalMap;
use crate::raw::{CHANNELS, RawFrame};
use common::geometry::{CameraModel, FieldPoint, Pose, wrap_angle};

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
/// Of the variance that the weights of the fit make for, so much is claimed: weights allow for edges
/// that are worse than most. With it errors in synthetic matches are about as large as claimed.
const VARIANCE_FACTOR: f64 = 0.4;
/// Where the squares of what stretches are off by are more than this, of what they claim, they disagree
/// more than in any good picture.
const USUAL_DISAGREEMENT: f64 = 0.8;
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
    pixels: EdgePixels,
    stretches: [Stretch; MAX_STRETCHES],
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
        let lever_mm = (0.6 * map.reach_mm).max(1.0);
        Self {
            lever_mm,
            expected_within_mm: EXPECTED_PX * map.mm_per_px,
            map,
            height_mm,
            pixels: EdgePixels::new(lever_mm),
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
            // Not by their maximum, which NaN would not be in.
            x.hypot(y) < self.expected_within_mm && turn.abs() < self.expected_within_mm
        };
        let mut pose = *expected.filter(is_near).unwrap_or(start);
        let mut map = self.local_map(camera, &pose)?;
        let mm_per_px = f64::from(map.mm_per_px());
        let prior = [
            deviations.position_mm.powi(-2),
            deviations.position_mm.powi(-2),
            (deviations.heading_rad * self.lever_mm).powi(-2),
        ];
        for round in 0..MAX_ROUNDS {
            if round > 0 {
                map = self.local_map(camera, &pose)?;
            }
            self.weigh_samples(frame, &map, mm_per_px);
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

    fn local_map(&self, camera: &CameraModel, pose: &Pose) -> Option<LocalMap> {
        let EdgeMap { reach_mm, mm_per_px, .. } = self.map;
        LocalMap::new(camera, pose, self.height_mm, reach_mm, mm_per_px)
    }

    /// What each stretch says, from the pixels at it.
    fn weigh_samples(&mut self, frame: &RawFrame, map: &LocalMap, mm_per_px: f64) {
        let count = self.map.stretch_count;
        let by_stretch = self.pixels.sum_up(&self.map, frame, map).chunks_exact(CHANNELS);
        for (stretch, channels) in self.stretches[..count].iter_mut().zip(by_stretch) {
            *stretch = Stretch::default();
            for sums in channels {
                stretch.add(sums);
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
        let mut weighings = 1;
        loop {
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
            if weighings == WEIGHINGS {
                let disagreement = disagreement(stretches, &weights, &off_px, mm_per_px);
                // Only of what the edges say; what was known before stays what it was.
                let mut claimed = information.map(|term| term / (VARIANCE_FACTOR * disagreement));
                for (index, prior) in [0, 3, 5].into_iter().zip(prior) {
                    claimed[index] += prior - prior / (VARIANCE_FACTOR * disagreement);
                }
                return Some((step, inverse(&claimed)?, samples));
            }
            weighings += 1;
            let outlier_px = typical_px(stretches, &off_px).clamp(OUTLIER_PX, MOST_OUTLIER_PX);
            for (weight, off_px) in weights[..stretches.len()].iter_mut().zip(off_px) {
                *weight = 1.0 / (1.0 + (off_px / outlier_px).powi(2));
            }
        }
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

impl Stretch {
    /// Eliminates the levels and adds what is left.
    fn add(&mut self, sums: &Sums) {
        if sums.n < MIN_SAMPLES {
            return;
        }
        let f = f64::from;
        let Sums { plain, by_w, by_i, first, rest, n } = *sums;
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
        let mut pull = [0.0; 3];
        for (axis, pull) in pull.iter_mut().enumerate() {
            *pull = b * (f(by_i[axis]) - a * f(plain[axis]) - b * f(by_w[axis]));
        }
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
        for (sum, term) in self.information.iter_mut().zip(information) {
            *sum += term / variance;
        }
        for (sum, term) in self.pull.iter_mut().zip(pull) {
            *sum += term / variance;
        }
        self.samples += sums.n;
    }

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

/// By how much the squares of what stretches are off by exceed what is usual; at least 1. It is by
/// this that the covariance of their mean is too small (Birge, The calculation of errors by the method
/// of least squares, 1932): where something hides patches, where they are badly cut or lit.
fn disagreement(
    stretches: &[Stretch],
    weights: &[f64; MAX_STRETCHES],
    off_px: &[f64; MAX_STRETCHES],
    mm_per_px: f64,
) -> f64 {
    let (mut squares, mut count) = (0.0, 0.0);
    for ((stretch, weight), off_px) in stretches.iter().zip(weights).zip(off_px) {
        if stretch.samples > 0.0 {
            let [xx, _, _, yy, _, _] = stretch.information;
            squares += weight * (off_px * mm_per_px).powi(2) * (xx + yy);
            count += weight;
        }
    }
    // A pose has three numbers, which take as much of the disagreement away.
    (squares / (count - 3.0).max(1.0) / USUAL_DISAGREEMENT).max(1.0)
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

#[cfg(test)]
mod tests;
