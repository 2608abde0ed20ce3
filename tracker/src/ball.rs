//! Ball candidates: regions of the ball's colour, judged by area and roundness.
//!
//! There is one ball, but rarely one region of its colour: highlights cut it in pieces, red and yellow
//! patches have orange rims, and people at the pitch wear anything. So every region of about the right area
//! and shape is reported, with a confidence, best first; the filter knows where the ball was before and
//! chooses.
//!
//! * A region merged with the smaller ones near it is a whole ball if its area and roundness are those of a
//!   disc; its place is the centroid.
//! * A region of 12 to 85 % of the ball's area may be its visible part; its place is that of the circle in
//!   its outline ([`silhouette`](silhouette)), if enough of the rim is visible.

pub(crate) mod ball_fit;
pub(crate) mod silhouette;
pub(crate) mod sphere;
pub(crate) mod tinge;

use crate::edges::local_map::mm_per_px;
use crate::error::TrackerError;
use crate::pattern::{Limits, Pattern, class_of, positive};
use crate::pitch::Pitch;
use crate::pose::robot_from_field;
use crate::reasons::Rejections;
use crate::regions::measure::{Measure, Moments};
use config::Config;
use geometry::{CameraModel, FieldPoint, Pose};
use messages::{DetectedBall, DetectedRobot, DetectionFrame, RejectReason, Rejected};
use silhouette::{BY_CLASS, Silhouette};
use sphere::Sphere;
use std::f64::consts::PI;

/// Least [`roundness`] of a ball. Half a disc has 0.66, a strip of eleven pixels by two 0.18, a ring a tenth
/// of its diameter wide 0.36.
const MIN_ROUNDNESS: f64 = 0.45;
/// Largest distance of a fragment from the largest one, in diameters.
const MERGE_DIAMETERS: f64 = 0.75;
/// Least area of a region that is merged or listed, as a fraction of the smallest admitted area.
const WORTH_LISTING: f64 = 0.25;
/// Area, as a fraction of the disc, below which a ball is located by its rim.
const WHOLE: f64 = 0.85;
/// Least visible share of the rim of a partial ball.
const MIN_RIM_SHARE: f64 = 0.25;
/// Least visible share of its disc.
const MIN_DISC_SHARE: f64 = 0.12;
/// Largest share of its outline outside the circle.
const MAX_OUTSIDE: f64 = 0.15;
/// Sigma of the centroid of a whole ball, px, times the root of the number of its pixels.
const CENTROID_NOISE_PX: f64 = 0.7;
/// Sigma of the circle in the outline of a partial ball, px, if the whole rim is visible.
const RIM_NOISE_PX: f64 = 0.4;
/// Factor on the confidence of a ball on a robot's top: it is visible there only if it lies on it.
const ON_ROBOT: f64 = 0.2;

/// Place of a ball by its regions.
#[derive(Debug, Clone, Copy)]
struct Place {
    position: FieldPoint,
    /// 1σ.
    deviation_mm: f64,
    confidence: f64,
    visible: Visible,
}

/// Part of a ball that its colour's region covers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Visible {
    All,
    Part,
}

/// A region of the ball's colour.
#[derive(Debug, Clone, Copy)]
struct BallRegion {
    /// Index of the region in the message.
    region: u32,
    measure: Measure,
    /// Whether it has been merged into a larger one.
    is_merged: bool,
}

/// Finds balls.
#[derive(Debug, Clone)]
pub(crate) struct BallFinder {
    class: u32,
    radius_mm: f64,
    sphere: Sphere,
    silhouette: Silhouette,
    limits: Limits,
    /// Largest first.
    regions: Vec<BallRegion>,
    found: Vec<(DetectedBall, Visible)>,
}

