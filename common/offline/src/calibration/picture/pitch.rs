//! The lines of a pitch.

use config::FieldConfig;
use std::f64::consts::TAU;

/// Distance by which the middle of a painted line lies inside the dimension it marks. Leagues differ in
/// whether a dimension is measured to the middle or to the outer edge of the line.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Insets {
    pub border_mm: f64,
    pub circle_mm: f64,
}

/// A line of the pitch: gives its points for a parameter from 0 to 1.
pub struct Line {
    /// Its points, field mm.
    pub at: Box<dyn Fn(f64) -> [f64; 2]>,
    /// Length.
    pub length_mm: f64,
    /// Towards the pitch's middle, for the border.
    pub inwards: Option<[f64; 2]>,
    /// Distance of its points inside the dimension it marks.
    pub inset_mm: f64,
}

/// The lines that every pitch has: border, centre line and centre circle.
pub fn lines(field: &FieldConfig, insets: Insets) -> Vec<Line> {
    let Insets { border_mm, circle_mm } = insets;
    let (x, y) = (field.length_mm / 2.0 - border_mm, field.width_mm / 2.0 - border_mm);
    let radius = field.center_circle_radius_mm - circle_mm;
    let straight = |from: [f64; 2], to: [f64; 2], inwards: Option<[f64; 2]>| Line {
        inset_mm: if inwards.is_some() { border_mm } else { 0.0 },
        at: Box::new(move |part| [0, 1].map(|axis| from[axis] + part * (to[axis] - from[axis]))),
        length_mm: (to[0] - from[0]).hypot(to[1] - from[1]),
        inwards,
    };
    let mut lines = vec![
        straight([-x, y], [x, y], Some([0.0, -1.0])),
        straight([-x, -y], [x, -y], Some([0.0, 1.0])),
        straight([-x, -y], [-x, y], Some([1.0, 0.0])),
        straight([x, -y], [x, y], Some([-1.0, 0.0])),
        straight([0.0, -y], [0.0, y], None),
    ];
    if radius > 0.0 {
        lines.push(Line {
            at: Box::new(move |part| {
                let (sin, cos) = (TAU * part).sin_cos();
                [radius * cos, radius * sin]
            }),
            length_mm: TAU * radius,
            inwards: None,
            inset_mm: circle_mm,
        });
    }
    lines
}
