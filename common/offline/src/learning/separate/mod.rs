//! From samples to bounds: boxes in red, green and blue, and sectors in hue and saturation, that contain one
//! colour each, exclude the others and the background, and have the widest margins.
//!
//! The bounds maximise the weighted number of correctly classified samples by coordinate ascent. A pixel's
//! class is the first colour all of whose ten bounds it meets, so the score of every position of one bound
//! can be computed exactly while all others stay: moving it gives the pixels it passes to this colour, or to
//! the next one that admits them. [`learn`] takes one bound after the other, sums the gains of all samples by
//! position, convolves them with a two-sided exponential as wide as colours wander, which puts a bound
//! between two well separated colours into the middle of the gap, where the tails are equal, and moves the
//! bound to the best position. This is repeated a fixed number of rounds. Samples are weighted by patch, not
//! by pixel, and patches with a low recall weigh more in the next round, similar to boosting: of twenty well
//! lit patches and a dark one, the dark one needs the bound.
//!
//! In a match, the box in red, green and blue is tested first, for every pixel of a frame; hue and saturation
//! of the pixels it passes take much longer. So background inside a colour's box has a cost even where hue or
//! saturation exclude it. Finally each box is closed around the samples in any light.

mod best_bound;
mod bounds;
mod closing;
mod points;
#[cfg(test)]
mod tests;

use crate::learning::samples::Samples;
use best_bound::best_bound;
use bounds::{AXES, BINS, BOX, Bounds, FailedBounds, HUE, SATURATION, Side, bit};
use config::ColorConfig;
use points::Point;

/// Weights of the learning objective.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Objective {
    /// Variation of red, green and blue beyond the samples, grey levels.
    pub spread: f64,
    /// Variation of hue, degrees.
    pub hue_spread_deg: f64,
    /// Variation of saturation.
    pub saturation_spread: f64,
    /// Cost of all background pixels of a picture classified as a colour, where all samples of a colour weigh
    /// 1.
    pub background_weight: f64,
    /// Cost of all background pixels of a picture that are in a colour's box and excluded by hue or
    /// saturation only.
    pub second_look_weight: f64,
    /// Cost of all rim pixels classified as a colour that is not beside them.
    pub rim_weight: f64,
    /// Brightness factors that samples may have elsewhere on the pitch, each with its weight, where seen
    /// samples weigh 1.
    pub other_lights: [(f64, f64); 3],
}

impl Default for Objective {
    fn default() -> Self {
        Self {
            spread: 6.0,
            hue_spread_deg: 5.0,
            saturation_spread: 0.03,
            background_weight: 5.0,
            second_look_weight: 0.1,
            rim_weight: 2.0,
            other_lights: [(0.5, 0.1), (0.75, 0.2), (1.25, 0.2)],
        }
    }
}

const ROUNDS: u32 = 8;

/// Learns bounds for the colours in `samples`, and returns them in the order of evaluation: most saturated
/// first. Colours without samples are left out. The classes of samples are indices into `colors`.
pub fn learn(colors: &[ColorConfig], samples: &Samples, objective: &Objective) -> Vec<ColorConfig> {
    let mut learner = Learner::new(colors.len(), samples, objective);
    for round in 0..ROUNDS {
        learner.improve(round);
    }
    learner.close_boxes();
    let learned = learner.order.iter().filter_map(|&class| {
        let bounds = learner.bounds[class]?;
        Some(bounds.color(&colors[class], display_color(samples, class as u8)))
    });
    learned.collect()
}

/// Display colour: the median of each channel.
fn display_color(samples: &Samples, class: u8) -> [u8; 3] {
    [0, 1, 2].map(|channel: usize| {
        let own = samples.pixels.iter().filter(|sample| sample.class == class);
        let mut values: Vec<f64> = own.map(|sample| f64::from(sample.rgb[channel])).collect();
        quantile(&mut values, 0.5) as u8
    })
}

