//! A robot's top, blurred by the camera's spot: a table of the part of each patch that a spot of light at any
//! place of the top covers.
//!
//! The top is sampled on a fine grid and convolved with the Gaussian spot, one axis after the other, since
//! the kernel is separable. The renderer interpolates bilinearly between the table's entries.

use config::{RobotsConfig, Top};
use geometry::body::Body;
use geometry::layout::{reach_mm, topmost_patch};
use messages::MAX_PATCHES;

/// Parts of a robot: the patches, then its body between them, then its sides.
pub const PARTS: usize = MAX_PATCHES + 2;
/// The body's top.
pub const BODY: usize = MAX_PATCHES;
/// The sides.
pub const SIDE: usize = MAX_PATCHES + 1;

/// A whole spot, in the units of [`Shape::weights`].
pub const WHOLE: u32 = 255 * FRACTIONS * FRACTIONS;

/// Interpolated positions between two entries of the table, along one axis.
const FRACTIONS: u32 = 16;
/// Maximum number of entries along one axis.
const MAX_SIDE: usize = 512;
/// Radius of a spot, standard deviations.
const REACH: f64 = 3.5;

/// The top of a robot in its own frame, blurred.
#[derive(Debug, Clone)]
pub struct Shape {
    /// The body, which has the same outline as the sides.
    pub body: Body,
    /// Maximum |x| or |y| of body and patches.
    pub reach_mm: f32,
    /// Height of the top above the floor.
    pub height_mm: f64,
    /// Standard deviation of the spot.
    pub spot_mm: f32,
    entries_per_mm: f32,
    side: usize,
    /// Index of the entry at 0.
    origin: f32,
    weights: Vec<[u8; PARTS]>,
}

impl Shape {
    /// Blurs the configured top with a spot of standard deviation `spot_mm`.
    pub fn new(robots: &RobotsConfig, top: Top, spot_mm: f64) -> Self {
        // Axis-aligned, even if the layout's forward direction is over a corner.
        let body = robots.body(&[]);
        let reach_mm = reach_mm(top.patches).max(body.half_mm());
        let extent_mm = reach_mm + REACH * spot_mm;
        // Interpolation between entries 0.4 standard deviations apart has an error of 1 %.
        let step_mm = (0.4 * spot_mm).max(2.0 * extent_mm / (MAX_SIDE - 3) as f64);
        let half_side = (extent_mm / step_mm).ceil() as usize;
        let side = 2 * half_side + 1;

        // Whole quarters of a millimetre, where the edges of patches usually are.
        let fine_mm: f64 = if step_mm > 0.5 { 0.25 } else { 0.125 };
        let fine_half = (reach_mm / fine_mm).ceil() as usize;
        let fine_side = 2 * fine_half;
        let fine_at = |index: usize| (index as f64 + 0.5 - fine_half as f64) * fine_mm;
        let parts: Vec<Option<usize>> = (0..fine_side * fine_side)
            .map(|index| {
                let (x, y) = (fine_at(index % fine_side), fine_at(index / fine_side));
                match topmost_patch(top.patches, [x, y]) {
                    Some(patch) if patch < MAX_PATCHES => Some(patch),
                    _ => (body.depth_mm([x, y]) >= 0.0).then_some(BODY),
                }
            })
            .collect();

        // A spot finer than the tables would be lost between their entries.
        let blur_mm = spot_mm.max(fine_mm).max(step_mm);
        let kernel = Kernel::new(side, half_side, step_mm, fine_half, fine_mm, blur_mm);
        let mut weights = vec![[0; PARTS]; side * side];
        let mut across = vec![0.0; side * fine_side];
        for part in (0..PARTS).filter(|&part| parts.contains(&Some(part))) {
            for (row, fine) in parts.chunks_exact(fine_side).enumerate() {
                for column in 0..side {
                    across[row * side + column] =
                        kernel.sum(column, |index| f64::from(u8::from(fine[index] == Some(part))));
                }
            }
            for row in 0..side {
                for column in 0..side {
                    let weight = kernel.sum(row, |index| across[index * side + column]);
                    weights[row * side + column][part] = (weight * 255.0).round() as u8;
                }
            }
        }
        Self {
            body,
            reach_mm: reach_mm as f32,
            height_mm: top.height_mm,
            spot_mm: spot_mm as f32,
            entries_per_mm: (1.0 / step_mm) as f32,
            side,
            origin: half_side as f32,
            weights,
        }
    }

