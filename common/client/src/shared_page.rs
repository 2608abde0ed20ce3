//! A page of atomic numbers in a file that processes share by mapping it.
//!
//! The page's memory is allocated when the page is opened, and an error is returned if there is none. A
//! page that only had its size set would be allocated at the first access, and a process that touches
//! memory which the system cannot provide is killed by a SIGBUS.

use crate::{memory, private};
use rustix::fs::{FallocateFlags, fallocate, ftruncate};
use rustix::io::Errno;
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use std::fs::File;
use std::io;
use std::path::Path;
use std::ptr::NonNull;
use std::sync::atomic::AtomicU32;

/// Size of a page, the smallest unit of a mapping.
const MAPPED_BYTES: usize = 4096;

/// Numbers that processes may share.
///
/// # Safety
///
/// The type must be valid when all its bytes are zero, not larger than a page, and safe to access from
/// several processes at once.
#[allow(unsafe_code)]
pub unsafe trait Shareable {}

// SAFETY: an atomic number meets all three.
#[allow(unsafe_code)]
unsafe impl Shareable for AtomicU32 {}

/// Mapped numbers. They start at 0 and live as long as their file, even without a process that maps
/// them.
pub struct SharedPage<T: Shareable> {
    page: NonNull<T>,
}

impl<T: Shareable> SharedPage<T> {
    /// Maps the page in this file. A missing file is created, readable by this user alone.
    #[allow(unsafe_code)]
    pub fn open(path: &Path) -> io::Result<Self> {
        const { assert!(size_of::<T>() <= MAPPED_BYTES, "the numbers must fit a page") };
        // A process that can open the file could truncate it under this one, hence the private open.
        let file = private::open_file(path)?;
        take_memory(&file)?;
        // SAFETY: a new mapping at an address the system chooses. It is unmapped in `drop`.
        let page = unsafe {
            let protection = ProtFlags::READ | ProtFlags::WRITE;
            mmap(std::ptr::null_mut(), MAPPED_BYTES, protection, MapFlags::SHARED, &file, 0)?
        };
        let page = Self { page: NonNull::new(page.cast()).ok_or(io::ErrorKind::OutOfMemory)? };
        // For file systems on which `fallocate` is not supported.
        if !memory::populate(page.page.as_ptr().cast(), MAPPED_BYTES) {
            return Err(Errno::NOSPC.into());
        }
        Ok(page)
    }

    /// The numbers.
    #[allow(unsafe_code)]
    pub fn get(&self) -> &T {
        // SAFETY: mapped as long as `self` lives, page-aligned, and initially filled with zeros, which
        // are valid numbers; other processes access them atomically too.
        unsafe { self.page.as_ref() }
    }
}

impl<T: Shareable> Drop for SharedPage<T> {
    #[allow(unsafe_code)]
    fn drop(&mut self) {
        // SAFETY: mapped by `open`; no reference to it outlives `self`.
        let _ = unsafe { munmap(self.page.as_ptr().cast(), MAPPED_BYTES) };
    }
}

/// Gives the file the size of a page and allocates its memory; existing bytes stay. Every process asks
/// for the same size, so no mapping loses its memory.
fn take_memory(file: &File) -> io::Result<()> {
    loop {
        match fallocate(file, FallocateFlags::empty(), 0, MAPPED_BYTES as u64) {
            Err(Errno::INTR) => {}
            Err(Errno::OPNOTSUPP | Errno::NOSYS) => {
                return Ok(ftruncate(file, MAPPED_BYTES as u64)?);
            }
            taken => return Ok(taken?),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::MetadataExt;
    use std::sync::atomic::Ordering;

    #[test]
    fn its_memory_is_there_before_it_is_touched() {
        let path = Path::new("/dev/shm").join(format!("tl-test-page-{}", std::process::id()));
        let page = SharedPage::<AtomicU32>::open(&path).unwrap();
        let data = std::fs::metadata(&path).unwrap();
        assert_eq!((data.len(), data.blocks() * 512), (MAPPED_BYTES as u64, MAPPED_BYTES as u64));
        page.get().store(7, Ordering::Relaxed);
        assert_eq!(SharedPage::<AtomicU32>::open(&path).unwrap().get().load(Ordering::Relaxed), 7);
        std::fs::remove_file(&path).unwrap();
    }
}
