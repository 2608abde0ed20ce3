//! Silhouette: a circle of known size in the outline of a region, which locates a ball that is partly hidden
//! or partly too dark for its colour.
//!
//! The visible part of such a ball ends at its rim on one side, and at what hides it or at the limit of its
//! colour on the other, so its centroid says little. But any three points of the rim determine its place
//! (random sample consensus: Fischler and Bolles, 1981):
//!
//! ```text
//! TRIALS times: circle through three points of the outline; skip it if its radius is not a ball's
//!               score = Σ over all points, d = signed distance from the circle / tolerance:
//!                       1 − d² on the circle (|d| < 1), −1 outside (d > 1), 0 inside
//! three Gauss–Newton steps from the best circle, over the points on it, with a prior of the radius
//! ```
//!
//! Points outside count against a circle because nothing of a ball can be there. The colour may end a little
//! before the rim, so circles may be smaller than the ball. Edges of robots are straight or concave, and fit
//! no such circle.

use super::sphere::{Outline, Sphere};
use crate::edges::local_map::{LocalMap, mm_per_px};
use crate::linear::{inverse, times};
use fearless_simd::{Level, dispatch};
use geometry::{CameraModel, FieldPoint, Pose};
use messages::Run;

/// Tolerance of points on the circle: the larger of these, in radii and in pixels.
const ON_RIM: f64 = 0.07;
const ON_RIM_PX: f64 = 0.55;
/// Admitted radii of circles, as multiples of the ball's.
const RADII: std::ops::Range<f64> = 0.7..1.2;
/// Distance from a ball's rim beyond which a pixel shows nothing of it.
const CLEARLY_PX: f64 = 1.8;
/// Least distance between the three points of a circle, in radii.
const APART: f64 = 0.6;
/// Most points of the outline that are used.
const MOST_POINTS: usize = 48;
/// Triples of points that are tried.
const TRIALS: u32 = 160;
/// Sectors of the rim, by which its visible share is measured.
const SECTORS: usize = 16;

/// The outer border of a region: its extent in each row and column.
#[derive(Debug, Clone)]
pub(crate) struct Silhouette {
    level: Level,
    top: usize,
    left: usize,
    /// First pixel and end, by row from `top`.
    rows: Vec<[u16; 2]>,
    /// First pixel and end, by column from `left`.
    columns: Vec<[u16; 2]>,
}

/// Prior of the circle's radius, as a multiple of the ball's: mean and standard deviation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RadiusPrior {
    mean: f64,
    sigma: f64,
}

/// Prior for the outline of a colour class, which ends before the rim.
pub(crate) const BY_CLASS: RadiusPrior = RadiusPrior { mean: 0.93, sigma: 0.08 };
/// Prior for the outline of the ball's tinge, which ends beyond the rim.
pub(crate) const BY_TINGE: RadiusPrior = RadiusPrior { mean: 1.05, sigma: 0.04 };

/// A circle in an outline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rim {
    /// In units of the ball's radius.
    pub center: [f64; 2],
    /// Share of the circle that the outline covers.
    pub share: f64,
    /// Share of the outline's points that lie outside the circle.
    pub outside: f64,
}

impl Default for Silhouette {
    fn default() -> Self {
        Self { level: Level::new(), top: 0, left: 0, rows: Vec::new(), columns: Vec::new() }
    }
}

impl Silhouette {
    /// Takes the outline of a region's runs.
    pub fn trace(&mut self, runs: &[Run]) {
        self.rows.clear();
        self.columns.clear();
        let (Some(first), Some(last)) = (runs.first(), runs.last()) else { return };
        self.top = usize::from(first.row);
        let bottom = usize::from(last.row.max(first.row));
        self.rows.resize(bottom - self.top + 1, [u16::MAX, 0]);
        let left = runs.iter().map(|run| run.begin).min().unwrap_or(0);
        let right = runs.iter().map(|run| run.end).max().unwrap_or(0).max(left);
        self.left = usize::from(left);
        self.columns.resize(usize::from(right - left), [u16::MAX, 0]);
        for run in runs {
            let Some(row) = self.rows.get_mut(usize::from(run.row).wrapping_sub(self.top)) else {
                continue;
            };
            *row = [row[0].min(run.begin), row[1].max(run.end)];
            let begin = usize::from(run.begin) - self.left;
            let end = usize::from(run.end.max(run.begin)) - self.left;
            for column in &mut self.columns[begin..end] {
                *column = [column[0].min(run.row), column[1].max(run.row + 1)];
            }
        }
    }

