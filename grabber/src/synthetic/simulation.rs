//! The simulation of robots and ball from frame to frame.
//!
//! Collisions are prevented, not resolved. A frame is divided into steps short enough that no point moves
//! farther than [`STEP_MM`]. In each step the bodies move one after the other (a sequential solver), and a
//! robot that would overlap a wall or another robot keeps its pose for that step. A ball in its way is pushed
//! out along the contact normal, at most six times alternating with the walls; if it has nowhere to go, the
//! robot keeps its pose, too. Since nothing overlaps at the start, nothing ever does.

use super::behaviour::{Behaviour, Surroundings};
use super::collision::{BallContact, Walls, robots_touch};
use super::motion::{CommandDelay, Twist, WheelSpeeds};
use super::random::Random;
use super::slip::{Slip, SlipRate};
use super::{SyntheticError, not_negative, positive};
use config::Config;
use geometry::body::Body;
use geometry::{FieldPoint, Pose};
use messages::Team;

/// Maximum distance that any point of a robot or the ball moves in one step.
const STEP_MM: f64 = 5.0;
/// Maximum speed of the ball.
const MAX_BALL_SPEED_MM_S: f64 = 3000.0;
/// Coefficient of restitution of the ball at a wall, and at a robot.
const WALL_RESTITUTION: f64 = 0.6;
const ROBOT_RESTITUTION: f64 = 0.3;
/// Below this speed the ball is at rest.
const REST_MM_S: f64 = 15.0;
/// A ball that has hardly moved for this long is put back into play with a push.
const FREE_BALL_S: f64 = 4.0;
/// Maximum number of robots that chase the ball at the same time.
const MAX_CHASERS: usize = 2;

/// Random streams of a seed.
const STREAM_PLACES: u64 = 1;
const STREAM_BALL: u64 = 2;
const STREAM_SLIP: u64 = 3;
const STREAM_ROBOTS: u64 = 1000;

/// A robot.
#[derive(Debug, Clone)]
pub struct Robot {
    /// Its team.
    pub team: Team,
    /// Its number.
    pub id: u32,
    /// Its pose.
    pub pose: Pose,
    /// Its motion from now on.
    pub twist: Twist,
    /// Consecutive frames in which its pose has not changed at all.
    pub frames_still: u32,
    /// Index into `robots.identities`.
    pub identity: usize,
    delay: CommandDelay,
    behaviour: Behaviour,
    /// Wheel speeds while it accelerates again after being blocked.
    recovering: Option<WheelSpeeds>,
    /// Its slip until the next frame.
    slip: Slip,
    blocked: bool,
    /// Wheel speeds commanded by another program, and the number of frames for which they still count.
    ordered: Option<(WheelSpeeds, u32)>,
}

impl Robot {
    /// Whether another program commands it.
    pub fn is_obeying(&self) -> bool {
        self.ordered.is_some()
    }

    /// The command sent to it in this frame.
    pub fn command(&self) -> WheelSpeeds {
        self.delay.newest()
    }
}

/// The ball.
#[derive(Debug, Clone, Copy)]
pub struct Ball {
    /// Its position.
    pub position: FieldPoint,
    /// Its velocity.
    pub velocity_mm_s: [f64; 2],
}

/// Robots and ball.
#[derive(Debug, Clone)]
pub struct Simulation {
    /// Sorted by team and number.
    pub robots: Vec<Robot>,
    /// The ball.
    pub ball: Ball,
    walls: Walls,
    body: Body,
    size_mm: f64,
    wheel_base_mm: f64,
    ball_radius_mm: f64,
    ball_friction_per_s: f64,
    max_speed_mm_s: f64,
    max_acceleration_mm_s2: f64,
    delay_s: f64,
    period_s: f64,
    /// Number of frames for which a command of another program counts.
    order_frames: u32,
    slip_rate: SlipRate,
    random: Random,
    ball_idle_s: f64,
    /// Reused allocation for the robots' poses.
    poses: Vec<Pose>,
}

