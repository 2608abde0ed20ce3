//! Splitting of regions that are two or more patches of one colour grown together.
//!
//! When robots touch, patches of one colour can lie a pixel apart, and interpolated colours fill the gap.
//! Such a region has the area of several patches; k-means over its pixels (Lloyd's algorithm) gives the place
//! of each. Whether the pieces are patches is decided later, among all explanations of the picture.

use crate::regions::measure::{MomentSums, Moments};
use messages::{Region, Run};

/// Most pieces of a region.
pub(crate) const MAX_PIECES: usize = 4;
/// Most rounds of k-means; two squares side by side settle in three or four.
const MAX_ROUNDS: usize = 12;
/// Most work in a frame, in pixels times rounds times pieces: a few milliseconds, some hundred times what
/// touching robots need. Regions beyond it stay whole.
const WORK_PER_FRAME: usize = 500_000;

/// Splits regions, and counts its work over a frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct Splitter {
    pixels: Vec<(f64, f64)>,
    work: usize,
}

impl Splitter {
    /// Begins a new frame's budget.
    pub fn start_frame(&mut self) {
        self.work = 0;
    }

    /// Splits a region into `count` pieces, if the frame's budget allows it.
    pub fn split(
        &mut self,
        region: &Region,
        whole: &Moments,
        runs: &[Run],
        count: usize,
    ) -> Option<[Moments; MAX_PIECES]> {
        let count = count.clamp(2, MAX_PIECES);
        let round = count.saturating_mul(region.pixel_count as usize);
        if self.work.saturating_add(round) > WORK_PER_FRAME {
            return None;
        }
        // Two centres need only the whole's moments.
        if count > 2 {
            self.pixels.clear();
            for run in runs {
                let row = f64::from(run.row);
                self.pixels.extend((run.begin..run.end).map(|column| (f64::from(column), row)));
            }
        }
        let mut centers = self.first_centers(whole, count);
        let mut pieces = [Moments::default(); MAX_PIECES];
        for _ in 0..MAX_ROUNDS {
            self.work += round;
            let mut sums = centers.map(MomentSums::around);
            for run in runs {
                let mut begin = run.begin;
                while begin < run.end {
                    let (nearest, end) = stretch(&centers[..count], run.row, begin);
                    let end = end.clamp(begin + 1, run.end);
                    sums[nearest].add_run(&Run { begin, end, ..*run });
                    begin = end;
                }
            }
            let mut settled = true;
            for piece in 0..count {
                pieces[piece] = sums[piece].moments();
                if pieces[piece].pixels < 1.0 {
                    return None;
                }
                let center = (pieces[piece].x_px, pieces[piece].y_px);
                settled &= distance2(center, centers[piece]) < 1e-6;
                centers[piece] = center;
            }
            if settled {
                break;
            }
        }
        Some(pieces)
    }

    /// Both ends of the longer principal axis for two pieces; for more, the pixel farthest from the
    /// centroid and then, one by one, the pixel farthest from those chosen.
    fn first_centers(&self, whole: &Moments, count: usize) -> [(f64, f64); MAX_PIECES] {
        let middle = (whole.x_px, whole.y_px);
        let mut centers = [middle; MAX_PIECES];
        if count == 2 {
            let [xx, xy, yy] = whole.covariance;
            let angle = (2.0 * xy).atan2(xx - yy) / 2.0;
            let length = crate::pattern::principal_deviations(whole.covariance)[0];
            let (dx, dy) = (length * angle.cos(), length * angle.sin());
            centers[0] = (middle.0 - dx, middle.1 - dy);
            centers[1] = (middle.0 + dx, middle.1 + dy);
            return centers;
        }
        for chosen in 0..count {
            let remoteness = |pixel: (f64, f64)| {
                let others = &centers[..chosen];
                others.iter().map(|&other| distance2(other, pixel)).fold(
                    if chosen == 0 { distance2(middle, pixel) } else { f64::INFINITY },
                    f64::min,
                )
            };
            let mut farthest = (f64::NEG_INFINITY, middle);
            for &pixel in &self.pixels {
                let remoteness = remoteness(pixel);
                if remoteness >= farthest.0 {
                    farthest = (remoteness, pixel);
                }
            }
            centers[chosen] = farthest.1;
        }
        centers
    }
}

