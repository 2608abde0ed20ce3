//! The optional second look at a classified pixel: bounds on hue and saturation in the HSI colour space
//! (section 4.2 of the paper, last paragraph).
//!
//! With R, G, B the interpolated values:
//!
//! * saturation = 1 − 3·min(R, G, B) / (R + G + B), computed as (sum − 3·min) / sum, which a single rounding
//!   makes comparable with a bound as written; black has saturation 0;
//! * hue is the angle of the vector (2R − G − B, √3·(G − B)), counter-clockwise: 0° red, 120° green, 240°
//!   blue. It equals the angle of the textbook's arccos formula. Grey (R = G = B) has no hue and meets no hue
//!   bound, except a full circle, which is no bound.
//!
//! Neither is computed per pixel. Both are ratios, of which bytes have finitely many, so each bound is
//! replaced by a ratio of small integers that lies between the two neighbouring ratios on either side of it
//! (`Bound`; found in the Stern–Brocot tree). The sign of a·x + b·y then tells on which side of the bound a
//! pixel lies. The formulas above place the bounds, so the answer equals theirs, is the same on every
//! machine, and is computed in vectors of integers.

use crate::ClassifierError;
use config::ColorConfig;

/// Conditions on a pixel besides the colour's RGB box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SecondLook {
    /// First and last hue. Both bounds must be met, or either one if they are more than half a circle apart.
    pub(crate) hue: [Bound; 2],
    pub(crate) is_reflex: bool,
    /// Lowest and highest saturation.
    pub(crate) saturation: [Bound; 2],
    /// The bounds as configured.
    formula: Formula,
}

/// Met if a·x + b·y ≥ least, for [hue](HueSaturation::hue) or [saturation](HueSaturation::saturation).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Bound {
    pub a: i16,
    pub b: i16,
    pub least: i32,
}

/// The vectors that bounds are compared with.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HueSaturation {
    /// R − B and G − B: hue is the direction of this vector, in oblique axes.
    hue: [i32; 2],
    /// sum − 3·min and the sum of the channels: saturation is their quotient.
    saturation: [i32; 2],
}

impl HueSaturation {
    #[inline(always)]
    pub fn new(rgb: [u8; 3]) -> Self {
        let [red, green, blue] = rgb.map(i32::from);
        let sum = red + green + blue;
        Self {
            hue: [red - blue, green - blue],
            saturation: [sum - 3 * red.min(green).min(blue), sum],
        }
    }
}

impl Bound {
    pub const NONE: Self = Self { a: 0, b: 0, least: 0 };
    const IMPOSSIBLE: Self = Self { a: 0, b: 0, least: 1 };

    #[inline(always)]
    fn is_met(&self, [x, y]: [i32; 2]) -> bool {
        i32::from(self.a) * x + i32::from(self.b) * y >= self.least
    }
}

impl SecondLook {
    /// Admits every pixel.
    pub const ANY: Self = Self {
        hue: [Bound::NONE; 2],
        is_reflex: false,
        saturation: [Bound::NONE; 2],
        formula: Formula { hue: None, saturation: [0.0, 1.0] },
    };

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
            look.formula.hue = HueSector::new(low, high);
        }
        if let Some([low, high]) = color.saturation {
            let (color, channel) = (color.name.clone(), "saturation");
            if !(low.is_finite() && high.is_finite()) {
                return Err(ClassifierError::NotFinite { color, channel, low, high });
            }
            if low > high {
                return Err(ClassifierError::EmptyRange { color, channel, low, high });
            }
            look.formula.saturation = [low, high];
        }
        if let Some(sector) = look.formula.hue {
            look.hue = sector.bounds();
            look.is_reflex = sector.is_reflex;
        }
        look.saturation = saturation_bounds(look.formula.saturation);
        Ok(Some(look))
    }

    /// Whether a pixel meets both bounds.
    pub fn admits(&self, rgb: [u8; 3]) -> bool {
        self.admits_hue_saturation(&HueSaturation::new(rgb))
    }

    /// [`admits`](Self::admits) without branches, which would be mispredicted at edges of patches and in
    /// noise.
    #[inline(always)]
    pub(crate) fn admits_hue_saturation(&self, seen: &HueSaturation) -> bool {
        let [lowest, highest] =
            self.saturation.each_ref().map(|bound| bound.is_met(seen.saturation));
        let [from, to] = self.hue.each_ref().map(|bound| bound.is_met(seen.hue));
        lowest & highest & (from & to | self.is_reflex & (from | to))
    }

    /// Whether the saturation bounds admit anything in a range.
    pub(crate) fn may_admit_saturation(&self, low: f64, high: f64) -> bool {
        let [lowest, highest] = self.formula.saturation;
        lowest <= high && low <= highest
    }

    /// Whether the hue bounds admit a hue between those of two pixels less than half a circle apart. True
    /// also if they miss it by rounding.
    pub(crate) fn may_admit_hue(&self, a: [u8; 3], b: [u8; 3]) -> bool {
        let Some(sector) = &self.formula.hue else { return true };
        let [a, b] = [a, b].map(|rgb| hue_vector(rgb.map(i32::from)));
        let (first, last) = if cross(a, b) >= 0.0 { (a, b) } else { (b, a) };
        const NEARLY: f64 = -1e-6;
        let begins_between =
            cross(first, sector.from) >= NEARLY && cross(sector.from, last) >= NEARLY;
        sector.holds(a) || sector.holds(b) || begins_between
    }
}

