//! Prior: the poses at which the filter expects the robots. It decides between equally good explanations, and
//! edge fits begin there.

use crate::pattern::Pattern;
use geometry::{FieldPoint, Pose};
use messages::{DetectionFrame, FrameHeader, RobotState, TrackStatus, WorldFrame};

/// Largest age of a `world` that is used.
const MAX_AGE_NS: u64 = 500_000_000;
/// Cost of a robot at its size's distance from the expected place. Small against the cost of patches that do
/// not fit (1 for each at its limits).
const PRIOR_WEIGHT: f64 = 0.25;

/// Expected poses of the robots of a pattern.
#[derive(Debug, Clone, Default)]
pub(crate) struct Prior {
    poses: Vec<Option<Pose>>,
}

impl Prior {
    /// Takes over the tracks of `world`, predicted to the time of `frame`. Returns the frame number of the
    /// `world`, or [`DetectionFrame::NO_WORLD`] if there is none, or it is not from before the frame or too
    /// old.
    pub fn update(
        &mut self,
        pattern: &Pattern,
        world: Option<&WorldFrame>,
        frame: &FrameHeader,
    ) -> u64 {
        self.poses.clear();
        self.poses.resize(pattern.identities.len(), None);
        let Some(world) = world else { return DetectionFrame::NO_WORLD };
        let age_ns = match frame.t_capture_ns.checked_sub(world.frame.t_capture_ns) {
            Some(age_ns) if age_ns <= MAX_AGE_NS && world.frame.seq < frame.seq => age_ns,
            _ => return DetectionFrame::NO_WORLD,
        };
        for robot in world.robots() {
            let identity = pattern.identity_of(robot.team, robot.robot_id);
            if let Some(identity) = identity {
                self.poses[identity] = expected_pose(robot, age_ns as f64 * 1e-9);
            }
        }
        world.frame.seq
    }

    /// Expected pose of a robot; `None` if it has no track.
    pub fn pose(&self, identity: usize) -> Option<&Pose> {
        self.poses.get(identity)?.as_ref()
    }

    /// Cost of a robot at a place: 0 where it is expected, growing with the squared distance up to a robot's
    /// size, half of the greatest cost for a robot without a track.
    pub fn cost(&self, identity: usize, place: FieldPoint, robot_size_mm: f64) -> f64 {
        match self.poses.get(identity).copied().flatten() {
            Some(Pose { position, .. }) => {
                PRIOR_WEIGHT * (position.distance(place) / robot_size_mm).powi(2).min(1.0)
            }
            None => PRIOR_WEIGHT / 2.0,
        }
    }
}

fn expected_pose(robot: &RobotState, age_s: f64) -> Option<Pose> {
    match TrackStatus::from_number(robot.status) {
        None | Some(TrackStatus::Absent) => return None,
        Some(_) => {}
    }
    // Along the arc that speed and turning rate describe, by its middle heading.
    let turn = robot.omega * age_s;
    let (sin, cos) = (robot.orientation + turn / 2.0).sin_cos();
    let way = robot.v_mm_s * age_s;
    let position = FieldPoint::new(robot.x_mm + way * cos, robot.y_mm + way * sin);
    let pose = Pose { position, orientation: robot.orientation + turn };
    let is_finite = [position.x_mm, position.y_mm, pose.orientation].iter().all(|v| v.is_finite());
    is_finite.then_some(pose)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use config::Config;
    use messages::Team;

    fn world() -> Box<WorldFrame> {
        let mut world = Box::new(WorldFrame::zeroed());
        world.frame.seq = 7;
        world.frame.t_capture_ns = 1_000_000_000;
        world.robot_count = 2;
        world.robots[0] = RobotState {
            team: Team::Blue as u32,
            robot_id: 1,
            status: TrackStatus::Measured as u32,
            x_mm: 100.0,
            v_mm_s: 1000.0,
            ..RobotState::zeroed()
        };
        world.robots[1] = RobotState {
            team: Team::Yellow as u32,
            robot_id: 2,
            status: TrackStatus::Measured as u32,
            x_mm: f64::NAN,
            ..RobotState::zeroed()
        };
        world
    }

    fn frame(seq: u64, t_capture_ns: u64) -> FrameHeader {
        FrameHeader { seq, t_capture_ns, ..FrameHeader::zeroed() }
    }

    #[test]
    fn tracks_are_carried_forward() {
        let pattern = Pattern::new(&Config::default()).unwrap();
        let mut prior = Prior::default();
        let used = prior.update(&pattern, Some(&world()), &frame(8, 1_012_500_000));
        assert_eq!(used, 7);
        let blue_1 = pattern.identities.iter().position(|i| (i.team, i.id) == (Team::Blue, 1));
        let cost = |identity, x| prior.cost(identity, FieldPoint::new(x, 0.0), 75.0);
        assert!(cost(blue_1.unwrap(), 112.5) < 1e-12);
        assert!(cost(blue_1.unwrap(), 100.0) > 0.001);
        assert_eq!(cost(blue_1.unwrap(), 5000.0), PRIOR_WEIGHT);
        // A track of rubbish counts as none.
        let yellow_2 = pattern.identities.iter().position(|i| (i.team, i.id) == (Team::Yellow, 2));
        assert_eq!(cost(yellow_2.unwrap(), 112.5), PRIOR_WEIGHT / 2.0);
    }

    #[test]
    fn a_world_that_does_not_precede_the_frame_is_not_used() {
        let pattern = Pattern::new(&Config::default()).unwrap();
        let mut prior = Prior::default();
        for frame in [frame(8, 999_999_999), frame(7, 1_012_500_000), frame(90, 2_000_000_000)] {
            let used = prior.update(&pattern, Some(&world()), &frame);
            assert_eq!(used, DetectionFrame::NO_WORLD, "{frame:?}");
        }
        assert_eq!(prior.update(&pattern, None, &frame(8, 1)), DetectionFrame::NO_WORLD);
    }
}
