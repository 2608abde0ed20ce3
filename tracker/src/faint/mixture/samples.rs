//! Samples of the raw picture around a robot, for the [mixture](super) model.

use super::{LANES, MOST_PLACES, Mixture, PARTS};
use crate::pattern::Top;
use crate::raw::{CHANNELS, RawFrame};
use geometry::{CameraModel, FieldPoint, ImagePoint};

/// Samples that are made of the pixels around a robot, about.
const SAMPLES: f64 = 180.0;
/// Most samples. A sample covers an even number of pixels each way, so there may be more than [`SAMPLES`].
const MOST_SAMPLES: usize = 512;
const _: () = assert!(MOST_SAMPLES.is_multiple_of(LANES));
/// Least excess of a line's level over the ground, in grey levels.
const LINE_LEVEL: f32 = 25.0;
/// Least ratio of the darkest to the brightest channel of what counts as grey.
const GREYNESS: f32 = 0.7;

/// The pixels around a robot, averaged over small squares.
#[derive(Debug, Clone)]
pub(crate) struct Samples {
    pub(super) origin: FieldPoint,
    pub(super) count: usize,
    pub(super) x_mm: [f32; MOST_SAMPLES],
    pub(super) y_mm: [f32; MOST_SAMPLES],
    pub(super) levels: [[f32; MOST_SAMPLES]; CHANNELS],
    /// Sum of the squares of a sample's levels.
    pub(super) squares: [f32; MOST_SAMPLES],
    /// 1 for each sample, and 0 for the surplus lanes of the last register.
    pub(super) is_there: [f32; MOST_SAMPLES],
    /// Cell of the table for each point along the motion, at the pose that is being tried.
    pub(super) cells: [[u32; MOST_SAMPLES]; MOST_PLACES],
    /// At that pose: weights, and the share of each part.
    pub(super) weights: [f32; MOST_SAMPLES],
    pub(super) shares: [[f32; MOST_SAMPLES]; PARTS],
    /// Scratch memory for medians.
    sorted: [f32; MOST_SAMPLES],
}

impl Samples {
    /// Takes the samples within the robot's reach of a team patch at `place` on the plane of the tops, except
    /// those at which `is_other` says that another robot is.
    pub fn take(
        &mut self,
        mixture: &Mixture,
        top: &Top,
        camera: &CameraModel,
        frame: &RawFrame,
        place: FieldPoint,
        is_other: impl Fn(FieldPoint) -> bool,
    ) {
        self.count = 0;
        self.collect(mixture, top, camera, frame, place, is_other);
        self.finish();
    }

    fn collect(
        &mut self,
        mixture: &Mixture,
        top: &Top,
        camera: &CameraModel,
        frame: &RawFrame,
        place: FieldPoint,
        is_other: impl Fn(FieldPoint) -> bool,
    ) {
        let height_mm = top.height_mm;
        let center = camera.image_from_field(place, height_mm);
        let mm_per_px = camera.pixel_area_mm2(center, height_mm).sqrt();
        let reach_mm = mixture.sample_reach_mm(top);
        let reach_px = reach_mm / mm_per_px;
        let is_usable = center.x_px.is_finite() && center.y_px.is_finite() && reach_px < 1e4;
        if !is_usable || reach_px < 1.0 {
            return;
        }
        // Even, so that each sample covers all channels of a Bayer mosaic.
        let step = (std::f64::consts::PI * reach_px * reach_px / SAMPLES).sqrt();
        let step = (2.0 * (step / 2.0).round()).max(2.0) as i64;
        let at = |x: f64, y: f64| camera.field_from_image(ImagePoint::new(x, y), height_mm);
        let first = |center: f64| ((center - reach_px) as i64 / step * step).max(0);
        let (left, top) = (first(center.x_px), first(center.y_px));
        let last = |center: f64, end: usize| ((center + reach_px) as i64).min(end as i64 - step);
        self.origin = place;
        // Over a robot the map from pixels to millimetres is linear to a fraction of a pixel.
        let here = at(center.x_px, center.y_px);
        let (right, down) =
            (at(center.x_px + 1.0, center.y_px), at(center.x_px, center.y_px + 1.0));
        let right = [right.x_mm - here.x_mm, right.y_mm - here.y_mm];
        let down = [down.x_mm - here.x_mm, down.y_mm - here.y_mm];
        for row in (top..=last(center.y_px, frame.height)).step_by(step as usize) {
            for column in (left..=last(center.x_px, frame.width)).step_by(step as usize) {
                let middle = (step - 1) as f64 / 2.0;
                let dx = column as f64 + middle - center.x_px;
                let dy = row as f64 + middle - center.y_px;
                let offset = [0, 1].map(|axis| dx * right[axis] + dy * down[axis]);
                let there = FieldPoint::new(place.x_mm + offset[0], place.y_mm + offset[1]);
                if offset[0].hypot(offset[1]) > reach_mm || is_other(there) {
                    continue;
                }
                let levels = frame.mean(row as usize, column as usize, step as usize);
                if self.count == MOST_SAMPLES {
                    return;
                }
                [self.x_mm[self.count], self.y_mm[self.count]] = offset.map(|value| value as f32);
                for (all, level) in self.levels.iter_mut().zip(levels) {
                    all[self.count] = level;
                }
                self.count += 1;
            }
        }
    }