impl Simulation {
    /// The first frame: robots distributed over the field, most of them moving.
    pub fn new(config: &Config) -> Result<Self, SyntheticError> {
        let robots = &config.robots;
        let size_mm = positive("robots.size_mm", robots.size_mm)?;
        let walls = Walls {
            half_length_mm: positive("field.length_mm", config.field.length_mm)? / 2.0,
            half_width_mm: positive("field.width_mm", config.field.width_mm)? / 2.0,
        };
        let mut simulation = Self {
            robots: Vec::with_capacity(robots.identities.len()),
            ball: Ball { position: FieldPoint::default(), velocity_mm_s: [0.0; 2] },
            walls,
            body: robots.body(&[]),
            size_mm,
            wheel_base_mm: positive("robots.wheel_base_mm", robots.wheel_base_mm)?,
            ball_radius_mm: positive("ball.diameter_mm", config.ball.diameter_mm)? / 2.0,
            ball_friction_per_s: config.filter.ball_friction_per_s.clamp(0.0, 1.0),
            max_speed_mm_s: not_negative(
                "synthetic.max_speed_mm_s",
                config.synthetic.max_speed_mm_s,
            )?,
            max_acceleration_mm_s2: not_negative(
                "synthetic.max_acceleration_mm_s2",
                config.synthetic.max_acceleration_mm_s2,
            )?,
            delay_s: config.filter.actuation_delay_ms.clamp(0.0, 1000.0) / 1000.0,
            period_s: 1.0 / positive("camera.fps", config.camera.fps)?,
            order_frames: (config.filter.command_timeout_ms.clamp(0.0, 60_000.0) / 1000.0
                * config.camera.fps)
                .ceil() as u32,
            slip_rate: SlipRate::new(config, Random::new(config.synthetic.seed, STREAM_SLIP)),
            random: Random::new(config.synthetic.seed, STREAM_BALL),
            ball_idle_s: 0.0,
            poses: Vec::with_capacity(robots.identities.len()),
        };
        simulation.place(config)?;
        simulation.push_ball(600.0);
        Ok(simulation)
    }

    fn place(&mut self, config: &Config) -> Result<(), SyntheticError> {
        let seed = config.synthetic.seed;
        let identities = &config.robots.identities;
        let mut random = Random::new(seed, STREAM_PLACES);
        let room = self.size_mm.max(2.0 * self.ball_radius_mm);
        if !self.walls.contain_ball(self.ball.position, 2.0 * self.ball_radius_mm) {
            return Err(SyntheticError::NoRoom { robots: identities.len() });
        }
        for _ in identities {
            let place = self.free_place(&mut random, room);
            self.poses.push(place.ok_or(SyntheticError::NoRoom { robots: identities.len() })?);
        }
        // Two fifths stand at first, at least three, and at least one robot moves.
        let standing = (identities.len() * 2 / 5).max(3).min(identities.len().saturating_sub(1));
        let mut stands: Vec<bool> = (0..identities.len()).map(|index| index < standing).collect();
        random.shuffle(&mut stands);

        let mut order: Vec<usize> = (0..identities.len()).collect();
        order.sort_by_key(|&index| (identities[index].team, identities[index].id));
        for (number, identity) in order.into_iter().enumerate() {
            let random = Random::new(seed, STREAM_ROBOTS + number as u64);
            let around = self.surroundings();
            let mut behaviour = Behaviour::new(number, stands[number], random, &around);
            let pose = self.poses[number];
            // Driving robots have just started.
            let twist = behaviour.decide(pose, false, &around, 0.0);
            let speeds = WheelSpeeds::from_twist(twist, self.wheel_base_mm)
                .limited(0.4 * self.max_speed_mm_s);
            let delay = CommandDelay::new(speeds, self.delay_s, self.period_s);
            self.robots.push(Robot {
                team: identities[identity].team,
                id: identities[identity].id,
                pose,
                twist: speeds.twist(self.wheel_base_mm),
                frames_still: 0,
                identity,
                delay,
                behaviour,
                recovering: None,
                slip: Slip::default(),
                blocked: false,
                ordered: None,
            });
        }
        Ok(())
    }

    /// A place away from the walls, from the ball in the middle, and as far from the robots placed so far as
    /// the best of a few tries.
    fn free_place(&self, random: &mut Random, room_mm: f64) -> Option<Pose> {
        let (length, width) = (self.walls.half_length_mm, self.walls.half_width_mm);
        let mut best: Option<(f64, Pose)> = None;
        for attempt in 0..400 {
            // Thirty tries look for a good place, all others for any.
            if attempt >= 30 && best.is_some() {
                break;
            }
            let pose = Pose {
                position: FieldPoint::new(
                    random.range(-length, length),
                    random.range(-width, width),
                ),
                orientation: random.range(-3.1, 3.1),
            };
            let free = self
                .poses
                .iter()
                .map(|other| other.position.distance(pose.position))
                .fold(pose.position.distance(self.ball.position), f64::min);
            if free > 1.5 * room_mm
                && self.walls.contain_robot(&pose, &self.body.scaled(1.6))
                && best.as_ref().is_none_or(|&(best, _)| free > best)
            {
                best = Some((free, pose));
            }
        }
        best.map(|(_, pose)| pose)
    }