/// The bounds as the formulas of hue and saturation state them.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Formula {
    /// `None` admits every hue, and grey.
    hue: Option<HueSector>,
    /// Lowest and highest, inclusive.
    saturation: [f64; 2],
}

impl Formula {
    #[cfg(test)]
    fn admits(&self, rgb: [u8; 3]) -> bool {
        let [lowest, highest] = self.saturation;
        let saturation = saturation(rgb);
        let is_grey = rgb[0] == rgb[1] && rgb[1] == rgb[2];
        let has_hue = |sector: HueSector| !is_grey && sector.holds(hue_vector(rgb.map(i32::from)));
        lowest <= saturation && saturation <= highest && self.hue.is_none_or(has_hue)
    }
}

/// HSI saturation, 0–1.
pub fn saturation(rgb: [u8; 3]) -> f64 {
    let [above, sum] = HueSaturation::new(rgb).saturation;
    saturation_of(above, sum)
}

/// HSI saturation from sum − 3·min and the sum of the channels.
pub(crate) fn saturation_of(above: i32, sum: i32) -> f64 {
    if sum == 0 { 0.0 } else { f64::from(above) / f64::from(sum) }
}

/// HSI hue in degrees, in [0, 360); `None` for grey.
pub fn hue_deg(rgb: [u8; 3]) -> Option<f64> {
    let [x, y] = hue_vector(rgb.map(i32::from));
    let degrees = y.atan2(x).to_degrees();
    let is_grey = x == 0.0 && y == 0.0;
    (!is_grey).then_some(if degrees < 0.0 { degrees + 360.0 } else { degrees })
}

/// A vector whose angle is the hue; 0 for grey.
fn hue_vector(rgb: [i32; 3]) -> [f64; 2] {
    let [red, green, blue] = rgb.map(f64::from);
    [2.0 * red - green - blue, 3f64.sqrt() * (green - blue)]
}

/// Highest byte, and highest sum of three: no ratio of pixels has a greater denominator.
const MAX_BYTE: i32 = 255;
const MAX_SUM: i32 = 3 * MAX_BYTE;

/// The bounds that pixels with at least the lowest and at most the highest saturation meet.
fn saturation_bounds([lowest, highest]: [f64; 2]) -> [Bound; 2] {
    let of = |[above, sum]: [i32; 2]| saturation_of(above, sum);
    let sum = |[_, sum]: [i32; 2]| sum;
    let ends = [[0, 1], [1, 1]];
    let lower = match ends.map(|end| of(end) >= lowest) {
        [true, _] => Bound::NONE,
        [_, false] => Bound::IMPOSSIBLE,
        // Black has saturation 0, which is below the bound.
        _ => {
            let [p, q] = between(ends, sum, MAX_SUM, |ratio| of(ratio) >= lowest);
            Bound { a: q as i16, b: -p as i16, least: 1 }
        }
    };
    let upper = match ends.map(|end| of(end) > highest) {
        [true, _] => Bound::IMPOSSIBLE,
        [_, false] => Bound::NONE,
        // Black has saturation 0, which is not above the bound.
        _ => {
            let [p, q] = between(ends, sum, MAX_SUM, |ratio| of(ratio) > highest);
            Bound { a: -q as i16, b: p as i16, least: 0 }
        }
    };
    [lower, upper]
}

