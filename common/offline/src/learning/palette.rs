//! Initial colours, made from the names and display colours in the configuration alone.

use config::ColorConfig;

/// Minimum HSI saturation of pixels, by kind of colour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeastSaturation {
    /// For colours of teams and ball: large patches of strong paint.
    pub strong: f64,
    /// For all others.
    pub weak: f64,
}

/// The feature that separates a colour from the others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Tone {
    /// Range of hues, degrees.
    Hue([f64; 2]),
    /// White, grey and black: range of the mean of the channels, grey levels.
    Grey([f64; 2]),
}

/// Saturation of `looks` below which a colour is white, grey or black.
const MIN_HUE_SATURATION: f64 = 0.07;
/// Assumed colour of an unknown pitch.
const DEFAULT_PITCH_RGB: [f64; 3] = [60.0; 3];
/// Maximum of the channels below which paint is too dark for a hue, where only `looks` bounds it.
const DARKEST: f64 = 20.0;
/// Maximum saturation of grey paint under a coloured lamp.
const MAX_GREY_SATURATION: f64 = 0.2;

/// Divides all hues among the colours that have one, and all grey levels among the others: each value goes to
/// the colour whose `looks` is nearest. The pitch, of colour `pitch_rgb`, takes part in the division of grey
/// levels, but not of hues, since a colour may have the pitch's hue and be more saturated. Colours with equal
/// `looks` get nothing.
pub fn tones(colors: &[ColorConfig], pitch_rgb: Option<[f64; 3]>) -> Vec<Option<Tone>> {
    let grey = |color: &ColorConfig| {
        (saturation(color.looks) < MIN_HUE_SATURATION).then(|| mean(color.looks.map(f64::from)))
    };
    let mut hues: Vec<f64> = colors
        .iter()
        .filter(|color| grey(color).is_none())
        .filter_map(|color| hue_deg(color.looks))
        .collect();
    hues.sort_by(f64::total_cmp);
    let pitch = mean(pitch_rgb.unwrap_or(DEFAULT_PITCH_RGB));
    let mut greys: Vec<f64> = colors.iter().filter_map(grey).chain([pitch]).collect();
    greys.sort_by(f64::total_cmp);
    let tone = |color: &ColorConfig| match grey(color) {
        Some(own) => {
            let between = |other: f64| (own.max(1.0) * other.max(1.0)).sqrt();
            let darker = greys.iter().rev().find(|&&level| level < own);
            let brighter = greys.iter().find(|&&level| level > own);
            let from = darker.map_or(0.0, |&level| between(level));
            Some(Tone::Grey([from, brighter.map_or(256.0 * 256.0, |&level| between(level))]))
        }
        None => {
            let own = hue_deg(color.looks)?;
            let turn = |from: f64, to: f64| (to - from).rem_euclid(360.0);
            let others = hues.iter().filter(|&&hue| hue != own);
            let before = others.clone().map(|&hue| turn(hue, own)).fold(360.0, f64::min);
            let behind = others.map(|&hue| turn(own, hue)).fold(360.0, f64::min);
            let rounded = |hue: f64| (hue.rem_euclid(360.0) * 10.0).round() / 10.0;
            match before == 360.0 {
                true => Some(Tone::Hue([0.0, 360.0])),
                false => {
                    Some(Tone::Hue([rounded(own - before / 2.0), rounded(own + behind / 2.0)]))
                }
            }
        }
    };
    colors.iter().map(tone).collect()
}

/// The colours bounded by their [`tones`] and by a minimum saturation.
pub fn by_tone(
    colors: &[ColorConfig],
    pitch_rgb: Option<[f64; 3]>,
    is_strong: impl Fn(&ColorConfig) -> bool,
    least: LeastSaturation,
) -> Vec<ColorConfig> {
    let tones = tones(colors, pitch_rgb);
    let with_tone = |(color, tone): (&ColorConfig, Option<Tone>)| {
        let (ranges, hue_deg, saturation) = match tone? {
            Tone::Hue(hues) => {
                let saturation = if is_strong(color) { least.strong } else { least.weak };
                let is_all = hues[1] - hues[0] >= 360.0;
                (darkest(hues).map(|low| [low, 255]), (!is_all).then_some(hues), [saturation, 1.0])
            }
            Tone::Grey(levels) => {
                let [low, high] = levels.map(|level| level.min(255.0) as u8);
                ([[low, high]; 3], None, [0.0, MAX_GREY_SATURATION])
            }
        };
        let [red, green, blue] = ranges;
        Some(ColorConfig {
            red,
            green,
            blue,
            hue_deg,
            saturation: Some(saturation),
            ..color.clone()
        })
    };
    colors.iter().zip(tones).filter_map(with_tone).collect()
}

