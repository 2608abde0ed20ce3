//! Aravis, loaded when it is first needed.
//!
//! The program is built and starts without it; only GigE Vision and USB3 Vision cameras need it. Declared are
//! the functions in use, with the signatures of Aravis' header files (0.8, whose interface is frozen).

// A foreign library cannot be called otherwise; `objects` and `stream` wrap it.
#![allow(unsafe_code)]

use libloading::Library as SharedLibrary;
use std::ffi::{c_char, c_double, c_int, c_uint, c_void};
use std::sync::{Mutex, PoisonError};

/// Any object of the library.
pub type Object = *mut c_void;
/// Address at which a function stores its error.
pub type ErrorPlace = *mut *mut GError;

/// An error of the library.
#[repr(C)]
pub struct GError {
    pub domain: u32,
    pub code: c_int,
    pub message: *mut c_char,
}

/// File name in all distributions.
const FILE: &str = "libaravis-0.8.so.0";

/// Error message if the library is missing.
const MISSING: &str = "GigE Vision and USB3 Vision cameras need the library Aravis 0.8: install the \
                       package libaravis-0.8-0 (`sudo apt-get install libaravis-0.8-0`)";

macro_rules! library {
    ($($name:ident: fn($($argument:ty),*) $(-> $result:ty)?;)*) => {
        /// The functions of the library.
        pub struct Library {
            $(pub $name: unsafe extern "C" fn($($argument),*) $(-> $result)?,)*
            /// Takes pairs of a property's name and its value, and a null pointer at the end.
            pub g_object_set: unsafe extern "C" fn(Object, *const c_char, ...),
            // Last field: the functions above are in this library.
            _file: SharedLibrary,
        }

        impl Library {
            fn load(file: &str) -> Result<Self, String> {
                // SAFETY: loading runs the library's initialisers; those of Aravis and of what it
                // needs (GLib, libusb) may run at any time and on any thread.
                let file = unsafe { SharedLibrary::new(file) }
                    .map_err(|error| format!("{MISSING}; the system says: {error}"))?;
                let missing = |error: libloading::Error| format!("{FILE} is too old: {error}");
                Ok(Self {
                    // SAFETY: the types are those of the functions' declarations in the header
                    // files of Aravis 0.8 and GLib. The pointers stay valid, since the file is
                    // kept, and is never unloaded (see `library`).
                    $($name: unsafe {
                        *file.get(concat!(stringify!($name), "\0").as_bytes()).map_err(missing)?
                    },)*
                    // SAFETY: as above.
                    g_object_set: unsafe { *file.get(b"g_object_set\0").map_err(missing)? },
                    _file: file,
                })
            }
        }
    };
}

library! {
    g_object_unref: fn(Object);
    g_error_free: fn(*mut GError);
    g_free: fn(*mut c_void);
    arv_enable_interface: fn(*const c_char);
    arv_update_device_list: fn();
    arv_get_n_devices: fn() -> c_uint;
    arv_get_device_id: fn(c_uint) -> *const c_char;
    arv_get_device_vendor: fn(c_uint) -> *const c_char;
    arv_get_device_model: fn(c_uint) -> *const c_char;
    arv_get_device_protocol: fn(c_uint) -> *const c_char;
    arv_get_device_address: fn(c_uint) -> *const c_char;
    arv_camera_new: fn(*const c_char, ErrorPlace) -> Object;
    arv_camera_get_device: fn(Object) -> Object;
    arv_camera_get_vendor_name: fn(Object, ErrorPlace) -> *const c_char;
    arv_camera_get_model_name: fn(Object, ErrorPlace) -> *const c_char;
    arv_camera_is_gv_device: fn(Object) -> c_int;
    arv_camera_gv_set_packet_size: fn(Object, c_int, ErrorPlace);
    arv_camera_gv_set_packet_size_adjustment: fn(Object, c_int);
    arv_camera_gv_set_stream_options: fn(Object, c_int);
    arv_camera_dup_available_pixel_formats_as_strings:
        fn(Object, *mut c_uint, ErrorPlace) -> *mut *const c_char;
    arv_camera_set_pixel_format_from_string: fn(Object, *const c_char, ErrorPlace);
    arv_camera_set_region: fn(Object, c_int, c_int, c_int, c_int, ErrorPlace);
    arv_camera_get_region:
        fn(Object, *mut c_int, *mut c_int, *mut c_int, *mut c_int, ErrorPlace);
    arv_camera_is_frame_rate_available: fn(Object, ErrorPlace) -> c_int;
    arv_camera_set_frame_rate: fn(Object, c_double, ErrorPlace);
    arv_camera_get_frame_rate: fn(Object, ErrorPlace) -> c_double;
    arv_camera_is_feature_available: fn(Object, *const c_char, ErrorPlace) -> c_int;
    arv_camera_get_float: fn(Object, *const c_char, ErrorPlace) -> c_double;
    arv_camera_get_integer: fn(Object, *const c_char, ErrorPlace) -> i64;
    arv_camera_get_float_bounds:
        fn(Object, *const c_char, *mut c_double, *mut c_double, ErrorPlace);
    arv_camera_get_integer_bounds: fn(Object, *const c_char, *mut i64, *mut i64, ErrorPlace);
    arv_camera_get_exposure_time: fn(Object, ErrorPlace) -> c_double;
    arv_camera_set_acquisition_mode: fn(Object, c_int, ErrorPlace);
    arv_camera_get_payload: fn(Object, ErrorPlace) -> c_uint;
    arv_camera_create_stream: fn(Object, *mut c_void, *mut c_void, ErrorPlace) -> Object;
    arv_camera_start_acquisition: fn(Object, ErrorPlace);
    arv_camera_stop_acquisition: fn(Object, ErrorPlace);
    arv_device_set_features_from_string: fn(Object, *const c_char, ErrorPlace) -> c_int;
    arv_stream_push_buffer: fn(Object, Object);
    arv_stream_stop_thread: fn(Object, c_int) -> c_uint;
    arv_stream_timeout_pop_buffer: fn(Object, u64) -> Object;
    arv_buffer_new_full: fn(usize, *mut c_void, *mut c_void, *mut c_void) -> Object;
    arv_buffer_get_user_data: fn(Object) -> *const c_void;
    arv_buffer_get_status: fn(Object) -> c_int;
    arv_buffer_get_frame_id: fn(Object) -> u64;
    arv_buffer_get_timestamp: fn(Object) -> u64;
    arv_buffer_get_system_timestamp: fn(Object) -> u64;
    arv_buffer_get_image_width: fn(Object) -> c_int;
    arv_buffer_get_image_height: fn(Object) -> c_int;
    arv_buffer_get_image_pixel_format: fn(Object) -> u32;
}

/// The library. It is loaded once and never unloaded; while it is missing, each call tries again.
pub fn library() -> Result<&'static Library, String> {
    static LIBRARY: Mutex<Option<&'static Library>> = Mutex::new(None);
    let mut known = LIBRARY.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(library) = *known {
        return Ok(library);
    }
    // Its threads run on after the last camera, so it is never unloaded.
    let library: &'static Library = Box::leak(Box::new(Library::load(FILE)?));
    *known = Some(library);
    Ok(library)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_library_is_reported_with_the_package() {
        let problem = Library::load("libthere-is-none-0.8.so.0").err().unwrap();
        assert!(problem.contains("apt-get install libaravis-0.8-0"), "{problem}");
    }

    #[test]
    fn another_library_is_refused() {
        // Always present, and without any of the functions.
        let problem = Library::load("libc.so.6").err().unwrap();
        assert!(problem.contains("too old"), "{problem}");
    }
}
