//! `touchline score`: measures detection of robots and ball on labelled pictures.

mod moments;
mod report;
mod synthetic;

use super::CommandError;
use crate::cli::ScoreArgs;
use config::Config;
use geometry::CameraModel;
use grabber::pictures::load_bayer;
use offline::chain::Chain;
use offline::learning::labels::{ImageLabels, Labels};
use offline::scoring::{Judge, PictureScore, Tolerances};
use report::Report;
use runtime::user_config::load_config;
use std::process::ExitCode;
use touchline::top_scale::TopScale;

/// Processes every labelled picture and prints its score. A picture that cannot be used is reported and
/// makes the exit code 1; the others count all the same.
pub fn score(args: ScoreArgs) -> Result<ExitCode, CommandError> {
    let config = load_config(args.config.as_deref())?;
    if args.synthetic {
        return score_scenes(&config, &args);
    }
    let tolerances = Tolerances {
        robot_px: args.within_px,
        robot_deg: args.within_deg,
        ball_px: args.ball_within_px,
    };
    // All files are read first, so that a typing error shows at once.
    let labels: Vec<Labels> =
        args.labels.iter().map(|path| Labels::load(path)).collect::<Result<_, _>>()?;
    let mut chain = Chain::new(&config)?;
    let camera = CameraModel::new(&config.geometry, config.camera.width, config.camera.height)?;
    let judge = Judge { config: &config, camera: &camera, tolerances };
    let mut pictures = Vec::new();
    let mut tops = TopScale::new(&config)?;
    let mut all_good = true;
    for image in labels.iter().flat_map(|labels| &labels.images) {
        match look_at(image, &config, &mut chain, &judge) {
            Ok(score) => {
                tops.add(chain.detections());
                pictures.push(score);
            }
            Err(error) => {
                runtime::tell!("touchline: {error}");
                all_good = false;
            }
        }
    }
    let report = Report::new(pictures, tolerances, tops.measured());
    let text =
        if args.json { serde_json::to_string_pretty(&report)? + "\n" } else { report.text() };
    runtime::say!("{text}")?;
    Ok(if all_good { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Plays the synthetic scenes, and prints each as soon as it is done.
fn score_scenes(config: &Config, args: &ScoreArgs) -> Result<ExitCode, CommandError> {
    if !args.json {
        runtime::say!("{}", synthetic::HEADING)?;
    }
    synthetic::play(config, &args.scenes, args.frames as usize, |score| {
        let text = if args.json { serde_json::to_string(&score)? + "\n" } else { score.text() };
        Ok(runtime::say!("{text}")?)
    })?;
    Ok(ExitCode::SUCCESS)
}

fn look_at(
    image: &ImageLabels,
    config: &Config,
    chain: &mut Chain,
    judge: &Judge,
) -> Result<PictureScore, CommandError> {
    let name = image.file.display();
    let bayer = load_bayer(&image.file, &config.camera)?;
    chain.look_at(&bayer).map_err(|fault| format!("{name}: {fault}"))?;
    Ok(judge.judge(image, chain.detections(), chain.runs()))
}
