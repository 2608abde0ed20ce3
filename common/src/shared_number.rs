//! A number in a file that processes share by mapping it.

use rustix::fs::{Mode, OFlags};
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use std::io;
use std::path::Path;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU32, AtomicU64};

/// The smallest piece of memory the system maps.
const MAPPED_BYTES: usize = 4096;

/// Numbers that may be shared.
///
/// # Safety
///
/// Valid when all their bytes are zero, not larger than a page, and meant to be touched by several
/// processes at once.
#[allow(unsafe_code)]
pub(crate) unsafe trait Shareable {}

// SAFETY: atomic numbers are.
#[allow(unsafe_code)]
unsafe impl Shareable for AtomicU32 {}
// SAFETY: as above.
#[allow(unsafe_code)]
unsafe impl Shareable for AtomicU64 {}

/// A mapped number. It begins with 0 and outlives the processes that map it, as long as its file does.
pub(crate) struct SharedNumber<T: Shareable> {
    page: NonNull<T>,
}

impl<T: Shareable> SharedNumber<T> {
    /// Maps the number in this file, which is made, for nobody else to read, if there is none.
    #[allow(unsafe_code)]
    pub fn open(path: &Path) -> io::Result<Self> {
        let flags = OFlags::RDWR | OFlags::CREATE | OFlags::CLOEXEC | OFlags::NOFOLLOW;
        let file = rustix::fs::open(path, flags, Mode::RUSR | Mode::WUSR)?;
        // Nobody ever gives it another size, so nobody's map loses its memory.
        rustix::fs::ftruncate(&file, MAPPED_BYTES as u64)?;
        // SAFETY: a new map of our own at a place the system chooses. It is unmapped in `drop`.
        let page = unsafe {
            let protection = ProtFlags::READ | ProtFlags::WRITE;
            mmap(std::ptr::null_mut(), MAPPED_BYTES, protection, MapFlags::SHARED, &file, 0)?
        };
        let page = NonNull::new(page.cast()).ok_or(io::ErrorKind::OutOfMemory)?;
        Ok(Self { page })
    }

    /// The number.
    #[allow(unsafe_code)]
    pub fn get(&self) -> &T {
        // SAFETY: mapped as long as `self` lives, aligned as a page is, and filled with zeros at
        // first, which is a valid number; other processes touch it as an atomic one too.
        unsafe { self.page.as_ref() }
    }
}

impl<T: Shareable> Drop for SharedNumber<T> {
    #[allow(unsafe_code)]
    fn drop(&mut self) {
        // SAFETY: mapped by `open`; no reference to it outlives `self`.
        let _ = unsafe { munmap(self.page.as_ptr().cast(), MAPPED_BYTES) };
    }
}
