//! Pictures from files as a source of frames: one PNG or JPEG, or a folder of them in the order of
//! their names, shown round and round.

use crate::camera::{CameraError, Exposure, Painter, Timeline};
use crate::mosaic::mosaic;
use common::config::CameraConfig;
use std::path::{Path, PathBuf};

/// Plays pictures along a timeline.
pub struct PictureCamera {
    frames: Vec<Vec<u8>>,
    timeline: Timeline,
}

impl PictureCamera {
    /// A camera that shows these frames, of which there must be at least one.
    pub fn new(frames: Vec<Vec<u8>>, timeline: Timeline) -> Self {
        assert!(!frames.is_empty(), "a picture camera needs pictures");
        Self { frames, timeline }
    }
}

/// Loads the pictures a path stands for as Bayer frames.
pub fn load_frames(path: &Path, camera: &CameraConfig) -> Result<Vec<Vec<u8>>, CameraError> {
    list_pictures(path)?.iter().map(|path| load_bayer(path, camera)).collect()
}

impl Painter for PictureCamera {
    fn expose(&mut self, pixels: &mut [u8]) -> Result<Exposure, CameraError> {
        let skipped = self.timeline.skip_late();
        let index = (self.timeline.next_seq() % self.frames.len() as u64) as usize;
        pixels.copy_from_slice(&self.frames[index]);
        Ok(self.timeline.wait(skipped))
    }
}

/// The picture files a path stands for: itself, or those in the folder, by name.
pub fn list_pictures(path: &Path) -> Result<Vec<PathBuf>, CameraError> {
    let problem =
        |problem: String| CameraError::Picture { path: path.display().to_string(), problem };
    if !path.is_dir() {
        return Ok(vec![path.to_path_buf()]);
    }
    let is_picture = |path: &PathBuf| {
        let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or("");
        ["png", "jpg", "jpeg"].iter().any(|known| extension.eq_ignore_ascii_case(known))
    };
    let mut pictures: Vec<PathBuf> = std::fs::read_dir(path)
        .map_err(|error| problem(error.to_string()))?
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(is_picture)
        .collect();
    pictures.sort();
    if pictures.is_empty() {
        return Err(problem("no PNG or JPEG in this folder".into()));
    }
    Ok(pictures)
}

/// Loads one picture as a Bayer frame of the configured size, rows without padding. A colour
/// picture is put behind the configured colour filter array; an 8-bit grey picture is taken to be
/// raw Bayer data already.
pub fn load_bayer(path: &Path, camera: &CameraConfig) -> Result<Vec<u8>, CameraError> {
    let problem =
        |problem: String| CameraError::Picture { path: path.display().to_string(), problem };
    // A folder can hold files of the wrong extension; the content decides.
    let picture = image::ImageReader::open(path)
        .and_then(image::ImageReader::with_guessed_format)
        .map_err(|error| problem(error.to_string()))?
        .decode()
        .map_err(|error| problem(format!("not a readable PNG or JPEG ({error})")))?;
    let (width, height) = (picture.width(), picture.height());
    if (width, height) != (camera.width, camera.height) {
        return Err(problem(format!(
            "the picture is {width}×{height}, the configuration says {}×{}; set camera.width and \
             camera.height (the geometry's points belong to that size)",
            camera.width, camera.height
        )));
    }
    match picture {
        image::DynamicImage::ImageLuma8(raw) => Ok(raw.into_raw()),
        other => {
            let mut frame = vec![0; width as usize * height as usize];
            mosaic(&other.into_rgb8(), width as usize, camera.bayer_order, &mut frame);
            Ok(frame)
        }
    }
}
