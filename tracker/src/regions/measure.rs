//! Measures: place, area and spread of a set of pixels, in the picture and on the field.

use crate::pattern::{ExpectedPatch, principal_deviations};
use geometry::{CameraModel, FieldPoint, ImagePoint};
use messages::{Region, Run};

/// Moments of a set of pixels, from which place and shape follow.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Moments {
    pub pixels: f64,
    /// Mean column and row.
    pub x_px: f64,
    pub y_px: f64,
    /// Covariance [xx, xy, yy] of the area that the pixels cover, in square pixels: a single pixel has 1/12
    /// each way.
    pub covariance: [f64; 3],
}

/// A set of pixels on the plane of the robots' tops or of the ball's centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Measure {
    pub pixels: f64,
    /// Centroid in the image.
    pub image: ImagePoint,
    /// Centroid on the plane.
    pub position: FieldPoint,
    pub area_mm2: f64,
    /// Covariance [xx, xy, yy] in square millimetres.
    pub covariance: [f64; 3],
}

impl Moments {
    /// The moments of a region from its runs.
    pub fn of_region(region: &Region, runs: &[Run]) -> Self {
        let center = (f64::from(region.x_px), f64::from(region.y_px));
        let mut sums = MomentSums::around(center);
        for run in runs {
            sums.add_run(run);
        }
        sums.moments()
    }
}

/// Adds up moments around a point near the centroid, which keeps the sums small.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct MomentSums {
    origin: (f64, f64),
    pixels: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
}

impl MomentSums {
    pub fn around(origin: (f64, f64)) -> Self {
        Self { origin, ..Self::default() }
    }

    pub fn add_run(&mut self, run: &Run) {
        let count = f64::from(run.pixels());
        let x = (f64::from(run.begin) + f64::from(run.end) - 1.0) / 2.0 - self.origin.0;
        let y = f64::from(run.row) - self.origin.1;
        self.pixels += count;
        self.x += count * x;
        self.y += count * y;
        // A stretch of n pixels spreads by (n² − 1)/12 around its middle.
        self.xx += count * (x * x + (count * count - 1.0) / 12.0);
        self.xy += count * x * y;
        self.yy += count * y * y;
    }

    pub fn add_pixel(&mut self, x_px: f64, y_px: f64) {
        let (x, y) = (x_px - self.origin.0, y_px - self.origin.1);
        self.pixels += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
    }

    /// The moments of all pixels added; zero if there are none.
    pub fn moments(&self) -> Moments {
        if self.pixels < 1.0 {
            return Moments::default();
        }
        let (x, y) = (self.x / self.pixels, self.y / self.pixels);
        const PIXEL: f64 = 1.0 / 12.0;
        Moments {
            pixels: self.pixels,
            x_px: self.origin.0 + x,
            y_px: self.origin.1 + y,
            covariance: [
                self.xx / self.pixels - x * x + PIXEL,
                self.xy / self.pixels - x * y,
                self.yy / self.pixels - y * y + PIXEL,
            ],
        }
    }
}

impl Measure {
    /// The measure on the plane `height_mm` above the floor; `None` where the camera model has no answer, as
    /// beyond the horizon.
    pub fn new(moments: &Moments, camera: &CameraModel, height_mm: f64) -> Option<Self> {
        let image = ImagePoint::new(moments.x_px, moments.y_px);
        // Millimetres per pixel along a row (u) and along a column (v).
        let (position, [u, v]) = camera.field_and_slopes(image, height_mm);
        let [xx, xy, yy] = moments.covariance;
        let turned = |i: usize, j: usize| {
            u[i] * u[j] * xx + (u[i] * v[j] + v[i] * u[j]) * xy + v[i] * v[j] * yy
        };
        let measure = Self {
            pixels: moments.pixels,
            image,
            position,
            area_mm2: moments.pixels * (u[0] * v[1] - u[1] * v[0]).abs(),
            covariance: [turned(0, 0), turned(0, 1), turned(1, 1)],
        };
        let numbers = [position.x_mm, position.y_mm, measure.area_mm2];
        let usable = numbers.iter().chain(&measure.covariance).all(|number| number.is_finite())
            && measure.area_mm2 > 0.0;
        usable.then_some(measure)
    }

