//! The optional second look at a classified pixel: bounds on hue and saturation of the HSI colour
//! space (section 4.2 of the paper, last paragraph).
//!
//! With R, G, B the interpolated values:
//!
//! * saturation = 1 − 3·min(R, G, B) / (R + G + B), computed as (sum − 3·min) / sum, which a
//!   single rounding makes comparable with a bound as written; black has saturation 0;
//! * hue is the angle of the vector (2R − G − B, √3·(G − B)), counter-clockwise: 0° red, 120°
//!   green, 240° blue. It is the angle of the textbook's arccos formula. Grey (R = G = B) has no
//!   hue and meets no hue bound, except a full circle, which is no bound.
//!
//! The angle itself is never needed: whether it lies between two others shows in the signs of two
//! cross products. So a pixel costs a few multiplications, and the result is the same on every
//! machine, which an arccos from the system's mathematical library would not guarantee.

use crate::ClassifierError;
use common::config::ColorConfig;

/// What a pixel must meet besides the colour's RGB box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SecondLook {
    /// `None`: any hue, and grey.
    hue: Option<HueSector>,
    /// Lowest and highest, inclusive.
    saturation: [f64; 2],
}

impl SecondLook {
    /// Admits every pixel.
    pub const ANY: Self = Self { hue: None, saturation: [0.0, 1.0] };

    /// The second look of a configured colour, if it has one.
    pub fn new(color: &ColorConfig) -> Result<Option<Self>, ClassifierError> {
        if color.hue_deg.is_none() && color.saturation.is_none() {
            return Ok(None);
        }
        let mut look = Self::ANY;
        if let Some([low, high]) = color.hue_deg {
            if !(low.is_finite() && high.is_finite()) {
                let color = color.name.clone();
                return Err(ClassifierError::NotFinite { color, channel: "hue", low, high });
            }
            look.hue = HueSector::new(low, high);
        }
        if let Some([low, high]) = color.saturation {
            let (color, channel) = (color.name.clone(), "saturation");
            if !(low.is_finite() && high.is_finite()) {
                return Err(ClassifierError::NotFinite { color, channel, low, high });
            }
            if low > high {
                return Err(ClassifierError::EmptyRange { color, channel, low, high });
            }
            look.saturation = [low, high];
        }
        Ok(Some(look))
    }

    /// Whether a pixel meets both bounds.
    pub fn admits(&self, rgb: [u8; 3]) -> bool {
        self.admits_seen(&Seen::new(rgb))
    }

    /// The same.
    #[inline(always)]
    pub(crate) fn admits_seen(&self, seen: &Seen) -> bool {
        let [lowest, highest] = self.saturation;
        lowest <= seen.saturation
            && seen.saturation <= highest
            && self.hue.is_none_or(|sector| seen.hue.is_some_and(|hue| sector.holds(hue)))
    }

    /// Whether the bounds on saturation share anything with a range.
    pub(crate) fn may_admit_saturation(&self, low: f64, high: f64) -> bool {
        let [lowest, highest] = self.saturation;
        lowest <= high && low <= highest
    }

    /// Whether the bounds on hue admit a pixel whose hue is between those of two pixels, which are less
    /// than half a circle apart. May say that they do where they nearly do.
    pub(crate) fn may_admit_hue(&self, a: [u8; 3], b: [u8; 3]) -> bool {
        let Some(sector) = self.hue else { return true };
        let (Some(a), Some(b)) = (hue_vector(a), hue_vector(b)) else { return true };
        let (first, last) = if cross(a, b) >= 0.0 { (a, b) } else { (b, a) };
        const NEARLY: f64 = -1e-6;
        let begins_between =
            cross(first, sector.from) >= NEARLY && cross(sector.from, last) >= NEARLY;
        sector.holds(a) || sector.holds(b) || begins_between
    }
}

/// What second looks see of a pixel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Seen {
    saturation: f64,
    hue: Option<[f64; 2]>,
}

