//! Robots whose patches have hardly a pixel of their own colour: out of focus, or moving while the shutter
//! is open. Pictures are painted by these tests, blurred with an ideal kernel, and classified by the
//! configured boxes; the raw picture is their mosaic.

mod support;

use bytemuck::Zeroable;
use config::Config;
use messages::{DetectionFrame, RejectReason, Run, RunsHeader, Team};
use support::*;
use touchline_tracker::Tracker;

use Team::{Blue, Yellow};

/// Colour of pitch and bodies.
const GROUND: [f64; 3] = [44.0, 46.0, 45.0];
const BODY: [f64; 3] = [22.0, 22.0, 23.0];

type Pixels = Vec<[f64; 3]>;

/// All robots of the default configuration, far from each other.
fn robots() -> Vec<Robot> {
    (0..5)
        .flat_map(|id| {
            let x = f64::from(id) * 380.0 - 780.0;
            let heading = f64::from(id) * 67.0;
            [
                robot(Yellow, id, x, 310.0, heading),
                robot(Blue, id, x + 60.0, -290.0, heading + 40.0),
            ]
        })
        .collect()
}

fn painted(config: &Config, robots: &[Robot]) -> Pixels {
    let mut picture = Picture::new(config);
    // A class of its own for what of a body no patch covers.
    let body = config.colors.len() as u8;
    for robot in robots {
        let mut classes = picture.classes_of(robot);
        classes.push(Some(body));
        picture.paint_top(&robot.pose, &classes);
    }
    let color = |class: &Option<u8>| match class {
        None => GROUND,
        Some(class) => config
            .colors
            .get(usize::from(*class))
            .map_or(BODY, |color| color.looks.map(|value| 0.9 * f64::from(value))),
    };
    picture.labels.iter().map(color).collect()
}

/// The mean of a picture shifted by each of these offsets, weighted.
fn shifted(config: &Config, pixels: &[[f64; 3]], offsets: &[(f64, f64, f64)]) -> Pixels {
    let (width, height) = (config.camera.width as i64, config.camera.height as i64);
    let at =
        |x: i64, y: i64| pixels[(y.clamp(0, height - 1) * width + x.clamp(0, width - 1)) as usize];
    let total: f64 = offsets.iter().map(|offset| offset.2).sum();
    (0..width * height)
        .map(|index| {
            let (x, y) = (index % width, index / width);
            let mut sum = [0.0; 3];
            for &(dx, dy, weight) in offsets {
                let (left, top) = (dx.floor(), dy.floor());
                let (right, below) = (dx - left, dy - top);
                for (across, part_x) in [(0, 1.0 - right), (1, right)] {
                    for (down, part_y) in [(0, 1.0 - below), (1, below)] {
                        let there = at(x + left as i64 + across, y + top as i64 + down);
                        let part = weight * part_x * part_y / total;
                        sum.iter_mut().zip(there).for_each(|(sum, level)| *sum += part * level);
                    }
                }
            }
            sum
        })
        .collect()
}

fn moved(config: &Config, pixels: &[[f64; 3]], way_px: f64, degrees: f64) -> Pixels {
    const PLACES: i32 = 21;
    let (sin, cos) = degrees.to_radians().sin_cos();
    let offsets: Vec<(f64, f64, f64)> = (0..PLACES)
        .map(|place| ((f64::from(place) + 0.5) / f64::from(PLACES) - 0.5) * way_px)
        .map(|way| (way * cos, way * sin, 1.0))
        .collect();
    shifted(config, pixels, &offsets)
}

fn defocused(config: &Config, pixels: &[[f64; 3]], sigma_px: f64) -> Pixels {
    let reach = (3.0 * sigma_px).ceil() as i32;
    let line = |along: fn(f64) -> (f64, f64)| -> Vec<(f64, f64, f64)> {
        (-reach..=reach)
            .map(f64::from)
            .map(|offset| {
                let (x, y) = along(offset);
                (x, y, (-offset * offset / (2.0 * sigma_px * sigma_px)).exp())
            })
            .collect()
    };
    let across = shifted(config, pixels, &line(|offset| (offset, 0.0)));
    shifted(config, &across, &line(|offset| (0.0, offset)))
}