impl BallFinder {
    pub fn new(config: &Config, limits: Limits) -> Result<Self, TrackerError> {
        positive("ball.diameter_mm", config.ball.diameter_mm)?;
        if config.ball.diameter_mm >= 2.0 * config.geometry.camera_mm[2] {
            return Err(TrackerError::Value {
                key: "ball.diameter_mm",
                value: config.ball.diameter_mm,
                must: "below the camera",
            });
        }
        Ok(Self {
            class: class_of(config, &config.ball.color, || "the ball".into())?,
            radius_mm: config.ball.diameter_mm / 2.0,
            sphere: Sphere::new(config.ball.diameter_mm / 2.0, config.geometry.camera_mm),
            silhouette: Silhouette::default(),
            limits,
            regions: Vec::new(),
            found: Vec::new(),
        })
    }

    /// Appends the balls among the regions of `frame`, best first; its robots must be known.
    pub fn find(
        &mut self,
        pattern: &Pattern,
        camera: &CameraModel,
        pitch: &Pitch,
        frame: &mut DetectionFrame,
        rejections: &mut Rejections,
    ) {
        self.measure_regions(camera, frame);
        self.found.clear();
        for index in 0..self.regions.len() {
            let BallRegion { region, measure, is_merged } = self.regions[index];
            if is_merged {
                continue;
            }
            let measure = self.with_fragments(index, measure);
            let place = match self.judge(camera, frame, region, &measure) {
                Ok(place) if pitch.contains(place.position, 0.0) => place,
                fault => {
                    let is_outside = !pitch.contains(measure.position, 0.0) || fault.is_ok();
                    let reason = fault.err().filter(|_| !is_outside);
                    let reason = reason.unwrap_or(RejectReason::OutsideField);
                    rejections.add(Rejected::BALL, reason, measure.image, measure.area_mm2);
                    continue;
                }
            };
            let on_robot =
                frame.robots().iter().any(|robot| is_on_top_of(pattern, camera, robot, &measure));
            let confidence = place.confidence * if on_robot { ON_ROBOT } else { 1.0 };
            let image = camera.image_from_field(place.position, self.radius_mm);
            let variance = (place.deviation_mm * place.deviation_mm) as f32;
            let ball = DetectedBall {
                x_mm: place.position.x_mm as f32,
                y_mm: place.position.y_mm as f32,
                x_px: image.x_px as f32,
                y_px: image.y_px as f32,
                confidence: confidence as f32,
                region,
                covariance: [variance, 0.0, variance],
                edge_samples: 0,
            };
            self.found.push((ball, place.visible));
        }
        self.found.sort_unstable_by(|(a, _), (b, _)| {
            b.confidence.total_cmp(&a.confidence).then(a.region.cmp(&b.region))
        });
        for (ball, _) in &self.found {
            if !frame.push_ball(*ball) {
                break;
            }
        }
    }

    /// The visible part of each ball of the last frame, in the order of the message.
    pub fn visible(&self) -> impl Iterator<Item = Visible> {
        self.found.iter().map(|&(_, visible)| visible)
    }

    fn area_mm2(&self) -> f64 {
        PI * self.radius_mm * self.radius_mm
    }

    fn measure_regions(&mut self, camera: &CameraModel, frame: &DetectionFrame) {
        let worth_listing = WORTH_LISTING * self.limits.min_area_ratio * self.area_mm2();
        self.regions.clear();
        for (index, region) in (0u32..).zip(frame.regions()) {
            if region.class != self.class {
                continue;
            }
            let moments = Moments::of_region(region, frame.runs_of(region));
            // The ball's outline is that of its widest section, at the height of its centre.
            match Measure::new(&moments, camera, self.radius_mm) {
                Some(measure) if measure.area_mm2 >= worth_listing => {
                    self.regions.push(BallRegion { region: index, measure, is_merged: false });
                }
                _ => {}
            }
        }
        self.regions.sort_unstable_by(|a, b| {
            b.measure.area_mm2.total_cmp(&a.measure.area_mm2).then(a.region.cmp(&b.region))
        });
    }

