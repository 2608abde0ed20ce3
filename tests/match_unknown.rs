//! Opponents of which only the team's colour is known: how well they are followed through synthetic
//! matches, through the cores of all stages, offline.

mod offline;

use config::Config;
use geometry::layout::Layout;
use geometry::{CameraModel, FieldPoint, ImagePoint, Pose};
use messages::{Team, TrackStatus, TruthFrame, TruthRobot, UnknownRobotState};
use offline::Offline;
use std::collections::HashMap;

/// A track farther than this from a robot's patch does not belong to it.
const SAME_ROBOT_MM: f64 = 20.0;

#[derive(Debug, Default)]
struct Outcome {
    /// Visible opponents, counted once per frame.
    expected: u64,
    followed: u64,
    /// Tracks without an opponent, counted once per frame.
    ghosts: u64,
    /// Number of changes of `track_id` of a followed opponent.
    switches: u64,
    /// Position errors of the patch.
    patch_mm: Vec<f64>,
    /// Position errors of the centre.
    center_mm: Vec<f64>,
    velocity_mm_s: Vec<f64>,
    /// Squared errors of centre and its velocity in units of their variance.
    normalised: [Vec<f64>; 2],
    numbers: HashMap<u32, u32>,
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

impl Outcome {
    fn note(&mut self, offline: &Offline, patch_mm: [f64; 2]) {
        let truth: Vec<&TruthRobot> = offline
            .game
            .truth()
            .robots()
            .iter()
            .filter(|robot| robot.team == Team::Blue as u32)
            .collect();
        let mut tracks: Vec<&UnknownRobotState> = offline.world().unknown_robots().iter().collect();
        for robot in truth {
            let (sin, cos) = robot.orientation.sin_cos();
            let arm =
                [cos * patch_mm[0] - sin * patch_mm[1], sin * patch_mm[0] + cos * patch_mm[1]];
            let patch = [robot.x_mm + arm[0], robot.y_mm + arm[1]];
            let off =
                |track: &UnknownRobotState| (track.x_mm - patch[0]).hypot(track.y_mm - patch[1]);
            self.expected += u64::from(robot.visible != 0);
            let nearest = (0..tracks.len())
                .filter(|&index| tracks[index].team == robot.team)
                .min_by(|&a, &b| off(tracks[a]).total_cmp(&off(tracks[b])));
            let Some(index) = nearest.filter(|&index| off(tracks[index]) < SAME_ROBOT_MM) else {
                continue;
            };
            let track = tracks.swap_remove(index);
            if robot.visible == 0 {
                continue;
            }
            self.followed += 1;
            let number = self.numbers.insert(robot.robot_id, track.track_id);
            self.switches += u64::from(number.is_some_and(|number| number != track.track_id));
            let place = [track.x_mm - robot.x_mm, track.y_mm - robot.y_mm];
            let velocity = [track.vx_mm_s - robot.v_mm_s * cos, track.vy_mm_s - robot.v_mm_s * sin];
            self.patch_mm.push(off(track));
            self.center_mm.push(place[0].hypot(place[1]));
            self.velocity_mm_s.push(velocity[0].hypot(velocity[1]));
            let in_sigma = |off: [f64; 2], first: usize| {
                off[0].powi(2) / track.covariance[first * 5]
                    + off[1].powi(2) / track.covariance[(first + 1) * 5]
            };
            self.normalised[0].push(in_sigma(place, 0));
            self.normalised[1].push(in_sigma(velocity, 2));
        }
        self.ghosts += tracks.len() as u64;
    }

