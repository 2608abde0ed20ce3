//! Writes pictures of the synthetic match to files: `cargo run --release -p touchline-grabber --example look
//! -- FOLDER [PRESET [FRAME…]]`.

use config::{Config, Preset};
use messages::BayerOrder;
use std::path::Path;
use touchline_grabber::synthetic::SyntheticMatch;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or("which folder?")?;
    let name = arguments.next().unwrap_or_else(|| Preset::default().name().to_string());
    let preset = Preset::ALL.into_iter().find(|preset| preset.name() == name);
    let config = preset.ok_or(format!("there is no preset {name}"))?.config();
    let mut frames: Vec<u64> = arguments.map(|frame| frame.parse()).collect::<Result<_, _>>()?;
    if frames.is_empty() {
        frames = vec![0, 200, 1000];
    }
    frames.sort_unstable();

    let (width, height) = (config.camera.width as usize, config.camera.height as usize);
    let mut scene = SyntheticMatch::new(&config)?;
    let mut pixels = vec![0; width * height];
    for frame in frames {
        while scene.frame_number() < frame {
            scene.advance();
        }
        scene.render(&mut pixels, width);
        let path = Path::new(&folder).join(format!("{name}-{frame:05}.png"));
        save(&path, &config, &pixels)?;
        println!("{}", path.display());
    }
    Ok(())
}

fn save(path: &Path, config: &Config, pixels: &[u8]) -> Result<(), image::ImageError> {
    let (width, height) = (config.camera.width, config.camera.height);
    let mut picture = image::RgbImage::new(width, height);
    for (column, row, rgb) in picture.enumerate_pixels_mut() {
        rgb.0 = color_at(pixels, [width, height], config.camera.bayer_order, [column, row]);
    }
    picture.save(path)
}

/// For each channel, the mean of the nearest sites.
fn color_at(
    pixels: &[u8],
    [width, height]: [u32; 2],
    order: BayerOrder,
    [x, y]: [u32; 2],
) -> [u8; 3] {
    let mut sums = [(0u32, 0u32); 3];
    for row in y.saturating_sub(1)..(y + 2).min(height) {
        for column in x.saturating_sub(1)..(x + 2).min(width) {
            let channel = order.channel_at(column as usize, row as usize);
            // A pixel's own channel needs no neighbours; green uses direct neighbours only.
            let own = order.channel_at(x as usize, y as usize);
            let diagonal = row != y && column != x;
            let counts =
                if channel == own { (row, column) == (y, x) } else { channel != 1 || !diagonal };
            if counts {
                sums[channel].0 += u32::from(pixels[(row * width + column) as usize]);
                sums[channel].1 += 1;
            }
        }
    }
    sums.map(|(sum, count)| (sum / count.max(1)) as u8)
}
