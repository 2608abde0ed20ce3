//! Footprints: the places of a robot's other patches, predicted from the shape of its team patch.
//!
//! The principal axis of a team patch that is longer than wide gives the robot's heading up to half a turn,
//! so there are two poses, and each predicts the place of every identification patch. The pixels of a colour
//! within the predicted patch, widened by [`MARGIN_MM`], are a candidate for it, even where their region
//! extends far beyond: grown together with a shadow, a floor in coloured light, or the rim of something else.

use super::{ExpectedPatch, Top};
use crate::regions::measure::{Measure, MomentSums};
use crate::regions::measured_regions::Bounds;
use config::{Pair, PatchConfig};
use geometry::layout::{reach_mm, topmost_patch};
use geometry::{CameraModel, FieldPoint, ImagePoint, Pose};
use messages::{DetectionFrame, Region};

/// Least ratio of the longer to the shorter deviation of a patch whose direction is known: by the layout, and
/// as measured.
const MIN_ELONGATION: f64 = 1.35;
const MIN_MEASURED_ELONGATION: f64 = 1.2;
/// Width that footprints add around their patches: about the uncertainty of the prediction, and about a
/// pixel.
const MARGIN_MM: f64 = 3.0;
/// Side of a cell.
const STEP_MM: f64 = 1.0;

/// A table of the patches that each point of a robot's top may belong to.
#[derive(Debug, Clone)]
pub(crate) struct Footprints {
    reach_mm: f64,
    columns: usize,
    /// Bit i is set for patch i.
    cells: Vec<u8>,
}

impl Footprints {
    /// The visible parts of the patches, widened.
    pub fn new(patches: &[PatchConfig]) -> Self {
        let reach_mm = reach_mm(patches) + MARGIN_MM + STEP_MM;
        let columns = ((2.0 * reach_mm / STEP_MM).ceil() as usize).max(1);
        let place = |index: usize| (index as f64 + 0.5) * STEP_MM - reach_mm;
        let shown: Vec<Option<usize>> = (0..columns * columns)
            .map(|cell| topmost_patch(patches, [place(cell % columns), place(cell / columns)]))
            .collect();
        let margin = (MARGIN_MM / STEP_MM) as i64;
        let around: Vec<(i64, i64)> = (-margin..=margin)
            .flat_map(|dy| (-margin..=margin).map(move |dx| (dx, dy)))
            .filter(|(dx, dy)| dx * dx + dy * dy <= margin * margin)
            .collect();
        let mut cells = vec![0; columns * columns];
        for (cell, patch) in shown.iter().enumerate() {
            let Some(patch) = patch else { continue };
            for (dx, dy) in &around {
                let (x, y) = ((cell % columns) as i64 + dx, (cell / columns) as i64 + dy);
                if (0..columns as i64).contains(&x) && (0..columns as i64).contains(&y) {
                    cells[y as usize * columns + x as usize] |= 1 << patch;
                }
            }
        }
        Self { reach_mm, columns, cells }
    }

    /// Whether a place, in cells from the table's corner, may belong to a patch.
    #[inline(always)]
    fn holds(&self, patch: usize, [x, y]: Pair) -> bool {
        let limit = self.columns as f64;
        // False for NaN.
        let is_inside = x >= 0.0 && y >= 0.0 && x < limit && y < limit;
        is_inside && self.cells[y as usize * self.columns + x as usize] >> patch & 1 == 1
    }

    /// Turns a point of the robot's frame into cells; with an origin of 0, a distance.
    fn in_cells(&self, point: Pair, origin_mm: f64) -> Pair {
        point.map(|value| (value + origin_mm) / STEP_MM)
    }
}

