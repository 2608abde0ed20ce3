//! The stage graph of a group.
//!
//! A *lane* is one camera with its grabber, classifier and tracker. A group has one lane for each of its cameras,
//! and one filter that reads the detections of all lanes:
//!
//! ```text
//! grabber ──→ classifier ──→ tracker ──┐
//!                                      ├──→ filter
//! grabber@1 → classifier@1 → tracker@1 ┘
//! ```
//!
//! Frame numbers rise within a lane and say nothing about other lanes, so a number always comes with its lane:
//! [`FrameId`] names one frame, [`Numbers`] hold the newest number of each lane.

use crate::ProcessKind;
use std::fmt;
use std::ops::{Index, IndexMut};
use std::str::FromStr;

/// Largest number of lanes in a group.
pub const MAX_LANES: usize = 8;
/// Position of the lane in a stage's number in messages.
const LANE_SHIFT: u32 = 16;
/// Separator between the name of a stage or topic and its lane.
pub const LANE_MARK: char = '@';

/// A stage of a group. Ordered along the path of a frame, lane by lane, with the filter last.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct StageId {
    kind: ProcessKind,
    lane: u8,
}

impl StageId {
    /// The filter, which belongs to no lane.
    pub const FILTER: Self = Self { kind: ProcessKind::Filter, lane: 0 };

    /// The stage of this kind in a lane, counted from 0. The filter is the same one for all lanes.
    pub const fn new(kind: ProcessKind, lane: u8) -> Self {
        match kind {
            ProcessKind::Filter => Self::FILTER,
            _ => Self { kind, lane },
        }
    }

    /// Kind of the stage's processes.
    pub const fn kind(self) -> ProcessKind {
        self.kind
    }

    /// Lane of the stage; 0 for the filter.
    pub const fn lane(self) -> u8 {
        self.lane
    }

    /// Whether the stage processes frames of this lane.
    pub fn serves(self, lane: u8) -> bool {
        self == Self::FILTER || self.lane == lane
    }

    /// Whether it is a grabber, which reads no other stage's output.
    pub fn is_grabber(self) -> bool {
        self.kind == ProcessKind::Grabber
    }

    /// Number of the stage in messages. In lane 0 it equals the number of its kind.
    pub const fn number(self) -> u32 {
        self.kind as u32 | (self.lane as u32) << LANE_SHIFT
    }

    /// The stage with this number in a message, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        let kind = ProcessKind::from_number(number & ((1 << LANE_SHIFT) - 1))?;
        let lane = u8::try_from(number >> LANE_SHIFT).ok().filter(|&lane| is_lane(lane))?;
        let id = Self::new(kind, lane);
        (id.lane == lane).then_some(id)
    }

    /// The stage of this name, if there is one.
    pub fn from_name(name: &str) -> Option<Self> {
        let (kind, lane) = match name.split_once(LANE_MARK) {
            None => (name, 0),
            // Each stage has one name only: neither `grabber@0` nor `grabber@01` is accepted.
            Some((_, lane)) if lane.starts_with('0') => return None,
            Some((kind, lane)) => (kind, lane.parse().ok().filter(|&lane| is_lane(lane))?),
        };
        let id = Self::new(ProcessKind::from_name(kind)?, lane);
        (id.lane == lane).then_some(id)
    }

    fn rank(self) -> (bool, u8, ProcessKind) {
        (self == Self::FILTER, self.lane, self.kind)
    }
}

fn is_lane(lane: u8) -> bool {
    usize::from(lane) < MAX_LANES
}

impl From<ProcessKind> for StageId {
    /// The stage of this kind in a group with one camera.
    fn from(kind: ProcessKind) -> Self {
        Self::new(kind, 0)
    }
}

impl PartialOrd for StageId {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for StageId {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.rank().cmp(&other.rank())
    }
}

/// `tracker` in lane 0, `tracker@1` in lane 1: the name in processes, files and reports.
impl fmt::Display for StageId {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(&match self.lane {
            0 => self.kind.name().into(),
            lane => format!("{}{LANE_MARK}{lane}", self.kind.name()),
        })
    }
}

impl FromStr for StageId {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let kinds = || ProcessKind::ALL.map(ProcessKind::name).join(", ");
        Self::from_name(name).ok_or_else(|| format!("there is no stage {name:?}; use {}", kinds()))
    }
}

impl serde::Serialize for StageId {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// The stages of a group and their connections.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StageGraph {
    lanes: u8,
}

