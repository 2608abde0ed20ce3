//! Radial lens models: from rays to pixels and back.
//!
//! Both models move a ray's image along the line through the centre. At distance x for an ideal lens, it
//! appears at
//!
//! ```text
//! x·(1 + k1·x² + k2·x⁴ + k3·x⁶ + k4·x⁸)
//! ```
//!
//! * `polynomial`: x is the radius in an ideal picture, f·tan θ for a ray at angle θ from the axis, in
//!   half diagonals; only k1 and k2 are used (Brown, *Close-range camera calibration*, 1971). For
//!   lenses that are meant to show straight lines straight.
//! * `fisheye`: x is the angle θ itself, and the focal length gives the scale (Kannala & Brandt, *A
//!   generic camera model and calibration method for conventional, wide-angle, and fish-eye lenses*,
//!   2006; OpenCV's `fisheye`). For all others: their ideal picture would be many times as large, and
//!   infinite at 90°.
//!
//! A polynomial that fits the pitch may turn back beyond it, where no point was marked. From its
//! turning point on it is continued by its tangent, so that every pixel has one ray and every ray one
//! pixel. The inverse is found by Newton's method, safeguarded by bisection (Press et al., *Numerical
//! Recipes*, `rtsafe`).

use crate::settings::{DistortionConfig, DistortionModel};
use nalgebra::{Vector2, Vector3};
use std::f64::consts::PI;

/// A radial lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    model: DistortionModel,
    center: Vector2<f64>,
    /// Pixels per unit of the radius: half the picture's diagonal, or the fisheye's focal length.
    scale_px: f64,
    k: [f64; 4],
    /// Largest radius at which the polynomial is used.
    limit: f64,
    /// Value of the polynomial at the limit.
    limit_value: f64,
    /// Slope of the tangent beyond the limit.
    limit_slope: f64,
}

/// Slope below which the polynomial counts as turning back.
const MIN_SLOPE: f64 = 0.05;
/// Largest limit of the `polynomial` model, in half diagonals of the ideal picture.
const MAX_RADIUS: f64 = 10.0;
/// Steps in the search for the turning point.
const STEPS: u32 = 200;
/// Most Newton steps. Usually four suffice.
const MAX_NEWTON_STEPS: u32 = 60;

impl Lens {
    /// The lens of a camera with pictures of `picture_px` pixels across and down.
    pub fn new(distortion: &DistortionConfig, picture_px: [u32; 2]) -> Self {
        let &DistortionConfig { model, focal_px, k1, k2, k3, k4, center_px } = distortion;
        let [width, height] = picture_px.map(f64::from);
        let (scale_px, k, farthest) = match model {
            DistortionModel::Polynomial => {
                (width.hypot(height) / 2.0, [k1, k2, 0.0, 0.0], MAX_RADIUS)
            }
            DistortionModel::Fisheye => (focal_px, [k1, k2, k3, k4], PI),
        };
        let limit = limit(&k, farthest);
        Self {
            model,
            center: Vector2::from(center_px),
            scale_px,
            k,
            limit,
            limit_value: distorted(&k, limit),
            limit_slope: slope(&k, limit).max(MIN_SLOPE),
        }
    }

    /// Whether the polynomial is used for a ray.
    pub fn reaches(&self, ray: &Vector3<f64>) -> bool {
        self.radius(ray) <= self.limit
    }

    /// Whether the polynomial is used for a pixel.
    pub fn reaches_pixel(&self, pixel: Vector2<f64>) -> bool {
        (pixel - self.center).norm() <= self.limit_value * self.scale_px
    }

    /// The pixel at which a ray is seen. A ray is a point of the ideal picture, in pixels, times a
    /// third coordinate, which is negative behind the camera.
    #[inline]
    pub fn image_from_ray(&self, ray: &Vector3<f64>) -> Vector2<f64> {
        match self.model {
            DistortionModel::Polynomial => {
                let offset = ray.xy() / ray.z - self.center;
                let r = offset.norm() / self.scale_px;
                if r <= self.limit {
                    self.center + offset * even(&self.k, r * r)
                } else {
                    self.center + offset * (self.distort(r) / r)
                }
            }
            DistortionModel::Fisheye => {
                let offset = ray.xy() - self.center * ray.z;
                let across = offset.norm();
                let along = self.scale_px * ray.z;
                if across <= 1e-9 * along {
                    return self.center + offset / ray.z;
                }
                let angle = across.atan2(along);
                self.center + offset * (self.distort(angle) * self.scale_px / across)
            }
        }
    }