    /// The measure of both sets of pixels together.
    pub fn merged(&self, other: &Self) -> Self {
        let pixels = self.pixels + other.pixels;
        let area_mm2 = self.area_mm2 + other.area_mm2;
        let (a, b) = (self.area_mm2 / area_mm2, other.area_mm2 / area_mm2);
        let (a_px, b_px) = (self.pixels / pixels, other.pixels / pixels);
        let dx = other.position.x_mm - self.position.x_mm;
        let dy = other.position.y_mm - self.position.y_mm;
        let between = [dx * dx, dx * dy, dy * dy];
        let mut covariance = [0.0; 3];
        for (index, value) in covariance.iter_mut().enumerate() {
            *value =
                a * self.covariance[index] + b * other.covariance[index] + a * b * between[index];
        }
        Self {
            pixels,
            image: ImagePoint::new(
                a_px * self.image.x_px + b_px * other.image.x_px,
                a_px * self.image.y_px + b_px * other.image.y_px,
            ),
            position: FieldPoint::new(
                a * self.position.x_mm + b * other.position.x_mm,
                a * self.position.y_mm + b * other.position.y_mm,
            ),
            area_mm2,
            covariance,
        }
    }

    /// Standard deviations along the longer and the shorter principal axis.
    pub fn deviations_mm(&self) -> [f64; 2] {
        principal_deviations(self.covariance)
    }

    /// Area in relation to spread, as [`ExpectedPatch::compactness`].
    pub fn compactness(&self) -> f64 {
        let [major, minor] = self.deviations_mm();
        self.area_mm2 / (12.0 * major * minor).max(f64::MIN_POSITIVE)
    }

    /// Whether the pixels could be a patch or most of one, and not a rim, one or two pixels wide, of
    /// interpolated colours around a patch.
    pub fn is_shaped_like(&self, patch: &ExpectedPatch) -> bool {
        self.deviations_mm()[1] >= MIN_NARROWNESS * patch.minor_mm
            && self.compactness() >= MIN_COMPACTNESS * patch.compactness()
    }
}

/// Distance in millimetres, for inner loops: `hypot` guards against overflow beyond 10¹⁵⁴ mm and takes
/// several times as long.
pub(crate) fn distance_mm(a: FieldPoint, b: FieldPoint) -> f64 {
    let (dx, dy) = (a.x_mm - b.x_mm, a.y_mm - b.y_mm);
    (dx * dx + dy * dy).sqrt()
}

/// Least width relative to the patch's: a third of a patch is about a third as wide.
const MIN_NARROWNESS: f64 = 0.3;
/// Least compactness relative to the patch's: a ring two pixels wide around a patch of nine pixels reaches
/// 0.35.
const MIN_COMPACTNESS: f64 = 0.45;

#[cfg(test)]
mod tests {
    use super::*;
    use config::Config;

    fn block(width: u16, height: u16) -> Vec<Run> {
        (0..height)
            .map(|row| Run { row: 100 + row, begin: 200, end: 200 + width, class: 0, reserved: 0 })
            .collect()
    }

    fn moments(runs: &[Run]) -> Moments {
        let mut sums = MomentSums::around((200.0, 100.0));
        runs.iter().for_each(|run| sums.add_run(run));
        sums.moments()
    }

    #[test]
    fn a_block_spreads_as_a_rectangle() {
        let moments = moments(&block(12, 6));
        assert_eq!(moments.pixels, 72.0);
        assert!((moments.x_px - 205.5).abs() < 1e-12 && (moments.y_px - 102.5).abs() < 1e-12);
        let [xx, xy, yy] = moments.covariance;
        assert!((xx - 12.0).abs() < 1e-9 && xy.abs() < 1e-9 && (yy - 3.0).abs() < 1e-9);
    }

    #[test]
    fn pixels_and_runs_add_up_alike() {
        let runs = block(7, 5);
        let mut sums = MomentSums::around((190.0, 95.0));
        for run in &runs {
            (run.begin..run.end).for_each(|x| sums.add_pixel(f64::from(x), f64::from(run.row)));
        }
        let (a, b) = (sums.moments(), moments(&runs));
        for (a, b) in a.covariance.iter().zip(b.covariance) {
            assert!((a - b).abs() < 1e-9);
        }
    }

    #[test]
    fn halves_merge_into_the_whole() {
        let config = Config::default();
        let camera =
            CameraModel::new(&config.geometry, config.camera.width, config.camera.height).unwrap();
        let runs = block(12, 8);
        let measure = |runs: &[Run]| Measure::new(&moments(runs), &camera, 75.0).unwrap();
        let whole = measure(&runs);
        let merged = measure(&runs[..3]).merged(&measure(&runs[3..]));
        assert!((whole.area_mm2 / merged.area_mm2 - 1.0).abs() < 1e-3);
        assert!(whole.position.distance(merged.position) < 0.05);
        assert!((whole.compactness() - 1.0).abs() < 1e-6);
        assert!((merged.compactness() - 1.0).abs() < 1e-2);
    }
}
