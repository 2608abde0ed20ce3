//! The raw frame: header, pixel layout, and the checks a reader makes.

use super::PixelFormat;
use super::json;
use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use serde::Serialize;

/// Colours of the top-left 2×2 pixels of a Bayer frame, read row by row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
#[repr(u32)]
pub enum BayerOrder {
    /// Red, green / green, blue.
    Rggb = 0,
    /// Green, red / blue, green.
    Grbg = 1,
    /// Green, blue / red, green.
    Gbrg = 2,
    /// Blue, green / green, red.
    Bggr = 3,
}

impl BayerOrder {
    /// All four orders, in the order of their numbers in messages.
    pub const ALL: [BayerOrder; 4] = [Self::Rggb, Self::Grbg, Self::Gbrg, Self::Bggr];

    /// The order with this number in a message, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.get(number as usize).copied()
    }

    /// Position of the red site in the 2×2 tile: `(column, row)`, each 0 or 1. Blue sits at the
    /// diagonally opposite site, green at the other two.
    pub fn red_site(self) -> (usize, usize) {
        match self {
            Self::Rggb => (0, 0),
            Self::Grbg => (1, 0),
            Self::Gbrg => (0, 1),
            Self::Bggr => (1, 1),
        }
    }

    /// Index into an RGB triple (0 red, 1 green, 2 blue) of the colour that the sensor measures at a
    /// pixel.
    pub fn channel_at(self, column: usize, row: usize) -> usize {
        let (red_column, red_row) = self.red_site();
        ((column ^ red_column) & 1) + ((row ^ red_row) & 1)
    }
}

/// Header of a raw frame; the payload is the pixels, laid out as [`PixelFormat`] says.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/FrameHeader/2")]
#[repr(C)]
pub struct FrameHeader {
    /// Number of the frame since the group started; a gap means frames that were never captured.
    pub seq: u64,
    /// Middle of the exposure.
    pub t_capture_ns: u64,
    /// The same instant on the wall clock, nanoseconds since 1970.
    pub t_capture_wall_ns: u64,
    /// When the grabber published the frame.
    pub t_sent_ns: u64,
    /// Which camera, counted from 0.
    pub camera_id: u32,
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from the start of a row to the start of the next; in planar formats, of the first plane.
    pub stride: u32,
    /// A [`PixelFormat`] number.
    #[serde(serialize_with = "json::pixel_format")]
    pub pixel_format: u32,
    /// A [`BayerOrder`] number; meaningless unless the format is a Bayer one.
    #[serde(serialize_with = "json::bayer_order")]
    pub bayer_order: u32,
    /// Exposure time; 0 when unknown.
    pub exposure_us: u32,
    /// Revision of the configuration of the grabber, see [`Revision`](super::Revision).
    pub revision: u32,
}

const _: () = assert!(size_of::<FrameHeader>() == 64);

/// Pixel layout of a frame whose header has been checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelLayout {
    /// Pixel format.
    pub format: PixelFormat,
    /// Colours of the top-left 2×2 pixels; meaningless unless the format is a Bayer one.
    pub order: BayerOrder,
}

/// Reason why a frame cannot be processed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FrameFault {
    /// The pixel format number is not one of [`PixelFormat`].
    #[error("pixel format {0} is unknown")]
    PixelFormat(u32),
    /// The Bayer order number is not one of [`BayerOrder`].
    #[error("Bayer order {0} is unknown")]
    BayerOrder(u32),
    /// The size in the header differs from the configured size, or its rows overlap.
    #[error(
        "frame is {width}×{height} (stride {stride}), expected {expected_width}×{expected_height}"
    )]
    Size {
        /// Width in the header.
        width: u32,
        /// Height in the header.
        height: u32,
        /// Stride in the header.
        stride: u32,
        /// Configured width.
        expected_width: u32,
        /// Configured height.
        expected_height: u32,
    },
    /// The payload is shorter than the header promises.
    #[error("frame has {got} bytes, its header promises {needed}")]
    Truncated {
        /// Payload bytes.
        got: usize,
        /// Bytes needed for the geometry in the header.
        needed: u64,
    },
}

/// Highest believable ratio of a camera's actual and configured frame rate …
const MAX_SPEED: f64 = 4.0;
/// … and this many frames more: cameras that number their frames themselves may have lost as many.
const TOLERATED_GAP: u64 = 128;
/// A frame captured longer ago does not belong to this match. A recording replayed at another pace than
/// its own can be this old.
pub const MAX_AGE_NS: u64 = 3_600_000_000_000;
/// Neither does a frame captured this far in the future.
const MAX_AHEAD_NS: u64 = 60_000_000_000;

