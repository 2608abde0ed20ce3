//! Paints robots and balls as the camera model sees them, as pictures of labels: what a perfect
//! classifier would make of a perfect sensor's picture.

#![allow(dead_code)] // Each test program uses a part of it.

use bytemuck::Zeroable;
use config::{Config, Pair, PatchConfig, PatchRole, Top};
use geometry::layout::topmost_patch;
use geometry::{CameraModel, FieldPoint, ImagePoint, Pose, wrap_angle};
use messages::{DetectedRobot, DetectionFrame, RejectReason, Run, RunsHeader, Team, WorldFrame};
use touchline_tracker::Tracker;

/// A robot to paint, or to look for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Robot {
    pub team: Team,
    pub id: u32,
    pub pose: Pose,
}

pub fn robot(team: Team, id: u32, x_mm: f64, y_mm: f64, heading_deg: f64) -> Robot {
    let position = FieldPoint::new(x_mm, y_mm);
    Robot { team, id, pose: Pose { position, orientation: heading_deg.to_radians() } }
}

/// A picture of labels in the making.
pub struct Picture {
    pub config: Config,
    pub camera: CameraModel,
    width: usize,
    height: usize,
    /// Class of each pixel.
    pub labels: Vec<Option<u8>>,
}

impl Picture {
    pub fn new(config: &Config) -> Self {
        let (width, height) = (config.camera.width, config.camera.height);
        Self {
            config: config.clone(),
            camera: CameraModel::new(&config.geometry, width, height).unwrap(),
            width: width as usize,
            height: height as usize,
            labels: vec![None; (width * height) as usize],
        }
    }

    pub fn of_robots(config: &Config, robots: &[Robot]) -> Self {
        let mut picture = Self::new(config);
        robots.iter().for_each(|robot| picture.paint_robot(robot));
        picture
    }

    pub fn class(&self, color: &str) -> u8 {
        let class = self.config.colors.iter().position(|known| known.name == color);
        class.unwrap_or_else(|| panic!("no color {color}")) as u8
    }

