//! The outline of a ball in the picture.
//!
//! The lens sees a sphere by a cone of rays that touch it. That cone cuts the plane of the ball's centre in
//! an ellipse: as wide as the ball across the line of sight, longer along it by 1 / cos θ (θ from the
//! vertical), and with its middle a little beyond the ball's centre. With its axis tilted by θ, half its
//! opening α = asin(r / D) at the distance D, and H = D·cos θ above the plane:
//!
//! long half axis  H·sin α·cos α / (cos²θ − sin²α)
//! short half axis H·sin α / √(cos²θ − sin²α)
//! middle          H·sin θ·cos θ / (cos²θ − sin²α) from below the lens, where the ball is at H·tan θ

use geometry::FieldPoint;

/// A ball, and the lens that looks at it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sphere {
    pub radius_mm: f64,
    lens_mm: [f64; 3],
}

/// An ellipse on the plane of the ball's centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Outline {
    /// Direction of the long axis: away from below the lens.
    pub direction: f64,
    pub long_mm: f64,
    pub short_mm: f64,
    /// Offset of the ellipse's middle from the ball's centre, along the long axis.
    pub beyond_mm: f64,
}

impl Sphere {
    pub fn new(radius_mm: f64, lens_mm: [f64; 3]) -> Self {
        Self { radius_mm, lens_mm }
    }

    /// The outline of a ball that lies there.
    pub fn outline(&self, position: FieldPoint) -> Outline {
        let [x, y, z] = self.lens_mm;
        let (dx, dy, above) = (position.x_mm - x, position.y_mm - y, z - self.radius_mm);
        let beside = dx.hypot(dy);
        let distance = beside.hypot(above);
        let (sin, cos) = (beside / distance, above / distance);
        let sin_half = self.radius_mm / distance;
        let cos_half = (1.0 - sin_half * sin_half).max(0.0).sqrt();
        let opening = cos * cos - sin_half * sin_half;
        // Seen from beside, or from within, there is no ellipse.
        if opening.is_nan() || opening < 0.01 || above <= 0.0 {
            let round = self.radius_mm;
            return Outline { direction: 0.0, long_mm: round, short_mm: round, beyond_mm: 0.0 };
        }
        Outline {
            direction: if beside > 0.0 { dy.atan2(dx) } else { 0.0 },
            long_mm: above * sin_half * cos_half / opening,
            short_mm: above * sin_half / opening.sqrt(),
            beyond_mm: above * sin * cos / opening - beside,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rays to the ends of the axes touch the ball: they pass its centre at the distance of its radius.
    #[test]
    fn rays_through_the_outline_touch_the_ball() {
        let lens = [100.0, -50.0, 1800.0];
        let sphere = Sphere::new(21.35, lens);
        for (x, y) in [(100.0, -50.0), (400.0, 300.0), (-1000.0, 800.0), (1500.0, 0.0)] {
            let outline = sphere.outline(FieldPoint::new(x, y));
            let (sin, cos) = outline.direction.sin_cos();
            for (along, across) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.6, -0.8)] {
                let (a, b) =
                    (outline.beyond_mm + along * outline.long_mm, across * outline.short_mm);
                let rim = [x + cos * a - sin * b, y + sin * a + cos * b, sphere.radius_mm];
                let ray = [0, 1, 2].map(|axis| rim[axis] - lens[axis]);
                let to_ball = [x - lens[0], y - lens[1], sphere.radius_mm - lens[2]];
                let dot = |p: [f64; 3], q: [f64; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
                let along = dot(ray, to_ball) / dot(ray, ray).sqrt();
                let beside = (dot(to_ball, to_ball) - along * along).sqrt();
                assert!((beside - sphere.radius_mm).abs() < 1e-9, "{x} {y}: {beside}");
            }
        }
    }
}
