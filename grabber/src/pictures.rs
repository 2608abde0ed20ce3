//! Picture files: PNG and JPEG, read within limits (`docs/limits.md`).

use crate::camera::CameraError;
use crate::mosaic::mosaic;
use crate::{jpeg, png};
use config::CameraConfig;
use config::input;
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};

/// The picture files of a path: itself, or those in the folder, by name.
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

/// Maximum side of a picture.
const MAX_SIDE: u32 = 16_384;
/// Maximum number of pixels if no other size is required.
const MAX_PIXELS: u64 = 160_000_000;
/// Bytes from the beginning of a file in which its size is searched.
const HEAD_BYTES: u64 = 256 << 10;
/// Memory for decoding a picture, besides its pixels.
const DECODER_BYTES: u64 = 64 << 20;

/// A picture's file.
struct PictureFile {
    bytes: Vec<u8>,
    format: ImageFormat,
}

impl PictureFile {
    fn read(path: &Path) -> Result<Self, CameraError> {
        let problem = |problem| CameraError::Picture { path: path.display().to_string(), problem };
        let bytes = input::read(path, input::PICTURE).map_err(|e| problem(e.to_string()))?;
        Self::new(path, bytes)
    }

    /// Reads its beginning, which contains its size.
    fn read_head(path: &Path) -> Result<Self, CameraError> {
        let problem = |problem| CameraError::Picture { path: path.display().to_string(), problem };
        let mut bytes = Vec::new();
        let file = input::open(path).map_err(|error| problem(error.to_string()))?;
        let read = file.take(HEAD_BYTES).read_to_end(&mut bytes);
        read.map_err(|error| problem(error.to_string()))?;
        Self::new(path, bytes)
    }

    fn new(path: &Path, bytes: Vec<u8>) -> Result<Self, CameraError> {
        let problem = |problem| CameraError::Picture { path: path.display().to_string(), problem };
        // A folder can hold files of the wrong extension; the content decides.
        let format = image::guess_format(&bytes).map_err(|error| problem(unreadable(&error)))?;
        let bytes = if format == ImageFormat::Png { png::essential_chunks(&bytes) } else { bytes };
        Ok(Self { bytes, format })
    }

    /// A decoder that knows the size, and takes memory for at most `most_pixels`.
    fn decoder(&self, most_pixels: u64) -> image::ImageResult<impl ImageDecoder + '_> {
        let mut reader = ImageReader::with_format(Cursor::new(&self.bytes), self.format);
        let mut limits = Limits::default();
        (limits.max_image_width, limits.max_image_height) = (Some(MAX_SIDE), Some(MAX_SIDE));
        // Four channels of two bytes.
        limits.max_alloc = Some(8 * most_pixels + DECODER_BYTES);
        reader.limits(limits);
        reader.into_decoder()
    }
}

fn unreadable(error: &image::ImageError) -> String {
    format!("not a readable PNG or JPEG ({error})")
}

/// Reads a PNG or JPEG, rotated upright by its EXIF orientation, as viewers do. A JPEG with missing parts is
/// an error.
pub fn read_picture(path: &Path) -> Result<DynamicImage, CameraError> {
    read_checked(path, |width, height| {
        let pixels = u64::from(width) * u64::from(height);
        let most = MAX_PIXELS / 1_000_000;
        (pixels > MAX_PIXELS)
            .then(|| format!("it has {width}×{height} pixels; at most {most} million are read"))
    })
}

/// Reads a picture, unless `complaint` rejects its size before it is decoded.
fn read_checked(
    path: &Path,
    complaint: impl Fn(u32, u32) -> Option<String>,
) -> Result<DynamicImage, CameraError> {
    let problem =
        |problem: String| CameraError::Picture { path: path.display().to_string(), problem };
    let unreadable = |error: image::ImageError| problem(unreadable(&error));
    let file = PictureFile::read(path)?;
    if file.format == ImageFormat::Jpeg {
        jpeg::check_whole(&file.bytes).map_err(|fault| problem(fault.to_string()))?;
    }
    let most_pixels = u64::from(MAX_SIDE) * u64::from(MAX_SIDE);
    let mut decoder = file.decoder(most_pixels).map_err(unreadable)?;
    let orientation = decoder.orientation().map_err(unreadable)?;
    let (width, height) = upright(decoder.dimensions(), orientation);
    if let Some(complaint) = complaint(width, height) {
        return Err(problem(complaint));
    }
    let mut picture = DynamicImage::from_decoder(decoder).map_err(unreadable)?;
    picture.apply_orientation(orientation);
    Ok(picture)
}

fn upright((width, height): (u32, u32), orientation: Orientation) -> (u32, u32) {
    match orientation {
        Orientation::Rotate90
        | Orientation::Rotate270
        | Orientation::Rotate90FlipH
        | Orientation::Rotate270FlipH => (height, width),
        _ => (width, height),
    }
}

/// The error for a picture of another size than the camera's.
fn size_complaint(width: u32, height: u32, camera: &CameraConfig) -> Option<String> {
    ((width, height) != (camera.width, camera.height)).then(|| {
        format!(
            "the picture is {width}×{height}, the configuration says {}×{}; set camera.width and \
             camera.height (the geometry's points belong to that size)",
            camera.width, camera.height
        )
    })
}

/// Checks that a file is a picture of the camera's size, without decoding it.
pub fn check_picture(path: &Path, camera: &CameraConfig) -> Result<(), CameraError> {
    let problem = |problem| CameraError::Picture { path: path.display().to_string(), problem };
    let head = PictureFile::read_head(path)?;
    // Metadata may precede the size, and be long.
    let file = if head.decoder(0).is_ok() { head } else { PictureFile::read(path)? };
    let mut decoder = file.decoder(0).map_err(|error| problem(unreadable(&error)))?;
    let orientation = decoder.orientation().map_err(|error| problem(unreadable(&error)))?;
    let (width, height) = upright(decoder.dimensions(), orientation);
    size_complaint(width, height, camera).map_or(Ok(()), |complaint| Err(problem(complaint)))
}

/// Loads a picture as a Bayer frame of the configured size, rows without padding. A colour picture is reduced
/// to the configured mosaic; an 8-bit grey picture is assumed to be raw Bayer data already.
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

/// Loads a picture as [`load_bayer`] does, and tells whether it was raw.
pub fn load_picture(path: &Path, camera: &CameraConfig) -> Result<Picture, CameraError> {
    let picture = read_checked(path, |width, height| size_complaint(width, height, camera))?;
    let (width, height) = (picture.width(), picture.height());
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

    /// The EXIF block for an orientation.
    fn exif(orientation: u8) -> Vec<u8> {
        let mut block = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
        block.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
        block
    }

    /// For each orientation of the EXIF standard: the corner of the stored picture that becomes the upright
    /// picture's red top-left corner.
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