/// Runs and raw picture of a picture with this much noise, 1σ.
fn taken(config: &Config, pixels: &[[f64; 3]], noise: f64) -> (RunsHeader, Vec<Run>, Vec<u8>) {
    let width = config.camera.width as usize;
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut random = move || {
        // About normal: the sum of four even ones, of variance 1/12 each.
        let sum: f64 = (0..4)
            .map(|_| {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
            })
            .sum();
        noise * sum * 3f64.sqrt()
    };
    let noisy: Vec<[u8; 3]> = pixels
        .iter()
        .map(|levels| levels.map(|level| (level + random()).round().clamp(0.0, 255.0) as u8))
        .collect();
    let class_of = |pixel: &[u8; 3]| {
        config.colors.iter().position(|color| {
            [color.red, color.green, color.blue]
                .iter()
                .zip(pixel)
                .all(|(range, value)| (range[0]..=range[1]).contains(value))
        })
    };
    let mut picture = Picture::new(config);
    picture.labels = noisy.iter().map(|pixel| class_of(pixel).map(|class| class as u8)).collect();
    let runs: Vec<Run> = picture.runs();
    let raw: Vec<u8> = noisy
        .iter()
        .enumerate()
        .map(|(index, pixel)| {
            pixel[config.camera.bayer_order.channel_at(index % width, index / width)]
        })
        .collect();
    let header = RunsHeader {
        frame: config.camera.frame_header(),
        run_count: runs.len() as u32,
        ..RunsHeader::default()
    };
    (header, runs, raw)
}

/// The tracker's detections in a picture by itself with this much noise, 1σ.
fn seen(config: &Config, pixels: &[[f64; 3]], noise: f64) -> Box<DetectionFrame> {
    let (header, runs, raw) = taken(config, pixels, noise);
    let mut out = Box::new(DetectionFrame::zeroed());
    Tracker::new(config).unwrap().look_at(&header, &runs, Some(&raw), &mut out);
    out
}

/// How many robots of a frame are found within these errors; none may have another's name.
fn found(frame: &DetectionFrame, robots: &[Robot], within_mm: f64, within_deg: f64) -> usize {
    let mut found = 0;
    for seen in frame.robots() {
        let is_it =
            |robot: &&Robot| (robot.team as u32, robot.id.into()) == (seen.team, seen.robot_id);
        let robot = robots.iter().find(is_it).unwrap_or_else(|| panic!("nobody is {seen:?}"));
        let off = (f64::from(seen.x_mm) - robot.pose.position.x_mm)
            .hypot(f64::from(seen.y_mm) - robot.pose.position.y_mm);
        assert!(off < 30.0, "{:?} {} is taken for another, {off} mm off", robot.team, robot.id);
        let turned = geometry::wrap_angle(f64::from(seen.orientation) - robot.pose.orientation);
        found += usize::from(off <= within_mm && turned.abs().to_degrees() <= within_deg);
    }
    found
}

#[test]
fn robots_that_move_by_more_than_a_patch_keep_their_names() {
    let (config, robots) = (Config::default(), robots());
    let sharp = painted(&config, &robots);
    let mut count = 0;
    for degrees in [0.0, 55.0, 90.0, 140.0] {
        let frame = seen(&config, &moved(&config, &sharp, 11.0, degrees), 2.0);
        count += found(&frame, &robots, 6.0, 12.0);
    }
    assert!(count >= 39, "{count} of 40");
}

#[test]
fn robots_out_of_focus_keep_their_names() {
    let (config, robots) = (Config::default(), robots());
    let sharp = painted(&config, &robots);
    let frame = seen(&config, &defocused(&config, &sharp, 2.5), 2.0);
    assert_eq!(found(&frame, &robots, 6.0, 12.0), 10);
}

