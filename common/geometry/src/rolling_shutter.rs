//! Rolling shutter: the rows of a picture are captured one after the other.
//!
//! A frame has one capture time, that of its middle row. With a readout time T from the first row to the
//! last of N rows, the capture time of row y differs from it by
//!
//! ```text
//! (y / (N − 1) − ½)·T
//! ```

/// Capture times of a frame's rows relative to the frame's capture time.
#[derive(Debug, Clone, Copy)]
pub struct RollingShutter {
    /// Time from the first row to the last; 0 when all are captured at once.
    readout_s: f64,
    last_row: f64,
}

impl RollingShutter {
    /// The shutter of a camera with this many rows and this readout time, from the first to the last.
    pub fn new(rows: u32, readout_us: u32) -> Self {
        Self {
            readout_s: f64::from(readout_us) * 1e-6,
            last_row: f64::from(rows.saturating_sub(1).max(1)),
        }
    }

    /// Whether rows are captured at different times.
    pub fn is_rolling(&self) -> bool {
        self.readout_s != 0.0
    }

    /// Capture time of a row minus the frame's capture time, seconds; negative above the middle. A
    /// position outside the picture counts as the nearest row.
    pub fn delay_s(&self, y_px: f64) -> f64 {
        if self.readout_s == 0.0 || !y_px.is_finite() {
            return 0.0;
        }
        ((y_px / self.last_row).clamp(0.0, 1.0) - 0.5) * self.readout_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_have_their_times() {
        let delay_s = |y_px: f64| RollingShutter::new(481, 10_000).delay_s(y_px);
        assert_eq!([0.0, 240.0, 480.0].map(delay_s), [-0.005, 0.0, 0.005]);
        assert_eq!([-1e9, 1e9].map(delay_s), [-0.005, 0.005]);
        assert_eq!([f64::NAN, f64::INFINITY].map(delay_s), [0.0, 0.0]);
        assert_eq!(RollingShutter::new(480, 0).delay_s(3.0), 0.0);
    }
}
