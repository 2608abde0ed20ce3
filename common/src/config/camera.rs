//! Keys of the camera: what its pictures are, and what real cameras are set to.

use crate::messages::{BayerOrder, FrameHeader, PixelFormat};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// The camera's picture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CameraConfig {
    /// Pixels in a row.
    #[schemars(range(min = 2, max = 16_384))]
    pub width: u32,
    /// Rows.
    #[schemars(range(min = 2, max = 16_384))]
    pub height: u32,
    /// Frames a second.
    #[schemars(range(min = 1, max = 10_000))]
    pub fps: f64,
    /// Colours of the top-left 2×2 pixels: "rggb", "grbg", "gbrg" or "bggr". Colour pictures given
    /// as a source are turned into this order.
    pub bayer_order: BayerOrder,
    /// Whether pictures show the pitch as in a mirror: the camera looks through one, or its pictures come
    /// flipped. The geometry's points say where everything is all the same; this says that they are meant.
    pub mirrored: bool,
    /// Exposure time, in microseconds; for a moving robot it sets the motion blur. Of real cameras,
    /// which are set below, it is only used where they do not tell theirs.
    #[schemars(range(max = 1_000_000))]
    pub exposure_us: u32,
    /// Of a camera with a rolling shutter: time between the exposures of the first and the last row, in
    /// microseconds (see its data sheet: readout time). Capture times are those of the middle row. 0 for
    /// a global shutter, which captures all rows at once.
    #[schemars(range(max = 1_000_000))]
    pub rolling_shutter_us: u32,
    /// Cameras of Video for Linux (`--source v4l2:/dev/video0`).
    pub v4l2: V4l2Config,
    /// GigE Vision and USB3 Vision cameras (`--source genicam`).
    pub genicam: GenicamConfig,
}

impl CameraConfig {
    /// Bytes of a frame, rows without padding.
    pub fn frame_bytes(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Header of a raw Bayer frame as configured, of a byte a pixel and rows without padding; number and
    /// times are left to the caller.
    pub fn frame_header(&self) -> FrameHeader {
        FrameHeader {
            width: self.width,
            height: self.height,
            stride: self.width,
            pixel_format: PixelFormat::Bayer8 as u32,
            bayer_order: self.bayer_order as u32,
            exposure_us: self.exposure_us,
            ..FrameHeader::default()
        }
    }
}

/// Cameras of Video for Linux (`--source v4l2:/dev/video0`): USB webcams, capture cards, and cameras
/// soldered to the board.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct V4l2Config {
    /// Four letters of the format, as `touchline cameras` shows them ("RGGB", "YUYV", "MJPG"), or
    /// "auto": the best that comes in the configured size and rate.
    #[schemars(length(min = 1))]
    pub format: String,
    /// Pictures that the driver may be filling at the same time.
    #[schemars(range(min = 2, max = 12))]
    pub buffers: u32,
    /// Have the driver write pictures straight into shared memory where it can; false has them
    /// copied, for drivers that only say they can.
    pub direct: bool,
    /// Controls to set whenever the camera is opened, by the names that `touchline cameras` shows:
    /// numbers, true or false, or an entry of a menu in quotes. Cameras with automatic exposure or
    /// white balance change all colours when a hand reaches in: switch these off.
    pub controls: BTreeMap<String, SettingValue>,
}

impl Default for V4l2Config {
    fn default() -> Self {
        Self { format: "auto".into(), buffers: 4, direct: true, controls: BTreeMap::new() }
    }
}

/// GigE Vision and USB3 Vision cameras (`--source genicam`), by way of the library Aravis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GenicamConfig {
    /// GenICam's name of the format ("BayerRG8", "YUV422_8"), or "auto": the best the camera has.
    #[schemars(length(min = 1))]
    pub format: String,
    /// Pictures that the library may be filling at the same time.
    #[schemars(range(min = 2, max = 12))]
    pub buffers: u32,
    /// Bytes in a network packet; 0 means 8000 for a camera on this machine and 1500 otherwise. Set
    /// 8000 or more where the network takes jumbo frames: it saves much processor time.
    #[schemars(range(min = 0, max = 16_000))]
    pub packet_size: u32,
    /// Read packets below the network stack; needs rights (CAP_NET_RAW), and does not work on
    /// every machine.
    pub packet_socket: bool,
    /// What the network stack keeps while the library is busy; net.core.rmem_max has to allow it.
    #[schemars(range(min = 65_536, max = 1_073_741_824))]
    pub socket_buffer_bytes: u32,
    /// Ask the camera again for packets that have not come.
    pub packet_resend: bool,
    /// A picture whose packets have not all come within this time is given up; those after it wait
    /// until then.
    #[schemars(range(min = 1, max = 10_000))]
    pub frame_timeout_ms: u32,
    /// Features to set whenever the camera is opened, by their GenICam names ("ExposureTime",
    /// "Gain"): numbers, true or false, or an entry in quotes.
    pub features: BTreeMap<String, SettingValue>,
}

impl Default for GenicamConfig {
    fn default() -> Self {
        Self {
            format: "auto".into(),
            buffers: 8,
            packet_size: 0,
            packet_socket: false,
            socket_buffer_bytes: 4 << 20,
            packet_resend: true,
            frame_timeout_ms: 40,
            features: BTreeMap::new(),
        }
    }
}

/// What a camera's control or feature is set to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum SettingValue {
    /// True or false.
    Switch(bool),
    /// A number, whole or not.
    Number(f64),
    /// An entry of a menu, or text.
    Text(String),
}

impl fmt::Display for SettingValue {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Switch(on) => write!(formatter, "{on}"),
            Self::Number(number) => write!(formatter, "{number}"),
            Self::Text(text) => write!(formatter, "{text:?}"),
        }
    }
}

impl JsonSchema for SettingValue {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "SettingValue".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "A number, true or false, or text.",
            "anyOf": [
                { "type": "boolean" },
                { "type": "number", "minimum": -1e15, "maximum": 1e15 },
                { "type": "string" },
            ],
        })
    }
}
