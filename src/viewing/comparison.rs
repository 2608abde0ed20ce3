//! The recorded results beside those of another configuration, on the same frames.

use super::ViewingError;
use super::recorded::{At, Recorded};
use crate::console::scene::Scene;
use config::Config;
use config::snapshot::Snapshot;
use messages::{
    ClearStale, DetectedRobot, DetectionFrame, RejectReason, Rejected, Team, WorldFrame,
};
use offline::chain::Chain;
use recording::{Channel, decode_message, encode_message};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::ops::Range;

/// Most frames of a comparison: their results are kept, with up to 30 kB each.
pub const MOST_FRAMES: usize = 2400;
/// Frames before the first one that is compared, where tracks settle.
const WARM_UP: usize = 40;
/// Distance in the picture within which a rejected candidate is taken for the robot that is not found there.
const NEAR_PX: f32 = 40.0;

/// Further apart than this, the sides have found different things under the same name.
const ELSEWHERE_MM: f32 = 50.0;

/// A robot: team and number; the ball is `None`.
type Name = Option<(u32, u32)>;

/// The results of another configuration for some frames of a recording.
pub struct Comparison {
    /// What the user calls the other configuration.
    pub name: String,
    /// The other configuration, ready for drawing.
    pub scene: Scene,
    chain: Chain,
    range: Range<usize>,
    next: usize,
    has_begun: bool,
    results: BTreeMap<usize, Results>,
    tallies: BTreeMap<Name, Tally>,
    compared: usize,
    /// Frames whose recorded results are missing, and frames that cannot be read or computed.
    without_results: usize,
    failed: usize,
    fault: Option<String>,
}

/// Results for a frame, encoded, which makes them small.
struct Results {
    detections: Vec<u8>,
    world: Vec<u8>,
    /// Robots, and the ball, that one side found alone or elsewhere.
    different: u32,
}

/// A frame on one side.
struct Side<'a> {
    found: BTreeMap<Name, Place>,
    seen: &'a DetectionFrame,
}

/// Where a robot or the ball was found.
#[derive(Debug, Clone, Copy)]
struct Place {
    mm: [f32; 2],
    px: [f32; 2],
}

#[derive(Debug, Default)]
struct Tally {
    recorded: u64,
    other: u64,
    both: u64,
    /// Found by both, at different places.
    elsewhere: u64,
    /// Sum of the distances where both have found it at about the same place.
    apart_mm: f64,
    /// Why one side did not find it where the other one did, with numbers of frames.
    why_recorded: BTreeMap<&'static str, u64>,
    why_other: BTreeMap<&'static str, u64>,
}

impl Comparison {
    /// Begins a comparison on these frames.
    pub fn new(
        recorded: &Recorded,
        name: String,
        config: Config,
        range: Range<usize>,
    ) -> Result<Self, ViewingError> {
        if recorded.archive().lead() != Channel::Frames {
            return Err("this recording has no pictures, so nothing can be computed from it".into());
        }
        let last = recorded.archive().moments().len();
        let range = range.start.min(last)..range.end.min(last).min(range.start + MOST_FRAMES);
        if range.is_empty() {
            return Err("there is no frame in this time".into());
        }
        let of_recording = &recorded.configurations()[0].scene.config.camera;
        let (then, now) = (of_recording.picture_px(), config.camera.picture_px());
        if then != now {
            let text = format!(
                "the pictures have {} × {} pixels, and this configuration is for {} × {}",
                then[0], then[1], now[0], now[1]
            );
            return Err(text.into());
        }
        let scene =
            Scene::new(&Snapshot::of_user(config.clone())).ok_or("its geometry cannot be used")?;
        let robots = config.robots.identities.iter().map(|it| Some((it.team as u32, it.id)));
        let then = recorded.configurations().iter().flat_map(|it| {
            it.scene.config.robots.identities.iter().map(|it| Some((it.team as u32, it.id)))
        });
        let tallies = robots.chain(then).chain([None]).map(|name| (name, Tally::default()));
        Ok(Self {
            name,
            tallies: tallies.collect(),
            scene,
            chain: Chain::new(&config)?,
            next: range.start.saturating_sub(WARM_UP),
            range,
            has_begun: false,
            results: BTreeMap::new(),
            compared: 0,
            without_results: 0,
            failed: 0,
            fault: None,
        })
    }

