//! Corrections of pixels for a light that differs from the one in which the colours were set.

use crate::white_balance::{self, Gains};

/// Subtracts white light from all channels, and multiplies each with a gain. Fits into 16-bit integers, so
/// that [`kernels`](crate::kernels) can do the same to registers full of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Correction {
    /// White light, grey levels.
    pub(crate) haze: u8,
    /// Gain of red, green and blue, 256ths; at most [`MOST`].
    pub(crate) gains: [u16; 3],
}

/// Gain 1.
const UNITY: u16 = 256;
/// Largest gain: the kernels multiply signed integers.
const MOST: u16 = i16::MAX as u16;

impl Correction {
    /// Changes nothing.
    pub const NONE: Self = Self { haze: 0, gains: [UNITY; 3] };

    /// For these gains and `haze` grey levels of white light.
    pub fn new(gains: Gains, haze: u8) -> Self {
        Self { haze, gains: gains.map(|steps| white_balance::gain_in_256ths(steps).min(MOST)) }
    }

    /// The corrected value of a channel: 0 red, 1 green, 2 blue.
    #[inline(always)]
    pub fn apply(&self, channel: usize, value: u8) -> u8 {
        let value = u32::from(value.saturating_sub(self.haze));
        rounded(value * u32::from(self.gains[channel]))
    }

    /// For each channel, a table from a value to its corrected value.
    pub fn tables(&self) -> [[u8; 256]; 3] {
        self.gains.map(|gain| {
            let mut table = [0; 256];
            // Adding the gain from value to value takes a third of the time of multiplying.
            let mut product = 0;
            for corrected in &mut table[usize::from(self.haze)..] {
                *corrected = rounded(product);
                product += u32::from(gain);
            }
            table
        })
    }
}

/// A product in 256ths, rounded to a byte.
#[inline(always)]
fn rounded(product: u32) -> u8 {
    ((product + u32::from(UNITY / 2)) / u32::from(UNITY)).min(u8::MAX.into()) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corrected_values_follow_the_gains() {
        assert_eq!(Correction::new([0; 3], 0), Correction::NONE);
        assert_eq!(Correction::NONE.tables()[0].to_vec(), (0..=255).collect::<Vec<u8>>());
        // Limit of the gains of white balance and zone together, steps.
        for steps in -41..=41 {
            let gain = (f64::from(steps) / 16.0).exp2();
            for haze in [0, 8, 144] {
                let correction = Correction::new([0, steps, 0], haze);
                for (value, &corrected) in correction.tables()[1].iter().enumerate() {
                    let exact = (value.saturating_sub(haze.into()) as f64 * gain).min(255.0);
                    let off = (f64::from(corrected) - exact).abs();
                    assert!(off <= 1.02, "{steps} {haze}: {value}");
                    assert_eq!(corrected, correction.apply(1, value as u8));
                }
            }
        }
    }
}
