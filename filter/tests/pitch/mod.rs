//! A simulation of differential-drive robots with exact truth, and of a camera that measures it with known
//! noise: the reference for the filter.

// Each test file uses a part of this.
#![allow(dead_code)]

use bytemuck::Zeroable;
use geometry::wrap_angle;
use messages::{
    Commands, DetectedBall, DetectedRobot, DetectionFrame, MAX_COMMANDS, WheelCommand, WorldFrame,
};

/// Nanoseconds between frames at 80 fps.
pub const FRAME_NS: u64 = 12_500_000;
/// Capture of the first frame.
pub const START_NS: u64 = 5_000_000_000;
/// Latency from capture to the tracker's output.
pub const TRACKER_NS: u64 = 4_000_000;
/// Latency from the tracker's output until the strategy has sent its commands.
const STRATEGY_NS: u64 = 3_000_000;
/// Value in the default configuration.
const DELAY_NS: u64 = 50_000_000;
const WHEEL_BASE_MM: f64 = 65.0;
/// Integration step of the truth.
const TICK_NS: u64 = 500_000;

/// A deterministic source of random numbers (splitmix64).
#[derive(Clone)]
pub struct Random(pub u64);

impl Random {
    pub fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Mean 0, standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }
}

/// Response of a robot's wheels to commands.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Wheels {
    /// Immediate; the strategy ramps its commands.
    Exact,
    /// First-order lag, time constant in seconds; the strategy ramps its commands, too.
    Lagging(f64),
    /// Limited acceleration, mm/s², for any step of the command.
    Limited(f64),
}

#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Pose {
    pub x: f64,
    pub y: f64,
    pub theta: f64,
}

/// A simulated robot.
#[derive(Clone)]
pub struct Robot {
    pub pose: Pose,
    pub left: f64,
    pub right: f64,
    pub frames_still: u32,
    pub wheels: Wheels,
    /// Strategy: desired speeds, and the time of the next change.
    goal: (f64, f64),
    next_goal_ns: u64,
    /// Strategy: current command.
    told: (f64, f64),
    /// Commands sent and not yet superseded: time of acting and speeds.
    pending: Vec<(u64, f64, f64)>,
    random: Random,
    t_ns: u64,
}

/// Maximum acceleration of a wheel.
const RAMP_MM_S2: f64 = 3000.0;

impl Robot {
    pub fn new(wheels: Wheels, seed: u64) -> Self {
        let mut random = Random(seed);
        let pose = Pose {
            x: random.between(-800.0, 800.0),
            y: random.between(-600.0, 600.0),
            theta: random.between(-3.0, 3.0),
        };
        Self {
            pose,
            left: 0.0,
            right: 0.0,
            frames_still: 0,
            wheels,
            goal: (0.0, 0.0),
            next_goal_ns: 0,
            told: (0.0, 0.0),
            pending: vec![],
            random,
            t_ns: START_NS,
        }
    }

    /// Simulates the robot until `t_ns`.
    pub fn drive_to(&mut self, t_ns: u64) {
        let before = self.pose;
        while self.t_ns < t_ns {
            let dt_ns = TICK_NS.min(t_ns - self.t_ns);
            let dt = dt_ns as f64 * 1e-9;
            self.t_ns += dt_ns;
            let acting = self.pending.iter().rposition(|command| command.0 <= self.t_ns);
            let (left, right) = match acting {
                Some(index) => {
                    self.pending.drain(..index);
                    (self.pending[0].1, self.pending[0].2)
                }
                None => (0.0, 0.0),
            };
            let follow = |speed: f64, told: f64| match self.wheels {
                Wheels::Exact => told,
                Wheels::Lagging(lag) => told + (speed - told) * (-dt / lag).exp(),
                Wheels::Limited(most) => speed + (told - speed).clamp(-most * dt, most * dt),
            };
            (self.left, self.right) = (follow(self.left, left), follow(self.right, right));
            let (v, omega) = (self.v(), self.omega());
            let middle = self.pose.theta + 0.5 * omega * dt;
            self.pose.x += v * dt * middle.cos();
            self.pose.y += v * dt * middle.sin();
            self.pose.theta = wrap_angle(self.pose.theta + omega * dt);
        }
        self.frames_still = if self.pose == before { self.frames_still + 1 } else { 0 };
    }

    pub fn v(&self) -> f64 {
        0.5 * (self.left + self.right)
    }

    pub fn omega(&self) -> f64 {
        (self.right - self.left) / WHEEL_BASE_MM
    }

