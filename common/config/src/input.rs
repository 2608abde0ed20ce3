//! Opening and reading files from outside, with limits. This is the only way in which the program reads
//! configurations, points, labels, pictures and recordings.
//!
//! Only regular files are read: a named pipe or a device could block, or never end. A file larger than
//! its kind can be is refused before it is read. `docs/limits.md` lists the limits.

use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

/// Size limit of a kind of file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limit {
    /// Name of the kind, in the plural.
    pub what: &'static str,
    /// Largest size in bytes.
    pub most_bytes: u64,
}

/// Configurations (TOML). The parser takes about 130 times their size.
pub const CONFIG: Limit = Limit { what: "configurations", most_bytes: 256 << 10 };
/// Marked points for `calibrate` (TOML).
pub const POINTS: Limit = Limit { what: "files of points", most_bytes: 256 << 10 };
/// Labels of pictures (JSON).
pub const LABELS: Limit = Limit { what: "files of labels", most_bytes: 16 << 20 };
/// Pictures (PNG, JPEG).
pub const PICTURE: Limit = Limit { what: "pictures", most_bytes: 128 << 20 };

/// Opens a file for reading. Refuses anything but a regular file, without blocking.
pub fn open(path: &Path) -> io::Result<File> {
    open_flagged(path, OpenOptions::new().read(true), 0)
}

/// Opens a file for modification in place. Refuses symbolic links, which another user may have put
/// there.
pub fn open_to_change(path: &Path) -> io::Result<File> {
    if std::fs::symlink_metadata(path).is_ok_and(|data| data.is_symlink()) {
        let problem = "it is a symbolic link; name the file itself";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, problem));
    }
    open_flagged(path, OpenOptions::new().read(true).write(true), libc::O_NOFOLLOW)
}

fn open_flagged(path: &Path, options: &mut OpenOptions, flags: i32) -> io::Result<File> {
    // Opening a pipe without a writer would block; for a regular file the flag has no effect.
    let file = options.custom_flags(libc::O_NONBLOCK | flags).open(path)?;
    let kind = file.metadata()?.file_type();
    if kind.is_file() {
        return Ok(file);
    }
    let what = match () {
        () if kind.is_dir() => "a folder",
        () if kind.is_fifo() => "a named pipe",
        () if kind.is_socket() => "a socket",
        () => "a device",
    };
    Err(io::Error::new(io::ErrorKind::InvalidInput, format!("it is {what}, not a file")))
}

/// Reads a whole file of a kind.
pub fn read(path: &Path, limit: Limit) -> io::Result<Vec<u8>> {
    let file = open(path)?;
    let size = file.metadata()?.len();
    check(size, limit)?;
    let mut bytes = Vec::with_capacity(size as usize);
    // The file may grow while it is read, or report no size at all, as in `/proc`.
    file.take(limit.most_bytes + 1).read_to_end(&mut bytes)?;
    check(bytes.len() as u64, limit)?;
    Ok(bytes)
}

/// Like [`read`], for text.
pub fn read_text(path: &Path, limit: Limit) -> io::Result<String> {
    String::from_utf8(read(path, limit)?).map_err(|error| {
        let place = error.utf8_error().valid_up_to();
        let problem = format!("it is not UTF-8 text: byte {place} is invalid");
        io::Error::new(io::ErrorKind::InvalidData, problem)
    })
}

/// Checks a size against the limit of its kind.
pub fn check(bytes: u64, limit: Limit) -> io::Result<()> {
    if bytes <= limit.most_bytes {
        return Ok(());
    }
    let problem = format!(
        "it has {} kB; {} have at most {} kB",
        bytes.div_ceil(1 << 10),
        limit.what,
        limit.most_bytes >> 10
    );
    Err(io::Error::new(io::ErrorKind::InvalidData, problem))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;

    const SMALL: Limit = Limit { what: "small files", most_bytes: 2048 };

    fn folder(name: &str) -> PathBuf {
        let folder =
            std::env::temp_dir().join(format!("touchline-input-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn files_are_read_up_to_their_limit() {
        let folder = folder("size");
        let path = folder.join("file");
        std::fs::write(&path, [b'a'; 2048]).unwrap();
        assert_eq!(read(&path, SMALL).unwrap().len(), 2048);
        assert_eq!(read_text(&path, SMALL).unwrap().len(), 2048);
        std::fs::write(&path, [b'a'; 2049]).unwrap();
        let error = read(&path, SMALL).unwrap_err().to_string();
        assert_eq!(error, "it has 3 kB; small files have at most 2 kB");
        std::fs::write(&path, b"ab\xff").unwrap();
        assert!(read_text(&path, SMALL).unwrap_err().to_string().contains("byte 2"));
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_file_is_not_changed_through_a_link() {
        let folder = folder("link");
        let (file, link) = (folder.join("file"), folder.join("link"));
        std::fs::write(&file, "").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        open_to_change(&file).unwrap();
        let error = open_to_change(&link).unwrap_err().to_string();
        assert!(error.contains("symbolic link"), "{error}");
        assert!(open(&link).is_ok(), "reading is another matter");
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn non_files_are_refused_without_waiting() {
        let folder = folder("kind");
        let pipe = folder.join("pipe");
        rustix::fs::mknodat(
            rustix::fs::CWD,
            &pipe,
            rustix::fs::FileType::Fifo,
            rustix::fs::Mode::RWXU,
            0,
        )
        .unwrap();
        for (path, what) in [
            (pipe.as_path(), "a named pipe"),
            (&folder, "a folder"),
            ("/dev/zero".as_ref(), "a device"),
        ] {
            let error = read(path, SMALL).unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        }
        std::fs::remove_dir_all(folder).unwrap();
    }
}
