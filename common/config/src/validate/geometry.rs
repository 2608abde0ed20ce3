//! Checks that camera, calibration points and field are consistent.

use super::super::Config;
use super::super::problem::Problem;
use geometry::{CameraModel, FieldPoint, GeometryError, ImagePoint};

/// Problems that make the geometry unusable.
pub(super) fn check(config: &Config, problems: &mut Vec<Problem>) {
    let lens_height = config.geometry.camera_mm[2];
    let tallest = config.tallest_robot_mm().max(config.ball.diameter_mm);
    if lens_height <= tallest {
        let message = format!(
            "the lens must hang above robots and ball ({tallest} mm), its height is {lens_height} mm"
        );
        let problem = Problem::new("geometry.camera_mm[2]", message);
        let is_metres = lens_height > 0.0 && lens_height * 1000.0 > tallest && lens_height < 20.0;
        let problem = if is_metres { problem.help(MILLIMETRES) } else { problem };
        problems.push(problem.related("robots.height_mm"));
        return;
    }
    let model = match model(config) {
        Ok(model) => model,
        Err(error) => {
            let path = match error {
                GeometryError::TooFewPoints(_) | GeometryError::Degenerate => "geometry.points",
                GeometryError::CameraHeight(_) => "geometry.camera_mm[2]",
                GeometryError::Distortion { .. } => "geometry.distortion",
            };
            let problem = Problem::new(path, error.to_string());
            problems.push(match error {
                GeometryError::Degenerate => problem.help(SWAPPED),
                _ => problem,
            });
            return;
        }
    };
    let marked = config.geometry.points.iter().map(|pair| pair.field_mm);
    if let Some((unit, factor)) = config.field.likely_unit(marked) {
        let message = format!("`field_mm` looks like {unit}: write {factor} times as much");
        problems.push(Problem::new("geometry.points", message).help(MILLIMETRES));
        return;
    }
    let view = View { config, model };
    if let Some([x, y]) = view.beyond_the_lens() {
        let message = format!(
            "this distortion folds the picture over itself before it reaches ({x:.0}, {y:.0}) mm on the field"
        );
        problems.push(Problem::new("geometry.distortion", message));
    } else if view.turns_inside_out() {
        let message = "these points turn part of the field inside out";
        problems.push(Problem::new("geometry.points", message).help(SWAPPED));
    } else if view.visible_share() == 0.0 {
        let message = format!(
            "with these points nothing of the field lies in a picture of {}×{} pixels",
            config.camera.width, config.camera.height
        );
        problems.push(Problem::new("geometry.points", message).related("camera.width"));
    }
}

const MILLIMETRES: &str = "lengths are in millimetres";
const SWAPPED: &str = "are two of them swapped in the picture?";

/// Warns of geometries that are possible but look like points measured in another picture.
pub(super) fn warn(config: &Config, warnings: &mut Vec<Problem>) {
    let Ok(model) = model(config) else { return };
    let view = View { config, model };
    let (width, height) = (config.camera.width, config.camera.height);
    let mut warn = |path: String, message: String| warnings.push(Problem::new(path, message));
    let points = "geometry.points".to_string();

    let visible = view.visible_share();
    let covered = view.covered_share();
    if visible < 0.5 {
        let percent = 100.0 * visible;
        let message =
            format!("only {percent:.0} % of the field lies in the {width}×{height} picture");
        warn(points.clone(), format!("{message}: were they measured in a larger one?"));
    } else if covered < 0.25 {
        let percent = 100.0 * covered;
        let message =
            format!("the field fills only {percent:.0} % of the {width}×{height} picture");
        warn(points.clone(), format!("{message}: were they measured in a smaller one?"));
    }
    match (view.is_mirrored(), config.camera.mirrored) {
        (true, false) => warn(
            points.clone(),
            "the picture shows the field mirrored: is y towards the left of x? If the camera looks through a \
             mirror, say so: camera.mirrored = true"
                .into(),
        ),
        (false, true) => warn(
            "camera.mirrored".into(),
            "geometry.points show the field as a camera sees it without a mirror".into(),
        ),
        _ => {}
    }
    if let Some([along, across]) = view.stretched_pixel() {
        let message = format!(
            "a pixel in the middle of the field is {along:.1} mm long and {across:.1} mm wide: are the corners \
             named one step round, or has the field other sides than configured?"
        );
        warn(points, message);
    }
    for (index, pair) in config.geometry.points.iter().enumerate() {
        let [x, y] = pair.field_mm;
        let placed = view.image(FieldPoint::new(x, y));
        let error = (placed.x_px - pair.image_px[0]).hypot(placed.y_px - pair.image_px[1]);
        if error > (f64::from(width) / 100.0).max(3.0) {
            let message =
                format!("lies {error:.0} pixels from where the other points would have it");
            warn(format!("geometry.points[{index}]"), message);
        }
    }
    let [x, y] = config.geometry.distortion.center_px;
    if !view.in_picture(ImagePoint::new(x, y)) {
        let message = format!("lies outside the {width}×{height} picture");
        warn("geometry.distortion.center_px".into(), message);
    }
}

