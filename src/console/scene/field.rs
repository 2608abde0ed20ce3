//! The lines of a pitch.

use config::{Config, FieldConfig};
use geometry::settings::Pair;
use std::f64::consts::TAU;

/// Corners of the circle's polygon.
const CORNERS: u32 = 48;
/// Stretches into which a side is cut for the picture, where lenses bend it.
const STRETCHES: u32 = 16;

/// The lines, each a row of points in millimetres; a closed one ends where it begins. Only those that the pitch
/// certainly has: the markings of `[publish]` are for other programs, and a wrong line looks like a wrong camera.
pub fn lines_mm(config: &Config) -> Vec<Vec<Pair>> {
    let field = &config.field;
    let (x, y) = (field.length_mm / 2.0, field.width_mm / 2.0);
    let circle = (0..=CORNERS).map(|corner| {
        let (sin, cos) = (TAU * f64::from(corner) / f64::from(CORNERS)).sin_cos();
        [cos, sin].map(|part| field.center_circle_radius_mm * part)
    });
    let mut lines = vec![outline_mm(field, 0.0), vec![[0.0, -y], [0.0, y]]];
    if field.center_circle_radius_mm > 0.0 {
        lines.push(circle.collect());
    }
    for side in [-1.0, 1.0] {
        let box_of = |depth: f64, width: f64| {
            [[0.0, -1.0], [1.0, -1.0], [1.0, 1.0], [0.0, 1.0]]
                .map(|[out, along]| [side * (x + out * depth), along * width / 2.0])
                .to_vec()
        };
        if field.goal_width_mm > 0.0 && field.goal_depth_mm > 0.0 {
            lines.push(box_of(field.goal_depth_mm, field.goal_width_mm));
        }
    }
    lines
}

/// The pitch's corners, so far outside, and the first again.
pub fn outline_mm(field: &FieldConfig, margin_mm: f64) -> Vec<Pair> {
    let (x, y) = (field.length_mm / 2.0 + margin_mm, field.width_mm / 2.0 + margin_mm);
    vec![[-x, -y], [x, -y], [x, y], [-x, y], [-x, -y]]
}

/// A line with more points on its straight parts.
pub fn finer(line: &[Pair]) -> Vec<Pair> {
    if line.len() > CORNERS as usize {
        return line.to_vec();
    }
    let between = |pair: &[Pair]| {
        let (from, to) = (pair[0], pair[1]);
        (0..STRETCHES).map(move |step| {
            let part = f64::from(step) / f64::from(STRETCHES);
            [0, 1].map(|axis: usize| from[axis] + part * (to[axis] - from[axis]))
        })
    };
    line.windows(2).flat_map(between).chain(line.last().copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_cut_without_moving_their_ends() {
        let line = [[0.0, 0.0], [16.0, 0.0], [16.0, 32.0]];
        let finer = finer(&line);
        assert_eq!(finer.len(), 2 * STRETCHES as usize + 1);
        assert_eq!((finer[0], finer[1], finer[16]), (line[0], [1.0, 0.0], line[1]));
        assert_eq!(finer.last(), Some(&line[2]));
        assert!(lines_mm(&Config::default()).len() >= 5);
    }
}