    /// The part of each area of the top that a spot at a point of the robot's frame covers, in fractions of
    /// [`WHOLE`].
    pub fn weights(&self, x_mm: f32, y_mm: f32) -> [u16; PARTS] {
        let x = x_mm * self.entries_per_mm + self.origin;
        let y = y_mm * self.entries_per_mm + self.origin;
        // Short of the last entry by more than rounding adds.
        let limit = self.side as f32 - 1.1;
        // Written this way it is false for NaN.
        if !(x >= 0.0 && y >= 0.0 && x < limit && y < limit) {
            return [0; PARTS];
        }
        let round = |value: f32| (value * FRACTIONS as f32 + 0.5) as u32;
        let (x, y) = (round(x), round(y));
        let index = (y / FRACTIONS) as usize * self.side + (x / FRACTIONS) as usize;
        let (right, below) = ((x % FRACTIONS) as u16, (y % FRACTIONS) as u16);
        let (left, above) = (FRACTIONS as u16 - right, FRACTIONS as u16 - below);
        let (top, bottom) = (&self.weights[index..index + 2], &self.weights[index + self.side..]);
        let bottom = &bottom[..2];
        let mut weights = [0; PARTS];
        for (part, weight) in weights.iter_mut().enumerate() {
            let top = u16::from(top[0][part]) * left + u16::from(top[1][part]) * right;
            let bottom = u16::from(bottom[0][part]) * left + u16::from(bottom[1][part]) * right;
            *weight = top * above + bottom * below;
        }
        weights
    }
}

/// One dimension of the spot: for each entry of the table, the fine samples it covers, with weights.
struct Kernel {
    first: Vec<usize>,
    weights: Vec<Vec<f64>>,
}

impl Kernel {
    fn new(
        side: usize,
        half_side: usize,
        step_mm: f64,
        fine_half: usize,
        fine_mm: f64,
        spot_mm: f64,
    ) -> Self {
        let mut kernel =
            Self { first: Vec::with_capacity(side), weights: Vec::with_capacity(side) };
        for entry in 0..side {
            let center_mm = (entry as f64 - half_side as f64) * step_mm;
            let center = center_mm / fine_mm + fine_half as f64;
            let reach = REACH * spot_mm / fine_mm;
            let limit = (2 * fine_half) as f64;
            let first = (center - reach).ceil().clamp(0.0, limit) as usize;
            let behind = (center + reach).floor().clamp(first as f64, limit) as usize;
            let weights = (first..behind).map(|index| {
                let distance = (index as f64 + 0.5 - center) * fine_mm / spot_mm;
                (-distance * distance / 2.0).exp() * fine_mm
                    / (spot_mm * std::f64::consts::TAU.sqrt())
            });
            kernel.first.push(first);
            kernel.weights.push(weights.collect());
        }
        kernel
    }

    fn sum(&self, entry: usize, value: impl Fn(usize) -> f64) -> f64 {
        let weights = self.weights[entry].iter().enumerate();
        weights.map(|(index, weight)| weight * value(self.first[entry] + index)).sum()
    }
}

/// The outline of a robot as the camera sees it, top and sides together: its body swept along the line of
/// sight.
#[derive(Debug, Clone, Copy)]
pub enum Outline {
    Square {
        low: [f32; 2],
        high: [f32; 2],
        /// Normal to the sweep.
        normal: [f32; 2],
        half_width: f32,
    },
    Round {
        radius: f32,
        /// Front of the sweep along x.
        front: f32,
        /// End of the sweep of the centre, and the square of its length.
        end: [f32; 2],
        length2: f32,
    },
}

impl Outline {
    /// Outline of a body around the origin. A line of sight through a point of the top meets the floor at a
    /// distance of `[x, y]` from that point.
    pub fn new(body: &Body, [x, y]: [f32; 2]) -> Self {
        let half = body.half_mm() as f32;
        if body.is_round() {
            return Self::Round {
                radius: half,
                front: body.front_mm() as f32 + (-x).max(0.0),
                end: [-x, -y],
                length2: x * x + y * y,
            };
        }
        let length = x.hypot(y);
        let normal = if length > 1e-3 { [-y / length, x / length] } else { [0.0; 2] };
        Self::Square {
            low: [-half - x.max(0.0), -half - y.max(0.0)],
            high: [half - x.min(0.0), half - y.min(0.0)],
            normal,
            half_width: if length > 1e-3 {
                half * (normal[0].abs() + normal[1].abs())
            } else {
                f32::INFINITY
            },
        }
    }

