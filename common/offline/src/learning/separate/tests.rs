use super::*;
use crate::learning::samples::Sample;
use classifier::ClassTables;

fn color(name: &str) -> ColorConfig {
    ColorConfig {
        name: name.into(),
        red: [0, 255],
        green: [0, 255],
        blue: [0, 255],
        hue_deg: None,
        saturation: None,
        y: None,
        u: None,
        v: None,
        looks: [0; 3],
    }
}

/// A few shades around each colour, each one a patch of its own.
fn samples(classes: &[&[[u8; 3]]], background: &[[u8; 3]]) -> Samples {
    let mut samples = Samples { pictures: 1, ..Samples::default() };
    for (class, patches) in (0u8..).zip(classes) {
        for &rgb in *patches {
            let patch = samples.patches;
            samples.patches += 1;
            samples.pixels.extend(shades(rgb).map(|rgb| Sample { rgb, class, patch }));
        }
    }
    samples.background =
        background.iter().flat_map(|&rgb| shades(rgb).map(|rgb| (rgb, 5000.0))).collect();
    samples
}

fn shades(rgb: [u8; 3]) -> impl Iterator<Item = [u8; 3]> {
    (0..27u8).map(move |index| {
        let shift = [index % 3, index / 3 % 3, index / 9];
        [0, 1, 2].map(|channel| rgb[channel].saturating_add(4 * shift[channel]).max(4) - 4)
    })
}

fn classify(colors: &[ColorConfig], rgb: [u8; 3]) -> Option<&str> {
    let class = ClassTables::new(colors).unwrap().classify(rgb);
    colors.get(usize::from(class)).map(|color| color.name.as_str())
}

const RED: [u8; 3] = [150, 40, 40];
const VIOLET: [u8; 3] = [120, 60, 150];
const GREEN: [u8; 3] = [50, 130, 60];
const FLOOR: [u8; 3] = [60, 62, 58];

fn learned() -> Vec<ColorConfig> {
    let colors = ["red", "violet", "green"].map(color);
    let dark = |rgb: [u8; 3]| rgb.map(|value| value / 2);
    let samples = samples(
        &[&[RED, dark(RED)], &[VIOLET, dark(VIOLET)], &[GREEN, dark(GREEN)]],
        &[FLOOR, [20, 20, 20], [200, 200, 200]],
    );
    learn(&colors, &samples, &Objective::default())
}

#[test]
fn colors_are_told_apart_and_from_the_floor() {
    let colors = learned();
    for (rgb, name) in [(RED, "red"), (VIOLET, "violet"), (GREEN, "green")] {
        for part in [0.5, 0.75, 1.0, 1.15] {
            let shade = rgb.map(|value| (f64::from(value) * part) as u8);
            assert_eq!(classify(&colors, shade), Some(name), "{shade:?} {colors:#?}");
        }
    }
    for grey in [FLOOR, [20, 20, 20], [200, 200, 200], [120, 120, 120]] {
        assert_eq!(classify(&colors, grey), None, "{grey:?} {colors:#?}");
    }
}

#[test]
fn margins_are_wide_and_even() {
    // The gap between red (0°) and violet (about 280°) is shared in equal parts.
    let colors = learned();
    let hue_of = |name: &str| {
        let color = colors.iter().find(|color| color.name == name).unwrap();
        color.hue_deg.unwrap_or_else(|| panic!("{colors:#?}"))
    };
    let bounds = [hue_of("red")[0], hue_of("violet")[1]];
    assert!(bounds.iter().any(|bound| (300.0..345.0).contains(bound)), "{bounds:?}");
}

#[test]
fn colors_without_samples_are_left_out() {
    let colors = ["red", "blue"].map(color);
    let samples = samples(&[&[RED]], &[FLOOR]);
    let learned = learn(&colors, &samples, &Objective::default());
    assert_eq!(learned.len(), 1);
    assert_eq!(learned[0].name, "red");
}
