//! Situations that lead a simple pairing astray: those of Fig. 7 of the paper, robots that touch,
//! patches in pieces, patches that are missing.

mod support;

use bytemuck::Zeroable;
use config::{Config, Preset};
use geometry::FieldPoint;
use messages::{RejectReason, Team, TrackStatus, WorldFrame};
use std::f64::consts::FRAC_PI_4;
use support::*;

use Team::{Blue, Yellow};

#[test]
fn figure_7a_robots_far_apart_and_noise() {
    let config = Config::default();
    let robots = [
        robot(Yellow, 1, -600.0, 300.0, 30.0),
        robot(Yellow, 0, 100.0, -200.0, 140.0),
        robot(Yellow, 2, 700.0, 400.0, 260.0),
    ];
    let mut picture = Picture::of_robots(&config, &robots);
    // Regions D (team colour) and 4 (identification), both small, in a patch's distance.
    let (yellow, red) = (picture.class("yellow"), picture.class("red"));
    picture.square([300.0, 500.0], 15.0, Some(yellow));
    picture.square([336.0, 536.0], 16.0, Some(red));
    let frame = picture.detections();
    assert_found(&frame, &robots, 1.0, 2.0);
    assert_eq!(frame.regions().len(), 8);
    assert_eq!(reasons(&frame, Yellow), [RejectReason::TooSmall]);
}

/// For each robot, whether the identification patch nearest to its team patch is another robot's.
fn misled(config: &Config, robots: &[Robot]) -> usize {
    let layout = geometry::layout::Layout::new(&config.robots);
    let place = |robot: &Robot, patch: usize| {
        robot.pose.field_from_robot(layout.patches[patch].centroid_mm)
    };
    robots
        .iter()
        .filter(|robot| {
            let own = place(robot, 0).distance(place(robot, 1));
            robots
                .iter()
                .any(|other| other != *robot && place(robot, 0).distance(place(other, 1)) < own)
        })
        .count()
}

#[test]
fn figure_7b_the_nearest_patch_belongs_to_another_robot() {
    let config = Config::default();
    // C's team patch in the corner between the other two robots' identification patches.
    let robots = [
        robot(Yellow, 2, 0.0, 0.0, 0.0),
        robot(Yellow, 3, 50.0, 80.0, 0.0),
        robot(Yellow, 1, -40.0, 82.0, 180.0),
    ];
    assert!(misled(&config, &robots) >= 1);
    let frame = Picture::of_robots(&config, &robots).detections();
    assert_found(&frame, &robots, 1.5, 3.0);
}

#[test]
fn figure_7c_two_robots_face_to_back() {
    let config = Config::default();
    for gap in [76.0, 80.0, 85.0] {
        let robots = [robot(Yellow, 1, 0.0, 0.0, 0.0), robot(Yellow, 2, gap, 0.0, 90.0)];
        assert_found(&Picture::of_robots(&config, &robots).detections(), &robots, 1.5, 3.0);
        let robots = [robot(Yellow, 1, 0.0, 0.0, 0.0), robot(Yellow, 2, gap, 30.0, 0.0)];
        assert!(misled(&config, &robots) >= 1);
        assert_found(&Picture::of_robots(&config, &robots).detections(), &robots, 1.5, 3.0);
    }
}

#[test]
fn pairs_that_touch_in_any_way() {
    let config = Config::default();
    let mut worst = (0.0f64, 0.0f64);
    for step in 0..72 {
        // The second robot rolls around the first.
        let around = f64::from(step) * 5f64.to_radians();
        let heading = f64::from(step * 35 % 360);
        let (first_heading, ids) = (f64::from(step * 20 % 360), [(Yellow, 1), (Yellow, 2)]);
        for teams in [ids, [(Yellow, 3), (Blue, 3)]] {
            let first = robot(teams[0].0, teams[0].1, 0.0, 0.0, first_heading);
            let distance = touching_distance(first.pose.orientation, around, heading.to_radians());
            let second = robot(
                teams[1].0,
                teams[1].1,
                distance * around.cos(),
                distance * around.sin(),
                heading,
            );
            let robots = [first, second];
            let frame = Picture::of_robots(&config, &robots).detections();
            let errors = assert_found(&frame, &robots, 2.0, 3.0);
            worst = (worst.0.max(errors.0), worst.1.max(errors.1));
        }
    }
    eprintln!("worst: {:.2} mm, {:.2}°", worst.0, worst.1);
}

