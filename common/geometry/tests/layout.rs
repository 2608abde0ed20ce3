//! Layouts of the presets' robots.

use config::{Config, PatchConfig, PatchRole, Preset};
use std::f64::consts::FRAC_PI_4;
use touchline_geometry::layout::{Layout, body_turn};
use touchline_geometry::{FieldPoint, Pose};

#[test]
fn separate_squares_show_whole() {
    let layout = Layout::new(&Config::default().robots);
    assert_eq!(layout.patches.len(), 2);
    let team = &layout.patches[0];
    assert!((team.area_mm2 - 34.0 * 34.0).abs() < 1e-9);
    assert!((team.centroid_mm[0] - 18.0).abs() < 1e-9 && (team.centroid_mm[1] - 18.0).abs() < 1e-9);
}

#[test]
fn a_body_is_turned_as_its_patches_need() {
    for preset in Preset::ALL {
        let robots = preset.config().robots;
        assert_eq!(body_turn(robots.size_mm, &robots.patches), 0.0, "{}", preset.name());
    }
    let mut robots = Config::default().robots;
    let corner_ahead = vec![[46.0, 0.0], [0.0, 46.0], [-46.0, 0.0], [0.0, -46.0]];
    robots.patches = vec![PatchConfig { role: PatchRole::Team, outline_mm: corner_ahead.clone() }];
    assert!((body_turn(robots.size_mm, &robots.patches) - FRAC_PI_4).abs() < 1e-9);
    let turned = Pose { position: FieldPoint::default(), orientation: 0.2 };
    for point in &mut robots.patches[0].outline_mm {
        let point_turned = turned.field_from_robot(*point);
        *point = [point_turned.x_mm, point_turned.y_mm];
    }
    assert!((body_turn(robots.size_mm, &robots.patches) - FRAC_PI_4 - 0.2).abs() < 0.01);
}

#[test]
fn a_covered_corner_moves_the_centroid() {
    let mut robots = Config::default().robots;
    let square = |a: f64, b: f64| vec![[b, b], [a, b], [a, a], [b, a]];
    robots.patches = vec![
        PatchConfig { role: PatchRole::Team, outline_mm: square(-30.0, 30.0) },
        PatchConfig { role: PatchRole::Identification, outline_mm: square(0.0, 30.0) },
    ];
    let layout = Layout::new(&robots);
    assert!((layout.patches[0].area_mm2 - 2700.0).abs() < 1e-6);
    // Three quarter squares at distance 15: (−15 −15 +15) / 3.
    assert!((layout.patches[0].centroid_mm[0] + 5.0).abs() < 1e-6);
    assert!((layout.patches[1].centroid_mm[1] - 15.0).abs() < 1e-6);
}
