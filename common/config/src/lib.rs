//! The configuration: one TOML file, read once and handed to every process as a whole.
//!
//! The structures below are its only definition. Their doc comments become the comments of `touchline
//! config init` and the descriptions of the JSON schema; their `range` and `length` attributes become
//! its bounds, against which every value is checked; their `Default` is the MiroSot middle league
//! preset on a synthetic pitch. A new key needs a doc comment, bounds and a default, and nothing else.
//! Rules about more than one key are checked in `validate`.

mod access;
mod camera;
pub mod change;
mod console;
mod diagnostic;
mod document;
pub mod edit;
mod filter;
pub mod input;
mod layouts;
mod load;
pub mod painted_light;
mod presets;
mod problem;
mod processes;
mod publish;
mod robots;
mod schema;
pub mod snapshot;
mod synthetic;
mod validate;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use access::{AccessConfig, TeamsAccess};
pub use camera::{CameraConfig, GenicamConfig, SettingValue, V4l2Config};
pub use console::ConsoleConfig;
pub use diagnostic::{Diagnostic, Diagnostics, Place};
pub use document::{commented_toml, schema_json};
pub use filter::FilterConfig;
pub use geometry::settings::{
    DistortionConfig, DistortionModel, FieldConfig, GeometryConfig, Pair, PatchConfig, PatchRole,
    PointPair, RobotShape,
};
pub use load::{ConfigError, check, check_file};
pub use presets::Preset;
pub use problem::Problem;
pub use processes::{SchedulingConfig, SpareStage, StageCpus, SupervisorConfig, WakeUpStrategy};
pub use publish::{
    CommandsConfig, MarkingsConfig, Output, OutputConfig, PublishConfig, PublishedTopic, SslConfig,
    TrackedConfig,
};
pub use robots::{IdentityConfig, RobotsConfig, TeamConfig, TeamsConfig, Top};
pub use synthetic::SyntheticConfig;

/// Touchline configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// The defaults for everything below. "mirosot-5v5" (2200×1800 mm; also "mirosot-triangles" and
    /// "mirosot-quadrants", with other patches), "mirosot-large" (4000×2800 mm, 11 against 11),
    /// "vsss-3v3" (1500×1300 mm; also "vsss-corner", with other patches) or "ssl-division-b" (9000×6000
    /// mm).
    pub preset: Preset,
    /// The pitch.
    pub field: FieldConfig,
    /// The camera's picture.
    pub camera: CameraConfig,
    /// Position of the camera and mapping from picture to field, for pictures of the size above.
    /// Defaults follow from field and picture: a camera above the middle that sees the whole field.
    pub geometry: GeometryConfig,
    /// The light, and whether the colours follow it.
    pub light: LightConfig,
    /// The colours on the pitch, at most 32. Where boxes overlap, the colour listed first wins.
    #[schemars(length(min = 1, max = 32))]
    pub colors: Vec<ColorConfig>,
    /// The two teams.
    pub teams: TeamsConfig,
    /// The ball.
    pub ball: BallConfig,
    /// The robots and the colour patches on their tops.
    pub robots: RobotsConfig,
    /// Recognition: from regions to robots.
    pub tracker: TrackerConfig,
    /// Filtering: from detections to poses.
    pub filter: FilterConfig,
    /// The process group.
    pub supervisor: SupervisorConfig,
    /// Which users and programs may attach to the group besides its owner.
    pub access: AccessConfig,
    /// Which of the leagues' own protocols are sent to other programs, and received from them; see
    /// docs/leagues.md. Nothing is sent unless a protocol is `enabled`.
    pub publish: PublishConfig,
    /// The page in a browser.
    pub console: ConsoleConfig,
    /// How stages wait for their input, and how the system schedules them.
    pub scheduling: SchedulingConfig,
    /// The synthetic match (`--source synthetic`).
    pub synthetic: SyntheticConfig,
}

/// The light under which the colours were set. If the pitch looks different, each channel of the
/// picture is corrected, so that other lamps and the camera's white balance do not matter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LightConfig {
    /// Whether the light is followed. false: pictures are not corrected.
    pub follow: bool,
    /// Red, green and blue of the empty pitch when the colours were set, as written by `touchline
    /// learn`. The preset's value belongs to the preset's colours, which are those of the synthetic
    /// match. A file with colours of its own and without this key has no correction.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(inner(range(min = 0, max = 255)), extend("examples" = [[48.5, 50, 41.2]]))]
    pub pitch_rgb: Option<[f64; 3]>,
    /// Share of a change in the pitch's brightness that applies to the patches, 0–1: little if the
    /// change is a lamp mirrored in a dark floor, all of it on a dull floor.
    #[schemars(range(min = 0, max = 1))]
    pub brightness: f64,
    /// Share of the pitch's unevenness in brightness that applies to the patches, 0–1: where the floor
    /// is darker than in its middle, colours may be darker by this share, in octaves. Measured by
    /// `touchline learn`; 0 switches it off. Needs `pitch_rgb`.
    #[schemars(range(min = 0, max = 1))]
    pub unevenness: f64,
    /// Whether colours are also found under glare: a mirrored lamp adds white light to a part of the
    /// picture, and what it adds to the floor is subtracted from everything there. For pitches whose
    /// floor is otherwise evenly lit.
    pub glare: bool,
}

