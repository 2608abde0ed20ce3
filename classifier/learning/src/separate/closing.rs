//! No box is wider than a colour's samples are in any light.

use super::bounds::Bounds;
use super::points::Point;

/// The part of a colour's samples at either end that may be chance.
const CHANCE: f64 = 0.01;
/// How much darker and brighter than its samples a colour may become.
const LIGHTS: [f64; 2] = [0.4, 1.6];

/// Closes a box around a colour's samples: in each channel from the darkest of them in the darkest
/// light to the brightest of them in the brightest light, and twice `margin` grey levels beyond.
/// Where no background was there to move a bound, it would otherwise stay open, and floors that no
/// picture has shown would pass.
pub(super) fn close<'a>(
    bounds: &mut Bounds,
    own: impl Iterator<Item = &'a Point> + Clone,
    margin: f64,
) {
    for channel in 0..3 {
        let mut values: Vec<f64> = own.clone().map(|point| point.rgb[channel].into()).collect();
        if values.is_empty() {
            return;
        }
        let [low, high] = [CHANCE, 1.0 - CHANCE].map(|part| super::quantile(&mut values, part));
        let [low, high] = [low * LIGHTS[0] - 2.0 * margin, high * LIGHTS[1] + 2.0 * margin];
        let [before_low, before_high] = bounds.bins[channel];
        let closed = [before_low.max(low.max(0.0) as u8), before_high.min(high.min(255.0) as u8)];
        if closed[0] <= closed[1] {
            bounds.bins[channel] = closed;
        }
    }
}
