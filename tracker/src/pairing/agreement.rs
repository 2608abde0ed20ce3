//! Agreement: the pose at which the layout, laid over the classified pixels, explains most of them.
//!
//! A fit of centroids needs whole regions. Small dark patches under a poor camera are not whole: half of one
//! is missing, a neighbour's rim has its colour, and the heading is off by ten degrees. The single pixels
//! still tell the pose: at the right one, pixels of each patch's colour lie in that patch, and few others do.
//!
//! # Measure
//!
//! With sₖ(p) the [share](crate::pattern::shares) of patch k at a pixel's place p in the robot's frame (faded at the
//! patch's rim) and Aₖ its sum over the whole patch, the agreement of patch k is
//!
//! aₖ = (1 + α)·Σ sₖ(p) / Aₖ − α, summed over the pixels whose class the patch accepts, α = [`AGAINST`]:
//!
//! 1 when the whole patch has its colour, −α when none of it has. Pixels of another class or none need not be
//! visited, because Aₖ is the same at every pose.
//!
//! # Search
//!
//! F(x, y, θ) = Σₖ Σ sₖ is smooth, and Newton's method finds its maximum: the step is H⁻¹·∇F. ∇F is summed up
//! together with F from tables of the derivatives of s. H is precomputed for a whole robot at its own pose,
//! and scaled by the visible part. A step that decreases F is halved. Four or five evaluations are enough.
//!
//! # One pass for all robots of a team
//!
//! At a given pose the sums of every robot come from the same numbers: the sums of sₖ over the pixels of each
//! class ([`Coverage`]). One pass over the pixels makes them; the agreement with any set of colours follows
//! without another.

use crate::linear::{inverse, times};
use crate::pattern::Top;
use crate::pattern::shares::{PatchRow, ROW, Shares};
use crate::regions::bounds::Bounds;
use crate::regions::class_index::{CLASSES, ClassIndex};
use fearless_simd::{Level, dispatch};
use geometry::{CameraModel, FieldPoint, ImagePoint, Pose};
use messages::{DetectionFrame, MAX_PATCHES};
use std::ops::Range;

/// α: weight of a pixel against a patch whose colour it does not have.
const AGAINST: f32 = 0.5;
/// Most pixels of a robot; in larger pictures every second, third … column and row is used.
const MAX_PIXELS: f64 = 1600.0;
/// Largest distance of a robot from where it is searched.
const START_ERROR_MM: f64 = 12.0;
/// Longest step of the search.
const LONGEST_STEP_MM: f64 = 6.0;
const LONGEST_STEP_DEG: f64 = 12.0;
/// Convergence: a step below this ends the search.
const SETTLED_MM: f64 = 0.2;
/// Fixed work of an evaluation, in pixels.
const EVALUATION_WORK: u64 = 64;
/// Most evaluations of a search.
const MAX_EVALUATIONS: u32 = 12;

/// F and its gradient at a pose.
#[derive(Debug, Clone, Copy, Default)]
struct Score {
    /// F, in pixels.
    sum: f32,
    /// Derivatives by a step of the robot in its own frame: mm, mm, rad.
    slope: [f32; 3],
}

/// Sums of the patches' shares over the pixels of each class at a pose, in pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Coverage {
    by_class: [PatchRow; CLASSES],
    pixel_mm2: f32,
}

/// The classified pixels around a robot.
#[derive(Debug, Clone)]
pub(crate) struct NearbyPixels {
    level: Level,
    /// Places of the pixels relative to `origin`, class by class.
    x_mm: Vec<f32>,
    y_mm: Vec<f32>,
    /// Classes that have pixels, and the pixels of each.
    classes: Vec<(usize, Range<usize>)>,
    /// Area that each pixel stands for.
    pixel_mm2: f32,
    origin: FieldPoint,
    /// Regions of a class in the window.
    meeting: Vec<u32>,
    /// At the pose of the last evaluation: the cell of each pixel, and its place in the robot's frame.
    cells: Vec<u32>,
    ahead_mm: Vec<f32>,
    aside_mm: Vec<f32>,
    /// Work since the last call of [`NearbyPixels::take_work`].
    work: u64,
}

/// For each patch, the classes that it accepts, as a bit set.
pub(crate) type Accepted = [u32; MAX_PATCHES];

