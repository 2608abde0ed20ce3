//! The area in which robots and balls can be.

use config::Config;
use geometry::FieldPoint;

/// The pitch with its goals.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pitch {
    half_length_mm: f64,
    half_width_mm: f64,
    half_goal_width_mm: f64,
    goal_depth_mm: f64,
    margin_mm: f64,
}

impl Pitch {
    pub fn new(config: &Config) -> Self {
        let field = &config.field;
        Self {
            half_length_mm: field.length_mm / 2.0,
            half_width_mm: field.width_mm / 2.0,
            half_goal_width_mm: field.goal_width_mm / 2.0,
            goal_depth_mm: field.goal_depth_mm,
            margin_mm: field.margin_mm,
        }
    }

    /// Whether a point lies in the field or a goal, or outside by no more than the configured
    /// margin and `slack_mm`.
    pub fn contains(&self, point: FieldPoint, slack_mm: f64) -> bool {
        let (x, y) = (point.x_mm.abs(), point.y_mm.abs());
        let margin = self.margin_mm + slack_mm;
        let in_field = x <= self.half_length_mm + margin && y <= self.half_width_mm + margin;
        let in_goal = x <= self.half_length_mm + self.goal_depth_mm + margin
            && y <= self.half_goal_width_mm + margin;
        in_field || in_goal
    }

    /// Places all over the pitch, up to the corners beside its goals.
    pub fn grid(&self) -> impl Iterator<Item = FieldPoint> {
        const STEPS: i32 = 8;
        let x_mm = self.half_length_mm + self.goal_depth_mm + self.margin_mm;
        let y_mm = self.half_width_mm.max(self.half_goal_width_mm) + self.margin_mm;
        let part = |step: i32| f64::from(2 * step - STEPS) / f64::from(STEPS);
        (0..=STEPS).flat_map(move |row| {
            (0..=STEPS).map(move |column| FieldPoint::new(x_mm * part(column), y_mm * part(row)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn field_and_goals_count_and_the_corners_behind_the_goal_lines_do_not() {
        let pitch = Pitch::new(&Config::default());
        let inside = |x, y, slack| pitch.contains(FieldPoint::new(x, y), slack);
        assert!(inside(1139.0, -939.0, 0.0));
        assert!(!inside(1141.0, 300.0, 0.0));
        assert!(inside(-1289.0, 239.0, 0.0));
        assert!(!inside(-1289.0, 241.0, 0.0));
        assert!(inside(1160.0, 300.0, 30.0));
        assert!(!inside(f64::NAN, 0.0, 0.0));
    }
}
