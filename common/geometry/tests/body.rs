//! Bodies of the presets' robots.

use config::{Config, Preset};
use touchline_geometry::body::Body;
use touchline_geometry::layout::contains;
use touchline_geometry::{FieldPoint, Pose};

fn pose(x: f64, y: f64, degrees: f64) -> Pose {
    Pose { position: FieldPoint::new(x, y), orientation: degrees.to_radians() }
}

fn body(config: &Config) -> Body {
    config.robots.body(&config.robots.patches)
}

#[test]
fn squares_touch_exactly_where_they_should() {
    let body = body(&Config::default());
    for (degrees, touch) in [(0.0, 75.0), (45.0, 37.5 + 37.5 * 2f64.sqrt())] {
        let a = pose(5.0, 7.0, 0.0);
        assert!(body.overlaps(&a, &body, &pose(5.0 + touch - 0.01, 7.0, degrees)));
        assert!(!body.overlaps(&a, &body, &pose(5.0 + touch + 0.01, 7.0, degrees)));
    }
}

#[test]
fn round_robots_touch_at_their_rims_and_flat_fronts() {
    let body = body(&Preset::SslDivisionB.config());
    let a = pose(100.0, -50.0, 0.0);
    // (heading of a, heading of the robot ahead of it, distance at which they touch)
    for (heading_a, heading_b, touch) in
        [(180.0, 0.0, 180.0), (0.0, 0.0, 165.0), (0.0, 180.0, 150.0), (180.0, 180.0, 165.0)]
    {
        let a = Pose { orientation: f64::to_radians(heading_a), ..a };
        let at = |distance: f64| pose(100.0 + distance, -50.0, heading_b);
        assert!(body.overlaps(&a, &body, &at(touch - 0.5)), "{heading_a} {heading_b}");
        assert!(!body.overlaps(&a, &body, &at(touch + 0.5)), "{heading_a} {heading_b}");
    }
    // Side by side, with fronts in line.
    assert!(!body.overlaps(&a, &body, &pose(100.0, 130.5, 0.0)));
    assert!(body.overlaps(&a, &body, &pose(100.0, 129.5, 0.0)));
}

#[test]
fn outline_and_depth_agree() {
    for config in Preset::ALL.map(Preset::config) {
        let body = body(&config);
        let outline = body.outline();
        for step in 0..360 {
            let (sin, cos) = f64::from(step).to_radians().sin_cos();
            for radius in [0.3, 0.6, 0.75, 0.85, 1.02, 1.3] {
                let point = [radius * body.reach_mm() * cos, radius * body.reach_mm() * sin];
                // The polygon's sides lie up to half a millimetre inside the disc.
                if body.depth_mm(point).abs() > 1.0 {
                    assert_eq!(contains(&outline, point), body.contains(point), "{point:?}");
                }
            }
        }
    }
}
