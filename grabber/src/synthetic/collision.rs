//! Who touches whom: robots are squares, the ball is a disc, the field is a box.

use super::motion::Twist;
use common::geometry::{FieldPoint, Pose};

/// Robots keep this far apart and from the walls.
const GAP_MM: f64 = 0.5;

/// The inside of the walls, seen from the middle of the field.
#[derive(Debug, Clone, Copy)]
pub struct Walls {
    /// Half the field's length.
    pub half_length_mm: f64,
    /// Half the field's width.
    pub half_width_mm: f64,
}

impl Walls {
    /// Whether a square robot stands inside the walls.
    pub fn hold_robot(&self, pose: &Pose, half_size_mm: f64) -> bool {
        let (sin, cos) = pose.orientation.sin_cos();
        let reach = half_size_mm * (sin.abs() + cos.abs()) + GAP_MM;
        pose.position.x_mm.abs() + reach <= self.half_length_mm
            && pose.position.y_mm.abs() + reach <= self.half_width_mm
    }

    /// The nearest place inside the walls for a ball.
    pub fn keep_ball(&self, center: FieldPoint, radius_mm: f64) -> FieldPoint {
        let keep = |value: f64, half: f64| {
            let limit = (half - radius_mm).max(0.0);
            value.clamp(-limit, limit)
        };
        FieldPoint::new(
            keep(center.x_mm, self.half_length_mm),
            keep(center.y_mm, self.half_width_mm),
        )
    }

    /// Whether a ball lies inside the walls.
    pub fn hold_ball(&self, center: FieldPoint, radius_mm: f64) -> bool {
        center.x_mm.abs() + radius_mm <= self.half_length_mm
            && center.y_mm.abs() + radius_mm <= self.half_width_mm
    }
}

/// Whether two square robots of the same size overlap or nearly touch (separating axes).
pub fn robots_touch(a: &Pose, b: &Pose, half_size_mm: f64) -> bool {
    squares_overlap(a, b, half_size_mm + GAP_MM)
}

/// Whether two squares of half side `half_mm` share a point.
pub fn squares_overlap(a: &Pose, b: &Pose, half_mm: f64) -> bool {
    let (dx, dy) = (b.position.x_mm - a.position.x_mm, b.position.y_mm - a.position.y_mm);
    let distance2 = dx * dx + dy * dy;
    if distance2 >= 8.0 * half_mm * half_mm {
        return false;
    }
    if distance2 < 4.0 * half_mm * half_mm {
        // Their inscribed circles overlap.
        return true;
    }
    let (sin, cos) = (b.orientation - a.orientation).sin_cos();
    // Half the extent of one square along an axis of the other, plus the other's own half side.
    let reach = half_mm * (1.0 + sin.abs() + cos.abs());
    [a.orientation, b.orientation].iter().all(|axis| {
        let (sin, cos) = axis.sin_cos();
        (dx * cos + dy * sin).abs() < reach && (dy * cos - dx * sin).abs() < reach
    })
}

/// How a ball touches a robot.
#[derive(Debug, Clone, Copy)]
pub struct BallContact {
    /// How far the ball reaches into the robot.
    pub depth_mm: f64,
    /// Away from the robot, of length 1, in field coordinates.
    pub normal: [f64; 2],
    /// The touching point of the robot, relative to its centre, in field coordinates.
    pub arm_mm: [f64; 2],
}

