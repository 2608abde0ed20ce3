//! What has been found, measured once more in the raw picture; and how sure each measurement is.

use crate::ball::Shows;
use crate::ball_fit::{BallFitter, Start};
use crate::edge_fit::{Deviations, EdgeFitter, Fitted};
use crate::edges::EdgeMap;
use crate::local_map::mm_per_px;
use crate::pattern::{Pattern, Top};
use crate::pose::image_pose;
use crate::raw::RawFrame;
use crate::silhouette::{BY_TINGE, Silhouette};
use crate::sphere::Sphere;
use crate::tinge::Tinge;
use common::config::{Config, Pair, PatchConfig};
use common::geometry::{CameraModel, FieldPoint, ImagePoint, Pose, wrap_angle};
use common::layout::topmost_patch;
use common::messages::{DetectedBall, DetectedRobot, DetectionFrame, Region, Team};

/// A centroid of so many pixels of a class is off by this over the root of their number, 1σ in
/// pixels.
const CENTROID_NOISE_PX: f64 = 0.7;
/// A pose by agreement is off by this, 1σ in pixels, and its patches turned by as much.
const AGREEMENT_NOISE_PX: f64 = 0.5;
/// The edges of a region that is more than a patch were guessed.
const MERGED_FACTOR: f64 = 3.0;
/// A region of more than so many patches' area is more than a patch.
const MERGED_AREA_RATIO: f64 = 1.5;
/// By how much more uncertain than it is the pose that the fit begins with is said to be: it has
/// been made of the same pixels.
const START_FACTOR: f64 = 2.0;
/// A ball may lie so far from where its regions put it, and a fit begins as uncertain as that at least.
const BALL_REACH_PX: f64 = 1.4;
const BALL_START_PX: f64 = 0.6;
/// A ball whose place its colour tells as surely as this, 1σ, shows three quarters of its rim.
const BALL_WELL_SEEN_PX: f64 = 0.46;
/// The rest of a ball is looked for within so many radii of where it seems to be.
const TINGE_RADII: f64 = 1.8;
/// A rim that leaves so much more of the ball's outline outside than the one it began with is another's.
const MORE_OUTSIDE: f64 = 0.08;
/// A ball whose rim cannot be measured is as far off as light from a side may put it, in radii, 1σ.
const BALL_UNMEASURED: f64 = 0.05;

/// Measures robots and balls again.
#[derive(Debug, Clone)]
pub(crate) struct Refiner {
    /// One for each top of the pattern.
    tops: Vec<TopEdges>,
    ball: BallFitter,
    sphere: Sphere,
    silhouette: Silhouette,
    tinge: Tinge,
    ball_height_mm: f64,
}

/// The edges of a top, and what its patches' centroids say.
#[derive(Debug, Clone)]
struct TopEdges {
    fitter: EdgeFitter,
    height_mm: f64,
    patches: Vec<Patch>,
}

/// What a patch's centroid says of the pose.
#[derive(Debug, Clone, Copy)]
struct Patch {
    area_mm2: f64,
    /// From the centroid of all patches.
    lever_mm: f64,
}

impl Refiner {
    pub fn new(config: &Config, pattern: &Pattern, camera: &CameraModel) -> Self {
        let scale = |height_mm: f64| {
            let middle = camera.image_from_field(FieldPoint::default(), height_mm);
            camera.pixel_area_mm2(middle, height_mm).sqrt().clamp(1e-3, 1e3)
        };
        let mut tops: Vec<Option<TopEdges>> = vec![None; pattern.tops.len()];
        let listed = config.robots.identities.iter().zip(&pattern.identities);
        let listed = listed.map(|(configured, found)| (found.top, config.top_of(configured)));
        let usual = Team::ALL.map(|team| (pattern.usual_top_index(team), config.top_of_team(team)));
        for (index, top) in listed.chain(usual) {
            let edges = || TopEdges::new(&pattern.tops[index], top.patches, scale(top.height_mm));
            tops[index].get_or_insert_with(edges);
        }
        let radius_mm = config.ball.diameter_mm / 2.0;
        let sphere = Sphere::new(radius_mm, config.geometry.camera_mm);
        Self {
            tops: tops.into_iter().flatten().collect(),
            ball: BallFitter::new(sphere),
            sphere,
            silhouette: Silhouette::default(),
            tinge: Tinge::default(),
            ball_height_mm: radius_mm,
        }
    }

