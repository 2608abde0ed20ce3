//! Limits on boxes where no background bounds them.

use super::bounds::Bounds;
use super::points::Point;

/// Part of a colour's samples at either end that is ignored as chance.
const OUTLIER_PART: f64 = 0.01;
/// Darkest and brightest light relative to that of the samples.
const LIGHTS: [f64; 2] = [0.4, 1.6];

/// Closes a box around a colour's samples: each channel from the darkest sample in the darkest light to the
/// brightest one in the brightest light, plus twice `margin` grey levels on either side. A bound that no
/// background has moved would otherwise stay open, and unseen floors would pass.
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
        let [low, high] =
            [OUTLIER_PART, 1.0 - OUTLIER_PART].map(|part| super::quantile(&mut values, part));
        let [low, high] = [low * LIGHTS[0] - 2.0 * margin, high * LIGHTS[1] + 2.0 * margin];
        let [before_low, before_high] = bounds.bins[channel];
        let closed = [before_low.max(low.max(0.0) as u8), before_high.min(high.min(255.0) as u8)];
        if closed[0] <= closed[1] {
            bounds.bins[channel] = closed;
        }
    }
}
