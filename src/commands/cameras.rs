//! `touchline cameras`.

use super::CommandError;
use crate::cli::CamerasArgs;
use grabber::listing::{CameraDescription, FeatureDescription, Listing, list};
use std::fmt::Write as _;
use std::process::ExitCode;

/// Lists the cameras connected to this machine.
pub fn cameras(args: CamerasArgs) -> Result<ExitCode, CommandError> {
    let listing = list();
    if args.json {
        runtime::say_line!("{}", serde_json::to_string_pretty(&listing)?)?;
    } else {
        runtime::say!("{}", text(&listing))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn text(listing: &Listing) -> String {
    let mut text = String::new();
    if listing.cameras.is_empty() {
        text.push_str("no camera found; the synthetic match needs none\n");
    }
    for camera in &listing.cameras {
        describe(&mut text, camera);
    }
    for note in &listing.notes {
        let _ = writeln!(text, "\nnote: {note}");
    }
    text
}

fn describe(text: &mut String, camera: &CameraDescription) {
    let gap = if text.is_empty() { "" } else { "\n" };
    let _ = writeln!(text, "{gap}{}   {} ({})", camera.source, camera.model, camera.driver);
    if let Some(problem) = &camera.problem {
        let _ = writeln!(text, "  {problem}");
    }
    for format in &camera.formats {
        let _ = write!(text, "  {:<12} {}", format.name, format.description);
        let _ = match &format.refused {
            Some(reason) => writeln!(text, ": {reason}"),
            None => writeln!(text),
        };
        if format.refused.is_some() {
            continue;
        }
        for size in &format.sizes {
            let rates: Vec<String> = size.fps.iter().map(|fps| format!("{fps:.4}")).collect();
            let rates = rates.iter().map(|r| r.trim_end_matches('0').trim_end_matches('.'));
            let rates = rates.collect::<Vec<_>>().join(", ");
            let _ = writeln!(text, "    {:<24} {rates} fps", size.size);
        }
    }
    if !camera.features.is_empty() {
        let _ = writeln!(text, "  for [camera.genicam.features], among others:");
    }
    for feature in &camera.features {
        let FeatureDescription { name, minimum, maximum, value } = feature;
        let _ = writeln!(text, "    {name:<32} {minimum} to {maximum} (now {value})");
    }
    if !camera.controls.is_empty() {
        let _ = writeln!(text, "  controls, for [camera.v4l2.controls]:");
    }
    for control in &camera.controls {
        let now = match control.value {
            Some(value) => format!("now {}", control.written(value)),
            None => "cannot be read".into(),
        };
        let inactive =
            if control.inactive { "; without effect while an automatic is on" } else { "" };
        let _ = writeln!(
            text,
            "    {:<32} {} (default {}, {now}{inactive})",
            control.name,
            control.allowed(),
            control.written(control.default)
        );
    }
}
