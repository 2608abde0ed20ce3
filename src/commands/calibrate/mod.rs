//! `touchline calibrate`: from marked points to the camera's geometry.

mod overlay;
mod points;

use super::{CommandError, load_config, output};
use crate::cli::CalibrateArgs;
use common::calibration::{Calibration, KnownLens, LensSource, calibrate as fit, calibrated};
use common::config::{Config, GeometryConfig, Problem, commented_toml};
use grabber::pictures::read_picture;
use image::RgbImage;
use points::{NamedMark, PointsFile};
use std::fmt::Write as _;
use std::path::Path;
use std::process::ExitCode;

/// Fits the camera to the points, prints how well, and writes the configuration. Points that do not
/// go together are an error, and nothing is written.
pub fn calibrate(args: CalibrateArgs) -> Result<ExitCode, CommandError> {
    let mut config = load_config(args.config.as_deref())?;
    output::check_free(args.output.as_deref(), args.force)?;
    let mut file = args.points.as_deref().map_or(Ok(PointsFile::default()), PointsFile::load)?;
    for argument in &args.at {
        file.add_argument(argument)?;
    }
    file.wall_height_mm = args.wall_height_mm.or(file.wall_height_mm);
    let points = file.marks(&config.field)?;
    if points.is_empty() {
        return Err("no points: give --points FILE or --at PLACE=X,Y, at least four of them".into());
    }
    let picture = args.picture.as_deref().map(open).transpose()?;
    if let Some((path, picture)) = args.picture.as_deref().zip(picture.as_ref()) {
        adopt_size(&mut config, path, picture, args.config.is_some())?;
    }
    let lens = match (args.camera_height_mm.or(file.camera_height_mm), file.camera_mm) {
        (Some(height), _) => KnownLens::HeightMm(height),
        (None, Some(place)) => KnownLens::Position(place),
        (None, None) => KnownLens::Guess(config.geometry.camera_mm),
    };
    let marks: Vec<_> = points.iter().map(|point| point.mark).collect();
    let calibration = fit(&marks, lens, &config.field, &config.camera, args.within_px)
        .map_err(|error| format!("{error}\n{}nothing was written", listing(&points)))?;
    let config = calibrated(&config, &calibration);
    if let Some(problem) = config.problems().first() {
        return Err(format!("{problem}\n{}nothing was written", listing(&points)).into());
    }
    if let Some((path, picture)) = args.overlay.as_deref().zip(picture.as_ref()) {
        overlay::draw(picture, &config.field, &points, &calibration)
            .save(path)
            .map_err(|error| format!("overlay {}: {error}", path.display()))?;
    }
    let report = report(&points, &calibration, &config.warnings());
    match &args.output {
        None => {
            common::tell_part!("{report}");
            say!("{}", section(&calibration.geometry))?;
        }
        Some(path) => {
            output::write(path, &commented_toml(&config), args.force)?;
            let path = path.display();
            say!("{report}")?;
            say_line!("{path}: written; `touchline config check {path}` checks it")?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn open(path: &Path) -> Result<RgbImage, CommandError> {
    Ok(read_picture(path)?.into_rgb8())
}

/// Points are pixels of pictures of the configured size; without a configuration that of the
/// picture is as good as any.
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

/// Which point has which number.
fn listing(points: &[NamedMark]) -> String {
    let line = |(index, point): (usize, &NamedMark)| {
        let [x, y] = point.mark.image_px;
        format!("  {:>3}  {:<26} ({x:.1}, {y:.1})\n", index + 1, point.name)
    };
    points.iter().enumerate().map(line).collect()
}

/// Each point with its error, and what was found.
fn report(points: &[NamedMark], calibration: &Calibration, warnings: &[Problem]) -> String {
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
    let distortion = &calibration.geometry.distortion;
    let _ = match calibration.distortion_parameters {
        0 => writeln!(text, "distortion  none that these points could tell"),
        1 => writeln!(text, "distortion  k1 = {}", distortion.k1),
        2 => writeln!(text, "distortion  k1 = {}, k2 = {}", distortion.k1, distortion.k2),
        _ => writeln!(
            text,
            "distortion  k1 = {}, k2 = {}, around ({:.1}, {:.1})",
            distortion.k1, distortion.k2, distortion.center_px[0], distortion.center_px[1]
        ),
    };
    let _ = writeln!(text, "camera      {}", camera(calibration));
    for hint in hints(calibration) {
        let _ = writeln!(text, "note: {hint}");
    }
    for warning in warnings.iter().filter(|warning| warning.path.starts_with("geometry")) {
        let _ = writeln!(text, "warning: {warning}");
    }
    text
}

fn camera(calibration: &Calibration) -> String {
    let place = calibration.geometry.camera_mm;
    let sigma = calibration.lens_sigma_mm;
    let coordinate = |axis: usize| match sigma[axis] {
        0.0 => format!("{:.0}", place[axis]),
        sigma => format!("{:.0} ± {sigma:.0}", place[axis]),
    };
    let source = match calibration.lens_source {
        LensSource::Points => "from points of different heights",
        LensSource::HeightAndPoints => "height as measured, the rest from points above the floor",
        LensSource::HeightAndPerspective => "height as measured, the rest from the perspective",
        LensSource::Given => "as given",
        LensSource::Guessed => "as configured, not measured",
    };
    format!("{} mm high, at x {}, y {} mm ({source})", coordinate(2), coordinate(0), coordinate(1))
}

/// What would make it better.
fn hints(calibration: &Calibration) -> Vec<&'static str> {
    let mut hints = Vec::new();
    if calibration.surplus == 0 {
        hints.push(
            "so few points fit whatever they are; mark more to have them checked, and the lens'\n      \
             distortion found: points along walls and lines, and in the middle",
        );
    }
    if calibration.lens_source == LensSource::Guessed {
        hints.push(
            "how high the camera hangs cannot be told from points of one height; it matters for\n      \
             where robots stand. Mark the upper edge of the wall (\"wall top left\" …, with\n      \
             --wall-height-mm), or measure the height (--camera-height-mm)",
        );
    }
    if calibration.lens_source == LensSource::HeightAndPerspective {
        hints.push(
            "points at the upper edge of the wall (\"wall top left\" …) would tell better above\n      \
             which place the camera hangs",
        );
    }
    hints
}

/// The part of a configuration that was found.
fn section(geometry: &GeometryConfig) -> String {
    let GeometryConfig { camera_mm, points, distortion } = geometry;
    let mut text = format!("[geometry]\ncamera_mm = {camera_mm:?}\n");
    let _ = writeln!(
        text,
        "distortion = {{ k1 = {:?}, k2 = {:?}, center_px = {:?} }}\npoints = [",
        distortion.k1, distortion.k2, distortion.center_px
    );
    for pair in points {
        let _ = writeln!(
            text,
            "    {{ field_mm = {:?}, image_px = {:?} }},",
            pair.field_mm, pair.image_px
        );
    }
    text + "]\n"
}