    /// Whether all frames were compared.
    pub fn is_done(&self) -> bool {
        self.next >= self.range.end
    }

    /// Leaves the frames out that were not compared yet.
    pub fn stop(&mut self) {
        self.range.end = self.next.max(self.range.start);
    }

    /// Compares the next frame.
    pub fn step(&mut self, recorded: &mut Recorded) {
        let index = self.next;
        self.next += 1;
        let is_counted = self.range.contains(&index);
        let Ok(Some(at)) = recorded.at(index) else {
            self.failed += usize::from(is_counted);
            return;
        };
        if !self.has_begun {
            self.has_begun = true;
            // Both sides know as much of what came before.
            if let Some(before) = index.checked_sub(1)
                && let Ok(Some(At { world: Some(world), .. })) = recorded.at(before)
            {
                self.chain.resume(&world);
            }
        }
        let Some(frame) = &at.frame else {
            self.failed += usize::from(is_counted);
            return;
        };
        if let Err(fault) = self.chain.step(&frame.header, &frame.bytes) {
            self.failed += usize::from(is_counted);
            self.fault.get_or_insert_with(|| fault.to_string());
            return;
        }
        if is_counted {
            self.count(&at);
        }
    }

    fn count(&mut self, at: &At) {
        let other = Side::new(self.chain.detections());
        let (mut detections, mut world) = (Vec::new(), Vec::new());
        // Old elements behind the lists would make it large. It is too large itself for the stack.
        let mut seen = bytemuck::allocation::zeroed_box::<DetectionFrame>();
        bytemuck::bytes_of_mut(&mut *seen).copy_from_slice(bytemuck::bytes_of(other.seen));
        seen.clear_stale();
        encode_message(&*seen, &mut detections);
        encode_message(self.chain.world(), &mut world);
        let mut different = 0;
        match &at.detections {
            None => self.without_results += 1,
            Some(detections) => {
                self.compared += 1;
                let then = Side::new(detections);
                for (name, tally) in &mut self.tallies {
                    different += u32::from(tally.count(&then, &other, *name));
                }
            }
        }
        self.results.insert(at.index, Results { detections, world, different });
    }

    /// What was computed for a frame, in the terms of a page.
    pub fn shown(&self, index: usize) -> Option<Value> {
        let results = self.results.get(&index)?;
        let seen = decode_message::<DetectionFrame>(&results.detections)?;
        let world = decode_message::<WorldFrame>(&results.world)?;
        Some(json!({
            "detections": self.scene.detections(&seen), "world": self.scene.world(&world),
            "runs": super::runs_of(&seen),
        }))
    }

    /// How many robots one side found alone or elsewhere in a frame, the ball included.
    pub fn different(&self, index: usize) -> u32 {
        self.results.get(&index).map_or(0, |it| it.different)
    }

    /// The next frame after this one, or before it, where the sides differ.
    pub fn next_difference(&self, index: usize, is_forward: bool) -> Option<usize> {
        let differs = |(&at, it): (&usize, &Results)| (it.different > 0).then_some(at);
        match is_forward {
            true => self.results.range(index + 1..).find_map(differs),
            false => self.results.range(..index).rev().find_map(differs),
        }
    }

