//! Drawing on pictures.

pub mod canvas;
mod font;
