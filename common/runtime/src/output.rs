//! Output of commands: to the standard output and into files.
//!
//! One rule for all files: an existing file is overwritten only with `--force`, and an input of the
//! command never. A file appears only when it is complete: a replacement is written beside the existing
//! file first, and an incomplete file is removed. Pipes and devices are written to directly. The reports
//! of `run` and `chaos` replace an earlier report without `--force`, and never anything else.

use std::fmt::Arguments;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Reason why a file is not written.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The file exists.
    #[error("{} exists; --force overwrites it", .0.display())]
    Exists(PathBuf),
    /// The file is an input of the command.
    #[error("{} is read by this command, and not written over; name another file", .0.display())]
    Input(PathBuf),
    /// The file exists and is not a report.
    #[error("{} exists and is no report, and so is not written over; name another file", .0.display())]
    NoReport(PathBuf),
    /// The file cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

/// As `print!`, with an [`io::Result`](std::io::Result) instead of a panic. See [`output::say`](crate::output::say).
#[macro_export]
macro_rules! say {
    ($($text:tt)*) => { $crate::output::say(format_args!($($text)*)) };
}

/// As `println!`, with an [`io::Result`](std::io::Result) instead of a panic. See [`output::say`](crate::output::say).
#[macro_export]
macro_rules! say_line {
    ($($text:tt)*) => { $crate::say!("{}\n", format_args!($($text)*)) };
}

/// Whether the standard output still has a reader.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reader {
    /// It has a reader as far as is known.
    There,
    /// The reader has ended (`touchline bench | head`): a long command that only prints can end.
    Gone,
}

/// Writes to the standard output. A reader that is gone is no error; a full disk is one.
pub fn say(text: Arguments) -> io::Result<Reader> {
    let mut out = io::stdout().lock();
    match out.write_fmt(text).and_then(|()| out.flush()) {
        Ok(()) => Ok(Reader::There),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(Reader::Gone),
        Err(error) => Err(error),
    }
}

/// Rule for the files that a command may overwrite.
#[derive(Debug, Clone, Copy)]
pub struct Rule<'a> {
    /// Files that the command reads.
    pub inputs: &'a [&'a Path],
    /// Whether `--force` was given.
    pub force: bool,
}

impl Rule<'_> {
    /// Checks before long work whether a file may be written.
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

    /// Starts a file.
    pub fn create(&self, path: &Path) -> Result<Output, OutputError> {
        self.check(path)?;
        let problem = |source: io::Error| match source.kind() {
            io::ErrorKind::AlreadyExists => OutputError::Exists(path.into()),
            _ => OutputError::Write { path: path.into(), source },
        };
        let (place, file) = match fs::metadata(path) {
            Ok(there) if there.is_file() => {
                // The existing file stays until its replacement is complete.
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

    /// Starts a report, which may replace an earlier report.
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

/// Path of the temporary file that will replace a file.
fn beside(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".writing-{}", std::process::id()));
    path.with_file_name(name)
}

/// A file being written. It is removed unless it is finished.
#[derive(Debug)]
pub struct Output {
    path: PathBuf,
    /// Path to remove if the file is not finished.
    unfinished: Option<PathBuf>,
    file: File,
}

impl Output {
    /// The underlying file.
    pub fn file(&self) -> &File {
        &self.file
    }

    /// Moves the file to its final place.
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