fn model(config: &Config) -> Result<CameraModel, GeometryError> {
    CameraModel::new(&config.geometry, config.camera.width, config.camera.height)
}

struct View<'a> {
    config: &'a Config,
    model: CameraModel,
}

/// Largest plausible ratio of a pixel's sides. Some cameras have oblong pixels, and the lens position
/// is often a guess. A field with corners named one step round looks stretched by the square of its
/// aspect ratio, 1.33 or more.
const MAX_STRETCH: f64 = 1.2;

/// Steps of the sampling grid along each side of field and picture.
const STEPS: i32 = 20;

impl View<'_> {
    fn image(&self, point: FieldPoint) -> ImagePoint {
        self.model.image_from_field(point, 0.0)
    }

    fn in_picture(&self, point: ImagePoint) -> bool {
        let inside = |value: f64, size: u32| (-0.5..f64::from(size) - 0.5).contains(&value);
        inside(point.x_px, self.config.camera.width)
            && inside(point.y_px, self.config.camera.height)
    }

    fn field_grid(&self) -> impl Iterator<Item = FieldPoint> {
        let (length, width) = (self.config.field.length_mm, self.config.field.width_mm);
        grid().map(move |(x, y)| FieldPoint::new((x - 0.5) * length, (y - 0.5) * width))
    }

    /// Share of the field that the camera sees.
    fn visible_share(&self) -> f64 {
        share(self.field_grid().map(|point| self.in_picture(self.image(point))))
    }

    /// Share of the picture that shows the field.
    fn covered_share(&self) -> f64 {
        let field = &self.config.field;
        let camera = &self.config.camera;
        share(grid().map(|(x, y)| {
            let x_px = x * f64::from(camera.width) - 0.5;
            let y_px = y * f64::from(camera.height) - 0.5;
            let point = self.model.field_from_image(ImagePoint::new(x_px, y_px), 0.0);
            point.x_mm.abs() <= field.length_mm / 2.0 && point.y_mm.abs() <= field.width_mm / 2.0
        }))
    }

    /// A point at the edge of the field that lies beyond the range of the lens polynomial.
    fn beyond_the_lens(&self) -> Option<[f64; 2]> {
        self.config.field.outline().find(|&[x, y]| {
            let point = FieldPoint::new(x, y);
            self.in_picture(self.image(point)) && !self.model.is_within_lens(point, 0.0)
        })
    }

    /// Length and width of a pixel on the floor in the middle of the visible field, if they differ by
    /// more than a camera at the lens position explains.
    fn stretched_pixel(&self) -> Option<[f64; 2]> {
        let (mut sum, mut count) = ([0.0; 2], 0.0);
        for point in self.field_grid().filter(|&point| self.in_picture(self.image(point))) {
            sum = [sum[0] + point.x_mm, sum[1] + point.y_mm];
            count += 1.0;
        }
        if count == 0.0 {
            return None;
        }
        let middle = FieldPoint::new(sum[0] / count, sum[1] / count);
        let here = self.image(middle);
        let step = |dx: f64, dy: f64| {
            let there = ImagePoint::new(here.x_px + dx, here.y_px + dy);
            let there = self.model.field_from_image(there, 0.0);
            [there.x_mm - middle.x_mm, there.y_mm - middle.y_mm]
        };
        let (right, down) = (step(1.0, 0.0), step(0.0, 1.0));
        let area = (right[0] * down[1] - right[1] * down[0]).abs();
        let squares = [right, down].iter().flatten().map(|part| part * part).sum::<f64>();
        // For singular values a ≥ b: a² + b² is the sum of squares, a·b the area.
        let [sum, difference] = [2.0, -2.0].map(|sign| (squares + sign * area).max(0.0).sqrt());
        let [long, short] = [(sum + difference) / 2.0, (sum - difference) / 2.0];
        let [x, y, height] = self.config.geometry.camera_mm;
        let away = (middle.x_mm - x).hypot(middle.y_mm - y);
        let foreshortening = height.hypot(away) / height;
        (long > MAX_STRETCH * foreshortening * short).then_some([long, short])
    }

    /// Rotation sense in the picture of a counter-clockwise turn on the field: −1 for a camera above
    /// the floor, since image rows run down; +1 in a mirrored picture.
    fn sense_at(&self, point: FieldPoint) -> f64 {
        let step = 1.0;
        let here = self.image(point);
        let along = self.image(FieldPoint::new(point.x_mm + step, point.y_mm));
        let across = self.image(FieldPoint::new(point.x_mm, point.y_mm + step));
        let determinant = (along.x_px - here.x_px) * (across.y_px - here.y_px)
            - (along.y_px - here.y_px) * (across.x_px - here.x_px);
        determinant.signum()
    }

    /// Calibration points and visible field points.
    fn seen_points(&self) -> impl Iterator<Item = FieldPoint> {
        let points = self.config.geometry.points.iter();
        let marked = points.map(|pair| FieldPoint::new(pair.field_mm[0], pair.field_mm[1]));
        marked.chain(self.field_grid().filter(|&point| self.in_picture(self.image(point))))
    }

    /// Whether the horizon passes between visible points.
    fn turns_inside_out(&self) -> bool {
        let senses = || self.seen_points().map(|point| self.sense_at(point));
        senses().any(|sense| sense > 0.0) && senses().any(|sense| sense < 0.0)
    }

    fn is_mirrored(&self) -> bool {
        self.seen_points().next().is_some_and(|point| self.sense_at(point) > 0.0)
    }
}

