//! Streaming: empty buffers are queued to the driver, and dequeued when filled.
//!
//! Best is to lend the driver the shared memory of the next frames ("user pointers"), which avoids a copy.
//! Drivers that cannot write there fill memory of their own, which is mapped and copied.

use super::device::{Negotiated, refusal};
use super::formats::Use;
use super::ioctl::{self, Buffer, RequestBuffers};
use super::mapping::Mapping;
use crate::camera::{Arrival, Delivery, Fault, FrameLoan, FramePool, Picture, Stream};
use crate::jpeg;
use bytemuck::Zeroable;
use client::clock::monotonic_ns;
use messages::{CameraState, PixelFormat};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::OwnedFd;
use rustix::io::{Errno, Result as SystemResult};
use std::path::PathBuf;
use std::time::Duration;

/// A streaming device.
pub struct V4l2Stream {
    // First, so that it is closed before the memory that the driver may be writing to is freed.
    device: OwnedFd,
    memory: Memory,
    path: PathBuf,
    negotiated: Negotiated,
    picture: Picture,
    device_seq: Option<u64>,
}

/// Destination of pictures.
enum Memory {
    /// Shared memory lent to the driver, by buffer.
    Lent(Vec<FrameLoan>),
    /// The driver's own memory.
    Mapped(Vec<Mapping>),
}

impl V4l2Stream {
    /// Starts streaming with `buffers` buffers; `direct` tries user pointers.
    pub fn start(
        device: OwnedFd,
        path: PathBuf,
        negotiated: Negotiated,
        picture: Picture,
        buffers: u32,
        direct: bool,
        pool: &mut FramePool,
    ) -> Result<Self, Fault> {
        let memory = Memory::Mapped(Vec::new());
        let mut stream = Self { device, memory, path, negotiated, picture, device_seq: None };
        // A picture that has to be decoded is not written to shared memory by the driver.
        let lent = direct && negotiated.usage != Use::Jpeg && stream.lend(buffers, pool).is_ok();
        if !lent {
            stream.map(buffers).map_err(|error| refusal(&stream.path, error))?;
        }
        let mut kind = ioctl::CAPTURE as i32;
        ioctl::stream_on(&stream.device, &mut kind).map_err(|error| match error {
            Errno::NOSPC => Fault::new(
                CameraState::Failed,
                format!(
                    "{}: not enough bandwidth on its USB bus; connect it to another port, or choose a \
                     smaller format or rate",
                    stream.path.display()
                ),
            ),
            error => refusal(&stream.path, error),
        })?;
        Ok(stream)
    }

    /// Whether the driver writes straight into shared memory.
    pub fn is_direct(&self) -> bool {
        matches!(self.memory, Memory::Lent(_))
    }

    fn request(&self, count: u32, memory: u32) -> SystemResult<u32> {
        let mut request =
            RequestBuffers { count, kind: ioctl::CAPTURE, memory, ..RequestBuffers::zeroed() };
        ioctl::request_buffers(&self.device, &mut request)?;
        Ok(request.count)
    }

    fn lend(&mut self, buffers: u32, pool: &mut FramePool) -> SystemResult<()> {
        let count = self.request(buffers, ioctl::MEMORY_USERPTR)?;
        let bytes = self.negotiated.size_image as usize;
        let loans: Result<Vec<FrameLoan>, _> = (0..count).map(|_| pool.loan(bytes)).collect();
        let queued = loans.map_err(|_| Errno::NOMEM).and_then(|loans| {
            self.memory = Memory::Lent(loans);
            (0..count).try_for_each(|index| self.queue(index))
        });
        if queued.is_err() {
            // Frees the buffers before the memory they point to.
            self.request(0, ioctl::MEMORY_USERPTR)?;
            self.memory = Memory::Mapped(Vec::new());
        }
        queued
    }

    fn map(&mut self, buffers: u32) -> SystemResult<()> {
        let count = self.request(buffers, ioctl::MEMORY_MMAP)?;
        let mut mappings = Vec::new();
        for index in 0..count {
            let mut buffer = Buffer {
                index,
                kind: ioctl::CAPTURE,
                memory: ioctl::MEMORY_MMAP,
                ..Buffer::zeroed()
            };
            ioctl::query_buffer(&self.device, &mut buffer)?;
            mappings.push(Mapping::new(&self.device, buffer.place, buffer.length as usize)?);
        }
        self.memory = Memory::Mapped(mappings);
        (0..count).try_for_each(|index| self.queue(index))
    }

