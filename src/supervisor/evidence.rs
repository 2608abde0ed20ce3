//! Saves a frame that has killed two processes, for a bug report.

use super::sys::{self, Call};
use classifier::{Picture, to_rgb};
use client::bus::Received;
use client::instance::Instance;
use client::private;
use image::{DynamicImage, GrayImage, ImageFormat, RgbImage};
use messages::{FrameFault, FrameHeader};
use std::fs::File;
use std::io::{BufWriter, ErrorKind};
use std::path::{Path, PathBuf};

/// Saves a raw frame in a directory that outlives the group: Bayer data as a grey PNG, which
/// `touchline detect` accepts, and colour as colour. Encoding is slow and runs in the background;
/// returns the path of the file to be.
pub fn save_frame(
    instance: &Instance,
    frame: &Received<u8, FrameHeader>,
) -> Result<PathBuf, String> {
    let seq = frame.header().seq;
    let picture =
        picture_of(frame.header(), frame.elements()).map_err(|fault| fault.to_string())?;
    let (path, file) = create(&directory(), &format!("{}-frame-{seq}", instance.name()))?;
    let target = path.clone();
    let save = move || {
        if let Err(error) = picture.write_to(&mut BufWriter::new(file), ImageFormat::Png) {
            let _ = std::fs::remove_file(&target);
            runtime::tell!(
                "touchline: frame {seq} cannot be kept in {}: {error}",
                target.display()
            );
        }
    };
    let start = || std::thread::Builder::new().name("evidence".into()).spawn(save);
    match sys::ask(Call::StartThread, start) {
        Ok(_) => Ok(path),
        Err(error) => {
            let _ = std::fs::remove_file(&path);
            Err(error.to_string())
        }
    }
}

/// Most pictures kept of the same frame number, from different matches.
const MOST_ALIKE: u32 = 100;

/// Creates a new picture file in a directory private to this user. An existing file, such as a
/// picture of an earlier match or a link planted by another user, is left as it is.
fn create(directory: &Path, name: &str) -> Result<(PathBuf, File), String> {
    private::create_directory(directory).map_err(|error| error.to_string())?;
    for number in 1..=MOST_ALIKE {
        let suffix = if number == 1 { String::new() } else { format!("-{number}") };
        let path = directory.join(format!("{name}{suffix}.png"));
        match private::create_new_file(&path) {
            Ok(file) => return Ok((path, file)),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(format!("{}: {error}", path.display())),
        }
    }
    Err(format!("{}/{name}-*.png are {MOST_ALIKE} pictures already", directory.display()))
}

/// The frame as a picture of 8 bits a channel.
fn picture_of(header: &FrameHeader, bytes: &[u8]) -> Result<DynamicImage, FrameFault> {
    let &FrameHeader { width, height, stride, .. } = header;
    let layout = header.check(width, height, bytes.len())?;
    let fault =
        FrameFault::Size { width, height, stride, expected_width: width, expected_height: height };
    let picture = match Picture::new(bytes, width, height, stride, layout).ok_or(fault)? {
        Picture::Bayer(image) => {
            let mut mosaic = Vec::new();
            image.copy_mosaic(&mut mosaic);
            GrayImage::from_raw(width, height, mosaic).map(DynamicImage::from)
        }
        picture => {
            let mut rgb = Vec::new();
            to_rgb(&picture, &mut rgb);
            RgbImage::from_raw(width, height, rgb).map(DynamicImage::from)
        }
    };
    picture.ok_or(fault)
}

/// Directory for state that survives the program but is no user document (XDG state). If the
/// environment names none, a private one in the directory for temporary files.
pub fn directory() -> PathBuf {
    let from = |variable| std::env::var_os(variable).filter(|value| !value.is_empty());
    let state = from("XDG_STATE_HOME").map(PathBuf::from);
    let home = || from("HOME").map(|home| PathBuf::from(home).join(".local/state"));
    match state.or_else(home) {
        Some(place) => place.join("touchline"),
        None => {
            let uid = rustix::process::getuid().as_raw();
            std::env::temp_dir().join(format!("touchline-{uid}.state"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::{PermissionsExt, symlink};

    #[test]
    fn pictures_never_overwrite_a_file_and_need_a_private_directory() {
        let base = std::env::temp_dir().join(format!("tl-evidence-{}", std::process::id()));
        let directory = base.join("state");
        let (first, _) = create(&directory, "match-frame-7").unwrap();
        let victim = base.join("victim");
        fs::write(&victim, "kept").unwrap();
        symlink(&victim, directory.join("match-frame-7-2.png")).unwrap();
        let (third, _) = create(&directory, "match-frame-7").unwrap();
        assert_eq!(first, directory.join("match-frame-7.png"));
        assert_eq!(third, directory.join("match-frame-7-3.png"));
        assert_eq!(fs::read_to_string(&victim).unwrap(), "kept");

        fs::set_permissions(&directory, fs::Permissions::from_mode(0o777)).unwrap();
        let refusal = create(&directory, "match-frame-8").unwrap_err();
        assert!(refusal.contains("can be written by other users"), "{refusal}");
        let link = base.join("link");
        symlink(&directory, &link).unwrap();
        let refusal = create(&link, "match-frame-8").unwrap_err();
        assert!(refusal.contains("is a symbolic link"), "{refusal}");
        fs::remove_dir_all(&base).unwrap();
    }
}
