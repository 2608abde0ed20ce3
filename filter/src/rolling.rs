//! What a [rolling shutter](common::rolling_shutter) does to measurements.
//!
//! What moves and is seen below the middle of the picture was measured after the frame's time, and
//! is a little ahead of where it was then: by 5 mm at 2 m/s and 2.5 ms. What is known of its speed takes
//! that off again.

use crate::blend::Wrap;
use crate::track::Candidate;
use nalgebra::{SMatrix, SVector};

/// How fast what is measured changes, and how well that is known: per second, and per second squared.
#[derive(Debug, Clone, Copy)]
pub struct Rates<const Z: usize> {
    /// Expected.
    pub mean: SVector<f64, Z>,
    /// Its covariance.
    pub covariance: SMatrix<f64, Z, Z>,
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
