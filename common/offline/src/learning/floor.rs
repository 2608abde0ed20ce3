//! The floor that colours take: classified pixels that belong to no robot and no ball.

use crate::learning::candidates::expected_patches;
use crate::learning::labels::ImageLabels;
use crate::learning::scene::Scene;
use config::Config;
use geometry::ImagePoint;
use messages::Run;

/// Pixels up to this multiple of half a robot's size from its centre may be the robot's, and up to this
/// multiple of the ball's radius the ball's.
const ROBOT_REACH: f64 = 1.5;
const BALL_REACH: f64 = 1.5;

/// Pixels of each colour outside robots and ball.
pub struct Taken {
    /// Indexed by colour.
    pub pixels: Vec<f64>,
}

impl Taken {
    /// Starts with no pixels.
    pub fn none(colors: usize) -> Self {
        Self { pixels: vec![0.0; colors] }
    }

    /// Adds the pixels of a picture whose robots and ball are labelled.
    pub fn add(&mut self, config: &Config, scene: &Scene, runs: &[Run], labels: &ImageLabels) {
        let px_per_mm = |center: ImagePoint, height_mm: f64| {
            1.0 / scene.camera.pixel_area_mm2(center, height_mm).sqrt()
        };
        let robots = labels.robots.iter().flatten().map(|robot| {
            let center = ImagePoint::new(robot.x_px, robot.y_px);
            let reach_mm = ROBOT_REACH * config.robots.size_mm / 2.0;
            (center, reach_mm * px_per_mm(center, config.robots.height_mm))
        });
        let ball = labels.ball.iter().flatten().map(|ball| {
            let center = ImagePoint::new(ball.x_px, ball.y_px);
            let radius_mm = config.ball.diameter_mm / 2.0;
            (center, BALL_REACH * radius_mm * px_per_mm(center, radius_mm))
        });
        let discs: Vec<(ImagePoint, f64)> = robots.chain(ball).collect();
        for run in runs {
            let (begin, end) = (f64::from(run.begin), f64::from(run.end));
            let length: f64 = discs
                .iter()
                .map(|(center, reach)| {
                    let half =
                        (reach.powi(2) - (f64::from(run.row) - center.y_px).powi(2)).max(0.0);
                    let half = half.sqrt();
                    (end.min(center.x_px + half) - begin.max(center.x_px - half)).max(0.0)
                })
                .sum();
            if let Some(pixels) = self.pixels.get_mut(usize::from(run.class)) {
                *pixels += (end - begin - length).max(0.0);
            }
        }
    }

    /// For each colour, the pixels taken relative to those that its patches cover in that many pictures.
    pub fn shares(&self, config: &Config, scene: &Scene, pictures: usize) -> Vec<f64> {
        let covered = covered_px(config, scene);
        let shares = self.pixels.iter().zip(covered);
        shares.map(|(taken, covered)| taken / (covered * pictures as f64)).collect()
    }
}

/// Pixels that each colour's patches cover in a picture if all robots are in it; for a colour that no
/// robot has, those of one robot.
pub fn covered_px(config: &Config, scene: &Scene) -> Vec<f64> {
    let [width, height] = [config.camera.width, config.camera.height].map(f64::from);
    let middle = ImagePoint::new(width / 2.0, height / 2.0);
    let robots = &config.robots;
    let mut covered = vec![
        robots.size_mm.powi(2)
            / scene.camera.pixel_area_mm2(middle, robots.height_mm);
        config.colors.len()
    ];
    for wanted in expected_patches(config) {
        let area_mm2 = scene.camera.pixel_area_mm2(middle, wanted.height_mm);
        covered[usize::from(wanted.class)] = wanted.total_mm2 / area_mm2;
    }
    covered
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learning::labels::{BallLabel, Quality};

    #[test]
    fn pixels_beside_the_ball_belong_to_the_floor() {
        let config = Config::default();
        let scene = Scene::new(&config).unwrap();
        let ball = BallLabel { x_px: 100.0, y_px: 50.0, quality: Quality::Clear };
        let labels = ImageLabels {
            file: "a.png".into(),
            robots: None,
            ball: Some(Some(ball)),
            samples: Vec::new(),
        };
        let run = |row, begin, end| Run { row, begin, end, class: 1, reserved: 0 };
        let mut taken = Taken::none(3);
        taken.add(&config, &scene, &[run(50, 0, 300), run(90, 10, 15), run(51, 98, 103)], &labels);
        assert_eq!((taken.pixels[0], taken.pixels[2]), (0.0, 0.0));
        // The run at the ball, and a part of the long run as wide as the ball, belong to the ball.
        let beside_px = taken.pixels[1];
        assert!((270.0..=300.0).contains(&beside_px), "{beside_px}");
        assert!(taken.shares(&config, &scene, 1)[1] > taken.shares(&config, &scene, 2)[1]);
    }
}
