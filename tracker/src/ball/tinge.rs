//! Tinge: extends the region of a ball's colour to the whole ball, by pixels of the same hue.
//!
//! Light from one side leaves the other side of a ball too dark for its colour's bounds, and a rim that faces
//! the floor is darker than its middle. Less light takes the same part from each channel, so the hue stays.
//! With t the tinge of a pixel (its colour less its grey, less the median tinge around) and T the mean tinge
//! of the ball's region,
//!
//! s = t·T / T²,   r = |t − s·T|,
//!
//! s is the part of the ball's light in the pixel and r its light of another hue. Floor, lines, walls and
//! robots' bodies have s ≈ 0 at any brightness; other patches have a large r. The ball is the pixels with s
//! above [`MIN_SHARE`] and r below [`OTHER_HUE`]·s·|T| that are connected with its region.

use super::silhouette::Silhouette;
use crate::raw::{CHANNELS, RawFrame};
use geometry::ImagePoint;
use messages::Run;

/// Least part of the ball's light in a pixel of the ball, and least tinge in grey levels (noise).
const MIN_SHARE: f32 = 0.12;
const MIN_TINGE: f32 = 8.0;
/// Most light of another hue, as a fraction of the ball's light in the pixel.
const OTHER_HUE: f32 = 0.4;
/// Largest side of the window, in pixels.
const MOST_SIDE: usize = 96;

type Color = [f32; CHANNELS];

/// Extends silhouettes, reusing its memory.
#[derive(Debug, Clone, Default)]
pub(crate) struct Tinge {
    tinges: Vec<Color>,
    sorted: Vec<f32>,
    is_ball: Vec<bool>,
    ahead: Vec<usize>,
    runs: Vec<Run>,
}

impl Tinge {
    /// Extends `silhouette`, which is that of a ball's region, to the rest of the ball within `reach_px` of
    /// `middle`. Returns `false` and changes nothing if the picture has no colours there or the ball no
    /// tinge.
    pub fn complete(
        &mut self,
        frame: &RawFrame,
        middle: ImagePoint,
        reach_px: f64,
        silhouette: &mut Silhouette,
    ) -> bool {
        // The conversion to usize saturates negative numbers at 0. Every pixel needs neighbours on all sides.
        let span = |middle: f64, limit: usize| {
            let first = ((middle - reach_px) as usize).max(1);
            first..((middle + reach_px) as usize + 1).min(limit.saturating_sub(1)).max(first)
        };
        let (columns, rows) = (span(middle.x_px, frame.width), span(middle.y_px, frame.height));
        let width = columns.len();
        if width == 0 || width > MOST_SIDE || rows.len() > MOST_SIDE {
            return false;
        }
        self.tinges.clear();
        for row in rows.clone() {
            for column in columns.clone() {
                let Some(tinge) = tinge_at(frame, row, column) else { return false };
                self.tinges.push(tinge);
            }
        }
        let is_seed = |index: usize| {
            silhouette.covers(rows.start + index / width, columns.start + index % width)
        };
        let Some(ball) = self.mean_of(is_seed) else { return false };
        let around = self.median_of(|index| !is_seed(index));
        let own: Color = std::array::from_fn(|channel| ball[channel] - around[channel]);
        let square = dot(&own, &own);
        let least = MIN_SHARE.max(MIN_TINGE / square.sqrt());
        if least.is_nan() || least >= 0.5 {
            return false;
        }
        self.is_ball.clear();
        self.ahead.clear();
        for (index, tinge) in self.tinges.iter().enumerate() {
            let off: Color = std::array::from_fn(|channel| tinge[channel] - around[channel]);
            let share = dot(&off, &own) / square;
            let other = (dot(&off, &off) - share * share * square).max(0.0).sqrt();
            let is_ball =
                share > least && other < OTHER_HUE * share * square.sqrt() + MIN_TINGE / 2.0;
            self.is_ball.push(is_ball || is_seed(index));
            if is_seed(index) {
                self.ahead.push(index);
            }
        }
        self.keep_connected(width);
        self.runs.clear();
        for (row, line) in rows.zip(self.is_ball.chunks_exact(width)) {
            let mut begin = columns.start;
            for stretch in line.chunk_by(|a, b| a == b) {
                let end = begin + stretch.len();
                if stretch[0] {
                    let [row, begin, end] = [row, begin, end].map(|place| place as u16);
                    self.runs.push(Run { row, begin, end, class: 0, reserved: 0 });
                }
                begin = end;
            }
        }
        silhouette.trace(&self.runs);
        true
    }

    fn mean_of(&self, is_part: impl Fn(usize) -> bool) -> Option<Color> {
        let (mut sum, mut count) = ([0.0; CHANNELS], 0.0);
        for (index, tinge) in self.tinges.iter().enumerate() {
            if is_part(index) {
                sum.iter_mut().zip(tinge).for_each(|(sum, value)| *sum += value);
                count += 1.0;
            }
        }
        (count > 0.0).then(|| sum.map(|sum| sum / count))
    }

    fn median_of(&mut self, is_part: impl Fn(usize) -> bool) -> Color {
        std::array::from_fn(|channel| {
            self.sorted.clear();
            let part = self.tinges.iter().enumerate().filter(|(index, _)| is_part(*index));
            self.sorted.extend(part.map(|(_, tinge)| tinge[channel]));
            match self.sorted.len() {
                0 => 0.0,
                count => *self.sorted.select_nth_unstable_by(count / 2, f32::total_cmp).1,
            }
        })
    }

    /// Keeps only pixels that are 4-connected with those of the list `ahead` (flood fill).
    fn keep_connected(&mut self, width: usize) {
        const REACHED: f32 = f32::INFINITY;
        for &index in &self.ahead {
            self.tinges[index][0] = REACHED;
        }
        while let Some(index) = self.ahead.pop() {
            let column = index % width;
            let neighbours = [
                (column > 0).then(|| index - 1),
                (column + 1 < width).then(|| index + 1),
                index.checked_sub(width),
                (index + width < self.is_ball.len()).then(|| index + width),
            ];
            for next in neighbours.into_iter().flatten() {
                if self.is_ball[next] && self.tinges[next][0] != REACHED {
                    self.tinges[next][0] = REACHED;
                    self.ahead.push(next);
                }
            }
        }
        for (is_ball, tinge) in self.is_ball.iter_mut().zip(&self.tinges) {
            *is_ball = tinge[0] == REACHED;
        }
    }
}

/// The colour of a pixel less its grey. In a mosaic each channel is a weighted mean of its samples among the
/// nine pixels around.
fn tinge_at(frame: &RawFrame, row: usize, column: usize) -> Option<Color> {
    let mut color = [0.0; CHANNELS];
    if frame.samples_per_pixel == CHANNELS {
        for index in 0..CHANNELS {
            let (channel, value) = frame.sample(row, column, index);
            color[channel] = value;
        }
    } else {
        let mut weights = [0.0; CHANNELS];
        for (y, beside_y) in [(row - 1, 1.0), (row, 2.0), (row + 1, 1.0)] {
            for (x, beside_x) in [(column - 1, 1.0), (column, 2.0), (column + 1, 1.0)] {
                let (channel, value) = frame.sample(y, x, 0);
                color[channel] += beside_x * beside_y * value;
                weights[channel] += beside_x * beside_y;
            }
        }
        for (color, weight) in color.iter_mut().zip(weights) {
            if weight == 0.0 {
                return None;
            }
            *color /= weight;
        }
    }
    let grey = color.iter().sum::<f32>() / CHANNELS as f32;
    Some(color.map(|value| value - grey))
}

fn dot(a: &Color, b: &Color) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
