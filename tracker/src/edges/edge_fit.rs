//! Edge fit: poses to a fiftieth of a pixel, from the positions of patch edges in the raw picture.
//!
//! A colour class says only whether a pixel lies mostly inside a patch. The fraction is lost, and with it
//! the edge's position between two pixels; the error stays the same while a robot stands still, so no filter
//! averages it out. The raw samples still hold the fraction: lens and sensor spread an edge over some
//! pixels, and each of these pixels tells its distance from the edge.
//!
//! # Model
//!
//! A sample of colour channel c at the signed distance d inside an edge measures
//!
//! I = a + b·w(d / σ),
//!
//! where w is the fraction of the light that comes from inside (the integral of the point spread function
//! of lens, filter and pixel, nearly the normal distribution function), σ the standard deviation of that
//! function, a the level outside and a + b the level inside. a and b are estimated from the picture for each
//! stretch of edge and each channel, so neither colours nor light need to be known. Nothing is demosaiced:
//! each sample is used in its own channel at its own place.
//!
//! # Fit
//!
//! The fit is Gauss–Newton over all samples at edges, for the step (x, y, θ) in the robot's frame:
//!
//! ```text
//! repeat up to MAX_ROUNDS times, until the step is below SETTLED_PX:
//!     sums over the samples, for each stretch and channel            (edge_pixels)
//!     eliminate a and b from the normal equations of each            (Stretch::add)
//!     WEIGHINGS times: step = (Σ wₖ·Nₖ + P)⁻¹·(Σ wₖ·gₖ + P·start)     (solve)
//!                      wₖ = 1 / (1 + (residualₖ / scale)²)
//! ```
//!
//! N and g are a stretch's normal matrix and right side, P the information of the start pose, which takes
//! part as one more measurement. Stretches that disagree with the others, because something lies beside them
//! or covers them, lose weight: iteratively reweighted least squares with the weights of Cauchy's
//! distribution (Holland and Welsch, Robust regression using iteratively reweighted least-squares, 1977).
//!
//! The covariance of the result is the inverse of the normal matrix, enlarged where stretches disagree more
//! than they do in a good picture (Birge's ratio).

use super::edge_pixels::{EdgePixels, Sums};
use super::local_map::LocalMap;
use super::{EdgeMap, MAX_STRETCHES};
use crate::linear::{UPPER, inverse, times};
use crate::raw::{CHANNELS, RawFrame};
use geometry::{CameraModel, FieldPoint, Pose, wrap_angle};

/// Noise of a sample, 1σ: of the sensor in grey levels, and of the model as a fraction of the edge's
/// contrast b.
const SAMPLE_NOISE: f64 = 2.0;
const MODEL_NOISE: f64 = 0.02;
/// Position error of an edge as a whole, 1σ, however many samples it has: patches are cut by hand, and the
/// point spread function varies over the picture.
const EDGE_NOISE_PX: f64 = 0.03;
/// Scale of Cauchy's weights, px. It is the median residual of the visible edges, within these bounds: in a
/// poor picture edges may be farther off before they count as outliers.
const OUTLIER_PX: f64 = 0.12;
const MOST_OUTLIER_PX: f64 = 0.6;
/// Fraction of the variance of the weighted fit that is reported: the weights allow for edges that are worse
/// than most. Chosen so that errors in synthetic matches are as large as reported.
const VARIANCE_FACTOR: f64 = 0.4;
/// Reduced chi-square of the stretches in a good picture; above it the covariance is enlarged.
const USUAL_DISAGREEMENT: f64 = 0.8;
/// Least samples of a stretch and channel: two levels and a position have to be estimated from them.
const MIN_SAMPLES: f32 = 6.0;
/// Most passes over the pixels; further ones are needed only where the start was far off.
const MAX_ROUNDS: usize = 3;
/// Convergence: a step below this ends the fit.
const SETTLED_PX: f64 = 0.12;
/// Reweightings of the stretches in each pass.
const WEIGHINGS: usize = 3;
/// Farthest that the result may lie from the start; beyond it the edges are those of something else.
const FARTHEST_PX: f64 = 1.6;
/// Farthest that the expected pose may lie from the start to be used in its place.
const EXPECTED_PX: f64 = 1.0;

