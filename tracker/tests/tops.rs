//! Robots whose tops differ: in height, in the patches they have, in what contradicts a name.

mod support;

use config::{Config, PatchConfig, PatchRole, Preset};
use messages::{RejectReason, Team};
use support::*;

use Team::{Blue, Yellow};

/// Robots of both teams far from the middle, where a wrong height shows most.
fn at_the_edges(config: &Config) -> Vec<Robot> {
    config
        .robots
        .identities
        .iter()
        .zip(0u32..)
        .map(|(identity, index)| {
            let x = f64::from(index % 5) * 450.0 - 900.0;
            let y = if index < 5 { 750.0 } else { -750.0 };
            robot(identity.team, identity.id, x, y, f64::from(index) * 77.0)
        })
        .collect()
}

#[test]
fn teams_and_robots_have_heights_of_their_own() {
    let mut config = Config::default();
    config.robots.height_mm = 50.0;
    config.teams.blue.height_mm = Some(150.0);
    config.robots.identities[1].height_mm = Some(90.0);
    let robots = at_the_edges(&config);
    let picture = Picture::of_robots(&config, &robots);
    let frame = picture.detections();
    assert_found(&frame, &robots, 1.5, 2.5);

    // Taken for robots of one height, the tall ones are centimetres off.
    let mut flat = config.clone();
    flat.teams.blue.height_mm = None;
    flat.robots.identities[1].height_mm = None;
    let frame = detections(&flat, &picture.runs(), None);
    let off = |robot: &Robot| {
        let is_it = |found: &&messages::DetectedRobot| {
            (found.team, found.robot_id) == (robot.team as u32, robot.id.into())
        };
        frame.robots().iter().find(is_it).map(|found| error_of(found, robot).0)
    };
    let worst =
        robots.iter().filter(|robot| robot.team == Blue).filter_map(off).fold(0.0, f64::max);
    assert!(worst > 30.0, "{worst} mm");
}

#[test]
fn a_tall_robot_of_which_only_the_team_is_known_is_where_it_is() {
    let mut config = Config::default();
    config.teams.blue.height_mm = Some(150.0);
    config.robots.report_unknown = true;
    let opponent = robot(Blue, 2, 900.0, -700.0, 30.0);
    let picture = Picture::of_robots(&config, &[opponent]);
    // No listed robot wears its identification patch.
    config.robots.identities.retain(|identity| (identity.team, identity.id) != (Blue, 2));
    let frame = detections(&config, &picture.runs(), None);
    let [found] = frame.robots() else { panic!("{:?}", frame.robots()) };
    assert!(!found.is_identified());
    // The patch lies 25 mm from the centre.
    assert!((error_of(found, &opponent).0 - 25.5).abs() < 1.5, "{found:?}");
}

fn patch(role: PatchRole, outline_mm: &[[f64; 2]]) -> PatchConfig {
    PatchConfig { role, outline_mm: outline_mm.to_vec() }
}

fn rectangle([left, right]: [f64; 2], [low, high]: [f64; 2]) -> Vec<[f64; 2]> {
    vec![[left, low], [right, low], [right, high], [left, high]]
}

/// Five robots of one team in two colours, told apart by the shapes of their patches.
fn shapes() -> Config {
    use PatchRole::{Identification, Team};
    let mut config = Preset::Vsss3v3.config();
    let half = patch(Team, &rectangle([0.0, 37.0], [-37.0, 37.0]));
    let rest = patch(Identification, &rectangle([-37.0, 0.0], [-37.0, 37.0]));
    let whole = patch(Identification, &rectangle([-37.0, 37.0], [-37.0, 37.0]));
    let triangle = patch(Team, &[[37.0, 0.0], [-37.0, 37.0], [-37.0, -37.0]]);
    let behind_right = patch(Identification, &rectangle([-37.0, -10.0], [-37.0, -10.0]));
    let behind_left = patch(Identification, &rectangle([-37.0, -10.0], [10.0, 37.0]));
    let ahead_left = patch(Identification, &rectangle([18.0, 37.0], [18.0, 37.0]));
    let tops = [
        vec![half.clone(), rest.clone()],
        vec![half.clone(), rest.clone(), behind_right.clone()],
        vec![half, rest, behind_right, behind_left],
        vec![whole.clone(), triangle.clone()],
        vec![whole, triangle, ahead_left],
    ];
    let colors = ["pink", "yellow", "yellow"];
    config.robots.identities = (0..)
        .zip(tops)
        .map(|(id, patches)| {
            let colors = colors[..patches.len() - 1].iter().map(|&color| color.into()).collect();
            let mut robot = config::IdentityConfig::new(Yellow, id, colors);
            robot.patches = Some(patches);
            robot
        })
        .collect();
    config
}

