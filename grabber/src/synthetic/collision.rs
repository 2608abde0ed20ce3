//! Contact geometry: robots are squares or discs with a flat front, the ball is a disc, the field is a box.
//!
//! A ball of radius r touches a robot if the point p of the body nearest to its centre c is closer than r.
//! The contact has the depth r − |c − p| and the normal (c − p)/|c − p|; for a centre inside the body they
//! follow from the nearest side. The ball bounces as off a body of infinite mass. With u the velocity of the
//! robot's contact point and n the normal, a negative normal component of v − u is reversed and multiplied by
//! the restitution e:
//!
//! ```text
//! v' = v − (1 + e)·((v − u)·n)·n
//! ```

use super::motion::Twist;
use geometry::body::Body;
use geometry::{FieldPoint, Pose};

/// Minimum distance of robots from each other and from the walls.
const GAP_MM: f64 = 0.5;

/// The inside of the walls, relative to the middle of the field.
#[derive(Debug, Clone, Copy)]
pub struct Walls {
    /// Half the field's length.
    pub half_length_mm: f64,
    /// Half the field's width.
    pub half_width_mm: f64,
}

impl Walls {
    /// Whether a robot is inside the walls. A disc counts without its flat front.
    pub fn contain_robot(&self, pose: &Pose, body: &Body) -> bool {
        let (sin, cos) = pose.orientation.sin_cos();
        let along = if body.is_round() { 1.0 } else { sin.abs() + cos.abs() };
        let reach = body.half_mm() * along + GAP_MM;
        pose.position.x_mm.abs() + reach <= self.half_length_mm
            && pose.position.y_mm.abs() + reach <= self.half_width_mm
    }

    /// The nearest position inside the walls for a ball.
    pub fn clamp_ball(&self, center: FieldPoint, radius_mm: f64) -> FieldPoint {
        let keep = |value: f64, half: f64| {
            let limit = (half - radius_mm).max(0.0);
            value.clamp(-limit, limit)
        };
        FieldPoint::new(
            keep(center.x_mm, self.half_length_mm),
            keep(center.y_mm, self.half_width_mm),
        )
    }

    /// Whether a ball is inside the walls.
    pub fn contain_ball(&self, center: FieldPoint, radius_mm: f64) -> bool {
        center.x_mm.abs() + radius_mm <= self.half_length_mm
            && center.y_mm.abs() + radius_mm <= self.half_width_mm
    }
}

/// Whether two robots overlap or nearly touch.
pub fn robots_touch(a: &Pose, b: &Pose, body: &Body) -> bool {
    let body = body.grown(GAP_MM);
    body.overlaps(a, &body, b)
}

/// Contact of a ball with a robot.
#[derive(Debug, Clone, Copy)]
pub struct BallContact {
    /// Penetration depth.
    pub depth_mm: f64,
    /// Unit normal away from the robot, in field coordinates.
    pub normal: [f64; 2],
    /// The robot's contact point, relative to its centre, in field coordinates.
    pub arm_mm: [f64; 2],
}

impl BallContact {
    /// The contact between a ball and a robot, if they touch.
    pub fn find(robot: &Pose, body: &Body, center: FieldPoint, radius_mm: f64) -> Option<Self> {
        let (dx, dy) = (center.x_mm - robot.position.x_mm, center.y_mm - robot.position.y_mm);
        let far = body.reach_mm() + radius_mm;
        if dx * dx + dy * dy >= far * far {
            return None;
        }
        let (sin, cos) = robot.orientation.sin_cos();
        let (x, y) = (dx * cos + dy * sin, dy * cos - dx * sin);
        let near =
            if body.is_round() { near_disc(body, [x, y]) } else { near_square(body, [x, y]) };
        let (away_x, away_y) = (x - near[0], y - near[1]);
        let distance = away_x.hypot(away_y);
        let (depth_mm, [nx, ny], [ax, ay]) = if distance > 1e-9 {
            (radius_mm - distance, [away_x / distance, away_y / distance], near)
        } else {
            // The centre itself is inside: out through the nearest side.
            let (normal, side) = nearest_side(body, [x, y]);
            (radius_mm + body.depth_mm([x, y]), normal, side)
        };
        let rotate = |x: f64, y: f64| [x * cos - y * sin, x * sin + y * cos];
        (depth_mm > 0.0).then(|| Self { depth_mm, normal: rotate(nx, ny), arm_mm: rotate(ax, ay) })
    }

    /// The ball's velocity after a bounce off the robot, which moves with `twist` and has infinite mass.
    pub fn bounce(
        &self,
        velocity_mm_s: [f64; 2],
        robot: &Pose,
        twist: Twist,
        restitution: f64,
    ) -> [f64; 2] {
        let (sin, cos) = robot.orientation.sin_cos();
        let point = [
            twist.v_mm_s * cos - twist.omega * self.arm_mm[1],
            twist.v_mm_s * sin + twist.omega * self.arm_mm[0],
        ];
        let approach = (velocity_mm_s[0] - point[0]) * self.normal[0]
            + (velocity_mm_s[1] - point[1]) * self.normal[1];
        if approach >= 0.0 {
            return velocity_mm_s;
        }
        let change = -(1.0 + restitution) * approach;
        [velocity_mm_s[0] + change * self.normal[0], velocity_mm_s[1] + change * self.normal[1]]
    }
}