    /// The region merged with each smaller one near it that improves its quality.
    fn with_fragments(&mut self, seed: usize, measure: Measure) -> Measure {
        let mut merged = measure;
        let reach = MERGE_DIAMETERS * 2.0 * self.radius_mm;
        for index in seed + 1..self.regions.len() {
            let BallRegion { measure: fragment, is_merged, .. } = self.regions[index];
            // Without the root: noise takes half a million comparisons.
            let (dx, dy) = (
                fragment.position.x_mm - measure.position.x_mm,
                fragment.position.y_mm - measure.position.y_mm,
            );
            if is_merged || dx * dx + dy * dy > reach * reach {
                continue;
            }
            let together = merged.merged(&fragment);
            if self.quality(&together) > self.quality(&merged) {
                merged = together;
                self.regions[index].is_merged = true;
            }
        }
        merged
    }

    /// Place of the ball that a region covers wholly or in part, or the reason why it is none.
    fn judge(
        &mut self,
        camera: &CameraModel,
        frame: &DetectionFrame,
        region: u32,
        measure: &Measure,
    ) -> Result<Place, RejectReason> {
        let ratio = measure.area_mm2 / self.area_mm2();
        let fault = self.fault(measure);
        let scale = mm_per_px(camera, measure.position, self.radius_mm);
        let by_centroid = Place {
            position: measure.position,
            deviation_mm: CENTROID_NOISE_PX * scale / measure.pixels.max(1.0).sqrt(),
            confidence: self.quality(measure),
            visible: Visible::All,
        };
        if !(MIN_DISC_SHARE..WHOLE).contains(&ratio) {
            return fault.map_or(Ok(by_centroid), Err);
        }
        // The outline of one of several merged regions is not the ball's.
        let is_whole_region = frame
            .regions()
            .get(region as usize)
            .is_some_and(|region| f64::from(region.pixel_count) >= measure.pixels);
        let by_rim = is_whole_region
            .then(|| self.place_by_rim(camera, frame, region, measure, scale))
            .flatten();
        if let Some(reason) = fault {
            return by_rim.ok_or(reason);
        }
        // The whole missing part may be on one side.
        let missing_mm = (1.0 - ratio) * self.radius_mm / 2.0;
        let deviation_mm = by_centroid.deviation_mm.hypot(missing_mm);
        let confidence = by_centroid.confidence;
        let place = by_rim.unwrap_or(Place { deviation_mm, ..by_centroid });
        Ok(Place { confidence, visible: Visible::Part, ..place })
    }

    /// Place of the ball of which a region is the visible part.
    fn place_by_rim(
        &mut self,
        camera: &CameraModel,
        frame: &DetectionFrame,
        region: u32,
        measure: &Measure,
        mm_per_px: f64,
    ) -> Option<Place> {
        let runs = frame.runs_of(frame.regions().get(region as usize)?);
        self.silhouette.trace(runs);
        let (place, rim) =
            self.silhouette.ball(&self.sphere, camera, measure.position, &BY_CLASS)?;
        if rim.share < MIN_RIM_SHARE || rim.outside > MAX_OUTSIDE {
            return None;
        }
        Some(Place {
            position: place,
            deviation_mm: RIM_NOISE_PX * mm_per_px / rim.share.sqrt(),
            confidence: measure.area_mm2 / self.area_mm2() * (1.0 - rim.outside),
            visible: Visible::Part,
        })
    }

    /// The reason why a region cannot be a whole ball; `None` if it can.
    fn fault(&self, measure: &Measure) -> Option<RejectReason> {
        let ratio = measure.area_mm2 / self.area_mm2();
        if ratio < self.limits.min_area_ratio {
            Some(RejectReason::TooSmall)
        } else if ratio > self.limits.max_area_ratio {
            Some(RejectReason::TooLarge)
        } else if roundness(measure) < MIN_ROUNDNESS {
            Some(RejectReason::NotRound)
        } else {
            None
        }
    }

    /// Roundness times exp(−area misfit): 1 for a disc of the right area.
    fn quality(&self, measure: &Measure) -> f64 {
        let ratio = measure.area_mm2 / self.area_mm2();
        roundness(measure) * (-self.limits.area_misfit(ratio)).exp()
    }
}

