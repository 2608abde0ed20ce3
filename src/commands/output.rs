//! What commands write: to the standard output, and into files, never over one that is there, unless
//! asked to.

use std::fmt::Arguments;
use std::fs::OpenOptions;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Why a file is not written.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// A file is in the way.
    #[error("{} exists; --force overwrites it", .0.display())]
    Exists(PathBuf),
    /// It cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
}

/// As `print!`, with an [`io::Result`] instead of a panic. See [`say()`].
macro_rules! say {
    ($($text:tt)*) => { $crate::commands::output::say(format_args!($($text)*)) };
}

/// As `println!`, with an [`io::Result`] instead of a panic. See [`say()`].
macro_rules! say_line {
    ($($text:tt)*) => { say!("{}\n", format_args!($($text)*)) };
}

/// Whether anybody reads the standard output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reader {
    /// As far as is known.
    There,
    /// It has seen enough (`touchline bench | head`): what takes long and only speaks can end.
    Gone,
}

/// Writes to the standard output. That its reader is gone is no error; a full disk is one.
pub fn say(text: Arguments) -> io::Result<Reader> {
    let mut out = io::stdout().lock();
    match out.write_fmt(text).and_then(|()| out.flush()) {
        Ok(()) => Ok(Reader::There),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(Reader::Gone),
        Err(error) => Err(error),
    }
}

/// Says before long work whether [`write()`] will refuse because a file is in the way.
pub fn check_free(path: Option<&Path>, force: bool) -> Result<(), OutputError> {
    match path {
        Some(path) if path.exists() && !force => Err(OutputError::Exists(path.into())),
        _ => Ok(()),
    }
}

/// Writes a file; over one that exists only with `force`.
pub fn write(path: &Path, text: &str, force: bool) -> Result<(), OutputError> {
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(force).create_new(!force);
    let written = options.open(path).and_then(|mut file| file.write_all(text.as_bytes()));
    written.map_err(|source| match source.kind() {
        io::ErrorKind::AlreadyExists => OutputError::Exists(path.into()),
        _ => OutputError::Write { path: path.into(), source },
    })
}
