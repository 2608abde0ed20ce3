//! A recording as a source of frames.
//!
//! Frames keep their distances in time and their gaps in number; the first one becomes number 0. The recorded
//! commands and, for a synthetic match, the truth are replayed with them, shifted in time like the frames. A
//! thread of its own reads and decompresses ahead of time.

mod pacer;
mod playlist;
mod times;

pub use pacer::{Pacer, request_steps};
pub use playlist::{Pace, Playlist};

use crate::camera::{Camera, CameraError, Captured, Exposure, FramePool, LastFrame, Picture};
use crate::source::Source;
use client::clock::{monotonic_ns, wall_ns};
use config::Config;
use messages::{BayerOrder, Commands, FrameHeader, PixelFormat, TruthFrame};
use recording::{Channel, Entry, Reader, Setup, decode_frame, decode_message};
use runtime::process::MAX_WAIT;
use std::collections::VecDeque;
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;
use times::{ScheduledFrame, TimeMap};

/// Messages read ahead: some tenths of a second.
const AHEAD: usize = 128;
/// Truth messages kept until their frame comes.
const KEPT_TRUTH: usize = 16;
/// Time until the next frame above which the source reports a pause.
const PAUSE: Duration = Duration::from_millis(500);

/// The configuration with which a recording was made, at its beginning or some seconds later.
pub fn recorded_config(path: &Path, from_s: f64) -> Result<Config, CameraError> {
    let problem = |problem| CameraError::Picture { path: path.display().to_string(), problem };
    let reader = Reader::open(path).map_err(|error| CameraError::Recording(error.to_string()))?;
    let setup = setup_at(reader.flatten(), (from_s * 1e9) as u64);
    let setup = setup.ok_or_else(|| problem("there is no configuration in it".into()))?;
    let origin = format!("the configuration recorded in {}", path.display());
    Config::parse(&setup.config_toml, &origin).map_err(|error| problem(error.to_string()))
}

/// The newest configuration of the first `from_ns`; if there is none, because the file's beginning is damaged, the
/// first one.
fn setup_at(entries: impl Iterator<Item = Entry>, from_ns: u64) -> Option<Setup> {
    let (mut begin_ns, mut chosen) = (None, None::<Setup>);
    for entry in entries {
        let begin_ns = *begin_ns.get_or_insert(entry.t_sent_ns);
        let is_late = entry.t_sent_ns.saturating_sub(begin_ns) > from_ns;
        if is_late && chosen.is_some() {
            break;
        }
        if entry.channel == Channel::Setup
            && let Some(setup) = Setup::decode(&entry.data)
            // Groups whose stages were started by hand have revision 0 throughout: the last one counts.
            && chosen.as_ref().is_none_or(|chosen| setup.revision >= chosen.revision)
        {
            chosen = Some(setup);
        }
    }
    chosen
}

/// A recording being played.
pub struct Playback {
    playlist: Playlist,
    /// Largest frame that the group has memory for; larger ones are invalid.
    most_bytes: usize,
    entries: Receiver<Entry>,
    /// The next frame, read and waiting to be shown.
    next: Option<Entry>,
    times: TimeMap,
    truths: VecDeque<TruthFrame>,
    /// Commands since the last frame.
    new_commands: Vec<Commands>,
    /// Truth of the last frame shown.
    truth: Option<TruthFrame>,
    commands: Vec<Commands>,
    /// Whether a long pause precedes the next frame.
    is_pausing: bool,
    is_over: bool,
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
            entries: read_ahead(reader, playlist),
            playlist: playlist.clone(),
            most_bytes: Source::Recording(playlist.clone()).frame_capacity(&config.camera),
            next: None,
            times: TimeMap::new(playlist.pace, config.camera.fps, last),
            truths: VecDeque::with_capacity(KEPT_TRUTH),
            new_commands: Vec::new(),
            truth: None,
            commands: Vec::new(),
            is_pausing: false,
            is_over: false,
        })
    }

    /// Takes in messages up to the next frame.
    fn read(&mut self) -> Result<(), CameraError> {
        while self.next.is_none() && !self.is_over {
            match self.entries.recv_timeout(MAX_WAIT) {
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
                    self.new_commands.push(*commands);
                }
            }
            _ => {}
        }
    }

    fn at_end(&mut self) -> Result<(), CameraError> {
        // A recording without a single frame is not repeated.
        if !self.playlist.is_loop || !self.times.has_begun() {
            self.is_over = true;
            return Ok(());
        }
        let reader = Reader::open(&self.playlist.path)
            .map_err(|error| CameraError::Recording(error.to_string()))?;
        self.entries = read_ahead(reader, &self.playlist);
        self.times.restart();
        Ok(())
    }
}

