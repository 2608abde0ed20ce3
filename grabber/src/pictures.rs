//! Pictures from files as a source of frames: one PNG or JPEG, or a folder of them in the order of
//! their names, shown round and round.

use crate::camera::{CameraError, Exposure, Painter, Timeline};
use crate::jpeg;
use crate::mosaic::mosaic;
use common::config::CameraConfig;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};
use std::io::Cursor;
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

/// Reads a PNG or JPEG, upright: turned as its EXIF orientation says, like every viewer shows it. A JPEG of
/// which a part is missing is an error.
pub fn read_picture(path: &Path) -> Result<DynamicImage, CameraError> {
    let problem =
        |problem: String| CameraError::Picture { path: path.display().to_string(), problem };
    let unreadable = |error| problem(format!("not a readable PNG or JPEG ({error})"));
    let bytes = std::fs::read(path).map_err(|error| problem(error.to_string()))?;
    // A folder can hold files of the wrong extension; the content decides.
    let format = image::guess_format(&bytes).map_err(unreadable)?;
    if format == ImageFormat::Jpeg {
        jpeg::check_whole(&bytes).map_err(|fault| problem(fault.to_string()))?;
    }
    let reader = ImageReader::with_format(Cursor::new(&bytes), format);
    let mut decoder = reader.into_decoder().map_err(unreadable)?;
    let orientation = decoder.orientation().map_err(unreadable)?;
    let mut picture = DynamicImage::from_decoder(decoder).map_err(unreadable)?;
    picture.apply_orientation(orientation);
    Ok(picture)
}

/// Loads one picture as a Bayer frame of the configured size, rows without padding. A colour
/// picture is put behind the configured colour filter array; an 8-bit grey picture is taken to be
/// raw Bayer data already.
pub fn load_bayer(path: &Path, camera: &CameraConfig) -> Result<Vec<u8>, CameraError> {
    load_picture(path, camera).map(|picture| picture.bayer)
}

/// A Bayer frame from a file.
pub struct Picture {
    /// Its pixels, rows without padding.
    pub bayer: Vec<u8>,
    /// Whether the file was grey and taken to be raw.
    pub is_raw: bool,
}

/// The same, and how it was taken.
pub fn load_picture(path: &Path, camera: &CameraConfig) -> Result<Picture, CameraError> {
    let picture = read_picture(path)?;
    let (width, height) = (picture.width(), picture.height());
    if (width, height) != (camera.width, camera.height) {
        let problem = format!(
            "the picture is {width}×{height}, the configuration says {}×{}; set camera.width and \
             camera.height (the geometry's points belong to that size)",
            camera.width, camera.height
        );
        return Err(CameraError::Picture { path: path.display().to_string(), problem });
    }
    match picture {
        DynamicImage::ImageLuma8(raw) => Ok(Picture { bayer: raw.into_raw(), is_raw: true }),
        other => {
            let mut bayer = vec![0; width as usize * height as usize];
            mosaic(&other.into_rgb8(), width as usize, camera.bayer_order, &mut bayer);
            Ok(Picture { bayer, is_raw: false })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::jpeg::JpegEncoder;
    use image::{ExtendedColorType, ImageEncoder, RgbImage};

    /// The EXIF block of a camera that was held so.
    fn exif(orientation: u8) -> Vec<u8> {
        let mut block = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
        block.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
        block
    }

    /// What the sensor saw, for each orientation of the EXIF standard: the corner of the stored picture in
    /// which the upright picture's red top-left corner is.
    #[test]
    fn pictures_are_turned_as_their_orientation_says() {
        let folder = std::env::temp_dir().join(format!("touchline-exif-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let corners = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0), (0, 1), (1, 1), (1, 0)].into_iter();
        for (orientation, corner) in (1..).zip(corners) {
            let stored = RgbImage::from_fn(48, 32, |x, y| {
                let is_red = (u32::from(x >= 24), u32::from(y >= 16)) == corner;
                image::Rgb(if is_red { [220, 30, 30] } else { [30, 30, 30] })
            });
            let path = folder.join(format!("{orientation}.jpg"));
            let mut bytes = Vec::new();
            let mut encoder = JpegEncoder::new_with_quality(&mut bytes, 95);
            encoder.set_exif_metadata(exif(orientation)).unwrap();
            encoder.write_image(&stored, 48, 32, ExtendedColorType::Rgb8).unwrap();
            std::fs::write(&path, &bytes).unwrap();
            let upright = read_picture(&path).unwrap().into_rgb8();
            let is_on_its_side = orientation >= 5;
            let size = if is_on_its_side { (32, 48) } else { (48, 32) };
            assert_eq!(upright.dimensions(), size, "{orientation}");
            let (width, height) = size;
            assert!(upright.get_pixel(4, 4).0[0] > 180, "{orientation}");
            for (x, y) in [(width - 4, 4), (4, height - 4), (width - 4, height - 4)] {
                assert!(upright.get_pixel(x, y).0[0] < 80, "{orientation}");
            }
            std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
            let error = read_picture(&path).unwrap_err().to_string();
            assert!(error.contains("cut off"), "{error}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
