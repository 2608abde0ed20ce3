//! How well the ball is located, on pictures by a renderer of the tests' own that shares nothing with the
//! synthetic camera: a shaded sphere with shadow and highlight under lamps from any side, in motion, across
//! lines, at the wall, behind robots.

mod painter;

use bytemuck::Zeroable;
use config::Config;
use messages::{DetectedBall, DetectionFrame, Run, RunsHeader};
use painter::{Ball, Block, Color, Dice, Lamp, Pinhole, World};
use std::f64::consts::TAU;
use touchline_tracker::Tracker;

/// Paints and looks.
struct Watch {
    config: Config,
    tracker: Tracker,
    seen: Box<DetectionFrame>,
}

impl Watch {
    fn new(camera: &Pinhole) -> Self {
        let mut config = Config::default();
        config.geometry = camera.geometry(&config);
        Self {
            tracker: Tracker::new(&config).unwrap(),
            seen: Box::new(DetectionFrame::zeroed()),
            config,
        }
    }

    /// The plainest classifier: means of the neighbours of each colour, and the colours' boxes.
    fn classify(&self, pixels: &[u8]) -> Vec<Run> {
        let camera = &self.config.camera;
        let (width, height) = (camera.width as usize, camera.height as usize);
        let class_at = |column: usize, row: usize| {
            let (mut sums, mut counts) = ([0; 3], [0; 3]);
            let own = camera.bayer_order.channel_at(column, row);
            for (x, y) in (0..9).map(|index| (column + index % 3 - 1, row + index / 3 - 1)) {
                let channel = camera.bayer_order.channel_at(x, y);
                if channel != own || (x, y) == (column, row) {
                    sums[channel] += u32::from(pixels[y * width + x]);
                    counts[channel] += 1;
                }
            }
            let rgb = [0, 1, 2].map(|channel| (sums[channel] / counts[channel]) as u8);
            self.config.colors.iter().position(|color| {
                let within = [color.red, color.green, color.blue];
                rgb.iter().zip(within).all(|(value, [low, high])| (low..=high).contains(value))
            })
        };
        let mut runs: Vec<Run> = Vec::new();
        for row in 1..height - 1 {
            for column in 1..width - 1 {
                let Some(class) = class_at(column, row) else { continue };
                let (row, column, class) = (row as u16, column as u16, class as u8);
                match runs.last_mut() {
                    Some(run) if (run.row, run.end, run.class) == (row, column, class) => {
                        run.end += 1;
                    }
                    _ => runs.push(Run { row, begin: column, end: column + 1, class, reserved: 0 }),
                }
            }
        }
        runs
    }

    fn look(&mut self, pixels: &[u8]) -> &DetectionFrame {
        let header = self.config.camera.frame_header();
        let runs_header = RunsHeader { frame: header, ..RunsHeader::default() };
        let runs = self.classify(pixels);
        self.tracker.step(&runs_header, &runs, Some(pixels), None, &mut self.seen);
        &self.seen
    }
}

/// How a scene was seen.
#[derive(Default)]
struct Outcome {
    painted: usize,
    found: usize,
    off_mm: Vec<[f64; 2]>,
    /// Squared errors in units of their covariance; 2 on average if that is right.
    normalised: Vec<f64>,
}

