//! A recording as a source of frames, with its original timing.
//!
//! Frames keep their distances in time and their gaps in number; the first one is shown at once and
//! called 0. With them come the commands and, of a synthetic match, the truth that were recorded, moved
//! in time as the frames are. Reading and decompressing happen on a thread of their own, ahead of time.

use crate::camera::{Camera, CameraError, Captured, Exposure, FramePool, LastFrame, Picture};
use crate::source::Source;
use common::clock::{monotonic_ns, wall_ns};
use common::config::Config;
use common::messages::{BayerOrder, Commands, FrameHeader, PixelFormat, TruthFrame};
use common::process::LOOK_AROUND;
use recording::{Channel, Entry, Reader, Setup, decode_frame, decode_message};
use std::collections::VecDeque;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

/// Messages read ahead: some tenths of a second.
const AHEAD: usize = 128;
/// A delay of more than this is not made up for: the rest is shown that much later.
const MAX_LAG_NS: u64 = 250_000_000;
/// Truth that is kept until its frame comes.
const KEPT_TRUTH: usize = 16;

/// Which recording, and how to play it: `FILE[,loop][,from=SECONDS]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Playlist {
    /// The recording.
    pub path: PathBuf,
    /// Begin anew at the end.
    pub is_loop: bool,
    /// Leave out so many seconds at the beginning.
    pub from_s: f64,
}

impl Eq for Playlist {}

impl FromStr for Playlist {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut playlist = Self { path: PathBuf::new(), is_loop: false, from_s: 0.0 };
        let mut rest = text;
        // From the end, so that file names may have commas.
        while let Some((before, option)) = rest.rsplit_once(',') {
            match option.split_once('=') {
                None if option == "loop" => playlist.is_loop = true,
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
        if self.from_s > 0.0 {
            write!(f, ",from={}", self.from_s)?;
        }
        if self.is_loop {
            write!(f, ",loop")?;
        }
        Ok(())
    }
}

/// The configuration with which a recording was made.
pub fn recorded_config(path: &Path) -> Result<Config, CameraError> {
    let problem = |problem| CameraError::Picture { path: path.display().to_string(), problem };
    let mut reader =
        Reader::open(path).map_err(|error| CameraError::Recording(error.to_string()))?;
    let setup = reader.by_ref().flatten().take(1000).find(|e| e.channel == Channel::Setup);
    let setup = setup.and_then(|entry| Setup::decode(&entry.data));
    let setup = setup.ok_or_else(|| problem("there is no configuration in it".into()))?;
    let origin = format!("the configuration recorded in {}", path.display());
    Config::parse(&setup.config_toml, &origin).map_err(|error| problem(error.to_string()))
}

/// Plays a recording.
pub struct Playback {
    playlist: Playlist,
    /// Larger frames than the group has memory for are rubbish.
    most_bytes: usize,
    entries: Receiver<Entry>,
    /// The next frame, read and waiting to be shown.
    next: Option<Entry>,
    times: Times,
    truths: VecDeque<TruthFrame>,
    /// Commands since the last frame.
    heard: Vec<Commands>,
    /// Of the frame shown last.
    truth: Option<TruthFrame>,
    commands: Vec<Commands>,
    is_over: bool,
}

/// From the times and numbers of the recording to those of now.
#[derive(Debug)]
struct Times {
    /// The first frame of this round: number and capture time, as recorded.
    first: Option<(u64, u64)>,
    /// What that frame is called now, and when it is shown.
    base_seq: u64,
    base_ns: Option<u64>,
    /// The last frame shown: number and time, now.
    last: Option<(u64, u64)>,
    period_ns: u64,
    /// Numbers up to here were shown by a predecessor.
    resume_after: Option<u64>,
}

impl Times {
    fn new(fps: f64, last: Option<LastFrame>) -> Self {
        Self {
            first: None,
            base_seq: 0,
            base_ns: None,
            last: None,
            period_ns: (1e9 / fps) as u64,
            resume_after: last.map(|last| last.seq),
        }
    }

    /// Number and time at which a frame is to be shown; `None` if it was shown by a predecessor, or
    /// cannot be told from one shown already.
    fn due(&mut self, header: &FrameHeader, now_ns: u64) -> Option<(u64, u64)> {
        let (first_seq, first_ns) = *self.first.get_or_insert((header.seq, header.t_capture_ns));
        let seq = self.base_seq + header.seq.checked_sub(first_seq)?;
        if self.last.is_some_and(|(last, _)| seq <= last) || self.resume_after >= Some(seq) {
            return None;
        }
        let offset_ns = header.t_capture_ns.checked_sub(first_ns)?;
        let base_ns = self.base_ns.get_or_insert(now_ns.saturating_sub(offset_ns));
        if now_ns > *base_ns + offset_ns + MAX_LAG_NS {
            *base_ns = now_ns - offset_ns;
        }
        Some((seq, *base_ns + offset_ns))
    }