    /// The rays seen at these pixels, by Newton's method on the polynomial, which is monotonic up to
    /// its limit. The points are iterated together, because the latency of consecutive divisions
    /// dominates.
    #[inline]
    pub fn rays_from_image<const N: usize>(&self, pixels: [Vector2<f64>; N]) -> [Vector3<f64>; N] {
        let mut seen = [0.0; N];
        for (seen, pixel) in seen.iter_mut().zip(&pixels) {
            *seen = (pixel - self.center).norm() / self.scale_px;
        }
        let radii = self.undistort(seen);
        let mut rays = [Vector3::zeros(); N];
        for (index, ray) in rays.iter_mut().enumerate() {
            let (pixel, radius, seen) = (pixels[index], radii[index], seen[index]);
            // The centre has no direction.
            let is_center = seen < 1e-12;
            *ray = match self.model {
                _ if is_center => pixel.push(1.0),
                DistortionModel::Polynomial => {
                    (self.center + (pixel - self.center) * (radius / seen)).push(1.0)
                }
                DistortionModel::Fisheye => {
                    let (sin, cos) = radius.min(PI).sin_cos();
                    ((pixel - self.center) * (sin / seen) + self.center * cos).push(cos)
                }
            };
        }
        rays
    }

    /// The ray seen at a pixel, and its derivatives by the pixel's column and row.
    #[inline]
    pub fn ray_and_slopes(&self, pixel: Vector2<f64>) -> (Vector3<f64>, [Vector3<f64>; 2]) {
        let offset = pixel - self.center;
        let seen = offset.norm() / self.scale_px;
        let [radius] = self.undistort([seen]);
        let is_center = seen < 1e-12;
        // How the radius grows with the one that is seen, and the ratio of the two.
        let (growth, ratio) = if is_center {
            (1.0, 1.0)
        } else if radius > self.limit {
            (1.0 / self.limit_slope, radius / seen)
        } else {
            (1.0 / slope(&self.k, radius), radius / seen)
        };
        let direction = if is_center { Vector2::zeros() } else { offset / offset.norm() };
        // d(offset·f)/d(axis) = f·e + offset·(df/d seen)·direction / scale, for a factor f of the radius.
        let scaled = |factor: f64, bend: f64, axis: usize| {
            let mut slope = direction * (direction[axis] * bend);
            slope[axis] += factor;
            slope
        };
        match self.model {
            DistortionModel::Polynomial => {
                let ray = (self.center + offset * ratio).push(1.0);
                // offset·f = radius·scale·direction.
                let slopes = [0, 1].map(|axis| scaled(ratio, growth - ratio, axis).push(0.0));
                (ray, slopes)
            }
            DistortionModel::Fisheye => {
                let angle = radius.min(PI);
                let (sin, cos) = angle.sin_cos();
                let turn = if radius > PI { 0.0 } else { growth };
                let ratio = if is_center { 1.0 } else { sin / seen };
                let ray = (offset * ratio + self.center * cos).push(cos);
                let slopes = [0, 1].map(|axis| {
                    // The angle grows by `turn` / scale for a pixel along `direction`.
                    let falls = -sin * turn * direction[axis] / self.scale_px;
                    (scaled(ratio, cos * turn - ratio, axis) + self.center * falls).push(falls)
                });
                (ray, slopes)
            }
        }
    }

    /// Distance of a ray from the axis, as radius or as angle.
    fn radius(&self, ray: &Vector3<f64>) -> f64 {
        match self.model {
            DistortionModel::Polynomial => (ray.xy() / ray.z - self.center).norm() / self.scale_px,
            DistortionModel::Fisheye => {
                (ray.xy() - self.center * ray.z).norm().atan2(self.scale_px * ray.z)
            }
        }
    }

    /// Distorted radius: the polynomial, or its tangent beyond the limit.
    fn distort(&self, radius: f64) -> f64 {
        if radius <= self.limit {
            distorted(&self.k, radius)
        } else {
            self.limit_value + self.limit_slope * (radius - self.limit)
        }
    }