impl StageGraph {
    /// The graph of a group with one camera.
    pub const SINGLE: Self = Self { lanes: 1 };

    /// The graph of a group with this many cameras, from 1 to [`MAX_LANES`].
    pub const fn with_lanes(lanes: usize) -> Self {
        assert!(lanes >= 1 && lanes <= MAX_LANES, "a group has 1 to MAX_LANES lanes");
        Self { lanes: lanes as u8 }
    }

    /// All lanes.
    pub fn lanes(self) -> impl DoubleEndedIterator<Item = u8> + Clone {
        0..self.lanes
    }

    /// All stages; each one follows the stages that it reads.
    pub fn stages(self) -> impl DoubleEndedIterator<Item = StageId> + Clone {
        let kinds = [ProcessKind::Grabber, ProcessKind::Classifier, ProcessKind::Tracker];
        let lane = move |lane| kinds.into_iter().map(move |kind| StageId::new(kind, lane));
        self.lanes().flat_map(lane).chain([StageId::FILTER])
    }

    /// Whether the group has this stage.
    pub fn has(self, stage: StageId) -> bool {
        stage.lane < self.lanes
    }

    /// The stage whose output `stage` reads in a lane. `None` for a grabber, and for a lane that the
    /// stage does not serve.
    pub fn input(self, stage: StageId, lane: u8) -> Option<StageId> {
        if !stage.serves(lane) {
            return None;
        }
        let kind = match stage.kind {
            ProcessKind::Grabber => return None,
            ProcessKind::Classifier => ProcessKind::Grabber,
            ProcessKind::Tracker => ProcessKind::Classifier,
            ProcessKind::Filter => ProcessKind::Tracker,
        };
        Some(StageId::new(kind, lane))
    }

    /// The stages that read the output of `stage`.
    pub fn readers(self, stage: StageId) -> impl Iterator<Item = StageId> {
        let reads = move |reader: &StageId| self.input(*reader, stage.lane) == Some(stage);
        self.stages().filter(reads)
    }
}

/// A value for each stage of a group.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StageMap<T> {
    graph: StageGraph,
    /// The values, in the order of [`StageGraph::stages`].
    items: Vec<T>,
}

impl<T> StageMap<T> {
    /// Creates the value of each stage with `item`.
    pub fn new(graph: StageGraph, item: impl FnMut(StageId) -> T) -> Self {
        Self { graph, items: graph.stages().map(item).collect() }
    }

    /// The stages with their values, along the path of a frame.
    pub fn iter(&self) -> impl Iterator<Item = (StageId, &T)> {
        self.graph.stages().zip(&self.items)
    }

    /// The values.
    pub fn values(&self) -> impl Iterator<Item = &T> {
        self.items.iter()
    }

    /// The values, mutable.
    pub fn values_mut(&mut self) -> impl Iterator<Item = &mut T> {
        self.items.iter_mut()
    }

    fn place(&self, stage: StageId) -> usize {
        match stage {
            StageId::FILTER => self.items.len() - 1,
            StageId { kind, lane } => usize::from(lane) * 3 + kind as usize,
        }
    }
}

impl<T: Default> StageMap<T> {
    /// A map of default values.
    pub fn of_defaults(graph: StageGraph) -> Self {
        Self::new(graph, |_| T::default())
    }
}

impl<T> Index<StageId> for StageMap<T> {
    type Output = T;

    fn index(&self, stage: StageId) -> &T {
        &self.items[self.place(stage)]
    }
}

impl<T> IndexMut<StageId> for StageMap<T> {
    fn index_mut(&mut self, stage: StageId) -> &mut T {
        let place = self.place(stage);
        &mut self.items[place]
    }
}

/// A frame of a lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct FrameId {
    /// Lane of the camera that captured the frame.
    pub lane: u8,
    /// Number of the frame in this lane.
    pub seq: u64,
}

/// The newest frame number of each lane; `None` before the first one.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Numbers([Option<u64>; MAX_LANES]);

impl Numbers {
    /// The newest number of a lane.
    pub fn of(&self, lane: u8) -> Option<u64> {
        self.0[usize::from(lane)]
    }

    /// Records a frame; returns whether it is newer than the newest one of its lane.
    pub fn raise(&mut self, frame: FrameId) -> bool {
        let newest = &mut self.0[usize::from(frame.lane)];
        let is_newer = *newest < Some(frame.seq);
        if is_newer {
            *newest = Some(frame.seq);
        }
        is_newer
    }

