//! Reasons for which nothing is learned.

use crate::chain::ChainError;
use crate::learning::labels::LabelsError;
use crate::learning::samples::SamplesError;
use classifier::ClassifierError;
use geometry::GeometryError;
use grabber::camera::CameraError;
use messages::FrameFault;
use std::path::PathBuf;

/// Nothing can be learned; the text is for the user.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum LearnError {
    #[error(transparent)]
    Picture(#[from] CameraError),
    #[error("{}: too small to learn from", .0.display())]
    TooSmall(PathBuf),
    #[error("{}: {fault}", file.display())]
    Frame { file: PathBuf, fault: FrameFault },
    #[error(transparent)]
    Labels(#[from] LabelsError),
    #[error(transparent)]
    Samples(#[from] SamplesError),
    #[error(
        "nothing that is labelled shows a colour: label robots, a ball, or places under \"samples\""
    )]
    NothingLabelled,
    #[error(
        "no robot was found with any colours: check geometry, layout (`robots.patches`) and `looks`, \
         or label some robots and use --samples"
    )]
    NoRobot,
    #[error("geometry: {0}")]
    Geometry(#[from] GeometryError),
    #[error(transparent)]
    Classifier(#[from] ClassifierError),
    #[error(transparent)]
    Stages(#[from] ChainError),
}