/// How far apart in direction `around` the centres of two robots are that just touch.
fn touching_distance(heading_a: f64, around: f64, heading_b: f64) -> f64 {
    let (size, half) = (75.0, 37.5);
    let delta = heading_a - heading_b;
    let reach = half * (1.0 + delta.sin().abs() + delta.cos().abs());
    // Separated as soon as one of the axes separates them.
    [heading_a, heading_a + 2.0 * FRAC_PI_4, heading_b, heading_b + 2.0 * FRAC_PI_4]
        .iter()
        .map(|axis| reach / (around - axis).cos().abs().max(1e-6))
        .fold(f64::INFINITY, f64::min)
        .max(size)
}

#[test]
fn the_same_identification_in_both_teams() {
    let config = Config::default();
    for heading in (0..360).step_by(30) {
        let robots = [
            robot(Yellow, 2, 0.0, 0.0, f64::from(heading)),
            robot(Blue, 2, 108.0, 20.0, f64::from(heading * 2)),
        ];
        assert_found(&Picture::of_robots(&config, &robots).detections(), &robots, 1.5, 3.0);
    }
}

#[test]
fn a_row_of_robots_shoulder_to_shoulder() {
    let config = Config::default();
    let robots: Vec<Robot> =
        (0..5).map(|id| robot(Blue, id, f64::from(id) * 76.0 - 150.0, 40.0, 45.0 * 2.0)).collect();
    assert_found(&Picture::of_robots(&config, &robots).detections(), &robots, 1.5, 3.0);
}

#[test]
fn robots_that_look_over_a_corner_stand_side_by_side() {
    for config in [half_and_two_triangles(), full_square_with_corner_ahead()] {
        // The sides of their bodies are those of the field.
        for (first, second) in [(45.0, 45.0), (45.0, 135.0), (-135.0, -45.0), (135.0, -45.0)] {
            for team in [Yellow, Blue] {
                let robots = [robot(Yellow, 1, 0.0, 0.0, first), robot(team, 2, 76.0, 8.0, second)];
                let frame = Picture::of_robots(&config, &robots).detections();
                assert_found(&frame, &robots, 4.0, 6.0);
            }
        }
    }
}

#[test]
fn patches_are_found_on_a_floor_of_their_colour() {
    let config = half_and_two_triangles();
    for heading in (0..360).step_by(45) {
        // Both wear green, on different sides.
        let robots = [
            robot(Yellow, 0, 0.0, 0.0, f64::from(heading)),
            robot(Blue, 4, 110.0, 20.0, f64::from(heading + 30)),
        ];
        let mut picture = Picture::new(&config);
        let green = picture.class("green");
        picture.square([50.0, 0.0], 500.0, Some(green));
        for robot in &robots {
            // No dark rim keeps the patches apart from the floor.
            let mut classes = picture.classes_of(robot);
            classes.push(Some(green));
            picture.paint_top(&robot.pose, &classes);
        }
        let frame = picture.detections();
        assert_eq!(frame.regions().len(), 5, "the green patches are not part of the floor");
        assert_found(&frame, &robots, 6.0, 12.0);
    }
}

/// Paints the gap between two patches, as blurred colours do.
fn bridge(picture: &mut Picture, from: FieldPoint, to: FieldPoint, class: u8) {
    let (x, y) = ((from.x_mm + to.x_mm) / 2.0, (from.y_mm + to.y_mm) / 2.0);
    picture.square([x, y], 30.0, Some(class));
}

#[test]
fn team_patches_grown_together_come_apart() {
    let config = Config::default();
    let layout = geometry::layout::Layout::new(&config.robots);
    // Nose to nose, so that the team patches lie side by side; and one behind the other.
    for (second, most_mm) in [
        (robot(Yellow, 2, 76.0, 36.0, 180.0), 3.0),
        (robot(Yellow, 2, 36.0, 76.0, 180.0), 3.0),
        (robot(Yellow, 2, 76.0, 0.0, 90.0), 3.0),
    ] {
        let robots = [robot(Yellow, 1, 0.0, 0.0, 0.0), second];
        let mut picture = Picture::of_robots(&config, &robots);
        let [a, b] = robots.map(|robot| robot.pose.field_from_robot(layout.patches[0].centroid_mm));
        let yellow = picture.class("yellow");
        bridge(&mut picture, a, b, yellow);
        let frame = picture.detections();
        let yellows = frame.regions().iter().filter(|r| r.class == u32::from(yellow)).count();
        assert_eq!(yellows, 1, "the patches have not grown together");
        assert_found(&frame, &robots, most_mm, 6.0);
        assert!(frame.rejected().is_empty());
    }
}

