//! Safe methods for the library's cameras and their discovery.

// A foreign library cannot be called otherwise.
#![allow(unsafe_code)]

use super::library::{ErrorPlace, GError, Library, Object, library};
use super::stream::Stream;
use std::ffi::{CStr, CString, c_char, c_int, c_uint};
use std::ptr::{null, null_mut};

/// An error of the library.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AravisError {
    /// One of [`error_code`], if it concerns the device.
    pub code: c_int,
    /// The library's message.
    pub text: String,
}

/// Numbers of the library's errors.
pub mod error_code {
    use std::ffi::c_int;

    /// The device is gone.
    pub const NOT_CONNECTED: c_int = 2;
    /// The device does not answer.
    pub const TIMEOUT: c_int = 5;
    /// There is no such device.
    pub const NOT_FOUND: c_int = 6;
    /// Another program controls the device.
    pub const NOT_CONTROLLER: c_int = 10;
    /// Another program controls the device.
    pub const ACCESS_DENIED: c_int = 17;
    /// The device is in use.
    pub const BUSY: c_int = 18;
}

type Outcome<T> = Result<T, AravisError>;

/// Calls a function that stores its error at a given address.
fn checked<T>(library: &Library, call: impl FnOnce(ErrorPlace) -> T) -> Outcome<T> {
    let mut error: *mut GError = null_mut();
    let value = call(&mut error);
    if error.is_null() {
        return Ok(value);
    }
    // SAFETY: a function that fails leaves an error with a message, which is ours to free.
    let copy = unsafe {
        let copy = AravisError { code: (*error).code, text: text((*error).message) };
        (library.g_error_free)(error);
        copy
    };
    Err(copy)
}

/// A text of the library; empty if it is null.
///
/// # Safety
///
/// `text` must be null or point to a zero-terminated text.
unsafe fn text(text: *const c_char) -> String {
    if text.is_null() {
        return String::new();
    }
    // SAFETY: the caller's promise.
    unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned()
}

fn c_text(text: &str) -> CString {
    CString::new(text.replace('\0', "")).unwrap_or_default()
}

/// A camera on network or bus.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DiscoveredCamera {
    /// Its name for opening it.
    pub id: String,
    /// Its vendor.
    pub vendor: String,
    /// Its model.
    pub model: String,
    /// "GigEVision", "USB3Vision" or "Fake".
    pub protocol: String,
    /// Its address.
    pub address: String,
}

/// Enables discovery of the library's simulated camera.
pub fn enable_fake() -> Result<(), String> {
    // SAFETY: takes the name of an interface.
    unsafe { (library()?.arv_enable_interface)(c"Fake".as_ptr()) };
    Ok(())
}

/// Discovers cameras; takes about a second.
pub fn discover() -> Result<Vec<DiscoveredCamera>, String> {
    let library = library()?;
    // SAFETY: no arguments; the texts are the library's until the next update, and copied here.
    // The library locks its list.
    unsafe {
        (library.arv_update_device_list)();
        let count = (library.arv_get_n_devices)();
        Ok((0..count)
            .map(|index| DiscoveredCamera {
                id: text((library.arv_get_device_id)(index)),
                vendor: text((library.arv_get_device_vendor)(index)),
                model: text((library.arv_get_device_model)(index)),
                protocol: text((library.arv_get_device_protocol)(index)),
                address: text((library.arv_get_device_address)(index)),
            })
            .collect())
    }
}

/// An opened camera.
pub struct Camera {
    library: &'static Library,
    object: Object,
}

// SAFETY: the library's cameras may be used from any thread; the library locks what threads share.
unsafe impl Send for Camera {}

impl Camera {
    /// Opens the camera of this name, or the first one.
    pub fn open(library: &'static Library, id: Option<&str>) -> Outcome<Self> {
        let id = id.map(c_text);
        let name = id.as_ref().map_or(null(), |id| id.as_ptr());
        // SAFETY: the name is null or a text that outlives the call.
        let object = checked(library, |error| unsafe { (library.arv_camera_new)(name, error) })?;
        if object.is_null() {
            return Err(AravisError {
                code: error_code::NOT_FOUND,
                text: "no camera found".into(),
            });
        }
        Ok(Self { library, object })
    }

