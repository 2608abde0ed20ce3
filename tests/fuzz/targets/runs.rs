//! The tracker with any header, any runs, any picture and any `world` as prediction. Its output is
//! consistent.
#![no_main]

use bytemuck::{Zeroable, bytes_of_mut, pod_read_unaligned};
use config::Config;
use messages::{
    DetectionFrame, PixelFormat, RejectReason, Run, RunsHeader, Team, WorldFrame,
};
use libfuzzer_sys::fuzz_target;
use std::cell::RefCell;
use tracker::Tracker;

/// As in the default configuration.
const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;

struct State {
    tracker: Tracker,
    pixels: Vec<u8>,
    world: Box<WorldFrame>,
    out: Box<DetectionFrame>,
}

thread_local! {
    static STATE: RefCell<State> = RefCell::new(State {
        tracker: Tracker::new(&Config::default()).expect("the default configuration can be used"),
        pixels: vec![0; WIDTH as usize * HEIGHT as usize],
        world: bytemuck::zeroed_box(),
        out: bytemuck::zeroed_box(),
    });
}

/// A run that is likely to touch others: half of them lie in a small part of the picture.
fn run(bytes: &[u8], is_near: bool) -> Run {
    let run: Run = pod_read_unaligned(bytes);
    if !is_near {
        return run;
    }
    let begin = run.begin % 64;
    Run { row: run.row % 32, begin, end: begin + run.end % 16, class: run.class % 9, ..run }
}

fuzz_target!(|bytes: &[u8]| {
    let mut header = RunsHeader::zeroed();
    let Some((first, rest)) = bytes.split_at_checked(size_of::<RunsHeader>() + 1) else { return };
    let (kind, first) = (first[0], &first[1..]);
    bytes_of_mut(&mut header).copy_from_slice(first);
    let mut runs: Vec<Run> =
        rest.chunks_exact(size_of::<Run>()).map(|bytes| run(bytes, kind & 1 == 0)).collect();
    if kind & 2 == 0 {
        runs.sort_by_key(|run| (run.row, run.begin));
    }
    if kind & 16 == 0 {
        let frame = &mut header.frame;
        (frame.width, frame.height, frame.stride) = (WIDTH, HEIGHT, WIDTH);
        (frame.pixel_format, frame.bayer_order) = (PixelFormat::Bayer8 as u32, 0);
    }
    STATE.with_borrow_mut(|State { tracker, pixels, world, out }| {
        let prior = (kind & 4 == 0 && !rest.is_empty()).then(|| {
            let pattern = rest.iter().cycle();
            bytes_of_mut(&mut **world).iter_mut().zip(pattern).for_each(|(to, from)| *to = *from);
            if kind & 8 == 0 {
                world.frame.seq = header.frame.seq.wrapping_sub(1);
                world.frame.t_capture_ns = header.frame.t_capture_ns.wrapping_sub(12_500_000);
            }
            &**world
        });
        // The picture matters only where runs are likely.
        let pattern = rest.iter().cycle();
        pixels[..64 * WIDTH as usize].iter_mut().zip(pattern).for_each(|(to, from)| *to = *from);
        let pixels = (kind & 32 == 0).then_some(pixels.as_slice());
        tracker.step(&header, header.valid(&runs), pixels, prior, out);
        for robot in out.robots() {
            assert!(Team::from_number(robot.team).is_some());
            let numbers = [robot.x_mm, robot.y_mm, robot.orientation, robot.x_px, robot.y_px];
            assert!(numbers.iter().all(|number| number.is_finite()), "{robot:?}");
            assert!((0.0..=1.0).contains(&robot.confidence), "{robot:?}");
        }
        let names: Vec<_> = out.robots().iter().map(|robot| (robot.team, robot.robot_id)).collect();
        assert!(names.windows(2).all(|pair| pair[0] < pair[1]), "{names:?}");
        for ball in out.balls() {
            assert!(ball.x_mm.is_finite() && ball.y_mm.is_finite(), "{ball:?}");
        }
        for region in out.regions() {
            let pixels: u32 = out.runs_of(region).iter().map(Run::pixels).sum();
            assert!(region.run_count == 0 || pixels == region.pixel_count, "{region:?}");
        }
        for rejected in out.rejected() {
            assert!(RejectReason::from_number(rejected.reason).is_some());
        }
    });
});
