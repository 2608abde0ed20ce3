//! The objects on the pitch, and ray tracing through them.

use super::lens::dot;
use super::{Rgb, Vector};

/// The floor and its surroundings.
#[derive(Debug, Clone)]
pub struct Floor {
    pub color: Rgb,
    /// Relative amplitude of its grain.
    pub grain: f64,
    pub markings: Vec<Marking>,
    /// Half of the pitch's length and width, millimetres.
    pub half_mm: [f64; 2],
    /// Colour of the room's floor.
    pub around: Rgb,
}

/// A line painted on the floor.
#[derive(Debug, Clone)]
pub enum Marking {
    Line { from: [f64; 2], to: [f64; 2], width_mm: f64 },
    Circle { radius_mm: f64, width_mm: f64 },
}

/// A point lamp, and ambient light.
#[derive(Debug, Clone)]
pub struct Lamp {
    pub position: Vector,
    /// Colour of the lamp.
    pub tint: Rgb,
    /// Ambient share of the light below the lamp.
    pub ambient: f64,
}

/// The outline of a robot seen from above.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// Half of the side.
    Square(f64),
    /// Radius, and distance of the flat front from the centre.
    Disc(f64, f64),
}

/// A robot.
#[derive(Debug, Clone)]
pub struct Robot {
    pub x: f64,
    pub y: f64,
    pub heading: f64,
    pub shape: Shape,
    pub height: f64,
    /// Corners of each patch on its top, x ahead and y to the left; later patches lie above earlier
    /// ones.
    pub patches: Vec<(Vec<[f64; 2]>, Rgb)>,
}

/// A ball that lies on the floor.
#[derive(Debug, Clone)]
pub struct Ball {
    pub x: f64,
    pub y: f64,
    pub radius: f64,
    pub color: Rgb,
}

/// Everything in front of the camera.
#[derive(Debug, Clone)]
pub struct Scene {
    pub floor: Floor,
    pub lamp: Lamp,
    pub robots: Vec<Robot>,
    pub balls: Vec<Ball>,
}

/// Colour of a robot's plastic.
const BODY: Rgb = [0.035, 0.035, 0.04];
const LINE: Rgb = [0.75, 0.75, 0.72];

impl Scene {
    /// The first object on a ray (each has a number), and the light that returns along the ray.
    pub fn look(&self, from: Vector, ray: Vector) -> (u32, Rgb) {
        let along = |t: f64| [0, 1, 2].map(|axis| from[axis] + t * ray[axis]);
        let floor = along(-from[2] / ray[2]);
        let mut nearest = f64::INFINITY;
        let mut hit = None;
        for (number, ball) in self.balls.iter().enumerate() {
            if let Some(t) = ball.meet(from, ray).filter(|&t| t < nearest) {
                nearest = t;
                hit = Some((2 + number as u32, ball.normal(along(t)), ball.color, along(t)));
            }
        }
        for (number, robot) in self.robots.iter().enumerate() {
            let Some(t) = robot.meet(from, ray).filter(|&t| t < nearest) else { continue };
            nearest = t;
            let number = 100 + 20 * number as u32;
            let place = along(t);
            if place[2] > robot.height - 1e-6 {
                let [x, y, _] = robot.inside(place);
                let patch =
                    robot.patches.iter().rposition(|(outline, _)| contains(outline, [x, y]));
                let color = patch.map_or(BODY, |patch| robot.patches[patch].1);
                let part = patch.map_or(1, |patch| 2 + patch as u32);
                hit = Some((number + part, [0.0, 0.0, 1.0], color, place));
            } else {
                // The sides are dark; their orientation does not matter.
                hit = Some((number, [0.0, 0.0, 1.0], BODY.map(|value| value * 0.5), place));
            }
        }
        let (thing, normal, color, place) = hit.unwrap_or_else(|| {
            let (thing, color) = self.floor.at([floor[0], floor[1]]);
            (thing, [0.0, 0.0, 1.0], color, floor)
        });
        let (lit, light) = self.light(place, normal);
        let color = [0, 1, 2].map(|channel| color[channel] * light[channel]);
        // The edge of a shadow is an edge, too.
        (2 * thing + u32::from(lit), color)
    }

    /// Whether the lamp is visible from there, and the light that falls on a surface.
    fn light(&self, place: Vector, normal: Vector) -> (bool, Rgb) {
        let to_lamp = [0, 1, 2].map(|axis| self.lamp.position[axis] - place[axis]);
        let square = dot(to_lamp, to_lamp);
        let cosine = (dot(to_lamp, normal) / square.sqrt()).max(0.0);
        // Slightly off the surface, which must not shade itself.
        let start = [0, 1, 2].map(|axis| place[axis] + 0.5 * normal[axis]);
        let shaded = self.balls.iter().any(|ball| ball.meet(start, to_lamp).is_some())
            || self.robots.iter().any(|robot| robot.meet(start, to_lamp).is_some());
        let below = self.lamp.position[2] * self.lamp.position[2];
        let direct = if shaded { 0.0 } else { (1.0 - self.lamp.ambient) * cosine * below / square };
        // A vertical surface sees half of the ceiling.
        let ambient = self.lamp.ambient * (0.5 + 0.5 * normal[2]);
        (!shaded, self.lamp.tint.map(|tint| tint * (direct + ambient)))
    }
}

