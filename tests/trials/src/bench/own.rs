//! Measures a configuration's own colours on pictures of its camera, stage by stage.

use super::COLD_BYTES;
use super::pictures::match_frames;
use super::stages::{self, Stages};
use crate::TrialError;
use config::Config;
use grabber::pictures::{list_pictures, load_bayer};
use runtime::output::Reader;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Time of each stage for a picture.
#[derive(Debug, Serialize)]
pub struct PictureRow {
    pub picture: String,
    #[serde(flatten)]
    pub stages: Stages,
}

/// Most copies of a picture that a measurement cycles through.
const MOST_COPIES: usize = 64;

/// Measures each picture, or frames of the synthetic match if there are none, and prints each result as
/// soon as it is known. A picture that cannot be used is reported; the others are measured all the same,
/// and the result is `false`.
pub fn measure(
    config: &Config,
    pictures: &[PathBuf],
    budget: Duration,
    shown_for: Option<usize>,
) -> Result<(Vec<PictureRow>, bool), TrialError> {
    let mut rows = Vec::new();
    let mut show = |picture: String, stages: Stages| -> Result<Reader, TrialError> {
        let reader = match shown_for {
            Some(processors) => stages.show(&picture, processors)?,
            None => Reader::There,
        };
        rows.push(PictureRow { picture, stages });
        Ok(reader)
    };
    if pictures.is_empty() {
        let frames = match_frames(config)?;
        show("a match frame".into(), stages::measure(config, &frames, budget)?)?;
        return Ok((rows, true));
    }
    let mut all_good = true;
    for picture in pictures {
        let found = match list_pictures(picture) {
            Ok(found) => found,
            Err(error) => {
                runtime::tell!("touchline: {error}");
                all_good = false;
                continue;
            }
        };
        for path in found {
            match of_picture(config, &path, budget) {
                Ok(stages) => {
                    if show(path.display().to_string(), stages)? == Reader::Gone {
                        return Ok((rows, all_good));
                    }
                }
                Err(error) => {
                    runtime::tell!("touchline: {error}");
                    all_good = false;
                }
            }
        }
    }
    Ok((rows, all_good))
}

fn of_picture(config: &Config, path: &Path, budget: Duration) -> Result<Stages, TrialError> {
    let frame = load_bayer(path, &config.camera)?;
    let copies = (COLD_BYTES / frame.len().max(1)).clamp(3, MOST_COPIES);
    stages::measure(config, &vec![frame; copies], budget)
        .map_err(|error| format!("{}: {error}", path.display()).into())
}