/// The two poses that a team patch's place and shape allow; `None` if it is as wide as long.
pub(crate) fn poses(team_patch: &ExpectedPatch, measure: &Measure) -> Option<[Pose; 2]> {
    let [major, minor] = measure.deviations_mm();
    if team_patch.major_mm < MIN_ELONGATION * team_patch.minor_mm
        || major < MIN_MEASURED_ELONGATION * minor
    {
        return None;
    }
    let axis = |[xx, xy, yy]: [f64; 3]| (2.0 * xy).atan2(xx - yy) / 2.0;
    let turned = axis(measure.covariance) - axis(team_patch.covariance);
    Some([turned, turned + std::f64::consts::PI].map(|orientation| {
        let turned = Pose { position: FieldPoint::default(), orientation };
        let offset = turned.field_from_robot(team_patch.centroid_mm);
        let position = FieldPoint::new(
            measure.position.x_mm - offset.x_mm,
            measure.position.y_mm - offset.y_mm,
        );
        Pose { position, ..turned }
    }))
}

/// The predicted place of a patch in the picture.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Footprint {
    /// Index into the patches of the top.
    pub patch: usize,
    /// Pixels that may belong to the patch.
    pub bounds: Bounds,
    center: ImagePoint,
    /// Place of `center` on the top in cells of its table, and its change with a pixel to the right and down.
    origin: Pair,
    right: Pair,
    down: Pair,
}

impl Footprint {
    /// Footprint of a patch of a robot at `pose`; `None` where the camera model has no answer.
    pub fn new(top: &Top, camera: &CameraModel, pose: &Pose, patch: usize) -> Option<Self> {
        let on_top = top.patches[patch].centroid_mm;
        let place = pose.field_from_robot(on_top);
        let center = camera.image_from_field(place, top.height_mm);
        // Over a patch the map from pixels to millimetres is linear to a fraction of a pixel. Its inverse
        // costs less.
        let ahead = |dx: f64, dy: f64| {
            let there = FieldPoint::new(place.x_mm + dx, place.y_mm + dy);
            let there = camera.image_from_field(there, top.height_mm);
            [there.x_px - center.x_px, there.y_px - center.y_px]
        };
        let ([a, c], [b, d]) = (ahead(1.0, 0.0), ahead(0.0, 1.0));
        let determinant = a * d - b * c;
        let (right, down) =
            ([d / determinant, -c / determinant], [-b / determinant, a / determinant]);
        let least = right[0].hypot(right[1]).min(down[0].hypot(down[1]));
        let reach_px = (top.patches[patch].reach_mm + MARGIN_MM) / least + 1.0;
        let usable = [place.x_mm, place.y_mm, center.x_px, center.y_px, reach_px];
        if !usable.iter().all(|number| number.is_finite()) {
            return None;
        }
        let (sin, cos) = pose.orientation.sin_cos();
        let turned = |[x, y]: Pair| [cos * x + sin * y, cos * y - sin * x];
        let table = &top.footprints;
        let within =
            |center: f64| [(center - reach_px).ceil() as i32, (center + reach_px).floor() as i32];
        Some(Self {
            patch,
            bounds: Bounds { columns: within(center.x_px), rows: within(center.y_px) },
            center,
            origin: table.in_cells(on_top, table.reach_mm),
            right: table.in_cells(turned(right), 0.0),
            down: table.in_cells(turned(down), 0.0),
        })
    }

    /// Adds the pixels of a region within the footprint to the sums; returns their number. `top` must be the
    /// top that the footprint was made for.
    pub fn add(
        &self,
        top: &Top,
        region: &Region,
        frame: &DetectionFrame,
        sums: &mut MomentSums,
    ) -> u32 {
        let clip = |value: i32| value.clamp(0, i32::from(u16::MAX)) as u16;
        let [first, last] = self.bounds.columns.map(clip);
        let [above, below] = self.bounds.rows;
        let mut count = 0;
        for run in frame.runs_of(region) {
            if !(above..=below).contains(&i32::from(run.row)) {
                continue;
            }
            let dy = f64::from(run.row) - self.center.y_px;
            let [x, y] = [0, 1].map(|axis| self.origin[axis] + self.down[axis] * dy);
            for column in run.begin.max(first)..run.end.min(last.saturating_add(1)) {
                let dx = f64::from(column) - self.center.x_px;
                let cell = [x + self.right[0] * dx, y + self.right[1] * dx];
                if top.footprints.holds(self.patch, cell) {
                    sums.add_pixel(f64::from(column), f64::from(run.row));
                    count += 1;
                }
            }
        }
        count
    }

