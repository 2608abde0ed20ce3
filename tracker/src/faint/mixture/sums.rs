//! Weighted sums over the samples around a robot: the normal equations of the [mixture](super).
//!
//! A search takes these sums at a hundred poses or more, and nearly all of its time. So the shares of eight
//! samples are read from the table row by row and transposed, and all sums run over the samples in arrays,
//! eight at a time. The order of additions does not depend on the machine.

use super::tables::{Table, WHOLE};
use super::{Blur, FLOOR, LANES, MOST_PLACES, Mixture, PARTS, PLACES, Parts, Samples};
use crate::raw::CHANNELS;
use fearless_simd::prelude::*;
use fearless_simd::{f32x8, u16x8};
use geometry::Pose;

/// Weight of a floor sample relative to one of the robot: lines and other robots may lie there.
const FLOOR_WEIGHT: f32 = 0.3;
/// Most sums that are taken together, so that all of them stay in registers.
const TOGETHER: usize = 8;
/// Most factors that a part's share is multiplied with: shares and levels.
const MOST_FACTORS: usize = PARTS + CHANNELS;

/// Weighted sums over all samples. Parts that the top lacks are left 0.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sums {
    /// Shares times shares; each pair of parts once, at the one that comes first in [`Mixture::parts`].
    pub products: [Parts; PARTS],
    /// Levels times shares.
    pub levels: [Parts; CHANNELS],
    /// Squares of the levels, all channels together.
    pub squares: f32,
}

/// A value of each sample, eight by eight.
type ByLanes = [[f32; LANES]];

impl Mixture {
    /// The parts that this top has: the patches, body and floor.
    pub(super) fn parts(&self) -> &[usize] {
        &self.parts[..self.patch_count + 2]
    }

    #[inline(always)]
    pub(super) fn sum_up<S: Simd>(
        &self,
        simd: S,
        samples: &mut Samples,
        pose: &Pose,
        blur: &Blur,
    ) -> Sums {
        let table = &self.tables[blur.sigma.min(self.tables.len() - 1)];
        let places = find_cells(table, samples, pose, blur);
        self.look_up(simd, table, samples, places);
        let floor_parts = 1.0 - FLOOR_WEIGHT;
        let groups = samples.count.div_ceil(LANES);
        let Samples { shares, weights, is_there, levels, squares, .. } = samples;
        let present = by_lanes(is_there, groups).iter().zip(by_lanes(&shares[FLOOR], groups));
        let of_lanes = weights.as_chunks_mut::<LANES>().0.iter_mut();
        for (weights, (there, floor)) in of_lanes.zip(present) {
            for lane in 0..LANES {
                weights[lane] = there[lane] * (1.0 - floor_parts * floor[lane]);
            }
        }
        let weights = by_lanes(weights, groups);
        let mut sums = Sums::default();
        let [squares] = add_up(simd, weights, None, [by_lanes(squares, groups)]);
        sums.squares = squares;
        // The shares of all parts, and the levels.
        let parts = self.parts();
        let mut factors = [weights; MOST_FACTORS];
        let values = parts.iter().map(|&part| &shares[part]).chain(levels.iter());
        let count = parts.len() + CHANNELS;
        for (factor, values) in factors.iter_mut().zip(values) {
            *factor = by_lanes(values, groups);
        }
        for (rank, &part) in parts.iter().enumerate() {
            // Each pair of parts once.
            let factors = &factors[rank..count];
            let products = products(simd, weights, factors[0], factors);
            for (&other, product) in parts[rank..].iter().zip(products) {
                sums.products[part][other] = product;
            }
            for (channel, levels) in sums.levels.iter_mut().enumerate() {
                levels[part] = products[parts.len() - rank + channel];
            }
        }
        sums
    }

    /// Fills the shares of each sample.
    #[inline(always)]
    fn look_up<S: Simd>(&self, simd: S, table: &Table, samples: &mut Samples, places: usize) {
        let Samples { cells, shares, count, .. } = samples;
        let (cells, scale) = (&cells[..places], 1.0 / (places as f32 * WHOLE));
        for begin in (0..*count).step_by(LANES) {
            let mut rows = [u16x8::splat(simd, 0); LANES];
            for cells in cells {
                for (row, &cell) in rows.iter_mut().zip(&cells[begin..begin + LANES]) {
                    *row += u16x8::simd_from(simd, table.cells[cell as usize]);
                }
            }
            let by_part = transposed(rows);
            for &part in self.parts() {
                let sums: [u16; LANES] = by_part[part].into();
                for (share, sum) in shares[part][begin..begin + LANES].iter_mut().zip(sums) {
                    *share = scale * f32::from(sum);
                }
            }
        }
    }
}

