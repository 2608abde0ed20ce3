//! Discovery of cameras of Video for Linux.

use super::controls;
use super::device::{list_formats, list_rates, list_sizes, open};
use super::formats::{self, Use};
use super::ioctl;
use crate::camera::Fault;
use crate::listing::{CameraDescription, FormatDescription, SizeDescription};
use messages::CameraState;
use rustix::fd::AsFd;
use std::path::{Path, PathBuf};

/// All cameras of Video for Linux. Devices that are no cameras are left out; those that cannot be opened are
/// listed with the reason.
pub fn list() -> Vec<CameraDescription> {
    let Ok(entries) = std::fs::read_dir("/dev") else { return Vec::new() };
    let number = |path: &PathBuf| -> Option<u32> {
        path.file_name()?.to_str()?.strip_prefix("video")?.parse().ok()
    };
    let mut devices: Vec<(u32, PathBuf)> = entries
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter_map(|path| Some((number(&path)?, path)))
        .collect();
    devices.sort();
    devices.iter().filter_map(|(_, path)| describe(path)).collect()
}

fn describe(path: &Path) -> Option<CameraDescription> {
    let source = format!("v4l2:{}", path.display());
    match open(path) {
        Ok((device, capability)) => Some(CameraDescription {
            source,
            model: ioctl::text(&capability.card),
            driver: format!(
                "{}, {}",
                ioctl::text(&capability.driver),
                ioctl::text(&capability.bus_info)
            ),
            problem: None,
            formats: describe_formats(&device),
            controls: controls::list(&device),
            features: Vec::new(),
        }),
        // A device for metadata or output.
        Err(Fault { state: CameraState::WrongFormat | CameraState::Failed, .. }) => None,
        Err(fault) => Some(CameraDescription {
            source,
            model: String::new(),
            driver: String::new(),
            problem: Some(fault.problem),
            formats: Vec::new(),
            controls: Vec::new(),
            features: Vec::new(),
        }),
    }
}

fn describe_formats(device: impl AsFd) -> Vec<FormatDescription> {
    let describe = |format: ioctl::FormatDescription| {
        let refused = match formats::use_of(format.fourcc) {
            Use::Refused(reason) => Some(reason.to_string()),
            _ => None,
        };
        let sizes = list_sizes(&device, format.fourcc).into_iter().map(|size| {
            let (width, height) = size.largest();
            SizeDescription {
                size: size.to_string(),
                fps: list_rates(&device, format.fourcc, width, height),
            }
        });
        FormatDescription {
            name: formats::name(format.fourcc),
            description: ioctl::text(&format.description),
            refused,
            sizes: sizes.collect(),
        }
    };
    list_formats(&device).into_iter().map(describe).collect()
}