    /// Inverse of [`distort`](Self::distort).
    fn undistort<const N: usize>(&self, seen: [f64; N]) -> [f64; N] {
        let mut radius = seen.map(|seen| seen.min(self.limit));
        // Bracket of the solution. If a step is not at most half as long as the one before, or leaves
        // the bracket, the bracket is bisected instead: Newton's method alone can oscillate for ever.
        let (mut least, mut most) = ([0.0; N], [self.limit; N]);
        let mut last_step = [self.limit; N];
        let mut is_moving = [true; N];
        for index in 0..N {
            if seen[index] >= self.limit_value {
                radius[index] = self.limit + (seen[index] - self.limit_value) / self.limit_slope;
                is_moving[index] = false;
            }
        }
        for _ in 0..MAX_NEWTON_STEPS {
            if !is_moving.contains(&true) {
                break;
            }
            for index in 0..N {
                let r = radius[index];
                let error = distorted(&self.k, r) - seen[index];
                let step = error / slope(&self.k, r);
                let is_beyond = error > 0.0;
                let low = if is_beyond { least[index] } else { r };
                let high = if is_beyond { r } else { most[index] };
                (least[index], most[index]) = (low, high);
                let newton = r - step;
                let is_between = low <= newton && newton <= high;
                let is_closing_in = 2.0 * step.abs() <= last_step[index];
                let next = if is_between && is_closing_in { newton } else { (low + high) / 2.0 };
                last_step[index] = (next - r).abs();
                // The next step would be of the order of this one squared.
                radius[index] = if is_moving[index] { next } else { r };
                is_moving[index] &= step.abs() >= 1e-7;
            }
        }
        radius
    }
}

/// Largest radius up to which the polynomial rises.
fn limit(k: &[f64; 4], farthest: f64) -> f64 {
    let step = farthest / f64::from(STEPS);
    let is_growing = |radius: f64| slope(k, radius) > MIN_SLOPE;
    let growing = (1..=STEPS).take_while(|&index| is_growing(step * f64::from(index))).count();
    let mut inside = step * growing as f64;
    if growing < STEPS as usize {
        let mut outside = inside + step;
        for _ in 0..30 {
            let middle = (inside + outside) / 2.0;
            if is_growing(middle) { inside = middle } else { outside = middle }
        }
    }
    inside
}

/// The polynomial: x·(1 + k1·x² + k2·x⁴ + k3·x⁶ + k4·x⁸).
fn distorted(k: &[f64; 4], x: f64) -> f64 {
    x * even(k, x * x)
}

fn even([k1, k2, k3, k4]: &[f64; 4], x2: f64) -> f64 {
    1.0 + x2 * (k1 + x2 * (k2 + x2 * (k3 + x2 * k4)))
}

