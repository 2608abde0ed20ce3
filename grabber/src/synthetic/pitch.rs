//! The static scene: the pitch with its markings, the goals, the walls and the floor around them.

use super::optics::{Optics, SAMPLES, sample_set, spot_samples};
use config::FieldConfig;
use geometry::{FieldPoint, ImagePoint};

/// RenderedCamera colours. White stays well below the sensor's limit, as with any camera that is set up to
/// distinguish colours.
const LINE: [f32; 3] = [150.0, 152.0, 148.0];
const WALL: [f32; 3] = [104.0, 103.0, 98.0];
const GOAL: [f32; 3] = [44.0, 44.0, 48.0];
const OUTSIDE: [f32; 3] = [66.0, 61.0, 56.0];

const LINE_WIDTH_MM: f64 = 12.0;
const WALL_THICKNESS_MM: f64 = 25.0;

/// The pitch and its markings. Positions are relative to the middle; since everything is symmetrical, only
/// distances from the two axes matter.
#[derive(Debug, Clone)]
struct Pitch {
    half_length: f64,
    half_width: f64,
    half_goal: f64,
    goal_depth: f64,
    circle: f64,
    /// Depth and half width of the penalty area and of the goal area.
    areas: [[f64; 2]; 2],
    floor: [f32; 3],
}

impl Pitch {
    fn new(field: &FieldConfig, floor_rgb: [u8; 3]) -> Self {
        let (length, width) = (field.length_mm, field.width_mm);
        Self {
            half_length: length / 2.0,
            half_width: width / 2.0,
            half_goal: field.goal_width_mm / 2.0,
            goal_depth: field.goal_depth_mm,
            circle: field.center_circle_radius_mm,
            // The proportions of the MiroSot middle league: 350×800 and 150×500 on 2200×1800.
            areas: [[0.16 * length, 0.222 * width], [0.068 * length, 0.139 * width]],
            floor: floor_rgb.map(f32::from),
        }
    }

    fn color(&self, point: FieldPoint) -> [f32; 3] {
        let (x, y) = (point.x_mm.abs(), point.y_mm.abs());
        if x <= self.half_length && y <= self.half_width {
            return if self.is_line(x, y) { LINE } else { self.floor };
        }
        if y <= self.half_goal && x <= self.half_length + self.goal_depth {
            return GOAL;
        }
        let around = |length: f64, width: f64| {
            x <= length + WALL_THICKNESS_MM && y <= width + WALL_THICKNESS_MM
        };
        if around(self.half_length, self.half_width)
            || around(self.half_length + self.goal_depth, self.half_goal)
        {
            return WALL;
        }
        OUTSIDE
    }

    fn is_line(&self, x: f64, y: f64) -> bool {
        let half = LINE_WIDTH_MM / 2.0;
        let from_goal_line = self.half_length - x;
        x <= half
            || (x.hypot(y) - self.circle).abs() <= half
            || self.areas.iter().any(|&[depth, half_width]| {
                let (along, across) = (from_goal_line - depth, y - half_width);
                (along.abs() <= half && across <= half) || (across.abs() <= half && along <= half)
            })
    }
}

/// Renders the empty pitch without noise: one byte per pixel, behind the Bayer filter.
pub fn paint(field: &FieldConfig, floor_rgb: [u8; 3], optics: &Optics) -> Vec<u8> {
    let pitch = Pitch::new(field, floor_rgb);
    let (width, height) = (optics.width, optics.height);
    let samples = spot_samples();
    let see = |x: usize, y: usize| {
        // Corner (x, y) lies half a pixel up and left of the middle of pixel (x, y).
        optics.model.field_from_image(ImagePoint::new(x as f64 - 0.5, y as f64 - 0.5), 0.0)
    };
    let mut above: Vec<FieldPoint> = (0..=width).map(|x| see(x, 0)).collect();
    let mut pixels = Vec::with_capacity(width * height);
    for row in 0..height {
        let below: Vec<FieldPoint> = (0..=width).map(|x| see(x, row + 1)).collect();
        for column in 0..width {
            let channel = optics.order.channel_at(column, row);
            let corners = [above[column], above[column + 1], below[column], below[column + 1]];
            let samples = &samples[sample_set(column, row)];
            let color = pixel_color(&pitch, corners, samples, optics.spot_px);
            let value =
                color[channel] * optics.light.at(column, row) + optics.light.glare_at(column, row);
            pixels.push((value + 0.5) as u8);
        }
        above = below;
    }
    pixels
}

/// Colour of a pixel whose corners see the given points of the floor.
fn pixel_color(
    pitch: &Pitch,
    [top_left, top_right, bottom_left, bottom_right]: [FieldPoint; 4],
    samples: &[[f64; 2]; SAMPLES],
    spot_px: f64,
) -> [f32; 3] {
    let mut sum = [0.0; 3];
    for sample in samples {
        let [x, y] = sample.map(|sigmas| 0.5 + sigmas * spot_px);
        let blend = |a: f64, b: f64, c: f64, d: f64| {
            (a * (1.0 - x) + b * x) * (1.0 - y) + (c * (1.0 - x) + d * x) * y
        };
        let color = pitch.color(FieldPoint::new(
            blend(top_left.x_mm, top_right.x_mm, bottom_left.x_mm, bottom_right.x_mm),
            blend(top_left.y_mm, top_right.y_mm, bottom_left.y_mm, bottom_right.y_mm),
        ));
        for (sum, value) in sum.iter_mut().zip(color) {
            *sum += value;
        }
    }
    sum.map(|value| value / SAMPLES as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markings_are_where_the_rules_put_them() {
        let pitch = Pitch::new(&FieldConfig::default(), [1, 2, 3]);
        let color = |x, y| pitch.color(FieldPoint::new(x, y));
        assert_eq!(color(0.0, 500.0), LINE);
        assert_eq!(color(200.0, 0.0), LINE);
        assert_eq!(color(-142.0, 141.0), LINE);
        assert_eq!(color(100.0, 0.0), [1.0, 2.0, 3.0]);
        assert_eq!(color(1100.0 - 352.0, -399.0), LINE);
        assert_eq!(color(1110.0, 0.0), GOAL);
        assert_eq!(color(-1110.0, 700.0), WALL);
        assert_eq!(color(0.0, 950.0), OUTSIDE);
    }
}
