//! Transforms between image and field: homography, lens distortion, and the parallax of points above
//! the floor.
//!
//! A point type names its frame, and transforms read output first: `field_from_image`.

use crate::lens::Lens;
use crate::points::{FieldPoint, ImagePoint};
use crate::settings::{DistortionConfig, GeometryConfig, PointPair};
use nalgebra::{DMatrix, Matrix3, Point2, Vector2, Vector3};

/// Reason why a geometry cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GeometryError {
    /// Too few point pairs.
    #[error("{0} point pairs given, at least 4 are needed")]
    TooFewPoints(usize),
    /// The points do not determine the transform.
    #[error(
        "the points do not determine the geometry: three of them lie (almost) on a line, or two coincide"
    )]
    Degenerate,
    /// The camera is not above the floor.
    #[error("the camera's height must be positive, got {0} mm")]
    CameraHeight(f64),
    /// A point is marked where a lens with these parameters shows nothing.
    #[error(
        "with this distortion the lens shows nothing at ({:.0}, {:.0}), where a point is marked: its picture ends \
         before",
        image_px[0], image_px[1]
    )]
    Distortion {
        /// The marked point.
        image_px: [f64; 2],
    },
}

/// Camera model: a homography from the floor to the rays of an ideal picture, which the lens then
/// distorts; and the lens' position C, from which height parallax follows.
///
/// A ray from the lens C (height H) to the floor at g passes height h at
///
/// ```text
/// g + (C − g)·h / H
/// ```
///
/// This is exact for any camera whose rays all pass through one point, whatever its tilt.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraModel {
    /// The sign is chosen such that the calibration points lie in front of the camera.
    ray_from_floor: Matrix3<f64>,
    floor_from_ray: Matrix3<f64>,
    position: Vector3<f64>,
    lens: Lens,
    /// A ray whose third coordinate on the floor is smaller does not meet the floor.
    horizon: f64,
}

/// Smallest third coordinate of a calibration point's ray; for a fisheye, the cosine of its angle to
/// the axis.
const MIN_DEPTH: f64 = 0.02;
/// Floor farther away than this many times the mean distance of the calibration points is beyond the
/// horizon.
const HORIZON: f64 = 1e6;

impl CameraModel {
    /// Builds the model for pictures of `width` × `height` pixels.
    pub fn new(geometry: &GeometryConfig, width: u32, height: u32) -> Result<Self, GeometryError> {
        let [_, _, camera_height] = geometry.camera_mm;
        if camera_height.is_nan() || camera_height <= 0.0 {
            return Err(GeometryError::CameraHeight(camera_height));
        }
        let lens = Lens::new(&geometry.distortion, [width, height]);
        // The points are marked in the distorted picture; the homography is fitted to their rays.
        let mut ideal = Vec::with_capacity(geometry.points.len());
        for pair in &geometry.points {
            let [ray] = lens.rays_from_image([Vector2::from(pair.image_px)]);
            // A homography cannot map the floor to rays at 90° from the axis or more; such a point
            // would spoil the fit.
            if !lens.reaches_pixel(Vector2::from(pair.image_px)) || ray.z < MIN_DEPTH {
                return Err(GeometryError::Distortion { image_px: pair.image_px });
            }
            ideal.push(PointPair { image_px: (ray.xy() / ray.z).into(), ..*pair });
        }
        let floor = geometry.points.iter().map(|pair| pair.field_mm);
        Self::assemble(homography(&ideal)?, geometry.camera_mm, lens, floor)
    }

    /// Builds the model from the homography that maps floor points to rays, for pictures of
    /// `picture_px` pixels across and down.
    pub fn from_homography(
        ray_from_floor: Matrix3<f64>,
        lens_mm: [f64; 3],
        distortion: &DistortionConfig,
        picture_px: [u32; 2],
        floor: impl Iterator<Item = [f64; 2]>,
    ) -> Result<Self, GeometryError> {
        if lens_mm[2].is_nan() || lens_mm[2] <= 0.0 {
            return Err(GeometryError::CameraHeight(lens_mm[2]));
        }
        Self::assemble(ray_from_floor, lens_mm, Lens::new(distortion, picture_px), floor)
    }

