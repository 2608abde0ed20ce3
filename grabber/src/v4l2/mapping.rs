//! A driver's memory, mapped for reading.

// Mapping memory requires it; each place states why it is sound.
#![allow(unsafe_code)]

use rustix::fd::AsFd;
use rustix::io::Result;
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use std::ffi::c_void;

/// Memory of a driver, readable until this is dropped.
pub struct Mapping {
    start: *mut c_void,
    length: usize,
}

impl Mapping {
    /// Maps the memory at this offset of the device.
    pub fn new(device: impl AsFd, offset: u64, length: usize) -> Result<Self> {
        let flags = MapFlags::SHARED;
        // SAFETY: the kernel chooses a free place, so nothing of ours is mapped over.
        let start =
            unsafe { mmap(std::ptr::null_mut(), length, ProtFlags::READ, flags, device, offset)? };
        Ok(Self { start, length })
    }

    /// The bytes written by the driver. Must be called only while the buffer is dequeued; otherwise the
    /// contents may be torn, though never outside the mapping.
    pub fn bytes(&self) -> &[u8] {
        // SAFETY: the mapping has this place and length until `self` is dropped. The driver writes
        // only to buffers it was given, and a buffer is read between being dequeued and queued.
        unsafe { std::slice::from_raw_parts(self.start.cast::<u8>(), self.length) }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: no reference into the mapping exists any more, since they borrow `self`.
        let _ = unsafe { munmap(self.start, self.length) };
    }
}