/// A pose with its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Fitted {
    pub pose: Pose,
    /// Upper triangle, row by row, of the covariance of x, y, heading, in mm and rad.
    pub covariance: [f64; 6],
    /// Samples of the stretches that are not outliers.
    pub samples: u32,
}

/// Uncertainty of the start pose, 1σ.
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
    /// Lever arm that turns headings into millimetres, so that all three unknowns have one unit.
    lever_mm: f64,
    /// [`EXPECTED_PX`] in millimetres.
    expected_within_mm: f64,
    pixels: EdgePixels,
    stretches: [Stretch; MAX_STRETCHES],
}

/// Normal equations of a stretch, the levels eliminated: information · step = pull.
#[derive(Debug, Clone, Copy, Default)]
struct Stretch {
    /// Normal matrix as an upper triangle.
    information: [f64; 6],
    /// Right side.
    pull: [f64; 3],
    samples: f32,
}

impl EdgeFitter {
    /// A fitter for bodies with these edges on a plane `height_mm` above the floor.
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

    /// The pose near `start` that explains the edges in the picture best; `None` if there are too few edges
    /// or the result is farther than [`FARTHEST_PX`] from `start`. Beginning at the `expected` pose, where it
    /// is near enough, saves passes and changes nothing else.
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
            // Two comparisons, because `max` would drop NaN.
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
            self.accumulate_normal_equations(frame, &map, mm_per_px);
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

    /// Fills `stretches` from the pixels at their edges.
    fn accumulate_normal_equations(&mut self, frame: &RawFrame, map: &LocalMap, mm_per_px: f64) {
        let count = self.map.stretch_count;
        let by_stretch = self.pixels.sum_up(&self.map, frame, map).chunks_exact(CHANNELS);
        for (stretch, channels) in self.stretches[..count].iter_mut().zip(by_stretch) {
            *stretch = Stretch::default();
            for sums in channels {
                stretch.add(sums);
            }
            // Adds EDGE_NOISE_PX to the variance of the stretch's position.
            let [xx, _, _, yy, _, _] = stretch.information;
            let edge_variance = (EDGE_NOISE_PX * mm_per_px).powi(2);
            stretch.scale(1.0 / (1.0 + edge_variance * (xx + yy)));
        }
    }

    /// Robust solution of the normal equations of all stretches and the start pose: the step, its covariance
    /// and the number of samples of stretches that are not outliers.
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
                // The factors apply to the edges' information; that of the start pose is kept as it is.
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

    /// The step from one pose to another in the frame of the second, the heading times the lever arm.
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

    /// Turns the covariance of a step in the robot's frame into one on the field, in millimetres and radians.
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
    /// Adds the normal equations of one channel, its levels a and b eliminated (Schur complement), divided by
    /// the variance of the residuals.
    fn add(&mut self, sums: &Sums) {
        if sums.n < MIN_SAMPLES {
            return;
        }
        let f = f64::from;
        let Sums { plain, by_w, by_i, first, rest, n } = *sums;
        let (n, w, ww) = (f(n), f(plain[3]), f(by_w[3]));
        let determinant = n * ww - w * w;
        // All samples lie on one side of the edge, so the levels cannot be separated.
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
            // The part of the derivatives' products that the levels explain.
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

    /// Distance between the edge and its place after a step.
    fn off_mm(&self, step: &[f64; 3]) -> f64 {
        let moved = times(&self.information, step);
        let left = [self.pull[0] - moved[0], self.pull[1] - moved[1]];
        let across = self.information[0] + self.information[3];
        if across > 1e-12 { left[0].hypot(left[1]) / across } else { 0.0 }
    }
}

/// Factor by which the covariance is too small (Birge, The calculation of errors by the method of least
/// squares, 1932): the reduced chi-square of the stretches over [`USUAL_DISAGREEMENT`], at least 1. It is
/// above 1 where patches are partly hidden, badly cut or badly lit.
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
    // Three degrees of freedom go into the pose.
    (squares / (count - 3.0).max(1.0) / USUAL_DISAGREEMENT).max(1.0)
}

/// Median residual of the visible edges, px.
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
