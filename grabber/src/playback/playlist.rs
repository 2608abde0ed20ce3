//! Selection of a recording, and how to play it.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

/// Pacing of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Pace {
    /// The recorded distances in time.
    #[default]
    Recorded,
    /// By the group: a frame is shown when the `world` of the previous one has arrived, within limits.
    Group,
    /// By a person, with `touchline step`.
    Steps,
}

impl Pace {
    /// Names on the command line; the default has none.
    const NAMES: [(Self, &str); 2] = [(Self::Group, "fast"), (Self::Steps, "step")];

    fn name(self) -> Option<&'static str> {
        Self::NAMES.iter().find(|(pace, _)| *pace == self).map(|(_, name)| *name)
    }

    fn from_name(name: &str) -> Option<Self> {
        Self::NAMES.iter().find(|(_, known)| *known == name).map(|(pace, _)| *pace)
    }
}

/// A recording, and how to play it: `FILE[,fast|,step][,loop][,from=SECONDS]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Playlist {
    /// The recording.
    pub path: PathBuf,
    /// Pacing.
    pub pace: Pace,
    /// Whether to repeat it endlessly.
    pub is_loop: bool,
    /// Seconds to skip at the beginning.
    pub from_s: f64,
}

impl Eq for Playlist {}

impl FromStr for Playlist {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut playlist =
            Self { path: PathBuf::new(), pace: Pace::Recorded, is_loop: false, from_s: 0.0 };
        let mut rest = text;
        // From the end, since file names may contain commas.
        while let Some((before, option)) = rest.rsplit_once(',') {
            match option.split_once('=') {
                None if option == "loop" => playlist.is_loop = true,
                None if let Some(pace) = Pace::from_name(option) => playlist.pace = pace,
                Some(("from", seconds)) => match seconds.parse() {
                    Ok(seconds) if (0.0..1e9).contains(&seconds) => playlist.from_s = seconds,
                    _ => return Err(format!("from={seconds}: use a number of seconds")),
                },
                _ => break,
            }
            rest = before;
        }
        if rest.is_empty() {
            return Err("name the recording: recording:FILE.mcap".into());
        }
        playlist.path = rest.into();
        Ok(playlist)
    }
}

impl fmt::Display for Playlist {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.path.display())?;
        if let Some(name) = self.pace.name() {
            write!(f, ",{name}")?;
        }
        if self.from_s > 0.0 {
            write!(f, ",from={}", self.from_s)?;
        }
        if self.is_loop {
            write!(f, ",loop")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn options_follow_the_name() {
        let playlist: Playlist = "a,b.mcap,loop,from=2.5".parse().unwrap();
        assert_eq!(playlist.path, Path::new("a,b.mcap"));
        assert!(playlist.is_loop && playlist.from_s == 2.5 && playlist.pace == Pace::Recorded);
        assert_eq!(playlist.to_string().parse(), Ok(playlist));
        for (text, pace) in [("a.mcap,fast", Pace::Group), ("a.mcap,loop,step", Pace::Steps)] {
            let playlist: Playlist = text.parse().unwrap();
            assert_eq!((playlist.pace, playlist.path.as_path()), (pace, Path::new("a.mcap")));
            assert_eq!(playlist.to_string().parse(), Ok(playlist));
        }
        assert!("a.mcap,from=x".parse::<Playlist>().is_err());
        assert!(",loop".parse::<Playlist>().is_err());
    }
}