    /// Empty sums around the footprint's centre.
    pub fn sums(&self) -> MomentSums {
        MomentSums::around((self.center.x_px, self.center.y_px))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Pattern;
    use config::{Config, Preset};
    use geometry::wrap_angle;

    /// A stripe ahead and two squares behind.
    fn stripe() -> Config {
        Preset::MirosotLarge.config()
    }

    /// The measure of a patch of a robot at `pose`.
    fn measured(pattern: &Pattern, patch: usize, pose: &Pose) -> Measure {
        let expected = pattern.tops[0].patches[patch];
        let [xx, xy, yy] = expected.covariance;
        let (sin, cos) = pose.orientation.sin_cos();
        Measure {
            pixels: 100.0,
            image: ImagePoint::default(),
            position: pose.field_from_robot(expected.centroid_mm),
            area_mm2: expected.area_mm2,
            covariance: [
                cos * cos * xx - 2.0 * sin * cos * xy + sin * sin * yy,
                sin * cos * (xx - yy) + (cos * cos - sin * sin) * xy,
                sin * sin * xx + 2.0 * sin * cos * xy + cos * cos * yy,
            ],
        }
    }

    #[test]
    fn a_stripe_tells_its_robots_pose_up_to_half_a_turn() {
        let pattern = Pattern::new(&stripe()).unwrap();
        for degrees in (-180..180).step_by(15) {
            let position = FieldPoint::new(300.0, -200.0);
            let pose = Pose { position, orientation: f64::from(degrees).to_radians() };
            let measure = measured(&pattern, 0, &pose);
            let poses = poses(&pattern.tops[0].patches[0], &measure).unwrap();
            let is_it = |guess: &&Pose| {
                wrap_angle(guess.orientation - pose.orientation).abs() < 1e-6
                    && guess.position.distance(pose.position) < 1e-6
            };
            assert_eq!(poses.iter().filter(is_it).count(), 1, "{degrees}°: {poses:?}");
        }
    }

    #[test]
    fn a_square_tells_nothing() {
        let pattern = Pattern::new(&Config::default()).unwrap();
        let measure = measured(&pattern, 0, &Pose::default());
        assert_eq!(poses(&pattern.tops[0].patches[0], &measure), None);
        // Nor does a visible piece of a stripe that is as wide as long.
        let pattern = Pattern::new(&stripe()).unwrap();
        let square =
            Measure { covariance: [90.0, 0.0, 90.0], ..measured(&pattern, 0, &Pose::default()) };
        assert_eq!(poses(&pattern.tops[0].patches[0], &square), None);
    }

    #[test]
    fn a_footprint_is_its_patch_and_a_margin() {
        let footprints = Footprints::new(&stripe().robots.patches);
        // The first square behind covers −35 to −2 by 2 to 35.
        for (point, inside) in [
            ([-18.5, 18.5], true),
            ([-34.0, 34.0], true),
            ([-37.0, 18.5], true),
            ([-18.5, 37.0], true),
            ([-39.5, 18.5], false),
            ([-18.5, 39.5], false),
            ([-18.5, -18.5], false),
            ([2.5, 18.5], false),
            ([f64::NAN, 0.0], false),
            ([1e300, -1e300], false),
        ] {
            let cell = footprints.in_cells(point, footprints.reach_mm);
            assert_eq!(footprints.holds(1, cell), inside, "{point:?}");
        }
    }
}