/// How far frame numbers can rise in a time at a configured rate, lost frames included.
pub fn reachable_frames(elapsed_ns: u64, fps: f64) -> u64 {
    // The cast saturates, and gives 0 for a NaN.
    TOLERATED_GAP.saturating_add((elapsed_ns as f64 * 1e-9 * fps * MAX_SPEED) as u64)
}

impl FrameHeader {
    /// Whether this can be the next frame after `last`, at the time `now_ns` and a configured rate: its
    /// capture time is plausible, and its number is higher but not higher than the camera can have
    /// reached.
    pub fn follows(&self, last: Option<&Self>, now_ns: u64, fps: f64) -> bool {
        self.is_present(now_ns)
            && last.is_none_or(|last| {
                self.seq > last.seq && self.is_reachable(last.seq, last.t_capture_ns, now_ns, fps)
            })
    }

    /// Whether a camera of a configured rate can have reached this number, at the time `now_ns`, since
    /// a frame of that number and capture time. A capture time in the future does not count as elapsed
    /// time.
    pub fn is_reachable(&self, seq: u64, t_capture_ns: u64, now_ns: u64, fps: f64) -> bool {
        let elapsed_ns = self.t_capture_ns.min(now_ns).saturating_sub(t_capture_ns);
        self.seq.saturating_sub(seq) <= reachable_frames(elapsed_ns, fps)
    }

    /// Whether the capture time is plausible for the present match.
    pub fn is_present(&self, now_ns: u64) -> bool {
        now_ns.saturating_sub(self.t_capture_ns) < MAX_AGE_NS
            && self.t_capture_ns.saturating_sub(now_ns) < MAX_AHEAD_NS
    }

    /// Checks the header against the configured size and the payload, and returns the pixel layout.
    /// Nothing of a frame may be used before this check: headers are outside input.
    pub fn check(
        &self,
        expected_width: u32,
        expected_height: u32,
        payload_bytes: usize,
    ) -> Result<PixelLayout, FrameFault> {
        let format = PixelFormat::from_number(self.pixel_format)
            .ok_or(FrameFault::PixelFormat(self.pixel_format))?;
        let order = match BayerOrder::from_number(self.bayer_order) {
            Some(order) => order,
            None if format.is_bayer() => return Err(FrameFault::BayerOrder(self.bayer_order)),
            None => BayerOrder::Rggb,
        };
        let &Self { width, height, stride, .. } = self;
        if (width, height) != (expected_width, expected_height)
            || u64::from(stride) < format.row_bytes(width)
        {
            return Err(FrameFault::Size {
                width,
                height,
                stride,
                expected_width,
                expected_height,
            });
        }
        let needed = format.frame_bytes(width, height, stride);
        if (payload_bytes as u64) < needed {
            return Err(FrameFault::Truncated { got: payload_bytes, needed });
        }
        Ok(PixelLayout { format, order })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_a_camera_can_have_reached_follows() {
        let now_ns = 2 * MAX_AGE_NS;
        let frame = |seq, t_capture_ns| FrameHeader { seq, t_capture_ns, ..Default::default() };
        let last = frame(500, now_ns - 10_000_000_000);
        let follows = |header: FrameHeader| header.follows(Some(&last), now_ns, 80.0);
        assert!(follows(frame(501, last.t_capture_ns + 12_500_000)));
        assert!(follows(frame(900, last.t_capture_ns + 5_000_000_000)), "after an outage");
        assert!(!follows(frame(1400, last.t_capture_ns)), "no time has passed");
        assert!(!follows(frame(9000, now_ns + 50_000_000_000)), "nor is it of the future");
        assert!(!follows(frame(500, now_ns)) && !follows(frame(0, now_ns)));
        assert!(!follows(frame(u64::MAX, now_ns)) && !follows(frame(u64::MAX, u64::MAX)));
        assert!(!frame(7, 0).follows(None, now_ns, 80.0), "of another time");
        assert!(!frame(7, now_ns + 2 * MAX_AHEAD_NS).follows(None, now_ns, 80.0), "of the future");
        assert!(frame(7, now_ns).follows(None, now_ns, 80.0));
        assert!(frame(7, now_ns - MAX_AGE_NS / 2).follows(None, now_ns, 80.0), "of a recording");
    }
}
