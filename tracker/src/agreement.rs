//! Poses by agreement: where the layout, laid over the picture, explains most pixels.
//!
//! A fit of centroids is as good as the regions are whole. Small, dark patches under a poor camera
//! are not: half of one is missing, a neighbour's rim has its colour, and the heading is off by ten
//! degrees. What then still tells the pose is every single pixel: at the right pose pixels of each
//! patch's colour lie in that patch, and few others do. So the pose is moved to where the sum over all
//! pixels around is greatest: a pixel counts for the patch it lies in, weighted by how far inside it
//! lies, when it has the patch's colour, and half as much against it when it has another or none. Since
//! a patch covers as many pixels wherever it lies, those against it are known from those for it, and only
//! pixels of some colour need be looked at.
//!
//! # The search
//!
//! The weights s fade at the rims of patches, so the sum F(x, y, θ) = Σ s is smooth, and Newton's method
//! finds its maximum: the step is H⁻¹·∇F. ∇F comes with F, from differences of the table of weights; H
//! is that of a whole robot at its own pose, known beforehand, times the part of the robot that shows.
//! A step that leads down is halved. Four or five looks at the pixels are enough.

use crate::linear::{UPPER, inverse, times};
use crate::pattern::Top;
use crate::pose::robot_from_field;
use common::config::PatchConfig;
use common::geometry::{CameraModel, FieldPoint, ImagePoint, Pose};
use common::layout::{reach_mm, topmost_patch};
use common::messages::{DetectionFrame, MAX_PATCHES};

/// A pixel of another colour than the patch's, or of none, counts so much against it.
const AGAINST: f32 = 0.5;
/// The rims of patches fade over this distance: demosaicing mixes pixels with their neighbours, and a
/// sum that changes gradually shows the way to its greatest value.
const FADE_MM: f64 = 6.0;
const CELL_MM: f64 = 1.0;
/// A cell with so much of a patch lies inside it, and not where a neighbour's colour begins.
const INSIDE: f32 = 0.5;
/// At most so many pixels are looked at for a robot; of larger pictures every second, third … one.
const MAX_PIXELS: f64 = 1600.0;
/// The robot may be so far from where it is looked for.
const START_ERROR_MM: f64 = 12.0;
/// Longest step of the search.
const LONGEST_STEP_MM: f64 = 6.0;
const LONGEST_STEP_DEG: f64 = 12.0;
/// A step shorter than this was the last.
const SETTLED_MM: f64 = 0.2;
/// Most looks at the pixels.
const MAX_LOOKS: u32 = 12;

/// How much of each patch there is at every point of a robot's top, the rims faded.
#[derive(Debug, Clone)]
pub(crate) struct Shares {
    reach_mm: f64,
    columns: usize,
    /// For each cell, the share of each patch.
    cells: Vec<[f32; MAX_PATCHES]>,
    /// For each patch, the sum of its shares in square millimetres.
    areas_mm2: [f32; MAX_PATCHES],
    /// For each patch, the area of the cells well inside it, which have at least [`INSIDE`] of it.
    insides_mm2: [f32; MAX_PATCHES],
    /// By how much the sum over a whole robot falls with the square of a step, in square millimetres:
    /// upper triangle for steps in x, y (mm) and heading (rad), all in the robot's frame.
    curvature: [f64; 6],
}

/// Agreement of the pixels with a pose, and its gradient.
#[derive(Debug, Clone, Copy, Default)]
struct Look {
    /// Pixels that agree, weighted.
    sum: f32,
    /// How that changes with a step of the robot in its own frame: mm, mm, rad.
    slope: [f32; 3],
}

/// The pixels around a robot that have a colour.
#[derive(Debug, Clone, Default)]
pub(crate) struct Surroundings {
    pixels: Vec<Pixel>,
    /// What each stands for.
    pixel_mm2: f32,
    /// From where their places are counted.
    origin: FieldPoint,
}

#[derive(Debug, Clone, Copy)]
struct Pixel {
    x_mm: f32,
    y_mm: f32,
    /// Bit i: it has colour class i.
    class_bit: u32,
}

/// For each patch, the classes that agree with it, as a bit set.
pub(crate) type Accepted = [u32; MAX_PATCHES];