/// One colour class: a box in RGB, thresholded as in section 4.2 of the paper, and optional bounds in
/// hue and saturation that classified pixels must also meet.
///
/// The paper finds YUV the better space for thresholds, since brightness is one of its axes, and only
/// advises against converting to it. If the camera delivers YUV, a colour may have a box there (`y`,
/// `u`, `v`), which is compared with the pixels as they arrive.
///
/// A colour with nothing but `looks` gets a box around it, as a start for `touchline learn`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ColorConfig {
    /// Name by which teams, ball and robots refer to it.
    #[schemars(length(min = 1))]
    pub name: String,
    /// Lowest and highest red value, 0–255.
    #[serde(default = "unbounded")]
    pub red: [u8; 2],
    /// Lowest and highest green value, 0–255.
    #[serde(default = "unbounded")]
    pub green: [u8; 2],
    /// Lowest and highest blue value, 0–255.
    #[serde(default = "unbounded")]
    pub blue: [u8; 2],
    /// Optional second look: range of hue in degrees (red 0, green 120, blue 240); [350, 20] passes
    /// through 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(inner(range(min = 0, max = 360)), extend("examples" = [[350, 20]]))]
    pub hue_deg: Option<[f64; 2]>,
    /// Optional second look: lowest and highest HSI saturation, 0–1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(inner(range(min = 0, max = 1)), extend("examples" = [[0.4, 1]]))]
    pub saturation: Option<[f64; 2]>,
    /// For cameras that deliver YUV: lowest and highest Y (brightness), 0–255. If any of `y`, `u` and
    /// `v` is given, these three are the colour's box in YUV pictures, and a missing one is unbounded.
    /// If none is given, YUV pixels are converted and compared with the RGB box.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("examples" = [[40, 235]]))]
    pub y: Option<[u8; 2]>,
    /// For cameras that deliver YUV: lowest and highest U (blue against yellow), 0–255, 128 is grey.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("examples" = [[90, 120]]))]
    pub u: Option<[u8; 2]>,
    /// For cameras that deliver YUV: lowest and highest V (red against cyan), 0–255, 128 is grey.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("examples" = [[150, 200]]))]
    pub v: Option<[u8; 2]>,
    /// Typical RGB value: for overlays, for painting the synthetic match, and for distinguishing robots
    /// whose patches are blurred.
    pub looks: [u8; 3],
}

fn unbounded() -> [u8; 2] {
    [0, 255]
}

impl ColorConfig {
    /// Ranges of red, green and blue around a typical value, wide enough for paint under other lamps
    /// and in shadow.
    pub fn box_around(looks: [u8; 3]) -> [[u8; 2]; 3] {
        looks.map(|value| {
            let value = f64::from(value);
            [value * 0.6 - 15.0, value * 1.4 + 25.0].map(|bound| bound.clamp(0.0, 255.0) as u8)
        })
    }

    /// The colour's own YUV box, if it has one: ranges of Y, U and V.
    pub fn yuv_box(&self) -> Option<[[u8; 2]; 3]> {
        let ranges = [self.y, self.u, self.v];
        let is_given = ranges.iter().any(Option::is_some);
        is_given.then(|| ranges.map(|range| range.unwrap_or([0, 255])))
    }
}

/// The ball.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BallConfig {
    /// Its colour.
    pub color: String,
    /// A golf ball: 42.7.
    #[schemars(range(min = 1, max = 1000))]
    pub diameter_mm: f64,
}

/// Recognition: from regions to robots.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TrackerConfig {
    /// A region smaller than this is noise.
    #[schemars(range(min = 1, max = 1_000_000))]
    pub min_region_px: u32,
    /// Smallest visible area of a patch, as a fraction of its expected area …
    #[schemars(range(min = 0, max = 1))]
    pub min_area_ratio: f64,
    /// … and largest, as a multiple of it.
    #[schemars(range(min = 1, max = 1000))]
    pub max_area_ratio: f64,
    /// Largest distance of an identification patch from its place in the layout, relative to the team
    /// patch (the tolerance around the distance in eq. 5).
    #[schemars(range(min = 0.1, max = 1000))]
    pub patch_tolerance_mm: f64,
}