impl Outcome {
    fn add(&mut self, truth: [f64; 2], ball: Option<&DetectedBall>) {
        self.painted += 1;
        let Some(ball) = ball else { return };
        let [dx, dy] = [f64::from(ball.x_mm) - truth[0], f64::from(ball.y_mm) - truth[1]];
        if dx.hypot(dy) > 30.0 {
            return;
        }
        self.found += 1;
        self.off_mm.push([dx, dy]);
        let [xx, xy, yy] = ball.covariance.map(f64::from);
        let determinant = xx * yy - xy * xy;
        self.normalised.push((yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant);
    }

    fn rms_mm(&self) -> f64 {
        let squares: f64 = self.off_mm.iter().map(|[x, y]| x * x + y * y).sum();
        (squares / self.off_mm.len().max(1) as f64).sqrt()
    }

    fn most_mm(&self) -> f64 {
        self.off_mm.iter().map(|[x, y]| x.hypot(*y)).fold(0.0, f64::max)
    }

    fn normalised_mean(&self) -> f64 {
        self.normalised.iter().sum::<f64>() / self.normalised.len().max(1) as f64
    }

    fn print(&self, what: &str) {
        let count = self.off_mm.len().max(1) as f64;
        let [x, y] =
            [0, 1].map(|axis| self.off_mm.iter().map(|off| off[axis]).sum::<f64>() / count);
        let mut sorted = self.normalised.clone();
        sorted.sort_by(f64::total_cmp);
        let nearly_all = sorted.get(sorted.len() * 95 / 100).copied().unwrap_or(f64::NAN);
        println!(
            "{what:28} found {}/{}, rms {:.3} mm, most {:.2}, mean ({x:+.2}, {y:+.2}), normalised {:.2}, 95 % {nearly_all:.1}",
            self.found,
            self.painted,
            self.rms_mm(),
            self.most_mm(),
            self.normalised_mean(),
        );
    }
}

const ORANGE: Color = [0.92, 0.353, 0.098];
const FLOOR: Color = [0.102, 0.118, 0.114];
const WHITE: Color = [0.59, 0.6, 0.58];

/// A lamp of which an upright surface of the floor's kind gets `share` of its light, at that height above
/// the horizon.
fn lit_by(share: f64, azimuth_deg: f64, height_deg: f64) -> (Vec<Lamp>, f64) {
    let (a, h) = (azimuth_deg.to_radians(), height_deg.to_radians());
    let direction = [a.cos() * h.cos(), a.sin() * h.cos(), h.sin()];
    (vec![Lamp { direction, strength: share / h.sin(), size: 0.06 }], 1.0 - share)
}

/// An empty pitch under a lamp that is not straight above.
fn world() -> World {
    let (lamps, ambient) = lit_by(0.5, 40.0, 70.0);
    World {
        camera: Pinhole::new([60.0, -40.0, 2200.0], [15.0, 10.0], 560.0, [640, 480]),
        lamps,
        ambient,
        floor: FLOOR,
        line: WHITE,
        line_half: 6.0,
        lines_x: vec![0.0, -748.0, 748.0],
        lines_y: vec![],
        circle: 200.0,
        ball: Ball {
            position: [0.0; 2],
            velocity: [0.0; 2],
            radius: 21.35,
            albedo: ORANGE,
            gloss: 0.25,
            sharpness: 60.0,
        },
        blocks: Vec::new(),
        exposure_s: 0.002,
        dice: Dice(7),
    }
}

/// Looks at a world so many times, each time as `arrange` has it.
fn watch(
    what: &str,
    world: &World,
    times: usize,
    mut arrange: impl FnMut(&mut World, &mut Dice),
) -> Outcome {
    let mut watch = Watch::new(&world.camera);
    let mut world = world.clone();
    // Far away, so that nothing of it is in the backdrop.
    world.ball.position = [9e5, 9e5];
    let backdrop = world.backdrop(&watch.config);
    let mut outcome = Outcome::default();
    let mut dice = Dice(11);
    for _ in 0..times {
        arrange(&mut world, &mut dice);
        let mut pixels = backdrop.clone();
        world.paint_around(
            &watch.config,
            &mut pixels,
            if world.blocks.is_empty() { 17 } else { 26 },
        );
        let pixels = world.with_noise(&pixels, 1.0, 0.02);
        let seen = watch.look(&pixels);
        let ball = seen.balls().first();
        outcome.add(world.ball.position, ball);
    }
    outcome.print(what);
    outcome
}

/// Anywhere, not near a line.
fn anywhere(dice: &mut Dice) -> [f64; 2] {
    loop {
        let [x, y] = [dice.between(-1000.0, 1000.0), dice.between(-800.0, 800.0)];
        let near = |off: f64| off.abs() < 45.0;
        if !(near(x) || near(x.abs() - 748.0) || near(x.hypot(y) - 200.0)) {
            return [x, y];
        }
    }
}

/// A robot between the ball and the lens that hides about `hidden` of the ball's outline.
fn robot_before(world: &mut World, hidden: f64, turn: f64) {
    let [x, y] = world.ball.position;
    let lens = world.camera.lens;
    let (dx, dy) = (lens[0] - x, lens[1] - y);
    let far = dx.hypot(dy);
    let towards = dy.atan2(dx);
    let (mut near, mut away) = (20.0, 160.0);
    let yellow = [0.88, 0.80, 0.157];
    let green = [0.157, 0.7, 0.235];
    for _ in 0..24 {
        let gap = (near + away) / 2.0;
        world.blocks = vec![Block {
            center: [x + dx / far * gap, y + dy / far * gap],
            half: [37.5; 2],
            height: 75.0,
            turn: towards + turn,
            body: [0.1, 0.1, 0.105],
            patches: vec![([1.0, 1.0, 35.0, 35.0], yellow), ([-35.0, -35.0, -1.0, -1.0], green)],
        }];
        if 1.0 - world.visible_share() > hidden { near = gap } else { away = gap }
    }
}

/// At most so far off, RMS, and so large in units of the covariance, on average.
fn check(outcome: &Outcome, found: usize, most_rms_mm: f64, most_normalised: f64) {
    assert!(outcome.found >= found, "{} of {}", outcome.found, outcome.painted);
    assert!(outcome.rms_mm() < most_rms_mm, "{} mm", outcome.rms_mm());
    assert!(outcome.normalised_mean() < most_normalised, "{}", outcome.normalised_mean());
}

#[test]
fn a_ball_that_lies_free_is_located_to_a_tenth_of_a_pixel() {
    let base = world();
    let outcome = watch("standing", &base, 40, |world, dice| world.ball.position = anywhere(dice));
    check(&outcome, 40, 0.5, 3.0);
    let mut bright = base.clone();
    bright.floor = [0.12, 0.3, 0.14];
    let outcome =
        watch("green floor", &bright, 40, |world, dice| world.ball.position = anywhere(dice));
    check(&outcome, 40, 0.75, 3.0);
}

#[test]
fn a_ball_that_rolls_is_located_as_well() {
    let mut moving = world();
    moving.exposure_s = 0.004;
    let outcome = watch("moving 2 m/s, 4 ms", &moving, 40, |world, dice| {
        world.ball.position = anywhere(dice);
        let turn = dice.between(0.0, TAU);
        world.ball.velocity = [2000.0 * turn.cos(), 2000.0 * turn.sin()];
    });
    check(&outcome, 40, 1.0, 4.0);
}

#[test]
fn light_from_one_side_hardly_moves_the_ball() {
    for (share, height, most_mm) in [(0.8, 60.0, 1.0), (0.8, 35.0, 3.0)] {
        let mut side = world();
        (side.lamps, side.ambient) = lit_by(share, 130.0, height);
        let what = format!("lamp {share} at {height}°");
        let outcome = watch(&what, &side, 40, |world, dice| world.ball.position = anywhere(dice));
        check(&outcome, 40, most_mm, 40.0);
    }
}

#[test]
fn lines_and_walls_hardly_move_the_ball() {
    let base = world();
    let outcome = watch("across a line", &base, 40, |world, dice| {
        world.ball.position = [748.0 + dice.between(-30.0, 30.0), dice.between(-800.0, 800.0)];
    });
    check(&outcome, 40, 1.3, 4.0);
    let outcome = watch("along the circle", &base, 40, |world, dice| {
        let (turn, off) = (dice.between(0.0, TAU), dice.between(-30.0, 30.0));
        world.ball.position = [(200.0 + off) * turn.cos(), (200.0 + off) * turn.sin()];
    });
    check(&outcome, 40, 1.0, 4.0);
    let mut walled = base;
    for side in [-1.0, 1.0] {
        walled.blocks.push(Block {
            center: [0.0, side * 912.5],
            half: [1125.0, 12.5],
            height: 50.0,
            turn: 0.0,
            body: [0.41, 0.405, 0.385],
            patches: vec![],
        });
    }
    let outcome = watch("at the wall", &walled, 40, |world, dice| {
        let side = if dice.even() < 0.5 { -1.0 } else { 1.0 };
        let off = dice.between(22.0, 45.0);
        world.ball.position = [dice.between(-1000.0, 1000.0), side * (900.0 - off)];
    });
    check(&outcome, 40, 0.8, 3.0);
}

/// From 30 % hidden on the shade on the ball leaves few pixels of its colour; see docs/accuracy.md.
#[test]
fn a_ball_behind_a_robot_is_found_by_what_is_seen_of_its_rim() {
    for (hidden, found, most_mm) in [(0.2, 40, 2.0), (0.4, 40, 2.0), (0.5, 39, 3.0), (0.6, 30, 4.5)]
    {
        let what = format!("{hidden} hidden by a robot");
        let outcome = watch(&what, &world(), 40, |world, dice| {
            loop {
                world.ball.position = anywhere(dice);
                let [x, y] = world.ball.position;
                // Nearly below the lens a robot hides nothing.
                if (x - 60.0).hypot(y + 40.0) > 450.0 {
                    break;
                }
            }
            let turn = dice.between(-0.7, 0.7);
            robot_before(world, hidden, turn);
        });
        assert!(outcome.found >= found, "{what}: {} of {}", outcome.found, outcome.painted);
        assert!(outcome.rms_mm() < most_mm, "{what}: {} mm", outcome.rms_mm());
    }
}
