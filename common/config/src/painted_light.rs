//! The light of the synthetic match.

use crate::{Config, LightConfig, SyntheticConfig};

/// Configures the light correction for painted light: it acts on floor and patches alike, and glare looks
/// like glare. Settings that differ from the preset's are left unchanged.
pub fn follow_painted_light(config: &mut Config) {
    if config.light == config.preset.config().light {
        config.light = painted(config.light.clone());
    }
}

/// The settings of painted light applied to any light.
pub fn painted(light: LightConfig) -> LightConfig {
    LightConfig { brightness: 1.0, unevenness: 1.0, glare: true, ..light }
}

/// Whether the synthetic match is played under other lamps than those for which the presets' colours are
/// made.
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
