//! A configuration that a program asks the supervisor to go over to.

use client::instance::Instance;
use client::private;
use config::{Config, commented_toml};
use std::io::{self, Write};
use std::path::PathBuf;

/// A file for the supervisor, removed when it has been read.
pub struct Candidate {
    /// Where it is.
    pub path: PathBuf,
}

impl Candidate {
    /// Writes it into the runtime directory.
    pub fn write(instance: &Instance, config: &Config) -> io::Result<Self> {
        let path = instance.candidate_path(std::process::id());
        let candidate = Self { path };
        private::create_file(&candidate.path)?.write_all(commented_toml(config).as_bytes())?;
        Ok(candidate)
    }
}

impl Drop for Candidate {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}