impl Shares {
    pub fn new(patches: &[PatchConfig]) -> Self {
        // With a border all around.
        let reach_mm = reach_mm(patches) + 2.0 * FADE_MM + CELL_MM;
        let columns = ((2.0 * reach_mm / CELL_MM).ceil() as usize).max(3);
        let place = |index: usize| (index as f64 + 0.5) * CELL_MM - reach_mm;
        let mut cells = vec![[0.0; MAX_PATCHES]; columns * columns];
        for (cell, share) in cells.iter_mut().enumerate() {
            let point = [place(cell % columns), place(cell / columns)];
            if let Some(patch) = topmost_patch(patches, point) {
                share[patch] = 1.0;
            }
        }
        let curvature = curvature(cells.clone(), columns, place);
        fade(&mut cells, columns, FADE_MM);
        let mut areas_mm2 = [0.0; MAX_PATCHES];
        for share in &cells {
            areas_mm2.iter_mut().zip(share).for_each(|(area, share)| *area += share);
        }
        let insides_mm2 = std::array::from_fn(|patch| {
            let is_inside = |share: &&[f32; MAX_PATCHES]| share[patch] >= INSIDE;
            cells.iter().filter(is_inside).count() as f32 * (CELL_MM * CELL_MM) as f32
        });
        areas_mm2.iter_mut().for_each(|area| *area *= (CELL_MM * CELL_MM) as f32);
        Self { reach_mm, columns, cells, areas_mm2, insides_mm2, curvature }
    }

    /// Square millimetres that a whole robot's patches agree with at its own pose.
    fn area_mm2(&self) -> f32 {
        self.areas_mm2.iter().sum()
    }
}

/// The negative second derivatives of the sum over a robot whose patches are all there, at its pose.
/// The sum is the correlation of its patches with the patches faded. That is the correlation of the
/// patches faded half as much (in variance) with themselves, so its second derivatives are products of
/// their slopes.
fn curvature(
    mut shares: Vec<[f32; MAX_PATCHES]>,
    columns: usize,
    place: impl Fn(usize) -> f64,
) -> [f64; 6] {
    fade(&mut shares, columns, FADE_MM / std::f64::consts::SQRT_2);
    let mut sums = [0.0; 6];
    for (row, column) in (1..columns - 1).flat_map(|row| (1..columns - 1).map(move |c| (row, c))) {
        let cell = row * columns + column;
        // How the share of each patch changes from the cell before to the one behind.
        let between = |step: usize| {
            let pairs = shares[cell - step].iter().zip(&shares[cell + step]);
            pairs.map(|(before, behind)| f64::from(behind - before) / (2.0 * CELL_MM))
        };
        for (x, y) in between(1).zip(between(columns)) {
            let slope = [x, y, place(row) * x - place(column) * y];
            for (sum, (i, j)) in sums.iter_mut().zip(UPPER) {
                *sum += slope[i] * slope[j] * CELL_MM * CELL_MM;
            }
        }
    }
    sums
}

impl Surroundings {
    /// Looks at the pixels around a team patch at `place`, wherever around it the robot may turn out to
    /// be: what is not looked at would count against it.
    pub fn look_at(
        &mut self,
        top: &Top,
        camera: &CameraModel,
        frame: &DetectionFrame,
        place: FieldPoint,
    ) {
        self.pixels.clear();
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
        // The map from pixels to millimetres is as good as linear over a robot.
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
        // What the regions show of it.
        let (left, first_row) = (column - steps * step, row - steps * step);
        let (last, bottom) = (column + steps * step, row + steps * step);
        for region in frame.regions() {
            let apart = i64::from(region.left) > last
                || i64::from(region.right) < left
                || i64::from(region.top) > bottom
                || i64::from(region.bottom) < first_row;
            let class_bit = 1u32.checked_shl(region.class).unwrap_or(0);
            if apart || class_bit == 0 {
                continue;
            }
            for run in frame.runs_of(region) {
                let y = i64::from(run.row);
                if y < first_row || y > bottom || (y - first_row) % step != 0 {
                    continue;
                }
                let first = (i64::from(run.begin) - left).max(0);
                let end = (i64::from(run.end) - left).min(last - left + 1);
                let first = first + (step - first % step) % step;
                for x in (first..end).step_by(step as usize) {
                    let (dx, dy) = ((left + x - column) as f64, (y - row) as f64);
                    let at = [0, 1].map(|axis| dx * right[axis] + dy * down[axis]);
                    let [dx, dy] = [at[0] - off[0], at[1] - off[1]];
                    if dx * dx + dy * dy <= reach_mm * reach_mm {
                        let [x_mm, y_mm] = at.map(|value| value as f32);
                        self.pixels.push(Pixel { x_mm, y_mm, class_bit });
                    }
                }
            }
        }
    }

