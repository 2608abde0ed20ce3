//! The fitted parameters of a camera, and the scales that bring them to order one.

use super::Mark;
use super::fit::POLYNOMIAL;
use super::physical::QuickCamera;
use config::{DistortionConfig, DistortionModel};
use geometry::lens::Lens;
use geometry::{CameraModel, GeometryError};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Parameters of a camera, scaled to order one: the homography from the floor to the undistorted
/// picture, both normalised; the lens position in units of the floor's scale; k1, k2 and the
/// distortion's centre.
#[derive(Debug, Clone, Copy)]
pub(super) struct Parameters(pub [f64; COUNT]);

pub(super) const COUNT: usize = HOMOGRAPHY + 3 + POLYNOMIAL;
pub(super) const HOMOGRAPHY: usize = 8;
pub(super) const LENS: usize = HOMOGRAPHY;
pub(super) const DISTORTION: usize = LENS + 3;

/// Offset and scale that bring floor points and pixels to order one.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scales {
    pub field_center_mm: Vector2<f64>,
    pub field_scale_mm: f64,
    pub image_center_px: Vector2<f64>,
    pub half_diagonal_px: f64,
}

impl Parameters {
    pub fn new(
        scales: &Scales,
        image_from_floor: &Matrix3<f64>,
        lens: Vector3<f64>,
        k1: f64,
    ) -> Self {
        let normal = scales.normal_from_image() * image_from_floor * scales.floor_from_normal();
        let normal = normal / normal[(2, 2)];
        let mut values = [0.0; COUNT];
        for (index, value) in values.iter_mut().take(HOMOGRAPHY).enumerate() {
            *value = normal[(index / 3, index % 3)];
        }
        values[DISTORTION] = k1;
        Self(values).with_lens(scales, lens)
    }

    /// The same camera with the lens at another position.
    pub fn with_lens(mut self, scales: &Scales, lens_mm: Vector3<f64>) -> Self {
        let lens = scales.normal_lens(lens_mm.into());
        self.0[LENS..DISTORTION].copy_from_slice(lens.as_slice());
        self
    }

    fn homography(&self) -> Matrix3<f64> {
        let h = &self.0;
        Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0)
    }

    pub fn lens_mm(&self, scales: &Scales) -> Vector3<f64> {
        let [x, y, z] = [0, 1, 2].map(|axis| self.0[LENS + axis] * scales.field_scale_mm);
        Vector3::new(scales.field_center_mm.x + x, scales.field_center_mm.y + y, z)
    }

    pub fn distortion(&self, scales: &Scales) -> DistortionConfig {
        let [k1, k2, x, y] = [0, 1, 2, 3].map(|index| self.0[DISTORTION + index]);
        let center = scales.image_center_px + Vector2::new(x, y) * scales.half_diagonal_px;
        DistortionConfig {
            model: DistortionModel::Polynomial,
            k1,
            k2,
            center_px: center.into(),
            ..DistortionConfig::default()
        }
    }

    pub fn through(&self, scales: &Scales, picture_px: [u32; 2]) -> QuickCamera {
        QuickCamera {
            ray_from_floor: self.ray_from_floor(scales),
            position: self.lens_mm(scales),
            lens: Lens::new(&self.distortion(scales), picture_px),
        }
    }

    pub fn ray_from_floor(&self, scales: &Scales) -> Matrix3<f64> {
        scales.image_from_normal() * self.homography() * scales.normal_from_floor()
    }

    pub fn model(
        &self,
        scales: &Scales,
        picture_px: [u32; 2],
        marks: &[Mark],
    ) -> Result<CameraModel, GeometryError> {
        CameraModel::from_homography(
            self.ray_from_floor(scales),
            self.lens_mm(scales).into(),
            &self.distortion(scales),
            picture_px,
            marks.iter().map(|mark| [mark.field_mm[0], mark.field_mm[1]]),
        )
    }
}

impl Scales {
    /// A lens position in the floor's scale.
    pub fn normal_lens(&self, [x, y, z]: [f64; 3]) -> Vector3<f64> {
        let offset = Vector2::new(x, y) - self.field_center_mm;
        Vector3::new(offset.x, offset.y, z) / self.field_scale_mm
    }

    pub fn normal_from_floor(&self) -> Matrix3<f64> {
        to_normal(self.field_center_mm, self.field_scale_mm)
    }

    pub fn floor_from_normal(&self) -> Matrix3<f64> {
        from_normal(self.field_center_mm, self.field_scale_mm)
    }

    pub fn normal_from_image(&self) -> Matrix3<f64> {
        to_normal(self.image_center_px, self.half_diagonal_px)
    }

    pub fn image_from_normal(&self) -> Matrix3<f64> {
        from_normal(self.image_center_px, self.half_diagonal_px)
    }
}

pub(super) fn to_normal(center: Vector2<f64>, scale: f64) -> Matrix3<f64> {
    let (s, c) = (1.0 / scale, center / scale);
    Matrix3::new(s, 0.0, -c.x, 0.0, s, -c.y, 0.0, 0.0, 1.0)
}

pub(super) fn from_normal(center: Vector2<f64>, scale: f64) -> Matrix3<f64> {
    Matrix3::new(scale, 0.0, center.x, 0.0, scale, center.y, 0.0, 0.0, 1.0)
}