#[test]
fn identification_patches_grown_together_come_apart() {
    let config = Config::default();
    let layout = geometry::layout::Layout::new(&config.robots);
    let robots = [robot(Yellow, 3, 0.0, 0.0, 0.0), robot(Blue, 3, -76.0, -36.0, 180.0)];
    let mut picture = Picture::of_robots(&config, &robots);
    let [a, b] = robots.map(|robot| robot.pose.field_from_robot(layout.patches[1].centroid_mm));
    let violet = picture.class("violet");
    bridge(&mut picture, a, b, violet);
    let frame = picture.detections();
    assert_eq!(frame.regions().len(), 3);
    assert_found(&frame, &robots, 3.0, 6.0);
}

#[test]
fn full_tops_of_one_team_grow_together_and_come_apart() {
    let mut config = full_square_with_corner();
    config.robots.size_mm = 72.0;
    for headings in [[0.0, 0.0], [90.0, 0.0], [180.0, 0.0], [0.0, 270.0]] {
        let robots =
            [robot(Yellow, 1, 0.0, 0.0, headings[0]), robot(Yellow, 2, 71.5, 10.0, headings[1])];
        let frame = Picture::of_robots(&config, &robots).detections();
        assert_eq!(frame.regions().len(), 3, "the tops have not grown together");
        assert_found(&frame, &robots, 3.0, 6.0);
    }
}

#[test]
fn a_patch_in_pieces_is_one_patch() {
    let config = Config::default();
    let robots = [robot(Yellow, 0, 200.0, 100.0, 0.0)];
    let mut picture = Picture::of_robots(&config, &robots);
    // A crack across the team patch: a column of pixels loses its colour.
    let crack = picture.camera.image_from_field(FieldPoint::new(220.0, 118.0), 75.0).x_px as usize;
    for row in 0..480 {
        picture.labels[row * 640 + crack] = None;
    }
    let frame = picture.detections();
    assert_eq!(frame.regions().len(), 3);
    assert_found(&frame, &robots, 1.5, 3.0);
    assert!(frame.rejected().is_empty(), "{:?}", frame.rejected());
}

#[test]
fn a_missing_identification_patch_is_reported() {
    let config = Config::default();
    let lone = robot(Blue, 2, 200.0, 100.0, 60.0);
    let whole = robot(Yellow, 1, -300.0, 100.0, 0.0);
    let mut picture = Picture::of_robots(&config, &[whole]);
    let mut classes = picture.classes_of(&lone);
    classes[1] = None;
    picture.paint_top(&lone.pose, &classes);
    let frame = picture.detections();
    assert_found(&frame, &[whole], 1.0, 2.0);
    assert_eq!(reasons(&frame, Blue), [RejectReason::NoIdentificationPatch]);
    assert_eq!(reasons(&frame, Yellow), []);
    let rejected = frame.rejected()[0];
    let place = picture.camera.field_from_image(
        geometry::ImagePoint::new(rejected.x_px.into(), rejected.y_px.into()),
        75.0,
    );
    assert!(place.distance(lone.pose.field_from_robot([18.0, 18.0])) < 2.0);
}

#[test]
fn the_prior_invents_nobody() {
    let config = Config::default();
    let lone = robot(Blue, 2, 200.0, 100.0, 60.0);
    let mut picture = Picture::new(&config);
    let mut classes = picture.classes_of(&lone);
    classes[1] = None;
    picture.paint_top(&lone.pose, &classes);
    let world = world_with(&[lone]);
    let frame = picture.detections_after(Some(&world));
    assert_eq!(frame.prior_world_seq, 99);
    assert!(frame.robots().is_empty());
}

fn world_with(robots: &[Robot]) -> Box<WorldFrame> {
    let mut world = Box::new(WorldFrame::zeroed());
    world.frame.seq = 99;
    world.frame.t_capture_ns = 987_500_000;
    world.robot_count = robots.len() as u32;
    for (state, robot) in world.robots.iter_mut().zip(robots) {
        state.team = robot.team as u32;
        state.robot_id = robot.id;
        state.status = TrackStatus::Measured as u32;
        state.x_mm = robot.pose.position.x_mm;
        state.y_mm = robot.pose.position.y_mm;
        state.orientation = robot.pose.orientation;
    }
    world
}

