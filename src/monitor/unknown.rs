//! Scores robots of which only the team is known against the truth of a synthetic match.

use super::accuracy::Distribution;
use config::{Config, PatchRole};
use control::report::UnknownErrors;
use geometry::layout::Layout;
use geometry::{FieldPoint, Pose};
use messages::{TruthFrame, TruthRobot, UnknownRobotState, WorldFrame};
use std::collections::{HashMap, HashSet};

/// Largest distance at which a track still belongs to a robot's team patch.
const SAME_ROBOT_MM: f64 = 20.0;

/// Collects errors over a run.
#[derive(Debug)]
pub struct UnknownScorer {
    /// Team and number of the identifiable robots.
    named: HashSet<(u32, u32)>,
    /// Position of the team patch in a robot's frame: nothing else of these robots is seen.
    patch_mm: [f64; 2],
    expected: u64,
    followed: u64,
    ghosts: u64,
    switches: u64,
    position: Distribution,
    /// Last track of each robot.
    tracks: HashMap<(u32, u32), u32>,
}

impl UnknownScorer {
    /// Nothing scored yet.
    pub fn new(config: &Config) -> Self {
        let mut it = Self {
            named: Default::default(),
            patch_mm: [0.0; 2],
            expected: 0,
            followed: 0,
            ghosts: 0,
            switches: 0,
            position: Distribution::new(),
            tracks: HashMap::new(),
        };
        it.use_config(config);
        it
    }

    /// Goes over to another configuration; what was scored so far stays.
    pub fn use_config(&mut self, config: &Config) {
        let robots = &config.robots;
        let layout = Layout::new(robots);
        let patch = layout.patches.iter().find(|patch| patch.role == PatchRole::Team);
        self.named = robots.identities.iter().map(|it| (it.team as u32, it.id)).collect();
        self.patch_mm = patch.map_or([0.0; 2], |patch| patch.centroid_mm);
    }

    /// Truth restricted to the identifiable robots.
    pub fn named_only(&self, truth: &TruthFrame) -> TruthFrame {
        let mut named = *truth;
        named.robot_count = 0;
        for robot in truth.robots().iter().filter(|robot| self.is_named(robot)) {
            named.robots[named.robot_count as usize] = *robot;
            named.robot_count += 1;
        }
        named
    }

    /// Scores one frame.
    pub fn score(&mut self, truth: &TruthFrame, world: &WorldFrame) {
        let mut tracks: Vec<&UnknownRobotState> = world.unknown_robots().iter().collect();
        for robot in truth.robots() {
            if self.is_named(robot) {
                continue;
            }
            self.expected += u64::from(robot.visible != 0);
            let position = FieldPoint::new(robot.x_mm, robot.y_mm);
            let pose = Pose { position, orientation: robot.orientation };
            let patch = pose.field_from_robot(self.patch_mm);
            let off =
                |track: &UnknownRobotState| patch.distance(FieldPoint::new(track.x_mm, track.y_mm));
            let nearest = (0..tracks.len())
                .filter(|&index| tracks[index].team == robot.team)
                .min_by(|&a, &b| off(tracks[a]).total_cmp(&off(tracks[b])))
                .filter(|&index| off(tracks[index]) < SAME_ROBOT_MM);
            let Some(index) = nearest else { continue };
            let track = tracks.swap_remove(index);
            let before = self.tracks.insert((robot.team, robot.robot_id), track.track_id);
            self.switches += u64::from(before.is_some_and(|before| before != track.track_id));
            if robot.visible != 0 {
                self.followed += 1;
                self.position.add(off(track));
            }
        }
        self.ghosts += tracks.len() as u64;
    }

    /// The errors so far; `None` when there was no such robot.
    pub fn errors(&self) -> Option<UnknownErrors> {
        (self.expected + self.ghosts > 0).then(|| UnknownErrors {
            followed_ratio: self.followed as f64 / self.expected.max(1) as f64,
            ghosts: self.ghosts,
            switches: self.switches,
            patch_rms_mm: self.position.rms(),
            patch_p99_mm: self.position.p99(),
        })
    }

    fn is_named(&self, robot: &TruthRobot) -> bool {
        self.named.contains(&(robot.team, robot.robot_id))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use messages::Team;

    #[test]
    fn changes_of_number_and_ghosts_are_counted() {
        let mut config = Config::default();
        config.robots.identities.retain(|identity| identity.team == Team::Yellow);
        let mut scorer = UnknownScorer::new(&config);
        let mut truth = TruthFrame::zeroed();
        truth.robot_count = 3;
        for (robot, (team, robot_id)) in truth.robots.iter_mut().zip([(0, 1), (1, 0), (1, 1)]) {
            (robot.team, robot.robot_id, robot.visible) = (team, robot_id, 1);
            robot.x_mm = 500.0 * f64::from(team) * f64::from(robot_id);
        }
        assert_eq!(scorer.named_only(&truth).robots(), &truth.robots()[..1]);
        let [x, y] = scorer.patch_mm;
        let mut world: Box<WorldFrame> = bytemuck::zeroed_box();
        let mut see = |tracks: &[(u32, f64)]| {
            world.unknown_robot_count = tracks.len() as u32;
            for (state, &(track_id, x_mm)) in world.unknown_robots.iter_mut().zip(tracks) {
                (state.team, state.track_id) = (1, track_id);
                (state.x_mm, state.y_mm) = (x_mm + x, y);
            }
            scorer.score(&truth, &world);
            scorer.errors().unwrap()
        };
        assert_eq!(see(&[(1, 3.0), (2, 504.0)]).switches, 0);
        // Two tracks swapped, and a third without a robot.
        let errors = see(&[(2, 3.0), (1, 504.0), (3, -300.0)]);
        assert_eq!((errors.switches, errors.ghosts, errors.followed_ratio), (2, 1, 1.0));
        assert!((errors.patch_rms_mm - 12.5f64.sqrt()).abs() < 1e-9);
        assert_eq!(see(&[]).followed_ratio, 4.0 / 6.0);
    }
}
