//! Simulated strategies: not football, but all situations that a vision system has to cope with. Robots drive
//! to random places, turn on the spot, chase the ball, run into each other and the walls and back off again,
//! and stand for a good part of the time.

use super::collision::Walls;
use super::motion::Twist;
use super::random::Random;
use geometry::{FieldPoint, Pose, wrap_angle};

/// Maximum commanded turning rate, rad/s.
const MAX_TURN_RATE: f64 = 6.0;
/// Distance below which a robot steers around another one, robot sizes.
const KEEP_CLEAR_SIZES: f64 = 2.6;
/// Time after which a robot reacts to an obstruction, besides the delay of its commands.
const REACTION_S: f64 = 0.12;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Task {
    Stand,
    Drive { target: FieldPoint, speed_mm_s: f64 },
    Turn { omega: f64 },
    Chase { speed_mm_s: f64 },
    BackOff { speed_mm_s: f64, omega: f64 },
}

/// A robot's knowledge about the pitch.
#[derive(Debug, Clone, Copy)]
pub struct Surroundings<'a> {
    /// Every robot.
    pub robots: &'a [Pose],
    /// The ball.
    pub ball: FieldPoint,
    /// Whether enough robots chase the ball already.
    pub ball_is_chased: bool,
    /// The walls.
    pub walls: Walls,
    /// Side of a robot.
    pub size_mm: f64,
    /// Maximum speed of a robot.
    pub max_speed_mm_s: f64,
    /// Maximum acceleration of a robot.
    pub max_acceleration_mm_s2: f64,
    /// Delay until a command acts.
    pub delay_s: f64,
}

/// The strategy of one robot.
#[derive(Debug, Clone)]
pub struct Behaviour {
    own: usize,
    task: Task,
    remaining_s: f64,
    blocked_s: f64,
    random: Random,
}

impl Behaviour {
    /// For robot number `own` of [`Surroundings::robots`]; it begins with standing for a few seconds, or with
    /// driving.
    pub fn new(own: usize, stands: bool, mut random: Random, around: &Surroundings) -> Self {
        let mut behaviour = Self {
            own,
            task: Task::Stand,
            remaining_s: 0.0,
            blocked_s: 0.0,
            random: random.clone(),
        };
        if stands {
            behaviour.remaining_s = random.range(2.5, 5.0);
        } else {
            behaviour.begin_drive(around);
        }
        behaviour
    }

    /// Whether it chases the ball.
    pub fn chases_ball(&self) -> bool {
        matches!(self.task, Task::Chase { .. })
    }

    /// The next motion of a robot that will be at `pose` when the command sent now acts. `blocked` tells
    /// whether it is obstructed at this moment.
    pub fn decide(&mut self, pose: Pose, blocked: bool, around: &Surroundings, dt_s: f64) -> Twist {
        self.remaining_s -= dt_s;
        self.blocked_s = if blocked { self.blocked_s + dt_s } else { 0.0 };
        if self.blocked_s > REACTION_S + 2.0 * around.delay_s {
            self.begin_back_off();
        } else if self.remaining_s <= 0.0 || self.has_arrived(&pose, around) {
            self.choose_next(around);
        }
        match self.task {
            Task::Stand => Twist::default(),
            Task::Turn { omega } => Twist { v_mm_s: 0.0, omega },
            Task::BackOff { speed_mm_s, omega } => Twist { v_mm_s: speed_mm_s, omega },
            Task::Drive { target, speed_mm_s } => {
                let brake =
                    (0.6 * around.max_acceleration_mm_s2 * pose.position.distance(target)).sqrt();
                self.drive_towards(pose, target, speed_mm_s.min(brake), around)
            }
            Task::Chase { speed_mm_s } => {
                let ball = self.inside(around.ball, 0.6 * around.size_mm, around);
                self.drive_towards(pose, ball, speed_mm_s, around)
            }
        }
    }

    fn has_arrived(&self, pose: &Pose, around: &Surroundings) -> bool {
        match self.task {
            Task::Drive { target, .. } => pose.position.distance(target) < 0.4 * around.size_mm,
            _ => false,
        }
    }

    fn choose_next(&mut self, around: &Surroundings) {
        let choice = self.random.unit();
        match self.task {
            Task::Stand => match choice {
                c if c < 0.25 && !around.ball_is_chased => self.begin_chase(around),
                c if c < 0.4 => self.begin_turn(),
                _ => self.begin_drive(around),
            },
            Task::Turn { .. } | Task::BackOff { .. } => match choice {
                c if c < 0.35 => self.begin_stand(),
                _ => self.begin_drive(around),
            },
            Task::Drive { .. } | Task::Chase { .. } => match choice {
                c if c < 0.6 => self.begin_stand(),
                c if c < 0.75 => self.begin_turn(),
                _ => self.begin_drive(around),
            },
        }
    }