    /// The command that the strategy sends at `t_ns`: random driving, turning and stopping.
    pub fn strategy(&mut self, t_ns: u64) -> (f64, f64) {
        if t_ns >= self.next_goal_ns {
            self.next_goal_ns = t_ns + (self.random.between(0.2, 1.2) * 1e9) as u64;
            let (v, omega) = match self.random.between(0.0, 10.0) {
                kind if kind < 3.0 => (0.0, 0.0),
                kind if kind < 4.0 => (0.0, self.random.between(-10.0, 10.0)),
                _ => (self.random.between(-1500.0, 1500.0), self.random.between(-4.0, 4.0)),
            };
            self.goal = (v - 0.5 * omega * WHEEL_BASE_MM, v + 0.5 * omega * WHEEL_BASE_MM);
            let strongest = self.goal.0.abs().max(self.goal.1.abs());
            if strongest > 1500.0 {
                let scale = 1500.0 / strongest;
                self.goal = (self.goal.0 * scale, self.goal.1 * scale);
            }
        }
        let most = match self.wheels {
            Wheels::Limited(_) => f64::INFINITY,
            Wheels::Exact | Wheels::Lagging(_) => RAMP_MM_S2 * FRAME_NS as f64 * 1e-9,
        };
        self.told.0 += (self.goal.0 - self.told.0).clamp(-most, most);
        self.told.1 += (self.goal.1 - self.told.1).clamp(-most, most);
        self.pending.push((t_ns + DELAY_NS, self.told.0, self.told.1));
        self.told
    }

    /// Stops dead and is pushed to the side.
    pub fn collide(&mut self) {
        self.left = 0.0;
        self.right = 0.0;
        let push = self.random.between(-8.0, 8.0);
        let (sin, cos) = self.pose.theta.sin_cos();
        self.pose.x -= push * sin;
        self.pose.y += push * cos;
        self.goal = (0.0, 0.0);
        self.told = (0.0, 0.0);
        self.pending.clear();
        self.next_goal_ns = self.t_ns + 200_000_000;
    }
}

/// A simulated ball: rolls, is kicked and hidden now and then.
#[derive(Clone)]
pub struct Ball {
    pub position: (f64, f64),
    pub velocity: (f64, f64),
    pub frames_hidden: u32,
    random: Random,
}

impl Ball {
    pub fn new(seed: u64) -> Self {
        let random = Random(seed);
        Self { position: (0.0, 0.0), velocity: (400.0, 300.0), frames_hidden: 0, random }
    }

    /// Simulates a frame of rolling, with 30 % loss of speed per second.
    pub fn roll(&mut self) {
        let dt = FRAME_NS as f64 * 1e-9;
        let random = &mut self.random;
        if random.unit() < dt / 0.7 {
            let (speed, angle) = (random.between(0.0, 2500.0), random.between(-3.2, 3.2));
            self.velocity = (speed * angle.cos(), speed * angle.sin());
        }
        self.frames_hidden = match self.frames_hidden {
            0 if random.unit() < dt / 2.0 => random.between(2.0, 25.0) as u32,
            frames => frames.saturating_sub(1),
        };
        let kept = 0.7f64.powf(dt);
        let carried = (1.0 - kept) / -0.7f64.ln();
        for (position, velocity, most) in [
            (&mut self.position.0, &mut self.velocity.0, 1000.0),
            (&mut self.position.1, &mut self.velocity.1, 800.0),
        ] {
            *position += *velocity * carried;
            *velocity *= kept;
            if position.abs() > most {
                *velocity = -velocity.abs() * position.signum();
            }
        }
    }
}

/// A detection frame without detections.
pub fn empty_frame(seq: u64, t_ns: u64) -> Box<DetectionFrame> {
    let mut frame = Box::new(DetectionFrame::zeroed());
    stamp(&mut frame, seq, t_ns);
    frame
}

pub fn stamp(frame: &mut DetectionFrame, seq: u64, t_ns: u64) {
    frame.clear();
    frame.frame.seq = seq;
    frame.frame.t_capture_ns = t_ns;
    frame.t_sent_ns = t_ns + TRACKER_NS;
}

pub fn detected(team: u32, robot_id: u32, pose: Pose) -> DetectedRobot {
    DetectedRobot {
        team,
        robot_id: robot_id.into(),
        x_mm: pose.x as f32,
        y_mm: pose.y as f32,
        orientation: wrap_angle(pose.theta) as f32,
        confidence: 0.9,
        ..Default::default()
    }
}

pub fn detected_ball(x: f64, y: f64, confidence: f32) -> DetectedBall {
    DetectedBall { x_mm: x as f32, y_mm: y as f32, confidence, ..Default::default() }
}

/// A message with these commands: (team, robot, left, right).
pub fn commands(seq: u64, t_sent_ns: u64, wheels: &[(u32, u32, f64, f64)]) -> Commands {
    let mut message = Commands {
        seq,
        t_sent_ns,
        wheel_count: wheels.len() as u32,
        user: 0,
        wheels: [WheelCommand::default(); MAX_COMMANDS],
    };
    for (slot, &(team, robot_id, left_mm_s, right_mm_s)) in message.wheels.iter_mut().zip(wheels) {
        *slot = WheelCommand { team, robot_id, left_mm_s, right_mm_s };
    }
    message
}

/// Measurement noise, 1σ.
#[derive(Clone, Copy, Debug)]
pub struct Noise {
    pub position_mm: f64,
    pub heading_deg: f64,
}