impl BallContact {
    /// The contact between a ball and a square robot, if they touch.
    pub fn find(
        robot: &Pose,
        half_size_mm: f64,
        center: FieldPoint,
        radius_mm: f64,
    ) -> Option<Self> {
        let (dx, dy) = (center.x_mm - robot.position.x_mm, center.y_mm - robot.position.y_mm);
        let far = half_size_mm * std::f64::consts::SQRT_2 + radius_mm;
        if dx * dx + dy * dy >= far * far {
            return None;
        }
        let (sin, cos) = robot.orientation.sin_cos();
        let (x, y) = (dx * cos + dy * sin, dy * cos - dx * sin);
        let near = [x.clamp(-half_size_mm, half_size_mm), y.clamp(-half_size_mm, half_size_mm)];
        let (away_x, away_y) = (x - near[0], y - near[1]);
        let distance = away_x.hypot(away_y);
        let (depth_mm, [nx, ny], [ax, ay]) = if distance > 1e-9 {
            (radius_mm - distance, [away_x / distance, away_y / distance], near)
        } else if x.abs() > y.abs() {
            // The centre itself is inside: out through the nearest side.
            let side = half_size_mm.copysign(x);
            (radius_mm + half_size_mm - x.abs(), [1f64.copysign(x), 0.0], [side, y])
        } else {
            let side = half_size_mm.copysign(y);
            (radius_mm + half_size_mm - y.abs(), [0.0, 1f64.copysign(y)], [x, side])
        };
        let rotate = |x: f64, y: f64| [x * cos - y * sin, x * sin + y * cos];
        (depth_mm > 0.0).then(|| Self { depth_mm, normal: rotate(nx, ny), arm_mm: rotate(ax, ay) })
    }

    /// A ball's velocity after it bounced off the robot, which moves with `twist` and is too heavy
    /// to notice.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x_mm: f64, y_mm: f64, degrees: f64) -> Pose {
        Pose { position: FieldPoint::new(x_mm, y_mm), orientation: degrees.to_radians() }
    }

    #[test]
    fn squares_touch_exactly_where_they_should() {
        // Side by side: the sum of two half sides. Corner against side: half side and half diagonal.
        for (degrees, touch) in [(0.0, 20.0), (45.0, 10.0 + 10.0 * 2f64.sqrt())] {
            let a = pose(5.0, 7.0, 0.0);
            assert!(squares_overlap(&a, &pose(5.0 + touch - 0.01, 7.0, degrees), 10.0));
            assert!(!squares_overlap(&a, &pose(5.0 + touch + 0.01, 7.0, degrees), 10.0));
        }
        // Two squares on their corners.
        let apart = 20.0 * 2f64.sqrt();
        assert!(squares_overlap(&pose(0.0, 0.0, 45.0), &pose(apart - 0.01, 0.0, 45.0), 10.0));
        assert!(!squares_overlap(&pose(0.0, 0.0, 45.0), &pose(apart + 0.01, 0.0, 45.0), 10.0));
    }

    #[test]
    fn walls_count_corners() {
        let walls = Walls { half_length_mm: 100.0, half_width_mm: 50.0 };
        assert!(walls.hold_robot(&pose(89.0, 39.0, 0.0), 10.0));
        assert!(!walls.hold_robot(&pose(89.0, 0.0, 45.0), 10.0));
        assert!(walls.hold_ball(FieldPoint::new(0.0, -40.0), 10.0));
        assert!(!walls.hold_ball(FieldPoint::new(0.0, -40.1), 10.0));
    }

    #[test]
    fn a_ball_bounces_off_a_side_and_is_carried_along() {
        let robot = pose(0.0, 0.0, 90.0);
        // In front of the robot (which looks along y), 1 mm too near.
        let contact =
            BallContact::find(&robot, 10.0, FieldPoint::new(2.0, 14.0), 5.0).expect("they touch");
        assert!((contact.depth_mm - 1.0).abs() < 1e-9);
        assert!(contact.normal[0].abs() < 1e-9 && (contact.normal[1] - 1.0).abs() < 1e-9);
        let pushed =
            contact.bounce([0.0, -100.0], &robot, Twist { v_mm_s: 300.0, omega: 0.0 }, 0.5);
        // Approach 400, so it leaves with 200 relative to the robot.
        assert!((pushed[1] - 500.0).abs() < 1e-9);
        assert_eq!(contact.bounce([0.0, 900.0], &robot, Twist::default(), 0.5), [0.0, 900.0]);
        assert!(BallContact::find(&robot, 10.0, FieldPoint::new(2.0, 15.1), 5.0).is_none());
        // A corner reaches less far than both sides together.
        assert!(BallContact::find(&robot, 10.0, FieldPoint::new(13.6, 13.6), 5.0).is_none());
        assert!(BallContact::find(&robot, 10.0, FieldPoint::new(13.5, 13.5), 5.0).is_some());
    }
}
