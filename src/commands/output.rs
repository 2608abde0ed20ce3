//! What commands write: to the standard output, and into files.
//!
//! One rule for all files. One that is there is written over only with `--force`, and one that the command
//! reads never. A file is there when it is complete: what replaces another one is written beside it first,
//! and what cannot be completed is removed. Pipes and devices are written to as they are. The reports of
//! `run` and `chaos` take the place of an earlier report without being asked, of anything else never.

use image::{ImageFormat, RgbImage};
use std::fmt::Arguments;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Cursor, Read, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Why a file is not written.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// A file is in the way.
    #[error("{} exists; --force overwrites it", .0.display())]
    Exists(PathBuf),
    /// A file is in the way that the command reads.
    #[error("{} is read by this command, and not written over; name another file", .0.display())]
    Input(PathBuf),
    /// A file is in the place of a report that is none.
    #[error("{} exists and is no report, and so is not written over; name another file", .0.display())]
    NoReport(PathBuf),
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

/// What a command may write over.
#[derive(Debug, Clone, Copy)]
pub struct Rule<'a> {
    /// Files that the command reads.
    pub inputs: &'a [&'a Path],
    /// Whether the user has said `--force`.
    pub force: bool,
}

impl Rule<'_> {
    /// Says before long work whether a file may be written.
    pub fn check(&self, path: &Path) -> Result<(), OutputError> {
        let Ok(there) = fs::metadata(path) else { return Ok(()) };
        self.check_inputs(path, &there)?;
        if there.is_file() && !self.force {
            return Err(OutputError::Exists(path.into()));
        }
        Ok(())
    }

    fn check_inputs(&self, path: &Path, there: &fs::Metadata) -> Result<(), OutputError> {
        let is_it = |input: &&Path| {
            fs::metadata(input)
                .is_ok_and(|input| (input.dev(), input.ino()) == (there.dev(), there.ino()))
        };
        match self.inputs.iter().any(is_it) {
            true => Err(OutputError::Input(path.into())),
            false => Ok(()),
        }
    }

    /// Begins a file.
    pub fn create(&self, path: &Path) -> Result<Output, OutputError> {
        self.check(path)?;
        let problem = |source: io::Error| match source.kind() {
            io::ErrorKind::AlreadyExists => OutputError::Exists(path.into()),
            _ => OutputError::Write { path: path.into(), source },
        };
        let (place, file) = match fs::metadata(path) {
            Ok(there) if there.is_file() => {
                // It keeps what it has until there is something in its place.
                let place = beside(path);
                (Some(place.clone()), create_new(&place))
            }
            Ok(_) => (None, OpenOptions::new().write(true).open(path)),
            Err(_) => (Some(path.into()), create_new(path)),
        };
        let file = file.map_err(problem)?;
        Ok(Output { path: path.into(), unfinished: place, file })
    }

    /// Writes a file.
    pub fn write(&self, path: &Path, bytes: &[u8]) -> Result<(), OutputError> {
        let mut output = self.create(path)?;
        let written = output.write_all(bytes);
        written.map_err(|source| OutputError::Write { path: path.into(), source })?;
        output.finish()
    }

    /// Writes a picture, as a PNG if its name does not say something else.
    pub fn write_picture(&self, path: &Path, picture: &RgbImage) -> Result<(), OutputError> {
        let format = ImageFormat::from_path(path).unwrap_or(ImageFormat::Png);
        let mut bytes = Vec::new();
        picture.write_to(&mut Cursor::new(&mut bytes), format).map_err(|error| {
            OutputError::Write { path: path.into(), source: io::Error::other(error) }
        })?;
        self.write(path, &bytes)
    }

    /// Begins a report. It takes the place of an earlier one.
    pub fn create_report(&self, path: &Path) -> Result<File, OutputError> {
        if let Ok(there) = fs::metadata(path) {
            self.check_inputs(path, &there)?;
            // Every report is one JSON object.
            let mut first = [b'{'];
            let read = there.is_file().then(|| File::open(path)?.read(&mut first));
            if read.is_some_and(|read| read.is_err()) || first != [b'{'] {
                return Err(OutputError::NoReport(path.into()));
            }
        }
        File::create(path).map_err(|source| OutputError::Write { path: path.into(), source })
    }
}

fn create_new(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).write(true).create_new(true).open(path)
}

/// Where something is written that is to take the place of a file.
fn beside(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".writing-{}", std::process::id()));
    path.with_file_name(name)
}

/// A file that is being written. Unless it is finished, nothing is left of it.
#[derive(Debug)]
pub struct Output {
    path: PathBuf,
    /// What is to be removed if it is not finished.
    unfinished: Option<PathBuf>,
    file: File,
}

impl Output {
    /// The file itself.
    pub fn file(&self) -> &File {
        &self.file
    }

    /// Puts the file in its place.
    pub fn finish(mut self) -> Result<(), OutputError> {
        let Some(place) = self.unfinished.take().filter(|place| *place != self.path) else {
            return Ok(());
        };
        fs::rename(&place, &self.path).map_err(|source| {
            self.unfinished = Some(place);
            OutputError::Write { path: self.path.clone(), source }
        })
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if let Some(place) = &self.unfinished {
            let _ = fs::remove_file(place);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn nothing_is_overwritten_unasked_and_no_input_ever() {
        let folder = std::env::temp_dir().join(format!("touchline-output-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let (input, output, link) = (folder.join("in"), folder.join("out"), folder.join("link"));
        fs::write(&input, "input").unwrap();
        std::os::unix::fs::symlink(&input, &link).unwrap();
        let inputs = [input.as_path()];
        let careful = Rule { inputs: &inputs, force: false };
        let forced = Rule { inputs: &inputs, force: true };

        careful.write(&output, b"first").unwrap();
        assert!(matches!(careful.write(&output, b"second"), Err(OutputError::Exists(_))));
        assert_eq!(fs::read(&output).unwrap(), b"first");
        let unfinished = forced.create(&output).unwrap();
        assert_eq!(names(&folder).len(), 4);
        drop(unfinished);
        assert_eq!(fs::read(&output).unwrap(), b"first");
        forced.write(&output, b"second").unwrap();
        assert_eq!(fs::read(&output).unwrap(), b"second");
        for rule in [careful, forced] {
            for path in [&input, &link] {
                assert!(matches!(rule.write(path, b"x"), Err(OutputError::Input(_))));
                assert!(matches!(rule.create_report(path), Err(OutputError::Input(_))));
            }
        }
        drop(careful.create(&folder.join("unfinished")).unwrap());
        careful.write(Path::new("/dev/null"), b"x").unwrap();
        assert_eq!(names(&folder), ["in", "link", "out"]);
        assert_eq!(fs::read(&input).unwrap(), b"input");

        assert!(matches!(careful.create_report(&output), Err(OutputError::NoReport(_))));
        fs::write(&output, "{\"a\": 1}").unwrap();
        careful.create_report(&output).unwrap();
        careful.create_report(&output).unwrap();
        fs::remove_dir_all(&folder).unwrap();
    }
}
