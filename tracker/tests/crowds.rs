//! Many robots that wear few colours: every identity has the same chance to be found.

mod support;

use config::{Config, PatchRole, Preset};
use messages::{DetectionFrame, RejectReason, Team};
use support::*;

/// All robots of the standard pattern in a block, as close to each other as `pitch_mm`, headings all
/// different.
fn block(config: &Config, pitch_mm: f64, turn: u32) -> Vec<Robot> {
    config
        .robots
        .identities
        .iter()
        .zip(0u32..)
        .map(|(identity, index)| {
            let (column, row) = (f64::from(index % 8) - 3.5, f64::from(index / 8) - 1.5);
            let heading = f64::from(index * 137 + turn * 31);
            robot(identity.team, identity.id, column * pitch_mm, row * pitch_mm, heading)
        })
        .collect()
}

/// A camera 4.2 m above a part of the field, 4 mm a pixel.
fn standard_pattern() -> Config {
    let mut config = Preset::SslDivisionB.config();
    config.field.length_mm = 4500.0;
    config.field.width_mm = 3000.0;
    config.camera.width = 1224;
    config.camera.height = 1024;
    config.geometry =
        config::GeometryConfig::above(&config.field, config.camera.picture_px(), 4200.0);
    config
}

#[test]
fn robots_that_touch_are_all_named_whatever_the_tolerance() {
    for patch_tolerance_mm in [12.0, 20.0] {
        let mut config = standard_pattern();
        config.tracker.patch_tolerance_mm = patch_tolerance_mm;
        for (turn, pitch_mm) in (0..).zip([184.0, 240.0]) {
            let robots = block(&config, pitch_mm, turn);
            let frame = Picture::of_robots(&config, &robots).detections();
            assert_found(&frame, &robots, 2.5, 2.5);
            assert_eq!(frame.flags & DetectionFrame::SEARCH_CUT, 0);
        }
    }
}

#[test]
fn a_search_that_was_cut_says_so() {
    // A robot, and around another team patch so many dots that no robot can be made out.
    let config = standard_pattern();
    let found = robot(Team::Blue, 9, 900.0, 0.0, 40.0);
    let mut picture = Picture::of_robots(&config, &[found]);
    let [yellow, pink, green] = ["yellow", "pink", "green"].map(|name| picture.class(name));
    picture.square([0.0, 0.0], 44.0, Some(yellow));
    for row in -16..=16i32 {
        for column in -16..=16i32 {
            let at = [f64::from(column) * 24.0, f64::from(row) * 24.0];
            if at[0].hypot(at[1]) > 45.0 {
                picture.square(at, 19.0, Some(if (row + column) % 2 == 0 { pink } else { green }));
            }
        }
    }
    let mut config = config;
    config.tracker.min_area_ratio = 0.15;
    config.tracker.patch_tolerance_mm = 60.0;
    picture.config = config;
    let frame = picture.detections();
    assert_ne!(frame.flags & DetectionFrame::SEARCH_CUT, 0);
    let said = reasons(&frame, Team::Yellow).contains(&RejectReason::SearchCut);
    assert!(
        said || names(&frame).iter().any(|name| name.0 == Team::Yellow),
        "{:?}",
        frame.rejected()
    );
    assert!(names(&frame).contains(&(Team::Blue, 9)), "{:?}", names(&frame));
}

#[test]
fn doubtful_patches_of_one_team_do_not_take_the_others_time() {
    // Stripes in yellow all over the pitch, each of which might be a robot whose other patches are too dark, and
    // a blue robot with a hole in an identification patch, which only its pixels name.
    let config = Preset::MirosotLarge.config();
    let mut picture = Picture::of_robots(&config, &[]);
    let top = &config.robots.patches;
    let yellow = picture.class("yellow");
    let lone: Vec<Option<u8>> =
        top.iter().map(|patch| (patch.role == PatchRole::Team).then_some(yellow)).collect();
    let blue = robot(Team::Blue, 4, 0.0, 0.0, 30.0);
    for index in 0..240u32 {
        let (x, y) = (f64::from(index % 20) - 9.5, f64::from(index / 20) - 5.5);
        let place = geometry::FieldPoint::new(x * 200.0, y * 220.0);
        if place.distance(blue.pose.position) > 250.0 {
            let pose = geometry::Pose { position: place, orientation: f64::from(index) };
            picture.paint_top(&pose, &lone);
        }
    }
    let classes = picture.classes_of(&blue);
    picture.paint_top(&blue.pose, &classes);
    let hole = blue.pose.field_from_robot([-18.5, 18.5]);
    picture.square([hole.x_mm, hole.y_mm], 26.0, None);
    let frame = picture.detections();
    assert_eq!(names(&frame), [(Team::Blue, 4)]);
    assert_ne!(frame.flags & DetectionFrame::SEARCH_CUT, 0);
    assert!(reasons(&frame, Team::Yellow).contains(&RejectReason::NotLookedAt));
}