    /// The next frame is the first one again.
    fn begin_anew(&mut self) {
        let last = self.last.map(|(seq, t_ns)| (seq + 1, t_ns + self.period_ns));
        self.first = None;
        self.base_seq = last.map_or(0, |(seq, _)| seq);
        self.base_ns = last.map(|(_, t_ns)| t_ns);
    }

    /// A stamp of the recording, now.
    fn moved(&self, t_ns: u64) -> u64 {
        match (self.first, self.base_ns) {
            (Some((_, first_ns)), Some(base_ns)) => (t_ns + base_ns).saturating_sub(first_ns),
            _ => t_ns,
        }
    }
}

impl Playback {
    /// Opens a recording and begins to read.
    pub fn open(
        playlist: &Playlist,
        config: &Config,
        last: Option<LastFrame>,
    ) -> Result<Self, CameraError> {
        let reader = Reader::open(&playlist.path)
            .map_err(|error| CameraError::Recording(error.to_string()))?;
        Ok(Self {
            entries: read_ahead(reader, playlist.from_s),
            playlist: playlist.clone(),
            most_bytes: Source::Recording(playlist.clone()).frame_capacity(&config.camera),
            next: None,
            times: Times::new(config.camera.fps, last),
            truths: VecDeque::with_capacity(KEPT_TRUTH),
            heard: Vec::new(),
            truth: None,
            commands: Vec::new(),
            is_over: false,
        })
    }

    /// Takes in what is there, up to the next frame.
    fn read(&mut self) -> Result<(), CameraError> {
        while self.next.is_none() && !self.is_over {
            match self.entries.recv_timeout(LOOK_AROUND) {
                Ok(entry) => self.note(entry),
                Err(RecvTimeoutError::Timeout) => return Ok(()),
                Err(RecvTimeoutError::Disconnected) => self.at_end()?,
            }
        }
        Ok(())
    }

    fn note(&mut self, entry: Entry) {
        match entry.channel {
            Channel::Frames => self.next = Some(entry),
            Channel::Truth => {
                if let Some(truth) = decode_message::<TruthFrame>(&entry.data) {
                    if self.truths.len() == KEPT_TRUTH {
                        self.truths.pop_front();
                    }
                    self.truths.push_back(*truth);
                }
            }
            Channel::Commands => {
                if let Some(commands) = decode_message::<Commands>(&entry.data) {
                    self.heard.push(*commands);
                }
            }
            _ => {}
        }
    }

    fn at_end(&mut self) -> Result<(), CameraError> {
        // One without a single frame is not played round and round.
        if !self.playlist.is_loop || self.times.first.is_none() {
            self.is_over = true;
            return Ok(());
        }
        let reader = Reader::open(&self.playlist.path)
            .map_err(|error| CameraError::Recording(error.to_string()))?;
        self.entries = read_ahead(reader, self.playlist.from_s);
        self.times.begin_anew();
        Ok(())
    }
}

impl Camera for Playback {
    fn capture(&mut self, pool: &mut FramePool) -> Result<Option<Captured>, CameraError> {
        self.read()?;
        let Some(entry) = &self.next else { return Ok(None) };
        let frame = decode_frame(&entry.data).filter(|frame| frame.pixels.len() <= self.most_bytes);
        let due = frame.and_then(|frame| self.times.due(&frame.header, monotonic_ns()));
        let (Some(frame), Some((seq, due_ns))) = (frame, due) else {
            self.next = None;
            self.heard.clear();
            return Ok(None);
        };
        let left = Duration::from_nanos(due_ns.saturating_sub(monotonic_ns()));
        if left > LOOK_AROUND {
            std::thread::sleep(LOOK_AROUND);
            return Ok(None);
        }
        let mut loan = pool.loan(frame.pixels.len())?;
        loan.elements().copy_from_slice(frame.pixels);
        std::thread::sleep(Duration::from_nanos(due_ns.saturating_sub(monotonic_ns())));

        let header = frame.header;
        self.times.last = Some((seq, due_ns));
        self.truth = self
            .truths
            .iter()
            .find(|truth| truth.seq == header.seq)
            .map(|truth| TruthFrame { seq, t_capture_ns: due_ns, ..*truth });
        self.commands.clear();
        let times = &self.times;
        self.commands.extend(
            self.heard.drain(..).map(|commands| Commands {
                t_sent_ns: times.moved(commands.t_sent_ns),
                ..commands
            }),
        );
        self.next = None;
        let exposure = Exposure {
            seq,
            t_capture_ns: due_ns,
            t_capture_wall_ns: wall_ns().saturating_sub(monotonic_ns().saturating_sub(due_ns)),
            skipped: 0,
        };
        Ok(Some(Captured { frame: loan, exposure, picture: picture(&header) }))
    }