    fn begin_stand(&mut self) {
        self.task = Task::Stand;
        self.remaining_s = self.random.range(1.0, 2.5);
    }

    fn begin_turn(&mut self) {
        let omega = self.random.range(1.0, 0.9 * MAX_TURN_RATE);
        self.task = Task::Turn { omega: if self.random.chance(0.5) { omega } else { -omega } };
        self.remaining_s = self.random.range(0.3, 1.2);
    }

    fn begin_chase(&mut self, around: &Surroundings) {
        self.task = Task::Chase { speed_mm_s: self.random.range(0.4, 0.9) * around.max_speed_mm_s };
        self.remaining_s = self.random.range(1.5, 3.0);
    }

    fn begin_drive(&mut self, around: &Surroundings) {
        let Walls { half_length_mm, half_width_mm } = around.walls;
        let anywhere = FieldPoint::new(
            self.random.range(-half_length_mm, half_length_mm),
            self.random.range(-half_width_mm, half_width_mm),
        );
        self.task = Task::Drive {
            target: self.inside(anywhere, 1.2 * around.size_mm, around),
            speed_mm_s: self.random.range(0.3, 1.0) * around.max_speed_mm_s,
        };
        self.remaining_s = 5.0;
    }

    fn begin_back_off(&mut self) {
        let speed = self.random.range(150.0, 400.0);
        // Reverse of the last direction; after that any direction, so that a cluster of robots dissolves.
        let backwards = match self.task {
            Task::Drive { .. } | Task::Chase { .. } => true,
            _ => self.random.chance(0.5),
        };
        let omega = if self.random.chance(0.5) { 0.0 } else { self.random.range(-3.0, 3.0) };
        self.task = Task::BackOff { speed_mm_s: if backwards { -speed } else { speed }, omega };
        self.remaining_s = self.random.range(0.3, 0.6);
        self.blocked_s = 0.0;
    }

    /// The nearest point at least `margin_mm` away from the walls.
    fn inside(&self, point: FieldPoint, margin_mm: f64, around: &Surroundings) -> FieldPoint {
        let clamp = |value: f64, half: f64| {
            let limit = (half - margin_mm).max(0.0);
            value.clamp(-limit, limit)
        };
        FieldPoint::new(
            clamp(point.x_mm, around.walls.half_length_mm),
            clamp(point.y_mm, around.walls.half_width_mm),
        )
    }

    fn drive_towards(
        &self,
        pose: Pose,
        target: FieldPoint,
        speed_mm_s: f64,
        around: &Surroundings,
    ) -> Twist {
        let mut speed = speed_mm_s;
        let to_target =
            FieldPoint::new(target.x_mm - pose.position.x_mm, target.y_mm - pose.position.y_mm);
        let mut direction = to_target.y_mm.atan2(to_target.x_mm);
        if let Some((bearing, nearness)) = self.obstacle(pose, direction, around) {
            // Around it on the side nearer to the desired direction.
            let side = if wrap_angle(direction - bearing) >= 0.0 { 1.0 } else { -1.0 };
            direction = bearing + side * (0.9 + 0.6 * nearness);
            speed *= 1.0 - 0.7 * nearness;
        }
        let error = wrap_angle(direction - pose.orientation);
        Twist {
            v_mm_s: speed * error.cos().max(0.0).powi(3),
            omega: (5.0 * error).clamp(-MAX_TURN_RATE, MAX_TURN_RATE),
        }
    }

    /// The nearest robot in the way: its bearing, and its nearness from 0 (far) to 1 (touching).
    fn obstacle(&self, pose: Pose, direction: f64, around: &Surroundings) -> Option<(f64, f64)> {
        let keep_clear = KEEP_CLEAR_SIZES * around.size_mm;
        around
            .robots
            .iter()
            .enumerate()
            .filter(|&(index, _)| index != self.own)
            .map(|(_, other)| {
                let (dx, dy) = (
                    other.position.x_mm - pose.position.x_mm,
                    other.position.y_mm - pose.position.y_mm,
                );
                (dx.hypot(dy), dy.atan2(dx))
            })
            .filter(|&(distance, bearing)| {
                distance < keep_clear && wrap_angle(bearing - direction).abs() < 1.0
            })
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(distance, bearing)| {
                let free = (distance - around.size_mm).max(0.0) / (keep_clear - around.size_mm);
                (bearing, 1.0 - free)
            })
    }
}