    /// Measures the robots of `seen` by their edges in `frame`, where they can be, looking first where
    /// they are `expected`, which also names their top; gives all of them their covariance.
    pub fn refine_robots(
        &mut self,
        camera: &CameraModel,
        frame: Option<&RawFrame>,
        expected: impl Fn(&DetectedRobot) -> (usize, Option<Pose>),
        seen: &mut DetectionFrame,
    ) {
        let (robots, regions) = seen.robots_and_regions_mut();
        for robot in robots {
            let start = Pose {
                position: FieldPoint::new(f64::from(robot.x_mm), f64::from(robot.y_mm)),
                orientation: f64::from(robot.orientation),
            };
            let (top, expected) = expected(robot);
            let Some(edges) = self.tops.get_mut(top) else { continue };
            let deviations = edges.deviations(camera, robot, regions);
            let begin = Deviations {
                position_mm: START_FACTOR * deviations.position_mm,
                heading_rad: START_FACTOR * deviations.heading_rad,
            };
            let fitter = &mut edges.fitter;
            let fitted = frame
                .and_then(|frame| fitter.fit(camera, frame, &start, &begin, expected.as_ref()));
            let fitted = fitted.unwrap_or_else(|| deviations.around(start));
            let (image, heading) = image_pose(camera, &fitted.pose, edges.height_mm);
            *robot = DetectedRobot {
                x_mm: fitted.pose.position.x_mm as f32,
                y_mm: fitted.pose.position.y_mm as f32,
                orientation: wrap_angle(fitted.pose.orientation) as f32,
                covariance: fitted.covariance.map(|term| term as f32),
                edge_samples: fitted.samples,
                x_px: image.x_px as f32,
                y_px: image.y_px as f32,
                orientation_image: heading as f32,
                ..*robot
            };
        }
    }

    /// Measures the balls of `seen` by their rims, likewise; of some only a part shows in
    /// their colour.
    pub fn refine_balls(
        &mut self,
        camera: &CameraModel,
        frame: Option<&RawFrame>,
        shows: impl Iterator<Item = Shows>,
        seen: &mut DetectionFrame,
    ) {
        for (index, part) in (0..seen.balls().len()).zip(shows) {
            let ball = seen.balls()[index];
            let position = FieldPoint::new(f64::from(ball.x_mm), f64::from(ball.y_mm));
            let deviation_mm = f64::from(ball.covariance[0]).sqrt();
            let mm_per_px = mm_per_px(camera, position, self.ball_height_mm);
            let region = seen.regions().get(ball.region as usize);
            self.silhouette.trace(region.map_or(&[], |region| seen.runs_of(region)));
            let outline_px = self.sphere.radius_mm / mm_per_px;
            let mut begin = position;
            if let (Shows::Part, Some(frame)) = (part, frame) {
                let middle = ImagePoint::new(f64::from(ball.x_px), f64::from(ball.y_px));
                let reach_px = TINGE_RADII * outline_px;
                let silhouette = &mut self.silhouette;
                if self.tinge.complete(frame, middle, reach_px, silhouette)
                    && let Some((position, _)) =
                        silhouette.ball(&self.sphere, camera, position, &BY_TINGE)
                {
                    begin = position;
                }
            }
            let silhouette = &self.silhouette;
            let shows = |row, column| silhouette.covers(row, column);
            let fit_from = |ball: &mut BallFitter, place: FieldPoint| {
                let start = Start {
                    position: place,
                    deviation_mm: (START_FACTOR * deviation_mm).max(BALL_START_PX * mm_per_px),
                    reach_mm: BALL_REACH_PX * mm_per_px,
                };
                let outside = |place| silhouette.outside(&self.sphere, camera, place);
                ball.fit(camera, frame?, &start, Some(shows)).filter(|fitted| {
                    part == Shows::All || outside(fitted.position) < outside(place) + MORE_OUTSIDE
                })
            };
            let mut fitted = fit_from(&mut self.ball, begin);
            // Something else of the ball's tinge may have led astray; most of the rim shows its colour.
            if fitted.is_none() && deviation_mm < BALL_WELL_SEEN_PX * mm_per_px {
                begin = position;
                fitted = fit_from(&mut self.ball, begin);
            }
            let measured = match fitted {
                Some(fitted) => {
                    let image = camera.image_from_field(fitted.position, self.ball_height_mm);
                    DetectedBall {
                        x_mm: fitted.position.x_mm as f32,
                        y_mm: fitted.position.y_mm as f32,
                        x_px: image.x_px as f32,
                        y_px: image.y_px as f32,
                        covariance: fitted.covariance.map(|term| term as f32),
                        edge_samples: fitted.samples,
                        ..ball
                    }
                }
                None => {
                    let deviation_mm = deviation_mm.hypot(BALL_UNMEASURED * self.ball_height_mm);
                    let variance = (deviation_mm * deviation_mm) as f32;
                    let image = camera.image_from_field(begin, self.ball_height_mm);
                    DetectedBall {
                        x_mm: begin.x_mm as f32,
                        y_mm: begin.y_mm as f32,
                        x_px: image.x_px as f32,
                        y_px: image.y_px as f32,
                        covariance: [variance, 0.0, variance],
                        ..ball
                    }
                }
            };
            seen.balls_and_regions_mut().0[index] = measured;
        }
    }
}