    /// For each patch, what speaks for and against it, in pixels.
    fn sums(&self, shares: &Shares, accepted: &Accepted, pose: &Pose) -> [f32; MAX_PATCHES] {
        let mut agree = [0.0; MAX_PATCHES];
        let scale = 1.0 / CELL_MM as f32;
        let (sin, cos) = pose.orientation.sin_cos();
        let (sin, cos) = (sin as f32 * scale, cos as f32 * scale);
        let middle = (shares.reach_mm / CELL_MM) as f32;
        let columns = shares.columns as f32;
        let center_x = (pose.position.x_mm - self.origin.x_mm) as f32;
        let center_y = (pose.position.y_mm - self.origin.y_mm) as f32;
        for pixel in &self.pixels {
            let (dx, dy) = (pixel.x_mm - center_x, pixel.y_mm - center_y);
            let x = cos * dx + sin * dy + middle;
            let y = cos * dy - sin * dx + middle;
            if !(x >= 0.0 && y >= 0.0 && x < columns && y < columns) {
                continue;
            }
            let cell = &shares.cells[y as usize * shares.columns + x as usize];
            for ((agree, share), accepted) in agree.iter_mut().zip(cell).zip(accepted) {
                *agree += if accepted & pixel.class_bit != 0 { *share } else { 0.0 };
            }
        }
        let per_mm2 = if self.pixel_mm2 > 0.0 { AGAINST / self.pixel_mm2 } else { 0.0 };
        for (agree, area_mm2) in agree.iter_mut().zip(shares.areas_mm2) {
            *agree = (1.0 + AGAINST) * *agree - area_mm2 * per_mm2;
        }
        agree
    }

    /// For each patch, which part of its inside has a colour that agrees, and which part has the one other
    /// colour that most of it has.
    pub fn colors_inside(
        &self,
        shares: &Shares,
        accepted: &Accepted,
        pose: &Pose,
    ) -> [[f32; 2]; MAX_PATCHES] {
        let mut pixels = [[0u32; 32]; MAX_PATCHES];
        for pixel in &self.pixels {
            let place = FieldPoint::new(
                self.origin.x_mm + f64::from(pixel.x_mm),
                self.origin.y_mm + f64::from(pixel.y_mm),
            );
            let [x, y] = robot_from_field(pose, place).map(|v| (v + shares.reach_mm) / CELL_MM);
            let columns = shares.columns as f64;
            if !(x >= 0.0 && y >= 0.0 && x < columns && y < columns) {
                continue;
            }
            let cell = &shares.cells[y as usize * shares.columns + x as usize];
            for (share, pixels) in cell.iter().zip(&mut pixels) {
                if *share >= INSIDE {
                    pixels[pixel.class_bit.trailing_zeros() as usize % 32] += 1;
                }
            }
        }
        std::array::from_fn(|patch| {
            let (mut own, mut other) = (0, 0);
            for (class, &count) in pixels[patch].iter().enumerate() {
                match accepted[patch] >> class & 1 {
                    1 => own += count,
                    _ => other = other.max(count),
                }
            }
            let inside_mm2 = shares.insides_mm2[patch];
            let part = |count: u32| match inside_mm2 > 0.0 {
                true => count as f32 * self.pixel_mm2 / inside_mm2,
                false => 0.0,
            };
            [part(own), part(other)]
        })
    }

