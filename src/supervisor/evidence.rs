//! What is kept for a bug report when a frame has killed two processes.

use super::sys::{self, Call};
use classifier::{Picture, to_rgb};
use common::bus::Received;
use common::instance::Instance;
use common::messages::{FrameFault, FrameHeader};
use image::{DynamicImage, GrayImage, RgbImage};
use std::path::PathBuf;

/// Saves a raw frame where it outlives the group: as a grey PNG of its Bayer data, which
/// `touchline detect` takes as it is, or in colour if it came in colour. Encoding takes a while and
/// is done in the background; returns where the file will be.
pub fn save_frame(instance: &Instance, frame: &Received<u8, FrameHeader>) -> PathBuf {
    let seq = frame.header().seq;
    let path = directory().join(format!("{}-frame-{seq}.png", instance.name()));
    let picture = picture_of(frame.header(), frame.elements());
    let target = path.clone();
    let save = move || {
        let saved = picture.map_err(|fault| fault.to_string()).and_then(|picture| {
            std::fs::create_dir_all(directory()).map_err(|error| error.to_string())?;
            picture.save(&target).map_err(|error| error.to_string())
        });
        if let Err(error) = saved {
            common::tell!("touchline: frame {seq} cannot be kept in {}: {error}", target.display());
        }
    };
    let start = || std::thread::Builder::new().name("evidence".into()).spawn(save);
    if let Err(error) = sys::ask(Call::StartThread, start) {
        common::tell!("touchline: frame {seq} cannot be kept: {error}");
    }
    path
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

/// Where programs keep what should survive them but is no document of the user's.
pub fn directory() -> PathBuf {
    let from = |variable| std::env::var_os(variable).filter(|value| !value.is_empty());
    let state = from("XDG_STATE_HOME").map(PathBuf::from);
    let home = || from("HOME").map(|home| PathBuf::from(home).join(".local/state"));
    state.or_else(home).unwrap_or_else(std::env::temp_dir).join("touchline")
}