    /// Queues a buffer to the driver.
    #[allow(unsafe_code)]
    fn queue(&mut self, index: u32) -> SystemResult<()> {
        let mut buffer = Buffer { index, kind: ioctl::CAPTURE, ..Buffer::zeroed() };
        match &mut self.memory {
            Memory::Lent(loans) => {
                let pixels = loans[index as usize].elements();
                buffer.memory = ioctl::MEMORY_USERPTR;
                buffer.place = pixels.as_mut_ptr() as u64;
                buffer.length = pixels.len() as u32;
            }
            Memory::Mapped(_) => buffer.memory = ioctl::MEMORY_MMAP,
        }
        // SAFETY: the memory is a loan that stays in `self.memory`, untouched, until its buffer
        // has been dequeued, or the buffers were freed, or the device was closed: `next` takes a
        // loan out only for a buffer that the driver has just given back, `lend` frees the buffers
        // before it lets go of the loans, and `device` is dropped before `memory`. The mapping of
        // the shared memory itself lives as long as any loan of it.
        unsafe { ioctl::queue_buffer(&self.device, &mut buffer) }
    }

    /// A filled buffer, if there is one.
    fn dequeue(&self) -> SystemResult<Option<Buffer>> {
        let memory = match self.memory {
            Memory::Lent(_) => ioctl::MEMORY_USERPTR,
            Memory::Mapped(_) => ioctl::MEMORY_MMAP,
        };
        let mut buffer = Buffer { kind: ioctl::CAPTURE, memory, ..Buffer::zeroed() };
        match ioctl::dequeue_buffer(&self.device, &mut buffer) {
            Ok(()) => Ok(Some(buffer)),
            Err(Errno::AGAIN) => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn fault(&self, error: Errno) -> Fault {
        match error {
            Errno::NODEV | Errno::NXIO => {
                let problem = format!("{} was unplugged", self.path.display());
                Fault::new(CameraState::Missing, problem)
            }
            error => refusal(&self.path, error),
        }
    }

    /// The frame in a filled buffer, which is queued again.
    fn take(&mut self, buffer: &Buffer, pool: &mut FramePool) -> Result<TakenFrame, Fault> {
        let index = buffer.index as usize;
        let is_whole = buffer.flags & ioctl::BUFFER_ERROR == 0
            && match self.negotiated.usage {
                Use::Raw(format, _) => {
                    let Picture { width, height, stride, .. } = self.picture;
                    u64::from(buffer.bytes_used) >= format.frame_bytes(width, height, stride)
                }
                _ => buffer.bytes_used > 0,
            };
        let taken = match &mut self.memory {
            _ if !is_whole => TakenFrame::Damaged,
            Memory::Lent(loans) => {
                match (pool.loan(self.negotiated.size_image as usize), loans.get_mut(index)) {
                    (Ok(fresh), Some(slot)) => TakenFrame::Frame(std::mem::replace(slot, fresh)),
                    (Err(_), _) => TakenFrame::NoMemory,
                    (_, None) => return Err(unknown_buffer()),
                }
            }
            Memory::Mapped(mappings) => {
                let mapping = mappings.get(index).ok_or_else(unknown_buffer)?;
                let used = mapping.bytes().get(..buffer.bytes_used as usize);
                copy(used.ok_or_else(unknown_buffer)?, self.negotiated, &self.picture, pool)
            }
        };
        self.queue(buffer.index).map_err(|error| self.fault(error))?;
        Ok(taken)
    }

    /// Extends a 32-bit number to one that never wraps.
    fn count(&mut self, sequence: u32) -> u64 {
        let seq = match self.device_seq {
            None => sequence.into(),
            Some(last) => last + u64::from(sequence.wrapping_sub(last as u32)),
        };
        self.device_seq = Some(seq);
        seq
    }
}

// Nearly all are frames.
#[allow(clippy::large_enum_variant)]
enum TakenFrame {
    Frame(FrameLoan),
    Damaged,
    NoMemory,
}

fn unknown_buffer() -> Fault {
    Fault::new(CameraState::Failed, "the driver gives back a buffer it was never given")
}

/// A copy of a mapped picture, decoded if needed.
fn copy(
    bytes: &[u8],
    negotiated: Negotiated,
    picture: &Picture,
    pool: &mut FramePool,
) -> TakenFrame {
    let length = match negotiated.usage {
        Use::Jpeg => 3 * picture.width as usize * picture.height as usize,
        _ => bytes.len(),
    };
    let Ok(mut frame) = pool.loan(length) else { return TakenFrame::NoMemory };
    if negotiated.usage == Use::Jpeg {
        let decoded = jpeg::decode(bytes, picture.width, picture.height, frame.elements());
        return if decoded { TakenFrame::Frame(frame) } else { TakenFrame::Damaged };
    }
    frame.elements().copy_from_slice(bytes);
    TakenFrame::Frame(frame)
}

impl Stream for V4l2Stream {
    fn next(&mut self, pool: &mut FramePool, timeout: Duration) -> Result<Option<Arrival>, Fault> {
        let timeout =
            Timespec { tv_sec: timeout.as_secs() as _, tv_nsec: timeout.subsec_nanos() as _ };
        match poll(&mut [PollFd::new(&self.device, PollFlags::IN)], Some(&timeout)) {
            Ok(0) | Err(Errno::INTR) => return Ok(None),
            Ok(_) => {}
            Err(error) => return Err(self.fault(error)),
        }
        let Some(buffer) = self.dequeue().map_err(|error| self.fault(error))? else {
            return Ok(None);
        };
        let t_capture_ns = capture_time(&buffer, self.picture.exposure_us);
        let device_seq = self.count(buffer.sequence);
        let picture = self.picture;
        Ok(Some(match self.take(&buffer, pool)? {
            TakenFrame::Frame(frame) => {
                Arrival::Frame(Delivery { frame, picture, device_seq, t_capture_ns })
            }
            TakenFrame::Damaged => Arrival::Incomplete,
            TakenFrame::NoMemory => Arrival::NoMemory,
        }))
    }
}

impl Drop for V4l2Stream {
    fn drop(&mut self) {
        // A device that is gone cannot be stopped; it is closed in any case.
        let _ = ioctl::stream_off(&self.device, &mut (ioctl::CAPTURE as i32));
    }
}

/// The middle of the exposure, from the driver's time of its start or, usually, of the end of the frame; the
/// present for drivers without such a time.
fn capture_time(buffer: &Buffer, exposure_us: u32) -> u64 {
    if buffer.flags & ioctl::TIMESTAMP_MASK != ioctl::TIMESTAMP_MONOTONIC {
        return monotonic_ns();
    }
    let time_ns = buffer.seconds.saturating_mul(1_000_000_000) + buffer.microseconds * 1000;
    let half_ns = i64::from(exposure_us) * 500;
    let middle_ns = if buffer.flags & ioctl::TIMESTAMP_START_OF_EXPOSURE != 0 {
        time_ns + half_ns
    } else {
        time_ns - half_ns
    };
    u64::try_from(middle_ns).unwrap_or(0)
}

/// Layout of a picture in the negotiated format.
pub fn picture_of(negotiated: &Negotiated, width: u32, height: u32, exposure_us: u32) -> Picture {
    let (pixel_format, bayer_order) = match negotiated.usage {
        Use::Raw(format, order) => (format, order),
        _ => (PixelFormat::Rgb24, messages::BayerOrder::Rggb),
    };
    Picture { width, height, stride: negotiated.stride, pixel_format, bayer_order, exposure_us }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capture_time_is_the_middle_of_the_exposure() {
        let flags = ioctl::TIMESTAMP_MONOTONIC;
        let buffer = Buffer { flags, seconds: 5, microseconds: 4000, ..Buffer::zeroed() };
        assert_eq!(capture_time(&buffer, 2000), 5_003_000_000);
        let flags = flags | ioctl::TIMESTAMP_START_OF_EXPOSURE;
        assert_eq!(capture_time(&Buffer { flags, ..buffer }, 2000), 5_005_000_000);
        let now = monotonic_ns();
        assert!(capture_time(&Buffer { flags: 0, ..buffer }, 2000) >= now, "another clock");
    }
}
