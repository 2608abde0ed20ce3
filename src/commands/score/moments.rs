//! Moments of a synthetic match that form a scene of their own: the positions of robots and ball make
//! them difficult, so the match runs until such a moment occurs.

use config::Config;
use geometry::FieldPoint;
use messages::{TruthFrame, TruthRobot};

/// Whether a frame is such a moment.
pub type Moment = fn(&Config, &TruthFrame) -> bool;

/// The scenes made of moments, by name.
pub const MOMENTS: [(&str, Moment); 2] = [
    ("ball-on-line", |config, truth| truth.ball_visible != 0 && is_on_line(config, truth)),
    ("ball-covered", |config, truth| (0.3..0.7).contains(&visible_share(config, truth))),
];

/// Frames without such a moment after which the search is given up.
pub const PATIENCE: usize = 200_000;

/// Whether the ball lies on or beside a line, or beside the wall.
fn is_on_line(config: &Config, truth: &TruthFrame) -> bool {
    let (x, y) = (truth.ball_x_mm.abs(), truth.ball_y_mm.abs());
    let reach = 1.25 * config.ball.diameter_mm / 2.0;
    x < reach
        || (x.hypot(y) - config.field.center_circle_radius_mm).abs() < reach
        || config.field.width_mm / 2.0 - y < 1.5 * reach
}

/// Share of the ball's disc that no robot hides from the camera.
fn visible_share(config: &Config, truth: &TruthFrame) -> f64 {
    const STEPS: i32 = 8;
    let radius = config.ball.diameter_mm / 2.0;
    let near = config.robots.size_mm + config.robots.height_mm;
    let ball = FieldPoint::new(truth.ball_x_mm, truth.ball_y_mm);
    let place = |robot: &TruthRobot| FieldPoint::new(robot.x_mm, robot.y_mm);
    if !truth.robots().iter().any(|robot| place(robot).distance(ball) < near) {
        return 1.0;
    }
    let (mut all, mut seen) = (0.0, 0.0);
    for row in -STEPS..=STEPS {
        for column in -STEPS..=STEPS {
            let [x, y] = [column, row].map(|step| f64::from(step) / f64::from(STEPS));
            if x.hypot(y) > 1.0 {
                continue;
            }
            let point = FieldPoint::new(ball.x_mm + x * radius, ball.y_mm + y * radius);
            all += 1.0;
            let hides = |robot: &TruthRobot| is_behind(config, robot, point, radius);
            seen += f64::from(u8::from(!truth.robots().iter().any(hides)));
        }
    }
    seen / all
}

/// Whether a robot blocks the line of sight to a point at a height above the floor.
fn is_behind(config: &Config, robot: &TruthRobot, point: FieldPoint, height_mm: f64) -> bool {
    const STEPS: u32 = 8;
    let [lens_x, lens_y, lens_z] = config.geometry.camera_mm;
    let body = config.robots.body(&config.robots.patches);
    let (sin, cos) = robot.orientation.sin_cos();
    (0..=STEPS).any(|step| {
        let up = f64::from(step) / f64::from(STEPS) * (config.robots.height_mm - height_mm);
        let part = up / (lens_z - height_mm);
        let dx = point.x_mm + part * (lens_x - point.x_mm) - robot.x_mm;
        let dy = point.y_mm + part * (lens_y - point.y_mm) - robot.y_mm;
        body.contains([cos * dx + sin * dy, cos * dy - sin * dx])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn truth(ball: [f64; 2], robot: [f64; 2]) -> TruthFrame {
        let mut truth = TruthFrame::zeroed();
        [truth.ball_x_mm, truth.ball_y_mm] = ball;
        truth.robot_count = 1;
        [truth.robots[0].x_mm, truth.robots[0].y_mm] = robot;
        truth
    }

    #[test]
    fn a_robot_hides_objects_behind_it() {
        let config = Config::default();
        let share = |robot: [f64; 2]| visible_share(&config, &truth([800.0, 0.0], robot));
        assert_eq!(share([870.0, 0.0]), 1.0);
        assert_eq!(share([600.0, 0.0]), 1.0);
        // Between the ball and the lens, which is above the middle.
        let shares = [-80.0, -70.0, -62.0].map(|beside| share([800.0 + beside, 0.0]));
        assert!(shares.is_sorted_by(|a, b| a >= b) && shares[2] < shares[0], "{shares:?}");
    }

    #[test]
    fn lines_and_walls_are_known() {
        let config = Config::default();
        let at = |x, y| is_on_line(&config, &truth([x, y], [0.0; 2]));
        assert!(at(10.0, 300.0) && at(-141.0, 141.0) && at(500.0, -875.0));
        assert!(!at(500.0, 300.0) && !at(100.0, 40.0));
    }
}
