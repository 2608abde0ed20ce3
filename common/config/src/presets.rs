//! Presets: the leagues' fields, with matching colours and layouts.

use super::layouts::{
    butterfly, corner_patch, diagonal_squares, identities_of_colors, one_color_identities,
    quadrants, standard_patterns, stripe_and_two_patches, three_color_identities, triangles,
    two_color_identities,
};
use super::*;
use messages::BayerOrder;

/// A league whose values are the defaults of a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// FIRA MiroSot middle league, 5 against 5, 2200×1800 mm; the paper's set-up.
    #[default]
    #[serde(rename = "mirosot-5v5")]
    Mirosot5v5,
    /// The same league; half of a robot's top, cut along the diagonal, has the team's colour, the other
    /// half has two triangles in identification colours.
    MirosotTriangles,
    /// The same league; four squares, one in the team's colour and three in identification colours.
    MirosotQuadrants,
    /// FIRA MiroSot large league, 11 against 11, 4000×2800 mm.
    MirosotLarge,
    /// IEEE Very Small Size Soccer, 3 against 3, 1500×1300 mm.
    #[serde(rename = "vsss-3v3")]
    Vsss3v3,
    /// The same league; the whole top has the team's colour, except for a square in one corner.
    VsssCorner,
    /// RoboCup Small Size League, division B, 9000×6000 mm, with the standard pattern: a dot of the
    /// team's colour in the middle, four pink or green ones around it.
    SslDivisionB,
}

impl Preset {
    /// All presets.
    pub const ALL: [Preset; 7] = [
        Self::Mirosot5v5,
        Self::MirosotTriangles,
        Self::MirosotQuadrants,
        Self::MirosotLarge,
        Self::Vsss3v3,
        Self::VsssCorner,
        Self::SslDivisionB,
    ];

    /// Name in a configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mirosot5v5 => "mirosot-5v5",
            Self::MirosotTriangles => "mirosot-triangles",
            Self::MirosotQuadrants => "mirosot-quadrants",
            Self::MirosotLarge => "mirosot-large",
            Self::Vsss3v3 => "vsss-3v3",
            Self::VsssCorner => "vsss-corner",
            Self::SslDivisionB => "ssl-division-b",
        }
    }

    /// Description in one line.
    pub fn describe(self) -> &'static str {
        match self {
            Self::Mirosot5v5 => "MiroSot middle league: two squares on a diagonal, as in the paper",
            Self::MirosotTriangles => "the same: half a square and two identification triangles",
            Self::MirosotQuadrants => "the same: four squares, three of them identification",
            Self::MirosotLarge => "MiroSot large league: a stripe and two identification squares",
            Self::Vsss3v3 => "Very Small Size Soccer: two squares on a diagonal",
            Self::VsssCorner => "the same: a square with an identification patch in one corner",
            Self::SslDivisionB => "RoboCup Small Size League: a dot and four around it",
        }
    }

    /// The complete configuration of the league.
    pub fn config(self) -> Config {
        let mut config = Config {
            preset: self,
            field: FieldConfig::default(),
            camera: CameraConfig::default(),
            geometry: GeometryConfig::default(),
            light: LightConfig { pitch_rgb: Some(STANDARD_PITCH), ..LightConfig::default() },
            colors: standard_colors(),
            teams: TeamsConfig::default(),
            ball: BallConfig::default(),
            robots: RobotsConfig::default(),
            tracker: TrackerConfig::default(),
            filter: FilterConfig::default(),
            supervisor: SupervisorConfig::default(),
            access: AccessConfig::default(),
            publish: PublishConfig::default(),
            console: ConsoleConfig::default(),
            scheduling: SchedulingConfig::default(),
            synthetic: SyntheticConfig::default(),
        };
        match self {
            Self::Mirosot5v5 => {}
            Self::MirosotTriangles => {
                config.robots.patches = triangles();
                config.robots.identities = two_color_identities(5);
            }
            Self::MirosotQuadrants => {
                config.robots.patches = quadrants();
                config.robots.identities = three_color_identities(5);
            }
            Self::MirosotLarge => {
                config.field = FieldConfig {
                    length_mm: 4000.0,
                    width_mm: 2800.0,
                    center_circle_radius_mm: 250.0,
                    ..FieldConfig::default()
                };
                config.camera.width = 1280;
                config.camera.height = 960;
                config.geometry =
                    GeometryConfig::above(&config.field, config.camera.picture_px(), 4000.0);
                config.robots.patches = stripe_and_two_patches();
                config.robots.identities = two_color_identities(11);
            }
            Self::Vsss3v3 | Self::VsssCorner => {
                config.field = FieldConfig {
                    length_mm: 1500.0,
                    width_mm: 1300.0,
                    goal_width_mm: 400.0,
                    goal_depth_mm: 100.0,
                    center_circle_radius_mm: 200.0,
                    ..FieldConfig::default()
                };
                config.geometry =
                    GeometryConfig::above(&config.field, config.camera.picture_px(), 2000.0);
                config.robots.identities = one_color_identities(3);
                if self == Self::VsssCorner {
                    config.robots.patches = corner_patch();
                }
            }
            Self::SslDivisionB => {
                config.field = FieldConfig {
                    length_mm: 9000.0,
                    width_mm: 6000.0,
                    goal_width_mm: 1000.0,
                    goal_depth_mm: 180.0,
                    center_circle_radius_mm: 500.0,
                    margin_mm: 300.0,
                    ..FieldConfig::default()
                };
                config.camera.width = 1920;
                config.camera.height = 1200;
                config.geometry = GeometryConfig::with_border(
                    &config.field,
                    config.camera.picture_px(),
                    6000.0,
                    200.0,
                );
                config.robots = RobotsConfig {
                    shape: RobotShape::Round,
                    size_mm: 180.0,
                    front_mm: Some(75.0),
                    height_mm: 140.0,
                    wheel_base_mm: 140.0,
                    patches: butterfly(),
                    report_unknown: false,
                    identities: identities_of_colors(standard_patterns()),
                };
                config.publish.markings = MarkingsConfig::ssl_division_b();
            }
        }
        config
    }
}