#[test]
fn the_prior_breaks_ties() {
    // One team patch midway between two identification patches: both robots are as good.
    let config = Config::default();
    let mut picture = Picture::new(&config);
    let [yellow, green, pink] = ["yellow", "green", "pink"].map(|color| picture.class(color));
    let off = 36.0 * 2f64.sqrt();
    picture.square([0.0, 0.0], 34.0, Some(yellow));
    picture.square([off, 0.0], 34.0, Some(green));
    picture.square([-off, 0.0], 34.0, Some(pink));
    for (id, x) in [(0, off / 2.0), (2, -off / 2.0)] {
        let world = world_with(&[robot(Yellow, id, x, 0.0, 0.0)]);
        let frame = picture.detections_after(Some(&world));
        assert_eq!(names(&frame), [(Yellow, id)]);
    }
}

#[test]
fn every_reason_has_its_situation() {
    let config = Config::default();
    let mut picture = Picture::new(&config);
    let [yellow, green, red] = ["yellow", "green", "red"].map(|color| picture.class(color));
    let off = 36.0 * 2f64.sqrt();
    // Too small, though not tiny.
    picture.square([-900.0, 600.0], 16.0, Some(yellow));
    // Too large.
    picture.square([-600.0, 600.0], 90.0, Some(yellow));
    // Alone.
    picture.square([-300.0, 600.0], 34.0, Some(yellow));
    // An identification patch beside it, but too near.
    picture.square([0.0, 600.0], 34.0, Some(yellow));
    picture.square([36.0, 600.0], 32.0, Some(green));
    // A robot, and a second team patch that would also go with its identification patch.
    picture.square([300.0, 600.0], 34.0, Some(yellow));
    picture.square([300.0 + off, 600.0], 34.0, Some(red));
    picture.square([300.0 + 2.15 * off, 600.0], 34.0, Some(yellow));
    // Outside.
    picture.square([-1230.0, 600.0], 34.0, Some(yellow));
    let frame = picture.detections();
    assert_eq!(names(&frame), [(Yellow, 4)]);
    let mut found: Vec<(i64, RejectReason)> = frame
        .rejected()
        .iter()
        .zip(reasons(&frame, Yellow))
        .map(|(rejected, reason)| (rejected.x_px as i64, reason))
        .collect();
    found.sort();
    let found: Vec<RejectReason> = found.into_iter().map(|(_, reason)| reason).collect();
    use RejectReason::*;
    assert_eq!(
        found,
        [OutsideField, TooSmall, TooLarge, NoIdentificationPatch, LayoutMismatch, TakenByAnother]
    );
}

#[test]
fn a_second_patch_of_the_team_too_close_to_the_first_is_no_robot() {
    let config = Config::default();
    let mut picture = Picture::new(&config);
    let [yellow, cyan] = ["yellow", "cyan"].map(|color| picture.class(color));
    // A patch so large that its halves cannot be pieces of one.
    picture.square([18.0, 18.0], 42.0, Some(yellow));
    picture.square([-18.0, -18.0], 34.0, Some(cyan));
    let crack = picture.camera.image_from_field(FieldPoint::new(18.0, 18.0), 75.0).x_px as usize;
    for row in 0..480 {
        picture.labels[row * 640 + crack] = None;
    }
    let frame = picture.detections();
    assert_eq!(frame.regions().len(), 3);
    assert_eq!(names(&frame), [(Yellow, 1)]);
    assert_eq!(reasons(&frame, Yellow), [RejectReason::TooCloseToTeamPatch]);
}

#[test]
fn an_identification_patch_without_a_team_patch_is_told_of() {
    let config = Config::default();
    let lone = robot(Blue, 2, 200.0, 100.0, 60.0);
    let whole = robot(Yellow, 1, -300.0, 100.0, 0.0);
    let mut picture = Picture::of_robots(&config, &[whole]);
    let mut classes = picture.classes_of(&lone);
    classes[0] = None;
    picture.paint_top(&lone.pose, &classes);
    let frame = picture.detections();
    assert_found(&frame, &[whole], 1.0, 2.0);
    let [rejected] = frame.rejected() else { panic!("{:?}", frame.rejected()) };
    assert_eq!(rejected.team, messages::Rejected::UNKNOWN_TEAM);
    assert_eq!(rejected.reason, RejectReason::NoTeamPatch as u32);
    let place = lone.pose.field_from_robot([-18.0, -18.0]);
    let image = picture.camera.image_from_field(place, 75.0);
    let off = (f64::from(rejected.x_px) - image.x_px).hypot(f64::from(rejected.y_px) - image.y_px);
    assert!(off < 1.0, "{off} px");

    // Not outside the pitch, and not if it is no patch of the layout by its size.
    let mut picture = Picture::new(&config);
    let green = picture.class("green");
    picture.square([-1230.0, 600.0], 34.0, Some(green));
    picture.square([0.0, 0.0], 90.0, Some(green));
    assert!(picture.detections().rejected().is_empty());
}