    /// For each patch, 1 when all of it has a colour that agrees; at worst −½.
    pub fn agreement(
        &self,
        shares: &Shares,
        accepted: &Accepted,
        pose: &Pose,
    ) -> [f32; MAX_PATCHES] {
        let mut sums = self.sums(shares, accepted, pose);
        for (sum, area_mm2) in sums.iter_mut().zip(shares.areas_mm2) {
            *sum *= if area_mm2 > 0.0 { self.pixel_mm2 / area_mm2 } else { 0.0 };
        }
        sums
    }

    /// The sum over all pixels, and its slope.
    fn look(&self, shares: &Shares, accepted: &Accepted, pose: &Pose) -> Look {
        let (sin, cos) = pose.orientation.sin_cos();
        let (sin, cos) = (sin as f32, cos as f32);
        let (middle, columns) = (shares.reach_mm as f32, shares.columns);
        let last = (columns - 1) as f32;
        let center_x = (pose.position.x_mm - self.origin.x_mm) as f32;
        let center_y = (pose.position.y_mm - self.origin.y_mm) as f32;
        let (mut sum, mut slope) = (0.0, [0.0; 3]);
        for pixel in &self.pixels {
            let (dx, dy) = (pixel.x_mm - center_x, pixel.y_mm - center_y);
            let (x, y) = (cos * dx + sin * dy, cos * dy - sin * dx);
            let [column, row] = [x, y].map(|at| (at + middle) * (1.0 / CELL_MM as f32));
            // Not at the border, so that there is a cell on each side.
            if !(column >= 1.0 && row >= 1.0 && column < last && row < last) {
                continue;
            }
            let cell = row as usize * columns + column as usize;
            let near = [cell, cell - 1, cell + 1, cell - columns, cell + columns];
            let near = near.map(|cell| &shares.cells[cell]);
            for (patch, accepted) in accepted.iter().enumerate() {
                if accepted & pixel.class_bit != 0 {
                    let [here, left, right, above, below] = near.map(|cell| cell[patch]);
                    let (by_x, by_y) = (right - left, below - above);
                    sum += here;
                    // The robot moves on by the step, so the pixel moves back within it.
                    slope[0] -= by_x;
                    slope[1] -= by_y;
                    slope[2] += y * by_x - x * by_y;
                }
            }
        }
        Look { sum, slope: slope.map(|part| part / (2.0 * CELL_MM as f32)) }
    }

    /// The pose near `start` that explains most.
    pub fn best_near(&self, shares: &Shares, accepted: &Accepted, start: Pose) -> Pose {
        let mut best = start;
        let mut look = self.look(shares, accepted, &best);
        let mut damping = 1.0;
        for _ in 1..MAX_LOOKS {
            let Some(step) = self.step(shares, &look) else { break };
            let [x, y, turn] = step.map(|part| damping * part);
            let position = best.field_from_robot([x, y]);
            let tried = Pose { position, orientation: best.orientation + turn };
            let there = self.look(shares, accepted, &tried);
            let moved_mm = x.hypot(y).hypot(turn * shares.reach_mm / 2.0);
            if there.sum > look.sum {
                (best, look, damping) = (tried, there, 1.0);
            } else {
                damping /= 2.0;
            }
            if moved_mm < SETTLED_MM {
                break;
            }
        }
        best
    }

    /// Newton's step.
    fn step(&self, shares: &Shares, look: &Look) -> Option<[f64; 3]> {
        // Where half of the robot shows, everything is half as steep.
        const LEAST_SHOWN: f32 = 0.25;
        let shown = look.sum * self.pixel_mm2 / shares.area_mm2().max(1.0);
        let per_pixel = self.pixel_mm2 / shown.clamp(LEAST_SHOWN, 1.0);
        let slope = look.slope.map(|part| f64::from(part * per_pixel));
        let step = times(&inverse(&shares.curvature)?, &slope);
        let [x, y, turn] = step;
        let excess =
            (x.hypot(y) / LONGEST_STEP_MM).max(turn.abs() / LONGEST_STEP_DEG.to_radians()).max(1.0);
        let step = step.map(|part| part / excess);
        step.iter().all(|part| part.is_finite()).then_some(step)
    }
}

