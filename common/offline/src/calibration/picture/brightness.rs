//! Brightness of a picture along and across lines.

use geometry::ImagePoint;
use image::RgbImage;

/// Brightness of each pixel.
pub struct Brightness {
    /// Rows from the top, without padding.
    pub values: Vec<f32>,
    /// Size, px.
    pub width: usize,
    pub height: usize,
}

/// Margin around a profile that interpolation needs, px.
pub const MARGIN_PX: f64 = 4.0;
/// Samples of a profile per pixel.
const STEPS_PER_PX: usize = 4;
/// Width of a brightness step, px.
const STEP_PX: usize = 2;
/// Smallest contrast, in grey levels, of a line against the floor on both sides.
const LEAST_CONTRAST: f32 = 12.0;

impl Brightness {
    /// The brightness of a picture; the mosaic of a raw one is smoothed.
    pub fn of(picture: &RgbImage) -> Self {
        let values = picture.pixels().map(|pixel| {
            let [red, green, blue] = pixel.0.map(f32::from);
            0.25 * red + 0.5 * green + 0.25 * blue
        });
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        let brightness = Self { values: values.collect(), width, height };
        let is_grey = picture.pixels().all(|pixel| pixel.0.iter().all(|&part| part == pixel.0[0]));
        if is_grey { brightness.without_mosaic() } else { brightness }
    }

    /// The picture with its Bayer mosaic smoothed: each pixel averaged with its neighbours, so that all
    /// colours have equal weight.
    fn without_mosaic(&self) -> Self {
        let value = |index: usize| {
            let (column, row) = (index % self.width, index / self.width);
            let around = |place: usize, size: usize| {
                [(place.saturating_sub(1), 1.0), (place, 2.0), ((place + 1).min(size - 1), 1.0)]
            };
            let mut sum = 0.0;
            for (row, down) in around(row, self.height) {
                for (column, across) in around(column, self.width) {
                    sum += down * across * self.values[row * self.width + column];
                }
            }
            sum / 16.0
        };
        Self {
            values: (0..self.values.len()).map(value).collect(),
            width: self.width,
            height: self.height,
        }
    }

    /// Whether the point lies in the picture, so far from its edge.
    pub fn holds(&self, point: ImagePoint, margin_px: f64) -> bool {
        let inside =
            |value: f64, size: usize| (margin_px..size as f64 - 1.0 - margin_px).contains(&value);
        inside(point.x_px, self.width) && inside(point.y_px, self.height)
    }

    /// Brightness between pixels.
    pub fn at(&self, x: f64, y: f64) -> f32 {
        let (left, top) = (x.floor(), y.floor());
        let (right_part, down_part) = ((x - left) as f32, (y - top) as f32);
        let value = |column: usize, row: usize| {
            self.values[row.min(self.height - 1) * self.width + column.min(self.width - 1)]
        };
        let (left, top) = (left.max(0.0) as usize, top.max(0.0) as usize);
        let blend = |a: f32, b: f32, part: f32| a + part * (b - a);
        let above = blend(value(left, top), value(left + 1, top), right_part);
        let below = blend(value(left, top + 1), value(left + 1, top + 1), right_part);
        blend(above, below, down_part)
    }

    /// Brightness profile across a line, `reach_px` to each side; averaged over some pixels along the
    /// line, which also smooths the mosaic of a raw picture.
    pub fn profile(&self, here: ImagePoint, normal: [f64; 2], reach_px: f64) -> Profile {
        let steps = (2.0 * reach_px) as usize * STEPS_PER_PX + 1;
        let along = [-normal[1], normal[0]];
        let value = |index: usize| {
            let across = index as f64 / STEPS_PER_PX as f64 - reach_px;
            let sum: f32 = [-1.5, -0.5, 0.5, 1.5]
                .map(|beside| {
                    let x = here.x_px + across * normal[0] + beside * along[0];
                    let y = here.y_px + across * normal[1] + beside * along[1];
                    self.at(x, y)
                })
                .iter()
                .sum();
            sum / 4.0
        };
        Profile { values: (0..steps).map(value).collect(), reach_px }
    }
}

/// Brightness across a line.
pub struct Profile {
    values: Vec<f32>,
    reach_px: f64,
}

impl Profile {
    /// Position of the line, if exactly one is in the profile, and its width. Steps, where the floor
    /// ends at something brighter, are searched at the border only and have no width.
    pub fn line(&self, is_border: bool) -> Option<(f64, Option<f64>)> {
        if let Some([from, to]) = self.ridge() {
            return Some(((from + to) / 2.0, Some(to - from)));
        }
        if is_border { self.step().map(|place| (place, None)) } else { None }
    }

    /// Both edges of the one bright line in the profile.
    fn ridge(&self) -> Option<[f64; 2]> {
        let mut sorted = self.values.clone();
        sorted.sort_by(f32::total_cmp);
        let floor = sorted[sorted.len() / 4];
        let top = *sorted.last()?;
        if top - floor < LEAST_CONTRAST {
            return None;
        }
        let level = (floor + top) / 2.0;
        let above: Vec<usize> =
            (0..self.values.len()).filter(|&index| self.values[index] > level).collect();
        let (&first, &last) = (above.first()?, above.last()?);
        let is_whole = last - first + 1 == above.len();
        let is_inside = first > 2 && last + 3 < self.values.len();
        if !is_whole || !is_inside {
            return None;
        }
        // Both sides must be floor.
        let side = |range: std::ops::Range<usize>| {
            let values = &self.values[range];
            values.iter().sum::<f32>() / values.len().max(1) as f32
        };
        let (before, behind) =
            (side(0..first.saturating_sub(2).max(1)), side(last + 3..self.values.len()));
        let rise = (top - before).min(top - behind);
        if rise < LEAST_CONTRAST || (before - behind).abs() > 0.4 * rise {
            return None;
        }
        Some([
            self.crossing(first, (before + top) / 2.0)?,
            self.crossing(last + 1, (behind + top) / 2.0)?,
        ])
    }

    /// The step from something brighter outside down to the floor: the last step of the profile, because
    /// the floor is even.
    fn step(&self) -> Option<f64> {
        let far = STEP_PX * STEPS_PER_PX;
        let falls = |index: usize| self.values[index - far] - self.values[index + far];
        let places = far..self.values.len().checked_sub(far)?;
        let steepest = places.clone().map(falls).fold(0.0, f32::max);
        if steepest < LEAST_CONTRAST {
            return None;
        }
        let last = places.rev().find(|&index| falls(index) > 0.7 * steepest)?;
        // Backwards to the steepest fall.
        let index = (far.max(last.saturating_sub(2 * far))..=last)
            .max_by(|&a, &b| falls(a).total_cmp(&falls(b)))?;
        let level = (self.values[index - far] + self.values[index + far]) / 2.0;
        self.crossing(index, level)
    }

    /// Position where the profile crosses a level near this sample, in pixels from its middle.
    fn crossing(&self, near: usize, level: f32) -> Option<f64> {
        let range = near.saturating_sub(6).max(1)..(near + 6).min(self.values.len());
        let crosses =
            |&index: &usize| (self.values[index - 1] > level) != (self.values[index] > level);
        let index = range.filter(crosses).min_by_key(|index| index.abs_diff(near))?;
        let (before, behind) = (self.values[index - 1], self.values[index]);
        let part = f64::from((level - before) / (behind - before));
        Some((index as f64 - 1.0 + part) / STEPS_PER_PX as f64 - self.reach_px)
    }
}