impl Camera for Playback {
    fn capture(&mut self, pool: &mut FramePool) -> Result<Option<Captured>, CameraError> {
        self.read()?;
        let Some(entry) = &self.next else { return Ok(None) };
        let frame = decode_frame(&entry.data).filter(|frame| frame.pixels.len() <= self.most_bytes);
        let due = frame.and_then(|frame| self.times.due(&frame.header, monotonic_ns()));
        let (Some(frame), Some(due)) = (frame, due) else {
            self.next = None;
            self.new_commands.clear();
            return Ok(None);
        };
        let left = Duration::from_nanos(due.show_ns.saturating_sub(monotonic_ns()));
        self.is_pausing = left > PAUSE;
        if left > MAX_WAIT {
            std::thread::sleep(MAX_WAIT);
            return Ok(None);
        }
        let mut loan = pool.loan(frame.pixels.len())?;
        loan.elements().copy_from_slice(frame.pixels);
        std::thread::sleep(Duration::from_nanos(due.show_ns.saturating_sub(monotonic_ns())));

        let header = frame.header;
        let ScheduledFrame { seq, t_capture_ns, .. } = due;
        self.times.shown(due, monotonic_ns());
        self.truth = self
            .truths
            .iter()
            .find(|truth| truth.seq == header.seq)
            .map(|truth| TruthFrame { seq, t_capture_ns, ..*truth });
        self.commands.clear();
        let times = &self.times;
        self.commands.extend(
            self.new_commands.drain(..).map(|commands| Commands {
                t_sent_ns: times.moved(commands.t_sent_ns),
                ..commands
            }),
        );
        self.next = None;
        let exposure = Exposure {
            seq,
            t_capture_ns,
            t_capture_wall_ns: wall_ns()
                .saturating_sub(monotonic_ns().saturating_sub(t_capture_ns)),
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

    fn is_waiting(&self) -> bool {
        self.is_pausing
    }

    fn is_over(&self) -> bool {
        self.is_over
    }
}

/// Invalid numbers were recorded unchanged, and the classifier refuses them; here any value does.
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
fn read_ahead(mut reader: Reader, playlist: &Playlist) -> Receiver<Entry> {
    let (sender, receiver): (SyncSender<Entry>, _) = sync_channel(AHEAD);
    let (path, from_s) = (playlist.path.clone(), playlist.from_s);
    std::thread::spawn(move || {
        let from_ns = (from_s * 1e9) as u64;
        let mut first_ns = None;
        let mut reported = 0;
        // The first unreadable message is the end.
        while let Some(Ok(entry)) = reader.next() {
            for part in reader.damages().parts.iter().skip(reported) {
                runtime::tell!("touchline: {}: {part}", path.display());
                reported += 1;
            }
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

    fn entry(channel: Channel, t_sent_ns: u64, revision: u32) -> Entry {
        let setup = Setup {
            touchline_version: "test".into(),
            instance: "test".into(),
            wall_minus_monotonic_ns: 0,
            config_toml: String::new(),
            revision,
            accepted_wall_ns: 0,
        };
        Entry { channel, t_sent_ns, data: setup.encode().into() }
    }

    #[test]
    fn the_configuration_at_a_time_is_found_even_behind_earlier_messages() {
        let entries = [
            entry(Channel::Frames, 100, 0),
            entry(Channel::Setup, 200, 3),
            entry(Channel::Frames, 300, 0),
            entry(Channel::Setup, 400, 5),
            entry(Channel::Setup, 410, 4),
        ];
        let at = |from_ns| setup_at(entries.clone().into_iter(), from_ns).map(|it| it.revision);
        assert_eq!([0, 50, 100, 299, 300, 310].map(at), [3, 3, 3, 3, 5, 5].map(Some));
        assert_eq!(setup_at(entries.into_iter().take(1), 1000), None);
    }
}