impl Coverage {
    /// Sum of a patch's shares over the pixels of the classes that it accepts.
    fn own(&self, accepted: &Accepted, patch: usize) -> f32 {
        bits(accepted[patch]).map(|class| self.by_class[class][patch]).sum()
    }

    /// aₖ of each patch.
    pub fn agreement(&self, shares: &Shares, accepted: &Accepted) -> [f32; MAX_PATCHES] {
        std::array::from_fn(|patch| {
            let area_mm2 = shares.areas_mm2[patch];
            let own_mm2 = self.own(accepted, patch) * self.pixel_mm2;
            if area_mm2 > 0.0 { (1.0 + AGAINST) * own_mm2 / area_mm2 - AGAINST } else { 0.0 }
        })
    }

    /// Sum of aₖ over all patches.
    pub fn total(&self, shares: &Shares, accepted: &Accepted) -> f32 {
        self.agreement(shares, accepted).iter().sum()
    }

    /// For the coverage of the patches' insides: the fraction of each patch that has an accepted colour, and
    /// the fraction that has the most frequent other colour.
    pub fn parts(&self, shares: &Shares, accepted: &Accepted) -> [[f32; 2]; MAX_PATCHES] {
        std::array::from_fn(|patch| {
            let inside_mm2 = shares.insides_mm2[patch];
            let others = bits(!accepted[patch]).map(|class| self.by_class[class][patch]);
            let counts = [self.own(accepted, patch), others.fold(0.0, f32::max)];
            let part = |count: f32| count * self.pixel_mm2 / inside_mm2;
            if inside_mm2 > 0.0 { counts.map(part) } else { [0.0; 2] }
        })
    }
}

/// Indices of the bits that are set.
fn bits(mut set: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lowest = set.trailing_zeros();
        (set != 0).then(|| {
            set &= set - 1;
            lowest as usize
        })
    })
}

impl Default for NearbyPixels {
    fn default() -> Self {
        Self {
            level: Level::new(),
            x_mm: Vec::new(),
            y_mm: Vec::new(),
            classes: Vec::new(),
            pixel_mm2: 0.0,
            origin: FieldPoint::default(),
            meeting: Vec::new(),
            cells: Vec::new(),
            ahead_mm: Vec::new(),
            aside_mm: Vec::new(),
            work: 0,
        }
    }
}

impl NearbyPixels {
    /// Pixel visits since the last call, plus [`EVALUATION_WORK`] for each evaluation.
    pub fn take_work(&mut self) -> u64 {
        std::mem::take(&mut self.work)
    }

    fn clear(&mut self) {
        self.x_mm.clear();
        self.y_mm.clear();
        self.classes.clear();
    }