    /// Whether a pixel lies between the outline's ends in its row. Holes count as covered.
    pub fn covers(&self, row: usize, column: usize) -> bool {
        let row = self.rows.get(row.wrapping_sub(self.top));
        row.is_some_and(|[begin, end]| (usize::from(*begin)..usize::from(*end)).contains(&column))
    }

    /// Points of the outline in pixels, one side after the other, so that every n-th of them are spread
    /// evenly.
    fn points(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        let rows = |end| ends(&self.rows, end).map(|(row, x)| [x, (self.top + row) as f64]);
        let columns =
            |end| ends(&self.columns, end).map(|(column, y)| [(self.left + column) as f64, y]);
        rows(0).chain(rows(1)).chain(columns(0)).chain(columns(1))
    }

    /// Position of the ball whose rim is in the outline, and the circle. `position` is where it lies roughly.
    pub fn ball(
        &self,
        sphere: &Sphere,
        camera: &CameraModel,
        position: FieldPoint,
        prior: &RadiusPrior,
    ) -> Option<(FieldPoint, Rim)> {
        let outline = sphere.outline(position);
        let pose = Pose { position, orientation: outline.direction };
        let (place, per_px) = into_outline(sphere, camera, &pose, &outline)?;
        let rim = self.rim(place, per_px, prior)?;
        let [along, across] = rim.center;
        let middle = [along * outline.long_mm - outline.beyond_mm, across * outline.short_mm];
        Some((pose.field_from_robot(middle), rim))
    }

    /// Share of the outline's points that lie clearly outside a ball.
    pub fn outside(&self, sphere: &Sphere, camera: &CameraModel, position: FieldPoint) -> f64 {
        let outline = sphere.outline(position);
        let pose = Pose { position, orientation: outline.direction };
        let Some((place, per_px)) = into_outline(sphere, camera, &pose, &outline) else {
            return 1.0;
        };
        let beyond = outline.beyond_mm / outline.long_mm;
        let is_outside = |point: [f64; 2]| {
            let [x, y] = place(point);
            let off = x - beyond;
            off * off + y * y > (1.0 + CLEARLY_PX * per_px).powi(2)
        };
        let (mut all, mut outside) = (0.0, 0.0);
        for point in self.points() {
            all += 1.0;
            outside += f64::from(u8::from(is_outside(point)));
        }
        if all > 0.0 { outside / all } else { 1.0 }
    }

    /// The circle that explains the outline best. `place` takes pixels to units of the ball's radius,
    /// `per_px` is a pixel in these.
    fn rim(
        &self,
        place: impl Fn([f64; 2]) -> [f64; 2],
        per_px: f64,
        prior: &RadiusPrior,
    ) -> Option<Rim> {
        let all = self.points().count();
        let every = all.div_ceil(MOST_POINTS).max(1);
        let mut points = [[0.0; 2]; MOST_POINTS];
        let mut count = 0;
        for (slot, point) in points.iter_mut().zip(self.points().step_by(every)) {
            *slot = place(point);
            count += 1;
        }
        let by_lanes = by_lanes(&points[..count]);
        let points = &points[..count];
        if count < 3 {
            return None;
        }
        let tolerance = ON_RIM.max(ON_RIM_PX * per_px);
        let (mut best, mut best_score) = (None, 0.0);
        let mut dice = 1u32;
        for _ in 0..TRIALS {
            // A fixed pseudo-random sequence (Numerical Recipes' linear congruential generator).
            let [a, b, c] = [0; 3].map(|_| {
                dice = dice.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                points[((u64::from(dice) * count as u64) >> 32) as usize]
            });
            let Some(circle) = circle_through(a, b, c) else { continue };
            let score = dispatch!(self.level, _simd => score(&by_lanes, &circle, tolerance));
            if score > best_score {
                (best, best_score) = (Some(circle), score);
            }
        }
        let mut circle = best?;
        for _ in 0..3 {
            circle = improved(points, &circle, tolerance, prior)?;
        }
        Some(describe(points, &circle, tolerance))
    }
}

/// Borders of the spans that are not empty, with their indices: the first ones (`end` 0) or the last ones
/// (1).
fn ends(spans: &[[u16; 2]], end: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
    let are_there = spans.iter().enumerate().filter(|(_, [begin, end])| begin < end);
    are_there.map(move |(index, span)| (index, f64::from(span[end]) - 0.5))
}

