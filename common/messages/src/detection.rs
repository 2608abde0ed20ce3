//! The tracker's output: regions, and the robots and balls made of them.

use super::json;
use super::{FrameHeader, Run, filled, push};
use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use serde::Serialize;

/// Most regions a message carries; beyond it the smallest are left out and
/// [`DetectionFrame::REGIONS_OVERFLOW`] is set.
pub const MAX_REGIONS: usize = 1024;
/// Most robots a message carries.
pub use super::world::MAX_ROBOTS;
/// Most ball candidates a message carries, best first.
pub const MAX_BALLS: usize = 8;
/// Most rejected candidates a message carries.
pub const MAX_REJECTED: usize = 128;
/// Most colour patches a robot's layout may have.
pub const MAX_PATCHES: usize = 6;

/// A connected set of pixels of one class (section 5 of the paper). Its pixels are
/// `runs[first_run..first_run + run_count]` of the same message.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/Region/1")]
#[repr(C)]
pub struct Region {
    /// Colour class: index into the configured colours.
    pub class: u32,
    /// Number of pixels.
    pub pixel_count: u32,
    /// Centroid, column.
    pub x_px: f32,
    /// Centroid, row.
    pub y_px: f32,
    /// Bounding box, first column.
    pub left: u16,
    /// Bounding box, first row.
    pub top: u16,
    /// Bounding box, last column.
    pub right: u16,
    /// Bounding box, last row.
    pub bottom: u16,
    /// Index of the first of its runs.
    pub first_run: u32,
    /// Number of its runs; 0 when they did not fit ([`DetectionFrame::RUNS_OVERFLOW`]).
    pub run_count: u32,
}

/// A robot found in this frame alone.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/DetectedRobot/2")]
#[repr(C)]
pub struct DetectedRobot {
    /// A [`Team`](super::Team) number.
    #[serde(serialize_with = "json::team")]
    pub team: u32,
    /// Number of the robot in its team; 4294967295 when unknown.
    pub robot_id: RobotId,
    /// Centre of the robot on the field.
    pub x_mm: f32,
    /// Centre of the robot on the field.
    pub y_mm: f32,
    /// Heading on the field, radians, in (−π, π].
    pub orientation: f32,
    /// 0–1: how well the patches fit the robot's layout.
    pub confidence: f32,
    /// Centre of the robot's top in the image.
    pub x_px: f32,
    /// Centre of the robot's top in the image.
    pub y_px: f32,
    /// Heading as it appears in the image: radians, 0 to the right, π/2 up.
    pub orientation_image: f32,
    /// Valid elements of `patch_regions`.
    pub patch_count: u32,
    /// For each patch of the layout in turn, the index of the region it is, or is a part of; `u32::MAX`
    /// when not seen.
    pub patch_regions: [u32; MAX_PATCHES],
    /// Covariance of x, y and orientation: upper triangle row by row, mm and radians (xx, xy, xθ, yy,
    /// yθ, θθ). All 0 when unknown.
    pub covariance: [f32; 6],
    /// Number of raw pixel samples, at the edges of the patches, from which the pose was measured; 0
    /// when it was computed from the centroids of the patches alone.
    pub edge_samples: u32,
}

impl DetectedRobot {
    /// Whether the robot's number is known. An unidentified robot has only a team patch: its position
    /// is that of the patch, and its heading is unknown (0).
    pub fn is_identified(&self) -> bool {
        self.robot_id.number().is_some()
    }
}

/// The number of a robot in its team, or unknown; callers must ask for the number explicitly.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Pod, Zeroable, ZeroCopySend,
)]
#[type_name("touchline/RobotId/1")]
#[repr(C)]
pub struct RobotId(u32);

impl RobotId {
    /// The number is not known.
    pub const UNKNOWN: Self = Self(u32::MAX);

    /// The number, if it is known.
    pub fn number(self) -> Option<u32> {
        (self != Self::UNKNOWN).then_some(self.0)
    }
}

impl From<u32> for RobotId {
    fn from(number: u32) -> Self {
        Self(number)
    }
}

/// A ball candidate.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/DetectedBall/2")]
#[repr(C)]
pub struct DetectedBall {
    /// Centre of the ball on the field.
    pub x_mm: f32,
    /// Centre of the ball on the field.
    pub y_mm: f32,
    /// Centre of the ball in the image.
    pub x_px: f32,
    /// Centre of the ball in the image.
    pub y_px: f32,
    /// 0–1: how well size and shape fit a ball.
    pub confidence: f32,
    /// Index of its region.
    pub region: u32,
    /// Covariance of x and y: upper triangle row by row, mm². All 0 when unknown.
    pub covariance: [f32; 3],
    /// Number of raw pixel samples, at the ball's rim, from which its position was measured; 0 when the
    /// position is the centroid of its region.
    pub edge_samples: u32,
}

