//! Robots at many places and headings, in several layouts, come out where they are.

mod support;

use config::{Config, Preset};
use geometry::FieldPoint;
use messages::{DetectionFrame, Team};
use support::*;

/// Every robot of a configuration, spread over the field in a grid, headings all different; `turn`
/// shifts places and headings.
fn spread_out(config: &Config, turn: u32) -> Vec<Robot> {
    let count = config.robots.identities.len();
    let columns = (count as f64).sqrt().ceil() as usize;
    let rows = count.div_ceil(columns);
    config
        .robots
        .identities
        .iter()
        .enumerate()
        .map(|(index, identity)| {
            let along = |step: usize, steps: usize, length: f64| {
                ((step as f64 + 0.5) / steps as f64 - 0.5) * (length - 120.0)
            };
            let wobble = f64::from(turn) * 1.37;
            robot(
                identity.team,
                identity.id,
                along(index % columns, columns, config.field.length_mm) + wobble.sin() * 9.0,
                along(index / columns, rows, config.field.width_mm) + wobble.cos() * 9.0,
                (index as f64) * 137.5 + f64::from(turn) * 23.0,
            )
        })
        .collect()
}

fn check_layout(config: &Config, most_mm: f64, most_deg: f64) {
    let mut worst = (0.0f64, 0.0f64);
    for turn in 0..8 {
        let robots = spread_out(config, turn);
        let frame = Picture::of_robots(config, &robots).detections();
        let errors = assert_found(&frame, &robots, most_mm, most_deg);
        worst = (worst.0.max(errors.0), worst.1.max(errors.1));
        check_image_poses(&frame, &robots, config, most_deg.max(3.5));
        assert!(frame.robots().iter().all(|robot| robot.confidence > 0.7), "{:?}", frame.robots());
        assert!(frame.rejected().is_empty(), "{:?}", frame.rejected());
    }
    eprintln!("worst: {:.2} mm, {:.2}°", worst.0, worst.1);
}

fn check_image_poses(frame: &DetectionFrame, robots: &[Robot], config: &Config, most_deg: f64) {
    let picture = Picture::new(config);
    for found in frame.robots() {
        let is_it = |r: &&Robot| (r.team as u32, r.id.into()) == (found.team, found.robot_id);
        let truth = robots.iter().find(is_it).unwrap();
        let height = config.robots.height_mm;
        let at = |x| picture.camera.image_from_field(truth.pose.field_from_robot([x, 0.0]), height);
        let (center, ahead) = (at(0.0), at(30.0));
        let off = (f64::from(found.x_px) - center.x_px).hypot(f64::from(found.y_px) - center.y_px);
        assert!(off < 1.0, "{off} px");
        let heading = (center.y_px - ahead.y_px).atan2(ahead.x_px - center.x_px);
        let turned = (f64::from(found.orientation_image) - heading).sin().abs().to_degrees();
        assert!(turned < most_deg, "{turned}°");
    }
}

#[test]
fn the_papers_diagonal_squares() {
    check_layout(&Config::default(), 1.0, 2.0);
}

#[test]
fn a_stripe_and_two_patches() {
    check_layout(&Preset::MirosotLarge.config(), 1.5, 2.5);
}

#[test]
fn diagonal_squares_on_a_vsss_field() {
    check_layout(&Preset::Vsss3v3.config(), 1.0, 2.0);
}

#[test]
fn half_a_square_and_two_triangles() {
    // By centroids alone: where the long edge that two patches share runs along a diagonal of the
    // pixel grid, all pixels on it go to one side.
    check_layout(&Preset::MirosotTriangles.config(), 1.5, 7.0);
}

#[test]
fn four_squares() {
    check_layout(&Preset::MirosotQuadrants.config(), 1.0, 2.0);
}

#[test]
fn a_square_with_a_patch_in_its_corner() {
    check_layout(&Preset::VsssCorner.config(), 1.5, 2.5);
}

/// Thirty-two robots, all that the standard pattern can name, at 5 mm a pixel.
#[test]
fn a_dot_and_four_around_it() {
    check_layout(&Preset::SslDivisionB.config(), 2.5, 2.5);
}

#[test]
fn a_full_square_with_an_identification_corner() {
    check_layout(&full_square_with_corner(), 1.0, 2.0);
}

#[test]
fn a_half_square_and_two_triangles() {
    check_layout(&half_and_two_triangles(), 1.5, 3.5);
}

#[test]
fn mirror_images_are_not_mixed_up() {
    // Red–green and green–red, the same colours on opposite sides.
    let config = half_and_two_triangles();
    for heading in (0..360).step_by(15) {
        for id in [3, 4] {
            let robots = [robot(Team::Yellow, id, 100.0, 50.0, f64::from(heading))];
            assert_found(&Picture::of_robots(&config, &robots).detections(), &robots, 2.0, 3.0);
        }
    }
}

#[test]
fn parallax_is_corrected_at_the_edge_of_the_field() {
    let config = Config::default();
    let robots = [
        robot(Team::Yellow, 0, 1060.0, 860.0, 10.0),
        robot(Team::Blue, 1, -1060.0, -860.0, 200.0),
        robot(Team::Blue, 2, 1180.0, 0.0, 90.0),
    ];
    assert_found(&Picture::of_robots(&config, &robots).detections(), &robots, 1.0, 2.0);
    // Without the correction the corners would be some 3.5 % farther out.
    let mut flat = config.clone();
    flat.robots.height_mm = 0.0;
    let frame = detections(&flat, &Picture::of_robots(&config, &robots).runs(), None);
    assert!(error_of(&frame.robots()[0], &robots[0]).0 > 30.0);
}

#[test]
fn the_ball_is_found_beside_a_robot() {
    let config = Config::default();
    let robots = [robot(Team::Yellow, 4, 0.0, 0.0, 0.0)];
    let mut picture = Picture::new(&config);
    let place = FieldPoint::new(62.0, 5.0);
    picture.ball(place);
    picture.paint_robot(&robots[0]);
    let frame = picture.detections();
    assert_found(&frame, &robots, 1.0, 2.0);
    let ball = frame.balls()[0];
    assert!(place.distance(FieldPoint::new(ball.x_mm.into(), ball.y_mm.into())) < 2.5, "{ball:?}");
    assert!(ball.confidence > 0.6, "{ball:?}");
    assert_eq!(frame.regions()[ball.region as usize].class, u32::from(picture.class("orange")));
}

#[test]
fn the_message_names_its_inputs() {
    let config = Config::default();
    let robots = spread_out(&config, 0);
    let frame = Picture::of_robots(&config, &robots).detections();
    assert_eq!(frame.frame.seq, 100);
    assert_eq!(frame.prior_world_seq, DetectionFrame::NO_WORLD);
    assert_eq!(frame.flags, 0);
    for robot in frame.robots() {
        let [team, identification, rest @ ..] = robot.patch_regions;
        assert_eq!(robot.patch_count, 2);
        assert!(rest.iter().all(|&region| region == u32::MAX));
        let color = |region: u32| {
            let class = frame.regions()[region as usize].class as usize;
            config.colors[class].name.as_str()
        };
        let team_name = Team::from_number(robot.team).unwrap().name();
        assert_eq!(color(team), team_name);
        let identity = config
            .robots
            .identities
            .iter()
            .find(|i| (i.team as u32, i.id.into()) == (robot.team, robot.robot_id))
            .unwrap();
        assert_eq!(color(identification), identity.colors[0]);
    }
}