    /// Vendor and model.
    pub fn model(&self) -> String {
        let (library, object) = (self.library, self.object);
        // SAFETY: the object is a camera; the texts are its own.
        let of = |function: unsafe extern "C" fn(Object, ErrorPlace) -> *const c_char| {
            checked(library, |error| unsafe { text(function(object, error)) }).unwrap_or_default()
        };
        let names = [of(library.arv_camera_get_vendor_name), of(library.arv_camera_get_model_name)];
        names.join(" ").trim().to_string()
    }

    /// Whether it is connected by network.
    pub fn is_gige(&self) -> bool {
        // SAFETY: the object is a camera.
        unsafe { (self.library.arv_camera_is_gv_device)(self.object) != 0 }
    }

    /// Sets the size of its packets, which then never changes by itself, and the kind of socket. Only for
    /// cameras [connected by network](Self::is_gige).
    pub fn set_packets(&self, bytes: u32, packet_socket: bool) -> Outcome<()> {
        let (library, object) = (self.library, self.object);
        /// Never.
        const ADJUSTMENT: c_int = 0;
        let options = c_int::from(!packet_socket);
        // SAFETY: the object is a camera of the network; the numbers are the library's own.
        unsafe {
            (library.arv_camera_gv_set_stream_options)(object, options);
            (library.arv_camera_gv_set_packet_size_adjustment)(object, ADJUSTMENT);
            checked(library, |error| {
                (library.arv_camera_gv_set_packet_size)(object, bytes as c_int, error)
            })
        }
    }

    /// The formats it offers, by GenICam's names.
    pub fn formats(&self) -> Outcome<Vec<String>> {
        let (library, object) = (self.library, self.object);
        let mut count: c_uint = 0;
        // SAFETY: the object is a camera; what comes back is a list of `count` texts. The list is
        // ours to free, the texts are the camera's.
        unsafe {
            let list = checked(library, |error| {
                (library.arv_camera_dup_available_pixel_formats_as_strings)(
                    object, &mut count, error,
                )
            })?;
            if list.is_null() {
                return Ok(Vec::new());
            }
            let names = (0..count as usize).map(|index| text(*list.add(index))).collect();
            (library.g_free)(list.cast());
            Ok(names)
        }
    }

    /// Sets the format.
    pub fn set_format(&self, name: &str) -> Outcome<()> {
        let (library, object, name) = (self.library, self.object, c_text(name));
        // SAFETY: the object is a camera; the text outlives the call.
        checked(library, |error| unsafe {
            (library.arv_camera_set_pixel_format_from_string)(object, name.as_ptr(), error)
        })
    }

    /// Sets the size of its pictures, anywhere on the sensor, and returns the resulting size.
    pub fn set_size(&self, width: u32, height: u32) -> Outcome<(u32, u32)> {
        let (library, object) = (self.library, self.object);
        let (mut x, mut y, mut got_width, mut got_height) = (0, 0, 0, 0);
        // SAFETY: the object is a camera; the places are ours. Negative offsets are left alone.
        unsafe {
            checked(library, |error| {
                (library.arv_camera_set_region)(
                    object,
                    -1,
                    -1,
                    width as c_int,
                    height as c_int,
                    error,
                )
            })?;
            checked(library, |error| {
                (library.arv_camera_get_region)(
                    object,
                    &mut x,
                    &mut y,
                    &mut got_width,
                    &mut got_height,
                    error,
                )
            })?;
        }
        Ok((got_width as u32, got_height as u32))
    }

    /// Sets the frame rate, and returns the resulting one; `None` if it cannot be set.
    pub fn set_rate(&self, fps: f64) -> Outcome<Option<f64>> {
        let (library, object) = (self.library, self.object);
        // SAFETY: the object is a camera.
        unsafe {
            let available = checked(library, |error| {
                (library.arv_camera_is_frame_rate_available)(object, error)
            })?;
            if available == 0 {
                return Ok(None);
            }
            checked(library, |error| (library.arv_camera_set_frame_rate)(object, fps, error))?;
            checked(library, |error| (library.arv_camera_get_frame_rate)(object, error)).map(Some)
        }
    }

    /// The exposure time in microseconds, if it is readable.
    pub fn exposure_us(&self) -> Option<f64> {
        let (library, object) = (self.library, self.object);
        // SAFETY: the object is a camera.
        checked(library, |error| unsafe { (library.arv_camera_get_exposure_time)(object, error) })
            .ok()
            .filter(|time| *time > 0.0)
    }