struct Learner<'a> {
    objective: &'a Objective,
    points: Vec<Point>,
    /// For each point, a bit set of the colours that admit it: bit i for position i of the order.
    admitted: Vec<u32>,
    patch_count: usize,
    /// Indexed by class; `None` without samples.
    bounds: Vec<Option<Bounds>>,
    /// Classes with samples, in the order of evaluation.
    order: Vec<usize>,
    /// Cost of a background pixel that is classified as a colour, and of one that is in a box.
    background_costs: [f32; 2],
}

/// A point whose score depends on whether a colour admits it, in that colour's bins.
struct Candidate {
    bins: [Option<u8>; AXES],
    fails: FailedBounds,
    /// Gained when the colour admits it.
    gain: f32,
    /// Lost when the colour's box holds it and the colour does not admit it.
    box_cost: f32,
}

impl<'a> Learner<'a> {
    fn new(classes: usize, samples: &Samples, objective: &'a Objective) -> Self {
        let points = points::points(samples, objective);
        let of_class = |class: usize| -> Vec<&Point> {
            let is_own = |point: &&Point| point.class == Some(class as u8) && !point.is_derived;
            points.iter().filter(is_own).collect()
        };
        let bounds: Vec<Option<Bounds>> = (0..classes)
            .map(|class| {
                let own = of_class(class);
                (!own.is_empty()).then(|| Bounds::around(&own))
            })
            .collect();
        let saturations: Vec<f64> = (0..classes)
            .map(|class| {
                let own = of_class(class);
                let mut own: Vec<f64> = own.iter().map(|point| point.saturation.into()).collect();
                quantile(&mut own, 0.5)
            })
            .collect();
        let mut order: Vec<usize> = (0..classes).filter(|&class| bounds[class].is_some()).collect();
        order.sort_by(|&a, &b| saturations[b].total_cmp(&saturations[a]));
        let background = points.iter().filter(|point| point.is_background());
        let background = background.map(|point| f64::from(point.pixels)).sum::<f64>().max(1.0);
        let costs = [objective.background_weight, objective.second_look_weight];
        let mut learner = Self {
            objective,
            admitted: vec![0; points.len()],
            points,
            patch_count: samples.patches as usize,
            bounds,
            order,
            background_costs: costs.map(|cost| (cost / background) as f32),
        };
        (0..learner.order.len()).for_each(|position| learner.admit(position));
        learner
    }

    /// Moves every bound twice, with new weights.
    fn improve(&mut self, round: u32) {
        self.reweight(round);
        for position in 0..self.order.len() {
            let class = self.order[position];
            let Some(mut bounds) = self.bounds[class] else { continue };
            let mut candidates = self.candidates(position, &bounds);
            for _ in 0..2 {
                for axis in 0..AXES {
                    for side in [Side::Low, Side::High] {
                        self.move_bound(&mut bounds, axis, side, &mut candidates);
                    }
                }
            }
            self.bounds[class] = Some(bounds);
            self.admit(position);
        }
    }

    /// Updates the points that the colour at a position of the order admits.
    fn admit(&mut self, position: usize) {
        let Some(bounds) = self.bounds[self.order[position]] else { return };
        for (point, admitted) in self.points.iter().zip(&mut self.admitted) {
            let is_admitted = u32::from(bounds.fails(point) == 0);
            *admitted = *admitted & !(1 << position) | is_admitted << position;
        }
    }

    /// Sets the points' weights: 1 for each class, shared among its patches by how badly they are recognised.
    /// The background fades in over the first rounds, since a colour with too wide initial bounds must
    /// shrink, not vanish.
    fn reweight(&mut self, round: u32) {
        let (mut pixels, mut right) = (vec![0.0; self.patch_count], vec![0.0; self.patch_count]);
        let mut patches_of_class = vec![0.0; self.bounds.len()];
        for (point, &admitted) in self.points.iter().zip(&self.admitted) {
            let Some(class) = point.class.filter(|_| !point.is_derived) else { continue };
            let patch = point.patch as usize;
            if pixels[patch] == 0.0 {
                patches_of_class[usize::from(class)] += 1.0;
            }
            pixels[patch] += 1.0;
            if self.first(admitted) == Some(class) {
                right[patch] += 1.0;
            }
        }
        let fade_in = (0.05 * 2f32.powi(round as i32)).min(1.0);
        for point in &mut self.points {
            let patch = point.patch as usize;
            point.weight = match point.class {
                Some(class) => {
                    let share = if round == 0 {
                        1.0f32
                    } else {
                        (1.6f32 - right[patch] / pixels[patch]).powi(2)
                    };
                    point.pixels * share / pixels[patch] / patches_of_class[usize::from(class)]
                }
                None if point.is_derived => point.pixels,
                None => point.pixels * self.background_costs[0] * fade_in,
            };
        }
    }

