//! The body of a robot as seen from above: a square, or a disc whose front may be cut off straight.

use crate::Pose;
use crate::layout::body_turn;
use crate::settings::{Pair, PatchConfig, RobotShape};
use std::f64::consts::{FRAC_PI_4, PI, TAU};

/// The outline of a robot in the frame of its layout.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    shape: RobotShape,
    /// Half the side of a square, radius of a disc.
    half_mm: f64,
    /// Distance from the centre to the front.
    front_mm: f64,
    /// Angle between a square body and the frame of the layout; see [`body_turn`].
    turn: f64,
}

impl Body {
    /// The body of a robot that has these patches on its top.
    ///
    /// `size_mm` is the side of a square or the diameter of a disc, `front_mm` the distance from a disc's
    /// centre to its straight front, if it has one.
    pub fn new(
        shape: RobotShape,
        size_mm: f64,
        front_mm: Option<f64>,
        patches: &[PatchConfig],
    ) -> Self {
        let half_mm = size_mm / 2.0;
        let (front_mm, turn) = match shape {
            RobotShape::Square => (half_mm, body_turn(size_mm, patches)),
            RobotShape::Round => (front_mm.unwrap_or(half_mm).min(half_mm), 0.0),
        };
        Self { shape, half_mm, front_mm, turn }
    }

    /// Half the side of a square, radius of a disc.
    pub fn half_mm(&self) -> f64 {
        self.half_mm
    }

    /// Distance from the centre to the front.
    pub fn front_mm(&self) -> f64 {
        self.front_mm
    }

    /// Whether it is a disc, with or without a flat front.
    pub fn is_round(&self) -> bool {
        self.shape == RobotShape::Round
    }

    /// The same shape, enlarged by this distance on all sides.
    pub fn grown(&self, by_mm: f64) -> Self {
        Self { half_mm: self.half_mm + by_mm, front_mm: self.front_mm + by_mm, ..*self }
    }

    /// The same shape, scaled.
    pub fn scaled(&self, factor: f64) -> Self {
        Self { half_mm: factor * self.half_mm, front_mm: factor * self.front_mm, ..*self }
    }

    /// Distance from the centre to the farthest point.
    pub fn reach_mm(&self) -> f64 {
        match self.shape {
            RobotShape::Square => self.half_mm * std::f64::consts::SQRT_2,
            RobotShape::Round => self.half_mm,
        }
    }

    /// Distance of a point of the robot's frame from the nearest side, positive inside and negative
    /// outside.
    pub fn depth_mm(&self, [x, y]: Pair) -> f64 {
        match self.shape {
            RobotShape::Square => {
                let (sin, cos) = self.turn.sin_cos();
                let (x, y) = (cos * x + sin * y, cos * y - sin * x);
                self.half_mm - x.abs().max(y.abs())
            }
            RobotShape::Round => (self.half_mm - x.hypot(y)).min(self.front_mm - x),
        }
    }

    /// Whether a point of the robot's frame lies inside.
    pub fn contains(&self, point: Pair) -> bool {
        self.depth_mm(point) > 0.0
    }

    /// The corners, counter-clockwise; a disc is approximated by a polygon.
    pub fn outline(&self) -> Vec<Pair> {
        const CORNERS: u32 = 32;
        match self.shape {
            RobotShape::Square => (0..4)
                .map(|corner| self.turn + FRAC_PI_4 + f64::from(corner) * PI / 2.0)
                .map(|angle| [self.reach_mm() * angle.cos(), self.reach_mm() * angle.sin()])
                .collect(),
            RobotShape::Round => {
                let cut = self.cut();
                let step = (TAU - 2.0 * cut) / f64::from(CORNERS);
                (0..=CORNERS)
                    .map(|corner| cut + f64::from(corner) * step)
                    .map(|angle| [self.half_mm * angle.cos(), self.half_mm * angle.sin()])
                    .collect()
            }
        }
    }

    /// Whether two bodies of the same shape and size overlap.
    ///
    /// Separating axis theorem: two convex bodies overlap unless their projections onto some axis are
    /// disjoint. For squares it is enough to test the directions of their sides; discs with a flat
    /// front are tested in directions 4.5° apart.
    pub fn overlaps(&self, a: &Pose, other: &Self, b: &Pose) -> bool {
        let (dx, dy) = (b.position.x_mm - a.position.x_mm, b.position.y_mm - a.position.y_mm);
        let distance2 = dx * dx + dy * dy;
        let reach = self.reach_mm() + other.reach_mm();
        let core = self.front_mm.min(self.half_mm) + other.front_mm.min(other.half_mm);
        if distance2 >= reach * reach {
            return false;
        }
        if distance2 < core * core {
            return true;
        }
        match self.shape {
            RobotShape::Square => {
                let (a_turned, b_turned) = (a.orientation + self.turn, b.orientation + other.turn);
                let (sin, cos) = (a_turned - b_turned).sin_cos();
                // Half the extent of one square along an axis of the other, plus the other's half side.
                let reach = self.half_mm.max(other.half_mm) * (1.0 + sin.abs() + cos.abs());
                [a_turned, b_turned].iter().all(|axis| {
                    let (sin, cos) = axis.sin_cos();
                    (dx * cos + dy * sin).abs() < reach && (dy * cos - dx * sin).abs() < reach
                })
            }
            RobotShape::Round => {
                const STEPS: i32 = 20;
                let toward = dy.atan2(dx);
                (-STEPS..=STEPS).all(|step| {
                    let turn = f64::from(step) / f64::from(STEPS) * PI / 2.0;
                    let apart = distance2.sqrt() * turn.cos();
                    let axis = toward + turn;
                    self.support_mm(axis - a.orientation)
                        + other.support_mm(axis + PI - b.orientation)
                        > apart
                })
            }
        }
    }

    /// Support function of a disc with a flat front: its extent in a direction of the robot's frame.
    fn support_mm(&self, angle: f64) -> f64 {
        let from_front = angle.sin().atan2(angle.cos()).abs();
        self.half_mm * (self.cut() - from_front).max(0.0).cos()
    }

    /// Angle at the centre between the middle of the front and its end.
    fn cut(&self) -> f64 {
        (self.front_mm / self.half_mm).clamp(-1.0, 1.0).acos()
    }
}