    /// Paints around a place on the field, `reach_mm` to each side, on a plane at `height_mm`. A
    /// pixel gets the class that `class_at` gives most of its samples, if that is at least half.
    pub fn paint(
        &mut self,
        place: FieldPoint,
        reach_mm: f64,
        height_mm: f64,
        class_at: impl Fn(FieldPoint) -> Option<Option<u8>>,
    ) {
        const SAMPLES: i32 = 6;
        let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)].map(|(x, y)| {
            let corner = FieldPoint::new(place.x_mm + x * reach_mm, place.y_mm + y * reach_mm);
            self.camera.image_from_field(corner, height_mm)
        });
        let range = |values: [f64; 4], limit: usize| {
            let least = values.iter().copied().fold(f64::INFINITY, f64::min) - 2.0;
            let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max) + 3.0;
            (least.max(0.0) as usize).min(limit)..(most.max(0.0) as usize).min(limit)
        };
        for row in range(corners.map(|corner| corner.y_px), self.height) {
            for column in range(corners.map(|corner| corner.x_px), self.width) {
                let mut votes: Vec<(Option<Option<u8>>, i32)> = Vec::new();
                for sample in 0..SAMPLES * SAMPLES {
                    let offset = |index: i32| (f64::from(index) + 0.5) / f64::from(SAMPLES) - 0.5;
                    let point = ImagePoint::new(
                        column as f64 + offset(sample % SAMPLES),
                        row as f64 + offset(sample / SAMPLES),
                    );
                    let class = class_at(self.camera.field_from_image(point, height_mm));
                    match votes.iter_mut().find(|vote| vote.0 == class) {
                        Some(vote) => vote.1 += 1,
                        None => votes.push((class, 1)),
                    }
                }
                let label = &mut self.labels[row * self.width + column];
                match votes.iter().max_by_key(|vote| vote.1) {
                    Some((Some(class), count)) if 2 * count >= SAMPLES * SAMPLES => *label = *class,
                    _ => {}
                }
            }
        }
    }

    /// Paints a robot's whole top, background where it has no patch.
    pub fn paint_robot(&mut self, robot: &Robot) {
        let classes = self.classes_of(robot);
        let config = self.config.clone();
        let top = config.top(robot.team as u32, Some(robot.id));
        self.paint_patches(&robot.pose, top, &classes);
    }

    /// Paints a robot's top with the classes given for its patches; one more is for what of the
    /// body they leave free, which is background otherwise.
    pub fn paint_top(&mut self, pose: &Pose, classes: &[Option<u8>]) {
        let config = self.config.clone();
        self.paint_patches(pose, config.top_of_team(Team::Yellow), classes);
    }

    fn paint_patches(&mut self, pose: &Pose, top: Top, classes: &[Option<u8>]) {
        let free = classes.get(top.patches.len()).copied().flatten();
        let body = self.config.robots.body(top.patches);
        let reach = body.reach_mm().max(self.config.robots.size_mm * 0.75);
        self.paint(pose.position, reach, top.height_mm, |point| {
            let (dx, dy) = (point.x_mm - pose.position.x_mm, point.y_mm - pose.position.y_mm);
            let (sin, cos) = pose.orientation.sin_cos();
            let point = [cos * dx + sin * dy, cos * dy - sin * dx];
            if !body.contains(point) {
                return None;
            }
            let patch = topmost_patch(top.patches, point);
            Some(patch.map_or(free, |patch| classes[patch]))
        });
    }

    /// The class of each patch of a robot.
    pub fn classes_of(&self, robot: &Robot) -> Vec<Option<u8>> {
        let robots = &self.config.robots;
        let identity = robots
            .identities
            .iter()
            .find(|identity| (identity.team, identity.id) == (robot.team, robot.id))
            .unwrap();
        let mut colors = identity.colors.iter();
        self.config
            .top_of(identity)
            .patches
            .iter()
            .map(|patch| {
                Some(self.class(match patch.role {
                    PatchRole::Team => self.config.teams.color(robot.team),
                    PatchRole::Identification => colors.next().unwrap(),
                }))
            })
            .collect()
    }

    /// Paints a square on the plane of the robots' tops; `None` wipes out.
    pub fn square(&mut self, center: Pair, side: f64, class: Option<u8>) {
        let height = self.config.robots.height_mm;
        let center = FieldPoint::new(center[0], center[1]);
        self.paint(center, side / 2.0, height, |point| {
            let inside = (point.x_mm - center.x_mm).abs() <= side / 2.0
                && (point.y_mm - center.y_mm).abs() <= side / 2.0;
            inside.then_some(class)
        });
    }

    pub fn ball(&mut self, place: FieldPoint) {
        let radius = self.config.ball.diameter_mm / 2.0;
        let class = self.class(&self.config.ball.color);
        self.paint(place, radius, radius, |point| {
            (point.distance(place) <= radius).then_some(Some(class))
        });
    }

    pub fn runs(&self) -> Vec<Run> {
        let mut runs = Vec::new();
        for (row, line) in (0u16..).zip(self.labels.chunks(self.width)) {
            let mut begin = 0u16;
            for stretch in line.chunk_by(|a, b| a == b) {
                let end = begin + stretch.len() as u16;
                if let Some(class) = stretch[0] {
                    runs.push(Run { row, begin, end, class, reserved: 0 });
                }
                begin = end;
            }
        }
        runs
    }

    pub fn detections(&self) -> Box<DetectionFrame> {
        self.detections_after(None)
    }

    pub fn detections_after(&self, prior: Option<&WorldFrame>) -> Box<DetectionFrame> {
        detections(&self.config, &self.runs(), prior)
    }
}

/// The detections of a new tracker.
pub fn detections(
    config: &Config,
    runs: &[Run],
    prior: Option<&WorldFrame>,
) -> Box<DetectionFrame> {
    let mut out = Box::new(DetectionFrame::zeroed());
    let mut header = RunsHeader::zeroed();
    header.frame.seq = 100;
    header.frame.t_capture_ns = 1_000_000_000;
    header.run_count = runs.len() as u32;
    Tracker::new(config).unwrap().step(&header, runs, None, prior, &mut out);
    out
}

/// The number of a robot of which it is not known, among [`names`].
pub const UNKNOWN: u32 = u32::MAX;