    /// Counts so far, robot by robot.
    pub fn report(&self, recorded: &Recorded) -> Value {
        let time_s = |index: usize| {
            let moments = recorded.archive().moments();
            moments.get(index).map(|moment| recorded.after_s(moment.t_sent_ns))
        };
        let begin = self.range.start.saturating_sub(WARM_UP);
        let most = |why: &BTreeMap<&'static str, u64>| {
            why.iter().max_by_key(|(_, count)| **count).map(|(reason, _)| *reason)
        };
        let rows = self.tallies.iter().map(|(name, tally)| {
            let team = name.and_then(|(team, _)| Team::from_number(team));
            let near = tally.both - tally.elsewhere;
            let apart_mm = (near > 0).then(|| tally.apart_mm / near as f64);
            json!({
                "team": team.map(Team::name), "identity": name.map(|(_, id)| id),
                "recorded": tally.recorded, "other": tally.other, "both": tally.both,
                "elsewhere": tally.elsewhere,
                "apart_mm": apart_mm.map(|mm| (mm * 100.0).round() / 100.0),
                "why_recorded": most(&tally.why_recorded), "why_other": most(&tally.why_other),
            })
        });
        json!({
            "name": self.name,
            "from_s": time_s(self.range.start), "to_s": time_s(self.range.end.saturating_sub(1)),
            "done": (self.next - begin) as f64 / (self.range.end - begin).max(1) as f64,
            "is_done": self.is_done(),
            "frames": self.compared, "without_results": self.without_results,
            "failed": self.failed, "fault": self.fault,
            "different": self.results.values().filter(|it| it.different > 0).count(),
            "rows": rows.collect::<Vec<_>>(),
        })
    }
}

impl<'a> Side<'a> {
    /// The named robots and the ball of a frame.
    fn new(seen: &'a DetectionFrame) -> Self {
        let robot = |it: &DetectedRobot| {
            let id = it.robot_id.number()?;
            let place = Place { mm: [it.x_mm, it.y_mm], px: [it.x_px, it.y_px] };
            Some((Some((it.team, id)), place))
        };
        let ball = seen
            .balls()
            .first()
            .map(|it| (None, Place { mm: [it.x_mm, it.y_mm], px: [it.x_px, it.y_px] }));
        Self { found: seen.robots().iter().filter_map(robot).chain(ball).collect(), seen }
    }

    /// Why nothing of this name was found at a place of the picture.
    fn why_not(&self, name: Name, at: Place) -> &'static str {
        let away = |x_px: f32, y_px: f32| (x_px - at.px[0]).hypot(y_px - at.px[1]);
        let team = name.map_or(Rejected::BALL, |(team, _)| team);
        let rejected = self.seen.rejected().iter().filter(|it| it.team == team);
        let nearest = rejected.min_by(|a, b| away(a.x_px, a.y_px).total_cmp(&away(b.x_px, b.y_px)));
        let without_name = |it: &&DetectedRobot| {
            Some(it.team) == name.map(|(team, _)| team)
                && it.robot_id.number() != name.map(|(_, id)| id)
                && away(it.x_px, it.y_px) < NEAR_PX / 2.0
        };
        if let Some(robot) = self.seen.robots().iter().find(without_name) {
            return match robot.is_identified() {
                true => "found under another name",
                false => "found without its name",
            };
        }
        match nearest.filter(|it| away(it.x_px, it.y_px) < NEAR_PX) {
            Some(it) => RejectReason::from_number(it.reason).map_or("rejected", RejectReason::text),
            None if name.is_none() => "nothing of the ball's colour there",
            None => "no team patch seen there",
        }
    }
}

impl Tally {
    /// Counts a frame; whether the sides differ.
    fn count(&mut self, then: &Side, other: &Side, name: Name) -> bool {
        let (a, b) = (then.found.get(&name), other.found.get(&name));
        self.recorded += u64::from(a.is_some());
        self.other += u64::from(b.is_some());
        match (a, b) {
            (Some(a), Some(b)) => {
                let apart_mm = (a.mm[0] - b.mm[0]).hypot(a.mm[1] - b.mm[1]);
                self.both += 1;
                if apart_mm > ELSEWHERE_MM {
                    self.elsewhere += 1;
                    return true;
                }
                self.apart_mm += f64::from(apart_mm);
            }
            (Some(&a), None) => {
                *self.why_other.entry(other.why_not(name, a)).or_default() += 1;
            }
            (None, Some(&b)) => {
                *self.why_recorded.entry(then.why_not(name, b)).or_default() += 1;
            }
            (None, None) => {}
        }
        a.is_some() != b.is_some()
    }
}
