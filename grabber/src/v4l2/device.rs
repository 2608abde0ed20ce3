//! Opening a device, negotiating format and rate, and querying its abilities.

use super::formats::{self, Use};
use super::ioctl::{
    self, Capability, Format, FormatDescription, Fraction, FrameInterval, FrameSize,
    StreamParameters,
};
use crate::camera::Fault;
use bytemuck::Zeroable;
use config::CameraConfig;
use messages::CameraState;
use rustix::fd::{AsFd, OwnedFd};
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use std::path::Path;

/// Maximum length of a driver's lists.
const MAX_LIST: u32 = 256;
/// Relative difference below which rates count as equal.
const SAME_RATE: f64 = 0.01;

/// Opens a device that captures pictures.
pub fn open(path: &Path) -> Result<(OwnedFd, Capability), Fault> {
    let flags = OFlags::RDWR | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let device = rustix::fs::open(path, flags, Mode::empty()).map_err(|e| refusal(path, e))?;
    let mut capability = Capability::zeroed();
    ioctl::query_capability(&device, &mut capability).map_err(|error| match error {
        Errno::NOTTY | Errno::INVAL => {
            let problem = format!("{} is no camera of Video for Linux", path.display());
            Fault::new(CameraState::Failed, problem)
        }
        error => refusal(path, error),
    })?;
    let can = abilities(&capability);
    if can & ioctl::CAP_CAPTURE == 0 || can & ioctl::CAP_STREAMING == 0 {
        let why = if can & ioctl::CAP_CAPTURE_MPLANE != 0 {
            "delivers pictures in several planes of memory, which is not supported"
        } else {
            "captures no pictures; a camera often has a second device beside the one that does"
        };
        let problem = format!("{} {why}; see `touchline cameras`", path.display());
        return Err(Fault::new(CameraState::WrongFormat, problem));
    }
    Ok((device, capability))
}

fn abilities(capability: &Capability) -> u32 {
    if capability.capabilities & ioctl::CAP_DEVICE_CAPS != 0 {
        capability.device_caps
    } else {
        capability.capabilities
    }
}

/// The camera fault for a system error.
pub fn refusal(path: &Path, error: Errno) -> Fault {
    let path = path.display();
    match error {
        Errno::NOENT | Errno::NODEV | Errno::NXIO => Fault::new(
            CameraState::Missing,
            format!(
                "{path} is not there: is the camera connected? `touchline cameras` lists what is"
            ),
        ),
        Errno::ACCESS | Errno::PERM => Fault::new(
            CameraState::NoRights,
            format!(
                "no rights to open {path}: `sudo usermod -aG video $USER` gives them, from the next \
                 login on"
            ),
        ),
        Errno::BUSY => Fault::new(
            CameraState::Busy,
            format!("{path} is in use by another program; `fuser {path}` names it"),
        ),
        error => Fault::new(CameraState::Failed, format!("{path}: {error}")),
    }
}

/// Result of the negotiation with a device.
#[derive(Debug, Clone, Copy)]
pub struct Negotiated {
    /// The format.
    pub fourcc: u32,
    /// Treatment of the format.
    pub usage: Use,
    /// Bytes per row, as the driver delivers them.
    pub stride: u32,
    /// Bytes that the driver needs for a picture.
    pub size_image: u32,
    /// Frames per second, if the driver states it.
    pub fps: Option<f64>,
}

