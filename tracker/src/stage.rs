//! The pure tracker: from the runs of a frame to its detections.

use crate::ball::BallFinder;
use crate::faint::FaintRobots;
use crate::faint::turns::Extent;
use crate::pairing::prior::Prior;
use crate::pairing::{Pairing, Scene};
use crate::pattern::Pattern;
use crate::pitch::Pitch;
use crate::raw::RawFrame;
use crate::reasons::{Rejections, explain};
use crate::refine::Refiner;
use crate::regions::RegionFinder;
use crate::unknown::UnknownRobots;
use config::Config;
use geometry::CameraModel;
use messages::{DetectedRobot, DetectionFrame, MAX_RUNS, Run, RunsHeader, WorldFrame};

pub use crate::error::TrackerError;

/// Finds regions, robots and balls in one frame after another. Only allocations are kept between frames: the
/// same input gives the same output, whatever came before.
#[derive(Debug)]
pub struct Tracker {
    camera: CameraModel,
    pitch: Pitch,
    pattern: Pattern,
    region_finder: RegionFinder,
    prior: Prior,
    pairing: Pairing,
    faint: FaintRobots,
    /// Most poses of faint robots that a frame of a match has time to try.
    frame_trials: u32,
    /// Whether unidentified robots are reported.
    report_unknown: bool,
    unknown: UnknownRobots,
    ball_finder: BallFinder,
    refiner: Refiner,
    rejections: Rejections,
    /// Configured width and height of the pictures.
    size: (u32, u32),
}

impl Tracker {
    /// A tracker for the configured camera, colours, robots and ball.
    pub fn new(config: &Config) -> Result<Self, TrackerError> {
        let (width, height) = (config.camera.width, config.camera.height);
        let pattern = Pattern::new(config)?;
        let camera = CameraModel::new(&config.geometry, width, height)?;
        let pitch = Pitch::new(config);
        Ok(Self {
            region_finder: RegionFinder::new(
                width,
                height,
                config.colors.len() as u32,
                config.tracker.min_region_px,
            ),
            prior: Prior::default(),
            pairing: Pairing::new(&pattern, &camera, &pitch),
            pitch,
            faint: FaintRobots::new(config, &pattern),
            frame_trials: Extent::frame_trials(config.camera.fps),
            report_unknown: config.robots.report_unknown,
            unknown: UnknownRobots::default(),
            ball_finder: BallFinder::new(config, pattern.limits)?,
            refiner: Refiner::new(config, &pattern, &camera),
            rejections: Rejections::default(),
            size: (width, height),
            camera,
            pattern,
        })
    }

    /// Works on one frame. `runs` is the valid part of the payload of `header`, `pixels` the bytes of the raw
    /// frame if they are available, and `prior` the newest `world`. Everything in `out` is replaced, except
    /// that arrays keep stale elements behind their counts; `t_runs_taken_ns` and `t_sent_ns` are left 0 for
    /// the sender.
    ///
    /// Invalid runs are skipped (see [`RegionFinder::find`]), and runs beyond [`MAX_RUNS`] are cut off
    /// ([`DetectionFrame::INPUT_OVERFLOW`]). Limits on all lists and searches bound the time that any input
    /// takes ([`DetectionFrame::SEARCH_CUT`]). The search for blurred robots, the longest of all, goes on in
    /// the next frames where a frame has no time for all of it: which part a frame searches follows from its
    /// number. [`look_at`](Self::look_at) searches a picture as a whole.
    ///
    /// With the raw frame, robots and balls are measured by their edges; without it, or where too few edges
    /// are visible, by their classified pixels ([`DetectionFrame::FRAME_USED`],
    /// [`DetectedRobot::edge_samples`](messages::DetectedRobot::edge_samples)). The robots that are
    /// found by classified pixels, and their numbers, do not depend on the raw frame; blurred robots are
    /// found only with it.
    ///
    /// `prior` decides between equally good explanations, and edge fits begin at its poses, which changes a
    /// pose by less than its sigma. It is ignored if it is not from before the frame.
    pub fn step(
        &mut self,
        header: &RunsHeader,
        runs: &[Run],
        pixels: Option<&[u8]>,
        prior: Option<&WorldFrame>,
        out: &mut DetectionFrame,
    ) {
        let extent = Extent::Frame { number: header.frame.seq, trials: self.frame_trials };
        self.search(header, runs, pixels, prior, extent, out);
    }

    /// Works on a picture that no other follows: as [`step`](Self::step), but everything is searched, however
    /// long that takes (some ten milliseconds).
    pub fn look_at(
        &mut self,
        header: &RunsHeader,
        runs: &[Run],
        pixels: Option<&[u8]>,
        out: &mut DetectionFrame,
    ) {
        self.search(header, runs, pixels, None, Extent::Picture, out);
    }

