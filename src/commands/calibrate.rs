//! `touchline calibrate`: computes the camera's geometry from marked points.

use super::CommandError;
use super::from_group::SourceGroup;
use super::picture_file::write_picture;
use crate::cli::CalibrateArgs;
use config::{Config, DistortionConfig, DistortionModel, GeometryConfig, Problem, commented_toml};
use grabber::pictures::read_picture;
use image::RgbImage;
use offline::calibration::picture::lines::{LinesFound, NotRefined};
use offline::calibration::picture::points::{NamedMark, PointsFile};
use offline::calibration::picture::{Fit, Marking, fit, fit_without_marks, words};
use offline::calibration::{Calibration, KnownLens, calibrated};
use runtime::output::Rule;
use runtime::user_config::load_config;
use std::fmt::Write as _;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;
use touchline::drawing;
use touchline::live_frames::median;

/// Frames taken of a running group, and the least time between two: robots leave the lines meanwhile.
const LIVE_FRAMES: u16 = 9;
const APART: Duration = Duration::from_millis(250);

/// Fits the camera to the points, prints the residuals and writes the configuration. Inconsistent points
/// are an error, and nothing is written.
pub fn calibrate(args: CalibrateArgs) -> Result<ExitCode, CommandError> {
    let group = SourceGroup::open(&args.from_group, LIVE_FRAMES)?;
    let mut config = match (&group, &args.config) {
        (Some(group), None) => group.config()?,
        (_, file) => load_config(file.as_deref())?,
    };
    let inputs: Vec<&Path> = [&args.config, &args.points, &args.picture]
        .into_iter()
        .flatten()
        .map(|path| &**path)
        .collect();
    let rule = Rule { inputs: &inputs, force: args.force };
    for path in [&args.output, &args.overlay].into_iter().flatten() {
        rule.check(path)?;
    }
    let mut file = args.points.as_deref().map_or(Ok(PointsFile::default()), PointsFile::load)?;
    for argument in &args.at {
        file.add_argument(argument)?;
    }
    file.wall_height_mm = args.wall_height_mm.or(file.wall_height_mm);
    let mut points = file.marks(&config.field)?;
    let picture = match (&group, args.picture.as_deref()) {
        (Some(group), _) => median(&group.frames(&config, APART)?),
        (None, path) => path.map(open).transpose()?,
    };
    if let Some((path, picture)) = args.picture.as_deref().zip(picture.as_ref()) {
        adopt_size(&mut config, path, picture, args.config.is_some())?;
    }
    let lens = match (args.camera_height_mm.or(file.camera_height_mm), file.camera_mm) {
        (Some(height), _) => KnownLens::HeightMm(height),
        (None, Some(place)) => KnownLens::Position(place),
        (None, None) => KnownLens::Guess(config.geometry.camera_mm),
    };
    let lined = picture.as_ref().filter(|_| !args.marks_only);
    let Fit { calibration, lines } = match (points.is_empty(), lined) {
        (true, Some(picture)) => {
            let (fit, pitch) = fit_without_marks(&config, lens, picture)
                .map_err(|error| format!("{error}\nnothing was written"))?;
            points = pitch.marks.iter().map(NamedMark::found).collect();
            fit
        }
        (true, None) => return Err(NO_POINTS.into()),
        (false, _) => {
            let marks: Vec<_> = points.iter().map(|point| point.mark).collect();
            let marking = Marking::Within(args.within_px);
            fit(&config, &marks, marking, lens, lined)
                .map_err(|error| format!("{error}\n{}nothing was written", listing(&points)))?
        }
    };
    let config = calibrated(&config, &calibration);
    if let Some(problem) = config.problems().first() {
        return Err(format!("{problem}\n{}nothing was written", listing(&points)).into());
    }
    if let Some((path, picture)) = args.overlay.as_deref().zip(picture.as_ref()) {
        write_picture(
            rule,
            path,
            &drawing::calibration::draw(picture, &config.field, &points, &calibration),
        )?;
    }
    let lines = lines.as_ref().map(said_of_lines);
    let report = report(&points, &calibration, lines.as_deref(), &config.warnings());
    match &args.output {
        None if args.from_group.apply => _ = runtime::say!("{report}")?,
        None => {
            runtime::tell_part!("{report}");
            runtime::say!("{}", section(&calibration.geometry))?;
        }
        Some(path) => {
            rule.write(path, commented_toml(&config).as_bytes())?;
            let path = path.display();
            runtime::say!("{report}")?;
            runtime::say_line!("{path}: written; `touchline config check {path}` checks it")?;
        }
    }
    let Some(group) = group else { return Ok(ExitCode::SUCCESS) };
    group.apply(args.output.is_some(), |newest| newest.geometry = config.geometry)
}

