//! The bytes: reproducibility, borders, mosaic, noise.

use super::*;
use config::Preset;

fn quiet(config: &Config) -> Config {
    let mut config = config.clone();
    config.synthetic.noise = 0.0;
    config
}

#[test]
fn the_same_seed_gives_the_same_match_pixel_for_pixel() {
    let config = Config::default();
    let (mut a, mut b) = (scene_at(&config, 0), scene_at(&config, 0));
    for _ in 0..50 {
        a.advance();
        b.advance();
        assert_eq!(render(&mut a, &config), render(&mut b, &config));
        assert_eq!(a.truth(), b.truth());
        assert_eq!(a.commands(), b.commands());
    }
    let mut other = config.clone();
    other.synthetic.seed += 1;
    let mut other_scene = scene_at(&other, 50);
    assert_ne!(other_scene.truth(), a.truth());
    assert_ne!(render(&mut other_scene, &other), render(&mut a, &config));
}

#[test]
fn rendering_overwrites_all_memory() {
    let config = Config::default();
    let (width, height) = (config.camera.width as usize, config.camera.height as usize);
    let mut scene = scene_at(&config, 7);
    let mut zeros = vec![0; width * height];
    let mut ones = vec![0xFF; width * height];
    scene.render(&mut zeros, width);
    scene.render(&mut ones, width);
    // The noise is a function of the frame, not of the call.
    assert_eq!(zeros, ones);
    scene.advance();
    scene.render(&mut ones, width);
    assert_ne!(zeros, ones);
}

#[test]
fn bytes_between_rows_are_left_alone() {
    let config = Config::default();
    let (width, height) = (config.camera.width as usize, config.camera.height as usize);
    let stride = width + 24;
    let mut scene = scene_at(&config, 3);
    let tight = render(&mut scene, &config);
    // The last row needs no padding.
    let mut wide = vec![0x5A; stride * (height - 1) + width];
    scene.render(&mut wide, stride);
    for (row, bytes) in wide.chunks(stride).enumerate() {
        assert_eq!(bytes[..width], tight[row * width..(row + 1) * width]);
        assert!(bytes[width..].iter().all(|&byte| byte == 0x5A));
    }
}

#[test]
fn drawing_what_moved_equals_drawing_everything() {
    for preset in Preset::ALL {
        let config = quiet(&preset.config());
        let mut every_frame = scene_at(&config, 0);
        let mut now_and_then = scene_at(&config, 0);
        for frame in 1..=60 {
            every_frame.advance();
            now_and_then.advance();
            let shown = render(&mut every_frame, &config);
            if frame % 20 == 0 {
                assert_eq!(shown, render(&mut now_and_then, &config));
                assert_eq!(shown, render(&mut scene_at(&config, frame), &config));
            }
        }
    }
}

#[test]
fn the_bayer_orders_show_the_same_scene() {
    let config = quiet(&Config::default());
    let width = config.camera.width as usize;
    let pictures = BayerOrder::ALL.map(|order| {
        let mut config = config.clone();
        config.camera.bayer_order = order;
        (order, render(&mut scene_at(&config, 40), &config))
    });
    for (order, picture) in &pictures {
        for (other_order, other) in &pictures {
            let mut compared = 0;
            for index in 0..picture.len() {
                let (column, row) = (index % width, index / width);
                if order.channel_at(column, row) == other_order.channel_at(column, row) {
                    assert_eq!(picture[index], other[index], "{order:?} {other_order:?}");
                    compared += 1;
                }
            }
            // RGGB and BGGR share the green sites, RGGB and GRBG none.
            let same = order.red_site() == other_order.red_site();
            let diagonal = order.red_site().0 != other_order.red_site().0
                && order.red_site().1 != other_order.red_site().1;
            let share = if same { 1 } else { 2 };
            let expected = if same || diagonal { picture.len() / share } else { 0 };
            assert_eq!(compared, expected, "{order:?} {other_order:?}");
        }
    }
}

#[test]
fn noise_is_as_strong_as_configured_and_fresh_in_every_frame() {
    let mut config = Config::default();
    config.synthetic.noise = 3.0;
    // Nothing moves, so frames differ in their noise only.
    config.robots.identities.clear();
    let clean = render(&mut scene_at(&quiet(&config), 5), &config);
    let mut scene = scene_at(&config, 5);
    let first = render(&mut scene, &config);
    scene.advance();
    let second = render(&mut scene, &config);
    let statistics = |a: &[u8], b: &[u8]| {
        let differences = || a.iter().zip(b).map(|(&a, &b)| f64::from(a) - f64::from(b));
        let count = a.len() as f64;
        let mean = differences().sum::<f64>() / count;
        (mean, (differences().map(|d| (d - mean) * (d - mean)).sum::<f64>() / count).sqrt())
    };
    let (mean, sigma) = statistics(&first, &clean);
    // Rounding adds 1/12 to the variance.
    assert!(mean.abs() < 0.05 && (sigma - 3.01).abs() < 0.1, "{mean} {sigma}");
    let (mean, sigma) = statistics(&first, &second);
    assert!(mean.abs() < 0.05 && (sigma - 3.01 * 2f64.sqrt()).abs() < 0.15, "{mean} {sigma}");
    // Repeated rows would be visible as stripes.
    let width = config.camera.width as usize;
    let noise: Vec<i16> =
        first.iter().zip(&clean).map(|(&a, &b)| i16::from(a) - i16::from(b)).collect();
    let rows: std::collections::HashSet<&[i16]> = noise.chunks(width).collect();
    assert_eq!(rows.len(), config.camera.height as usize);
}

#[test]
fn brightness_and_vignette_are_as_configured() {
    let mut config = quiet(&Config::default());
    config.synthetic.vignette = 0.0;
    let plain = render(&mut scene_at(&config, 0), &config);
    config.synthetic.brightness = 0.5;
    let half = render(&mut scene_at(&config, 0), &config);
    let sum = |pixels: &[u8]| pixels.iter().map(|&pixel| u64::from(pixel)).sum::<u64>() as f64;
    assert!((sum(&half) / sum(&plain) - 0.5).abs() < 0.01);
    config.synthetic.brightness = 8.0;
    let glaring = render(&mut scene_at(&config, 0), &config);
    assert!(glaring.iter().filter(|&&pixel| pixel == 255).count() > glaring.len() / 10);
}
