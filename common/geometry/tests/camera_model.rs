//! The camera model with the geometry of the presets.

use config::{Config, Preset};
use touchline_geometry::{CameraModel, FieldPoint, GeometryError, ImagePoint};

fn model(config: &Config) -> CameraModel {
    CameraModel::new(&config.geometry, config.camera.width, config.camera.height).unwrap()
}

#[test]
fn the_calibration_points_map_onto_each_other() {
    for preset in Preset::ALL {
        let config = preset.config();
        let model = model(&config);
        for pair in &config.geometry.points {
            let [x, y] = pair.field_mm;
            let image = model.image_from_field(FieldPoint::new(x, y), 0.0);
            assert!((image.x_px - pair.image_px[0]).abs() < 1e-6, "{image:?} {pair:?}");
            assert!((image.y_px - pair.image_px[1]).abs() < 1e-6, "{image:?} {pair:?}");
        }
    }
}

#[test]
fn field_and_image_are_inverses_at_any_height() {
    let config = Config::default();
    let model = model(&config);
    for height in [0.0, 21.35, 75.0] {
        for x in [-1100.0, -500.0, 0.0, 730.0, 1100.0] {
            for y in [-900.0, 0.0, 333.0, 900.0] {
                let point = FieldPoint::new(x, y);
                let back = model.field_from_image(model.image_from_field(point, height), height);
                assert!(point.distance(back) < 1e-6, "{point:?} {back:?}");
            }
        }
    }
}

#[test]
fn slopes_are_differences_between_neighbouring_pixels() {
    for preset in Preset::ALL {
        let model = model(&preset.config());
        for (x, y) in [(3.0, 5.0), (211.0, 187.0), (333.0, 250.0)] {
            let at =
                |dx: f64, dy: f64| model.field_from_image(ImagePoint::new(x + dx, y + dy), 75.0);
            let (place, [right, down]) = model.field_and_slopes(ImagePoint::new(x, y), 75.0);
            assert!(place.distance(at(0.0, 0.0)) < 1e-9, "{place:?}");
            let between = |a: FieldPoint, b: FieldPoint| [b.x_mm - a.x_mm, b.y_mm - a.y_mm];
            let expected =
                [between(at(-0.5, 0.0), at(0.5, 0.0)), between(at(0.0, -0.5), at(0.0, 0.5))];
            for (slope, expected) in [right, down].into_iter().zip(expected) {
                let off = (slope[0] - expected[0]).hypot(slope[1] - expected[1]);
                assert!(off < 1e-4, "{preset:?}: {slope:?} {expected:?}");
            }
        }
    }
}

#[test]
fn a_higher_point_appears_further_from_the_lens() {
    let mut config = Config::default();
    config.geometry.camera_mm = [0.0, 0.0, 2000.0];
    let model = model(&config);
    let image = model.image_from_field(FieldPoint::new(800.0, 0.0), 75.0);
    let floor = model.field_from_image(image, 0.0);
    // Similar triangles: 800 · 2000 / (2000 − 75).
    assert!((floor.x_mm - 831.168_831).abs() < 1e-3, "{floor:?}");
}

#[test]
fn degenerate_points_are_refused() {
    let mut config = Config::default();
    config.geometry.points[2].field_mm = [0.0, 900.0];
    config.geometry.points[2].image_px = [320.0, 10.0];
    let result = CameraModel::new(&config.geometry, 640, 480);
    assert!(result.is_err(), "three points on a line were accepted: {result:?}");
    config.geometry.points.truncate(3);
    assert_eq!(CameraModel::new(&config.geometry, 640, 480), Err(GeometryError::TooFewPoints(3)));
}
