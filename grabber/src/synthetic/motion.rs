//! Kinematics of a robot with two driven wheels (eq. 7), and the delay of its commands.

use geometry::{FieldPoint, Pose, wrap_angle};
use std::collections::VecDeque;

/// Circumferential speeds of the two wheels.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WheelSpeeds {
    /// Left wheel.
    pub left_mm_s: f64,
    /// Right wheel.
    pub right_mm_s: f64,
}

/// Speed along the heading and turning rate.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Twist {
    /// Speed along the heading.
    pub v_mm_s: f64,
    /// Turning rate, rad/s, counter-clockwise.
    pub omega: f64,
}

impl WheelSpeeds {
    /// The wheel speeds that give a twist.
    pub fn from_twist(twist: Twist, wheel_base_mm: f64) -> Self {
        let difference = twist.omega * wheel_base_mm / 2.0;
        Self { left_mm_s: twist.v_mm_s - difference, right_mm_s: twist.v_mm_s + difference }
    }

    /// Eq. (7), seen from the robot.
    pub fn twist(self, wheel_base_mm: f64) -> Twist {
        Twist {
            v_mm_s: (self.right_mm_s + self.left_mm_s) / 2.0,
            omega: (self.right_mm_s - self.left_mm_s) / wheel_base_mm,
        }
    }

    /// The same curve at a speed at which no wheel turns faster than `limit_mm_s`.
    pub fn limited(self, limit_mm_s: f64) -> Self {
        let fastest = self.left_mm_s.abs().max(self.right_mm_s.abs());
        if fastest <= limit_mm_s {
            return self;
        }
        let scale = limit_mm_s / fastest;
        Self { left_mm_s: self.left_mm_s * scale, right_mm_s: self.right_mm_s * scale }
    }

    /// The wheel speeds nearest to `target` if each may change by at most `change_mm_s`.
    pub fn towards(self, target: Self, change_mm_s: f64) -> Self {
        let step = |from: f64, to: f64| {
            let change = to - from;
            if change.abs() <= change_mm_s { to } else { from + change_mm_s.copysign(change) }
        };
        Self {
            left_mm_s: step(self.left_mm_s, target.left_mm_s),
            right_mm_s: step(self.right_mm_s, target.right_mm_s),
        }
    }
}

/// The pose after `dt_s` with a constant twist: eq. (7) integrated exactly, an arc. A robot at rest keeps its
/// pose to the last bit.
pub fn drive(pose: Pose, twist: Twist, dt_s: f64) -> Pose {
    let turn = twist.omega * dt_s;
    let way = twist.v_mm_s * dt_s;
    if turn == 0.0 && way == 0.0 {
        return pose;
    }
    // The chord of the arc points along the mean heading and is shorter than the arc by sin(turn/2) /
    // (turn/2).
    let half = turn / 2.0;
    let chord =
        if half.abs() < 1e-4 { way * (1.0 - half * half / 6.0) } else { way * half.sin() / half };
    let (sin, cos) = (pose.orientation + half).sin_cos();
    Pose {
        position: FieldPoint::new(
            pose.position.x_mm + chord * cos,
            pose.position.y_mm + chord * sin,
        ),
        orientation: wrap_angle(pose.orientation + turn),
    }
}

/// Commands under way to a robot: one is sent per frame, and acts from `delay` after it was sent until the
/// next one does.
#[derive(Debug, Clone)]
pub struct CommandDelay {
    /// Oldest first; the first one acts at the instant of the current frame.
    pending: VecDeque<WheelSpeeds>,
    /// Time after the instant of a frame for which the command that acted there continues to act.
    rest_s: f64,
    period_s: f64,
}

impl CommandDelay {
    /// For a robot that has been sent `speeds` for a long time.
    pub fn new(speeds: WheelSpeeds, delay_s: f64, period_s: f64) -> Self {
        // A delay of a whole number of frames, up to rounding, must not leave a tiny rest.
        let frames = delay_s / period_s;
        let whole = (frames + 1e-6).floor();
        let rest_s = ((frames - whole) * period_s).max(0.0);
        let rest_s = if rest_s < 1e-6 * period_s { 0.0 } else { rest_s };
        // One for each whole frame of delay, the newest, and the one about to end.
        let count = whole as usize + 1 + usize::from(rest_s > 0.0);
        Self { pending: std::iter::repeat_n(speeds, count).collect(), rest_s, period_s }
    }

    /// The command sent last.
    pub fn newest(&self) -> WheelSpeeds {
        self.pending.back().copied().unwrap_or_default()
    }

    /// The command that acts from the instant of the current frame on.
    pub fn acting(&self) -> WheelSpeeds {
        self.pending.front().copied().unwrap_or_default()
    }

    /// The commands that act between the current frame and the next: speeds, and durations in seconds. The
    /// second duration may be 0.
    pub fn until_next_frame(&self) -> [(WheelSpeeds, f64); 2] {
        if self.rest_s == 0.0 {
            return [(self.acting(), self.period_s), (self.acting(), 0.0)];
        }
        let second = self.pending.get(1).copied().unwrap_or_default();
        [(self.acting(), self.rest_s), (second, self.period_s - self.rest_s)]
    }

    /// Advances to the next frame, at which `command` is sent.
    pub fn send(&mut self, command: WheelSpeeds) {
        self.pending.pop_front();
        self.pending.push_back(command);
    }