#[test]
fn robots_are_told_apart_by_the_shapes_of_their_patches() {
    let config = shapes();
    for turn in 0..12 {
        let robots: Vec<Robot> = (0..5)
            .map(|id| {
                let heading = f64::from(turn * 31 + id * 77);
                robot(Yellow, id, f64::from(id) * 250.0 - 500.0, 200.0, heading)
            })
            .collect();
        let frame = Picture::of_robots(&config, &robots).detections();
        assert_found(&frame, &robots, 2.5, 4.0);
    }
}

/// A stripe ahead, two identification squares behind; robots of these pairs of colours.
fn striped(pairs: &[[&str; 2]]) -> Config {
    let mut config = Preset::MirosotLarge.config();
    config.robots.identities = (0..)
        .zip(pairs)
        .map(|(id, pair)| {
            let colors = pair.iter().map(|&color| color.into()).collect();
            config::IdentityConfig::new(Yellow, id, colors)
        })
        .collect();
    config
}

#[test]
fn a_patch_of_another_colour_in_its_place_contradicts_a_name() {
    let worn = [["green", "red"], ["pink", "cyan"], ["red", "pink"]];
    let config = striped(&worn);
    for turn in 0..8 {
        let robots: Vec<Robot> = (0..3)
            .map(|id| {
                robot(Yellow, id, f64::from(id) * 300.0, 100.0, f64::from(turn * 47 + id * 90))
            })
            .collect();
        let picture = Picture::of_robots(&config, &robots);
        let runs = picture.runs();
        assert_found(&detections(&config, &runs, None), &robots, 2.5, 3.0);
        // Left and right exchanged; one of both right, and the other a colour that is not there.
        let mirrored = striped(&worn.map(|[left, right]| [right, left]));
        let half = striped(&worn.map(|[left, _]| [left, "violet"]));
        for config in [mirrored, half] {
            let frame = detections(&config, &runs, None);
            assert_eq!(names(&frame), [], "turned by {turn} steps");
            let mismatches = reasons(&frame, Yellow);
            assert!(mismatches.contains(&RejectReason::LayoutMismatch), "{mismatches:?}");
        }
    }
}

#[test]
fn a_patch_that_is_missing_does_not_contradict_a_name() {
    let config = striped(&[["green", "red"], ["pink", "cyan"]]);
    let robots = [robot(Yellow, 0, 100.0, 100.0, 40.0)];
    let mut picture = Picture::of_robots(&config, &robots);
    let red = picture.class("red");
    for label in &mut picture.labels {
        *label = label.filter(|&class| class != red);
    }
    assert_found(&picture.detections(), &robots, 6.0, 6.0);
}

#[test]
fn round_robots_that_touch_are_all_found() {
    let config = Preset::SslDivisionB.config();
    // Side by side, front to front, front to back; 180 mm wide, their fronts 75 mm from the centre.
    let robots = [
        robot(Yellow, 0, 0.0, 0.0, 90.0),
        robot(Yellow, 1, 181.0, 0.0, 90.0),
        robot(Blue, 2, 0.0, 151.0, -90.0),
        robot(Blue, 3, 181.0, 166.0, 90.0),
        robot(Blue, 4, 900.0, 0.0, 0.0),
        robot(Yellow, 5, 1051.0, 0.0, 180.0),
        robot(Yellow, 6, 900.0, 181.0, 45.0),
    ];
    assert_found(&Picture::of_robots(&config, &robots).detections(), &robots, 2.5, 2.5);
}
