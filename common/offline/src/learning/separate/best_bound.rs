//! Optimum of a single bound.

use super::bounds::{BINS, Side};

/// The bin at which a bound gains most, where everything beyond it is left out and every gain is spread
/// around its place with exponential tails.
pub(super) fn best_bound(gain_at: &[f64; BINS], spread_bins: f64, side: Side) -> u8 {
    // A causal and an anticausal exponential make a two-sided one: two passes instead of a kernel.
    let keep = (-1.0 / spread_bins.max(1e-3)).exp();
    let mut smooth = [0.0; BINS];
    let mut carried = 0.0;
    for bin in 0..BINS {
        carried = carried * keep + gain_at[bin];
        smooth[bin] += carried;
    }
    carried = 0.0;
    for bin in (0..BINS).rev() {
        smooth[bin] += carried;
        carried = (carried + gain_at[bin]) * keep;
    }
    // Weight spread beyond the last bin stays in it.
    let tail = keep / (1.0 - keep);
    smooth[0] += gain_at.iter().rev().fold(0.0, |sum, gain| sum * keep + gain) * tail;
    smooth[BINS - 1] += gain_at.iter().fold(0.0, |sum, gain| sum * keep + gain) * tail;

    let (mut sum, mut best, mut best_sum) = (0.0, side.end(), f64::NEG_INFINITY);
    // Starts at the end that admits nothing.
    for step in 0..=u8::MAX {
        let bin = match side {
            Side::Low => u8::MAX - step,
            Side::High => step,
        };
        sum += smooth[usize::from(bin)];
        // Among equal scores (up to rounding) the widest wins.
        if sum > best_sum - 1e-9 {
            (best, best_sum) = (bin, best_sum.max(sum));
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bound_lies_where_two_tails_are_equal() {
        let mut gains = [0.0; BINS];
        gains[100] = 1.0;
        gains[140] = -1.0;
        let bound = best_bound(&gains, 6.0, Side::High);
        assert!((118..=121).contains(&bound), "{bound}");
        assert_eq!(best_bound(&gains, 6.0, Side::Low), 0);
        (gains[60], gains[140]) = (-1.0, 0.0);
        let bound = best_bound(&gains, 6.0, Side::Low);
        assert!((79..=82).contains(&bound), "{bound}");
    }
}