    /// Collects the pixels around a team patch at `place`, within reach of the robot at any heading: a
    /// missing pixel would count against it.
    pub fn collect(
        &mut self,
        top: &Top,
        camera: &CameraModel,
        frame: &DetectionFrame,
        index: &ClassIndex,
        place: FieldPoint,
    ) {
        self.clear();
        let center = camera.image_from_field(place, top.height_mm);
        let area_mm2 = camera.pixel_area_mm2(center, top.height_mm);
        let robot_mm = top.shares.reach_mm.max(top.body.reach_mm()) + START_ERROR_MM;
        let [x_mm, y_mm] = top.patches[top.team_patch].centroid_mm;
        let reach_mm = robot_mm + x_mm.hypot(y_mm);
        let reach_px = reach_mm / area_mm2.sqrt();
        if !(center.x_px.is_finite() && center.y_px.is_finite() && reach_px < 1e4) {
            return;
        }
        let robot_px = robot_mm / area_mm2.sqrt();
        let step =
            ((std::f64::consts::PI * robot_px * robot_px / MAX_PIXELS).sqrt().ceil()).max(1.0);
        self.pixel_mm2 = (area_mm2 * step * step) as f32;
        let step = step as i64;
        let (column, row) = (center.x_px.round() as i64, center.y_px.round() as i64);
        let steps = (reach_px / step as f64).ceil() as i64;
        // Over a robot the map from pixels to millimetres is linear to a fraction of a pixel.
        let at = |dx: f64, dy: f64| {
            let point = ImagePoint::new(column as f64 + dx, row as f64 + dy);
            camera.field_from_image(point, top.height_mm)
        };
        let (origin, right, down) = (at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0));
        self.origin = origin;
        let (right, down) = (
            [right.x_mm - origin.x_mm, right.y_mm - origin.y_mm],
            [down.x_mm - origin.x_mm, down.y_mm - origin.y_mm],
        );
        let off = [place.x_mm - origin.x_mm, place.y_mm - origin.y_mm];
        let right2 = right[0] * right[0] + right[1] * right[1];
        // The window in the picture.
        let (left, first_row) = (column - steps * step, row - steps * step);
        let (last, bottom) = (column + steps * step, row + steps * step);
        let regions = frame.regions();
        let clip = |side: i64| side.clamp(-1, i64::from(u16::MAX)) as i32;
        let window =
            Bounds { columns: [left, last].map(clip), rows: [first_row, bottom].map(clip) };
        for class in 0..CLASSES {
            let begin = self.x_mm.len();
            index.meeting(class, &window, &mut self.meeting);
            for &number in &self.meeting {
                let region = &regions[index.of_class(class)[number as usize] as usize];
                for run in frame.runs_of(region) {
                    let y = i64::from(run.row);
                    if y < first_row || y > bottom || (y - first_row) % step != 0 {
                        continue;
                    }
                    let first = (i64::from(run.begin) - left).max(0);
                    let end = (i64::from(run.end) - left).min(last - left + 1);
                    // The part of the row within reach: |p + dx·r|² ≤ reach², p its point in the middle column.
                    let dy = (y - row) as f64;
                    let from = [0, 1].map(|axis| dy * down[axis] - off[axis]);
                    let along = from[0] * right[0] + from[1] * right[1];
                    let left_over = reach_mm * reach_mm - from[0] * from[0] - from[1] * from[1];
                    let root = along * along + right2 * left_over;
                    if root < 0.0 {
                        continue;
                    }
                    let (middle, half) = (-along / right2, root.sqrt() / right2);
                    let to_left = column - left;
                    let first = first.max((middle - half).ceil() as i64 + to_left);
                    let end = end.min((middle + half).floor() as i64 + to_left + 1);
                    let first = first + (step - first % step) % step;
                    let columns = || {
                        let steps = ((end - first + step - 1) / step).max(0);
                        (0..steps).map(|index| (first + index * step - to_left) as f64)
                    };
                    self.x_mm.extend(columns().map(|dx| (dx * right[0] + dy * down[0]) as f32));
                    self.y_mm.extend(columns().map(|dx| (dx * right[1] + dy * down[1]) as f32));
                }
            }
            if self.x_mm.len() > begin {
                self.classes.push((class, begin..self.x_mm.len()));
            }
        }
        for list in [&mut self.ahead_mm, &mut self.aside_mm] {
            list.resize(self.x_mm.len(), 0.0);
        }
        self.cells.resize(self.x_mm.len(), 0);
    }

    /// The coverage at a pose.
    pub fn coverage(&mut self, shares: &Shares, pose: &Pose) -> Coverage {
        dispatch!(self.level, _simd => self.sum_up(shares, pose, |share| share))
    }

    /// The coverage of the patches' insides, where every pixel counts as one.
    pub fn coverage_inside(&mut self, shares: &Shares, pose: &Pose) -> Coverage {
        let count = |share| if Shares::is_inside(share) { 1.0 } else { 0.0 };
        dispatch!(self.level, _simd => self.sum_up(shares, pose, count))
    }

    #[inline(always)]
    fn sum_up(&mut self, shares: &Shares, pose: &Pose, count: impl Fn(f32) -> f32) -> Coverage {
        self.place(shares, pose);
        let table = shares.cells();
        let mut by_class = [PatchRow::default(); CLASSES];
        for (class, pixels) in &self.classes {
            let mut sums = PatchRow::default();
            for &cell in &self.cells[pixels.clone()] {
                let share = &table[cell as usize];
                for patch in 0..ROW {
                    sums[patch] += count(share[patch]);
                }
            }
            by_class[*class] = sums;
        }
        Coverage { by_class, pixel_mm2: self.pixel_mm2 }
    }

    /// Finds the place in the robot's frame and the cell of every pixel.
    #[inline(always)]
    fn place(&mut self, shares: &Shares, pose: &Pose) {
        let (sin, cos) = pose.orientation.sin_cos();
        let (sin, cos) = (sin as f32, cos as f32);
        let center_x = (pose.position.x_mm - self.origin.x_mm) as f32;
        let center_y = (pose.position.y_mm - self.origin.y_mm) as f32;
        let count = self.x_mm.len();
        self.work += EVALUATION_WORK + count as u64;
        let (x_mm, y_mm) = (&self.x_mm[..count], &self.y_mm[..count]);
        let (ahead_mm, aside_mm) = (&mut self.ahead_mm[..count], &mut self.aside_mm[..count]);
        let cells = &mut self.cells[..count];
        let grid = shares.grid();
        for index in 0..count {
            let (dx, dy) = (x_mm[index] - center_x, y_mm[index] - center_y);
            let (ahead, aside) = (cos * dx + sin * dy, cos * dy - sin * dx);
            (ahead_mm[index], aside_mm[index]) = (ahead, aside);
            cells[index] = grid.cell_at(ahead, aside);
        }
    }

    /// F and its gradient at a pose.
    fn score(&mut self, shares: &Shares, accepted: &Accepted, pose: &Pose) -> Score {
        dispatch!(self.level, _simd => self.sum_up_slopes(shares, accepted, pose))
    }

    #[inline(always)]
    fn sum_up_slopes(&mut self, shares: &Shares, accepted: &Accepted, pose: &Pose) -> Score {
        self.place(shares, pose);
        let (mut sums, mut turn) = ([0.0; 4], 0.0);
        for (class, pixels) in &self.classes {
            for (patch, accepted) in accepted.iter().enumerate() {
                if accepted >> class & 1 == 0 {
                    continue;
                }
                let table = shares.slopes_of(patch);
                let cells = self.cells[pixels.clone()].iter();
                let places =
                    self.ahead_mm[pixels.clone()].iter().zip(&self.aside_mm[pixels.clone()]);
                for (&cell, (&x, &y)) in cells.zip(places) {
                    let slope = table[cell as usize];
                    for (sum, part) in sums.iter_mut().zip(slope) {
                        *sum += part;
                    }
                    turn += y * slope[1] - x * slope[2];
                }
            }
        }
        // A step of the robot moves the pixels the other way within it.
        Score { sum: sums[0], slope: [-sums[1], -sums[2], turn] }
    }

    /// The pose near `start` at which F is greatest.
    pub fn best_near(&mut self, shares: &Shares, accepted: &Accepted, start: Pose) -> Pose {
        let mut best = start;
        let mut score = self.score(shares, accepted, &best);
        let mut damping = 1.0;
        for _ in 1..MAX_EVALUATIONS {
            let Some(step) = self.step(shares, &score) else { break };
            let [x, y, turn] = step.map(|part| damping * part);
            let position = best.field_from_robot([x, y]);
            let tried = Pose { position, orientation: best.orientation + turn };
            let there = self.score(shares, accepted, &tried);
            let moved_mm = x.hypot(y).hypot(turn * shares.reach_mm / 2.0);
            if there.sum > score.sum {
                (best, score, damping) = (tried, there, 1.0);
            } else {
                damping /= 2.0;
            }
            if moved_mm < SETTLED_MM {
                break;
            }
        }
        best
    }

    /// Newton's step, shortened to the longest one.
    fn step(&self, shares: &Shares, score: &Score) -> Option<[f64; 3]> {
        // The curvature of F is proportional to the visible part of the robot.
        const LEAST_SHOWN: f32 = 0.25;
        let shown = score.sum * self.pixel_mm2 / shares.area_mm2().max(1.0);
        let per_pixel = self.pixel_mm2 / shown.clamp(LEAST_SHOWN, 1.0);
        let slope = score.slope.map(|part| f64::from(part * per_pixel));
        let step = times(&inverse(&shares.curvature)?, &slope);
        let [x, y, turn] = step;
        let excess =
            (x.hypot(y) / LONGEST_STEP_MM).max(turn.abs() / LONGEST_STEP_DEG.to_radians()).max(1.0);
        let step = step.map(|part| part / excess);
        step.iter().all(|part| part.is_finite()).then_some(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Pattern;
    use crate::regions::RegionFinder;
    use bytemuck::Zeroable;
    use config::{Config, Preset};
    use geometry::layout::topmost_patch;
    use geometry::wrap_angle;
    use messages::Run;

    /// A robot of the large league at a pose, as runs: class i for patch i. `shows` says which pixels
    /// are recognised.
    fn painted(
        config: &Config,
        pose: &Pose,
        shows: impl Fn(u16, u16) -> bool,
    ) -> Box<DetectionFrame> {
        let camera = &config.camera;
        let model = CameraModel::new(&config.geometry, camera.width, camera.height).unwrap();
        let mut runs = Vec::new();
        for row in 0..camera.height as u16 {
            for column in 0..camera.width as u16 {
                let point = ImagePoint::new(column.into(), row.into());
                let place = model.field_from_image(point, config.robots.height_mm);
                let point = crate::pose::robot_from_field(pose, place);
                let patch = topmost_patch(&config.robots, point).filter(|_| shows(column, row));
                if let Some(patch) = patch {
                    let class = patch as u8;
                    runs.push(Run { row, begin: column, end: column + 1, class, reserved: 0 });
                }
            }
        }
        let mut frame = Box::new(DetectionFrame::zeroed());
        RegionFinder::new(camera.width, camera.height, 8, 1).find(&runs, &mut frame);
        frame
    }

    #[test]
    fn half_a_robot_still_tells_its_pose() {
        let mut config = Preset::MirosotLarge.config();
        config.camera.width = 640;
        config.camera.height = 480;
        config.geometry =
            config::GeometryConfig::above(&config.field, config.camera.picture_px(), 4000.0);
        let pattern = Pattern::new(&config).unwrap();
        let camera = CameraModel::new(&config.geometry, 640, 480).unwrap();
        let accepted = [1, 2, 4, 0, 0, 0];
        for degrees in [0.0, 33.0, 130.0, -75.0] {
            let position = FieldPoint::new(310.0, -220.0);
            let pose = Pose { position, orientation: f64::to_radians(degrees) };
            // A checkerboard of holes, and one identification patch gone at all.
            let frame = painted(&config, &pose, |column, row| (column / 2 + row / 2) % 3 != 0);
            let mut index = ClassIndex::default();
            index.fill(&frame);
            let mut nearby = NearbyPixels::default();
            let top = &pattern.tops[0];
            let team_patch = pose.field_from_robot(top.patches[top.team_patch].centroid_mm);
            nearby.collect(top, &camera, &frame, &index, team_patch);
            let start = Pose {
                position: FieldPoint::new(position.x_mm + 4.0, position.y_mm - 3.0),
                orientation: pose.orientation + 0.3,
            };
            let fitted = nearby.best_near(&top.shares, &accepted, start);
            let turned = wrap_angle(fitted.orientation - pose.orientation).to_degrees().abs();
            assert!(turned < 6.0, "{degrees}: {turned}°");
            assert!(fitted.position.distance(position) < 6.0, "{degrees}: {fitted:?}");
            let coverage = nearby.coverage(&top.shares, &fitted);
            let right = coverage.agreement(&top.shares, &accepted);
            let swapped = coverage.agreement(&top.shares, &[1, 4, 2, 0, 0, 0]);
            assert!(right[1] > 0.2 && swapped[1] < 0.0, "{right:?} {swapped:?}");
        }
    }

    #[test]
    fn nowhere_is_survived() {
        let config = Config::default();
        let pattern = Pattern::new(&config).unwrap();
        let camera = CameraModel::new(&config.geometry, 640, 480).unwrap();
        let frame = Box::new(DetectionFrame::zeroed());
        let mut index = ClassIndex::default();
        index.fill(&frame);
        let mut nearby = NearbyPixels::default();
        let top = &pattern.tops[0];
        for x_mm in [f64::NAN, 1e12, -5000.0] {
            let pose = Pose { position: FieldPoint::new(x_mm, 0.0), orientation: 0.0 };
            nearby.collect(top, &camera, &frame, &index, pose.position);
            let fitted = nearby.best_near(&top.shares, &[1; MAX_PATCHES], pose);
            assert!(!fitted.orientation.is_nan());
        }
    }
}