    fn print(&mut self, what: &str) {
        let quantile = |values: &mut Vec<f64>, share: f64| {
            values.sort_by(f64::total_cmp);
            values.get((share * values.len() as f64) as usize).copied().unwrap_or(f64::NAN)
        };
        println!(
            "{what}: followed {}/{}, {} ghosts, {} switches; rms: patch {:.2} mm, centre {:.2} mm, \
             velocity {:.0} mm/s (patch 99 % {:.2}, velocity 99 % {:.0}); normalised means {:.2} {:.2}, 95 % {:.2} {:.2}",
            self.followed,
            self.expected,
            self.ghosts,
            self.switches,
            rms(&self.patch_mm),
            rms(&self.center_mm),
            rms(&self.velocity_mm_s),
            quantile(&mut self.patch_mm, 0.99),
            quantile(&mut self.velocity_mm_s, 0.99),
            mean(&self.normalised[0]),
            mean(&self.normalised[1]),
            quantile(&mut self.normalised[0], 0.95),
            quantile(&mut self.normalised[1], 0.95),
        );
    }
}

/// A configuration that knows the yellow robots only.
fn without_blue(config: &Config) -> Config {
    let mut config = config.clone();
    config.robots.report_unknown = true;
    config.robots.identities.retain(|identity| identity.team == Team::Yellow);
    config
}

fn patch_mm(config: &Config) -> [f64; 2] {
    Layout::new(&config.robots).patches[0].centroid_mm
}

/// Information for a change of the picture.
struct Moment {
    seq: u64,
    truth: TruthFrame,
}

fn play(painted: &Config, frames: u64, mut spoil: impl FnMut(&Moment, &mut [u8])) -> Outcome {
    let mut outcome = Outcome::default();
    let mut offline = Offline::watched_with(painted, &without_blue(painted));
    let patch_mm = patch_mm(painted);
    for seq in 0..frames {
        let moment = Moment { seq, truth: *offline.game.truth() };
        offline.look(|pixels| spoil(&moment, pixels));
        offline.think();
        if seq >= 40 {
            outcome.note(&offline, patch_mm);
        }
        offline.advance();
    }
    outcome
}

/// Draws a disc in the robots' own grey.
fn cover(pixels: &mut [u8], width: usize, middle: ImagePoint, radius_px: f64) {
    for (index, pixel) in pixels.iter_mut().enumerate() {
        let (x, y) = ((index % width) as f64, (index / width) as f64);
        if (x - middle.x_px).hypot(y - middle.y_px) < radius_px {
            *pixel = 25;
        }
    }
}

fn camera(config: &Config) -> CameraModel {
    CameraModel::new(&config.geometry, config.camera.width, config.camera.height).unwrap()
}

fn pose(robot: &TruthRobot) -> Pose {
    let position = FieldPoint::new(robot.x_mm, robot.y_mm);
    Pose { position, orientation: robot.orientation }
}

#[test]
fn opponents_are_followed() {
    for (speed, seed) in [(1500.0, 1), (1500.0, 2), (2400.0, 3), (2400.0, 4)] {
        let mut config = Config::default();
        config.synthetic.max_speed_mm_s = speed;
        config.synthetic.seed = seed;
        let mut outcome = play(&config, 800, |_, _| ());
        outcome.print(&format!("{speed} mm/s, seed {seed}"));
        assert!(outcome.expected > 3000);
        assert_eq!((outcome.followed, outcome.ghosts, outcome.switches), (outcome.expected, 0, 0));
        assert!(rms(&outcome.patch_mm) < 1.0 && rms(&outcome.velocity_mm_s) < 100.0);
        // The error is the distance of the patch from the centre, and the covariance says that: 2.
        let [x, y] = patch_mm(&config);
        assert!((rms(&outcome.center_mm) - x.hypot(y)).abs() < 0.5);
        assert!((1.8..2.2).contains(&mean(&outcome.normalised[0])));
        assert!(mean(&outcome.normalised[1]) < 2.0);
    }
}

/// Each opponent in turn is covered by a hand for a fifth of a second, throughout the match.
#[test]
fn opponents_that_were_hidden_are_found_again() {
    const HIDDEN_FRAMES: u64 = 16;
    for (speed, seed) in [(1500.0, 5), (2400.0, 6)] {
        let mut config = Config::default();
        config.synthetic.max_speed_mm_s = speed;
        config.synthetic.seed = seed;
        let camera = camera(&config);
        let (width, height_mm) = (config.camera.width as usize, config.robots.height_mm);
        let mut hidden = 0;
        let mut outcome = play(&config, 1200, |offline, pixels| {
            let (turn, frame) = (offline.seq / 40, offline.seq % 40);
            if frame < HIDDEN_FRAMES && offline.seq >= 40 {
                let robot = &offline.truth.robots()[5 + turn as usize % 5];
                let middle = pose(robot).position;
                cover(pixels, width, camera.image_from_field(middle, height_mm), 14.0);
                hidden += 1;
            }
        });
        outcome.print(&format!("hidden for a fifth of a second, {speed} mm/s, seed {seed}"));
        let occlusions = hidden / HIDDEN_FRAMES;
        assert!(occlusions > 25);
        // Visible opponents are followed meanwhile, and most of the hidden ones are recognised by their
        // motion.
        assert!(outcome.followed as f64 > 0.9 * (outcome.expected - hidden) as f64);
        assert!(outcome.switches * 20 <= occlusions, "{} of {occlusions}", outcome.switches);
    }
}

/// One known robot at a time has its identification patch hidden for a tenth of a second, throughout
/// the match.
#[test]
fn a_hidden_identification_patch_makes_no_ghost() {
    let mut config = Config::default();
    config.robots.report_unknown = true;
    let camera = camera(&config);
    let (width, height_mm) = (config.camera.width as usize, config.robots.height_mm);
    let layout = Layout::new(&config.robots);
    let mut offline = Offline::new(&config);
    let (mut unrecognised, mut located) = (0u64, 0u64);
    let mut off_mm = vec![];
    for frame in 0..1200u64 {
        let truth = *offline.game.truth();
        let robot = truth.robots()[frame as usize / 20 % 10];
        let is_hidden = frame >= 40 && frame % 20 < 8;
        offline.look(|pixels| {
            if is_hidden {
                let patch = pose(&robot).field_from_robot(layout.patches[1].centroid_mm);
                cover(pixels, width, camera.image_from_field(patch, height_mm), 8.0);
            }
        });
        offline.think();
        let world = offline.world();
        assert!(world.unknown_robots().is_empty(), "frame {frame}: {:?}", world.unknown_robots());
        assert_eq!(world.robots().len(), 10, "frame {frame}");
        let name = (robot.team, robot.robot_id);
        let is_it = |(team, id): (u32, u32)| (team, id) == name;
        let seen = offline
            .seen()
            .robots()
            .iter()
            .any(|it| it.robot_id.number().is_some_and(|id| is_it((it.team, id))));
        let known = world.robots().iter().find(|it| is_it((it.team, it.robot_id))).unwrap();
        if is_hidden && !seen {
            unrecognised += 1;
            located += u64::from(known.status == TrackStatus::Located as u32);
            off_mm.push((known.x_mm - robot.x_mm).hypot(known.y_mm - robot.y_mm));
        }
        offline.advance();
    }
    println!(
        "not recognised in {unrecognised} frames, located in {located}; rms {:.2} mm",
        rms(&off_mm)
    );
    assert!(unrecognised > 300);
    assert!(located as f64 > 0.9 * unrecognised as f64);
    assert!(rms(&off_mm) < 2.0, "{}", rms(&off_mm));
}
