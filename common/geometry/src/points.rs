//! Points in the picture and on the field, poses and angles.

/// Pixels; the centre of the top-left pixel is (0, 0), x to the right, y down.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImagePoint {
    /// Column.
    pub x_px: f64,
    /// Row.
    pub y_px: f64,
}

/// Millimetres; origin at the centre of the pitch, x towards the right goal, y to the left of x.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FieldPoint {
    /// Along the pitch.
    pub x_mm: f64,
    /// Across the pitch.
    pub y_mm: f64,
}

impl ImagePoint {
    /// The point at column `x_px`, row `y_px`.
    pub fn new(x_px: f64, y_px: f64) -> Self {
        Self { x_px, y_px }
    }
}

impl FieldPoint {
    /// The point at `x_mm`, `y_mm`.
    pub fn new(x_mm: f64, y_mm: f64) -> Self {
        Self { x_mm, y_mm }
    }

    /// Distance in millimetres.
    pub fn distance(self, other: Self) -> f64 {
        (self.x_mm - other.x_mm).hypot(self.y_mm - other.y_mm)
    }
}

/// A position and a heading on the field.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose {
    /// The position.
    pub position: FieldPoint,
    /// The heading: radians, counter-clockwise from x.
    pub orientation: f64,
}

impl Pose {
    /// Field position of a point of the body (x forward, y left, millimetres).
    pub fn field_from_robot(&self, [x, y]: [f64; 2]) -> FieldPoint {
        let (sin, cos) = self.orientation.sin_cos();
        FieldPoint::new(
            self.position.x_mm + cos * x - sin * y,
            self.position.y_mm + sin * x + cos * y,
        )
    }
}

/// The same angle in (−π, π].
pub fn wrap_angle(angle: f64) -> f64 {
    use std::f64::consts::TAU;
    // Most angles are within one turn of the result, and a division with remainder is slow.
    let wrapped = if (0.0..TAU).contains(&angle) {
        angle
    } else if -TAU < angle && angle < 0.0 {
        angle + TAU
    } else {
        angle.rem_euclid(TAU)
    };
    if wrapped > std::f64::consts::PI { wrapped - TAU } else { wrapped }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_wrapped_without_a_division_where_possible() {
        use std::f64::consts::{PI, TAU};
        let near = [0.0, 1e-300, 1e-17, 1.0, PI, 4.0, TAU, 9.0, 3.0 * PI, 100.0, f64::INFINITY];
        let near = near.into_iter().flat_map(|a| [a, a.next_up(), a.next_down()]);
        for angle in near.flat_map(|a| [a, -a]).chain([f64::NAN]) {
            let wrapped = angle.rem_euclid(TAU);
            let expected = if wrapped > PI { wrapped - TAU } else { wrapped };
            assert_eq!(wrap_angle(angle).to_bits(), expected.to_bits(), "{angle}");
        }
    }

    #[test]
    fn angles_wrap_into_one_turn() {
        use std::f64::consts::PI;
        assert_eq!(wrap_angle(PI), PI);
        assert!((wrap_angle(-PI) - PI).abs() < 1e-12);
        assert!((wrap_angle(7.0) - (7.0 - 2.0 * PI)).abs() < 1e-12);
    }
}