impl Default for Config {
    fn default() -> Self {
        Preset::default().config()
    }
}

impl Default for CameraConfig {
    fn default() -> Self {
        Self {
            width: 640,
            height: 480,
            fps: 80.0,
            bayer_order: BayerOrder::Rggb,
            mirrored: false,
            exposure_us: 2000,
            rolling_shutter_us: 0,
            v4l2: V4l2Config::default(),
            genicam: GenicamConfig::default(),
        }
    }
}

impl Default for LightConfig {
    fn default() -> Self {
        Self { follow: true, pitch_rgb: None, brightness: 0.5, unevenness: 0.0, glare: false }
    }
}

impl Default for TeamsConfig {
    fn default() -> Self {
        Self { yellow: "yellow".into(), blue: "blue".into() }
    }
}

impl Default for BallConfig {
    fn default() -> Self {
        Self { color: "orange".into(), diameter_mm: 42.7 }
    }
}

impl Default for RobotsConfig {
    fn default() -> Self {
        Self {
            shape: RobotShape::Square,
            size_mm: 75.0,
            front_mm: None,
            height_mm: 75.0,
            wheel_base_mm: 65.0,
            patches: diagonal_squares(),
            report_unknown: false,
            identities: one_color_identities(5),
        }
    }
}

impl Default for TrackerConfig {
    fn default() -> Self {
        Self {
            min_region_px: 8,
            min_area_ratio: 0.35,
            max_area_ratio: 2.2,
            patch_tolerance_mm: 12.0,
        }
    }
}

impl Default for FilterConfig {
    fn default() -> Self {
        Self {
            position_noise_mm: 0.5,
            heading_noise_deg: 1.0,
            repeat_distance_mm: 0.8,
            acceleration_noise_mm_s2: 4000.0,
            angular_acceleration_noise_deg_s2: 3000.0,
            command_noise_mm_s: 20.0,
            command_noise_deg_s: 20.0,
            lateral_noise_mm_s: 10.0,
            collision_factor: 16.0,
            command_lag_ms: 0.0,
            command_timeout_ms: 250.0,
            actuation_delay_ms: 50.0,
            gate_chi2: 30.0,
            reinit_after: 3,
            start_confidence: 0.2,
            forget_after_ms: 1000.0,
            ball_noise_mm: 1.0,
            ball_acceleration_noise_mm_s2: 700.0,
            ball_kick_factor: 200.0,
            ball_friction_per_s: 0.3,
        }
    }
}

impl Default for SupervisorConfig {
    fn default() -> Self {
        Self {
            stall_frames: 2.5,
            stall_min_ms: 35.0,
            ready_timeout_ms: 10_000.0,
            backoff_ms: 100.0,
            backoff_max_ms: 5_000.0,
            spares: vec![SpareStage::Classifier, SpareStage::Tracker, SpareStage::Filter],
            orphan_timeout_s: 600.0,
        }
    }
}

impl Default for SchedulingConfig {
    fn default() -> Self {
        Self {
            wake_up: WakeUpStrategy::Event,
            realtime_priority: 0,
            lock_memory: false,
            keep_awake: false,
            cpus: StageCpus::default(),
        }
    }
}

impl Default for SyntheticConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            unknown_opponents: 0,
            max_speed_mm_s: 1500.0,
            max_acceleration_mm_s2: 3000.0,
            slip: 0.0,
            floor_rgb: [26, 30, 29],
            brightness: 1.0,
            vignette: 0.25,
            gradient: 0.0,
            color_temperature_k: 6500.0,
            glare: 0.0,
            defocus_px: 0.0,
            noise: 2.0,
        }
    }
}

/// Median colour of the synthetic pitch under the lamps for which [`standard_colors`] are made.
const STANDARD_PITCH: [f64; 3] = [24.9, 28.2, 27.2];

/// Colours of the synthetic pitch, with boxes that hold from its bright middle to its corners.
///
/// A pixel at the edge of a patch shows part patch, part dark robot: the same colour, but darker. So
/// even a dark version of a colour must not fall into another colour's box. Each box therefore starts
/// at about half the patch's brightness and is narrow where a neighbouring colour is near. Grey (lines,
/// walls) lies in no box.
fn standard_colors() -> Vec<ColorConfig> {
    let color = |name: &str, looks, red, green, blue| ColorConfig {
        name: name.into(),
        red,
        green,
        blue,
        hue_deg: None,
        saturation: None,
        y: None,
        u: None,
        v: None,
        looks,
    };
    vec![
        color("orange", [235, 90, 25], [138, 255], [43, 112], [0, 55]),
        color("yellow", [225, 205, 40], [115, 255], [113, 255], [0, 75]),
        color("blue", [35, 70, 215], [0, 56], [20, 94], [115, 255]),
        color("green", [40, 180, 60], [0, 70], [98, 230], [0, 85]),
        color("cyan", [45, 190, 210], [0, 75], [95, 240], [105, 255]),
        color("pink", [240, 105, 180], [145, 255], [52, 122], [90, 225]),
        color("violet", [115, 45, 205], [59, 140], [0, 70], [116, 255]),
        color("red", [210, 25, 45], [122, 255], [0, 41], [0, 72]),
    ]
}
