//! Rolling shutter: each row of the picture is captured at a time of its own.
//!
//! A frame has one capture time, that of its middle row. What moves and is seen farther down was
//! measured later, and is a little ahead of where it was at that time: by 5 mm at 2 m/s and 2.5 ms. What
//! is known of its speed takes that off again.

use crate::blend::Wrap;
use crate::track::Candidate;
use common::config::CameraConfig;
use common::messages::FrameHeader;
use nalgebra::{SMatrix, SVector};

/// When the rows of a frame are captured.
#[derive(Debug, Clone, Copy)]
pub struct RollingShutter {
    /// From the first row to the last; 0 when all are captured at once.
    readout_s: f64,
}

/// How fast what is measured changes, and how well that is known: per second, and per second squared.
#[derive(Debug, Clone, Copy)]
pub struct Rates<const Z: usize> {
    /// Expected.
    pub mean: SVector<f64, Z>,
    /// Its covariance.
    pub covariance: SMatrix<f64, Z, Z>,
}

impl RollingShutter {
    /// That of the configured camera.
    pub fn new(camera: &CameraConfig) -> Self {
        Self { readout_s: f64::from(camera.rolling_shutter_us) * 1e-6 }
    }

    /// How long after the frame's capture time one of its rows was captured, in seconds; negative for
    /// those above the middle. What lies outside the picture counts as its nearest row.
    pub fn delay_s(&self, y_px: f32, frame: &FrameHeader) -> f64 {
        if self.readout_s == 0.0 || !y_px.is_finite() || frame.height < 2 {
            return 0.0;
        }
        let part = f64::from(y_px) / f64::from(frame.height - 1);
        (part.clamp(0.0, 1.0) - 0.5) * self.readout_s
    }
}

impl<const Z: usize> Rates<Z> {
    /// A measurement that was taken `delay_s` after the frame's time, as it would have been at that
    /// time; `wrap` wraps its angles.
    pub fn take_off(&self, delay_s: f64, candidate: Candidate<Z>, wrap: Wrap<Z>) -> Candidate<Z> {
        if delay_s == 0.0 {
            return candidate;
        }
        let mut measured = candidate.measured - self.mean * delay_s;
        wrap(&mut measured);
        Candidate {
            measured,
            noise: candidate.noise + self.covariance * (delay_s * delay_s),
            ..candidate
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_have_their_times() {
        let camera = CameraConfig { rolling_shutter_us: 10_000, ..CameraConfig::default() };
        let frame = FrameHeader { height: 481, ..FrameHeader::default() };
        let delay_s = |y_px: f32| RollingShutter::new(&camera).delay_s(y_px, &frame);
        assert_eq!([0.0, 240.0, 480.0].map(delay_s), [-0.005, 0.0, 0.005]);
        assert_eq!([-1e9, 1e9].map(delay_s), [-0.005, 0.005]);
        assert_eq!([f32::NAN, f32::INFINITY].map(delay_s), [0.0, 0.0]);
        let unknown = FrameHeader::default();
        assert_eq!(RollingShutter::new(&camera).delay_s(3.0, &unknown), 0.0);
        assert_eq!(RollingShutter::new(&CameraConfig::default()).delay_s(3.0, &frame), 0.0);
    }
}
