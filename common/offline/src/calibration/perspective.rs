//! The position of a lens of known height, from the perspective of the floor.

use super::parameters::to_normal;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Position of the lens above the floor, for a lens of known height, square pixels, and an axis through
/// `axis_px` of the undistorted picture.
///
/// For a focal length f, the columns of diag(1/f, 1/f, 1)·H are the floor's two axes and its origin in
/// the camera's frame, up to scale (Zhang, *A flexible new technique for camera calibration*, section
/// 3.1), which gives the lens position. Its height rises with f, so f is found by bisection. `None` if
/// no focal length gives the height within 1 %.
pub(super) fn lens_above(
    image_from_floor: &Matrix3<f64>,
    axis_px: Vector2<f64>,
    height_mm: f64,
) -> Option<[f64; 2]> {
    let centered = to_normal(axis_px, 1.0) * image_from_floor;
    let lens = |focal_px: f64| {
        let camera = Matrix3::from_diagonal(&Vector3::new(1.0 / focal_px, 1.0 / focal_px, 1.0));
        let columns = camera * centered;
        let (x_axis, y_axis) = (columns.column(0).into_owned(), columns.column(1).into_owned());
        let unit = (x_axis.norm() * y_axis.norm()).sqrt();
        let axes = Matrix3::from_columns(&[x_axis, y_axis, x_axis.cross(&y_axis) / unit]);
        let lens = -(axes.try_inverse()? * columns.column(2));
        lens.iter().all(|value| value.is_finite()).then_some(lens)
    };
    let (mut short, mut long) = (1.0f64, 1e6f64);
    for _ in 0..100 {
        let focal_px = (short * long).sqrt();
        if lens(focal_px)?.z.abs() < height_mm { short = focal_px } else { long = focal_px }
    }
    let found = lens((short * long).sqrt())?;
    let is_that_high = (found.z.abs() - height_mm).abs() < 0.01 * height_mm;
    is_that_high.then_some([found.x, found.y])
}