/// The nearest point of a square.
fn near_square(body: &Body, [x, y]: [f64; 2]) -> [f64; 2] {
    let half = body.half_mm();
    [x.clamp(-half, half), y.clamp(-half, half)]
}

/// The nearest point of a disc with a flat front.
fn near_disc(body: &Body, [x, y]: [f64; 2]) -> [f64; 2] {
    let (radius, front) = (body.half_mm(), body.front_mm());
    let half_front = (radius * radius - front * front).max(0.0).sqrt();
    // Ahead of the front, the nearest point is on it.
    if x > front && y.abs() <= half_front * x / front {
        return [front, y.clamp(-half_front, half_front)];
    }
    let inward = (radius / x.hypot(y).max(1e-9)).min(1.0);
    [inward * x, inward * y]
}

/// For a point inside: the normal of the nearest side, and the nearest point on it.
fn nearest_side(body: &Body, [x, y]: [f64; 2]) -> ([f64; 2], [f64; 2]) {
    let half = body.half_mm();
    if body.is_round() {
        let (radius, front) = (x.hypot(y), body.front_mm());
        if front - x < half - radius || radius < 1e-9 {
            return ([1.0, 0.0], [front, y]);
        }
        ([x / radius, y / radius], [half * x / radius, half * y / radius])
    } else if x.abs() > y.abs() {
        ([1f64.copysign(x), 0.0], [half.copysign(x), y])
    } else {
        ([0.0, 1f64.copysign(y)], [x, half.copysign(y)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::{Config, RobotShape, RobotsConfig};

    fn pose(x_mm: f64, y_mm: f64, degrees: f64) -> Pose {
        Pose { position: FieldPoint::new(x_mm, y_mm), orientation: degrees.to_radians() }
    }

    /// Half side or radius 10; a disc with its front at 8.
    fn body(shape: RobotShape) -> Body {
        let front_mm = (shape == RobotShape::Round).then_some(8.0);
        let robots = RobotsConfig { shape, size_mm: 20.0, front_mm, ..Config::default().robots };
        robots.body(&[])
    }

    #[test]
    fn corners_must_be_inside_the_walls() {
        let walls = Walls { half_length_mm: 100.0, half_width_mm: 50.0 };
        assert!(walls.contain_robot(&pose(89.0, 39.0, 0.0), &body(RobotShape::Square)));
        assert!(!walls.contain_robot(&pose(89.0, 0.0, 45.0), &body(RobotShape::Square)));
        assert!(walls.contain_ball(FieldPoint::new(0.0, -40.0), 10.0));
        assert!(!walls.contain_ball(FieldPoint::new(0.0, -40.1), 10.0));
    }

    #[test]
    fn a_ball_bounces_off_a_side_and_is_carried_along() {
        let robot = pose(0.0, 0.0, 90.0);
        let square = body(RobotShape::Square);
        // In front of the robot (which faces y), 1 mm too near.
        let contact = BallContact::find(&robot, &square, FieldPoint::new(2.0, 14.0), 5.0)
            .expect("they touch");
        assert!((contact.depth_mm - 1.0).abs() < 1e-9);
        assert!(contact.normal[0].abs() < 1e-9 && (contact.normal[1] - 1.0).abs() < 1e-9);
        let pushed =
            contact.bounce([0.0, -100.0], &robot, Twist { v_mm_s: 300.0, omega: 0.0 }, 0.5);
        // Approaches with 400, so it leaves with 200 relative to the robot.
        assert!((pushed[1] - 500.0).abs() < 1e-9);
        assert_eq!(contact.bounce([0.0, 900.0], &robot, Twist::default(), 0.5), [0.0, 900.0]);
        assert!(BallContact::find(&robot, &square, FieldPoint::new(2.0, 15.1), 5.0).is_none());
        // A corner reaches less far than both sides together.
        assert!(BallContact::find(&robot, &square, FieldPoint::new(13.6, 13.6), 5.0).is_none());
        assert!(BallContact::find(&robot, &square, FieldPoint::new(13.5, 13.5), 5.0).is_some());
    }

    #[test]
    fn a_ball_touches_rim_and_front_of_a_round_robot() {
        let (robot, disc) = (pose(0.0, 0.0, 90.0), body(RobotShape::Round));
        let depth = |x, y| {
            let contact = BallContact::find(&robot, &disc, FieldPoint::new(x, y), 5.0);
            contact.map_or(0.0, |contact| contact.depth_mm)
        };
        // It faces y: its front is nearer there than its rim elsewhere.
        assert!((depth(2.0, 12.0) - 1.0).abs() < 1e-9);
        assert!((depth(0.0, -14.0) - 1.0).abs() < 1e-9 && (depth(14.0, 0.0) - 1.0).abs() < 1e-9);
        assert_eq!(depth(0.0, 13.1), 0.0);
        // The centre of the ball inside: out through the nearest side.
        let inside = BallContact::find(&robot, &disc, FieldPoint::new(0.0, 7.0), 5.0).unwrap();
        assert!((inside.depth_mm - 6.0).abs() < 1e-9 && inside.normal[1] > 0.99);
    }
}
