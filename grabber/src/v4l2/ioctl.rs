//! The requests of Video for Linux, as `<linux/videodev2.h>` defines them.
//!
//! Written by hand rather than generated: a dozen requests are needed, and a generator would require libclang
//! for every build. Sizes are checked at compile time, and by the kernel, since they are part of a request's
//! number.

// The kernel interface takes pointers; each call states why it is sound.
#![allow(unsafe_code)]

use bytemuck::Zeroable;
use rustix::fd::AsFd;
use rustix::io::{Errno, Result};
use rustix::ioctl::{Updater, ioctl, opcode};

/// Capture of single-plane pictures: the type of every buffer here.
pub const CAPTURE: u32 = 1;
/// Memory that the driver owns and the program maps.
pub const MEMORY_MMAP: u32 = 1;
/// Memory that the program owns.
pub const MEMORY_USERPTR: u32 = 2;

/// The device captures single-plane pictures.
pub const CAP_CAPTURE: u32 = 0x1;
/// The device captures multi-planar pictures.
pub const CAP_CAPTURE_MPLANE: u32 = 0x1000;
/// The device streams.
pub const CAP_STREAMING: u32 = 0x0400_0000;
/// [`Capability::device_caps`] is filled in.
pub const CAP_DEVICE_CAPS: u32 = 0x8000_0000;

/// The frame rate can be set.
pub const PARM_TIME_PER_FRAME: u32 = 0x1000;

/// The picture is damaged.
pub const BUFFER_ERROR: u32 = 0x40;
/// Mask of the clock of a buffer's time.
pub const TIMESTAMP_MASK: u32 = 0xe000;
/// The monotonic clock.
pub const TIMESTAMP_MONOTONIC: u32 = 0x2000;
/// The time is that of the start of the exposure, not of the end of the frame.
pub const TIMESTAMP_START_OF_EXPOSURE: u32 = 0x1_0000;

/// The control cannot be used at all.
pub const CONTROL_DISABLED: u32 = 0x1;
/// The control can only be read.
pub const CONTROL_READ_ONLY: u32 = 0x4;
/// The control has no effect now, because another one overrides it.
pub const CONTROL_INACTIVE: u32 = 0x10;
/// The control can only be written.
pub const CONTROL_WRITE_ONLY: u32 = 0x40;
/// Or'ed with a control's number: requests the next control.
pub const NEXT_CONTROL: u32 = 0x8000_0000;

/// Kinds of controls.
pub mod control_type {
    /// A number.
    pub const INTEGER: u32 = 1;
    /// On or off.
    pub const BOOLEAN: u32 = 2;
    /// One of several names.
    pub const MENU: u32 = 3;
    /// Setting it triggers an action.
    pub const BUTTON: u32 = 4;
    /// A bit set.
    pub const BITMASK: u32 = 8;
    /// One of several numbers.
    pub const INTEGER_MENU: u32 = 9;
}

/// Identity and abilities of a device.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub struct Capability {
    pub driver: [u8; 16],
    pub card: [u8; 32],
    pub bus_info: [u8; 32],
    pub version: u32,
    pub capabilities: u32,
    pub device_caps: u32,
    pub reserved: [u32; 3],
}

/// A format that a device offers.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub struct FormatDescription {
    pub index: u32,
    pub kind: u32,
    pub flags: u32,
    pub description: [u8; 32],
    pub fourcc: u32,
    pub media_bus_code: u32,
    pub reserved: [u32; 3],
}

/// The format of captured pictures.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub struct Format {
    pub kind: u32,
    pub padding: u32,
    pub width: u32,
    pub height: u32,
    pub fourcc: u32,
    pub field: u32,
    pub bytes_per_line: u32,
    pub size_image: u32,
    pub color_space: u32,
    pub private: u32,
    pub flags: u32,
    pub encoding: u32,
    pub quantization: u32,
    pub transfer_function: u32,
    pub rest: [u64; 19],
}

/// A request for buffers.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub struct RequestBuffers {
    pub count: u32,
    pub kind: u32,
    pub memory: u32,
    pub capabilities: u32,
    pub flags: u32,
}

/// A buffer being queued or dequeued.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub struct Buffer {
    pub index: u32,
    pub kind: u32,
    pub bytes_used: u32,
    pub flags: u32,
    pub field: u32,
    pub padding: u32,
    pub seconds: i64,
    pub microseconds: i64,
    pub timecode: [u32; 4],
    pub sequence: u32,
    pub memory: u32,
    /// Its location: an offset to map, or an address of this process.
    pub place: u64,
    pub length: u32,
    pub reserved: u32,
    pub request: u32,
    pub padding_at_end: u32,
}

/// A fraction, for example of a second.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Zeroable)]
#[repr(C)]
pub struct Fraction {
    pub numerator: u32,
    pub denominator: u32,
}

/// The frame rate.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub struct StreamParameters {
    pub kind: u32,
    pub capability: u32,
    pub mode: u32,
    pub time_per_frame: Fraction,
    pub rest: [u32; 46],
}

/// A size, or a range of sizes, of a format.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub struct FrameSize {
    pub index: u32,
    pub fourcc: u32,
    /// 1: `size[..2]` is width and height; else a range: width from, to, step; height from, to, step.
    pub kind: u32,
    pub size: [u32; 6],
    pub reserved: [u32; 2],
}

