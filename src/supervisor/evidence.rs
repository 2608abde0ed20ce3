//! What is kept for a bug report when a frame has killed two processes.

use common::bus::Received;
use common::instance::Instance;
use common::messages::FrameHeader;
use std::path::PathBuf;

/// Saves a raw frame where it outlives the group, as a grey PNG of its Bayer data, which
/// `touchline detect` takes as it is. Encoding takes a while and is done in the background; returns
/// where the file will be.
pub fn save_frame(instance: &Instance, frame: &Received<u8, FrameHeader>) -> PathBuf {
    let &FrameHeader { seq, width, height, stride, .. } = frame.header();
    let path = directory().join(format!("{}-frame-{seq}.png", instance.name()));
    let rows = frame.elements().chunks(stride.max(1) as usize);
    let pixels: Vec<u8> =
        rows.flat_map(|row| &row[..row.len().min(width as usize)]).copied().collect();
    let target = path.clone();
    std::thread::spawn(move || {
        let saved = image::GrayImage::from_raw(width, height, pixels)
            .ok_or_else(|| "its size is not what its header says".to_string())
            .and_then(|picture| {
                std::fs::create_dir_all(directory()).map_err(|error| error.to_string())?;
                picture.save(&target).map_err(|error| error.to_string())
            });
        if let Err(error) = saved {
            eprintln!("touchline: frame {seq} cannot be kept in {}: {error}", target.display());
        }
    });
    path
}

/// Where programs keep what should survive them but is no document of the user's.
fn directory() -> PathBuf {
    let from = |variable| std::env::var_os(variable).filter(|value| !value.is_empty());
    let state = from("XDG_STATE_HOME").map(PathBuf::from);
    let home = || from("HOME").map(|home| PathBuf::from(home).join(".local/state"));
    state.or_else(home).unwrap_or_else(std::env::temp_dir).join("touchline")
}
