//! Frames as `foxglove.RawImage`, a protobuf message that viewers can show, without loss.
//!
//! Protobuf is a list of fields, each a key (number and wire type) and a value; readers skip unknown
//! numbers, so our header travels in a field of its own. The message is small and fixed and needs no
//! protobuf library: it is encoded here, and checked with the official library in
//! `scripts/python/check_recording.py`.

use messages::{BayerOrder, FrameHeader, PixelFormat};

/// A frame from a recording.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// The header as published.
    pub header: FrameHeader,
    /// The payload as published.
    pub pixels: &'a [u8],
}

/// Name of the schema, known to viewers.
pub const SCHEMA_NAME: &str = "foxglove.RawImage";
/// Frame of reference for viewers.
const FRAME_ID: &str = "camera";

/// Field numbers of the Foxglove schema, and our own far beyond them.
const TIMESTAMP: u32 = 1;
const WIDTH: u32 = 2;
const HEIGHT: u32 = 3;
const ENCODING: u32 = 4;
const STEP: u32 = 5;
const DATA: u32 = 6;
const FRAME: u32 = 7;
const HEADER: u32 = 1000;

/// Wire types.
const VARINT: u32 = 0;
const FIXED64: u32 = 1;
const BYTES: u32 = 2;
const FIXED32: u32 = 5;

/// The viewers' name for a frame's pixel format. Formats unknown to them are shown in grey; the
/// recorded bytes are exact in any case.
fn encoding(header: &FrameHeader) -> &'static str {
    let order = BayerOrder::from_number(header.bayer_order);
    match PixelFormat::from_number(header.pixel_format) {
        Some(PixelFormat::Bayer8) => match order {
            Some(BayerOrder::Rggb) => "bayer_rggb8",
            Some(BayerOrder::Grbg) => "bayer_grbg8",
            Some(BayerOrder::Gbrg) => "bayer_gbrg8",
            Some(BayerOrder::Bggr) => "bayer_bggr8",
            None => "mono8",
        },
        Some(PixelFormat::Bayer10 | PixelFormat::Bayer12 | PixelFormat::Bayer16) => "mono16",
        Some(PixelFormat::Rgb24) => "rgb8",
        Some(PixelFormat::Yuyv) => "yuyv",
        Some(PixelFormat::Uyvy) => "uyvy",
        // The luma plane comes first.
        Some(PixelFormat::Nv12 | PixelFormat::I420) | None => "mono8",
    }
}

/// Encodes a frame into `out`, replacing its content.
pub fn encode_frame(header: &FrameHeader, pixels: &[u8], out: &mut Vec<u8>) {
    out.clear();
    out.reserve(pixels.len() + 160);
    let mut timestamp = Vec::with_capacity(16);
    put_number(&mut timestamp, 1, header.t_capture_wall_ns / 1_000_000_000);
    put_number(&mut timestamp, 2, header.t_capture_wall_ns % 1_000_000_000);
    put_bytes(out, TIMESTAMP, &timestamp);
    put_bytes(out, FRAME, FRAME_ID.as_bytes());
    put_fixed32(out, WIDTH, header.width);
    put_fixed32(out, HEIGHT, header.height);
    put_bytes(out, ENCODING, encoding(header).as_bytes());
    put_fixed32(out, STEP, header.stride);
    put_bytes(out, HEADER, bytemuck::bytes_of(header));
    put_bytes(out, DATA, pixels);
}

/// Decodes a frame; `None` if header or pixels are missing, or the bytes are not a protobuf message.
pub fn decode_frame(mut data: &[u8]) -> Option<Frame<'_>> {
    let (mut header, mut pixels) = (None, None);
    while !data.is_empty() {
        let key = u32::try_from(take_varint(&mut data)?).ok()?;
        let value = match key & 7 {
            VARINT => {
                take_varint(&mut data)?;
                continue;
            }
            FIXED64 => take(&mut data, 8)?,
            FIXED32 => take(&mut data, 4)?,
            BYTES => {
                let length = take_varint(&mut data)?;
                take(&mut data, usize::try_from(length).ok()?)?
            }
            _ => return None,
        };
        match key >> 3 {
            HEADER if value.len() == size_of::<FrameHeader>() => {
                header = Some(bytemuck::pod_read_unaligned(value));
            }
            DATA => pixels = Some(value),
            _ => {}
        }
    }
    Some(Frame { header: header?, pixels: pixels? })
}

