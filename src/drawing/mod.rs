//! Drawing on pictures.

pub mod calibration;
pub mod canvas;
pub mod detections;
mod font;
