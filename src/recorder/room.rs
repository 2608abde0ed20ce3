//! Disk space that a recording takes, and that is free.

use super::RecorderError;
use config::Config;
use recording::Channel;
use rustix::fs::statvfs;
use std::path::Path;

/// Largest compressed size of a frame's detections, `world` and drawings.
const RESULTS_BYTES: u64 = 16 << 10;
/// Index at the end of a file: bytes per megabyte of the file, and minimum.
const INDEX_BYTES_PER_MB: u64 = 1000;
const LEAST_INDEX_BYTES: u64 = 64 << 10;

/// Most bytes that a second of recording takes.
pub fn bytes_per_second(config: &Config, channels: &[Channel]) -> u64 {
    let pixels = match channels.contains(&Channel::Frames) {
        true => config.camera.frame_bytes() as u64,
        false => 0,
    };
    ((pixels + RESULTS_BYTES) as f64 * config.camera.fps) as u64
}

/// Bytes needed to complete a file of this size.
pub fn index_bytes(file_bytes: u64) -> u64 {
    LEAST_INDEX_BYTES + file_bytes / 1_000_000 * INDEX_BYTES_PER_MB
}

/// Bytes free on the disk that a file is on, or will be.
pub fn free_bytes(path: &Path) -> Result<u64, RecorderError> {
    let directory = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    let directory = directory.unwrap_or(Path::new("."));
    let space = statvfs(directory).map_err(|error| RecorderError::System {
        action: format!("look for free space in {}", directory.display()),
        source: error.into(),
    })?;
    Ok(space.f_bavail * space.f_frsize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_is_mostly_pixels() {
        let config = Config::default();
        let all = bytes_per_second(&config, &[Channel::Frames, Channel::World]);
        let results = bytes_per_second(&config, &[Channel::World]);
        assert_eq!(all - results, (config.camera.frame_bytes() as f64 * config.camera.fps) as u64);
        assert!(results > 0 && results < all / 10);
    }
}
