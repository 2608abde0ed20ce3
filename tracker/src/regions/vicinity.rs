//! Vicinity: the parts of the picture near certain places, as a coarse grid of bits.
//!
//! Most specks of identification colours on a real pitch lie far from any team patch, and no robot can be made
//! of them. A look at a few bits tells, before a speck is measured.

use geometry::{CameraModel, ImagePoint};
use messages::Region;

/// Side of a cell in pixels.
const CELL_PX: u16 = 16;
/// Cells in a row, enough for any coordinate of a region.
const COLUMNS: usize = (u16::MAX as usize + 1) / CELL_PX as usize;
const WORDS: usize = COLUMNS / u64::BITS as usize;
/// Longest reach that is marked cell by cell; with a longer one every place counts as near.
const FARTHEST_PX: f64 = 2000.0;

/// Marked cells of the picture.
#[derive(Debug, Clone, Default)]
pub(crate) struct Vicinity {
    /// Rows from the top of the picture down to the last that has a mark.
    rows: Vec<[u64; WORDS]>,
    is_everywhere: bool,
}

impl Vicinity {
    pub fn clear(&mut self) {
        self.rows.clear();
        self.is_everywhere = false;
    }

    /// Marks everything within `reach_px` of a point, and a little more.
    pub fn add(&mut self, point: ImagePoint, reach_px: f64) {
        let corners = [point.x_px, point.y_px].map(|at| [at - reach_px, at + reach_px]);
        let is_usable = corners.iter().flatten().all(|corner| corner.is_finite());
        if !is_usable || reach_px > FARTHEST_PX {
            self.is_everywhere = true;
            return;
        }
        // The conversion saturates.
        let [columns, rows] =
            corners.map(|corners| corners.map(|corner| usize::from(corner as u16 / CELL_PX)));
        if self.rows.len() <= rows[1] {
            self.rows.resize(rows[1] + 1, [0; WORDS]);
        }
        for row in &mut self.rows[rows[0]..=rows[1]] {
            for (word, bits) in words(columns) {
                row[word] |= bits;
            }
        }
    }

    /// Whether the bounds of a region meet a mark.
    pub fn meets(&self, region: &Region) -> bool {
        let [left, right, top, bottom] = [region.left, region.right, region.top, region.bottom]
            .map(|side| usize::from(side / CELL_PX));
        let end = self.rows.len().min(bottom + 1);
        let is_marked = |row: &[u64; WORDS]| {
            words([left, right.max(left)]).any(|(word, bits)| row[word] & bits != 0)
        };
        self.is_everywhere || self.rows.get(top..end).is_some_and(|rows| rows.iter().any(is_marked))
    }
}

/// The words of a row that have these columns, and their bits in each.
fn words([first, last]: [usize; 2]) -> impl Iterator<Item = (usize, u64)> {
    const BITS: usize = u64::BITS as usize;
    (first / BITS..=last / BITS).map(move |word| {
        let from = first.saturating_sub(word * BITS);
        let to = (last - word * BITS).min(BITS - 1);
        (word, (u64::MAX << from) & (u64::MAX >> (BITS - 1 - to)))
    })
}

/// Length of a pixel on a plane above the floor, in the direction in which it is shortest.
pub(crate) fn least_mm_per_px(camera: &CameraModel, point: ImagePoint, height_mm: f64) -> f64 {
    let (_, [u, v]) = camera.field_and_slopes(point, height_mm);
    let squares = u[0] * u[0] + u[1] * u[1] + v[0] * v[0] + v[1] * v[1];
    let area = u[0] * v[1] - u[1] * v[0];
    // The smaller singular value of the map.
    ((squares - (squares * squares - 4.0 * area * area).max(0.0).sqrt()) / 2.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Config;
    use proptest::prelude::*;

    proptest! {
        /// Whatever lies within reach is near; what is farther than two cells beyond it is not.
        #[test]
        fn regions_within_reach_are_near(
            points in prop::collection::vec((-50.0..2000.0f64, -50.0..1500.0f64), 0..6),
            reach_px in 0.0..300.0f64,
            [left, top] in prop::array::uniform2(0..2000u16),
            [width, height] in prop::array::uniform2(0..90u16),
        ) {
            let mut vicinity = Vicinity::default();
            for _ in 0..2 {
                vicinity.clear();
                for &(x_px, y_px) in &points {
                    vicinity.add(ImagePoint::new(x_px, y_px), reach_px);
                }
            }
            let (right, bottom) = (left + width, top + height);
            let region = Region { left, top, right, bottom, ..Region::default() };
            let off = |at: f64, first: u16, last: u16| {
                (f64::from(first) - at).max(at - f64::from(last)).max(0.0)
            };
            let distances = points.iter().map(|&(x_px, y_px)| {
                off(x_px, left, right).max(off(y_px, top, bottom))
            });
            let distance = distances.fold(f64::INFINITY, f64::min);
            if distance <= reach_px {
                prop_assert!(vicinity.meets(&region));
            }
            if distance > reach_px + 2.0 * f64::from(CELL_PX) {
                prop_assert!(!vicinity.meets(&region));
            }
        }
    }

    #[test]
    fn a_place_without_a_finite_reach_is_near_everything() {
        let region = Region { left: 900, right: 901, top: 5, bottom: 5, ..Region::default() };
        for (x_px, reach_px) in [(f64::NAN, 1.0), (0.0, f64::INFINITY), (0.0, 1e5)] {
            let mut vicinity = Vicinity::default();
            assert!(!vicinity.meets(&region));
            vicinity.add(ImagePoint::new(x_px, 0.0), reach_px);
            assert!(vicinity.meets(&region));
        }
    }

    #[test]
    fn the_shortest_direction_of_a_pixel_is_found() {
        let config = Config::default();
        let camera = CameraModel::new(&config.geometry, 640, 480).unwrap();
        let point = ImagePoint::new(600.0, 30.0);
        let at = |angle: f64| {
            let (sin, cos) = angle.sin_cos();
            let there = ImagePoint::new(point.x_px + cos, point.y_px + sin);
            camera.field_from_image(there, 50.0).distance(camera.field_from_image(point, 50.0))
        };
        let least = (0..360).map(|degrees| at(f64::from(degrees).to_radians()));
        let least = least.fold(f64::INFINITY, f64::min);
        assert!((least_mm_per_px(&camera, point, 50.0) / least - 1.0).abs() < 0.01);
    }
}