    /// Completes what follows from the levels. Surplus lanes get no stale values: those might be infinite.
    pub(super) fn finish(&mut self) {
        let whole = self.count.next_multiple_of(LANES);
        for list in self.levels.iter_mut().chain([&mut self.is_there]) {
            list[self.count..whole].fill(0.0);
        }
        self.is_there[..self.count].fill(1.0);
        let [red, green, blue] = &self.levels;
        for (square, ((r, g), b)) in
            self.squares[..whole].iter_mut().zip(red.iter().zip(green).zip(blue))
        {
            *square = r * r + g * g + b * b;
        }
    }

    pub fn count(&self) -> usize {
        self.count
    }

    /// Removes samples that are brighter than the ground (the median) by about as much in every channel:
    /// lines and walls. For robots whose patches all have a hue.
    pub fn drop_lines(&mut self) {
        let count = self.count;
        if count == 0 {
            return;
        }
        let ground: [f32; CHANNELS] = std::array::from_fn(|channel| {
            let sorted = &mut self.sorted[..count];
            sorted.copy_from_slice(&self.levels[channel][..count]);
            *sorted.select_nth_unstable_by(count / 2, f32::total_cmp).1
        });
        self.count = 0;
        for index in 0..count {
            let levels = self.levels.map(|levels| levels[index]);
            let above: [f32; CHANNELS] =
                std::array::from_fn(|channel| levels[channel] - ground[channel]);
            let least = above.iter().copied().fold(f32::INFINITY, f32::min);
            let most = above.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            if most < LINE_LEVEL || least < GREYNESS * most {
                self.x_mm[self.count] = self.x_mm[index];
                self.y_mm[self.count] = self.y_mm[index];
                for (all, level) in self.levels.iter_mut().zip(levels) {
                    all[self.count] = level;
                }
                self.count += 1;
            }
        }
        self.finish();
    }
}

/// Whether a colour is neither white, grey nor black.
pub(crate) fn has_hue(color: &[f64; CHANNELS]) -> bool {
    let least = color.iter().copied().fold(f64::INFINITY, f64::min);
    let most = color.iter().copied().fold(0.0, f64::max);
    least < f64::from(GREYNESS) * most
}

impl Default for Samples {
    fn default() -> Self {
        Self {
            origin: FieldPoint::default(),
            count: 0,
            x_mm: [0.0; MOST_SAMPLES],
            y_mm: [0.0; MOST_SAMPLES],
            levels: [[0.0; MOST_SAMPLES]; CHANNELS],
            squares: [0.0; MOST_SAMPLES],
            is_there: [0.0; MOST_SAMPLES],
            weights: [0.0; MOST_SAMPLES],
            shares: [[0.0; MOST_SAMPLES]; PARTS],
            cells: [[0; MOST_SAMPLES]; MOST_PLACES],
            sorted: [0.0; MOST_SAMPLES],
        }
    }
}