/// Derivative of the polynomial.
fn slope([k1, k2, k3, k4]: &[f64; 4], x: f64) -> f64 {
    let x2 = x * x;
    1.0 + x2 * (3.0 * k1 + x2 * (5.0 * k2 + x2 * (7.0 * k3 + x2 * 9.0 * k4)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PICTURE: [u32; 2] = [640, 480];

    fn any_lens() -> impl Strategy<Value = DistortionConfig> {
        let center = (280.0..360.0f64, 200.0..280.0f64);
        let polynomial = (-0.4..0.3f64, -0.1..0.1f64).prop_map(|(k1, k2)| DistortionConfig {
            k1,
            k2,
            ..DistortionConfig::default()
        });
        let fisheye = (120.0..600.0f64, prop::array::uniform4(-0.05..0.05f64)).prop_map(
            |(focal_px, [k1, k2, k3, k4])| DistortionConfig {
                model: DistortionModel::Fisheye,
                focal_px,
                k1,
                k2: k2 / 4.0,
                k3: k3 / 16.0,
                k4: k4 / 64.0,
                ..DistortionConfig::default()
            },
        );
        (prop_oneof![polynomial, fisheye], center)
            .prop_map(|(lens, (x, y))| DistortionConfig { center_px: [x, y], ..lens })
    }

    proptest! {
        /// Every pixel, also far outside the picture, has a ray that is seen at that pixel.
        #[test]
        fn pixels_and_rays_belong_together(
            distortion in any_lens(), x in -300.0..900.0f64, y in -300.0..800.0f64,
        ) {
            let lens = Lens::new(&distortion, PICTURE);
            let pixel = Vector2::new(x, y);
            let [ray] = lens.rays_from_image([pixel]);
            // A fisheye sees nothing at more than 180° from its axis.
            prop_assume!(distortion.model == DistortionModel::Polynomial || lens.radius(&ray) < 3.1);
            let back = lens.image_from_ray(&ray);
            prop_assert!((back - pixel).norm() < 1e-6, "{back:?} {ray:?}");
            let [_, both] = lens.rays_from_image([Vector2::new(10.0, 20.0), pixel]);
            prop_assert_eq!(ray, both);
        }

        /// Derivatives are the limits of differences, except at the radius where the polynomial ends.
        #[test]
        fn slopes_are_those_of_the_rays(
            distortion in any_lens(), x in -300.0..900.0f64, y in -300.0..800.0f64,
        ) {
            let lens = Lens::new(&distortion, PICTURE);
            for pixel in [Vector2::new(x, y), Vector2::from(distortion.center_px)] {
                let (ray, slopes) = lens.ray_and_slopes(pixel);
                let [same] = lens.rays_from_image([pixel]);
                prop_assert!((ray - same).norm() < 1e-9, "{ray:?} {same:?}");
                const STEP_PX: f64 = 0.01;
                let steps = [Vector2::new(STEP_PX, 0.0), Vector2::new(0.0, STEP_PX)];
                for (step, slope) in steps.into_iter().zip(slopes) {
                    let [before, after] = lens.rays_from_image([pixel - step, pixel + step]);
                    prop_assume!(
                        [before, after].iter().all(|it| (lens.radius(it) - lens.limit).abs() > 0.001)
                    );
                    let measured = (after - before) / (2.0 * STEP_PX);
                    let off = (slope - measured).norm();
                    prop_assert!(off < 2e-4 * (1.0 + measured.norm()), "{slope:?} {measured:?}");
                }
            }
        }

        /// A ray farther from the axis is seen farther from the centre.
        #[test]
        fn nothing_is_folded_over(distortion in any_lens(), a in 0.0..3.0f64, b in 0.0..3.0f64) {
            let lens = Lens::new(&distortion, PICTURE);
            prop_assert_eq!(a < b, lens.distort(a) < lens.distort(b));
        }
    }

    /// Newton's steps from one end of this polynomial lead beyond the other end, and back from there.
    #[test]
    fn steps_beyond_both_ends_come_to_rest() {
        let distortion = DistortionConfig {
            model: DistortionModel::Fisheye,
            focal_px: 258.3556423107956,
            k1: 0.03788477121083207,
            k2: 0.011890040844912887,
            k4: -0.0006226545235536105,
            center_px: [280.0, 200.0],
            ..DistortionConfig::default()
        };
        let lens = Lens::new(&distortion, PICTURE);
        let pixel = Vector2::new(-274.01545027207817, 0.0);
        let [ray] = lens.rays_from_image([pixel]);
        let back = lens.image_from_ray(&ray);
        assert!((back - pixel).norm() < 1e-6, "{back:?}");
    }

    #[test]
    fn the_fisheye_is_opencvs() {
        let distortion = DistortionConfig {
            model: DistortionModel::Fisheye,
            focal_px: 300.0,
            k1: 0.02,
            k2: -0.004,
            k3: 0.001,
            k4: -0.0002,
            center_px: [330.0, 235.0],
        };
        // cv::fisheye::projectPoints, derived from its documentation: x = 0.8, y = −0.6 at depth 1.
        let theta = 1f64.atan();
        let (t2, t4) = (theta.powi(2), theta.powi(4));
        let distorted = theta * (1.0 + 0.02 * t2 - 0.004 * t4 + 0.001 * t4 * t2 - 0.0002 * t4 * t4);
        let expected =
            Vector2::new(330.0 + 300.0 * distorted * 0.8, 235.0 - 300.0 * distorted * 0.6);
        let ideal = Vector3::new(330.0 + 300.0 * 0.8, 235.0 - 300.0 * 0.6, 1.0);
        let lens = Lens::new(&distortion, PICTURE);
        for depth in [1.0, 0.01, 50.0] {
            assert!((lens.image_from_ray(&(ideal * depth)) - expected).norm() < 1e-9);
        }
    }

    #[test]
    fn a_fisheye_sees_what_is_beside_the_camera() {
        let distortion = DistortionConfig {
            model: DistortionModel::Fisheye,
            focal_px: 150.0,
            k1: 0.0,
            ..DistortionConfig::default()
        };
        let lens = Lens::new(&distortion, PICTURE);
        let beside = lens.image_from_ray(&Vector3::new(150.0, 0.0, 0.0));
        assert!((beside.x - (319.5 + 150.0 * PI / 2.0)).abs() < 1e-9, "{beside:?}");
        let [ray] = lens.rays_from_image([beside]);
        assert!(ray.z.abs() < 1e-9 && ray.x > 0.0, "{ray:?}");
    }
}