    /// Depth of a point inside; negative outside. Exact beside an edge, and too large beyond corners.
    pub fn depth(&self, x: f32, y: f32) -> f32 {
        // One machine instruction; `f32::min` takes four because of NaN.
        let lesser = |a: f32, b: f32| if a < b { a } else { b };
        match self {
            Self::Square { low, high, normal, half_width } => {
                let across = (x * normal[0] + y * normal[1]).abs();
                let along_x = lesser(x - low[0], high[0] - x);
                let along_y = lesser(y - low[1], high[1] - y);
                lesser(lesser(along_x, along_y), half_width - across)
            }
            Self::Round { radius, front, end, length2 } => {
                let along = if *length2 > 1e-6 { (x * end[0] + y * end[1]) / length2 } else { 0.0 };
                let along = along.clamp(0.0, 1.0);
                let (dx, dy) = (x - along * end[0], y - along * end[1]);
                lesser(radius - (dx * dx + dy * dy).sqrt(), front - x)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::{Config, Preset};

    fn preset_top(robots: &RobotsConfig) -> Top<'_> {
        Top { patches: &robots.patches, height_mm: robots.height_mm }
    }

    /// A square of half side 1.
    fn square() -> Body {
        let robots = RobotsConfig { size_mm: 2.0, ..Config::default().robots };
        robots.body(&[])
    }

    #[test]
    fn blurring_preserves_area_and_centroid() {
        for preset in Preset::ALL {
            let robots = preset.config().robots;
            let layout = geometry::layout::Layout::new(&robots);
            let shape = Shape::new(&robots, preset_top(&robots), 2.3);
            for (part, expected) in layout.patches.iter().enumerate() {
                let (mut area, mut x_sum, mut y_sum) = (0.0, 0.0, 0.0);
                let step = 0.35 * robots.size_mm / 75.0;
                for row in -150..=150 {
                    for column in -150..=150 {
                        let (x, y) = (f64::from(column) * step, f64::from(row) * step);
                        let weight = shape.weights(x as f32, y as f32)[part];
                        let weight = f64::from(weight) / f64::from(WHOLE) * step * step;
                        area += weight;
                        x_sum += weight * x;
                        y_sum += weight * y;
                    }
                }
                let name = preset.name();
                assert!((area / expected.area_mm2 - 1.0).abs() < 0.01, "{name}: {area}");
                let [x, y] = expected.centroid_mm;
                assert!((x_sum / area - x).abs() < 0.02, "{name}: {} for {x}", x_sum / area);
                assert!((y_sum / area - y).abs() < 0.02, "{name}: {} for {y}", y_sum / area);
            }
        }
    }

    #[test]
    fn parts_add_up_to_a_whole_spot_on_the_robot_and_to_none_beside_it() {
        let shape =
            Shape::new(&Config::default().robots, preset_top(&Config::default().robots), 2.3);
        let sum = |x: f32, y: f32| -> f64 {
            shape.weights(x, y).iter().map(|&weight| f64::from(weight)).sum::<f64>()
                / f64::from(WHOLE)
        };
        assert!((sum(0.3, -0.7) - 1.0).abs() < 0.01);
        assert!((sum(29.0, -29.0) - 1.0).abs() < 0.01);
        assert!((sum(37.5, 0.0) - 0.5).abs() < 0.02);
        assert_eq!(sum(47.0, 0.0), 0.0);
        for far in [f32::NAN, f32::INFINITY, -1e30, 1e30] {
            assert_eq!(sum(far, 0.0), 0.0);
            assert_eq!(sum(0.0, far), 0.0);
        }
    }

    #[test]
    fn extreme_spots_are_survived() {
        for spot_mm in [0.01, 0.3, 40.0] {
            let shape = Shape::new(
                &Config::default().robots,
                preset_top(&Config::default().robots),
                spot_mm,
            );
            assert!(shape.side <= MAX_SIDE && shape.weights(18.0, 18.0)[0] > 0);
        }
    }

    #[test]
    fn outlines_are_swept_squares() {
        // The floor is 3 further on along x: the square is swept to the left.
        let outline = Outline::new(&square(), [3.0, 0.0]);
        assert!((outline.depth(-2.0, 0.0) - 1.0).abs() < 1e-6);
        assert!((outline.depth(1.5, 0.0) + 0.5).abs() < 1e-6);
        assert!((outline.depth(-3.0, 1.25) + 0.25).abs() < 1e-6);
        // Along a diagonal, the two other corners are cut.
        let outline = Outline::new(&square(), [2.0, 2.0]);
        assert!(outline.depth(-3.0, -3.0).abs() < 1e-6);
        assert!(outline.depth(-2.9, 0.9) < -0.5);
        assert!(Outline::new(&square(), [0.0, 0.0]).depth(0.0, 0.0) == 1.0);
    }
}
