//! Random access to the bytes of a file through a window. The length is that at opening time.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;

/// Smallest read.
const WINDOW_BYTES: usize = 64 << 10;

/// The bytes of a file.
pub(crate) struct Bytes {
    file: File,
    length: u64,
    window: Vec<u8>,
    /// File offset of the window.
    from: u64,
}

impl Bytes {
    pub fn new(file: File) -> io::Result<Self> {
        let length = file.metadata()?.len();
        Ok(Self { file, length, window: Vec::new(), from: 0 })
    }

    pub fn length(&self) -> u64 {
        self.length
    }

    /// Up to `most` bytes at an offset; fewer only at the end of the file.
    pub fn at(&mut self, place: u64, most: usize) -> io::Result<&[u8]> {
        let there = self.length.saturating_sub(place);
        let count = most.min(usize::try_from(there).unwrap_or(usize::MAX));
        let is_held =
            place >= self.from && place + count as u64 <= self.from + self.window.len() as u64;
        if !is_held {
            let read = count.max(WINDOW_BYTES.min(usize::try_from(there).unwrap_or(usize::MAX)));
            self.window.clear();
            self.window.reserve_exact(read);
            self.window.resize(read, 0);
            self.from = place;
            if let Err(error) = self.file.read_exact_at(&mut self.window, place) {
                self.window.clear();
                return Err(error);
            }
        }
        let start = (place - self.from) as usize;
        Ok(&self.window[start..start + count])
    }
}
