//! An allocator that measures the peak memory of a thread. Memory allocated inside zstd does not count.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// The system's allocator with measurement.
struct Measuring;

thread_local! {
    static NOW: Cell<i64> = const { Cell::new(0) };
    static MOST: Cell<i64> = const { Cell::new(0) };
}

fn add(bytes: i64) {
    NOW.set(NOW.get() + bytes);
    MOST.set(MOST.get().max(NOW.get()));
}

// SAFETY: all work is done by the system allocator; measuring only touches two thread-local numbers,
// which need no allocation and no destructor.
#[allow(unsafe_code)] // the trait is unsafe
unsafe impl GlobalAlloc for Measuring {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        add(layout.size() as i64);
        // SAFETY: the caller's guarantee.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, place: *mut u8, layout: Layout) {
        add(-(layout.size() as i64));
        // SAFETY: the caller's guarantee.
        unsafe { System.dealloc(place, layout) }
    }

    unsafe fn realloc(&self, place: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // Both blocks may exist for a moment.
        add(size as i64);
        add(-(layout.size() as i64));
        // SAFETY: the caller's guarantee.
        unsafe { System.realloc(place, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Measuring = Measuring;

/// Peak memory of `work`, besides what the thread had before.
pub fn most_bytes_in(work: impl FnOnce()) -> u64 {
    let before = NOW.get();
    MOST.set(before);
    work();
    (MOST.get() - before).max(0) as u64
}

#[test]
fn the_most_memory_at_a_time_is_measured() {
    let both = most_bytes_in(|| {
        drop(std::hint::black_box(vec![1u8; 5000]));
        drop(std::hint::black_box(vec![1u8; 3000]));
    });
    assert!((5000..8000).contains(&both), "{both}");
}
