//! From samples to bounds: boxes in red, green and blue, and sectors in hue and saturation, that
//! hold one colour each, leave out the others and the background, and have the widest margins.
//!
//! A pixel's class is that of the first colour all of whose ten bounds it meets, so what a bound is
//! worth can be told for every value it could have: moving it gives the pixels it passes to this
//! colour, or to whatever comes behind it. [`learn`] takes one bound after the other, adds up what
//! each sample would gain, smooths that over the distance by which colours wander (so that a bound
//! between two well separated colours ends up in the middle of the gap, where the two tails are
//! equal), and moves the bound to the best place; again and again, until nothing changes much
//! (coordinate ascent). Samples count by patch, not by pixel, and patches that are not recognised
//! well count more in the next round: of twenty well lit patches and a dark one, it is the dark one
//! that needs the bound.
//!
//! The box in red, green and blue is what the classifier asks first, of every pixel of a frame, and
//! hue and saturation of what it lets pass take much longer. So background inside a colour's box
//! costs something even where hue or saturation turn it away. In the end each box is closed around
//! the samples in any light.

mod best_bound;
mod bounds;
mod closing;
mod points;
#[cfg(test)]
mod tests;

use crate::samples::Samples;
use best_bound::best_bound;
use bounds::{AXES, BINS, BOX, Bounds, Fails, HUE, SATURATION, Side, bit};
use common::config::ColorConfig;
use points::Point;

/// Weights of the learning objective.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wishes {
    /// How far red, green and blue of a colour may wander beyond its samples, in grey levels …
    pub spread: f64,
    /// … its hue, in degrees …
    pub hue_spread_deg: f64,
    /// … and its saturation.
    pub saturation_spread: f64,
    /// What all pixels of a picture's background count against all samples of a colour, if they
    /// were taken for a colour.
    pub background_weight: f64,
    /// The same if they were in a colour's box, and only hue or saturation turned them away.
    pub second_look_weight: f64,
    /// What all pixels at the rims of patches count, if they were taken for a colour that is not
    /// beside them.
    pub rim_weight: f64,
    /// Elsewhere on the pitch samples may be so many times as bright; and what each counts then,
    /// against 1 for what was seen.
    pub other_lights: [(f64, f64); 3],
}

impl Default for Wishes {
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

/// Learns bounds for the colours that `samples` show, and returns them in the order in which they
/// are to be looked at: most saturated first. Those that are not shown are left out. Samples name
/// colours by their place in `colors`.
pub fn learn(colors: &[ColorConfig], samples: &Samples, wishes: &Wishes) -> Vec<ColorConfig> {
    let mut learner = Learner::new(colors.len(), samples, wishes);
    for round in 0..ROUNDS {
        learner.improve(round);
    }
    learner.close_boxes();
    let learned = learner.order.iter().filter_map(|&class| {
        let bounds = learner.bounds[class]?;
        Some(bounds.color(&colors[class], looks(samples, class as u8)))
    });
    learned.collect()
}

/// What a colour looks like: the median of each channel.
fn looks(samples: &Samples, class: u8) -> [u8; 3] {
    [0, 1, 2].map(|channel: usize| {
        let own = samples.pixels.iter().filter(|sample| sample.class == class);
        let mut values: Vec<f64> = own.map(|sample| f64::from(sample.rgb[channel])).collect();
        quantile(&mut values, 0.5) as u8
    })
}

struct Learner<'a> {
    wishes: &'a Wishes,
    points: Vec<Point>,
    /// For each point the colours that admit it: bit i for the colour at place i of the order.
    admitted: Vec<u32>,
    patch_count: usize,
    /// Indexed by class; `None` without samples.
    bounds: Vec<Option<Bounds>>,
    /// Classes with samples, in the order in which they are looked at.
    order: Vec<usize>,
    /// What a pixel of the background costs that is taken for a colour, and that is in a box.
    background_costs: [f32; 2],
}

/// A point for which it matters whether a colour takes it, as that colour's bounds see it.
struct Candidate {
    bins: [Option<u8>; AXES],
    fails: Fails,
    /// Gained when the colour takes it.
    gain: f32,
    /// Lost when the colour's box holds it and the colour does not take it.
    box_cost: f32,
}

impl<'a> Learner<'a> {
    fn new(classes: usize, samples: &Samples, wishes: &'a Wishes) -> Self {
        let points = points::points(samples, wishes);
        let of_class = |class: usize| -> Vec<&Point> {
            let is_own = |point: &&Point| point.class == Some(class as u8) && !point.is_imagined;
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
        let costs = [wishes.background_weight, wishes.second_look_weight];
        let mut learner = Self {
            wishes,
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

    /// Moves every bound once or twice.
    fn improve(&mut self, round: u32) {
        self.weigh(round);
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

    /// Notes which points the colour at a place of the order admits.
    fn admit(&mut self, position: usize) {
        let Some(bounds) = self.bounds[self.order[position]] else { return };
        for (point, admitted) in self.points.iter().zip(&mut self.admitted) {
            let is_admitted = u32::from(bounds.fails(point) == 0);
            *admitted = *admitted & !(1 << position) | is_admitted << position;
        }
    }

    /// Sets the points' weights: each class 1 in all, shared among its patches by how badly they
    /// are recognised; the background little at first, since a colour that begins with too wide
    /// bounds must shrink, not vanish.
    fn weigh(&mut self, round: u32) {
        let (mut pixels, mut right) = (vec![0.0; self.patch_count], vec![0.0; self.patch_count]);
        let mut patches_of_class = vec![0.0; self.bounds.len()];
        for (point, &admitted) in self.points.iter().zip(&self.admitted) {
            let Some(class) = point.class.filter(|_| !point.is_imagined) else { continue };
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
                None if point.is_imagined => point.pixels,
                None => point.pixels * self.background_costs[0] * fade_in,
            };
        }
    }

    /// The class of the first of some places of the order.
    fn first(&self, places: u32) -> Option<u8> {
        self.order.get(places.trailing_zeros() as usize).map(|&class| class as u8)
    }

    /// The points for which it matters whether the colour at a place of the order takes them; what an
    /// earlier one has, this one cannot get.
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

    /// Moves one bound of a colour to where most is gained, all others staying where they are.
    fn move_bound(
        &self,
        bounds: &mut Bounds,
        axis: usize,
        side: Side,
        candidates: &mut [Candidate],
    ) {
        let spread_bins = match axis {
            HUE => self.wishes.hue_spread_deg / 360.0,
            SATURATION => self.wishes.saturation_spread,
            _ => self.wishes.spread / BINS as f64,
        } * BINS as f64;
        let own = bit(axis, side);
        let is_of_box = own & BOX != 0;
        let mut gain_at = [0.0; BINS];
        for candidate in candidates.iter() {
            let fails = candidate.fails & !own;
            // Grey has no place among hues.
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
            let is_own = |point: &&Point| point.class == Some(class as u8) && !point.is_imagined;
            let own = self.points.iter().filter(is_own);
            closing::close(bounds, own, self.wishes.spread);
        }
    }
}

/// The value below which a part of them lies. Sorts them.
fn quantile(values: &mut [f64], part: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let index = (part * values.len() as f64) as usize;
    values.get(index.min(values.len().saturating_sub(1))).copied().unwrap_or(0.0)
}
