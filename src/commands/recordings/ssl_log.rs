//! Log files of the SSL: made from recordings, and their contents.

use super::{size_text, time_text};
use crate::cli::InfoArgs;
use crate::commands::CommandError;
use config::{Config, input};
use flate2::Compression;
use flate2::read::MultiGzDecoder;
use flate2::write::GzEncoder;
use messages::{DetectionFrame, WorldFrame};
use protocols::Message;
use protocols::ssl_log::{Kind, LogReader, LogWriter, MAGIC};
use protocols::ssl_vision::WrapperPacket;
use recording::{Channel, Entry, Setup, decode_message};
use runtime::output::{Output, Rule};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::Path;
use std::process::ExitCode;
use touchline::publisher::convert::{self, Scene, seconds};

/// First bytes of a compressed file.
const GZIP: [u8; 2] = [0x1f, 0x8b];
/// Interval between geometries.
const GEOMETRY_NS: u64 = 1_000_000_000;

/// A log file that is being written: detections as SSL-Vision's, world as a tracker's, and the geometry once a
/// second. The time of receipt is that at which our message was sent.
pub struct SslLog {
    log: LogWriter<BufWriter<Target>>,
    scene: Option<Scene>,
    /// Revision of the configuration of `scene`.
    revision: u32,
    geometry_ns: u64,
    without_config: bool,
}

/// The file, or the compressor before it.
enum Target {
    Plain(Output),
    Gzip(GzEncoder<Output>),
}

impl SslLog {
    /// Starts the file.
    pub fn create(path: &Path, rule: Rule) -> Result<Self, CommandError> {
        let output = rule.create(path)?;
        let is_compressed = path.extension().is_some_and(|extension| extension == "gz");
        let target = match is_compressed {
            true => Target::Gzip(GzEncoder::new(output, Compression::default())),
            false => Target::Plain(output),
        };
        let log = LogWriter::new(BufWriter::new(target))?;
        Ok(Self { log, scene: None, revision: 0, geometry_ns: 0, without_config: false })
    }

    /// Appends what a message of the recording becomes.
    pub fn take(&mut self, entry: &Entry) -> Result<(), CommandError> {
        if entry.channel == Channel::Setup {
            let setup = Setup::decode(&entry.data);
            // An earlier one may follow, for the outputs of a process that still worked with it.
            if let Some(setup) = setup.filter(|setup| setup.revision >= self.revision) {
                let config = Config::parse(&setup.config_toml, "the recorded configuration")?;
                let scene = Scene::new(&config, &setup.instance);
                self.scene = Some(scene.map_err(|error| format!("geometry: {error}"))?);
                self.revision = setup.revision;
                // Receivers get the new geometry at once.
                self.geometry_ns = 0;
            }
            return Ok(());
        }
        if ![Channel::Detections, Channel::World].contains(&entry.channel) {
            return Ok(());
        }
        let Some(scene) = &self.scene else {
            self.without_config = true;
            return Ok(());
        };
        let t_ns = entry.t_sent_ns as i64;
        if entry.t_sent_ns.saturating_sub(self.geometry_ns) >= GEOMETRY_NS {
            self.geometry_ns = entry.t_sent_ns;
            let packet = convert::geometry(scene).encode_to_vec();
            self.log.write(t_ns, Kind::Vision2014, &packet)?;
        }
        let (kind, packet) = match entry.channel {
            Channel::Detections => match decode_message::<DetectionFrame>(&entry.data) {
                Some(frame) => {
                    let packet = convert::of_detections(scene, &frame, seconds(entry.t_sent_ns));
                    (Kind::Vision2014, packet.encode_to_vec())
                }
                None => return Ok(()),
            },
            _ => match decode_message::<WorldFrame>(&entry.data) {
                Some(world) => (Kind::Tracker2020, convert::tracked(scene, &world).encode_to_vec()),
                None => return Ok(()),
            },
        };
        Ok(self.log.write(t_ns, kind, &packet)?)
    }

    /// Completes the file; returns the number of packets.
    pub fn finish(self) -> Result<u64, CommandError> {
        if self.without_config {
            return Err(
                "the recording has no configuration before its messages: a log needs it".into()
            );
        }
        let packets = self.log.messages();
        let target = self.log.finish()?.into_inner().map_err(|error| error.into_error())?;
        let output = match target {
            Target::Plain(output) => output,
            Target::Gzip(encoder) => encoder.finish()?,
        };
        output.finish()?;
        Ok(packets)
    }
}

