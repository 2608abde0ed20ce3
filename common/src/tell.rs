//! Saying something to whoever looks after a process, on the standard error output.
//!
//! `eprintln!` panics where that output cannot be written: the terminal is gone, the reader of a pipe has
//! ended, a log has filled its disk. None of that is a reason to end a match.

use std::fmt::Arguments;
use std::io::{self, Write};

/// As `eprintln!`, except that nothing happens if it cannot be written.
#[macro_export]
macro_rules! tell {
    ($($text:tt)*) => { $crate::tell_part!("{}\n", format_args!($($text)*)) };
}

/// As `eprint!`, except that nothing happens if it cannot be written.
#[macro_export]
macro_rules! tell_part {
    ($($text:tt)*) => { $crate::tell::tell(format_args!($($text)*)) };
}

/// See [`tell!`](crate::tell!).
pub fn tell(text: Arguments) {
    let _ = io::stderr().lock().write_fmt(text);
}