    /// The class at the lowest position in a bit set of positions.
    fn first(&self, places: u32) -> Option<u8> {
        self.order.get(places.trailing_zeros() as usize).map(|&class| class as u8)
    }

    /// The points whose score depends on the colour at a position of the order. Points that an earlier colour
    /// admits depend on it only by their cost in its box.
    fn candidates(&self, position: usize, bounds: &Bounds) -> Vec<Candidate> {
        let class = self.order[position] as u8;
        let mut candidates = Vec::new();
        for (point, &admitted) in self.points.iter().zip(&self.admitted) {
            let gain = match admitted & ((1 << position) - 1) {
                0 => {
                    let behind = (u64::from(admitted) >> (position + 1) << (position + 1)) as u32;
                    point.value(Some(class)) - point.value(self.first(behind))
                }
                _ => 0.0,
            };
            let box_cost = match point.is_background() {
                true => point.pixels * self.background_costs[1],
                false => 0.0,
            };
            if gain != 0.0 || box_cost != 0.0 {
                let bins = std::array::from_fn(|axis| bounds.bin(point, axis));
                candidates.push(Candidate { bins, fails: bounds.fails(point), gain, box_cost });
            }
        }
        candidates
    }

    /// Moves one bound of a colour to the best position, with all others fixed.
    fn move_bound(
        &self,
        bounds: &mut Bounds,
        axis: usize,
        side: Side,
        candidates: &mut [Candidate],
    ) {
        let spread_bins = match axis {
            HUE => self.objective.hue_spread_deg / 360.0,
            SATURATION => self.objective.saturation_spread,
            _ => self.objective.spread / BINS as f64,
        } * BINS as f64;
        let own = bit(axis, side);
        let is_of_box = own & BOX != 0;
        let mut gain_at = [0.0; BINS];
        for candidate in candidates.iter() {
            let fails = candidate.fails & !own;
            // Grey has no hue.
            let Some(bin) = candidate.bins[axis] else { continue };
            if fails == 0 {
                gain_at[usize::from(bin)] += f64::from(candidate.gain);
            } else if is_of_box && fails & BOX == 0 {
                gain_at[usize::from(bin)] -= f64::from(candidate.box_cost);
            }
        }
        let best = best_bound(&gain_at, spread_bins, side);
        let [low, high] = bounds.bins[axis];
        bounds.bins[axis] = match side {
            Side::Low => [best.min(high), high],
            Side::High => [low, best.max(low)],
        };
        let both = bit(axis, Side::Low) | bit(axis, Side::High);
        for candidate in candidates {
            candidate.fails = candidate.fails & !both | bounds.fails_on(axis, candidate.bins[axis]);
        }
    }

    /// Closes every box around its samples in any light.
    fn close_boxes(&mut self) {
        for class in self.order.iter().copied() {
            let Some(bounds) = &mut self.bounds[class] else { continue };
            let is_own = |point: &&Point| point.class == Some(class as u8) && !point.is_derived;
            let own = self.points.iter().filter(is_own);
            closing::close(bounds, own, self.objective.spread);
        }
    }
}

/// The quantile at `part`. Sorts the values.
fn quantile(values: &mut [f64], part: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let index = (part * values.len() as f64) as usize;
    values.get(index.min(values.len().saturating_sub(1))).copied().unwrap_or(0.0)
}