impl TopEdges {
    fn new(top: &Top, configured: &[PatchConfig], mm_per_px: f64) -> Self {
        let outlines: Vec<&[Pair]> =
            configured.iter().map(|patch| patch.outline_mm.as_slice()).collect();
        let edges = EdgeMap::new(&outlines, |point| topmost_patch(configured, point), mm_per_px);
        let area: f64 = top.patches.iter().map(|patch| patch.area_mm2).sum();
        let middle = [0, 1].map(|axis| {
            let moment = top.patches.iter().map(|p| p.area_mm2 * p.centroid_mm[axis]);
            moment.sum::<f64>() / area
        });
        let patches = top.patches.iter().map(|patch| Patch {
            area_mm2: patch.area_mm2,
            lever_mm: (patch.centroid_mm[0] - middle[0]).hypot(patch.centroid_mm[1] - middle[1]),
        });
        Self {
            fitter: EdgeFitter::new(edges, top.height_mm),
            height_mm: top.height_mm,
            patches: patches.collect(),
        }
    }

    /// How uncertain a pose is that was fitted to the centroids of its patches.
    fn deviations(
        &self,
        camera: &CameraModel,
        robot: &DetectedRobot,
        regions: &[Region],
    ) -> Deviations {
        let position = FieldPoint::new(f64::from(robot.x_mm), f64::from(robot.y_mm));
        let mm_per_px = mm_per_px(camera, position, self.height_mm);
        let is_missing = |region: &u32| *region as usize >= regions.len();
        if robot.patch_regions[..self.patches.len()].iter().any(is_missing) {
            // Not of centroids, but laid over broken patches where most pixels agree.
            let position_mm = AGREEMENT_NOISE_PX * mm_per_px;
            let reach = self.patches.iter().map(|patch| patch.lever_mm).fold(1.0, f64::max);
            return Deviations { position_mm, heading_rad: (position_mm / reach).min(1.0) };
        }
        let (mut weight, mut turning) = (0.0, 0.0);
        for (patch, region) in self.patches.iter().zip(robot.patch_regions) {
            let whole_px = patch.area_mm2 / (mm_per_px * mm_per_px);
            let seen_px = regions
                .get(region as usize)
                .map_or(1.0, |region| f64::from(region.pixel_count.max(1)));
            let mut deviation = CENTROID_NOISE_PX / seen_px.min(whole_px.max(1.0)).sqrt();
            if seen_px > MERGED_AREA_RATIO * whole_px {
                deviation *= MERGED_FACTOR;
            }
            let information = (deviation * mm_per_px).powi(-2);
            weight += information;
            turning += information * patch.lever_mm * patch.lever_mm;
        }
        Deviations { position_mm: weight.powf(-0.5), heading_rad: turning.powf(-0.5).min(1.0) }
    }
}

impl Deviations {
    fn around(&self, pose: Pose) -> Fitted {
        let [place, heading] = [self.position_mm.powi(2), self.heading_rad.powi(2)];
        Fitted { pose, covariance: [place, 0.0, 0.0, place, 0.0, heading], samples: 0 }
    }
}