/// Sets format, size and rate as configured.
pub fn negotiate(
    device: impl AsFd,
    path: &Path,
    config: &CameraConfig,
) -> Result<Negotiated, Fault> {
    let fourcc = choose(&device, path, config)?;
    let mut format = Format {
        kind: ioctl::CAPTURE,
        width: config.width,
        height: config.height,
        fourcc,
        // Rows in order. Wrong sizes, remembered from another format or made up, turn raw pictures purple; at
        // zero, the driver computes them itself.
        field: 1,
        bytes_per_line: 0,
        size_image: 0,
        ..Format::zeroed()
    };
    ioctl::set_format(&device, &mut format).map_err(|error| refusal(path, error))?;
    let wanted = format!("{} {}×{}", formats::name(fourcc), config.width, config.height);
    if (format.width, format.height, format.fourcc) != (config.width, config.height, fourcc) {
        let got = format!("{} {}×{}", formats::name(format.fourcc), format.width, format.height);
        return Err(wrong_format(&device, path, &format!("gives {got} instead of {wanted}")));
    }
    let usage = formats::use_of(fourcc);
    let stride = match usage {
        Use::Raw(pixel_format, _) => {
            let least = pixel_format.row_bytes(config.width);
            let stride = format.bytes_per_line.max(least as u32);
            let bytes = pixel_format.frame_bytes(config.width, config.height, stride);
            if u64::from(format.size_image) < bytes {
                let problem = format!(
                    "{}: the driver wants {} bytes for {wanted}, which has {bytes}",
                    path.display(),
                    format.size_image
                );
                return Err(Fault::new(CameraState::WrongFormat, problem));
            }
            stride
        }
        _ => 3 * config.width,
    };
    let fps = set_rate(&device, config.fps);
    Ok(Negotiated { fourcc, usage, stride, size_image: format.size_image, fps })
}

/// The configured format, or the best one available in the configured size; formats that reach the configured
/// rate come first.
fn choose(device: impl AsFd, path: &Path, config: &CameraConfig) -> Result<u32, Fault> {
    let offered = list_formats(&device);
    if config.v4l2.format != "auto" {
        let fourcc = formats::parse(&config.v4l2.format)
            .map_err(|problem| Fault::new(CameraState::WrongFormat, problem))?;
        if offered.iter().any(|description| description.fourcc == fourcc) {
            return Ok(fourcc);
        }
        let problem = format!("does not offer {}", config.v4l2.format);
        return Err(wrong_format(&device, path, &problem));
    }
    let fits = |fourcc: u32| {
        let sizes = list_sizes(&device, fourcc);
        sizes.is_empty() || sizes.iter().any(|size| size.holds(config.width, config.height))
    };
    offered
        .iter()
        .map(|description| description.fourcc)
        .filter(|&fourcc| !matches!(formats::use_of(fourcc), Use::Refused(_)) && fits(fourcc))
        .min_by_key(|&fourcc| {
            let rates = list_rates(&device, fourcc, config.width, config.height);
            let reaches = |&fps: &f64| fps >= config.fps * (1.0 - SAME_RATE);
            let too_slow = !rates.is_empty() && !rates.iter().any(reaches);
            (too_slow, formats::preference(fourcc))
        })
        .ok_or_else(|| {
            let problem = format!("has no usable format in {}×{}", config.width, config.height);
            wrong_format(&device, path, &problem)
        })
}

/// A fault that lists the alternatives: the sizes of the best format, and the other formats.
fn wrong_format(device: impl AsFd, path: &Path, problem: &str) -> Fault {
    let mut usable: Vec<u32> = list_formats(&device)
        .iter()
        .map(|description| description.fourcc)
        .filter(|&fourcc| !matches!(formats::use_of(fourcc), Use::Refused(_)))
        .collect();
    usable.sort_by_key(|&fourcc| formats::preference(fourcc));
    let path = path.display();
    let problem = match usable.as_slice() {
        [] => format!("{path} {problem}; it has no usable format at all"),
        [best, others @ ..] => {
            let sizes: Vec<String> =
                list_sizes(&device, *best).iter().map(Size::to_string).collect();
            let others: Vec<String> = others.iter().map(|&fourcc| formats::name(fourcc)).collect();
            format!(
                "{path} {problem}; it has {} in {}, and {} (see `touchline cameras`)",
                formats::name(*best),
                sizes.join(", "),
                others.join(", ")
            )
        }
    };
    Fault::new(CameraState::WrongFormat, problem)
}

/// Requests a rate; returns the one that the driver promises.
fn set_rate(device: impl AsFd, fps: f64) -> Option<f64> {
    let mut parameters = StreamParameters { kind: ioctl::CAPTURE, ..StreamParameters::zeroed() };
    ioctl::get_parameters(&device, &mut parameters).ok()?;
    if parameters.capability & ioctl::PARM_TIME_PER_FRAME != 0 {
        let time_per_frame = Fraction { numerator: 1000, denominator: (fps * 1000.0) as u32 };
        let mut wanted = StreamParameters { time_per_frame, ..parameters };
        if ioctl::set_parameters(&device, &mut wanted).is_ok() {
            parameters = wanted;
        }
    }
    rate(parameters.time_per_frame)
}