    fn search(
        &mut self,
        header: &RunsHeader,
        runs: &[Run],
        pixels: Option<&[u8]>,
        prior: Option<&WorldFrame>,
        extent: Extent,
        out: &mut DetectionFrame,
    ) {
        out.clear();
        out.frame = header.frame;
        out.t_frame_taken_ns = header.t_frame_taken_ns;
        out.t_runs_ns = header.t_sent_ns;
        out.t_runs_taken_ns = 0;
        out.t_sent_ns = 0;
        out.class_table_version = header.class_table_version;
        out.classifier_revision = header.revision;
        out.revision = 0;
        out.prior_world_seq = self.prior.update(&self.pattern, prior, &header.frame);
        if header.flags & RunsHeader::OVERFLOW != 0 || runs.len() > MAX_RUNS {
            out.flags |= DetectionFrame::INPUT_OVERFLOW;
        }

        let (width, height) = self.size;
        let frame = pixels.and_then(|pixels| RawFrame::new(&header.frame, pixels, width, height));
        if frame.is_some() {
            out.flags |= DetectionFrame::FRAME_USED;
        }

        self.region_finder.find(runs, out);
        let scene = Scene {
            pattern: &self.pattern,
            camera: &self.camera,
            pitch: &self.pitch,
            prior: &self.prior,
        };
        self.pairing.find(&scene, out);
        let expected = |robot: &DetectedRobot| {
            let number = robot.robot_id.number();
            let identity = number.and_then(|id| self.pattern.identity_of(robot.team, id));
            let top = identity.map_or(0, |identity| self.pattern.identities[identity].top);
            (top, identity.and_then(|identity| self.prior.pose(identity)).copied())
        };
        self.refiner.refine_robots(&self.camera, frame.as_ref(), expected, out);
        self.faint.clear();
        if let Some(frame) = &frame {
            self.faint.find(&scene, &self.pairing, frame, extent, out);
        }
        self.unknown.clear();
        if self.report_unknown {
            self.unknown.find(&scene, &self.pairing, &self.faint, out);
        }
        self.rejections.clear();
        let (pattern, pairing, rejections) = (&self.pattern, &self.pairing, &mut self.rejections);
        explain(pattern, pairing, &self.faint, &self.unknown, rejections);
        self.ball_finder.find(&self.pattern, &self.camera, &self.pitch, out, &mut self.rejections);
        let visible = self.ball_finder.visible();
        self.refiner.refine_balls(&self.camera, frame.as_ref(), visible, out);
        self.rejections.write(out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use geometry::{FieldPoint, Pose};
    use proptest::prelude::*;

    /// Paints a rectangle, given by its middle, into class labels.
    fn paint(labels: &mut [Option<u8>], class: u8, [x, y]: [f64; 2], [wide, high]: [u8; 2]) {
        let span = |middle: f64, length: u8, limit: f64| {
            let first = middle - f64::from(length) / 2.0;
            first.clamp(0.0, limit) as usize..(first + f64::from(length)).clamp(0.0, limit) as usize
        };
        for row in span(y, high, 480.0) {
            labels[row * 640..][span(x, wide, 640.0)].fill(Some(class));
        }
    }

    fn runs_of(labels: &[Option<u8>]) -> Vec<Run> {
        let mut runs = Vec::new();
        for (row, line) in (0u16..).zip(labels.chunks(640)) {
            let mut begin = 0u16;
            for stretch in line.chunk_by(|a, b| a == b) {
                let end = begin + stretch.len() as u16;
                if let Some(class) = stretch[0] {
                    runs.push(Run { row, begin, end, class, reserved: 0 });
                }
                begin = end;
            }
        }
        runs
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

        /// Regions in identification colours that are not measured, far from every team patch, would have
        /// changed nothing.
        #[test]
        fn regions_far_from_team_patches_do_not_matter(
            robots in prop::collection::vec(
                (0..10usize, -1000.0..1000.0f64, -800.0..800.0f64, -3.1..3.1f64),
                0..8,
            ),
            specks in prop::collection::vec(
                (0..8u8, 0.0..640.0f64, 0.0..480.0f64, prop::array::uniform2(1..9u8)),
                0..150,
            ),
        ) {
            let config = Config::default();
            let mut tracker = Tracker::new(&config).unwrap();
            let mut labels = vec![None; 640 * 480];
            for (identity, x, y, orientation) in robots {
                let pose = Pose { position: FieldPoint::new(x, y), orientation };
                let identity = &tracker.pattern.identities[identity];
                let top = &tracker.pattern.tops[identity.top];
                for (patch, &kind) in top.patches.iter().zip(&identity.kinds) {
                    let place = pose.field_from_robot(patch.centroid_mm);
                    let place = tracker.camera.image_from_field(place, top.height_mm);
                    let class = tracker.pattern.kinds[kind].class as u8;
                    paint(&mut labels, class, [place.x_px, place.y_px], [8, 8]);
                }
            }
            for (class, x, y, size) in specks {
                paint(&mut labels, class, [x, y], size);
            }
            let runs = runs_of(&labels);
            let header = RunsHeader { run_count: runs.len() as u32, ..RunsHeader::default() };
            let mut seen = [0; 2].map(|_| Box::new(DetectionFrame::zeroed()));
            tracker.step(&header, &runs, None, None, &mut seen[0]);
            // Measures everything.
            tracker.pairing = Pairing::default();
            tracker.step(&header, &runs, None, None, &mut seen[1]);
            let [some, all] = seen;
            prop_assert_eq!(some.robots(), all.robots());
            prop_assert_eq!(some.rejected(), all.rejected());
            prop_assert_eq!(some.flags, all.flags);
        }
    }
}
