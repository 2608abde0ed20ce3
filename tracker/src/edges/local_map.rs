//! Local map: the camera model near one place as a polynomial of second order, cheap enough for every pixel.

use geometry::{CameraModel, FieldPoint, ImagePoint, Pose};

/// The map from pixels to millimetres in a body's frame, to second order around the body's place. The error
/// of third order is some thousandths of a pixel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LocalMap {
    pub center: ImagePoint,
    /// For x and y: coefficients of u, v, u², uv, v², where (u, v) are pixels from the centre.
    terms: [[f32; 5]; 2],
}

/// One row of the picture through a [`LocalMap`]: for x and y the coefficients of 1, u, u².
pub(crate) type RowMap = [[f32; 3]; 2];

impl LocalMap {
    /// The map for a body of the reach `reach_mm` at `pose` on a plane `height_mm` above the floor, in pixels
    /// of about `mm_per_px`. `None` where the camera model has no answer.
    pub fn new(
        camera: &CameraModel,
        pose: &Pose,
        height_mm: f64,
        reach_mm: f64,
        mm_per_px: f64,
    ) -> Option<Self> {
        let center = camera.image_from_field(pose.position, height_mm);
        // Differences between points at about the body's reach.
        let step = (reach_mm / mm_per_px).clamp(1.0, 1000.0);
        let (sin, cos) = pose.orientation.sin_cos();
        let around = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 1.0), (-1.0, -1.0)];
        let around =
            around.map(|(u, v)| ImagePoint::new(center.x_px + u * step, center.y_px + v * step));
        let places = camera.fields_from_image(around, height_mm);
        let [right, left, down, up, near, far] = places.map(|FieldPoint { x_mm, y_mm }| {
            let (dx, dy) = (x_mm - pose.position.x_mm, y_mm - pose.position.y_mm);
            [cos * dx + sin * dy, cos * dy - sin * dx]
        });
        let terms = [0, 1].map(|axis| {
            let u = (right[axis] - left[axis]) / (2.0 * step);
            let v = (down[axis] - up[axis]) / (2.0 * step);
            let uu = (right[axis] + left[axis]) / (2.0 * step * step);
            let vv = (down[axis] + up[axis]) / (2.0 * step * step);
            let uv = (near[axis] + far[axis]) / (2.0 * step * step) - uu - vv;
            [u as f32, v as f32, uu as f32, uv as f32, vv as f32]
        });
        let usable = terms.iter().flatten().all(|term| term.is_finite())
            && center.x_px.is_finite()
            && center.y_px.is_finite();
        let map = Self { center, terms };
        (usable && map.mm_per_px() > 1e-3).then_some(map)
    }

    /// Millimetres in one pixel's length.
    pub fn mm_per_px(&self) -> f32 {
        let [[a, b, ..], [c, d, ..]] = self.terms;
        (a * d - b * c).abs().sqrt()
    }

    /// Length in pixels in the direction in which pixels are smallest.
    pub fn most_px(&self, length_mm: f64) -> f64 {
        let [[a, b, ..], [c, d, ..]] = self.terms;
        length_mm / f64::from(a.hypot(c).min(b.hypot(d)).max(1e-3))
    }

    /// Gradient per pixel, at the centre, of a quantity with these derivatives by x and y (per millimetre).
    pub fn slope(&self, [x, y]: [f32; 2]) -> f32 {
        let [[a, b, ..], [c, d, ..]] = self.terms;
        (x * a + y * c).hypot(x * b + y * d)
    }

    /// The row `v` pixels below the centre.
    pub fn row(&self, v: f32) -> RowMap {
        self.terms.map(|[a, b, c, d, e]| [v * (b + e * v), a + d * v, c])
    }
}

/// Millimetres in one pixel's length at a place on a plane above the floor.
pub(crate) fn mm_per_px(camera: &CameraModel, position: FieldPoint, height_mm: f64) -> f64 {
    let scale = camera.pixel_area_mm2(camera.image_from_field(position, height_mm), height_mm);
    scale.sqrt().clamp(1e-3, 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::robot_from_field;
    use config::Preset;

    #[test]
    fn it_agrees_with_the_camera_model() {
        for preset in Preset::ALL {
            let config = preset.config();
            let (width, height) = (config.camera.width, config.camera.height);
            let camera = CameraModel::new(&config.geometry, width, height).unwrap();
            let top = config.robots.height_mm;
            let (x, y) = (0.47 * config.field.length_mm, 0.47 * config.field.width_mm);
            let pose = Pose { position: FieldPoint::new(x, -y), orientation: 0.7 };
            let middle = camera.image_from_field(FieldPoint::default(), top);
            let scale = camera.pixel_area_mm2(middle, top).sqrt();
            let map = LocalMap::new(&camera, &pose, top, 50.0, scale).unwrap();
            for (du, dv) in [(0.0, 0.0), (9.0, -7.0), (-11.0, 2.0), (4.0, 10.0)] {
                let point = ImagePoint::new(map.center.x_px + du, map.center.y_px + dv);
                let exact = robot_from_field(&pose, camera.field_from_image(point, top));
                let row = map.row(dv as f32);
                for axis in 0..2 {
                    let [a, b, c] = row[axis];
                    let u = du as f32;
                    let off = f64::from(a + u * (b + c * u)) - exact[axis];
                    assert!(off.abs() < 0.004 * f64::from(map.mm_per_px()), "{off}");
                }
            }
        }
    }
}
