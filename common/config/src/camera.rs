//! Camera configuration: picture format, and settings of real cameras.

use geometry::rolling_shutter::RollingShutter;
use messages::{BayerOrder, FrameHeader, PixelFormat};
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
    /// Colours of the top-left 2×2 pixels: "rggb", "grbg", "gbrg" or "bggr". Colour pictures used as a
    /// source are converted to this order.
    pub bayer_order: BayerOrder,
    /// Whether the picture is mirrored: the camera looks through a mirror, or its pictures are flipped.
    /// The geometry's points already describe that; this key says that it is intended.
    pub mirrored: bool,
    /// Exposure time in microseconds; it sets the motion blur of a moving robot. With a real camera,
    /// whose exposure is set below, it is used only if the camera does not report its own.
    #[schemars(range(max = 1_000_000))]
    pub exposure_us: u32,
    /// Readout time of a rolling shutter, in microseconds: from the exposure of the first row to that
    /// of the last (see the camera's data sheet). Capture times are those of the middle row. 0 for a
    /// global shutter, which captures all rows at once.
    #[schemars(range(max = 1_000_000))]
    pub rolling_shutter_us: u32,
    /// Video for Linux cameras (`--source v4l2:/dev/video0`).
    pub v4l2: V4l2Config,
    /// GigE Vision and USB3 Vision cameras (`--source genicam`).
    pub genicam: GenicamConfig,
}

impl CameraConfig {
    /// Width and height of the picture.
    pub fn picture_px(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// The times at which its rows are captured.
    pub fn rolling_shutter(&self) -> RollingShutter {
        RollingShutter::new(self.height, self.rolling_shutter_us)
    }

    /// Bytes of a frame with one byte a pixel and unpadded rows.
    pub fn frame_bytes(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Header of a raw Bayer frame as configured, with one byte a pixel and unpadded rows. The caller
    /// sets number and times.
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

/// Video for Linux cameras (`--source v4l2:/dev/video0`): USB webcams, capture cards, and cameras on
/// the board.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct V4l2Config {
    /// Four-letter name of the format, as listed by `touchline cameras` ("RGGB", "YUYV", "MJPG"), or
    /// "auto": the best one available in the configured size and rate.
    #[schemars(length(min = 1))]
    pub format: String,
    /// Number of pictures the driver may be filling at the same time.
    #[schemars(range(min = 2, max = 12))]
    pub buffers: u32,
    /// Let the driver write pictures straight into shared memory if it can. false: pictures are copied,
    /// for drivers that claim this ability wrongly.
    pub direct: bool,
    /// Controls set whenever the camera is opened, by their names in `touchline cameras`: numbers, true
    /// or false, or a menu entry in quotes. Automatic exposure and white balance change all colours
    /// when a hand enters the picture: switch them off.
    pub controls: BTreeMap<String, SettingValue>,
}

impl Default for V4l2Config {
    fn default() -> Self {
        Self { format: "auto".into(), buffers: 4, direct: true, controls: BTreeMap::new() }
    }
}

/// GigE Vision and USB3 Vision cameras (`--source genicam`), through the library Aravis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GenicamConfig {
    /// GenICam name of the format ("BayerRG8", "YUV422_8"), or "auto": the camera's best one.
    #[schemars(length(min = 1))]
    pub format: String,
    /// Number of pictures the library may be filling at the same time.
    #[schemars(range(min = 2, max = 12))]
    pub buffers: u32,
    /// Size of a network packet in bytes; 0 means 8000 for a camera on this machine and 1500 otherwise.
    /// Set 8000 or more if the network supports jumbo frames: it saves much processor time.
    #[schemars(range(min = 0, max = 16_000))]
    pub packet_size: u32,
    /// Read packets below the network stack. Needs the right CAP_NET_RAW, and does not work on every
    /// machine.
    pub packet_socket: bool,
    /// Receive buffer of the network stack, in bytes; net.core.rmem_max must allow it.
    #[schemars(range(min = 65_536, max = 1_073_741_824))]
    pub socket_buffer_bytes: u32,
    /// Request missing packets again from the camera.
    pub packet_resend: bool,
    /// A picture is given up if its packets have not all arrived within this time. Later pictures wait
    /// until then.
    #[schemars(range(min = 1, max = 10_000))]
    pub frame_timeout_ms: u32,
    /// Features set whenever the camera is opened, by their GenICam names ("ExposureTime", "Gain"):
    /// numbers, true or false, or an entry in quotes.
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

/// Value of a camera's control or feature.
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