impl Write for Target {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Plain(output) => output.write(bytes),
            Self::Gzip(encoder) => encoder.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Plain(output) => output.flush(),
            Self::Gzip(encoder) => encoder.flush(),
        }
    }
}

/// Whether a file is such a log, compressed or not.
pub fn is_log(path: &Path) -> bool {
    let Ok(mut from) = open(path) else { return false };
    let mut head = [0; MAGIC.len()];
    from.read_exact(&mut head).is_ok() && head == *MAGIC
}

fn open(path: &Path) -> io::Result<Box<dyn Read>> {
    let mut head = [0; GZIP.len()];
    let is_compressed = input::open(path)?.read_exact(&mut head).is_ok() && head == GZIP;
    let file = BufReader::new(input::open(path)?);
    Ok(match is_compressed {
        true => Box::new(BufReader::new(MultiGzDecoder::new(file))),
        false => Box::new(file),
    })
}

/// Contents of a log.
#[derive(Debug, Default, Serialize)]
struct Info {
    bytes: u64,
    seconds: f64,
    begins_wall_ns: i64,
    is_complete: bool,
    has_index: bool,
    /// Packets by kind.
    packets: BTreeMap<&'static str, Content>,
    /// SSL-Vision's detection frames by camera.
    cameras: BTreeMap<u32, Camera>,
    geometries: u64,
    unreadable: u64,
}

#[derive(Debug, Default, Serialize)]
struct Content {
    packets: u64,
    bytes: u64,
}

#[derive(Debug, Default, Serialize)]
struct Camera {
    frames: u64,
    first: u32,
    last: u32,
    missing: u64,
}

/// Prints the contents of a log.
pub fn info(args: &InfoArgs) -> Result<ExitCode, CommandError> {
    if args.config {
        return Err("a log file of the SSL holds no configuration".into());
    }
    let mut info =
        Info { bytes: args.file.metadata()?.len(), is_complete: true, ..Info::default() };
    let (mut begin, mut end) = (i64::MAX, i64::MIN);
    let mut problem = None;
    for message in LogReader::new(open(&args.file)?)? {
        let message = match message {
            Ok(message) => message,
            Err(error) => {
                (info.is_complete, problem) = (false, Some(error));
                break;
            }
        };
        if message.kind == Kind::Index2021 {
            info.has_index = true;
            continue;
        }
        (begin, end) = (begin.min(message.t_received_ns), end.max(message.t_received_ns));
        let content = info.packets.entry(message.kind.name()).or_default();
        content.packets += 1;
        content.bytes += message.packet.len() as u64;
        if message.kind == Kind::Vision2014 {
            info.look_into(&message.packet);
        }
    }
    if begin <= end {
        info.begins_wall_ns = begin;
        info.seconds = end.saturating_sub(begin) as f64 / 1e9;
    }
    if args.json {
        runtime::say_line!("{}", serde_json::to_string_pretty(&info)?)?;
    } else {
        runtime::say!("{}", info.text())?;
    }
    if let Some(problem) = problem {
        runtime::tell!("touchline: {}: {problem}; what follows is not read", args.file.display());
    }
    Ok(ExitCode::SUCCESS)
}

impl Info {
    fn look_into(&mut self, packet: &[u8]) {
        let Ok(packet) = WrapperPacket::decode(packet) else {
            self.unreadable += 1;
            return;
        };
        self.geometries += u64::from(packet.geometry.is_some());
        if let Some(frame) = packet.detection {
            let number = frame.frame_number;
            let camera = self.cameras.entry(frame.camera_id).or_insert(Camera {
                first: number,
                last: number,
                ..Camera::default()
            });
            camera.frames += 1;
            camera.last = camera.last.max(number);
            let span = u64::from(camera.last.saturating_sub(camera.first)) + 1;
            camera.missing = span.saturating_sub(camera.frames);
        }
    }

    fn text(&self) -> String {
        let mut text = format!(
            "  log file of the SSL, {} in {}, {}\n",
            size_text(self.bytes),
            time_text(self.seconds),
            if self.has_index { "with an index" } else { "without an index" }
        );
        for (id, camera) in &self.cameras {
            text += &format!(
                "  camera {id}: frames {} to {}, {} missing\n",
                camera.first, camera.last, camera.missing
            );
        }
        text += &format!("  {:<14}{:>10}{:>12}\n", "", "packets", "size");
        for (name, content) in &self.packets {
            let size = size_text(content.bytes);
            text += &format!("  {name:<14}{:>10}{size:>12}\n", content.packets);
        }
        text
    }
}
