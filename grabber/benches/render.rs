//! Duration of simulating and rendering the synthetic match, on one core: `cargo bench -p touchline-grabber`.
//!
//! Times are the processor time of this thread, so other load on the machine has less influence.

use config::Preset;
use rustix::time::{ClockId, clock_gettime};
use std::time::Duration;
use touchline_grabber::synthetic::SyntheticMatch;

const FRAMES: u32 = 4000;

fn main() {
    println!(
        "{:<14} {:>10} {:>10} {:>12} {:>12} {:>12} {:>10}",
        "preset", "size", "advance", "render p50", "p99", "still", "frames/s"
    );
    for preset in Preset::ALL {
        let config = preset.config();
        let stride = config.camera.width as usize;
        let mut pixels = vec![0; stride * config.camera.height as usize];
        let mut scene = SyntheticMatch::new(&config).expect("presets are valid");
        let (mut play, mut still) = (Duration::ZERO, Duration::ZERO);
        let mut paint: Vec<Duration> = Vec::new();
        for _ in 0..FRAMES {
            let start = processor_time();
            scene.advance();
            let played = processor_time();
            scene.render(&mut pixels, stride);
            let painted = processor_time();
            // Once more without changes: noise alone.
            scene.render(&mut pixels, stride);
            play += played - start;
            paint.push(painted - played);
            still += processor_time() - painted;
        }
        // A bench must not measure an empty picture.
        let brightest = pixels.iter().max().copied().unwrap_or(0);
        assert!(brightest > 100, "nothing was painted");
        let total: Duration = paint.iter().sum();
        paint.sort_unstable();
        println!(
            "{:<14} {:>10} {:>10} {:>12} {:>12} {:>12} {:>10.0}",
            preset.name(),
            format!("{}×{}", config.camera.width, config.camera.height),
            format!("{:.1?}", play / FRAMES),
            format!("{:.1?}", paint[paint.len() / 2]),
            format!("{:.1?}", paint[paint.len() * 99 / 100]),
            format!("{:.1?}", still / FRAMES),
            f64::from(FRAMES) / (play + total).as_secs_f64(),
        );
    }
}

fn processor_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs() as u32)
}
