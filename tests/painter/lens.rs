//! The camera's pose and its lens.

use super::Vector;

/// A pinhole with Brown–Conrady distortion: a point at (x, y) of the plane one focal length ahead
/// appears at (x, y)·(1 + k1·r² + k2·r⁴) (Brown, "Decentering distortion of lenses", 1966).
#[derive(Debug, Clone)]
pub struct Lens {
    pub width: u32,
    pub height: u32,
    /// Position in field coordinates, millimetres.
    pub position: Vector,
    /// Rotations from looking straight down: about the picture's x axis, its y axis, the optical axis.
    pub tilt_deg: [f64; 3],
    pub focal_px: f64,
    /// Principal point.
    pub center_px: [f64; 2],
    pub k1: f64,
    pub k2: f64,
}

impl Lens {
    /// The pixel at which a point of the field is seen; the centre of the top-left pixel is (0, 0).
    pub fn project(&self, point: Vector) -> [f64; 2] {
        let away = [0, 1, 2].map(|axis| point[axis] - self.position[axis]);
        let axes = self.axes();
        let [right, down, ahead] = axes.map(|axis| dot(axis, away));
        let (x, y) = (right / ahead, down / ahead);
        let stretch = self.stretch(x * x + y * y);
        [
            self.center_px[0] + self.focal_px * x * stretch,
            self.center_px[1] + self.focal_px * y * stretch,
        ]
    }

    /// The direction in which a pixel looks.
    pub fn ray(&self, x_px: f64, y_px: f64) -> Vector {
        let seen = [
            (x_px - self.center_px[0]) / self.focal_px,
            (y_px - self.center_px[1]) / self.focal_px,
        ];
        // The distortion is weak, so this fixed-point iteration converges quickly.
        let mut plane = seen;
        for _ in 0..12 {
            let stretch = self.stretch(plane[0] * plane[0] + plane[1] * plane[1]);
            plane = seen.map(|value| value / stretch);
        }
        let [right, down, ahead] = self.axes();
        [0, 1, 2].map(|axis| plane[0] * right[axis] + plane[1] * down[axis] + ahead[axis])
    }

    fn stretch(&self, square: f64) -> f64 {
        1.0 + self.k1 * square + self.k2 * square * square
    }

    /// Axes to the right, down and ahead of the camera, in field coordinates.
    fn axes(&self) -> [Vector; 3] {
        let [about_x, about_y, about_axis] = self.tilt_deg.map(f64::to_radians);
        let turn = |[x, y, z]: Vector| {
            let (sin, cos) = about_axis.sin_cos();
            let [x, y] = [cos * x - sin * y, sin * x + cos * y];
            let (sin, cos) = about_y.sin_cos();
            let [x, z] = [cos * x + sin * z, cos * z - sin * x];
            let (sin, cos) = about_x.sin_cos();
            [x, cos * y - sin * z, sin * y + cos * z]
        };
        [turn([1.0, 0.0, 0.0]), turn([0.0, -1.0, 0.0]), turn([0.0, 0.0, -1.0])]
    }
}

pub fn dot(a: Vector, b: Vector) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