fn grid() -> impl Iterator<Item = (f64, f64)> {
    let place = |step: i32| (f64::from(step) + 0.5) / f64::from(STEPS);
    (0..STEPS).flat_map(move |x| (0..STEPS).map(move |y| (place(x), place(y))))
}

fn share(answers: impl Iterator<Item = bool>) -> f64 {
    let (yes, all) = answers.fold((0, 0), |(yes, all), answer| (yes + i32::from(answer), all + 1));
    f64::from(yes) / f64::from(all)
}

#[cfg(test)]
mod tests {
    use super::super::tests::refused;
    use super::*;

    fn problems(change: impl FnOnce(&mut Config)) -> Vec<Problem> {
        let mut config = Config::default();
        change(&mut config);
        config.problems()
    }

    #[track_caller]
    fn warned(path: &str, part: &str, change: impl FnOnce(&mut Config)) {
        let mut config = Config::default();
        change(&mut config);
        assert_eq!(config.problems(), []);
        let warnings = config.warnings();
        let found =
            warnings.iter().any(|warning| warning.path == path && warning.message.contains(part));
        assert!(found, "{path}: {part:?} not in {warnings:#?}");
    }

    #[test]
    fn the_lens_hangs_above_what_it_sees() {
        refused("geometry.camera_mm[2]", "its height is 60 mm", |config| {
            config.geometry.camera_mm[2] = 60.0;
        });
        refused("geometry.camera_mm[2]", "its height is -2200 mm", |config| {
            config.geometry.camera_mm[2] = -2200.0;
        });
    }