/// A ratio between two neighbours in the Stern–Brocot tree that separates all ratios with denominators up to
/// `most` for which `is_true` from those for which it is not. A ratio is a vector; the sum of two neighbours
/// (the mediant) is the simplest ratio between them.
fn between<const N: usize>(
    [mut without, mut with]: [[i32; N]; 2],
    denominator: impl Fn([i32; N]) -> i32,
    most: i32,
    is_true: impl Fn([i32; N]) -> bool,
) -> [i32; N] {
    loop {
        let middle: [i32; N] = std::array::from_fn(|i| without[i] + with[i]);
        if denominator(middle) > most {
            return middle;
        }
        if is_true(middle) {
            with = middle;
        } else {
            without = middle;
        }
    }
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

/// Red, yellow, green, cyan, blue, magenta: any hue between two neighbours is a sum of multiples of both.
const PRIMARIES: [[i32; 3]; 6] = [[1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1], [1, 0, 1]];

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
        let (from, to) = (is_left(self.from, hue), !is_left(self.to, hue));
        if self.is_reflex { from || to } else { from && to }
    }

    /// The sector in integers: counter-clockwise of `from` and clockwise of `to`. Grey is neither.
    fn bounds(&self) -> [Bound; 2] {
        // A pixel lies counter-clockwise of a colour where their determinant is positive.
        let [[from_x, from_y], [to_x, to_y]] = [self.from, self.to].map(|direction| {
            let [red, green, blue] = hue_at(direction);
            [red - blue, green - blue].map(|value| value as i16)
        });
        [Bound { a: -from_y, b: from_x, least: 1 }, Bound { a: to_y, b: -to_x, least: 1 }]
    }
}

/// A colour between the last hue that is not counter-clockwise of a direction and the first that is.
fn hue_at(direction: [f64; 2]) -> [i32; 3] {
    let is_left = |rgb| is_left(direction, hue_vector(rgb));
    let greatest = |rgb: [i32; 3]| rgb[0].max(rgb[1]).max(rgb[2]);
    let sector = (0..6).map(|index| [PRIMARIES[index], PRIMARIES[(index + 1) % 6]]);
    let ends = sector.into_iter().find(|&[last, first]| !is_left(last) && is_left(first));
    // No two of the six have the same direction modulo half a circle, so there is one.
    between(ends.unwrap_or([PRIMARIES[0], PRIMARIES[1]]), greatest, MAX_BYTE, is_left)
}

/// Whether the second direction is that of the first or counter-clockwise of it, by less than half a turn.
fn is_left(first: [f64; 2], second: [f64; 2]) -> bool {
    cross(first, second) >= 0.0
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
            // Half circles, and sectors of more than half a circle.
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
    fn integer_bounds_separate_every_hue_and_saturation() {
        for (index, degrees) in (0..360).step_by(45).map(f64::from).enumerate() {
            let tenth = index as f64 / 10.0;
            let color = color(Some([degrees + tenth, degrees + 77.7]), Some([0.3, 0.7]));
            let look = SecondLook::new(&color).unwrap().unwrap();
            for first in 0..=255 {
                for second in 0..=255 {
                    for rgb in [
                        [first, second, 0],
                        [0, first, second],
                        [second, 0, first],
                        [first, first, second],
                    ] {
                        assert_eq!(look.admits(rgb), look.formula.admits(rgb), "{rgb:?} {degrees}");
                    }
                }
            }
        }
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
        fn integer_bounds_agree_with_the_formulas(
            hue in (-400.0..400.0f64, -400.0..400.0f64),
            saturation in (-0.1..1.1f64, 0.0..1.0f64),
            met in any::<[u8; 3]>(),
            meets in any::<[bool; 4]>(),
            pixels in proptest::collection::vec(any::<[u8; 3]>(), 100),
            dark in 0u8..6,
        ) {
            // Some bounds are exactly the value of a pixel.
            let exact = |is_exact: bool, value: f64, of: f64| if is_exact { of } else { value };
            let of = hue_deg(met).unwrap_or(0.0);
            let hue = [exact(meets[0], hue.0, of), exact(meets[1], hue.1, of)];
            let of = super::saturation(met);
            let ends = [saturation.0, saturation.0 + saturation.1];
            let saturation = [exact(meets[2], ends[0], of), exact(meets[3], ends[1], of)];
            let color = color(Some(hue), Some(saturation));
            let Ok(Some(look)) = SecondLook::new(&color) else { return Ok(()) };
            let around = |(index, rgb): (usize, [u8; 3])| -> [u8; 3] {
                std::array::from_fn(|c| match index % 3 {
                    0 => rgb[c],
                    1 => rgb[c] >> dark,
                    _ => met[c].wrapping_add(rgb[c] % 3).wrapping_sub(1),
                })
            };
            for rgb in pixels.into_iter().enumerate().map(around).chain([met, [0; 3], [255; 3]]) {
                prop_assert_eq!(look.admits(rgb), look.formula.admits(rgb), "{:?}", rgb);
            }
        }

        #[test]
        fn any_finite_bounds_are_survived(rgb: [u8; 3], from: f64, to: f64) {
            if let Ok(Some(look)) = SecondLook::new(&color(Some([from, to]), None)) {
                look.admits(rgb);
            }
        }
    }
}
