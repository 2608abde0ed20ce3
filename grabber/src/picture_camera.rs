//! Picture files as a source of frames: one PNG or JPEG, or a folder of them in the order of their names,
//! repeated endlessly.
//!
//! Few pictures are read once and kept. Larger folders are read ahead by a thread of its own, so that a
//! folder of any size takes the same memory.

use crate::camera::{CameraError, Exposure, FrameRenderer, Timeline};
use crate::pictures::{check_picture, list_pictures, load_bayer};
use config::CameraConfig;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, sync_channel};

/// Limit of the memory for frames that are kept.
const MAX_KEPT_BYTES: usize = 256 << 20;
/// Frames of a larger folder that are read ahead.
const AHEAD: usize = 8;

/// Shows pictures along a timeline.
pub struct PictureCamera {
    frames: Frames,
    timeline: Timeline,
}

enum Frames {
    Kept(Vec<Vec<u8>>),
    Read(Receiver<Result<Vec<u8>, CameraError>>),
}

/// Pictures that have been checked.
pub struct Pictures {
    paths: Vec<PathBuf>,
    camera: CameraConfig,
    kept: Vec<Vec<u8>>,
}

impl Pictures {
    /// Checks the pictures of a path. Those that will be kept are read; for others only format and size are
    /// checked.
    pub fn open(path: &Path, camera: &CameraConfig) -> Result<Self, CameraError> {
        let paths = list_pictures(path)?;
        let mut kept = Vec::new();
        if paths.len().saturating_mul(camera.frame_bytes()) <= MAX_KEPT_BYTES {
            for path in &paths {
                kept.push(load_bayer(path, camera)?);
            }
        } else {
            for path in &paths {
                check_picture(path, camera)?;
            }
        }
        Ok(Self { paths, camera: camera.clone(), kept })
    }

    /// Starts showing them.
    pub fn start(self, timeline: Timeline) -> PictureCamera {
        let frames = match self.kept.is_empty() {
            false => Frames::Kept(self.kept),
            true => Frames::Read(read(self.paths, self.camera, timeline.next_seq())),
        };
        PictureCamera { frames, timeline }
    }
}

impl FrameRenderer for PictureCamera {
    fn expose(&mut self, pixels: &mut [u8]) -> Result<Exposure, CameraError> {
        let skipped = self.timeline.skip_late();
        match &self.frames {
            Frames::Kept(frames) => {
                let index = (self.timeline.next_seq() % frames.len() as u64) as usize;
                pixels.copy_from_slice(&frames[index]);
            }
            // If reading is slower than the configured rate, no picture is skipped.
            Frames::Read(frames) => {
                let frame = frames.recv().map_err(|_| CameraError::Picture {
                    path: "images".into(),
                    problem: "no picture can be read any more".into(),
                })?;
                pixels.copy_from_slice(&frame?);
            }
        }
        Ok(self.timeline.wait(skipped))
    }
}

/// Reads pictures ahead, round and round, from number `first` on. The thread ends with its receiver, or after
/// a whole round without a readable picture.
fn read(
    paths: Vec<PathBuf>,
    camera: CameraConfig,
    first: u64,
) -> Receiver<Result<Vec<u8>, CameraError>> {
    let (sender, receiver) = sync_channel(AHEAD);
    std::thread::spawn(move || {
        let first = (first % paths.len() as u64) as usize;
        let mut failures = 0;
        for path in paths.iter().cycle().skip(first) {
            let frame = load_bayer(path, &camera);
            failures = if frame.is_ok() { 0 } else { failures + 1 };
            if let Err(error) = &frame
                && failures < paths.len()
            {
                runtime::tell!("touchline: {error}; the picture is skipped");
                continue;
            }
            let is_over = frame.is_err();
            if sender.send(frame).is_err() || is_over {
                return;
            }
        }
    });
    receiver
}

#[cfg(test)]
mod tests {
    use super::*;

    /// More pictures than are kept: the limit counts memory, not files.
    #[test]
    fn many_pictures_are_shown_in_order_within_the_memory_limit() {
        let folder = std::env::temp_dir().join(format!("touchline-many-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let camera = CameraConfig { width: 4096, height: 2048, fps: 1e4, ..Default::default() };
        let count = MAX_KEPT_BYTES / camera.frame_bytes() + 2;
        for number in 0..count {
            let picture = image::GrayImage::from_pixel(4096, 2048, image::Luma([number as u8]));
            picture.save(folder.join(format!("{number:03}.png"))).unwrap();
        }
        // One is damaged, but not at its beginning.
        let damaged = folder.join("003.png");
        let bytes = std::fs::read(&damaged).unwrap();
        std::fs::write(&damaged, &bytes[..bytes.len() / 2]).unwrap();

        let pictures = Pictures::open(&folder, &camera).unwrap();
        assert!(pictures.kept.is_empty());
        let mut shown = pictures.start(Timeline::new(camera.fps, None));
        let mut pixels = vec![0; camera.frame_bytes()];
        for number in (0..count).filter(|&number| number != 3).chain([0]) {
            shown.expose(&mut pixels).unwrap();
            assert_eq!(pixels[12345], number as u8);
        }
        std::fs::remove_dir_all(&folder).unwrap();
        let error = (0..100).find_map(|_| shown.expose(&mut pixels).err());
        assert!(error.is_some(), "files that are gone are not shown for ever");
    }
}