/// Names of the robots found.
pub fn names(frame: &DetectionFrame) -> Vec<(Team, u32)> {
    frame
        .robots()
        .iter()
        .map(|robot| {
            let number = robot.robot_id.number().unwrap_or(UNKNOWN);
            (Team::from_number(robot.team).unwrap(), number)
        })
        .collect()
}

/// Reasons of the rejections of a team.
pub fn reasons(frame: &DetectionFrame, team: Team) -> Vec<RejectReason> {
    frame
        .rejected()
        .iter()
        .filter(|rejected| rejected.team == team as u32)
        .map(|rejected| RejectReason::from_number(rejected.reason).unwrap())
        .collect()
}

/// How far a robot was found from where it is: millimetres and degrees.
pub fn error_of(found: &DetectedRobot, truth: &Robot) -> (f64, f64) {
    let place = FieldPoint::new(f64::from(found.x_mm), f64::from(found.y_mm));
    let turned = wrap_angle(f64::from(found.orientation) - truth.pose.orientation);
    (place.distance(truth.pose.position), turned.to_degrees().abs())
}

/// Asserts that exactly these robots are found, each as exactly as stated; returns the largest
/// errors in millimetres and degrees.
pub fn assert_found(
    frame: &DetectionFrame,
    robots: &[Robot],
    most_mm: f64,
    most_deg: f64,
) -> (f64, f64) {
    let mut expected = robots.to_vec();
    expected.sort_by_key(|robot| (robot.team, robot.id));
    let expected_names: Vec<(Team, u32)> = expected.iter().map(|r| (r.team, r.id)).collect();
    assert_eq!(
        names(frame),
        expected_names,
        "\nof {robots:#?}\nrejected {:?}",
        Team::ALL.map(|team| reasons(frame, team))
    );
    let mut worst = (0.0f64, 0.0f64);
    for (found, truth) in frame.robots().iter().zip(&expected) {
        let (mm, deg) = error_of(found, truth);
        assert!(mm <= most_mm && deg <= most_deg, "{mm:.2} mm, {deg:.2}° off: {truth:?} {found:?}");
        worst = (worst.0.max(mm), worst.1.max(deg));
    }
    worst
}

fn polygon(role: PatchRole, outline_mm: &[Pair]) -> PatchConfig {
    PatchConfig { role, outline_mm: outline_mm.to_vec() }
}

/// The whole top in the team's colour, an identification square in the front left corner.
pub fn full_square_with_corner() -> Config {
    let mut config = config::Preset::Vsss3v3.config();
    let square = |a: f64, b: f64| [[b, b], [a, b], [a, a], [b, a]];
    config.robots.patches = vec![
        polygon(PatchRole::Team, &square(-36.0, 36.0)),
        polygon(PatchRole::Identification, &square(-2.0, 36.0)),
    ];
    config
}

/// The same turned by 45°: the corner with the identification square goes ahead.
pub fn full_square_with_corner_ahead() -> Config {
    let mut config = full_square_with_corner();
    let half = 0.5f64.sqrt();
    for patch in &mut config.robots.patches {
        for [x, y] in &mut patch.outline_mm {
            (*x, *y) = (half * (*x + *y), half * (*y - *x));
        }
    }
    config
}

/// A square cut along its diagonal: the front half the team's colour, the other half two smaller
/// triangles of identification colours.
pub fn half_and_two_triangles() -> Config {
    let mut config = Config::default();
    let reach = 65.0 / 2f64.sqrt();
    let (front, left, behind, right) = ([reach, 0.0], [0.0, reach], [-reach, 0.0], [0.0, -reach]);
    let center = [0.0, 0.0];
    config.robots.size_mm = 75.0;
    config.robots.patches = vec![
        polygon(PatchRole::Team, &[front, left, right]),
        polygon(PatchRole::Identification, &[left, behind, center]),
        polygon(PatchRole::Identification, &[behind, right, center]),
    ];
    let pairs = [
        ["green", "violet"],
        ["red", "violet"],
        ["violet", "green"],
        ["red", "green"],
        ["green", "red"],
    ];
    for identity in &mut config.robots.identities {
        identity.colors = pairs[identity.id as usize].map(String::from).to_vec();
    }
    config
}