fn rate(time: Fraction) -> Option<f64> {
    let fps = f64::from(time.denominator) / f64::from(time.numerator);
    (fps.is_finite() && fps > 0.0).then_some(fps)
}

/// The formats a device offers.
pub fn list_formats(device: impl AsFd) -> Vec<FormatDescription> {
    let describe = |index| {
        let mut description =
            FormatDescription { index, kind: ioctl::CAPTURE, ..FormatDescription::zeroed() };
        ioctl::describe_format(&device, &mut description).ok().map(|()| description)
    };
    (0..MAX_LIST).map_while(describe).collect()
}

/// A size, or a range of sizes: from, to, step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    width: [u32; 3],
    height: [u32; 3],
}

impl Size {
    /// Whether a picture of this size is available.
    fn holds(&self, width: u32, height: u32) -> bool {
        let lies_in = |value: u32, [low, high, step]: [u32; 3]| {
            (low..=high).contains(&value) && (value - low).is_multiple_of(step.max(1))
        };
        lies_in(width, self.width) && lies_in(height, self.height)
    }

    /// The largest width and height.
    pub fn largest(&self) -> (u32, u32) {
        (self.width[1], self.height[1])
    }
}

impl std::fmt::Display for Size {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let ([low_width, high_width, _], [low_height, high_height, _]) = (self.width, self.height);
        if (low_width, low_height) != (high_width, high_height) {
            write!(f, "{low_width}×{low_height} to ")?;
        }
        write!(f, "{high_width}×{high_height}")
    }
}

/// The sizes of a format; empty if the driver does not state them.
pub fn list_sizes(device: impl AsFd, fourcc: u32) -> Vec<Size> {
    let mut sizes = Vec::new();
    for index in 0..MAX_LIST {
        let mut size = FrameSize { index, fourcc, ..FrameSize::zeroed() };
        if ioctl::frame_size(&device, &mut size).is_err() {
            break;
        }
        let [a, b, c, d, e, f] = size.size;
        if size.kind != 1 {
            sizes.push(Size { width: [a, b, c], height: [d, e, f] });
            break;
        }
        sizes.push(Size { width: [a, a, 1], height: [b, b, 1] });
    }
    sizes
}

/// The rates of a format at a size, fastest first; for a range, its ends.
pub fn list_rates(device: impl AsFd, fourcc: u32, width: u32, height: u32) -> Vec<f64> {
    let mut rates = Vec::new();
    for index in 0..MAX_LIST {
        let mut interval =
            FrameInterval { index, fourcc, width, height, ..FrameInterval::zeroed() };
        if ioctl::frame_interval(&device, &mut interval).is_err() {
            break;
        }
        let [first, last, _] = interval.interval;
        rates.extend(rate(first));
        if interval.kind != 1 {
            rates.extend(rate(last));
            break;
        }
    }
    rates.sort_by(|a, b| b.total_cmp(a));
    rates
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_of_sizes_hold_their_steps() {
        let range = Size { width: [32, 640, 16], height: [24, 480, 8] };
        assert!(range.holds(640, 480) && range.holds(48, 24));
        assert!(!range.holds(40, 24) && !range.holds(656, 480) && !range.holds(32, 25));
        assert_eq!(range.to_string(), "32×24 to 640×480");
    }

    #[test]
    fn a_rate_is_the_inverse_of_a_time() {
        assert_eq!(rate(Fraction { numerator: 1, denominator: 30 }), Some(30.0));
        assert_eq!(rate(Fraction { numerator: 0, denominator: 30 }), None);
        assert_eq!(rate(Fraction { numerator: 1, denominator: 0 }), None);
    }

    #[test]
    fn a_device_that_is_no_camera_is_refused() {
        let refused = |path: &str| open(Path::new(path)).err().expect("no camera");
        assert_eq!(refused("/dev/video-that-is-not").state, CameraState::Missing);
        let fault = refused("/dev/null");
        assert_eq!(fault.state, CameraState::Failed);
        assert!(fault.problem.contains("/dev/null is no camera"), "{fault}");
    }
}
