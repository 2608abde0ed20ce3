//! Refinement: robots and balls measured in the raw picture, with a covariance.
//!
//! Robots are fitted by their edges ([`edge_fit`](crate::edges::edge_fit)), balls by their rim
//! ([`ball_fit`](crate::ball::ball_fit)). Where a fit fails, pose or place stay those of the regions, with a
//! covariance that follows from how they were found.

use crate::ball::Visible;
use crate::ball::ball_fit::{BallFitter, Start};
use crate::ball::silhouette::{BY_TINGE, Silhouette};
use crate::ball::sphere::Sphere;
use crate::ball::tinge::Tinge;
use crate::edges::EdgeMap;
use crate::edges::edge_fit::{Deviations, EdgeFitter, Fitted};
use crate::edges::local_map::mm_per_px;
use crate::pattern::{Pattern, Top};
use crate::pose::image_pose;
use crate::raw::RawFrame;
use config::{Config, Pair, PatchConfig};
use geometry::layout::topmost_patch;
use geometry::{CameraModel, FieldPoint, ImagePoint, Pose, wrap_angle};
use messages::{DetectedBall, DetectedRobot, DetectionFrame, Region, Team};

/// Sigma of a patch's centroid, px, times the root of the number of its pixels.
const CENTROID_NOISE_PX: f64 = 0.7;
/// Sigma of a pose by agreement, px; that of its heading is as much at the patches.
const AGREEMENT_NOISE_PX: f64 = 0.5;
/// Factor on the sigma of a region that is larger than a patch: its border with the rest was estimated.
const MERGED_FACTOR: f64 = 3.0;
/// Area in patches from which a region counts as larger than a patch.
const MERGED_AREA_RATIO: f64 = 1.5;
/// Inflates the start pose's sigma: it was measured from the same pixels.
const START_FACTOR: f64 = 2.0;
/// Largest distance of a fitted ball from its start, and least sigma of the start.
const BALL_REACH_PX: f64 = 1.4;
const BALL_START_PX: f64 = 0.6;
/// Sigma of a ball's place by its colour, below which about three quarters of its rim are visible.
const BALL_WELL_SEEN_PX: f64 = 0.46;
/// Radius around a partial ball within which the rest of it is searched by its tinge, in ball radii.
const TINGE_RADII: f64 = 1.8;
/// Largest increase of the outline's share outside the ball during a fit; beyond it the rim is another's.
const MORE_OUTSIDE: f64 = 0.08;
/// Sigma of a ball whose rim cannot be measured, in radii: light from a side moves the centroid of its
/// colour.
const BALL_UNMEASURED: f64 = 0.05;

/// Refines robots and balls.
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

/// The edges of a top, and the weights of its patches' centroids.
#[derive(Debug, Clone)]
struct TopEdges {
    fitter: EdgeFitter,
    height_mm: f64,
    patches: Vec<Patch>,
}

/// A patch in the fit of a pose to centroids.
#[derive(Debug, Clone, Copy)]
struct Patch {
    area_mm2: f64,
    /// Distance from the centroid of all patches.
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

    /// Fits the robots of `seen` to their edges in `frame`, and gives all of them a covariance. `expected`
    /// returns a robot's top and the pose at which the fit begins.
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

    /// Fits the balls of `seen` to their rims in `frame`, and gives all of them a covariance. `visible` has
    /// the part of each that its colour covers.
    pub fn refine_balls(
        &mut self,
        camera: &CameraModel,
        frame: Option<&RawFrame>,
        visible: impl Iterator<Item = Visible>,
        seen: &mut DetectionFrame,
    ) {
        for (index, part) in (0..seen.balls().len()).zip(visible) {
            let ball = seen.balls()[index];
            let position = FieldPoint::new(f64::from(ball.x_mm), f64::from(ball.y_mm));
            let deviation_mm = f64::from(ball.covariance[0]).sqrt();
            let mm_per_px = mm_per_px(camera, position, self.ball_height_mm);
            let region = seen.regions().get(ball.region as usize);
            self.silhouette.trace(region.map_or(&[], |region| seen.runs_of(region)));
            let outline_px = self.sphere.radius_mm / mm_per_px;
            let mut begin = position;
            if let (Visible::Part, Some(frame)) = (part, frame) {
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
                    part == Visible::All || outside(fitted.position) < outside(place) + MORE_OUTSIDE
                })
            };
            let mut fitted = fit_from(&mut self.ball, begin);
            // Something else may have the ball's tinge. Where most of the rim has the ball's colour, fits
            // from that.
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

    /// Sigma of a pose by centroids, or by agreement.
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
            // A pose by agreement.
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