/// Blurs shares with a kernel of three boxes, which is as good as a Gaussian.
fn fade(shares: &mut [[f32; MAX_PATCHES]], columns: usize, sigma_mm: f64) {
    // A box of width w has a variance of (w² − 1)/12 cells²; each takes its part of what is left.
    let mut left = (sigma_mm / CELL_MM).powi(2);
    for boxes in [3.0, 2.0, 1.0] {
        let half = (((12.0 * left / boxes + 1.0).max(1.0).sqrt() - 1.0) / 2.0).round() as usize;
        left -= ((2 * half + 1).pow(2) - 1) as f64 / 12.0;
        for vertical in [false, true] {
            let before = shares.to_vec();
            let index = |line: usize, place: usize| {
                if vertical { place * columns + line } else { line * columns + place }
            };
            for line in 0..columns {
                for place in 0..columns {
                    let around = place.saturating_sub(half)..(place + half + 1).min(columns);
                    let mut sum = [0.0; MAX_PATCHES];
                    for other in around {
                        let share = &before[index(line, other)];
                        sum.iter_mut().zip(share).for_each(|(sum, share)| *sum += share);
                    }
                    shares[index(line, place)] = sum.map(|sum| sum / (2 * half + 1) as f32);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Pattern;
    use crate::regions::RegionFinder;
    use bytemuck::Zeroable;
    use common::config::{Config, Preset};
    use common::geometry::wrap_angle;
    use common::messages::Run;

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
            common::config::GeometryConfig::above(&config.field, &config.camera, 4000.0);
        let pattern = Pattern::new(&config).unwrap();
        let camera = CameraModel::new(&config.geometry, 640, 480).unwrap();
        let accepted = [1, 2, 4, 0, 0, 0];
        for degrees in [0.0, 33.0, 130.0, -75.0] {
            let position = FieldPoint::new(310.0, -220.0);
            let pose = Pose { position, orientation: f64::to_radians(degrees) };
            // A checkerboard of holes, and one identification patch gone at all.
            let frame = painted(&config, &pose, |column, row| (column / 2 + row / 2) % 3 != 0);
            let mut surroundings = Surroundings::default();
            let top = &pattern.tops[0];
            let team_patch = pose.field_from_robot(top.patches[top.team_patch].centroid_mm);
            surroundings.look_at(top, &camera, &frame, team_patch);
            let start = Pose {
                position: FieldPoint::new(position.x_mm + 4.0, position.y_mm - 3.0),
                orientation: pose.orientation + 0.3,
            };
            let fitted = surroundings.best_near(&top.shares, &accepted, start);
            let turned = wrap_angle(fitted.orientation - pose.orientation).to_degrees().abs();
            assert!(turned < 6.0, "{degrees}: {turned}°");
            assert!(fitted.position.distance(position) < 6.0, "{degrees}: {fitted:?}");
            let right = surroundings.agreement(&top.shares, &accepted, &fitted);
            let swapped = surroundings.agreement(&top.shares, &[1, 4, 2, 0, 0, 0], &fitted);
            assert!(right[1] > 0.2 && swapped[1] < 0.0, "{right:?} {swapped:?}");
        }
    }

    #[test]
    fn shares_add_up_to_the_patches() {
        let config = Config::default();
        let shares = Shares::new(&config.robots.patches);
        for (patch, expected) in [34.0 * 34.0, 34.0 * 34.0].iter().enumerate() {
            let area = f64::from(shares.areas_mm2[patch]);
            assert!((area / expected - 1.0).abs() < 0.01, "{area} mm²");
        }
    }

    #[test]
    fn nowhere_is_survived() {
        let config = Config::default();
        let pattern = Pattern::new(&config).unwrap();
        let camera = CameraModel::new(&config.geometry, 640, 480).unwrap();
        let frame = Box::new(DetectionFrame::zeroed());
        let mut surroundings = Surroundings::default();
        let top = &pattern.tops[0];
        for x_mm in [f64::NAN, 1e12, -5000.0] {
            let pose = Pose { position: FieldPoint::new(x_mm, 0.0), orientation: 0.0 };
            surroundings.look_at(top, &camera, &frame, pose.position);
            let fitted = surroundings.best_near(&top.shares, &[1; MAX_PATCHES], pose);
            assert!(!fitted.orientation.is_nan());
        }
    }
}
