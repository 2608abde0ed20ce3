//! A driver's memory, mapped to be read.

// Mapping memory needs it; what makes it sound is said at each place.
#![allow(unsafe_code)]

use rustix::fd::AsFd;
use rustix::io::Result;
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use std::ffi::c_void;

/// Memory of a driver, readable until it is dropped.
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

    /// What the driver has written. Call only while the buffer is not the driver's: what is read
    /// meanwhile is torn, though never outside the mapping.
    pub fn bytes(&self) -> &[u8] {
        // SAFETY: the mapping has this place and length until `self` is dropped. The driver writes
        // only to buffers it was given, and a buffer is read between being dequeued and queued.
        unsafe { std::slice::from_raw_parts(self.start.cast::<u8>(), self.length) }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: nobody holds a reference into the mapping, since they borrow `self`.
        let _ = unsafe { munmap(self.start, self.length) };
    }
}