/// Reason why a candidate did not become a robot or a ball.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u32)]
pub enum RejectReason {
    /// Fewer pixels than a patch can have.
    TooSmall = 1,
    /// More pixels than a patch can have.
    TooLarge = 2,
    /// Nearer to a larger patch of the same team than two robots can be (eq. 4).
    TooCloseToTeamPatch = 3,
    /// No identification patch within reach (eq. 5).
    NoIdentificationPatch = 4,
    /// Identification patches are near, but not where any layout of the team has them.
    LayoutMismatch = 5,
    /// Its identification patches fit another robot better.
    TakenByAnother = 6,
    /// Outside the field.
    OutsideField = 7,
    /// The shape is not that of a ball.
    NotRound = 8,
    /// An identification patch without a team patch in range.
    NoTeamPatch = 9,
    /// Too many patches of the team's colours are around it to try every combination.
    SearchCut = 10,
    /// Its patches fit no layout by themselves, and the frame's time budget for a second look at their
    /// pixels was spent on other such patches.
    NotLookedAt = 11,
}

impl RejectReason {
    /// All reasons.
    pub const ALL: [Self; 11] = [
        Self::TooSmall,
        Self::TooLarge,
        Self::TooCloseToTeamPatch,
        Self::NoIdentificationPatch,
        Self::LayoutMismatch,
        Self::TakenByAnother,
        Self::OutsideField,
        Self::NotRound,
        Self::NoTeamPatch,
        Self::SearchCut,
        Self::NotLookedAt,
    ];

    /// The reason with this number in a message, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|&reason| reason as u32 == number)
    }

    /// A short phrase for reports.
    pub fn text(self) -> &'static str {
        match self {
            Self::TooSmall => "too small",
            Self::TooLarge => "too large",
            Self::TooCloseToTeamPatch => "too close to another team patch",
            Self::NoIdentificationPatch => "no identification patch in range",
            Self::LayoutMismatch => "identification patches do not fit the layout",
            Self::TakenByAnother => "identification patches taken by another robot",
            Self::OutsideField => "outside the field",
            Self::NotRound => "not round enough for a ball",
            Self::NoTeamPatch => "identification patch without a team patch in range",
            Self::SearchCut => "too many patches around it to try all combinations",
            Self::NotLookedAt => "not looked at closely, too many doubtful patches in the frame",
        }
    }
}

/// A rejected candidate and the reason.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/Rejected/1")]
#[repr(C)]
pub struct Rejected {
    /// A [`Team`](super::Team) number, [`Rejected::BALL`], or [`Rejected::UNKNOWN_TEAM`].
    #[serde(serialize_with = "json::candidate")]
    pub team: u32,
    /// A [`RejectReason`] number.
    #[serde(serialize_with = "json::reject_reason")]
    pub reason: u32,
    /// Centroid in the image.
    pub x_px: f32,
    /// Centroid in the image.
    pub y_px: f32,
}

impl Rejected {
    /// Value of `team` for a ball candidate.
    pub const BALL: u32 = 2;
    /// Value of `team` for a robot candidate of either team.
    pub const UNKNOWN_TEAM: u32 = 3;
}

/// Everything the tracker found in one frame, with the reasons for rejections.
#[derive(Debug, Clone, Copy, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/DetectionFrame/4")]
#[repr(C)]
pub struct DetectionFrame {
    /// The frame this was found in.
    pub frame: FrameHeader,
    /// When the classifier received the frame.
    pub t_frame_taken_ns: u64,
    /// When the classifier published its runs.
    pub t_runs_ns: u64,
    /// When the tracker received the runs.
    pub t_runs_taken_ns: u64,
    /// When the tracker published this message.
    pub t_sent_ns: u64,
    /// Version of the classifier's tables, as in [`RunsHeader`](super::RunsHeader).
    pub class_table_version: u64,
    /// Frame number of the `world` used as prediction; [`DetectionFrame::NO_WORLD`] for none.
    pub prior_world_seq: u64,
    /// Revision of the classifier's configuration.
    pub classifier_revision: u32,
    /// Revision of the tracker's configuration.
    pub revision: u32,
    /// Bit set of the flags below.
    pub flags: u32,
    /// Valid elements of `robots`.
    pub robot_count: u32,
    /// Valid elements of `balls`.
    pub ball_count: u32,
    /// Valid elements of `rejected`.
    pub rejected_count: u32,
    /// Valid elements of `regions`.
    pub region_count: u32,
    /// Valid elements of `runs`.
    pub run_count: u32,
    /// Robots, by team and number.
    pub robots: [DetectedRobot; MAX_ROBOTS],
    /// Ball candidates, best first.
    pub balls: [DetectedBall; MAX_BALLS],
    /// Rejected candidates.
    #[cfg_attr(
        feature = "schema",
        schemars(with = "crate::structure::List<Rejected, MAX_REJECTED>")
    )]
    pub rejected: [Rejected; MAX_REJECTED],
    /// Regions, in the order in which their first pixel appears in the picture.
    #[cfg_attr(feature = "schema", schemars(with = "crate::structure::List<Region, MAX_REGIONS>"))]
    pub regions: [Region; MAX_REGIONS],
    /// The pixels of the regions, region by region.
    #[cfg_attr(
        feature = "schema",
        schemars(with = "crate::structure::List<Run, { super::MAX_RUNS }>")
    )]
    pub runs: [Run; super::MAX_RUNS],
}