    /// Builds the model, with the sign of the homography for which these floor points lie in front.
    fn assemble(
        ray_from_floor: Matrix3<f64>,
        lens_mm: [f64; 3],
        lens: Lens,
        floor: impl Iterator<Item = [f64; 2]>,
    ) -> Result<Self, GeometryError> {
        let depth = |point: [f64; 2]| (ray_from_floor * Vector2::from(point).push(1.0)).z;
        let depths: Vec<f64> = floor.map(depth).collect();
        let is_behind = depths.iter().sum::<f64>() < 0.0;
        let ray_from_floor = if is_behind { -ray_from_floor } else { ray_from_floor };
        let mean = depths.iter().map(|depth| depth.abs()).sum::<f64>() / depths.len() as f64;
        Ok(Self {
            floor_from_ray: ray_from_floor.try_inverse().ok_or(GeometryError::Degenerate)?,
            ray_from_floor,
            position: Vector3::from(lens_mm),
            lens,
            horizon: 1.0 / (mean * HORIZON),
        })
    }

    /// Position of the lens on the field: x, y and height.
    pub fn position_mm(&self) -> [f64; 3] {
        self.position.into()
    }

    /// Image position of a point `height_mm` above `point` on the field.
    pub fn image_from_field(&self, point: FieldPoint, height_mm: f64) -> ImagePoint {
        let seen = self.lens.image_from_ray(&self.ray_from_field(point, height_mm));
        ImagePoint::new(seen.x, seen.y)
    }

    /// Field position of the point that appears at `point` and is `height_mm` above the floor. A point
    /// above the horizon is placed very far away in its direction.
    pub fn field_from_image(&self, point: ImagePoint, height_mm: f64) -> FieldPoint {
        let [place] = self.fields_from_image([point], height_mm);
        place
    }

    /// Like [`field_from_image`](Self::field_from_image), for several points in hardly more time.
    pub fn fields_from_image<const N: usize>(
        &self,
        points: [ImagePoint; N],
        height_mm: f64,
    ) -> [FieldPoint; N] {
        let pixels = points.map(|point| Vector2::new(point.x_px, point.y_px));
        let lift = height_mm / self.position.z;
        self.lens.rays_from_image(pixels).map(|ray| {
            let floor = self.floor_from_ray * ray;
            let floor = floor.xy() / floor.z.max(self.horizon);
            FieldPoint::new(
                floor.x + (self.position.x - floor.x) * lift,
                floor.y + (self.position.y - floor.y) * lift,
            )
        })
    }

    /// The point of a plane `height_mm` above the floor that is seen at `point`, and the millimetres [x, y] by
    /// which it moves with a pixel to the right and with a pixel down. Takes a third of the time of measuring
    /// these at neighbouring pixels.
    pub fn field_and_slopes(
        &self,
        point: ImagePoint,
        height_mm: f64,
    ) -> (FieldPoint, [[f64; 2]; 2]) {
        let lift = height_mm / self.position.z;
        let (ray, slopes) = self.lens.ray_and_slopes(Vector2::new(point.x_px, point.y_px));
        let floor = self.floor_from_ray * ray;
        let is_floor = floor.z > self.horizon;
        let depth = if is_floor { floor.z } else { self.horizon };
        let place = floor.xy() / depth;
        let slopes = slopes.map(|slope| {
            let moved = self.floor_from_ray * slope;
            let deeper = if is_floor { moved.z } else { 0.0 };
            let [x, y] = [0, 1].map(|axis| (moved[axis] - place[axis] * deeper) / depth);
            [x * (1.0 - lift), y * (1.0 - lift)]
        });
        let place = FieldPoint::new(
            place.x + (self.position.x - place.x) * lift,
            place.y + (self.position.y - place.y) * lift,
        );
        (place, slopes)
    }

    /// Whether the lens model is valid where the point is seen. Farther out its polynomial would turn
    /// back, and is replaced by a straight line.
    pub fn is_within_lens(&self, point: FieldPoint, height_mm: f64) -> bool {
        self.lens.reaches(&self.ray_from_field(point, height_mm))
    }

