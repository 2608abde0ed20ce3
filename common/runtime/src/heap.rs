//! Returning freed memory to the system.

/// Makes the allocator give every freed block of 128 kB or more back to the system at once.
///
/// By default glibc raises that limit to the size of any such block that is freed. Later blocks of that
/// size then come from its heap, which shrinks only from its end: a process that once held a hundred
/// frames keeps their memory. For processes that hold large buffers now and then. A block costs two
/// system calls, so buffers in constant use should be reused.
#[allow(unsafe_code)] // neither `std` nor rustix sets options of the allocator
pub fn return_large_blocks() {
    #[cfg(target_env = "gnu")]
    {
        const LARGE_BYTES: libc::c_int = 128 << 10;
        // SAFETY: the call changes a number inside the allocator, under the allocator's lock.
        unsafe { libc::mallopt(libc::M_MMAP_THRESHOLD, LARGE_BYTES) };
    }
}
