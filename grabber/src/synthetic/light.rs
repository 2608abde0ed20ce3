//! Light on the pitch: brightest a little off the middle, darker towards the corners.

use common::config::Config;

/// What part of a painted colour reaches the sensor, pixel by pixel.
#[derive(Debug, Clone, Copy)]
pub struct Light {
    center_px: [f32; 2],
    brightness: f32,
    /// Loss per square pixel of distance.
    fall_px2: f32,
}

impl Light {
    /// The configured light for the configured picture.
    pub fn new(config: &Config) -> Self {
        let (width, height) = (config.camera.width as f32, config.camera.height as f32);
        let center_px = [0.46 * width, 0.54 * height];
        // The corner that is farthest away gets the full vignette.
        let farthest2 = (width - center_px[0]).powi(2) + center_px[1].powi(2);
        let vignette = config.synthetic.vignette.clamp(0.0, 1.0) as f32;
        Self {
            center_px,
            brightness: config.synthetic.brightness.max(0.0) as f32,
            fall_px2: vignette / farthest2,
        }
    }

    /// The part at a pixel.
    pub fn at(&self, column: usize, row: usize) -> f32 {
        let (x, y) = (column as f32 - self.center_px[0], row as f32 - self.center_px[1]);
        self.brightness * (1.0 - (x * x + y * y) * self.fall_px2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_falls_from_the_middle_to_the_corners_as_configured() {
        let mut config = Config::default();
        config.synthetic.brightness = 0.9;
        config.synthetic.vignette = 0.3;
        let light = Light::new(&config);
        let samples: Vec<f32> =
            (0..480).flat_map(|row| (0..640).map(move |column| light.at(column, row))).collect();
        let brightest = samples.iter().copied().fold(0.0, f32::max);
        let darkest = samples.iter().copied().fold(9.0, f32::min);
        assert!((brightest - 0.9).abs() < 1e-3, "{brightest}");
        assert!((darkest - 0.9 * 0.7).abs() < 2e-3, "{darkest}");
    }
}