#[test]
fn robots_with_a_patch_of_no_listed_robot_get_no_name() {
    let (config, robots) = (Config::default(), robots());
    let mut known = config.clone();
    // Yellow 3 and blue 1 are not listed.
    known.robots.identities.retain(|identity| {
        (identity.team, identity.id) != (Yellow, 3) && (identity.team, identity.id) != (Blue, 1)
    });
    let sharp = painted(&config, &robots);
    let others: Vec<Robot> = robots
        .iter()
        .copied()
        .filter(|robot| {
            (robot.team, robot.id) != (Yellow, 3) && (robot.team, robot.id) != (Blue, 1)
        })
        .collect();
    for blurred in [moved(&config, &sharp, 11.0, 20.0), defocused(&config, &sharp, 2.5)] {
        let frame = seen(&known, &blurred, 2.0);
        assert_eq!(frame.robots().len(), found(&frame, &others, 30.0, 180.0));
        // Both are told of with a place.
        for robot in robots.iter().filter(|robot| !others.contains(robot)) {
            let camera = geometry::CameraModel::new(
                &config.geometry,
                config.camera.width,
                config.camera.height,
            )
            .unwrap();
            let place = camera.image_from_field(robot.pose.position, config.robots.height_mm);
            assert!(frame.rejected().iter().any(|rejected| {
                let (dx, dy) =
                    (f64::from(rejected.x_px) - place.x_px, f64::from(rejected.y_px) - place.y_px);
                rejected.team == robot.team as u32 && dx.hypot(dy) < 15.0
            }));
        }
    }
}

/// At a high rate no frame has time to search for all robots of a blurred picture, but every few frames each is
/// found. What a frame finds follows from its number, and it says that it did not look everywhere.
#[test]
fn frames_of_a_match_take_turns_with_blurred_robots() {
    const FRAMES: u64 = 24;
    let (mut config, robots) = (Config::default(), robots());
    config.camera.fps = 400.0;
    let sharp = painted(&config, &robots);
    let blurred = moved(&config, &defocused(&config, &sharp, 2.5), 9.0, 30.0);
    let (mut header, runs, raw) = taken(&config, &blurred, 2.0);
    let mut tracker = Tracker::new(&config).unwrap();
    let mut step = |seq: u64| {
        header.frame.seq = seq;
        let mut out = Box::new(DetectionFrame::zeroed());
        tracker.step(&header, &runs, Some(&raw), None, &mut out);
        out
    };
    let mut times_found = std::collections::BTreeMap::new();
    for seq in 1000..1000 + FRAMES {
        let frame = step(seq);
        found(&frame, &robots, 6.0, 12.0);
        for robot in frame.robots() {
            *times_found.entry((robot.team, robot.robot_id)).or_insert(0u64) += 1;
        }
        let missing = robots.len() - frame.robots().len();
        let not_looked_at = RejectReason::NotLookedAt as u32;
        let said = frame.rejected().iter().filter(|it| it.reason == not_looked_at).count();
        assert!(said >= missing, "frame {seq}: {missing} missing, {said} said");
        assert_eq!(frame.flags & DetectionFrame::SEARCH_CUT != 0, missing > 0, "frame {seq}");
    }
    assert_eq!(times_found.len(), robots.len(), "{times_found:?}");
    assert!(times_found.values().any(|&times| times < FRAMES), "no frame was short of time");
    assert!(times_found.values().all(|&times| times >= 2), "{times_found:?}");
    // In any order and by any tracker, a frame gives the same.
    let robots_of = |frame: Box<DetectionFrame>| frame.robots().to_vec();
    let before: Vec<_> = (1000..1006).map(|seq| robots_of(step(seq))).collect();
    let again: Vec<_> = (1000..1006).rev().map(|seq| robots_of(step(seq))).collect();
    assert!(before.iter().eq(again.iter().rev()));
}

/// At the usual rate a frame of a match finds as much as the same picture by itself.
#[test]
fn at_the_usual_rate_every_frame_finds_all_blurred_robots() {
    let (config, robots) = (Config::default(), robots());
    let sharp = painted(&config, &robots);
    let blurred = moved(&config, &defocused(&config, &sharp, 2.5), 9.0, 30.0);
    let (mut header, runs, raw) = taken(&config, &blurred, 2.0);
    let mut tracker = Tracker::new(&config).unwrap();
    let mut out = Box::new(DetectionFrame::zeroed());
    tracker.look_at(&header, &runs, Some(&raw), &mut out);
    let alone = out.robots().to_vec();
    assert_eq!(alone.len(), robots.len());
    for seq in 0..10 {
        header.frame.seq = seq;
        tracker.step(&header, &runs, Some(&raw), None, &mut out);
        assert_eq!(out.robots(), alone, "frame {seq}");
    }
}
