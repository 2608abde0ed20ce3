//! Compensation of a [rolling shutter](geometry::rolling_shutter).
//!
//! An object seen in a row that is captured `d` later than the frame's time has moved by `d` times its
//! velocity meanwhile: 5 mm at 2 m/s and 2.5 ms. The measurement is moved back by that, `z' = z − d·ṙ`, and
//! its covariance grows by the uncertainty of the rates, `R' = R + d² C`.

use crate::imm::Wrap;
use crate::track::Candidate;
use nalgebra::{SMatrix, SVector};

/// Rates of change of the measured quantities, per second, and their uncertainty.
#[derive(Debug, Clone, Copy)]
pub struct Rates<const Z: usize> {
    /// Expected rates.
    pub mean: SVector<f64, Z>,
    /// Covariance of the rates.
    pub covariance: SMatrix<f64, Z, Z>,
}

impl<const Z: usize> Rates<Z> {
    /// Converts a measurement taken `delay_s` after the frame's time to that time; `wrap` wraps its angles.
    pub fn at_frame_time(
        &self,
        delay_s: f64,
        candidate: Candidate<Z>,
        wrap: Wrap<Z>,
    ) -> Candidate<Z> {
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