const _: () = assert!(size_of::<Region>() == 32);
const _: () = assert!(size_of::<DetectedRobot>() == 92);
const _: () = assert!(
    size_of::<DetectionFrame>()
        == 144
            + MAX_ROBOTS * 92
            + MAX_BALLS * 40
            + MAX_REJECTED * 16
            + MAX_REGIONS * 32
            + super::MAX_RUNS * 8
);

impl DetectionFrame {
    /// Flag: the list of runs this was computed from was cut off.
    pub const INPUT_OVERFLOW: u32 = 1;
    /// Flag: there were more regions than fit.
    pub const REGIONS_OVERFLOW: u32 = 2;
    /// Flag: some regions come without their runs.
    pub const RUNS_OVERFLOW: u32 = 4;
    /// Flag: the raw frame was available, so poses could be measured from edges in it.
    pub const FRAME_USED: u32 = 8;
    /// Flag: there were more possible explanations of the picture than time to compare them. Robots may
    /// be missing; the team patches concerned are listed with [`RejectReason::SearchCut`] or
    /// [`RejectReason::NotLookedAt`].
    pub const SEARCH_CUT: u32 = 16;
    /// Value of `prior_world_seq` when no `world` was used.
    pub const NO_WORLD: u64 = u64::MAX;

    /// Empties all lists and clears the flags, but leaves the (large) arrays as they are: messages are
    /// reused or loaned, and writing a third of a megabyte of zeros would cost more than the whole
    /// stage.
    pub fn clear(&mut self) {
        self.flags = 0;
        self.robot_count = 0;
        self.ball_count = 0;
        self.rejected_count = 0;
        self.region_count = 0;
        self.run_count = 0;
    }

    /// Robots found.
    pub fn robots(&self) -> &[DetectedRobot] {
        filled(&self.robots, self.robot_count)
    }

    /// Ball candidates, best first.
    pub fn balls(&self) -> &[DetectedBall] {
        filled(&self.balls, self.ball_count)
    }

    /// Rejected candidates.
    pub fn rejected(&self) -> &[Rejected] {
        filled(&self.rejected, self.rejected_count)
    }

    /// Regions found.
    pub fn regions(&self) -> &[Region] {
        filled(&self.regions, self.region_count)
    }

    /// Robots for modification, and regions.
    pub fn robots_and_regions_mut(&mut self) -> (&mut [DetectedRobot], &[Region]) {
        let count = (self.robot_count as usize).min(MAX_ROBOTS);
        (&mut self.robots[..count], filled(&self.regions, self.region_count))
    }

    /// Ball candidates for modification, and regions.
    pub fn balls_and_regions_mut(&mut self) -> (&mut [DetectedBall], &[Region]) {
        let count = (self.ball_count as usize).min(MAX_BALLS);
        (&mut self.balls[..count], filled(&self.regions, self.region_count))
    }

    /// The pixels of a region, as runs.
    pub fn runs_of(&self, region: &Region) -> &[Run] {
        let runs = filled(&self.runs, self.run_count);
        let begin = (region.first_run as usize).min(runs.len());
        let end = begin.saturating_add(region.run_count as usize).min(runs.len());
        &runs[begin..end]
    }

    /// Appends a robot; `false` when the list is full.
    pub fn push_robot(&mut self, robot: DetectedRobot) -> bool {
        push(&mut self.robots, &mut self.robot_count, robot)
    }

    /// Appends a ball candidate; `false` when the list is full.
    pub fn push_ball(&mut self, ball: DetectedBall) -> bool {
        push(&mut self.balls, &mut self.ball_count, ball)
    }

    /// Appends a rejected candidate; `false` when the list is full.
    pub fn push_rejected(&mut self, rejected: Rejected) -> bool {
        push(&mut self.rejected, &mut self.rejected_count, rejected)
    }
}
