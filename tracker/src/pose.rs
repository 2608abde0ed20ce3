//! The pose of a robot from the places of its patches.
//!
//! The pose is the rigid motion that brings the layout's centroids closest to the measured places, by least
//! squares weighted by the patches' areas (the planar case of Procrustes' problem). With p and q the layout's
//! and the measured offsets from their weighted means, θ = atan2(Σ w·(p × q), Σ w·(p · q)). For two squares
//! on a diagonal this is eq. (6): the centre is the mean of both, and the heading the direction from the
//! identification patch to the team patch less π/4.

use config::Pair;
use geometry::{CameraModel, FieldPoint, ImagePoint, Pose};

/// Fits a pose to patches, each given by its centroid in the layout, its measured place and its weight.
/// `None` when the places leave the heading open or are not numbers.
pub(crate) fn fit_pose(
    patches: impl Iterator<Item = (Pair, FieldPoint, f64)> + Clone,
) -> Option<Pose> {
    let (mut weight, mut layout, mut measured) = (0.0, [0.0; 2], [0.0; 2]);
    for ([x, y], place, w) in patches.clone() {
        weight += w;
        layout = [layout[0] + w * x, layout[1] + w * y];
        measured = [measured[0] + w * place.x_mm, measured[1] + w * place.y_mm];
    }
    let layout = layout.map(|sum| sum / weight);
    let measured = measured.map(|sum| sum / weight);

    // Sums of scalar and vector products of the offsets.
    let (mut along, mut across) = (0.0, 0.0);
    for ([x, y], place, w) in patches {
        let (px, py) = (x - layout[0], y - layout[1]);
        let (qx, qy) = (place.x_mm - measured[0], place.y_mm - measured[1]);
        along += w * (px * qx + py * qy);
        across += w * (px * qy - py * qx);
    }
    if !(along.is_finite() && across.is_finite()) || along.hypot(across) < 1e-9 {
        return None;
    }
    let turned = Pose { position: FieldPoint::default(), orientation: across.atan2(along) };
    let offset = turned.field_from_robot(layout);
    let position = FieldPoint::new(measured[0] - offset.x_mm, measured[1] - offset.y_mm);
    Some(Pose { position, ..turned })
}

/// A point of the field in the robot's frame: x forward, y left.
pub(crate) fn robot_from_field(pose: &Pose, point: FieldPoint) -> Pair {
    let (sin, cos) = pose.orientation.sin_cos();
    let (dx, dy) = (point.x_mm - pose.position.x_mm, point.y_mm - pose.position.y_mm);
    [cos * dx + sin * dy, cos * dy - sin * dx]
}

/// Image of the centre of the robot's top, and of its heading: radians, 0 to the right, π/2 up on the screen.
pub(crate) fn image_pose(camera: &CameraModel, pose: &Pose, height_mm: f64) -> (ImagePoint, f64) {
    const STEP_MM: f64 = 5.0;
    let at = |x: f64| camera.image_from_field(pose.field_from_robot([x, 0.0]), height_mm);
    let (behind, ahead) = (at(-STEP_MM), at(STEP_MM));
    let heading = (behind.y_px - ahead.y_px).atan2(ahead.x_px - behind.x_px);
    (at(0.0), heading)
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::{Config, Preset};
    use geometry::layout::Layout;
    use geometry::wrap_angle;
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_4, PI};

    fn equation_6(team: FieldPoint, identification: FieldPoint) -> (f64, f64, f64) {
        let heading = (team.y_mm - identification.y_mm).atan2(team.x_mm - identification.x_mm);
        (
            (team.x_mm + identification.x_mm) / 2.0,
            (team.y_mm + identification.y_mm) / 2.0,
            wrap_angle(heading - FRAC_PI_4),
        )
    }

    fn angle_between(a: f64, b: f64) -> f64 {
        wrap_angle(a - b).abs()
    }

    proptest! {
        /// Also when the patches lie too near to each other or too far apart.
        #[test]
        fn two_diagonal_squares_give_equation_6(
            x in -1000.0..1000.0f64,
            y in -1000.0..1000.0f64,
            direction in -PI..PI,
            distance in 30.0..70.0f64,
        ) {
            let layout = Layout::new(&Config::default().robots);
            let team = FieldPoint::new(x, y);
            let identification =
                FieldPoint::new(x + distance * direction.cos(), y + distance * direction.sin());
            let places = [team, identification];
            let pose = fit_pose(
                layout.patches.iter().zip(places).map(|(p, place)| (p.centroid_mm, place, p.area_mm2)),
            )
            .unwrap();
            let (x, y, heading) = equation_6(team, identification);
            prop_assert!((pose.position.x_mm - x).abs() < 1e-6);
            prop_assert!((pose.position.y_mm - y).abs() < 1e-6);
            prop_assert!(angle_between(pose.orientation, heading) < 1e-9);
        }

        #[test]
        fn any_layout_gives_the_pose_back(
            x in -1000.0..1000.0f64,
            y in -1000.0..1000.0f64,
            orientation in -PI..PI,
            preset in prop::sample::select(Preset::ALL.to_vec()),
        ) {
            let layout = Layout::new(&preset.config().robots);
            let truth = Pose { position: FieldPoint::new(x, y), orientation };
            let pose = fit_pose(layout.patches.iter().map(|p| {
                (p.centroid_mm, truth.field_from_robot(p.centroid_mm), p.area_mm2)
            }))
            .unwrap();
            prop_assert!(pose.position.distance(truth.position) < 1e-6);
            prop_assert!(angle_between(pose.orientation, orientation) < 1e-9);
            for patch in &layout.patches {
                let back = robot_from_field(&pose, truth.field_from_robot(patch.centroid_mm));
                prop_assert!((back[0] - patch.centroid_mm[0]).abs() < 1e-6);
                prop_assert!((back[1] - patch.centroid_mm[1]).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn places_that_leave_the_heading_open_give_no_pose() {
        let here = FieldPoint::new(3.0, 4.0);
        let patches = [([18.0, 18.0], here, 1.0), ([-18.0, -18.0], here, 1.0)];
        assert_eq!(fit_pose(patches.into_iter()), None);
        let nowhere = FieldPoint::new(f64::NAN, 4.0);
        let patches = [([18.0, 18.0], here, 1.0), ([-18.0, -18.0], nowhere, 1.0)];
        assert_eq!(fit_pose(patches.into_iter()), None);
        assert_eq!(fit_pose(std::iter::empty()), None);
    }

    #[test]
    fn headings_on_the_screen_turn_the_same_way_as_on_the_field() {
        let config = Config::default();
        let camera = CameraModel::new(&config.geometry, 640, 480).unwrap();
        for degrees in (-170..=180).step_by(10) {
            let orientation = f64::from(degrees).to_radians();
            let pose = Pose { position: FieldPoint::new(200.0, -100.0), orientation };
            let (center, heading) = image_pose(&camera, &pose, 75.0);
            assert!(angle_between(heading, orientation) < 0.05, "{degrees}: {heading}");
            assert!(center.x_px > 319.5 && center.y_px > 239.5, "{center:?}");
        }
    }
}
