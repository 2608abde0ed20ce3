//! `touchline export`: converts a recording to formats that other tools read.

use super::ssl_log::SslLog;
use super::tell_damages;
use crate::cli::ExportArgs;
use crate::commands::CommandError;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use messages::{DetectionFrame, PixelFormat, Team, TrackStatus, TruthFrame, WorldFrame};
use recording::{Channel, Entry, Frame, Reader, decode_frame, decode_message};
use runtime::output::{Output, Rule};
use std::io::{BufWriter, Write};
use std::path::Path;
use std::process::ExitCode;

const COLUMNS: &str = "source,seq,t_capture_ns,what,robot_id,x_mm,y_mm,orientation_rad,v_mm_s,\
                       omega_rad_s,vx_mm_s,vy_mm_s,quality,track_id";

/// Standard output as a file.
const STDOUT: &str = "/dev/stdout";

/// Writes poses as a table, frames as pictures, or both.
pub fn export(args: ExportArgs) -> Result<ExitCode, CommandError> {
    if args.csv.is_none() && args.png.is_none() && args.ssl_log.is_none() {
        return Err("say what to export: --csv FILE, --png DIR, --ssl-log FILE".into());
    }
    if [&args.csv, &args.ssl_log].into_iter().flatten().filter(|path| is_stdout(path)).count() > 1 {
        return Err("only one of them can go to standard output".into());
    }
    let mut reader = Reader::open(&args.file)?;
    let rule = Rule { inputs: &[&args.file], force: args.force };
    let place = |path: &Path| if is_stdout(path) { STDOUT.into() } else { path.to_path_buf() };
    let (csv, ssl_log) = (args.csv.as_deref().map(place), args.ssl_log.as_deref().map(place));
    let mut table = csv.as_deref().map(|path| Table::create(path, rule)).transpose()?;
    let mut log = ssl_log.as_deref().map(|path| SslLog::create(path, rule)).transpose()?;
    if let Some(directory) = &args.png {
        std::fs::create_dir_all(directory)
            .map_err(|error| format!("{}: {error}", directory.display()))?;
    }
    let (mut frames, mut pictures, mut unknown) = (0, 0, 0);
    for entry in reader.by_ref() {
        let entry = entry?;
        if let Some(table) = &mut table {
            table.take(&entry)?;
        }
        if let Some(log) = &mut log {
            log.take(&entry)?;
        }
        if let (Some(directory), Channel::Frames) = (&args.png, entry.channel) {
            frames += 1;
            let Some(frame) = decode_frame(&entry.data) else { continue };
            if (frames - 1) % args.every == 0 {
                let written = save(&frame, directory, rule)?;
                pictures += u64::from(written);
                unknown += u64::from(!written);
            }
        }
    }
    if let (Some(table), Some(path)) = (table, &args.csv) {
        tell_count(path, table.finish()?, "rows")?;
    }
    if let (Some(log), Some(path)) = (log, &args.ssl_log) {
        tell_count(path, log.finish()?, "packets")?;
    }
    tell_damages(&args.file, reader.damages());
    if let Some(directory) = &args.png {
        runtime::say_line!("{}: {pictures} pictures", directory.display())?;
        if unknown > 0 {
            runtime::tell!("touchline: {unknown} frames are neither 8-bit Bayer nor RGB; left out");
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Whether a path stands for standard output.
fn is_stdout(path: &Path) -> bool {
    path == Path::new("-")
}

/// Says how much was written, but not in the middle of it.
fn tell_count(path: &Path, count: u64, what: &str) -> std::io::Result<()> {
    if !is_stdout(path) {
        runtime::say_line!("{}: {count} {what}", path.display())?;
    }
    Ok(())
}

/// Saves a frame unprocessed: Bayer data as a grey picture, which `touchline detect` recognises as such.
/// `false` for formats that no PNG can hold.
fn save(frame: &Frame, directory: &Path, rule: Rule) -> Result<bool, CommandError> {
    let header = &frame.header;
    let (bytes, color) = match PixelFormat::from_number(header.pixel_format) {
        Some(PixelFormat::Bayer8) => (1, ExtendedColorType::L8),
        Some(PixelFormat::Rgb24) => (3, ExtendedColorType::Rgb8),
        _ => return Ok(false),
    };
    let row = header.width as usize * bytes;
    if header.check(header.width, header.height, frame.pixels.len()).is_err() || row == 0 {
        return Ok(false);
    }
    let rows = frame.pixels.chunks(header.stride as usize).take(header.height as usize);
    let pixels: Vec<u8> = rows.flat_map(|bytes| &bytes[..row]).copied().collect();
    let path = directory.join(format!("frame-{:08}.png", header.seq));
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(&pixels, header.width, header.height, color)
        .map_err(|error| format!("{}: {error}", path.display()))?;
    rule.write(&path, &png)?;
    Ok(true)
}

/// One row for each robot and ball of each message.
struct Table {
    file: BufWriter<Output>,
    rows: u64,
}

/// The data of a robot or ball; columns that do not apply stay empty.
#[derive(Default)]
struct Row {
    what: &'static str,
    robot_id: Option<u32>,
    /// Only for a robot without a number.
    track_id: Option<u32>,
    x_mm: f64,
    y_mm: f64,
    orientation: Option<f64>,
    speed: Option<(f64, f64)>,
    velocity: Option<(f64, f64)>,
    quality: Option<f64>,
}

impl Table {
    fn create(path: &Path, rule: Rule) -> Result<Self, CommandError> {
        let mut file = BufWriter::new(rule.create(path)?);
        writeln!(file, "{COLUMNS}")?;
        Ok(Self { file, rows: 0 })
    }

    fn finish(self) -> Result<u64, CommandError> {
        let file = self.file.into_inner().map_err(|error| error.into_error())?;
        file.finish()?;
        Ok(self.rows)
    }

    fn take(&mut self, entry: &Entry) -> std::io::Result<()> {
        let (seq, t_ns, rows) = match entry.channel {
            Channel::Detections => match decode_message::<DetectionFrame>(&entry.data) {
                Some(message) => {
                    (message.frame.seq, message.frame.t_capture_ns, of_detections(&message))
                }
                None => return Ok(()),
            },
            Channel::World => match decode_message::<WorldFrame>(&entry.data) {
                Some(message) => {
                    (message.frame.seq, message.frame.t_capture_ns, of_world(&message))
                }
                None => return Ok(()),
            },
            Channel::Truth => match decode_message::<TruthFrame>(&entry.data) {
                Some(message) => (message.seq, message.t_capture_ns, of_truth(&message)),
                None => return Ok(()),
            },
            _ => return Ok(()),
        };
        let source = entry.channel.name();
        for row in rows {
            let Row { what, x_mm, y_mm, .. } = row;
            let name = |id: Option<u32>| id.map(|id| id.to_string()).unwrap_or_default();
            let (id, track_id) = (name(row.robot_id), name(row.track_id));
            let number = |value: Option<f64>| value.map(|v| v.to_string()).unwrap_or_default();
            let (v, omega) = (row.speed.map(|speed| speed.0), row.speed.map(|speed| speed.1));
            let (vx, vy) = (row.velocity.map(|v| v.0), row.velocity.map(|v| v.1));
            writeln!(
                self.file,
                "{source},{seq},{t_ns},{what},{id},{x_mm},{y_mm},{},{},{},{},{},{},{track_id}",
                number(row.orientation),
                number(v),
                number(omega),
                number(vx),
                number(vy),
                number(row.quality),
            )?;
            self.rows += 1;
        }
        Ok(())
    }
}

fn team(number: u32) -> &'static str {
    Team::from_number(number).map_or("unknown", Team::name)
}

fn of_detections(message: &DetectionFrame) -> Vec<Row> {
    let robots = message.robots().iter().map(|robot| Row {
        what: team(robot.team),
        robot_id: robot.robot_id.number(),
        x_mm: robot.x_mm.into(),
        y_mm: robot.y_mm.into(),
        orientation: robot.is_identified().then_some(robot.orientation.into()),
        quality: Some(robot.confidence.into()),
        ..Row::default()
    });
    // Candidates are listed best first.
    let ball = message.balls().first().map(|ball| Row {
        what: "ball",
        x_mm: ball.x_mm.into(),
        y_mm: ball.y_mm.into(),
        quality: Some(ball.confidence.into()),
        ..Row::default()
    });
    robots.chain(ball).collect()
}

fn of_world(message: &WorldFrame) -> Vec<Row> {
    let is_present = |status| status != TrackStatus::Absent as u32;
    let robots = message.robots().iter().filter(|robot| is_present(robot.status));
    let robots = robots.map(|robot| Row {
        what: team(robot.team),
        robot_id: Some(robot.robot_id),
        x_mm: robot.x_mm,
        y_mm: robot.y_mm,
        orientation: Some(robot.orientation),
        speed: Some((robot.v_mm_s, robot.omega)),
        quality: Some(robot.visibility.into()),
        ..Row::default()
    });
    let unknown = message.unknown_robots().iter().filter(|robot| is_present(robot.status));
    let unknown = unknown.map(|robot| Row {
        what: team(robot.team),
        track_id: Some(robot.track_id),
        x_mm: robot.x_mm,
        y_mm: robot.y_mm,
        velocity: Some((robot.vx_mm_s, robot.vy_mm_s)),
        quality: Some(robot.visibility.into()),
        ..Row::default()
    });
    let ball = &message.ball;
    let ball = is_present(ball.status).then(|| Row {
        what: "ball",
        x_mm: ball.x_mm,
        y_mm: ball.y_mm,
        velocity: Some((ball.vx_mm_s, ball.vy_mm_s)),
        quality: Some(ball.visibility.into()),
        ..Row::default()
    });
    robots.chain(unknown).chain(ball).collect()
}

fn of_truth(message: &TruthFrame) -> Vec<Row> {
    let robots = message.robots().iter().map(|robot| Row {
        what: team(robot.team),
        robot_id: Some(robot.robot_id),
        x_mm: robot.x_mm,
        y_mm: robot.y_mm,
        orientation: Some(robot.orientation),
        speed: Some((robot.v_mm_s, robot.omega)),
        quality: Some(robot.visible.into()),
        ..Row::default()
    });
    let ball = Row {
        what: "ball",
        x_mm: message.ball_x_mm,
        y_mm: message.ball_y_mm,
        velocity: Some((message.ball_vx_mm_s, message.ball_vy_mm_s)),
        quality: Some(message.ball_visible.into()),
        ..Row::default()
    };
    robots.chain([ball]).collect()
}
