//! Light on the pitch: brightest a little off the middle, darker towards the corners and to one side, with
//! the colour of a lamp, and mirrored in one place.

use config::Config;
use messages::BayerOrder;

/// Illumination of each pixel: factor on painted colours, and added glare.
#[derive(Debug, Clone, Copy)]
pub struct Light {
    order: BayerOrder,
    center_px: [f32; 2],
    brightness: f32,
    /// Loss per square pixel of distance.
    fall_px2: f32,
    /// Loss per column.
    fall_px: f32,
    /// Factors of red, green and blue.
    channels: [f32; 3],
    glare_px: [f32; 2],
    glare_radius_px: f32,
    /// Grey levels in the middle of the glare.
    glare: f32,
}

/// Colour temperature under which colours look as configured.
const NEUTRAL_K: f64 = 6500.0;

impl Light {
    /// The configured light for the configured picture.
    pub fn new(config: &Config) -> Self {
        let (width, height) = (config.camera.width as f32, config.camera.height as f32);
        let center_px = [0.46 * width, 0.54 * height];
        // The farthest corner gets the full vignette.
        let farthest2 = (width - center_px[0]).powi(2) + center_px[1].powi(2);
        let synthetic = &config.synthetic;
        let vignette = synthetic.vignette.clamp(0.0, 1.0) as f32;
        Self {
            order: config.camera.bayer_order,
            center_px,
            brightness: synthetic.brightness.max(0.0) as f32,
            fall_px2: vignette / farthest2,
            fall_px: synthetic.gradient.clamp(0.0, 1.0) as f32 / width,
            channels: channels(synthetic.color_temperature_k),
            glare_px: [0.3 * width, 0.35 * height],
            glare_radius_px: 0.12 * width,
            glare: 255.0 * synthetic.glare.clamp(0.0, 1.0) as f32,
        }
    }

    /// Factor on a painted colour at a pixel.
    pub fn at(&self, column: usize, row: usize) -> f32 {
        let (x, y) = (column as f32 - self.center_px[0], row as f32 - self.center_px[1]);
        let falls = (1.0 - (x * x + y * y) * self.fall_px2) * (1.0 - column as f32 * self.fall_px);
        self.brightness * falls * self.channels[self.order.channel_at(column, row)]
    }

    /// Brightness of the mirrored lamp at a pixel, grey levels, independent of what is painted there.
    pub fn glare_at(&self, column: usize, row: usize) -> f32 {
        if self.glare == 0.0 {
            return 0.0;
        }
        let (x, y) = (column as f32 - self.glare_px[0], row as f32 - self.glare_px[1]);
        let distance2 = (x * x + y * y) / (self.glare_radius_px * self.glare_radius_px);
        self.glare * (-2.0 * distance2).exp() * self.channels[self.order.channel_at(column, row)]
    }
}

/// Red, green and blue of a black body relative to one at [`NEUTRAL_K`], with green 1: Planck's law at 600,
/// 540 and 450 nm.
fn channels(temperature_k: f64) -> [f32; 3] {
    /// hc/k in nanometre kelvins.
    const SECOND_RADIATION_CONSTANT: f64 = 1.4388e7;
    let temperature_k = temperature_k.max(1000.0);
    let gain = |wavelength_nm: f64| {
        let exponent = SECOND_RADIATION_CONSTANT / wavelength_nm;
        (exponent / NEUTRAL_K).exp_m1() / (exponent / temperature_k).exp_m1()
    };
    let green = gain(540.0);
    [600.0, 540.0, 450.0].map(|wavelength_nm| (gain(wavelength_nm) / green) as f32)
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

    #[test]
    fn warm_lamps_are_red_and_cold_ones_blue() {
        let [red, green, blue] = channels(3000.0);
        assert!(red > 1.4 && green == 1.0 && blue < 0.5, "{red} {blue}");
        let [red, _, blue] = channels(10_000.0);
        assert!(red < 0.95 && blue > 1.1, "{red} {blue}");
        assert_eq!(channels(NEUTRAL_K), [1.0; 3]);
    }

    #[test]
    fn gradient_and_glare_are_where_configured() {
        let mut config = Config::default();
        config.synthetic.vignette = 0.0;
        config.synthetic.gradient = 0.5;
        config.synthetic.glare = 0.4;
        let light = Light::new(&config);
        assert!((light.at(0, 100) - 1.0).abs() < 1e-3);
        assert!((light.at(639, 300) - 0.5).abs() < 2e-3);
        assert!((light.glare_at(192, 168) - 102.0).abs() < 0.5);
        assert!(light.glare_at(600, 400) < 0.01);
    }
}