impl Noise {
    pub fn measure(&self, pose: Pose, random: &mut Random) -> Pose {
        Pose {
            x: pose.x + self.position_mm * random.normal(),
            y: pose.y + self.position_mm * random.normal(),
            theta: wrap_angle(pose.theta + self.heading_deg.to_radians() * random.normal()),
        }
    }
}

/// A match: simulated robots, seen and commanded.
pub struct Match {
    pub robots: Vec<Robot>,
    /// Whether the filter receives the commands.
    pub overheard: bool,
    pub noise: Noise,
    /// Mean seconds between a robot's collisions.
    pub collisions_every_s: Option<f64>,
    /// Whether most of an error persists until the robot has moved by some 0.8 mm, as on a real pixel grid.
    pub errors_stay: bool,
    /// For each robot: pose when last seen, and the persistent part of the error, in 1σ.
    stays: Vec<(Pose, [f64; 3])>,
    random: Random,
    pub seq: u64,
    pub detections: Box<DetectionFrame>,
}

impl Match {
    pub fn new(wheels: Wheels, overheard: bool, noise: Noise, seed: u64) -> Self {
        let mut random = Random(seed);
        let robots = (0..10).map(|_| Robot::new(wheels, (random.unit() * 1e15) as u64)).collect();
        let detections = empty_frame(0, START_NS);
        Self {
            robots,
            overheard,
            noise,
            collisions_every_s: None,
            errors_stay: false,
            stays: vec![(Pose::default(), [0.0; 3]); 10],
            random,
            seq: 0,
            detections,
        }
    }

    pub fn t_ns(&self) -> u64 {
        START_NS + self.seq * FRAME_NS
    }

    /// Team and number of a robot.
    pub fn identity(index: usize) -> (u32, u32) {
        ((index / 5) as u32, (index % 5) as u32)
    }

    /// Simulates up to the next frame, fills `detections` from it, and returns the commands that the
    /// strategies send in reply.
    pub fn next_frame(&mut self) -> Commands {
        let t_ns = self.t_ns();
        stamp(&mut self.detections, self.seq, t_ns);
        let t_sent_ns = t_ns + TRACKER_NS + STRATEGY_NS;
        let mut sent = vec![];
        for (index, robot) in self.robots.iter_mut().enumerate() {
            robot.drive_to(t_ns);
            if let Some(every_s) = self.collisions_every_s
                && self.random.unit() < 0.0125 / every_s
            {
                robot.collide();
            }
            let (team, id) = Self::identity(index);
            let seen = if self.errors_stay {
                measure_on_a_grid(&mut self.stays[index], robot.pose, self.noise, &mut self.random)
            } else {
                self.noise.measure(robot.pose, &mut self.random)
            };
            assert!(self.detections.push_robot(detected(team, id, seen)));
            let (left, right) = robot.strategy(t_sent_ns);
            sent.push((team, id, left, right));
        }
        self.seq += 1;
        let heard = if self.overheard { &sent[..] } else { &[] };
        commands(self.seq, t_sent_ns, heard)
    }
}

/// The synthetic match's error model: 84 % of the variance persists.
fn measure_on_a_grid(
    (last, stays): &mut (Pose, [f64; 3]),
    pose: Pose,
    noise: Noise,
    random: &mut Random,
) -> Pose {
    let moved =
        (pose.x - last.x).hypot(pose.y - last.y) + 25.0 * wrap_angle(pose.theta - last.theta).abs();
    *last = pose;
    let kept = (-moved / 0.8).exp();
    let mut error = [0.0; 3];
    for (error, stays) in error.iter_mut().zip(stays) {
        *stays = kept * *stays + (1.0 - kept * kept).sqrt() * random.normal();
        *error = 0.84f64.sqrt() * *stays + 0.16f64.sqrt() * random.normal();
    }
    Pose {
        x: pose.x + noise.position_mm * error[0],
        y: pose.y + noise.position_mm * error[1],
        theta: wrap_angle(pose.theta + noise.heading_deg.to_radians() * error[2]),
    }
}

/// Errors relative to the truth.
#[derive(Default, Clone)]
pub struct Errors {
    pub position_mm: Vec<f64>,
    pub heading_deg: Vec<f64>,
}

impl Errors {
    pub fn add(&mut self, truth: Pose, x: f64, y: f64, theta: f64) {
        self.position_mm.push((x - truth.x).hypot(y - truth.y));
        self.heading_deg.push(wrap_angle(theta - truth.theta).abs().to_degrees());
    }

    pub fn rms(&self) -> (f64, f64) {
        let rms = |values: &[f64]| {
            (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
        };
        (rms(&self.position_mm), rms(&self.heading_deg))
    }

    pub fn quantile(&self, share: f64) -> (f64, f64) {
        let quantile = |values: &[f64]| {
            let mut sorted = values.to_vec();
            sorted.sort_by(f64::total_cmp);
            sorted[((sorted.len() - 1) as f64 * share) as usize]
        };
        (quantile(&self.position_mm), quantile(&self.heading_deg))
    }
}

pub fn new_world() -> Box<WorldFrame> {
    Box::new(WorldFrame::zeroed())
}
