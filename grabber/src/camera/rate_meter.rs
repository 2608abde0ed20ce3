//! Measurement of the actual frame rate.

/// Measures the rate of arrivals, and detects when it falls short.
#[derive(Debug, Clone)]
pub struct RateMeter {
    expected_fps: f64,
    window_start_ns: u64,
    count: u32,
    fps: Option<f64>,
}

/// Length of a measurement.
const WINDOW_NS: u64 = 2_000_000_000;
/// Part of the expected rate that suffices: clocks differ, and a frame may fall on the other side of a
/// window's edge.
const SHARE: f64 = 0.95;

impl RateMeter {
    /// Expects a rate, frames per second, from now on.
    pub fn new(expected_fps: f64, now_ns: u64) -> Self {
        Self { expected_fps, window_start_ns: now_ns, count: 0, fps: None }
    }

    /// Counts a frame.
    pub fn arrived(&mut self) {
        self.count += 1;
    }

    /// Updates the measurement; `true` if a new one is complete.
    pub fn measure(&mut self, now_ns: u64) -> bool {
        let elapsed_ns = now_ns.saturating_sub(self.window_start_ns);
        if elapsed_ns < WINDOW_NS {
            return false;
        }
        self.fps = Some(f64::from(self.count) * 1e9 / elapsed_ns as f64);
        (self.window_start_ns, self.count) = (now_ns, 0);
        true
    }

    /// The latest measurement, frames per second.
    pub fn fps(&self) -> Option<f64> {
        self.fps
    }

    /// Whether clearly fewer frames arrive than expected.
    pub fn is_slow(&self) -> bool {
        // At a few frames per second one frame more or less is a large share.
        let tolerance = (1e9 / WINDOW_NS as f64 * 1.5).max((1.0 - SHARE) * self.expected_fps);
        self.fps.is_some_and(|fps| fps < self.expected_fps - tolerance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after_four_seconds(expected_fps: f64, frames: u64) -> RateMeter {
        let mut pace = RateMeter::new(expected_fps, 0);
        for frame in 1..=frames {
            pace.arrived();
            pace.measure(frame * 4_000_000_000 / frames);
        }
        pace
    }

    #[test]
    fn a_camera_at_its_rate_is_not_slow() {
        let pace = after_four_seconds(80.0, 319);
        assert!((pace.fps().unwrap() - 80.0).abs() < 1.0 && !pace.is_slow());
        assert!(!after_four_seconds(1.0, 4).is_slow());
    }

    #[test]
    fn a_camera_at_half_its_rate_is_slow() {
        let pace = after_four_seconds(80.0, 160);
        assert!((pace.fps().unwrap() - 40.0).abs() < 1.0 && pace.is_slow());
    }

    #[test]
    fn no_rate_is_reported_before_it_is_measured() {
        assert!(!RateMeter::new(80.0, 0).is_slow());
    }
}
