//! The ten bounds of a colour, in bins.

use super::points::{Point, TURN};
use super::quantile;
use config::ColorConfig;

/// Red, green, blue, hue, saturation.
pub(super) const AXES: usize = 5;
pub(super) const HUE: usize = 3;
pub(super) const SATURATION: usize = 4;
/// Possible positions of a bound.
pub(super) const BINS: usize = 256;
const LAST: u8 = (BINS - 1) as u8;
/// Width of a bin of hue, where a turn is [`TURN`].
const HUE_BIN: f64 = TURN / BINS as f64;
/// Length of the mean direction of hues (1 for a single hue) below which a colour is grey.
const MIN_COHERENCE: f64 = 0.6;

/// End of a range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Side {
    Low = 0,
    High = 1,
}

impl Side {
    /// The bin that excludes nothing.
    pub fn end(self) -> u8 {
        match self {
            Side::Low => 0,
            Side::High => LAST,
        }
    }
}

/// Bit set of the bounds that a point fails.
pub(super) type FailedBounds = u16;

/// The bit of a bound.
pub(super) fn bit(axis: usize, side: Side) -> FailedBounds {
    1 << (2 * axis + side as usize)
}

/// The bounds of red, green and blue.
pub(super) const BOX: FailedBounds = 0b11_1111;

/// One colour's bounds: first and last bin, both included. Hue is measured relative to the middle of the
/// samples' hues, which is put into the middle of the bins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bounds {
    pub bins: [[u8; 2]; AXES],
    middle_hue: u16,
}

impl Bounds {
    /// The narrowest bounds that contain all but a few of a colour's own samples.
    pub fn around(own: &[&Point]) -> Self {
        let mut direction = [0.0, 0.0];
        let mut length = 0.0;
        for point in own {
            let Some(hue) = point.hue else { continue };
            let (sin, cos) = (f64::from(hue) / TURN * std::f64::consts::TAU).sin_cos();
            let saturation = f64::from(point.saturation);
            direction = [direction[0] + saturation * cos, direction[1] + saturation * sin];
            length += saturation;
        }
        let [x, y] = direction;
        let middle = y.atan2(x) / std::f64::consts::TAU * TURN;
        let mut bounds = Self { bins: [[0, LAST]; AXES], middle_hue: middle.round() as i64 as u16 };
        let grey = own.iter().filter(|point| point.hue.is_none()).count();
        let has_hue = x.hypot(y) >= MIN_COHERENCE * length && 10 * grey <= own.len();
        for axis in (0..AXES).filter(|&axis| axis != HUE || has_hue) {
            let mut bins: Vec<f64> =
                own.iter().filter_map(|point| bounds.bin(point, axis)).map(f64::from).collect();
            bounds.bins[axis] = [0.01, 0.99].map(|part| quantile(&mut bins, part) as u8);
        }
        bounds
    }

    /// Position of a point on an axis; `None` for the hue of grey.
    pub fn bin(&self, point: &Point, axis: usize) -> Option<u8> {
        match axis {
            HUE => {
                point.hue.map(|hue| (hue.wrapping_sub(self.middle_hue) ^ 0x8000).to_be_bytes()[0])
            }
            SATURATION => Some(point.saturation),
            _ => Some(point.rgb[axis]),
        }
    }

    /// The bounds that a point fails.
    pub fn fails(&self, point: &Point) -> FailedBounds {
        (0..AXES).map(|axis| self.fails_on(axis, self.bin(point, axis))).sum()
    }

    /// The bounds of an axis that a bin fails.
    pub fn fails_on(&self, axis: usize, bin: Option<u8>) -> FailedBounds {
        let [low, high] = self.bins[axis];
        let is_beyond = match bin {
            Some(bin) => [bin < low, bin > high],
            None => [low > 0 || high < LAST; 2],
        };
        (FailedBounds::from(is_beyond[0]) | FailedBounds::from(is_beyond[1]) << 1) << (2 * axis)
    }

    pub fn is_bounded(&self, axis: usize) -> bool {
        self.bins[axis] != [0, LAST]
    }

    /// The bounds in the form of the configuration.
    pub fn color(&self, color: &ColorConfig, looks: [u8; 3]) -> ColorConfig {
        let edge =
            |bin: u8, beyond: u8| f64::from(u16::from(bin) + u16::from(beyond)) / BINS as f64;
        let [hue_low, hue_high] = self.bins[HUE];
        let hue = |bin: u8, beyond: u8| {
            let turns =
                edge(bin, beyond) - 0.5 + f64::from(self.middle_hue) / HUE_BIN / BINS as f64;
            (turns.rem_euclid(1.0) * 3600.0).round() / 10.0
        };
        let [saturation_low, saturation_high] = self.bins[SATURATION];
        let saturation = [edge(saturation_low, 0), edge(saturation_high, 1)];
        ColorConfig {
            name: color.name.clone(),
            red: self.bins[0],
            green: self.bins[1],
            blue: self.bins[2],
            hue_deg: self.is_bounded(HUE).then(|| [hue(hue_low, 0), hue(hue_high, 1)]),
            saturation: self
                .is_bounded(SATURATION)
                .then(|| saturation.map(|value| (value * 1000.0).round() / 1000.0)),
            looks,
            ..color.clone()
        }
    }
}
