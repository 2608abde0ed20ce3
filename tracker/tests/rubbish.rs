//! Whatever comes in, the tracker survives it, and its output makes sense.

mod support;

use bytemuck::Zeroable;
use config::Config;
use messages::{
    DetectionFrame, MAX_REGIONS, MAX_RUNS, RejectReason, Run, RunsHeader, Team, WorldFrame,
};
use proptest::prelude::*;
use support::*;
use touchline_tracker::Tracker;

fn check(frame: &DetectionFrame) {
    for robot in frame.robots() {
        assert!(Team::from_number(robot.team).is_some());
        let numbers = [robot.x_mm, robot.y_mm, robot.orientation, robot.x_px, robot.y_px];
        assert!(numbers.iter().all(|number| number.is_finite()), "{robot:?}");
        assert!((0.0..=1.0).contains(&robot.confidence));
        for &region in &robot.patch_regions[..robot.patch_count as usize] {
            assert!(region == u32::MAX || (region as usize) < frame.regions().len());
        }
    }
    let names = names(frame);
    assert!(names.is_sorted());
    assert!(names.windows(2).all(|pair| pair[0] != pair[1]), "{names:?}");
    for ball in frame.balls() {
        assert!((0.0..=1.0).contains(&ball.confidence), "{ball:?}");
        assert!(ball.x_mm.is_finite() && ball.y_mm.is_finite());
    }
    assert!(frame.balls().is_sorted_by(|a, b| a.confidence >= b.confidence));
    for rejected in frame.rejected() {
        assert!(RejectReason::from_number(rejected.reason).is_some());
    }
}

/// Blocks of random classes and sizes: regions by the hundred, many as large as a patch.
fn blocks(seed: u64, count: usize, most: u64) -> Picture {
    let mut picture = Picture::new(&Config::default());
    let mut state = seed.wrapping_mul(2).wrapping_add(1);
    let mut draw = |below: u64| {
        // The high bits of a linear congruential generator (Knuth's MMIX) are random enough.
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) % below
    };
    for _ in 0..count {
        let (left, top) = (draw(640) as usize, draw(480) as usize);
        let (width, height) = (1 + draw(most) as usize, 1 + draw(most) as usize);
        let class = draw(9) as u8;
        let class = (class < 8).then_some(class);
        for row in top..(top + height).min(480) {
            picture.labels[row * 640 + left..row * 640 + (left + width).min(640)].fill(class);
        }
    }
    picture
}

#[test]
fn pictures_full_of_patches_are_survived() {
    for seed in 0..6 {
        for (count, most) in [(500, 14), (4000, 10), (3000, 20), (300, 60)] {
            let frame = blocks(seed, count, most).detections();
            check(&frame);
            assert!(!frame.regions().is_empty());
        }
    }
}

#[test]
fn a_picture_of_noise_overflows_and_is_survived() {
    let mut picture = blocks(1, 200_000, 1);
    for (index, label) in picture.labels.iter_mut().enumerate() {
        *label = Some((index as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(20) as u8 % 8);
    }
    let runs = picture.runs();
    assert!(runs.len() > MAX_RUNS);
    let mut config = Config::default();
    config.tracker.min_region_px = 1;
    let frame = detections(&config, &runs, None);
    check(&frame);
    assert_eq!(frame.flags, DetectionFrame::INPUT_OVERFLOW | DetectionFrame::REGIONS_OVERFLOW);
    assert_eq!(frame.regions().len(), MAX_REGIONS);
}

#[test]
fn a_tight_grid_of_patches_is_survived() {
    // Everything in reach of everything.
    let mut picture = Picture::new(&Config::default());
    for row in 0..480 {
        for column in 0..640 {
            if row % 8 < 7 && column % 8 < 7 {
                let class = 1 + (row / 8 * 3 + column / 8 * 5) % 7;
                picture.labels[row * 640 + column] = Some(class as u8);
            }
        }
    }
    let frame = picture.detections();
    check(&frame);
    assert!(frame.robots().len() > 4, "{:?}", names(&frame));
}

#[test]
fn one_color_all_over_is_survived() {
    for class in 0..8 {
        let mut picture = Picture::new(&Config::default());
        picture.labels.fill(Some(class));
        let frame = picture.detections();
        check(&frame);
        assert!(frame.robots().is_empty() && frame.balls().is_empty());
    }
}

#[test]
fn a_tracker_remembers_nothing() {
    let config = Config::default();
    let robots = [robot(Team::Yellow, 1, 0.0, 0.0, 30.0), robot(Team::Blue, 1, 90.0, 0.0, 80.0)];
    let quiet = Picture::of_robots(&config, &robots).runs();
    let fresh = detections(&config, &quiet, None);
    let mut tracker = Tracker::new(&config).unwrap();
    let mut out = Box::new(DetectionFrame::zeroed());
    let mut header = RunsHeader::zeroed();
    header.frame = fresh.frame;
    header.flags = RunsHeader::OVERFLOW;
    tracker.step(&header, &blocks(3, 2000, 14).runs(), None, None, &mut out);
    assert_ne!(out.flags, 0);
    header.flags = 0;
    tracker.step(&header, &quiet, None, None, &mut out);
    assert_eq!(out.flags, 0);
    assert_eq!(out.robots(), fresh.robots());
    assert_eq!(out.regions(), fresh.regions());
    assert_eq!(out.balls(), fresh.balls());
    assert_eq!(out.rejected(), fresh.rejected());
}

fn any_run() -> impl Strategy<Value = Run> {
    let near = (0u16..500, 0u16..700, 0u16..40, 0u8..10).prop_map(|(row, begin, length, class)| {
        Run { row, begin, end: begin + length, class, reserved: 0 }
    });
    let any = any::<(u16, u16, u16, u8, u8)>().prop_map(|(row, begin, end, class, reserved)| Run {
        row,
        begin,
        end,
        class,
        reserved,
    });
    prop_oneof![9 => near, 1 => any]
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 64,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn any_runs_are_survived(
        mut runs in prop::collection::vec(any_run(), 0..3000),
        sorted in any::<bool>(),
    ) {
        if sorted {
            runs.sort_by_key(|run| (run.row, run.begin));
        }
        check(&detections(&Config::default(), &runs, None));
    }

    #[test]
    fn any_prior_is_survived(bytes in prop::collection::vec(any::<u8>(), size_of::<WorldFrame>())) {
        let mut world = Box::new(WorldFrame::zeroed());
        bytemuck::bytes_of_mut(&mut *world).copy_from_slice(&bytes);
        world.frame.seq = 99;
        world.frame.t_capture_ns = 987_500_000;
        let robots = [robot(Team::Yellow, 1, 0.0, 0.0, 30.0), robot(Team::Blue, 1, 90.0, 0.0, 80.0)];
        let frame = Picture::of_robots(&Config::default(), &robots).detections_after(Some(&world));
        check(&frame);
        assert_found(&frame, &robots, 1.5, 3.0);
    }
}