const NO_POINTS: &str = "no points: give a picture (--picture FILE) in which the pitch can be found, or points (--points \
                         FILE or --at PLACE=X,Y), at least four of them";

/// The result of the search for the lines of the pitch, as text.
fn said_of_lines(outcome: &Result<LinesFound, NotRefined>) -> String {
    match outcome {
        Ok(found) => found.text(),
        Err(why) => format!("not used: {why}"),
    }
}

fn open(path: &Path) -> Result<RgbImage, CommandError> {
    Ok(read_picture(path)?.into_rgb8())
}

/// Points are pixels of pictures of the configured size. Without a configuration, the size of the
/// picture is adopted.
fn adopt_size(
    config: &mut Config,
    path: &Path,
    picture: &RgbImage,
    is_configured: bool,
) -> Result<(), CommandError> {
    let camera = &mut config.camera;
    let (width, height) = picture.dimensions();
    if (camera.width, camera.height) != (width, height) && is_configured {
        return Err(format!(
            "{}: has {width} × {height} pixels, the camera is configured to {} × {}",
            path.display(),
            camera.width,
            camera.height
        )
        .into());
    }
    (camera.width, camera.height) = (width, height);
    Ok(())
}

/// Numbered list of the points.
fn listing(points: &[NamedMark]) -> String {
    let line = |(index, point): (usize, &NamedMark)| {
        let [x, y] = point.mark.image_px;
        format!("  {:>3}  {:<26} ({x:.1}, {y:.1})\n", index + 1, point.name)
    };
    points.iter().enumerate().map(line).collect()
}

/// Each point with its error, and the fitted camera.
fn report(
    points: &[NamedMark],
    calibration: &Calibration,
    refinement: Option<&str>,
    warnings: &[Problem],
) -> String {
    let mut text = "  no.  point                      marked at           off by, px\n".to_string();
    for (index, (point, [dx, dy])) in points.iter().zip(&calibration.errors_px).enumerate() {
        let [x, y] = point.mark.image_px;
        let marked = format!("({x:.1}, {y:.1})");
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "  {:>3}  {:<26} {marked:<18}  {:.2}  ({dx:+.2}, {dy:+.2})",
            index + 1,
            point.name,
            dx.hypot(*dy),
        );
    }
    let (worst, most) = calibration.worst();
    let _ = writeln!(
        text,
        "error       rms {:.2} px, at most {most:.2} px (point {})",
        calibration.rms_px(),
        worst + 1
    );
    if let Some(refinement) = refinement {
        let _ = writeln!(text, "lines       {refinement}");
    }
    let _ = writeln!(text, "lens        {}", words::lens(calibration));
    let _ = writeln!(text, "camera      {}", words::camera(calibration));
    for hint in words::hints(calibration) {
        let _ = writeln!(text, "note: {hint}");
    }
    for warning in warnings.iter().filter(|warning| warning.path.starts_with("geometry")) {
        let _ = writeln!(text, "warning: {warning}");
    }
    text
}

/// The part of the configuration that was determined.
fn section(geometry: &GeometryConfig) -> String {
    let GeometryConfig { camera_mm, points, distortion } = geometry;
    let mut text = format!("[geometry]\ncamera_mm = {camera_mm:?}\n");
    let DistortionConfig { model, focal_px, k1, k2, k3, k4, center_px } = distortion;
    let _ = match model {
        DistortionModel::Polynomial => {
            writeln!(text, "distortion = {{ k1 = {k1:?}, k2 = {k2:?}, center_px = {center_px:?} }}")
        }
        DistortionModel::Fisheye => writeln!(
            text,
            "distortion = {{ model = \"fisheye\", focal_px = {focal_px:?}, k1 = {k1:?}, k2 = {k2:?}, \
             k3 = {k3:?}, k4 = {k4:?}, center_px = {center_px:?} }}"
        ),
    };
    text += "points = [\n";
    for pair in points {
        let _ = writeln!(
            text,
            "    {{ field_mm = {:?}, image_px = {:?} }},",
            pair.field_mm, pair.image_px
        );
    }
    text + "]\n"
}
