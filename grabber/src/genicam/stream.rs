//! The library's streams: shared memory is lent to them, and returned with a picture in it.

// A foreign library cannot be called otherwise.
#![allow(unsafe_code)]

use super::library::{Library, Object};
use crate::camera::FrameLoan;
use std::ffi::{c_char, c_int, c_uint, c_void};
use std::mem::ManuallyDrop;
use std::ptr::{null, null_mut};
use std::time::Duration;

/// Receives a camera's pictures in shared memory.
pub struct Stream {
    library: &'static Library,
    object: Object,
    /// The memory lent to the library, by buffer; `None` while a buffer is being replaced.
    loans: ManuallyDrop<Vec<Option<FrameLoan>>>,
}

/// A buffer returned by the library, with its memory.
pub struct Received {
    /// The picture's memory.
    pub frame: FrameLoan,
    /// Index of the buffer.
    pub index: usize,
    /// Whether the whole picture has arrived.
    pub is_complete: bool,
    /// The camera's number for it.
    pub frame_id: u64,
    /// Capture time on the camera's clock.
    pub device_ns: u64,
    /// Arrival of its first packet, nanoseconds since 1970.
    pub arrived_wall_ns: u64,
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// GenICam's number of the format.
    pub format: u32,
}

impl Stream {
    /// A stream without buffers.
    ///
    /// # Safety
    ///
    /// `object` must be a stream, and this must be its only reference.
    pub(super) unsafe fn new(library: &'static Library, object: Object) -> Self {
        Self { library, object, loans: ManuallyDrop::new(Vec::new()) }
    }

    /// Configures sockets and the handling of lost packets. Only for streams from the network.
    pub fn set_network(&self, socket_buffer_bytes: u32, resend: bool, frame_timeout: Duration) {
        /// A socket buffer of fixed size.
        const FIXED: c_int = 0;
        let timeout_us = frame_timeout.as_micros() as c_uint;
        let end: *const c_char = null();
        // SAFETY: the object is a stream of the network, which has these properties, of these types
        // (two enumerations, which are passed as int, an int, and an unsigned int).
        unsafe {
            (self.library.g_object_set)(
                self.object,
                c"socket-buffer".as_ptr(),
                FIXED,
                c"socket-buffer-size".as_ptr(),
                socket_buffer_bytes as c_int,
                c"packet-resend".as_ptr(),
                c_int::from(resend),
                c"frame-retention".as_ptr(),
                timeout_us,
                end,
            );
        }
    }

    /// Lends memory to the library, as a new buffer.
    pub fn add(&mut self, frame: FrameLoan) {
        self.loans.push(None);
        self.give(self.loans.len() - 1, frame);
    }

    /// Lends memory to the library, in place of the memory returned in this buffer.
    pub fn give(&mut self, index: usize, mut frame: FrameLoan) {
        let pixels = frame.elements();
        // SAFETY: the memory is a loan that stays in `self.loans`, untouched, until its buffer has
        // come back from the library (`receive`), or the stream's thread has ended (`end`); a stream
        // that is just dropped leaks both, and writes on into memory that stays ours.
        // The library never frees memory it was lent. The user data is a number, not an address.
        // The stream takes over the buffer's reference.
        unsafe {
            let buffer = (self.library.arv_buffer_new_full)(
                pixels.len(),
                pixels.as_mut_ptr().cast(),
                index as *mut c_void,
                null_mut(),
            );
            self.loans[index] = Some(frame);
            (self.library.arv_stream_push_buffer)(self.object, buffer);
        }
    }

    /// Waits for a buffer to be returned, for at most `timeout`.
    pub fn receive(&mut self, timeout: Duration) -> Option<Received> {
        let Self { library, object, loans } = self;
        /// Everything has arrived.
        const SUCCESS: c_int = 0;
        // SAFETY: the object is a stream. A buffer that comes back is ours alone; its user data is
        // the number it was made with; the picture's properties may only be asked of a complete
        // picture. The buffer's memory is a loan of ours, so the buffer may go and the loan stay.
        unsafe {
            let buffer =
                (library.arv_stream_timeout_pop_buffer)(*object, timeout.as_micros() as u64);
            if buffer.is_null() {
                return None;
            }
            let index = (library.arv_buffer_get_user_data)(buffer) as usize;
            let is_complete = (library.arv_buffer_get_status)(buffer) == SUCCESS;
            let received = loans.get_mut(index).and_then(Option::take).map(|frame| {
                let (mut width, mut height, mut format) = (0, 0, 0);
                if is_complete {
                    width = (library.arv_buffer_get_image_width)(buffer) as u32;
                    height = (library.arv_buffer_get_image_height)(buffer) as u32;
                    format = (library.arv_buffer_get_image_pixel_format)(buffer);
                }
                Received {
                    frame,
                    index,
                    is_complete,
                    frame_id: (library.arv_buffer_get_frame_id)(buffer),
                    device_ns: (library.arv_buffer_get_timestamp)(buffer),
                    arrived_wall_ns: (library.arv_buffer_get_system_timestamp)(buffer),
                    width,
                    height,
                    format,
                }
            });
            (library.g_object_unref)(buffer);
            received
        }
    }
}

/// A stream that no longer receives. Dropping it takes seconds if the camera does not answer.
pub struct EndedStream {
    library: &'static Library,
    object: Object,
}

// SAFETY: the library's objects may be let go of on any thread.
unsafe impl Send for EndedStream {}

impl Stream {
    /// Ends receiving: from here on, nothing is written to shared memory.
    pub fn end(mut self) -> EndedStream {
        /// The buffers are deleted, too.
        const DELETE_BUFFERS: c_int = 1;
        // SAFETY: the object is a stream. This waits for its thread, the only one that writes to
        // the loans, to end; only then do these go.
        unsafe { (self.library.arv_stream_stop_thread)(self.object, DELETE_BUFFERS) };
        self.loans.clear();
        EndedStream { library: self.library, object: self.object }
    }
}

impl Drop for EndedStream {
    fn drop(&mut self) {
        // SAFETY: the only reference of ours.
        unsafe { (self.library.g_object_unref)(self.object) };
    }
}