    /// Has a robot obey a command of another program.
    pub fn obey(&mut self, team: Team, id: u32, speeds: WheelSpeeds) {
        let is_possible = speeds.left_mm_s.is_finite() && speeds.right_mm_s.is_finite();
        let robot = self.robots.iter_mut().find(|robot| (robot.team, robot.id) == (team, id));
        if let Some(robot) = robot.filter(|_| is_possible) {
            robot.ordered = Some((speeds.limited(self.max_speed_mm_s), self.order_frames));
        }
    }

    /// Simulates one frame period.
    pub fn advance(&mut self) {
        self.poses.clear();
        self.poses.extend(self.robots.iter().map(|robot| robot.pose));
        // All delays are equal, so all robots change their commands at the same instants.
        let durations = match self.robots.first() {
            Some(robot) => robot.delay.until_next_frame().map(|(_, duration)| duration),
            None => [self.period_s, 0.0],
        };
        for robot in &mut self.robots {
            robot.blocked = false;
            robot.slip = self.slip_rate.draw();
        }
        for (part, duration) in durations.into_iter().enumerate() {
            let steps = self.steps(duration);
            for _ in 0..steps {
                self.step(part, duration / f64::from(steps));
            }
        }
        for (robot, before) in self.robots.iter_mut().zip(&self.poses) {
            robot.frames_still =
                if robot.pose == *before { robot.frames_still.saturating_add(1) } else { 0 };
        }
        self.push_idle_ball();
        self.decide();
    }

    fn steps(&self, duration_s: f64) -> u32 {
        // A robot's corner can be faster than its wheels, but not by much more than half.
        let fastest = (1.6 * self.max_speed_mm_s).max(MAX_BALL_SPEED_MM_S);
        // The limit bounds the time for absurd speeds; larger jumps do no harm then.
        (duration_s * fastest / STEP_MM).ceil().clamp(0.0, 2000.0) as u32
    }

    fn step(&mut self, part: usize, dt_s: f64) {
        for index in 0..self.robots.len() {
            self.step_robot(index, part, dt_s);
        }
        self.step_ball(dt_s);
    }

    fn step_robot(&mut self, index: usize, part: usize, dt_s: f64) {
        let change = self.max_acceleration_mm_s2 * dt_s;
        let robot = &mut self.robots[index];
        let (command, _) = robot.delay.until_next_frame()[part];
        let speeds = match robot.recovering {
            None => command,
            Some(speeds) => {
                let speeds = speeds.towards(command, change);
                robot.recovering = (speeds != command).then_some(speeds);
                speeds
            }
        };
        let twist = speeds.twist(self.wheel_base_mm);
        let pose = robot.slip.drive(robot.pose, speeds, twist, dt_s);
        if pose == robot.pose {
            return;
        }
        let pushed = self.try_robot(index, pose, twist);
        let robot = &mut self.robots[index];
        match pushed {
            Some(ball) => {
                robot.pose = pose;
                self.ball = ball;
            }
            None => {
                robot.recovering = Some(WheelSpeeds::default());
                robot.blocked = true;
            }
        }
    }

    /// Checks whether a robot can move to `pose`; if so, returns the ball after that.
    fn try_robot(&self, index: usize, pose: Pose, twist: Twist) -> Option<Ball> {
        let body = &self.body;
        if !self.walls.contain_robot(&pose, body) {
            return None;
        }
        let mut others = self.robots.iter().enumerate().filter(|&(other, _)| other != index);
        if others.clone().any(|(_, other)| robots_touch(&pose, &other.pose, body)) {
            return None;
        }
        let radius = self.ball_radius_mm;
        let Some(contact) = BallContact::find(&pose, body, self.ball.position, radius) else {
            return Some(self.ball);
        };
        let position = self.push_out(&pose, self.ball.position)?;
        // A ball that cannot give way (between two robots) stops the robot.
        if others.any(|(_, other)| BallContact::find(&other.pose, body, position, radius).is_some())
        {
            return None;
        }
        let velocity = contact.bounce(self.ball.velocity_mm_s, &pose, twist, ROBOT_RESTITUTION);
        Some(Ball { position, velocity_mm_s: limited(velocity) })
    }

    /// The position of a ball after a robot's new pose has pushed it out of the robot, along the walls if
    /// needed. `None` if there is no free position within reach.
    fn push_out(&self, pose: &Pose, ball: FieldPoint) -> Option<FieldPoint> {
        let radius = self.ball_radius_mm;
        let mut ball = ball;
        for _ in 0..6 {
            let Some(contact) = BallContact::find(pose, &self.body, ball, radius) else {
                return Some(ball);
            };
            let push = contact.depth_mm + 1e-6;
            ball = self.walls.clamp_ball(
                FieldPoint::new(
                    ball.x_mm + push * contact.normal[0],
                    ball.y_mm + push * contact.normal[1],
                ),
                radius,
            );
        }
        None
    }