/// Finds the cell of each sample at each place along the motion; returns the number of places.
#[inline(always)]
fn find_cells(table: &Table, samples: &mut Samples, pose: &Pose, blur: &Blur) -> usize {
    let (sin, cos) = pose.orientation.sin_cos();
    let (sin, cos) = (sin as f32, cos as f32);
    let turned = |x: f32, y: f32| [cos * x + sin * y, cos * y - sin * x];
    let turned_center = turned(
        (pose.position.x_mm - samples.origin.x_mm) as f32,
        (pose.position.y_mm - samples.origin.y_mm) as f32,
    );
    let way = turned(blur.way_mm[0] as f32, blur.way_mm[1] as f32);
    let places = if blur.way_mm == [0.0; 2] { 0 } else { PLACES };
    let per_place = 1.0 / (2 * places + 1) as f32;
    let Samples { x_mm, y_mm, cells, count, .. } = samples;
    let whole = count.next_multiple_of(LANES);
    let grid = table.grid;
    for (place, cells) in (-places..=places).zip(cells.iter_mut()) {
        // Evenly spread over the way, half a step from its ends.
        let part = 2.0 * place as f32 * per_place;
        let offset = [part * way[0] - turned_center[0], part * way[1] - turned_center[1]];
        let points = x_mm[..whole].iter().zip(&y_mm[..whole]);
        for (cell, (&x, &y)) in cells[..whole].iter_mut().zip(points) {
            let [x, y] = turned(x, y);
            *cell = grid.cell_at(x + offset[0], y + offset[1]);
        }
    }
    (2 * places + 1) as usize
}
const _: () = assert!(2 * PLACES as usize + 1 == MOST_PLACES);

/// Swaps rows and columns. Taking the values of two rows in turns moves each value from row 4h + l, column j
/// to row 2l + ⌊j/4⌋, which rotates the six bits of its place; three times exchange row and column.
#[inline(always)]
fn transposed<S: Simd>(mut rows: [u16x8<S>; LANES]) -> [u16x8<S>; LANES] {
    for _ in 0..3 {
        let [a, b, c, d, e, f, g, h] = rows;
        rows = [
            a.zip_low(e),
            a.zip_high(e),
            b.zip_low(f),
            b.zip_high(f),
            c.zip_low(g),
            c.zip_high(g),
            d.zip_low(h),
            d.zip_high(h),
        ];
    }
    rows
}

#[inline(always)]
fn by_lanes(values: &[f32], groups: usize) -> &ByLanes {
    &values.as_chunks().0[..groups]
}

/// Σ weight · own · factor for each factor.
#[inline(always)]
fn products<S: Simd>(
    simd: S,
    weights: &ByLanes,
    own: &ByLanes,
    factors: &[&ByLanes],
) -> [f32; MOST_FACTORS] {
    let mut sums = [0.0; MOST_FACTORS];
    for (sums, factors) in sums.chunks_mut(TOGETHER).zip(factors.chunks(TOGETHER)) {
        macro_rules! together {
            ($($count:literal)*) => {
                match factors.len() {
                    $($count => {
                        let mut those = [own; $count];
                        those.copy_from_slice(factors);
                        sums[..$count].copy_from_slice(&add_up(simd, weights, Some(own), those));
                    })*
                    _ => {}
                }
            };
        }
        together!(1 2 3 4 5 6 7 8);
    }
    sums
}

