//! The light of the synthetic match, and that which the presets' colours are made for.

use super::CommandError;
use classifier::lamp::PitchProbe;
use classifier::{BayerImage, Picture};
use common::config::{Config, LightConfig, SyntheticConfig};
use grabber::synthetic::SyntheticMatch;

/// How the pitch of the synthetic match looks under the lamps that the presets' colours are made for:
/// what `touchline learn` would have written down.
pub fn standard_light(config: &Config) -> Result<LightConfig, CommandError> {
    let mut standard = config.clone();
    standard.synthetic = Config::default().synthetic;
    let camera = &config.camera;
    let mut pixels = vec![0; camera.frame_bytes()];
    SyntheticMatch::new(&standard)?.render(&mut pixels, camera.width as usize);
    let image =
        BayerImage::new(&pixels, camera.width, camera.height, camera.width, camera.bayer_order)
            .ok_or("the configured picture is too small")?;
    let pitch_rgb = PitchProbe::new(config)?.measure(&Picture::Bayer(image));
    // Painted light acts on floor and patches alike.
    Ok(LightConfig { pitch_rgb, brightness: 1.0, unevenness: 1.0, glare: true })
}

/// Whether the synthetic match is played under other lamps than those.
pub fn is_other_light(config: &Config) -> bool {
    let lamps = |synthetic: &SyntheticConfig| {
        [
            synthetic.brightness,
            synthetic.vignette,
            synthetic.gradient,
            synthetic.color_temperature_k,
            synthetic.glare,
        ]
    };
    lamps(&config.synthetic) != lamps(&Config::default().synthetic)
}