/// A frame interval, or a range of them, of a format and size.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub struct FrameInterval {
    pub index: u32,
    pub fourcc: u32,
    pub width: u32,
    pub height: u32,
    /// 1: `interval[0]`; else a range: shortest, longest, step.
    pub kind: u32,
    pub interval: [Fraction; 3],
    pub reserved: [u32; 2],
}

/// Description of a control.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub struct QueryControl {
    pub id: u32,
    pub kind: u32,
    pub name: [u8; 32],
    pub minimum: i64,
    pub maximum: i64,
    pub step: u64,
    pub default: i64,
    pub flags: u32,
    pub element_size: u32,
    pub elements: u32,
    pub dimensions: u32,
    pub sizes: [u32; 4],
    pub reserved: [u32; 32],
}

/// One entry of a menu.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub struct QueryMenu {
    pub id: u32,
    pub index: u32,
    /// The name; in a menu of numbers the first eight bytes are the number.
    pub name: [u8; 32],
    pub reserved: u32,
}

/// A control's value.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
pub struct Control {
    pub id: u32,
    pub value: i32,
}

const _: () = {
    assert!(size_of::<Capability>() == 104);
    assert!(size_of::<FormatDescription>() == 64);
    assert!(size_of::<Format>() == 208);
    assert!(size_of::<RequestBuffers>() == 20);
    assert!(size_of::<Buffer>() == 88);
    assert!(std::mem::offset_of!(Buffer, seconds) == 24);
    assert!(std::mem::offset_of!(Buffer, sequence) == 56);
    assert!(std::mem::offset_of!(Buffer, place) == 64);
    assert!(size_of::<StreamParameters>() == 204);
    assert!(size_of::<FrameSize>() == 44);
    assert!(size_of::<FrameInterval>() == 52);
    assert!(size_of::<QueryControl>() == 232);
    assert!(size_of::<QueryMenu>() == 44);
};

/// Repeats a request that a signal has interrupted.
fn uninterrupted(mut request: impl FnMut() -> Result<()>) -> Result<()> {
    loop {
        match request() {
            Err(Errno::INTR) => {}
            result => return result,
        }
    }
}

macro_rules! requests {
    ($($(#[$doc:meta])* $name:ident: $direction:ident $number:literal $type:ty;)*) => {$(
        $(#[$doc])*
        pub fn $name(device: impl AsFd, value: &mut $type) -> Result<()> {
            // SAFETY: direction, number and structure are those of <linux/videodev2.h>. The kernel
            // reads and writes nothing but `value`, which holds no address it follows, and any
            // bytes it writes are valid numbers.
            uninterrupted(|| unsafe {
                ioctl(
                    device.as_fd(),
                    Updater::<{ opcode::$direction::<$type>(b'V', $number) }, $type>::new(value),
                )
            })
        }
    )*};
}

requests! {
    /// Queries identity and abilities.
    query_capability: read 0 Capability;
    /// Queries the format of this index.
    describe_format: read_write 2 FormatDescription;
    /// Sets the format, and returns the resulting one.
    set_format: read_write 5 Format;
    /// Allocates buffers, or frees them.
    request_buffers: read_write 8 RequestBuffers;
    /// Queries a buffer's location.
    query_buffer: read_write 9 Buffer;
    /// Dequeues a filled buffer.
    dequeue_buffer: read_write 17 Buffer;
    /// Starts streaming.
    stream_on: write 18 i32;
    /// Stops streaming; all buffers belong to the program again.
    stream_off: write 19 i32;
    /// Queries the frame rate.
    get_parameters: read_write 21 StreamParameters;
    /// Sets the frame rate, and returns the resulting one.
    set_parameters: read_write 22 StreamParameters;
    /// Reads a control.
    get_control: read_write 27 Control;
    /// Sets a control.
    set_control: read_write 28 Control;
    /// Queries the menu entry of this index.
    query_menu: read_write 37 QueryMenu;
    /// Queries the size of this index of a format.
    frame_size: read_write 74 FrameSize;
    /// Queries the frame interval of this index of a format and size.
    frame_interval: read_write 75 FrameInterval;
    /// Queries the description of a control.
    query_control: read_write 103 QueryControl;
}

/// Queues a buffer for the driver to fill.
///
/// # Safety
///
/// A buffer of [`MEMORY_USERPTR`] must describe memory (`place`, `length`) that stays valid and is not
/// accessed until the buffer was dequeued or the stream turned off.
pub unsafe fn queue_buffer(device: impl AsFd, buffer: &mut Buffer) -> Result<()> {
    // SAFETY: as for the other requests; that the memory it points to may be written is the
    // caller's promise.
    uninterrupted(|| unsafe {
        ioctl(
            device.as_fd(),
            Updater::<{ opcode::read_write::<Buffer>(b'V', 15) }, Buffer>::new(buffer),
        )
    })
}

/// The text in a field of fixed size.
pub fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn request_numbers_equal_the_kernels() {
        // Printed by a C program that includes <linux/videodev2.h>.
        assert_eq!(opcode::read::<Capability>(b'V', 0) as u32, 0x8068_5600);
        assert_eq!(opcode::read_write::<Buffer>(b'V', 15) as u32, 0xc058_560f);
        assert_eq!(opcode::read_write::<QueryControl>(b'V', 103) as u32, 0xc0e8_5667);
    }

    #[test]
    fn texts_end_at_their_zero() {
        assert_eq!(text(b"vivid\0\0\0"), "vivid");
        assert_eq!(text(b"full"), "full");
    }
}