    /// Whether a feature is available now.
    pub fn has(&self, feature: &str) -> bool {
        let (library, object, name) = (self.library, self.object, c_text(feature));
        // SAFETY: the object is a camera; the text outlives the call.
        checked(library, |error| unsafe {
            (library.arv_camera_is_feature_available)(object, name.as_ptr(), error)
        })
        .is_ok_and(|available| available != 0)
    }

    /// Lowest, highest and present value of a numeric feature.
    pub fn range(&self, feature: &str) -> Option<[f64; 3]> {
        let (library, object, name) = (self.library, self.object, c_text(feature));
        let (mut low, mut high) = (0.0, 0.0);
        let (mut lowest, mut highest) = (0, 0);
        // SAFETY: the object is a camera; text and places outlive the calls.
        unsafe {
            let is_float = checked(library, |error| {
                (library.arv_camera_get_float_bounds)(
                    object,
                    name.as_ptr(),
                    &mut low,
                    &mut high,
                    error,
                )
            });
            let value = checked(library, |error| {
                (library.arv_camera_get_float)(object, name.as_ptr(), error)
            });
            if let (Ok(()), Ok(value)) = (is_float, value) {
                return Some([low, high, value]);
            }
            checked(library, |error| {
                (library.arv_camera_get_integer_bounds)(
                    object,
                    name.as_ptr(),
                    &mut lowest,
                    &mut highest,
                    error,
                )
            })
            .ok()?;
            let value = checked(library, |error| {
                (library.arv_camera_get_integer)(object, name.as_ptr(), error)
            });
            Some([lowest as f64, highest as f64, value.ok()? as f64])
        }
    }

    /// Sets a feature to a value written as text.
    pub fn set_feature(&self, feature: &str, value: &str) -> Outcome<()> {
        let (library, object, text) =
            (self.library, self.object, c_text(&format!("{feature}={value}")));
        // SAFETY: the object is a camera, and its device lives as long as it; the text outlives the
        // call.
        checked(library, |error| unsafe {
            let device = (library.arv_camera_get_device)(object);
            (library.arv_device_set_features_from_string)(device, text.as_ptr(), error)
        })?;
        Ok(())
    }

    /// Bytes of a picture with all that the camera sends along.
    pub fn payload(&self) -> Outcome<usize> {
        let (library, object) = (self.library, self.object);
        // SAFETY: the object is a camera.
        checked(library, |error| unsafe { (library.arv_camera_get_payload)(object, error) })
            .map(|bytes| bytes as usize)
    }

    /// Creates the stream that receives pictures.
    pub fn create_stream(&self) -> Outcome<Stream> {
        let (library, object) = (self.library, self.object);
        // SAFETY: the object is a camera; without a callback nothing of ours is called.
        let stream = checked(library, |error| unsafe {
            (library.arv_camera_create_stream)(object, null_mut(), null_mut(), error)
        })?;
        if stream.is_null() {
            return Err(AravisError { code: -1, text: "no stream".into() });
        }
        // SAFETY: the object is a stream, and the only reference to it is ours to give away.
        Ok(unsafe { Stream::new(library, stream) })
    }

    /// Starts continuous acquisition.
    pub fn start(&self) -> Outcome<()> {
        let (library, object) = (self.library, self.object);
        /// Until it is stopped.
        const CONTINUOUS: c_int = 0;
        // SAFETY: the object is a camera; the mode is the library's own number.
        unsafe {
            // A camera without modes has only this one.
            let _ = checked(library, |error| {
                (library.arv_camera_set_acquisition_mode)(object, CONTINUOUS, error)
            });
            checked(library, |error| (library.arv_camera_start_acquisition)(object, error))
        }
    }

    /// Stops acquisition. Takes seconds if the camera is gone.
    pub fn stop(&self) {
        let (library, object) = (self.library, self.object);
        // SAFETY: the object is a camera. One that cannot be stopped stops by itself when it
        // is no longer controlled.
        let _ = checked(library, |error| unsafe {
            (library.arv_camera_stop_acquisition)(object, error)
        });
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        // SAFETY: the only reference of ours.
        unsafe { (self.library.g_object_unref)(self.object) };
    }
}
