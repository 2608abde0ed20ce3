//! Colours to begin with, when nothing is known but what they are called and look like.

use common::config::ColorConfig;

/// How saturated something must be to be looked at, in HSI.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeastSaturation {
    /// Colours of teams and ball: large patches of strong paint.
    pub strong: f64,
    /// All others.
    pub weak: f64,
}

/// Divides all hues among `colors` by what they look like: each gets everything that is nearer to
/// its own hue than to any other's. Grey looks have no hue; such colours are left out.
pub fn by_hue(
    colors: &[ColorConfig],
    is_strong: impl Fn(&ColorConfig) -> bool,
    least: LeastSaturation,
) -> Vec<ColorConfig> {
    let mut known: Vec<(f64, &ColorConfig)> =
        colors.iter().filter_map(|color| Some((hue_deg(color.looks)?, color))).collect();
    known.sort_by(|a, b| a.0.total_cmp(&b.0));
    let count = known.len();
    let middle = |from: f64, to: f64| {
        let gap = (to - from).rem_euclid(360.0);
        // A single colour has all hues, and so have two of one hue together.
        let gap = if count == 1 { 360.0 } else { gap };
        ((from + gap / 2.0).rem_euclid(360.0) * 10.0).round() / 10.0
    };
    let mut divided: Vec<ColorConfig> = (0..count)
        .map(|index| {
            let (hue, color) = known[index];
            let before = known[(index + count - 1) % count].0;
            let behind = known[(index + 1) % count].0;
            let saturation = if is_strong(color) { least.strong } else { least.weak };
            ColorConfig {
                red: [DARKEST, 255],
                green: [DARKEST, 255],
                blue: [0, 255],
                hue_deg: (count > 1).then(|| [middle(before, hue), middle(hue, behind)]),
                saturation: Some([saturation, 1.0]),
                ..color.clone()
            }
        })
        .collect();
    // In the order in which they were given.
    let place = |color: &ColorConfig| colors.iter().position(|known| known.name == color.name);
    divided.sort_by_key(place);
    divided
}

/// What is darker than this in red or green has hardly a hue.
const DARKEST: u8 = 20;

/// The hue as in the classifier's second look; `None` for grey.
fn hue_deg(rgb: [u8; 3]) -> Option<f64> {
    let [red, green, blue] = rgb.map(f64::from);
    let vector = [2.0 * red - green - blue, 3f64.sqrt() * (green - blue)];
    (vector != [0.0; 2]).then(|| vector[1].atan2(vector[0]).to_degrees().rem_euclid(360.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use common::config::Config;

    #[test]
    fn hues_are_divided_without_gap_or_overlap() {
        let least = LeastSaturation { strong: 0.3, weak: 0.1 };
        let colors = Config::default().colors;
        let divided = by_hue(&colors, |color| color.name == "blue", least);
        assert_eq!(divided.len(), colors.len());
        for (color, original) in divided.iter().zip(&colors) {
            assert_eq!(color.name, original.name);
            let strong = color.name == "blue";
            assert_eq!(color.saturation, Some([if strong { 0.3 } else { 0.1 }, 1.0]));
            let hue = hue_deg(original.looks).unwrap();
            let [from, to] = color.hue_deg.unwrap();
            let extent = (to - from).rem_euclid(360.0);
            assert!((hue - from).rem_euclid(360.0) <= extent, "{} {from} {to}", color.name);
        }
        let total: f64 = divided
            .iter()
            .map(|color| color.hue_deg.map_or(360.0, |[from, to]| (to - from).rem_euclid(360.0)))
            .sum();
        assert!((total - 360.0).abs() < 1e-6, "{total}");
    }

    #[test]
    fn grey_has_no_hue_and_one_color_has_all() {
        let least = LeastSaturation { strong: 0.3, weak: 0.1 };
        let mut colors = Config::default().colors;
        colors.truncate(2);
        colors[0].looks = [90; 3];
        let divided = by_hue(&colors, |_| true, least);
        assert_eq!(divided.len(), 1);
        assert_eq!(divided[0].hue_deg, None);
    }
}
