//! Geometry between picture and field: camera model, lens, rolling shutter, and the shapes of robots.
//!
//! # Coordinate frames
//!
//! * **image**: pixels; the centre of the top-left pixel is (0, 0), x to the right, y down.
//! * **field**: millimetres on the floor; origin at the centre of the pitch, x along its length
//!   towards the goal on the right of an upright picture, y to the left of x, z up. Angles are in
//!   radians, counter-clockwise from x.
//! * **robot**: millimetres; origin at the centre of the robot's top, x forward, y to the left.

pub mod body;
mod camera_model;
pub mod layout;
pub mod lens;
mod points;
pub mod rolling_shutter;
pub mod settings;

pub use camera_model::{CameraModel, GeometryError, homography};
pub use points::{FieldPoint, ImagePoint, Pose, wrap_angle};