/// The map from pixels to the frame of an outline, in units of its half axes, and the length of a pixel in
/// these.
fn into_outline(
    sphere: &Sphere,
    camera: &CameraModel,
    pose: &Pose,
    outline: &Outline,
) -> Option<(impl Fn([f64; 2]) -> [f64; 2], f64)> {
    let mm_per_px = mm_per_px(camera, pose.position, sphere.radius_mm);
    let reach_mm = 2.0 * sphere.radius_mm;
    let map = LocalMap::new(camera, pose, sphere.radius_mm, reach_mm, mm_per_px)?;
    let axes = [outline.long_mm, outline.short_mm];
    let place = move |[x, y]: [f64; 2]| {
        let [u, v] = [x - map.center.x_px, y - map.center.y_px].map(|off| off as f32);
        let [along, across] = map.row(v).map(|[a, b, c]| f64::from(a + u * (b + u * c)));
        [along / axes[0], across / axes[1]]
    };
    Some((place, mm_per_px / sphere.radius_mm))
}

#[derive(Debug, Clone, Copy)]
struct Circle {
    center: [f64; 2],
    radius: f64,
}

impl Circle {
    /// Distance of a point from the circle, positive outside.
    fn outside(&self, [x, y]: [f64; 2]) -> f64 {
        ((x - self.center[0]).powi(2) + (y - self.center[1]).powi(2)).sqrt() - self.radius
    }
}