impl Seen {
    #[inline(always)]
    pub fn new(rgb: [u8; 3]) -> Self {
        Self { saturation: saturation(rgb), hue: hue_vector(rgb) }
    }
}

/// HSI saturation, 0–1.
pub fn saturation(rgb: [u8; 3]) -> f64 {
    let [red, green, blue] = rgb.map(u32::from);
    let sum = red + green + blue;
    saturation_of(sum - 3 * red.min(green).min(blue), sum)
}

/// The same of what the channels have above the least of them, and of their sum.
pub(crate) fn saturation_of(above: u32, sum: u32) -> f64 {
    if sum == 0 { 0.0 } else { f64::from(above) / f64::from(sum) }
}

/// HSI hue in degrees, in [0, 360); `None` for grey.
pub fn hue_deg(rgb: [u8; 3]) -> Option<f64> {
    let degrees = hue_vector(rgb).map(|[x, y]| y.atan2(x).to_degrees())?;
    Some(if degrees < 0.0 { degrees + 360.0 } else { degrees })
}

/// A vector whose angle is the hue; `None` for grey.
fn hue_vector(rgb: [u8; 3]) -> Option<[f64; 2]> {
    let [red, green, blue] = rgb.map(f64::from);
    let vector = [2.0 * red - green - blue, 3f64.sqrt() * (green - blue)];
    (vector != [0.0, 0.0]).then_some(vector)
}

/// All hues counter-clockwise from one direction to another, both included.
#[derive(Debug, Clone, Copy, PartialEq)]
struct HueSector {
    from: [f64; 2],
    to: [f64; 2],
    /// Wider than half a circle.
    is_reflex: bool,
}

/// Widens a sector at both ends, so that a colour exactly on a bound is inside whatever way the
/// roundings fall. Different hues of 8-bit colours lie at least 0.0007° apart.
const TOLERANCE_DEG: f64 = 1e-9;

impl HueSector {
    /// `None` for a full circle.
    fn new(from_deg: f64, to_deg: f64) -> Option<Self> {
        let mut extent_deg = to_deg - from_deg;
        if extent_deg < 0.0 {
            extent_deg = extent_deg.rem_euclid(360.0);
        }
        extent_deg += 2.0 * TOLERANCE_DEG;
        if extent_deg >= 360.0 {
            return None;
        }
        let from_deg = from_deg.rem_euclid(360.0) - TOLERANCE_DEG;
        let direction = |degrees: f64| [degrees.to_radians().cos(), degrees.to_radians().sin()];
        Some(Self {
            from: direction(from_deg),
            to: direction(from_deg + extent_deg),
            is_reflex: extent_deg > 180.0,
        })
    }

    fn holds(&self, hue: [f64; 2]) -> bool {
        let is_left_of_from = cross(self.from, hue) >= 0.0;
        let is_right_of_to = cross(hue, self.to) >= 0.0;
        if self.is_reflex {
            is_left_of_from || is_right_of_to
        } else {
            is_left_of_from && is_right_of_to
        }
    }
}