/// The centre that is nearest to a pixel, of equals the first, and the column from which on another one of
/// the row's pixels is nearer.
///
/// Along a row the difference of two squared distances is linear in the column x:
///
/// d₂²(x) − d₁²(x) = d₂²(x₀) − d₁²(x₀) − 2·(x₂ − x₁)·(x − x₀)
///
/// so another centre can become the nearest only once, and only if it lies farther to the right.
fn stretch(centers: &[(f64, f64)], row: u16, begin: u16) -> (usize, u16) {
    let pixel = (f64::from(begin), f64::from(row));
    let (mut nearest, mut least) = (0, f64::INFINITY);
    for (piece, &center) in centers.iter().enumerate() {
        let distance = distance2(center, pixel);
        if distance < least {
            (nearest, least) = (piece, distance);
        }
    }
    let mut columns = f64::from(u16::MAX);
    for (piece, &center) in centers.iter().enumerate() {
        let right = center.0 - centers[nearest].0;
        if right > 0.0 {
            let equal = (distance2(center, pixel) - least) / (2.0 * right);
            // Of equals the first is taken.
            let first = if piece < nearest { equal.ceil() } else { equal.floor() + 1.0 };
            columns = columns.min(first);
        }
    }
    // The conversion saturates.
    (nearest, (f64::from(begin) + columns) as u16)
}

fn distance2(a: (f64, f64), b: (f64, f64)) -> f64 {
    (a.0 - b.0).powi(2) + (a.1 - b.1).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The runs of squares of nine pixels with their top-left corners at the places given.
    fn squares(corners: &[(u16, u16)]) -> (Region, Moments, Vec<Run>) {
        let mut runs = Vec::new();
        for row in 0..100u16 {
            let mut columns: Vec<u16> = corners
                .iter()
                .filter(|(_, top)| (*top..top + 9).contains(&row))
                .flat_map(|(left, _)| *left..left + 9)
                .collect();
            columns.sort_unstable();
            columns.dedup();
            for stretch in columns.chunk_by(|a, b| a + 1 == *b) {
                let (begin, end) = (stretch[0], stretch[stretch.len() - 1] + 1);
                runs.push(Run { row, begin, end, class: 0, reserved: 0 });
            }
        }
        let mut sums = MomentSums::around((50.0, 50.0));
        runs.iter().for_each(|run| sums.add_run(run));
        let moments = sums.moments();
        let region = Region { pixel_count: moments.pixels as u32, ..Region::default() };
        (region, moments, runs)
    }

    #[test]
    fn squares_that_touch_come_apart() {
        for corners in [
            vec![(20, 20), (29, 20)],
            vec![(20, 20), (24, 29)],
            vec![(20, 20), (29, 20), (38, 20)],
            vec![(20, 20), (29, 20), (22, 29)],
            vec![(20, 20), (29, 20), (20, 29), (29, 29)],
        ] {
            let (region, whole, runs) = squares(&corners);
            let pieces = Splitter::default().split(&region, &whole, &runs, corners.len()).unwrap();
            for &(left, top) in &corners {
                let center = (f64::from(left) + 4.0, f64::from(top) + 4.0);
                let nearest = pieces[..corners.len()]
                    .iter()
                    .map(|piece| distance2(center, (piece.x_px, piece.y_px)).sqrt())
                    .fold(f64::INFINITY, f64::min);
                assert!(nearest < 1.0, "{corners:?}: {nearest} px from {center:?}");
            }
        }
    }

    #[test]
    fn work_is_bounded() {
        let (mut region, whole, runs) = squares(&[(20, 20), (29, 20)]);
        let mut splitter = Splitter::default();
        region.pixel_count = u32::MAX / 64;
        assert!(splitter.split(&region, &whole, &runs, 2).is_none());
        region.pixel_count = 162;
        let split = (0..100_000)
            .take_while(|_| splitter.split(&region, &whole, &runs, 2).is_some())
            .count();
        assert!(split < 100_000 && split > 100, "{split}");
        splitter.start_frame();
        assert!(splitter.split(&region, &whole, &runs, 2).is_some());
    }
}