impl Floor {
    /// Number and colour of the floor at a position.
    fn at(&self, [x, y]: [f64; 2]) -> (u32, Rgb) {
        if self.markings.iter().any(|marking| marking.covers([x, y])) {
            return (1, LINE);
        }
        if x.abs() > self.half_mm[0] || y.abs() > self.half_mm[1] {
            return (0, self.around);
        }
        // Grain of a few millimetres, the same in every picture: a hash of the position.
        let cell = |value: f64| (value / 3.0).floor() as i64 as u64;
        let mut hash = cell(x).wrapping_mul(0x9e37_79b9_7f4a_7c15)
            ^ cell(y).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
        hash = (hash ^ hash >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let grain = 1.0 + self.grain * ((hash >> 40) as f64 / f64::from(1 << 23) - 1.0);
        (0, self.color.map(|value| value * grain))
    }
}

impl Marking {
    fn covers(&self, [x, y]: [f64; 2]) -> bool {
        match *self {
            Self::Line { from, to, width_mm } => {
                let along = [to[0] - from[0], to[1] - from[1]];
                let length = along[0].hypot(along[1]);
                let along = along.map(|value| value / length);
                let (dx, dy) = (x - from[0], y - from[1]);
                let half = width_mm / 2.0;
                (dx * along[1] - dy * along[0]).abs() < half
                    && (-half..length + half).contains(&(dx * along[0] + dy * along[1]))
            }
            Self::Circle { radius_mm, width_mm } => (x.hypot(y) - radius_mm).abs() < width_mm / 2.0,
        }
    }
}

impl Ball {
    /// Distance along a ray to the intersection, in lengths of the ray.
    fn meet(&self, from: Vector, ray: Vector) -> Option<f64> {
        let away = [from[0] - self.x, from[1] - self.y, from[2] - self.radius];
        let (a, b) = (dot(ray, ray), dot(away, ray));
        let c = dot(away, away) - self.radius * self.radius;
        let root = (b * b - a * c).max(-1.0);
        let t = (-b - root.max(0.0).sqrt()) / a;
        (root >= 0.0 && t > 0.0).then_some(t)
    }

    fn normal(&self, place: Vector) -> Vector {
        [
            (place[0] - self.x) / self.radius,
            (place[1] - self.y) / self.radius,
            (place[2] - self.radius) / self.radius,
        ]
    }
}

impl Robot {
    /// A field position in the robot's frame: ahead, to the left, up.
    fn inside(&self, [x, y, z]: Vector) -> Vector {
        let (sin, cos) = self.heading.sin_cos();
        let (dx, dy) = (x - self.x, y - self.y);
        [cos * dx + sin * dy, cos * dy - sin * dx, z]
    }

    /// Distance along a ray to its upright prism, in lengths of the ray.
    fn meet(&self, from: Vector, ray: Vector) -> Option<f64> {
        // Most rays miss it: the ray's nearest point to its axis is too far away.
        let reach = match self.shape {
            Shape::Square(half) => half * std::f64::consts::SQRT_2,
            Shape::Disc(radius, _) => radius,
        };
        let (dx, dy) = (from[0] - self.x, from[1] - self.y);
        let level = ray[0].hypot(ray[1]);
        if level > 1e-12 && (dx * ray[1] - dy * ray[0]).abs() > reach * level {
            return None;
        }
        let start = self.inside(from);
        let (sin, cos) = self.heading.sin_cos();
        let ray = [cos * ray[0] + sin * ray[1], cos * ray[1] - sin * ray[0], ray[2]];
        // The part of the ray inside all of the prism's boundaries.
        let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
        let mut slab = |position: f64, speed: f64, low: f64, high: f64| {
            if speed.abs() < 1e-12 {
                if position < low || position > high {
                    leave = f64::NEG_INFINITY;
                }
                return;
            }
            let (a, b) = ((low - position) / speed, (high - position) / speed);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        };
        slab(start[2], ray[2], 0.0, self.height);
        match self.shape {
            Shape::Square(half) => {
                slab(start[0], ray[0], -half, half);
                slab(start[1], ray[1], -half, half);
            }
            Shape::Disc(radius, front) => {
                slab(start[0], ray[0], -radius, front);
                let a = ray[0] * ray[0] + ray[1] * ray[1];
                let b = start[0] * ray[0] + start[1] * ray[1];
                let c = start[0] * start[0] + start[1] * start[1] - radius * radius;
                if a < 1e-18 {
                    if c > 0.0 {
                        return None;
                    }
                } else {
                    let root = b * b - a * c;
                    if root < 0.0 {
                        return None;
                    }
                    enter = enter.max((-b - root.sqrt()) / a);
                    leave = leave.min((-b + root.sqrt()) / a);
                }
            }
        }
        (enter <= leave && enter > 1e-9).then_some(enter)
    }
}

/// Whether a polygon contains a point (crossing number).
fn contains(outline: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let mut inside = false;
    for (index, &[ax, ay]) in outline.iter().enumerate() {
        let [bx, by] = outline[(index + 1) % outline.len()];
        if (ay > y) != (by > y) && x < (bx - ax) * (y - ay) / (by - ay) + ax {
            inside = !inside;
        }
    }
    inside
}