/// The circle through three points, if they are apart and its radius can be a ball's.
fn circle_through(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> Option<Circle> {
    let [p, q] = [b, c].map(|to| [to[0] - a[0], to[1] - a[1]]);
    let [pp, qq] = [p, q].map(|[x, y]| x * x + y * y);
    let between = (q[0] - p[0]).powi(2) + (q[1] - p[1]).powi(2);
    if pp.min(qq).min(between) < APART * APART {
        return None;
    }
    let twice = 2.0 * (p[0] * q[1] - p[1] * q[0]);
    let x = (q[1] * pp - p[1] * qq) / twice;
    let y = (p[0] * qq - q[0] * pp) / twice;
    let radius = (x * x + y * y).sqrt();
    RADII.contains(&radius).then_some(Circle { center: [a[0] + x, a[1] + y], radius })
}

/// Points that are scored together.
const LANES: usize = 8;
/// The columns and the rows of points, eight by eight. Places without a point are NaN.
type ByLanes = [[[f64; LANES]; 2]; MOST_POINTS / LANES];

fn by_lanes(points: &[[f64; 2]]) -> ByLanes {
    let mut by_lanes = [[[f64::NAN; LANES]; 2]; MOST_POINTS / LANES];
    for (index, point) in points.iter().enumerate() {
        for (lanes, value) in by_lanes[index / LANES].iter_mut().zip(point) {
            lanes[index % LANES] = *value;
        }
    }
    by_lanes
}

/// Score of a circle, as described above. The sums do not depend on the width of the registers.
#[inline(always)]
fn score(points: &ByLanes, circle: &Circle, tolerance: f64) -> f64 {
    let [center_x, center_y] = circle.center;
    let mut sums = [0.0; LANES];
    for [xs, ys] in points {
        for lane in 0..LANES {
            let (x, y) = (xs[lane] - center_x, ys[lane] - center_y);
            let off = ((x * x + y * y).sqrt() - circle.radius) / tolerance;
            let near = 1.0 - off * off;
            // No branch is taken for NaN: neither outside nor on the circle.
            let on_circle = if near > 0.0 { near } else { 0.0 };
            sums[lane] += if off > 1.0 { -1.0 } else { on_circle };
        }
    }
    sums.iter().sum()
}

/// A Gauss–Newton step of the circle towards the points on it.
fn improved(
    points: &[[f64; 2]],
    circle: &Circle,
    tolerance: f64,
    prior: &RadiusPrior,
) -> Option<Circle> {
    let by_prior = (tolerance / prior.sigma).powi(2);
    // The weak prior of the centre is for arcs so short that they leave a direction open.
    let mut normal = [0.05, 0.0, 0.0, 0.05, 0.0, by_prior];
    let mut pull = [0.0, 0.0, by_prior * (prior.mean - circle.radius)];
    for point in points {
        let off = circle.outside(*point);
        let weight = (1.0 - (off / tolerance).powi(2)).max(0.0);
        let far = off + circle.radius;
        if weight > 0.0 && far > 0.1 {
            let [nx, ny] = [0, 1].map(|axis| (point[axis] - circle.center[axis]) / far);
            let terms = [nx * nx, nx * ny, nx, ny * ny, ny, 1.0];
            normal.iter_mut().zip(terms).for_each(|(sum, term)| *sum += weight * term);
            pull.iter_mut().zip([nx, ny, 1.0]).for_each(|(sum, term)| *sum += weight * term * off);
        }
    }
    let [x, y, wider] = times(&inverse(&normal)?, &pull);
    let [a, b] = circle.center;
    Some(Circle { center: [a + x, b + y], radius: circle.radius + wider })
}

/// Share of the circle that points lie on, by sectors, and share of the points outside.
fn describe(points: &[[f64; 2]], circle: &Circle, tolerance: f64) -> Rim {
    let center = circle.center;
    let mut seen = [false; SECTORS];
    let mut beyond = 0.0;
    for point in points {
        let off = circle.outside(*point);
        if off > tolerance {
            beyond += 1.0;
        } else if off > -tolerance {
            let angle = (point[1] - center[1]).atan2(point[0] - center[0]);
            let turn = angle.rem_euclid(std::f64::consts::TAU) / std::f64::consts::TAU;
            seen[((turn * SECTORS as f64) as usize).min(SECTORS - 1)] = true;
        }
    }
    let count = points.len().max(1) as f64;
    let share = seen.iter().filter(|&&seen| seen).count() as f64 / SECTORS as f64;
    Rim { center, share, outside: beyond / count }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs of the pixels that are `inside`.
    fn runs(inside: impl Fn(f64, f64) -> bool) -> Vec<Run> {
        let mut runs: Vec<Run> = Vec::new();
        for row in 80..120u16 {
            for column in 180..220u16 {
                if !inside(f64::from(column), f64::from(row)) {
                    continue;
                }
                match runs.last_mut() {
                    Some(run) if run.row == row && run.end == column => run.end += 1,
                    _ => runs.push(Run {
                        row,
                        begin: column,
                        end: column + 1,
                        class: 0,
                        reserved: 0,
                    }),
                }
            }
        }
        runs
    }

    fn rim(runs: &[Run], radius_px: f64) -> Option<Rim> {
        let mut silhouette = Silhouette::default();
        silhouette.trace(runs);
        silhouette.rim(|[x, y]| [x / radius_px, y / radius_px], 1.0 / radius_px, &BY_CLASS)
    }

    #[test]
    fn a_circle_is_found_by_a_visible_part() {
        for radius in [3.5, 5.8, 11.0] {
            for (cut, share) in [(2.0, 0.99), (0.3, 0.6), (0.0, 0.45), (-0.35, 0.3)] {
                for degrees in [0, 20, 45, 70, 130, 200, 290] {
                    let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
                    let (x, y) = (200.3, 99.6);
                    let part = runs(|u, v| {
                        let (u, v) = (u - x, v - y);
                        u.hypot(v) < radius && u * cos + v * sin < cut * radius
                    });
                    let found = rim(&part, radius).unwrap();
                    let [u, v] = found.center.map(|place| place * radius);
                    assert!((u - x).hypot(v - y) < 1.2, "{radius} {cut} {degrees}°: {u} {v}");
                    assert!(found.share >= share - 0.15 && found.outside < 0.1, "{found:?}");
                }
            }
        }
    }

    #[test]
    fn shapes_that_are_not_round_have_no_rim() {
        let radius = 5.8;
        for part in [
            runs(|x, y| (x - 200.0).abs() < 12.0 && (y - 100.0).abs() < 1.0),
            runs(|x, y| (x - 200.0).abs() < 14.0 && (y - 100.0).abs() < 14.0),
            runs(|x, y| (x - 200.0).abs() < 2.0 && (y - 100.0).abs() < 2.0),
        ] {
            let found = rim(&part, radius);
            assert!(found.is_none_or(|rim| rim.share < 0.3 || rim.outside > 0.2), "{found:?}");
        }
        assert_eq!(rim(&[], radius), None);
    }

    #[test]
    fn every_level_scores_as_one_point_after_the_other_would() {
        let points: Vec<[f64; 2]> = (0..37)
            .map(|index| f64::from(index) * 0.7)
            .map(|angle| [(1.0 + 0.1 * angle.sin()) * angle.cos(), angle.sin()])
            .collect();
        let (circle, tolerance) = (Circle { center: [0.02, -0.05], radius: 0.97 }, 0.09);
        let one = |point: &[f64; 2]| {
            let off = circle.outside(*point) / tolerance;
            if off > 1.0 { -1.0 } else { (1.0 - off * off).max(0.0) }
        };
        let expected: f64 = points.iter().map(one).sum();
        let by_lanes = by_lanes(&points);
        let scores = [Level::new(), Level::baseline()]
            .map(|level| dispatch!(level, _simd => score(&by_lanes, &circle, tolerance)));
        assert!((scores[0] - expected).abs() < 1e-9, "{scores:?} {expected}");
        assert_eq!(scores[0].to_bits(), scores[1].to_bits());
    }
}