    /// The larger number of each lane.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self(std::array::from_fn(|lane| self.0[lane].max(other.0[lane])))
    }

    /// The lanes in which these numbers are larger than the others.
    pub fn ahead_of(&self, other: Self) -> impl Iterator<Item = u8> {
        let both = self.0.into_iter().zip(other.0);
        (0..).zip(both).filter(|(_, (own, other))| own > other).map(|(lane, _)| lane)
    }

    /// Whether these numbers are larger than the others in any lane.
    pub fn are_beyond(&self, other: Self) -> bool {
        self.ahead_of(other).next().is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_numbers_name_one_stage_each() {
        for stage in StageGraph::with_lanes(MAX_LANES).stages() {
            assert_eq!(StageId::from_name(&stage.to_string()), Some(stage));
            assert_eq!(StageId::from_number(stage.number()), Some(stage));
        }
        for kind in ProcessKind::ALL {
            let stage = StageId::from(kind);
            assert_eq!((stage.to_string().as_str(), stage.number()), (kind.name(), kind as u32));
        }
        for name in
            ["", "@", "grabber@", "grabber@0", "grabber@01", "grabber@8", "grabber@-1", "filter@1"]
        {
            assert_eq!(StageId::from_name(name), None, "{name}");
        }
        for number in [4, 3 | 1 << LANE_SHIFT, 8 << LANE_SHIFT, u32::MAX] {
            assert_eq!(StageId::from_number(number), None, "{number:#x}");
        }
    }

    #[test]
    fn lanes_meet_in_the_filter_and_nowhere_else() {
        let graph = StageGraph::with_lanes(2);
        let names = |stages: &mut dyn Iterator<Item = StageId>| -> Vec<String> {
            stages.map(|stage| stage.to_string()).collect()
        };
        let all = names(&mut graph.stages());
        let lane_by_lane = [
            "grabber",
            "classifier",
            "tracker",
            "grabber@1",
            "classifier@1",
            "tracker@1",
            "filter",
        ];
        assert_eq!(all, lane_by_lane);
        let mut sorted: Vec<StageId> = graph.stages().rev().collect();
        sorted.sort();
        assert_eq!(names(&mut sorted.into_iter()), lane_by_lane);

        let stage = |name| StageId::from_name(name).unwrap();
        assert_eq!(names(&mut graph.readers(stage("grabber@1"))), ["classifier@1"]);
        assert_eq!(names(&mut graph.readers(stage("tracker"))), ["filter"]);
        assert_eq!(names(&mut graph.readers(stage("tracker@1"))), ["filter"]);
        assert_eq!(names(&mut graph.readers(StageId::FILTER)), [""; 0]);
        for stage in graph.stages() {
            for lane in graph.lanes() {
                let input = graph.input(stage, lane);
                assert_eq!(input.is_some(), !stage.is_grabber() && stage.serves(lane));
                assert!(input.is_none_or(|input| input.lane() == lane && input < stage));
            }
        }
        assert!(
            !StageGraph::SINGLE.has(stage("tracker@1")) && StageGraph::SINGLE.has(StageId::FILTER)
        );
    }

    #[test]
    fn each_stage_has_a_place_of_its_own() {
        let mut map = StageMap::new(StageGraph::with_lanes(3), |stage| stage);
        assert!(map.iter().all(|(stage, item)| stage == *item && map[stage] == stage));
        let tracker = StageId::new(ProcessKind::Tracker, 2);
        map[tracker] = StageId::FILTER;
        assert_eq!(map.values().filter(|stage| **stage == StageId::FILTER).count(), 2);
    }

    #[test]
    fn numbers_of_lanes_are_compared_lane_by_lane() {
        let mut a = Numbers::default();
        assert!(a.raise(FrameId { lane: 1, seq: 0 }) && !a.raise(FrameId { lane: 1, seq: 0 }));
        let mut b = a;
        assert!(!a.are_beyond(b));
        b.raise(FrameId { lane: 0, seq: 7 });
        assert!(b.are_beyond(a) && !a.are_beyond(b));
        a.raise(FrameId { lane: 1, seq: 3 });
        assert!(b.are_beyond(a) && a.are_beyond(b));
        assert_eq!(a.ahead_of(b).collect::<Vec<_>>(), [1]);
        assert_eq!((a.max(b).of(0), a.max(b).of(1), a.max(b).of(2)), (Some(7), Some(3), None));
    }
}
