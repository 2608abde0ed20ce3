//! Guarantees of the synthetic match, tested from outside.

mod accuracy;
mod colors;
mod game;
mod pixels;

use super::SyntheticMatch;
use config::Config;
use messages::BayerOrder;

/// A picture with all three channels of every pixel.
struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<[f64; 3]>,
}

impl Picture {
    fn at(&self, column: usize, row: usize) -> [f64; 3] {
        self.pixels[row * self.width + column]
    }
}

/// Renders the current frame.
fn render(scene: &mut SyntheticMatch, config: &Config) -> Vec<u8> {
    let width = config.camera.width as usize;
    let mut pixels = vec![0xA5; width * config.camera.height as usize];
    scene.render(&mut pixels, width);
    pixels
}

/// The match at a given frame.
fn scene_at(config: &Config, frame: u64) -> SyntheticMatch {
    let mut scene = SyntheticMatch::new(config).unwrap();
    for _ in 0..frame {
        scene.advance();
    }
    scene
}

/// The picture before the mosaic, assembled from all four Bayer orders.
fn full_color(config: &Config, frame: u64) -> Picture {
    let (width, height) = (config.camera.width as usize, config.camera.height as usize);
    let mut pixels = vec![[f64::NAN; 3]; width * height];
    for order in BayerOrder::ALL {
        let mut config = config.clone();
        config.camera.bayer_order = order;
        let raw = render(&mut scene_at(&config, frame), &config);
        for (index, &value) in raw.iter().enumerate() {
            let channel = order.channel_at(index % width, index / width);
            pixels[index][channel] = f64::from(value);
        }
    }
    Picture { width, height, pixels }
}

/// Bilinear demosaicing, eqs. (1)–(3): for each channel the mean of the nearest sites.
fn demosaic(raw: &[u8], width: usize, height: usize, order: BayerOrder) -> Picture {
    let pixels = (0..width * height)
        .map(|index| {
            let (x, y) = (index % width, index / width);
            let own = order.channel_at(x, y);
            std::array::from_fn(|channel| {
                let (mut sum, mut count) = (0.0, 0.0);
                for row in y.saturating_sub(1)..(y + 2).min(height) {
                    for column in x.saturating_sub(1)..(x + 2).min(width) {
                        let here = (column, row) == (x, y);
                        let diagonal = column != x && row != y;
                        if order.channel_at(column, row) == channel
                            && (here || own != channel)
                            && (channel != 1 || !diagonal)
                        {
                            sum += f64::from(raw[row * width + column]);
                            count += 1.0;
                        }
                    }
                }
                f64::floor(sum / count)
            })
        })
        .collect();
    Picture { width, height, pixels }
}