    /// The pose at which a command sent at the next [`send`](Self::send) begins to act, for a robot that will
    /// be at `pose` at that `send`.
    pub fn predict(&self, pose: Pose, wheel_base_mm: f64) -> Pose {
        let mut pose = pose;
        // The first pending command will have been dropped by then.
        let mut pending = self.pending.iter().skip(1);
        if self.rest_s > 0.0
            && let Some(speeds) = pending.next()
        {
            pose = drive(pose, speeds.twist(wheel_base_mm), self.rest_s);
        }
        for speeds in pending {
            pose = drive(pose, speeds.twist(wheel_base_mm), self.period_s);
        }
        pose
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BASE: f64 = 65.0;

    fn speeds(left_mm_s: f64, right_mm_s: f64) -> WheelSpeeds {
        WheelSpeeds { left_mm_s, right_mm_s }
    }

    #[test]
    fn an_arc_equals_many_small_euler_steps() {
        let start = Pose { position: FieldPoint::new(100.0, -50.0), orientation: 2.9 };
        for wheels in [speeds(400.0, 700.0), speeds(300.0, 300.0), speeds(-200.0, 200.0)] {
            let twist = wheels.twist(BASE);
            let exact = drive(start, twist, 0.5);
            let (mut x, mut y, mut theta) = (100.0, -50.0, 2.9f64);
            let steps = 200_000;
            let dt = 0.5 / f64::from(steps);
            for _ in 0..steps {
                x += 0.5 * theta.cos() * (wheels.right_mm_s + wheels.left_mm_s) * dt;
                y += 0.5 * theta.sin() * (wheels.right_mm_s + wheels.left_mm_s) * dt;
                theta += (wheels.right_mm_s - wheels.left_mm_s) / BASE * dt;
            }
            assert!(exact.position.distance(FieldPoint::new(x, y)) < 2e-3, "{exact:?} {x} {y}");
            assert!(wrap_angle(exact.orientation - theta).abs() < 1e-9);
        }
    }

    #[test]
    fn two_halves_of_an_arc_make_the_whole() {
        let start = Pose { position: FieldPoint::new(0.0, 0.0), orientation: -3.0 };
        let twist = speeds(200.0, 900.0).twist(BASE);
        let whole = drive(start, twist, 0.0125);
        let halves = drive(drive(start, twist, 0.005), twist, 0.0075);
        assert!(whole.position.distance(halves.position) < 1e-9);
        assert!(wrap_angle(whole.orientation - halves.orientation).abs() < 1e-12);
    }

    #[test]
    fn wheel_speeds_and_twists_are_inverses() {
        let wheels = speeds(-120.0, 340.0);
        let back = WheelSpeeds::from_twist(wheels.twist(BASE), BASE);
        assert!((back.left_mm_s - wheels.left_mm_s).abs() < 1e-9);
        assert!((back.right_mm_s - wheels.right_mm_s).abs() < 1e-9);
    }

    #[test]
    fn limits_hold() {
        let fast = speeds(3000.0, -1500.0).limited(1500.0);
        assert_eq!(fast, speeds(1500.0, -750.0));
        assert_eq!(speeds(0.0, 100.0).towards(speeds(50.0, 90.0), 20.0), speeds(20.0, 90.0));
    }

    /// Sends 1, 2, 3, … and returns the commands that acted, as (time, left speed).
    fn timeline(delay_s: f64, period_s: f64) -> Vec<(f64, f64)> {
        let mut delay = CommandDelay::new(speeds(0.0, 0.0), delay_s, period_s);
        let mut changes = Vec::new();
        let mut last = 0.0;
        for frame in 0..20 {
            // Before frame 0 the robot has had command 0 for ever.
            if frame > 0 {
                delay.send(speeds(f64::from(frame), 0.0));
            }
            let mut t = f64::from(frame) * period_s;
            for (acting, duration) in delay.until_next_frame() {
                if duration > 0.0 && acting.left_mm_s != last {
                    last = acting.left_mm_s;
                    changes.push((t, last));
                }
                t += duration;
            }
        }
        changes
    }

    #[test]
    fn a_command_acts_exactly_the_delay_after_it_was_sent() {
        let period = 0.0125;
        for delay in [0.0, 0.003, 0.0125, 0.05, 0.0437] {
            let changes = timeline(delay, period);
            assert!(changes.len() > 10);
            for (t, number) in changes {
                let sent = number * period;
                assert!((t - sent - delay).abs() < 1e-9, "delay {delay}: {number} acted at {t}");
            }
        }
    }

    #[test]
    fn the_prediction_comes_true() {
        let period = 0.0125;
        for delay_s in [0.0, 0.003, 0.05, 0.0437] {
            let mut delay = CommandDelay::new(speeds(100.0, 200.0), delay_s, period);
            let mut pose = Pose::default();
            let mut predictions: Vec<(f64, Pose)> = Vec::new();
            let mut checked = 0;
            for frame in 0..30 {
                let mut t = f64::from(frame) * period;
                for (acting, duration) in delay.until_next_frame() {
                    let twist = acting.twist(BASE);
                    for (due, predicted) in &predictions {
                        if *due >= t - 1e-9 && *due < t + duration - 1e-9 {
                            let there = drive(pose, twist, (due - t).max(0.0));
                            assert!(there.position.distance(predicted.position) < 1e-6);
                            checked += 1;
                        }
                    }
                    pose = drive(pose, twist, duration);
                    t += duration;
                }
                predictions.push((t + delay_s, delay.predict(pose, BASE)));
                delay.send(speeds(100.0 + 20.0 * f64::from(frame), 200.0));
            }
            assert!(checked > 20, "only {checked} predictions came due");
        }
    }
}
