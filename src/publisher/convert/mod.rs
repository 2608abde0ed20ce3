//! From our messages to those of the leagues: pure, with the time of sending given.
//!
//! Positions and angles have the same axes everywhere; only units change. Robots without a known number are
//! left out: receivers of the leagues crash on them or drop them. The time of a packet is that of its frame,
//! the middle of the exposure on the wall clock, and frame numbers are those of our frames: they only rise,
//! whatever is restarted.

mod detection;
mod field;
mod firasim;
mod json;
#[cfg(test)]
mod tests;
mod tracked;

pub use detection::{of_detections, of_world};
pub use field::geometry;
pub use firasim::environment;
pub use json::json;
pub use tracked::tracked;

use config::Config;
use geometry::{CameraModel, GeometryError};
use messages::{FrameHeader, TrackStatus};
use offline::calibration::{Pinhole, PinholeError};

/// What conversions need besides a message.
pub struct Scene {
    config: Config,
    camera: CameraModel,
    /// The calibration in the leagues' form; `Err` says why there is none.
    pub pinhole: Result<Pinhole, PinholeError>,
    /// Number of each lane's camera in the league.
    camera_ids: Vec<u32>,
    /// Identifies this group among the trackers in the network.
    uuid: String,
}

impl Scene {
    /// Prepares conversions. `identity` names the group: the same text gives the same uuid.
    pub fn new(config: &Config, identity: &str) -> Result<Self, GeometryError> {
        let (field, picture) = (&config.field, &config.camera);
        let camera = CameraModel::new(&config.geometry, picture.width, picture.height)?;
        let pinhole = Pinhole::closest_to(
            &camera,
            [field.length_mm, field.width_mm],
            config.tallest_robot_mm(),
            [picture.width, picture.height],
        );
        Ok(Self {
            camera_ids: league_camera_ids(&[config.geometry.camera_mm]),
            camera,
            pinhole,
            uuid: uuid(identity),
            config: config.clone(),
        })
    }

    /// The configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Number of a frame's camera in the league.
    pub fn camera_id(&self, lane: u32) -> u32 {
        self.camera_ids.get(lane as usize).copied().unwrap_or(lane)
    }

    fn ball_radius_mm(&self) -> f64 {
        self.config.ball.diameter_mm / 2.0
    }
}

/// Camera numbers as the SSL counts them, for cameras at these positions: those of the half at −x first, and
/// in each half from −y to y.
pub fn league_camera_ids(positions_mm: &[[f64; 3]]) -> Vec<u32> {
    let key = |index: &usize| {
        let [x, y, _] = positions_mm[*index];
        (x > 0.0, y)
    };
    let mut order: Vec<usize> = (0..positions_mm.len()).collect();
    order.sort_by(|a, b| key(a).partial_cmp(&key(b)).unwrap_or(std::cmp::Ordering::Equal));
    let mut ids = vec![0; positions_mm.len()];
    for (id, index) in order.into_iter().enumerate() {
        ids[index] = id as u32;
    }
    ids
}

/// Time of capture, seconds since 1970.
fn captured_s(frame: &FrameHeader) -> f64 {
    seconds(frame.t_capture_wall_ns)
}

/// Nanoseconds as seconds.
pub fn seconds(ns: u64) -> f64 {
    ns as f64 * 1e-9
}

/// The leagues' frame numbers have 32 bits; at 200 frames a second they last for eight months.
fn frame_number(frame: &FrameHeader) -> u32 {
    frame.seq as u32
}

/// Whether a track exists: seen, or predicted for a while.
fn exists(status: u32) -> bool {
    TrackStatus::from_number(status).is_some_and(|status| status != TrackStatus::Absent)
}

/// A uuid that depends on a text alone: two FNV-1a hashes, with the bits of version 8 (RFC 9562).
fn uuid(identity: &str) -> String {
    let hash = |start: u64| {
        identity
            .bytes()
            .fold(start, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3))
    };
    let high = hash(0xcbf2_9ce4_8422_2325) & !0xf000 | 0x8000;
    let low = hash(0x6c62_272e_07bb_0142) >> 2 | 1 << 63;
    let (a, b, c) = (high >> 32, high >> 16 & 0xffff, high & 0xffff);
    format!("{a:08x}-{b:04x}-{c:04x}-{:04x}-{:012x}", low >> 48, low & 0xffff_ffff_ffff)
}