fn is_on_top_of(
    pattern: &Pattern,
    camera: &CameraModel,
    robot: &DetectedRobot,
    ball: &Measure,
) -> bool {
    let top = pattern.top_by_numbers(robot.team, robot.robot_id.number());
    // The point of the picture on the plane of the robot's top.
    let place = camera.field_from_image(ball.image, top.height_mm);
    let pose = Pose {
        position: FieldPoint::new(f64::from(robot.x_mm), f64::from(robot.y_mm)),
        orientation: f64::from(robot.orientation),
    };
    top.body.contains(robot_from_field(&pose, place))
}

/// Area in relation to spread, times evenness of the spread in all directions: 1 for a disc.
fn roundness(measure: &Measure) -> f64 {
    let [major, minor] = measure.deviations_mm();
    // A disc of area A has a variance of A/4π each way. Small discs of pixels are a little more compact.
    let compactness =
        (measure.area_mm2 / (4.0 * PI * major * minor).max(f64::MIN_POSITIVE)).min(1.0);
    // Blur and oblique views make ellipses of discs; a ratio of axes down to 0.8 costs nothing.
    let evenness = (minor / (0.8 * major).max(f64::MIN_POSITIVE)).min(1.0);
    compactness * evenness
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Pattern;
    use crate::regions::RegionFinder;
    use bytemuck::Zeroable;
    use geometry::ImagePoint;
    use messages::Run;

    struct Picture {
        config: Config,
        camera: CameraModel,
        labels: Vec<bool>,
    }

    impl Picture {
        fn new() -> Self {
            let config = Config::default();
            let camera = CameraModel::new(&config.geometry, 640, 480).unwrap();
            Self { config, camera, labels: vec![false; 640 * 480] }
        }

        /// Paints (or wipes out) what `shape` says, in millimetres around a place on the field.
        fn paint(&mut self, place: FieldPoint, ink: bool, shape: impl Fn(f64, f64) -> bool) {
            let height = self.config.ball.diameter_mm / 2.0;
            for (index, label) in self.labels.iter_mut().enumerate() {
                let point = ImagePoint::new((index % 640) as f64, (index / 640) as f64);
                let here = self.camera.field_from_image(point, height);
                if shape(here.x_mm - place.x_mm, here.y_mm - place.y_mm) {
                    *label = ink;
                }
            }
        }

        fn disc(&mut self, place: FieldPoint) {
            self.paint(place, true, |x, y| x.hypot(y) <= 21.35);
        }

        fn found(&self, robots: &[DetectedRobot]) -> Box<DetectionFrame> {
            let class = self.config.colors.iter().position(|c| c.name == "orange").unwrap() as u8;
            let mut runs = Vec::new();
            for (row, line) in (0u16..).zip(self.labels.chunks(640)) {
                let mut begin = 0u16;
                for stretch in line.chunk_by(|a, b| a == b) {
                    let end = begin + stretch.len() as u16;
                    if stretch[0] {
                        runs.push(Run { row, begin, end, class, reserved: 0 });
                    }
                    begin = end;
                }
            }
            let mut frame = Box::new(DetectionFrame::zeroed());
            RegionFinder::new(640, 480, 8, 8).find(&runs, &mut frame);
            for robot in robots {
                frame.push_robot(*robot);
            }
            let limits = Pattern::new(&self.config).unwrap().limits;
            let mut finder = BallFinder::new(&self.config, limits).unwrap();
            let pattern = Pattern::new(&self.config).unwrap();
            let mut rejections = Rejections::default();
            let pitch = Pitch::new(&self.config);
            finder.find(&pattern, &self.camera, &pitch, &mut frame, &mut rejections);
            rejections.write(&mut frame);
            frame
        }
    }

    fn reasons(frame: &DetectionFrame) -> Vec<Option<RejectReason>> {
        frame.rejected().iter().map(|r| RejectReason::from_number(r.reason)).collect()
    }

    #[test]
    fn a_disc_is_a_ball() {
        for place in [FieldPoint::new(0.0, 0.0), FieldPoint::new(-1000.0, 800.0)] {
            let mut picture = Picture::new();
            picture.disc(place);
            let frame = picture.found(&[]);
            let [ball] = frame.balls() else { panic!("{:?}", frame.balls()) };
            let found = FieldPoint::new(f64::from(ball.x_mm), f64::from(ball.y_mm));
            assert!(found.distance(place) < 1.0, "{ball:?}");
            assert!(ball.confidence > 0.9, "{ball:?}");
            assert!(frame.rejected().is_empty());
        }
    }

    #[test]
    fn a_ball_cut_by_a_highlight_is_one_ball() {
        let mut picture = Picture::new();
        let place = FieldPoint::new(300.0, 200.0);
        picture.disc(place);
        picture.paint(place, false, |x, y| (x - y).abs() < 4.0 && x.abs() < 40.0 && y.abs() < 40.0);
        let frame = picture.found(&[]);
        assert!(frame.regions().len() >= 2, "the highlight does not cut the ball");
        let [ball] = frame.balls() else { panic!("{:?}", frame.balls()) };
        let found = FieldPoint::new(f64::from(ball.x_mm), f64::from(ball.y_mm));
        assert!(found.distance(place) < 1.5, "{ball:?}");
    }

    #[test]
    fn other_shapes_are_rejected_with_a_reason() {
        let place = FieldPoint::new(300.0, 200.0);
        let rejected = |shape: &dyn Fn(f64, f64) -> bool| {
            let mut picture = Picture::new();
            picture.paint(place, true, shape);
            let frame = picture.found(&[]);
            assert!(frame.balls().is_empty(), "{:?}", frame.balls());
            assert!(frame.rejected().iter().all(|rejected| rejected.team == Rejected::BALL));
            reasons(&frame)
        };
        let string = rejected(&|x, y| x.abs() < 60.0 && y.abs() < 4.0);
        assert_eq!(string, [Some(RejectReason::NotRound)]);
        let ring = rejected(&|x, y| (25.0..31.0).contains(&x.hypot(y)));
        assert_eq!(ring, [Some(RejectReason::NotRound)]);
        let carpet = rejected(&|x, y| x.abs() < 60.0 && y.abs() < 60.0);
        assert_eq!(carpet, [Some(RejectReason::TooLarge)]);
        let speck = rejected(&|x, y| x.hypot(y) < 9.0);
        assert_eq!(speck, [Some(RejectReason::TooSmall)]);
        let spectator = rejected(&|x, y| (x + 1550.0).hypot(y - 500.0) < 21.0);
        assert_eq!(spectator, [Some(RejectReason::OutsideField)]);
    }

    #[test]
    fn a_speck_on_a_robot_comes_after_the_ball() {
        let mut picture = Picture::new();
        let camera = picture.camera.clone();
        let robot_place = FieldPoint::new(-400.0, 100.0);
        // A round speck that would be the better ball, if it were not on a robot.
        let speck = camera.field_from_image(camera.image_from_field(robot_place, 75.0), 21.35);
        picture.disc(speck);
        let place = FieldPoint::new(300.0, 200.0);
        picture.paint(place, true, |x, y| x.hypot(y) <= 21.35 && x < 5.0);
        let robot = DetectedRobot {
            x_mm: robot_place.x_mm as f32,
            y_mm: robot_place.y_mm as f32,
            ..DetectedRobot::default()
        };
        let with_robot = picture.found(&[robot]);
        let [first, second] = with_robot.balls() else { panic!("{:?}", with_robot.balls()) };
        // Not at the centroid of what is seen of it, at 293.
        assert!((first.x_mm - 300.0).abs() < 3.0 && second.confidence < 0.3, "{first:?}");
        let without = picture.found(&[]);
        assert!((without.balls()[0].x_mm + 400.0).abs() < 20.0, "{:?}", without.balls());
    }
}