/// Positive when the second vector lies counter-clockwise of the first, by less than half a turn.
fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn color(hue_deg: Option<[f64; 2]>, saturation: Option<[f64; 2]>) -> ColorConfig {
        ColorConfig {
            name: "test".into(),
            red: [0, 255],
            green: [0, 255],
            blue: [0, 255],
            hue_deg,
            saturation,
            y: None,
            u: None,
            v: None,
            looks: [0; 3],
        }
    }

    fn hue_look(from: f64, to: f64) -> SecondLook {
        SecondLook::new(&color(Some([from, to]), None)).unwrap().unwrap()
    }

    const PRIMARIES: [([u8; 3], f64); 6] = [
        ([255, 0, 0], 0.0),
        ([255, 255, 0], 60.0),
        ([0, 255, 0], 120.0),
        ([0, 255, 255], 180.0),
        ([0, 0, 255], 240.0),
        ([255, 0, 255], 300.0),
    ];

    #[test]
    fn bounds_are_inclusive_and_a_single_hue_is_a_sector() {
        for (rgb, hue) in PRIMARIES {
            assert!((hue_deg(rgb).unwrap() - hue).abs() < 1e-9);
            for (other, other_hue) in PRIMARIES {
                assert_eq!(hue_look(hue, hue).admits(other), hue == other_hue);
            }
            // Half circles, and what is more than half a circle.
            assert!(hue_look(hue, hue + 180.0).admits(rgb));
            assert!(hue_look(hue - 180.0, hue).admits(rgb));
            assert!(hue_look(hue, hue + 300.0).admits(rgb));
            assert!(!hue_look(hue + 0.001, hue - 0.001).admits(rgb));
            assert!(!hue_look(hue + 0.001, hue + 180.0).admits(rgb));
        }
    }

    #[test]
    fn a_sector_may_pass_through_zero() {
        let red = hue_look(350.0, 20.0);
        assert!(red.admits([255, 0, 0]));
        assert!(red.admits([200, 40, 10])); // 9°
        assert!(red.admits([200, 10, 30])); // 354°
        assert!(!red.admits([200, 100, 10])); // 29°
        assert!(!red.admits([200, 10, 70])); // 343°
        assert!(!red.admits([0, 255, 255])); // opposite
        assert_eq!(red, hue_look(-10.0, 20.0));
    }

    #[test]
    fn grey_has_no_hue_and_black_no_saturation() {
        for grey in [0, 1, 128, 255] {
            assert_eq!(hue_deg([grey; 3]), None);
            assert_eq!(saturation([grey; 3]), 0.0);
            assert!(!hue_look(0.0, 359.0).admits([grey; 3]));
            assert!(hue_look(0.0, 360.0).admits([grey; 3]));
        }
        let look = SecondLook::new(&color(None, Some([0.1, 1.0]))).unwrap().unwrap();
        assert!(!look.admits([0, 0, 0]));
    }

    #[test]
    fn saturation_bounds_are_inclusive_as_written() {
        // Sum 300, minimum 80: exactly 0.2.
        let look = |low, high| SecondLook::new(&color(None, Some([low, high]))).unwrap().unwrap();
        assert!(look(0.2, 0.2).admits([80, 100, 120]));
        assert!(!look(0.2000001, 1.0).admits([80, 100, 120]));
        assert!(!look(0.0, 0.1999999).admits([80, 100, 120]));
        assert!(look(1.0, 1.0).admits([0, 3, 250]));
    }

    #[test]
    fn only_bounded_colors_have_a_second_look() {
        assert_eq!(SecondLook::new(&color(None, None)), Ok(None));
    }

    #[test]
    fn impossible_bounds_are_refused() {
        for bad in [[f64::NAN, 1.0], [0.0, f64::INFINITY]] {
            for (hue, saturation) in [(Some(bad), None), (None, Some(bad))] {
                let result = SecondLook::new(&color(hue, saturation));
                assert!(matches!(result, Err(ClassifierError::NotFinite { .. })));
            }
        }
        let result = SecondLook::new(&color(None, Some([0.6, 0.5])));
        assert!(matches!(result, Err(ClassifierError::EmptyRange { .. })));
    }

    proptest! {
        #[test]
        fn sectors_agree_with_angles(
            rgb: [u8; 3],
            from in 0i32..360,
            extent in 0i32..360,
        ) {
            // Off the whole degrees, where colours may lie exactly on a bound.
            let from = f64::from(from) + 0.37;
            let to = (from + f64::from(extent)) % 360.0;
            let expected = hue_deg(rgb)
                .is_some_and(|hue| (hue - from).rem_euclid(360.0) <= f64::from(extent));
            prop_assert_eq!(hue_look(from, to).admits(rgb), expected);
        }

        #[test]
        fn any_finite_bounds_are_survived(rgb: [u8; 3], from: f64, to: f64) {
            if let Ok(Some(look)) = SecondLook::new(&color(Some([from, to]), None)) {
                look.admits(rgb);
            }
        }
    }
}