    fn step_ball(&mut self, dt_s: f64) {
        let [vx, vy] = self.ball.velocity_mm_s;
        if vx == 0.0 && vy == 0.0 {
            return;
        }
        let keep = (1.0 - self.ball_friction_per_s).max(0.0).powf(dt_s);
        let mut velocity = [vx * keep, vy * keep];
        let mut position = FieldPoint::new(
            self.ball.position.x_mm + velocity[0] * dt_s,
            self.ball.position.y_mm + velocity[1] * dt_s,
        );
        let reflect = |place: &mut f64, speed: &mut f64, half: f64| {
            let limit = half - self.ball_radius_mm;
            if place.abs() > limit {
                *place = limit.copysign(*place);
                *speed *= -WALL_RESTITUTION;
            }
        };
        reflect(&mut position.x_mm, &mut velocity[0], self.walls.half_length_mm);
        reflect(&mut position.y_mm, &mut velocity[1], self.walls.half_width_mm);
        for robot in &self.robots {
            let contact = BallContact::find(&robot.pose, &self.body, position, self.ball_radius_mm);
            if let Some(contact) = contact {
                velocity = contact.bounce(velocity, &robot.pose, robot.twist, ROBOT_RESTITUTION);
                position = self.ball.position;
            }
        }
        if velocity[0].hypot(velocity[1]) < REST_MM_S {
            velocity = [0.0; 2];
        }
        self.ball = Ball { position, velocity_mm_s: limited(velocity) };
    }

    /// Puts a ball that lies still for long back into play.
    fn push_idle_ball(&mut self) {
        let [vx, vy] = self.ball.velocity_mm_s;
        let idle = vx.hypot(vy) < 50.0;
        self.ball_idle_s = if idle { self.ball_idle_s + self.period_s } else { 0.0 };
        if self.ball_idle_s > FREE_BALL_S {
            self.ball_idle_s = 0.0;
            let speed = self.random.range(400.0, 1200.0);
            self.push_ball(speed);
        }
    }

    fn push_ball(&mut self, speed_mm_s: f64) {
        let (sin, cos) = self.random.range(0.0, std::f64::consts::TAU).sin_cos();
        self.ball.velocity_mm_s = [speed_mm_s * cos, speed_mm_s * sin];
    }

    /// All robots choose their next commands, knowing this frame.
    fn decide(&mut self) {
        self.poses.clear();
        self.poses.extend(self.robots.iter().map(|robot| robot.pose));
        let change = self.max_acceleration_mm_s2 * self.period_s;
        for index in 0..self.robots.len() {
            let around = Surroundings {
                ball_is_chased: self.robots.iter().filter(|r| r.behaviour.chases_ball()).count()
                    >= MAX_CHASERS,
                ..self.surroundings()
            };
            let robot = &self.robots[index];
            let mut behaviour = robot.behaviour.clone();
            let predicted = robot.delay.predict(robot.pose, self.wheel_base_mm);
            let wanted = behaviour.decide(predicted, robot.blocked, &around, self.period_s);
            let wanted = match robot.ordered {
                Some((ordered, _)) => ordered,
                None => {
                    WheelSpeeds::from_twist(wanted, self.wheel_base_mm).limited(self.max_speed_mm_s)
                }
            };
            let command = robot.delay.newest().towards(wanted, change);

            let robot = &mut self.robots[index];
            robot.behaviour = behaviour;
            robot.ordered =
                robot.ordered.and_then(|(speeds, frames)| Some((speeds, frames.checked_sub(1)?)));
            robot.delay.send(command);
            let speeds = robot.recovering.unwrap_or(robot.delay.acting());
            robot.twist = speeds.twist(self.wheel_base_mm);
        }
    }

    fn surroundings(&self) -> Surroundings<'_> {
        Surroundings {
            robots: &self.poses,
            ball: self.ball.position,
            ball_is_chased: false,
            walls: self.walls,
            size_mm: self.size_mm,
            max_speed_mm_s: self.max_speed_mm_s,
            max_acceleration_mm_s2: self.max_acceleration_mm_s2,
            delay_s: self.delay_s,
        }
    }
}

fn limited([vx, vy]: [f64; 2]) -> [f64; 2] {
    let speed = vx.hypot(vy);
    let scale = if speed > MAX_BALL_SPEED_MM_S { MAX_BALL_SPEED_MM_S / speed } else { 1.0 };
    [vx * scale, vy * scale]
}