    fn truth(&self) -> Option<&TruthFrame> {
        self.truth.as_ref()
    }

    fn commands(&self) -> &[Commands] {
        &self.commands
    }

    fn is_over(&self) -> bool {
        self.is_over
    }
}

/// Numbers that mean nothing were recorded as they were, and the classifier refuses them; here they
/// only need to be something.
fn picture(header: &FrameHeader) -> Picture {
    Picture {
        width: header.width,
        height: header.height,
        stride: header.stride,
        pixel_format: PixelFormat::from_number(header.pixel_format).unwrap_or(PixelFormat::Bayer8),
        bayer_order: BayerOrder::from_number(header.bayer_order).unwrap_or(BayerOrder::Rggb),
        exposure_us: header.exposure_us,
    }
}

/// Reads on a thread of its own, which ends with the recording or with its receiver.
fn read_ahead(reader: Reader, from_s: f64) -> Receiver<Entry> {
    let (sender, receiver): (SyncSender<Entry>, _) = sync_channel(AHEAD);
    std::thread::spawn(move || {
        let from_ns = (from_s * 1e9) as u64;
        let mut first_ns = None;
        // What cannot be read any more is the end.
        for entry in reader.map_while(Result::ok) {
            let first_ns = *first_ns.get_or_insert(entry.t_sent_ns);
            let is_wanted =
                matches!(entry.channel, Channel::Frames | Channel::Truth | Channel::Commands);
            if is_wanted
                && entry.t_sent_ns.saturating_sub(first_ns) >= from_ns
                && sender.send(entry).is_err()
            {
                return;
            }
        }
    });
    receiver
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn frame(seq: u64, t_ms: u64) -> FrameHeader {
        FrameHeader { seq, t_capture_ns: t_ms * MS, ..Default::default() }
    }

    #[test]
    fn options_follow_the_name() {
        let playlist: Playlist = "a,b.mcap,loop,from=2.5".parse().unwrap();
        assert_eq!(playlist.path, Path::new("a,b.mcap"));
        assert!(playlist.is_loop && playlist.from_s == 2.5);
        assert_eq!(playlist.to_string().parse(), Ok(playlist));
        assert!("a.mcap,from=x".parse::<Playlist>().is_err());
        assert!(",loop".parse::<Playlist>().is_err());
    }

    #[test]
    fn distances_and_gaps_are_kept() {
        let mut times = Times::new(100.0, None);
        let mut show = |seq, t_ms, now_ms: u64| {
            let due = times.due(&frame(seq, t_ms), now_ms * MS)?;
            times.last = Some(due);
            Some((due.0, due.1 / MS))
        };
        assert_eq!(show(70, 5000, 900), Some((0, 900)));
        assert_eq!(show(71, 5010, 901), Some((1, 910)));
        assert_eq!(show(71, 5010, 902), None, "a repetition");
        assert_eq!(show(75, 5050, 960), Some((5, 950)), "a little late is made up for");
        assert_eq!(show(76, 5060, 2000), Some((6, 2000)), "long stops are not");
        assert_eq!(show(77, 5070, 2001), Some((7, 2010)));
        assert_eq!(times.moved(5080 * MS), 2020 * MS);
        times.begin_anew();
        assert_eq!(times.due(&frame(70, 5000), 2011 * MS), Some((8, 2020 * MS)));
    }

    #[test]
    fn a_successor_goes_on_behind_its_predecessor() {
        let mut times = Times::new(100.0, Some(LastFrame { seq: 1, t_capture_ns: 0 }));
        assert_eq!(times.due(&frame(70, 5000), 900 * MS), None);
        assert_eq!(times.due(&frame(71, 5010), 900 * MS), None);
        assert_eq!(times.due(&frame(72, 5020), 900 * MS), Some((2, 900 * MS)));
    }
}
