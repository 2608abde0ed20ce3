//! A classifier at work allocates nothing: after the first frame of a format, memory is what it was.

mod reference;

use common::config::Config;
use common::messages::{BayerOrder, PixelFormat, Run, RunsHeader};
use reference::{Frame, Noise};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use touchline_classifier::{Classifier, SimdLevel};

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

// There is no other way to see allocations.
#[allow(unsafe_code)]
// SAFETY: all work is the system allocator's; counting touches a thread-local integer and allocates
// nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = ALLOCATIONS.try_with(|count| count.set(count.get() + 1));
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: the caller's promises are passed on.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn steps_after_the_first_allocate_nothing() {
    let config = Config::default();
    let mut noise = Noise(5);
    for level in SimdLevel::available() {
        let mut classifier = Classifier::with_level(&config, level).unwrap();
        let mut header = RunsHeader::default();
        let mut runs = vec![Run::default(); 32_768];
        for format in PixelFormat::ALL {
            let stride = format.row_bytes(640) as u32;
            let bytes = format.frame_bytes(640, 480, stride);
            let pixels = (0..bytes).map(|_| noise.next_u32() as u8).collect();
            let mut frame = Frame::new(640, 480, stride, BayerOrder::Gbrg, pixels);
            frame.header.pixel_format = format as u32;
            let mut step = || {
                classifier.step(&frame.header, &frame.pixels, &mut header, &mut runs).unwrap();
                ALLOCATIONS.get()
            };
            let warmed_up = step();
            assert!(warmed_up > 0, "allocations are counted");
            assert_eq!(step(), warmed_up, "{level}, {format}");
        }
    }
}