    fn ray_from_field(&self, point: FieldPoint, height_mm: f64) -> Vector3<f64> {
        let lift = height_mm / self.position.z;
        let floor = Vector3::new(
            (point.x_mm - self.position.x * lift) / (1.0 - lift),
            (point.y_mm - self.position.y * lift) / (1.0 - lift),
            1.0,
        );
        self.ray_from_floor * floor
    }

    /// Area covered by one pixel at `point`, mm² of a plane `height_mm` above the floor.
    pub fn pixel_area_mm2(&self, point: ImagePoint, height_mm: f64) -> f64 {
        let (_, [across, along]) = self.field_and_slopes(point, height_mm);
        (across[0] * along[1] - across[1] * along[0]).abs()
    }
}

/// The homography that maps field points to image points, by the normalised direct linear transform
/// (Hartley & Zisserman, *Multiple View Geometry*, algorithm 4.2). Each pair gives two equations that
/// are linear in the nine elements; the solution is the right singular vector of the smallest singular
/// value. Exact for four points, least squares for more.
pub fn homography(pairs: &[PointPair]) -> Result<Matrix3<f64>, GeometryError> {
    if pairs.len() < 4 {
        return Err(GeometryError::TooFewPoints(pairs.len()));
    }
    let field: Vec<Point2<f64>> = pairs.iter().map(|pair| Point2::from(pair.field_mm)).collect();
    let image: Vec<Point2<f64>> = pairs.iter().map(|pair| Point2::from(pair.image_px)).collect();
    let normal_from_field = normalisation(&field).ok_or(GeometryError::Degenerate)?;
    let normal_from_image = normalisation(&image).ok_or(GeometryError::Degenerate)?;

    let mut equations = DMatrix::<f64>::zeros((2 * pairs.len()).max(9), 9);
    for (index, (field, image)) in field.iter().zip(&image).enumerate() {
        let f = normal_from_field.transform_point(field);
        let i = normal_from_image.transform_point(image);
        let rows = [
            [-f.x, -f.y, -1.0, 0.0, 0.0, 0.0, i.x * f.x, i.x * f.y, i.x],
            [0.0, 0.0, 0.0, -f.x, -f.y, -1.0, i.y * f.x, i.y * f.y, i.y],
        ];
        for (offset, row) in rows.iter().enumerate() {
            for (column, value) in row.iter().enumerate() {
                equations[(2 * index + offset, column)] = *value;
            }
        }
    }
    let svd = equations.svd(false, true);
    let v_t = svd.v_t.ok_or(GeometryError::Degenerate)?;
    // Singular values come in descending order. The last is the residual; if the one before it vanishes
    // too, the solution is not unique.
    if svd.singular_values[7] < 1e-6 * svd.singular_values[0] {
        return Err(GeometryError::Degenerate);
    }
    let h = v_t.row(8);
    let normal = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]);
    // Three points on a line make the homography singular.
    let singular_values = normal.singular_values();
    if singular_values[2] < 1e-6 * singular_values[0] {
        return Err(GeometryError::Degenerate);
    }
    let image_from_normal = normal_from_image.try_inverse().ok_or(GeometryError::Degenerate)?;
    let homography = image_from_normal * normal * normal_from_field;
    if homography[(2, 2)].abs() < 1e-12 || !homography.iter().all(|value| value.is_finite()) {
        return Err(GeometryError::Degenerate);
    }
    Ok(homography / homography[(2, 2)])
}

/// The similarity that moves points to their centroid and scales them to a mean distance of √2.
fn normalisation(points: &[Point2<f64>]) -> Option<Matrix3<f64>> {
    let count = points.len() as f64;
    let centroid = points.iter().fold(Vector2::zeros(), |sum, point| sum + point.coords) / count;
    let mean = points.iter().map(|point| (point.coords - centroid).norm()).sum::<f64>() / count;
    if !(mean > 0.0 && mean.is_finite()) {
        return None;
    }
    let scale = std::f64::consts::SQRT_2 / mean;
    Some(Matrix3::new(
        scale,
        0.0,
        -scale * centroid.x,
        0.0,
        scale,
        -scale * centroid.y,
        0.0,
        0.0,
        1.0,
    ))
}