    #[test]
    fn points_must_make_a_view() {
        refused("geometry.points", "at least 4", |config| config.geometry.points.truncate(3));
        refused("geometry.points", "line", |config| {
            config.geometry.points[2].field_mm = [0.0, 900.0];
            config.geometry.points[2].image_px = [320.0, 20.0];
        });
        refused("geometry.points", "metres", |config| {
            for pair in &mut config.geometry.points {
                pair.field_mm = pair.field_mm.map(|value| value / 1000.0);
            }
        });
        refused("geometry.points", "nothing of the field", |config| {
            for pair in &mut config.geometry.points {
                pair.image_px[0] += 2000.0;
            }
            config.geometry.distortion.k1 = 0.0;
        });
    }

    #[test]
    fn swapped_points_are_found_out() {
        // Any two of four corners swapped give a bow tie, or a triangle with a point inside.
        for first in 0..4 {
            for second in 0..first {
                let problems = problems(|config| {
                    let points = &mut config.geometry.points;
                    // A view from the side, so that no two edges are parallel.
                    points[0].image_px = [150.0, 80.0];
                    (points[first].image_px, points[second].image_px) =
                        (points[second].image_px, points[first].image_px);
                });
                // Swapped opposite corners give a mirrored picture, which only causes a warning.
                let opposite = first - second == 2;
                assert_eq!(problems.is_empty(), opposite, "{first} {second}: {problems:#?}");
                for problem in problems {
                    assert_eq!(problem.path, "geometry.points");
                    assert_eq!(problem.help.as_deref(), Some(SWAPPED));
                }
            }
        }
    }

    #[test]
    fn the_distortion_leaves_the_picture_in_one_piece() {
        refused("geometry.distortion", "its picture ends before", |config| {
            config.geometry.distortion.k1 = -0.4
        });
        // Mild distortion, but the optical centre is so far off that the opposite corner folds.
        refused("geometry.distortion", "its picture ends before", |config| {
            config.geometry.distortion.k1 = -0.15;
            config.geometry.distortion.center_px = [0.0, 0.0];
        });
        // The points lie inside the valid range, the pitch does not.
        refused("geometry.distortion", "before it reaches", |config| {
            config.geometry.distortion.k1 = -0.35;
            for pair in &mut config.geometry.points {
                pair.field_mm = pair.field_mm.map(|value| value / 2.0);
                let [x, y] = pair.image_px;
                pair.image_px = [319.5 + (x - 319.5) / 2.0, 239.5 + (y - 239.5) / 2.0];
            }
        });
    }

    #[test]
    fn points_of_another_picture_are_warned_of() {
        warned("geometry.points", "of the 1280×960 picture", |config| {
            config.camera.width *= 2;
            config.camera.height *= 2;
        });
        warned("geometry.points", "% of the field lies in the 320×240", |config| {
            config.camera.width /= 2;
            config.camera.height /= 2;
            config.geometry.distortion.k1 = 0.0;
        });
        warned("geometry.distortion.center_px", "320×240", |config| {
            config.camera.width /= 2;
            config.camera.height /= 2;
            config.geometry.distortion.k1 = 0.0;
            config.geometry.distortion.center_px = [320.0, 10.0];
        });
        warned("geometry.points", "mirrored", |config| {
            for pair in &mut config.geometry.points {
                pair.image_px[0] = 639.0 - pair.image_px[0];
            }
        });
        warned("camera.mirrored", "without a mirror", |config| config.camera.mirrored = true);
        warned("geometry.points", "one step round", |config| {
            let seen: Vec<_> = config.geometry.points.iter().map(|pair| pair.image_px).collect();
            for (index, pair) in config.geometry.points.iter_mut().enumerate() {
                pair.image_px = seen[(index + 1) % 4];
            }
        });
        warned("geometry.points[4]", "pixels from where", |config| {
            let points = &mut config.geometry.points;
            points.push(crate::PointPair { field_mm: [0.0, 0.0], image_px: [380.0, 200.0] });
        });
    }
}
