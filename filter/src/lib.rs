pub mod ball;
pub mod blend;
pub mod commands;
pub mod gaussian;
mod message;
pub mod process;
pub mod robot;
pub mod stage;
pub mod track;

pub use stage::{Filter, FilterError};
