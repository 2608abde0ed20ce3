//! Pictures as results of commands.

use image::{ImageFormat, RgbImage};
use runtime::output::{OutputError, Rule};
use std::io::{self, Cursor};
use std::path::Path;

/// Writes a picture, as a PNG unless its name has the extension of another format.
pub fn write_picture(rule: Rule, path: &Path, picture: &RgbImage) -> Result<(), OutputError> {
    let format = ImageFormat::from_path(path).unwrap_or(ImageFormat::Png);
    let mut bytes = Vec::new();
    picture.write_to(&mut Cursor::new(&mut bytes), format).map_err(|error| OutputError::Write {
        path: path.into(),
        source: io::Error::other(error),
    })?;
    rule.write(path, &bytes)
}