/// The schema: a `google.protobuf.FileDescriptorSet` of the two files needed.
pub fn schema() -> Vec<u8> {
    // Types and labels of descriptor.proto.
    const STRING: u64 = 9;
    const MESSAGE: u64 = 11;
    const RAW: u64 = 12;
    const FIXED: u64 = 7;
    const INT64: u64 = 3;
    const INT32: u64 = 5;
    let timestamp = file(
        "google/protobuf/timestamp.proto",
        "google.protobuf",
        None,
        "Timestamp",
        &[("seconds", 1, INT64, None), ("nanos", 2, INT32, None)],
    );
    let image = file(
        "touchline/RawImage.proto",
        "foxglove",
        Some("google/protobuf/timestamp.proto"),
        "RawImage",
        &[
            ("timestamp", TIMESTAMP, MESSAGE, Some(".google.protobuf.Timestamp")),
            ("width", WIDTH, FIXED, None),
            ("height", HEIGHT, FIXED, None),
            ("encoding", ENCODING, STRING, None),
            ("step", STEP, FIXED, None),
            ("data", DATA, RAW, None),
            ("frame_id", FRAME, STRING, None),
            ("touchline_frame_header", HEADER, RAW, None),
        ],
    );
    let mut set = Vec::new();
    put_bytes(&mut set, 1, &timestamp);
    put_bytes(&mut set, 1, &image);
    set
}

/// A field: name, number, type, and the type's name if it is a message.
type Field<'a> = (&'a str, u32, u64, Option<&'a str>);

/// A `FileDescriptorProto` with one message.
fn file(
    name: &str,
    package: &str,
    import: Option<&str>,
    message: &str,
    fields: &[Field],
) -> Vec<u8> {
    let mut descriptor = Vec::new();
    put_bytes(&mut descriptor, 1, message.as_bytes());
    for (name, number, kind, type_name) in fields {
        let mut field = Vec::new();
        put_bytes(&mut field, 1, name.as_bytes());
        put_number(&mut field, 3, u64::from(*number));
        // Optional, like every proto3 field.
        put_number(&mut field, 4, 1);
        put_number(&mut field, 5, *kind);
        if let Some(type_name) = type_name {
            put_bytes(&mut field, 6, type_name.as_bytes());
        }
        put_bytes(&mut descriptor, 2, &field);
    }
    let mut file = Vec::new();
    put_bytes(&mut file, 1, name.as_bytes());
    put_bytes(&mut file, 2, package.as_bytes());
    if let Some(import) = import {
        put_bytes(&mut file, 3, import.as_bytes());
    }
    put_bytes(&mut file, 4, &descriptor);
    put_bytes(&mut file, 12, b"proto3");
    file
}

fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn put_key(out: &mut Vec<u8>, field: u32, wire: u32) {
    put_varint(out, u64::from(field << 3 | wire));
}

fn put_number(out: &mut Vec<u8>, field: u32, value: u64) {
    put_key(out, field, VARINT);
    put_varint(out, value);
}

fn put_fixed32(out: &mut Vec<u8>, field: u32, value: u32) {
    put_key(out, field, FIXED32);
    out.extend_from_slice(&value.to_le_bytes());
}

fn put_bytes(out: &mut Vec<u8>, field: u32, bytes: &[u8]) {
    put_key(out, field, BYTES);
    put_varint(out, bytes.len() as u64);
    out.extend_from_slice(bytes);
}

fn take<'a>(data: &mut &'a [u8], count: usize) -> Option<&'a [u8]> {
    let (taken, rest) = data.split_at_checked(count)?;
    *data = rest;
    Some(taken)
}

fn take_varint(data: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let byte = take(data, 1)?[0];
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn header() -> FrameHeader {
        FrameHeader {
            seq: 7,
            t_capture_wall_ns: 1_700_000_000_123_456_789,
            width: 4,
            height: 2,
            stride: 5,
            pixel_format: PixelFormat::Bayer8 as u32,
            bayer_order: BayerOrder::Gbrg as u32,
            ..Default::default()
        }
    }

    #[test]
    fn a_frame_comes_back_as_it_was() {
        let pixels: Vec<u8> = (0..10).collect();
        let mut bytes = vec![1, 2, 3];
        encode_frame(&header(), &pixels, &mut bytes);
        let frame = decode_frame(&bytes).unwrap();
        assert_eq!((frame.header, frame.pixels), (header(), pixels.as_slice()));
        assert!(bytes.windows(11).any(|part| part == b"bayer_gbrg8"));
        for end in 0..bytes.len() {
            assert!(decode_frame(&bytes[..end]).is_none(), "cut at {end}");
        }
    }

    proptest! {
        #[test]
        fn garbage_is_refused(data in prop::collection::vec(any::<u8>(), 0..300)) {
            let _ = decode_frame(&data);
        }
    }
}