/// The minimum of each channel over pixels of these hues whose greatest channel is at least [`DARKEST`]. In a
/// vivid colour one channel is near zero; the hue determines which one.
fn darkest([from, to]: [f64; 2]) -> [u8; 3] {
    let extent = if to - from >= 360.0 { 360.0 } else { (to - from).rem_euclid(360.0) };
    let mut least = [1.0f64; 3];
    for step in 0..=extent as u32 {
        let hue = from + f64::from(step);
        for (channel, least) in least.iter_mut().enumerate() {
            // Channel of the purest colour of that hue: 1 within 60° of the channel's own hue, 0 beyond 120°.
            let apart = (hue - 120.0 * channel as f64).rem_euclid(360.0);
            let apart = apart.min(360.0 - apart);
            *least = least.min((2.0 - apart / 60.0).clamp(0.0, 1.0));
        }
    }
    least.map(|part| (part * DARKEST) as u8)
}

fn mean(rgb: [f64; 3]) -> f64 {
    rgb.iter().sum::<f64>() / 3.0
}

/// HSI saturation.
fn saturation(rgb: [u8; 3]) -> f64 {
    let [red, green, blue] = rgb.map(f64::from);
    let sum = red + green + blue;
    if sum == 0.0 { 0.0 } else { 1.0 - 3.0 * red.min(green).min(blue) / sum }
}

/// Hue as in the classifier's second look; `None` for grey.
pub fn hue_deg(rgb: [u8; 3]) -> Option<f64> {
    let [red, green, blue] = rgb.map(f32::from);
    let vector = [2.0 * red - green - blue, 3f32.sqrt() * (green - blue)];
    (vector != [0.0; 2])
        .then(|| f64::from(vector[1].atan2(vector[0]).to_degrees().rem_euclid(360.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use classifier::ClassTables;
    use config::Config;

    const LEAST: LeastSaturation = LeastSaturation { strong: 0.3, weak: 0.1 };

    #[test]
    fn hues_are_divided_without_gap_or_overlap() {
        let colors = Config::default().colors;
        let divided = by_tone(&colors, None, |color| color.name == "blue", LEAST);
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
    fn a_single_hue_gets_the_full_circle() {
        let mut colors = Config::default().colors;
        colors.truncate(1);
        assert_eq!(by_tone(&colors, None, |_| true, LEAST)[0].hue_deg, None);
    }

    #[test]
    fn vivid_paint_is_admitted() {
        let mut colors = Config::default().colors;
        let vivid = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 0, 255], [255, 255, 0]];
        colors.truncate(vivid.len());
        for (color, looks) in colors.iter_mut().zip(vivid) {
            color.looks = looks;
        }
        let tables = ClassTables::new(&by_tone(&colors, None, |_| true, LEAST)).unwrap();
        for (class, looks) in vivid.iter().enumerate() {
            for part in [0.15, 0.5, 1.0] {
                let shade = looks.map(|value| (f64::from(value) * part) as u8);
                assert_eq!(usize::from(tables.classify(shade)), class, "{shade:?}");
            }
        }
        assert_eq!(tables.classify([3, 0, 0]), classifier::BACKGROUND);
    }

    #[test]
    fn greys_are_divided_by_brightness_around_that_of_the_pitch() {
        let mut colors = Config::default().colors;
        colors.truncate(4);
        for (color, level) in colors.iter_mut().zip([240, 120, 10]) {
            color.looks = [level; 3];
        }
        let divided = by_tone(&colors, Some([50.0; 3]), |_| true, LEAST);
        let tables = ClassTables::new(&divided).unwrap();
        let classes = [230, 180, 100, 50, 12].map(|level| tables.classify([level; 3]));
        assert_eq!(classes, [0, 0, 1, classifier::BACKGROUND, 2]);
        // The fourth has a hue.
        assert_eq!(tables.classify(colors[3].looks), 3);
    }
}
