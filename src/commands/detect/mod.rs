//! `touchline detect`: the detections of a running group, on still pictures.
//!
//! Runs the stages' own cores one after the other in one process, so the results are those of a match,
//! with one exception: in a match the filter's last output helps to choose between equally good
//! explanations of a picture; here every picture stands alone.

mod answer;
mod doubts;

use super::CommandError;
use super::picture_file::write_picture;
use crate::cli::DetectArgs;
use answer::Answer;
use classifier::{BayerImage, demosaic};
use config::{CameraConfig, Config};
use doubts::Doubts;
use grabber::pictures::{Picture, list_pictures, load_picture};
use messages::{DetectionFrame, MAX_RUNS};
use offline::chain::Chain;
use runtime::output::{Reader, Rule};
use runtime::user_config::load_config;
use std::collections::HashSet;
use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use touchline::drawing::detections::Overlay;
use touchline::top_scale::{Scale, TopScale};

/// Processes every picture and prints its detections. A picture that cannot be used is reported and
/// makes the exit code 1; the others are processed all the same.
pub fn detect(args: DetectArgs) -> Result<ExitCode, CommandError> {
    let config = load_config(args.config.as_deref())?;
    let mut chain = Chain::new(&config)?;
    let mut tops = TopScale::new(&config)?;
    let (pictures, mut all_good) = list(&args.images);
    let mut painter = match &args.overlay {
        Some(folder) => Some(Painter::new(folder, &config, &pictures, args.force)?),
        None => None,
    };
    let mut doubts = Doubts::default();
    for path in &pictures {
        let looked = look_at(path, &config, &mut chain, &mut tops, painter.as_mut(), &mut doubts);
        let answer = match looked {
            Ok(answer) => answer,
            Err(error) => {
                runtime::tell!("touchline: {error}");
                all_good = false;
                continue;
            }
        };
        let text = if args.json { serde_json::to_string(&answer)? + "\n" } else { answer.text() };
        if runtime::say!("{text}")? == Reader::Gone {
            break;
        }
    }
    if let Some(measured) = tops.measured().filter(Scale::is_off) {
        runtime::tell!("touchline: {}", measured.advice());
    }
    if let Some(doubt) = doubts.say(&config)? {
        runtime::tell!("touchline: {doubt}");
    }
    Ok(if all_good { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The pictures that files and folders stand for; `false` if some folders cannot be listed, which has
/// been reported by then.
fn list(arguments: &[PathBuf]) -> (Vec<PathBuf>, bool) {
    let mut pictures = Vec::new();
    let mut all_good = true;
    for argument in arguments {
        match list_pictures(argument) {
            Ok(found) => pictures.extend(found),
            Err(error) => {
                runtime::tell!("touchline: {error}");
                all_good = false;
            }
        }
    }
    (pictures, all_good)
}

fn look_at(
    path: &Path,
    config: &Config,
    chain: &mut Chain,
    tops: &mut TopScale,
    painter: Option<&mut Painter>,
    doubts: &mut Doubts,
) -> Result<Answer, CommandError> {
    let name = path.display();
    let Picture { bayer, is_raw } = load_picture(path, &config.camera)?;
    let seen = chain.look_at(&bayer).map_err(|fault| format!("{name}: {fault}"))?;
    if seen.flags & DetectionFrame::INPUT_OVERFLOW != 0 {
        runtime::tell!(
            "touchline: {name}: more than {MAX_RUNS} stretches of colour; the lower part of the \
             picture was not looked at; make the colours narrower"
        );
    }
    if seen.flags & DetectionFrame::SEARCH_CUT != 0 {
        runtime::tell!(
            "touchline: {name}: so many patches that not all combinations could be tried, or not all \
             of them looked at closely; robots may be missing; make the colours narrower, or `tracker.patch_tolerance_mm` smaller"
        );
    }
    tops.add(seen);
    let named = seen.robots().iter().filter(|robot| robot.is_identified()).count();
    doubts.keep(&bayer, is_raw, named);
    if let Some(painter) = painter {
        painter.paint(path, &bayer, seen)?;
    }
    Ok(Answer::new(name.to_string(), seen))
}

/// Writes overlays into a folder.
struct Painter<'a> {
    folder: PathBuf,
    camera: &'a CameraConfig,
    overlay: Overlay<'a>,
    /// File names already used.
    used: HashSet<String>,
    rgb: Vec<u8>,
    rule: Rule<'static>,
}

impl<'a> Painter<'a> {
    /// Makes sure that there is a folder, and that no picture comes from it, because overlays have the
    /// pictures' names.
    fn new(
        folder: &Path,
        config: &'a Config,
        pictures: &[PathBuf],
        force: bool,
    ) -> Result<Self, CommandError> {
        let problem = |error: io::Error| format!("overlay folder {}: {error}", folder.display());
        std::fs::create_dir_all(folder).map_err(problem)?;
        let place = folder.canonicalize().map_err(problem)?;
        for picture in pictures {
            let parent =
                picture.canonicalize().ok().and_then(|path| Some(path.parent()?.to_owned()));
            if parent.as_ref() == Some(&place) {
                return Err(format!(
                    "overlay folder {}: {} lies in it and would be overwritten; use another folder",
                    folder.display(),
                    picture.display()
                )
                .into());
            }
        }
        let rule = Rule { inputs: &[], force };
        let mut painter = Self {
            folder: folder.to_owned(),
            camera: &config.camera,
            overlay: Overlay::new(config)?,
            used: HashSet::new(),
            rgb: Vec::new(),
            rule,
        };
        // Before any of them is written.
        for picture in pictures {
            let name = painter.unused_name(picture);
            rule.check(&folder.join(name))?;
        }
        painter.used.clear();
        Ok(painter)
    }

    fn paint(
        &mut self,
        picture: &Path,
        bayer: &[u8],
        seen: &DetectionFrame,
    ) -> Result<(), CommandError> {
        let &CameraConfig { width, height, bayer_order, .. } = self.camera;
        let image = BayerImage::new(bayer, width, height, width, bayer_order)
            .ok_or_else(|| format!("{}: not a Bayer picture", picture.display()))?;
        demosaic(&image, &mut self.rgb);
        let name = self.unused_name(picture);
        let path = self.folder.join(name);
        Ok(write_picture(self.rule, &path, &self.overlay.draw(&self.rgb, seen))?)
    }

    /// The picture's own name with the extension of a PNG; followed by a number if another picture of
    /// this run has used it.
    fn unused_name(&mut self, picture: &Path) -> String {
        let stem = picture.file_stem().unwrap_or_default().to_string_lossy();
        let mut name = format!("{stem}.png");
        let mut number = 2;
        while !self.used.insert(name.clone()) {
            name = format!("{stem}-{number}.png");
            number += 1;
        }
        name
    }
}