#[test]
fn a_robot_of_which_only_the_team_is_known_has_a_place() {
    let mut config = Config::default();
    config.robots.report_unknown = true;
    let known = [robot(Yellow, 1, -300.0, 100.0, 0.0), robot(Blue, 0, 300.0, -400.0, 30.0)];
    let mut picture = Picture::of_robots(&config, &known);
    let [yellow, blue] = ["yellow", "blue"].map(|color| picture.class(color));
    picture.square([200.0, 100.0], 34.0, Some(blue));
    picture.square([-500.0, -500.0], 34.0, Some(yellow));
    // Neither noise, nor what lies outside, nor a blob.
    picture.square([0.0, 600.0], 12.0, Some(blue));
    picture.square([0.0, -600.0], 90.0, Some(blue));
    picture.square([-1230.0, 600.0], 34.0, Some(yellow));
    let frame = picture.detections();
    let unknown = UNKNOWN;
    assert_eq!(names(&frame), [(Yellow, 1), (Yellow, unknown), (Blue, 0), (Blue, unknown)]);
    for (index, place) in [(1, [-500.0, -500.0]), (3, [200.0, 100.0])] {
        let found = &frame.robots()[index];
        let off = (f64::from(found.x_mm) - place[0]).hypot(f64::from(found.y_mm) - place[1]);
        assert!(off < 1.5 && !found.is_identified() && found.confidence <= 0.5, "{found:?}");
        // Sigma is the distance of the patch from the centre; the heading is unknown.
        let [xx, .., tt] = found.covariance.map(f32::sqrt);
        assert!((15.0..25.0).contains(&xx) && tt > 1.5, "{found:?}");
    }
    // Reported robots are not rejected as well; other regions still are.
    let told: Vec<_> = frame.rejected().iter().map(|rejected| rejected.reason).collect();
    assert!(!told.contains(&(RejectReason::NoIdentificationPatch as u32)), "{told:?}");
    assert!(told.contains(&(RejectReason::TooLarge as u32)), "{told:?}");

    // Off by default.
    picture.config.robots.report_unknown = false;
    assert_eq!(names(&picture.detections()), [(Yellow, 1), (Blue, 0)]);
}

/// A floor beside the pitch that looks like team patches all over must not use up the time for
/// robots that only their pixels can name.
#[test]
fn a_floor_full_of_team_patches_leaves_time_for_robots() {
    let mut config = Preset::MirosotTriangles.config();
    (config.field.length_mm, config.field.width_mm) = (1700.0, 1300.0);
    let mut picture = Picture::new(&config);
    let yellow = Some(picture.class("yellow"));
    let beside = config.field.margin_mm + 45.0;
    let (x_edge, y_edge) = (850.0 + beside, 650.0 + beside);
    let mut places = Vec::new();
    for step in -8..=8i32 {
        let along = f64::from(step) * 90.0;
        // Turned so that the patch lies along the edge.
        places.extend([(along, y_edge, -45.0), (along, -y_edge, -45.0)]);
        if step.abs() < 7 {
            places.extend([(x_edge, along, 45.0), (-x_edge, along, 45.0)]);
        }
    }
    for (x, y, heading) in &places {
        let pose = robot(Yellow, 0, *x, *y, *heading).pose;
        picture.paint_top(&pose, &[yellow, None, None]);
    }
    assert!(places.len() > 50);
    // One of its identification patches is too dark to have a colour.
    let dark = robot(Blue, 1, 200.0, -100.0, 20.0);
    let classes = ["blue", "pink"].map(|color| Some(picture.class(color)));
    picture.paint_top(&dark.pose, &[classes[0], None, classes[1]]);
    let frame = picture.detections();
    assert_eq!(names(&frame), [(Blue, 1)], "{:?}", frame.robots());
}