/// Σ weight · factor, or Σ weight · own · factor, for each factor.
#[inline(always)]
fn add_up<S: Simd, const COUNT: usize>(
    simd: S,
    weights: &ByLanes,
    own: Option<&ByLanes>,
    factors: [&ByLanes; COUNT],
) -> [f32; COUNT] {
    let mut sums = [f32x8::splat(simd, 0.0); COUNT];
    for (group, weight) in weights.iter().enumerate() {
        let mut weight = f32x8::simd_from(simd, *weight);
        if let Some(own) = own {
            weight *= f32x8::simd_from(simd, own[group]);
        }
        for (sum, factor) in sums.iter_mut().zip(&factors) {
            *sum += weight * f32x8::simd_from(simd, factor[group]);
        }
    }
    let mut totals = [0.0; COUNT];
    for (total, sum) in totals.iter_mut().zip(sums) {
        let [a, b, c, d, e, f, g, h]: [f32; LANES] = sum.into();
        *total = ((a + e) + (c + g)) + ((b + f) + (d + h));
    }
    totals
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Pattern;
    use config::Preset;
    use fearless_simd::{Level, dispatch};
    use geometry::FieldPoint;
    use proptest::prelude::*;
    use std::sync::LazyLock;

    /// Tops with three and with five patches.
    static MIXTURES: LazyLock<[Mixture; 2]> = LazyLock::new(|| {
        [Preset::MirosotLarge, Preset::SslDivisionB].map(|preset| {
            let config = preset.config();
            let pattern = Pattern::new(&config).unwrap();
            Mixture::new(&config.robots.patches, &pattern.tops[0], pattern.size_mm)
        })
    });

    /// The sums, one sample after the other, in double precision.
    fn plain(mixture: &Mixture, samples: &Samples, pose: &Pose, blur: &Blur) -> [Vec<f64>; 3] {
        let table = &mixture.tables[blur.sigma];
        let places = if blur.way_mm == [0.0; 2] { 0 } else { PLACES };
        let parts = mixture.parts();
        let mut sums = [vec![0.0; PARTS * PARTS], vec![0.0; PARTS * CHANNELS], vec![0.0]];
        for index in 0..samples.count {
            let mut shares = [0.0; PARTS];
            for place in -places..=places {
                let part = 2.0 * f64::from(place) / f64::from(2 * places + 1);
                let [x, y] = [
                    f64::from(samples.x_mm[index]) + part * blur.way_mm[0],
                    f64::from(samples.y_mm[index]) + part * blur.way_mm[1],
                ];
                let point = FieldPoint::new(samples.origin.x_mm + x, samples.origin.y_mm + y);
                let [x, y] = crate::pose::robot_from_field(pose, point);
                let cell = &table.cells[table.grid.cell_at(x as f32, y as f32) as usize];
                for (share, &part) in shares.iter_mut().zip(cell) {
                    *share += f64::from(part) / f64::from(WHOLE) / f64::from(2 * places + 1);
                }
            }
            let weight = 1.0 - f64::from(1.0 - FLOOR_WEIGHT) * shares[FLOOR];
            for (rank, &part) in parts.iter().enumerate() {
                for &other in &parts[rank..] {
                    sums[0][part * PARTS + other] += weight * shares[part] * shares[other];
                }
                for channel in 0..CHANNELS {
                    let level = f64::from(samples.levels[channel][index]);
                    sums[1][channel * PARTS + part] += weight * level * shares[part];
                }
            }
            let levels = samples.levels.iter().map(|levels| f64::from(levels[index]));
            sums[2][0] += weight * levels.map(|level| level * level).sum::<f64>();
        }
        sums
    }

    proptest! {
        /// All machines get the same, and about what a plain loop over the samples gets.
        #[test]
        fn all_machines_get_the_same(
            points in prop::collection::vec(
                (-80.0..80.0f32, -80.0..80.0f32, prop::array::uniform3(0.0..255.0f32)),
                0..300,
            ),
            place in prop::array::uniform2(-30.0..30.0f64),
            orientation in -3.0..3.0f64,
            sigma in 0..Mixture::SIGMA_COUNT,
            way_mm in prop::sample::select(vec![[0.0, 0.0], [13.0, -4.0], [0.0, 25.0]]),
            mixture in 0..MIXTURES.len(),
        ) {
            let mut mixture = MIXTURES[mixture].clone();
            let mut samples = Box::new(Samples::default());
            samples.origin = FieldPoint::new(310.0, -200.0);
            for (index, (x, y, levels)) in points.into_iter().enumerate() {
                (samples.x_mm[index], samples.y_mm[index]) = (x, y);
                for (all, level) in samples.levels.iter_mut().zip(levels) {
                    all[index] = level;
                }
                samples.count = index + 1;
            }
            samples.finish();
            let position = FieldPoint::new(310.0 + place[0], -200.0 + place[1]);
            let (pose, blur) = (Pose { position, orientation }, Blur { sigma, way_mm });
            let mut all = [Level::new(), Level::baseline()].map(|level| {
                mixture.level = level;
                dispatch!(level, simd => mixture.sum_up(simd, &mut samples, &pose, &blur))
            });
            let flat = |sums: &Sums| -> [Vec<f32>; 3] {
                [sums.products.concat(), sums.levels.concat(), vec![sums.squares]]
            };
            let [sums, others] = all.each_mut().map(|sums| flat(sums));
            prop_assert_eq!(&sums, &others);
            // Rounding puts a sample or two into the next cell of the table.
            let slack = 0.5 + 1e-3 * samples.count as f64;
            let expected = plain(&mixture, &samples, &pose, &blur);
            for ((sums, expected), scale) in sums.iter().zip(&expected).zip([1.0, 255.0, 2e5]) {
                for (sum, expected) in sums.iter().zip(expected) {
                    prop_assert!((f64::from(*sum) - expected).abs() < scale * slack);
                }
            }
        }
    }
}
