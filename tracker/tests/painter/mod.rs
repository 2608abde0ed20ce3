//! Pictures of a ball by ray tracing, independent of the synthetic camera: a sphere, boxes for robots and
//! walls, a floor with lines, lamps with shadows, a pinhole camera, a Bayer mosaic and noise.
//!
//! Nothing here knows how the tracker models a ball. Light is linear: what a surface sends is its albedo
//! times its irradiance, of lamps (with cast shadows, the lamps' size makes them soft) and of an even
//! surrounding that the ball and the floor take from each other, plus the lamp mirrored in the ball.
//! Millimetres; z up.

// Every test file uses its own part of this.
#![allow(dead_code)]

use config::{Config, DistortionConfig, GeometryConfig, PointPair};

pub type Vec3 = [f64; 3];
pub type Color = [f64; 3];

/// Rays through a pixel, along each side.
const RAYS: usize = 6;

pub fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
fn add(a: Vec3, b: Vec3, s: f64) -> Vec3 {
    [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
}
fn unit(a: Vec3) -> Vec3 {
    let n = dot(a, a).sqrt();
    a.map(|v| v / n)
}
fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Numbers that look random, the same every time.
#[derive(Clone)]
pub struct Dice(pub u64);

impl Dice {
    /// Fraction, 0 to 1.
    pub fn even(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.even()
    }

    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.even()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.even()).cos()
    }
}

/// A pinhole camera.
#[derive(Clone)]
pub struct Pinhole {
    pub lens: Vec3,
    /// Focal length in pixels.
    pub focal: f64,
    /// Where the optical axis meets the picture.
    pub middle: [f64; 2],
    /// Right, down and forward, in the field's axes.
    axes: [Vec3; 3],
    pub size: [usize; 2],
    /// Standard deviation of what the lens makes of a point, without the pixel's own area.
    pub lens_spot_px: f64,
}

impl Pinhole {
    /// At `lens`, with its optical axis through `target` on the floor.
    pub fn new(lens: Vec3, target: [f64; 2], focal: f64, size: [usize; 2]) -> Self {
        let forward = unit(add([target[0], target[1], 0.0], lens, -1.0));
        // The picture's right is about the field's x, its down about −y.
        let right = unit(cross(forward, [0.0, 1.0, 0.0]));
        let down = cross(forward, right);
        let middle = size.map(|side| side as f64 / 2.0 - 0.5);
        Self { lens, focal, middle, axes: [right, down, forward], size, lens_spot_px: 0.4 }
    }

    pub fn image_of(&self, point: Vec3) -> [f64; 2] {
        let ray = add(point, self.lens, -1.0);
        let [x, y, z] = self.axes.map(|axis| dot(axis, ray));
        [self.middle[0] + self.focal * x / z, self.middle[1] + self.focal * y / z]
    }

    fn ray(&self, [x, y]: [f64; 2]) -> Vec3 {
        let [right, down, forward] = self.axes;
        let ray = add(forward, right, (x - self.middle[0]) / self.focal);
        unit(add(ray, down, (y - self.middle[1]) / self.focal))
    }

    /// The geometry that an exact measurement would give.
    pub fn geometry(&self, config: &Config) -> GeometryConfig {
        let (x, y) = (config.field.length_mm / 2.0, config.field.width_mm / 2.0);
        let corners = [[-x, -y], [-x, y], [x, -y], [x, y], [0.0, y], [0.0, -y]];
        GeometryConfig {
            camera_mm: self.lens,
            points: corners
                .iter()
                .map(|&field_mm| PointPair {
                    field_mm,
                    image_px: self.image_of([field_mm[0], field_mm[1], 0.0]),
                })
                .collect(),
            distortion: DistortionConfig {
                k1: 0.0,
                k2: 0.0,
                center_px: self.middle,
                ..DistortionConfig::default()
            },
        }
    }
}

#[derive(Clone)]
pub struct Lamp {
    /// Towards the lamp.
    pub direction: Vec3,
    /// Irradiance of what faces it.
    pub strength: f64,
    /// Half its apparent width, as a tangent.
    pub size: f64,
}

/// A robot, or anything with four walls: upright, with a top that may show patches.
#[derive(Clone)]
pub struct Block {
    pub center: [f64; 2],
    pub half: [f64; 2],
    pub height: f64,
    pub turn: f64,
    pub body: Color,
    /// On its top, in its own frame: left, bottom, right, top.
    pub patches: Vec<([f64; 4], Color)>,
}

#[derive(Clone)]
pub struct Ball {
    pub position: [f64; 2],
    /// In millimetres a second.
    pub velocity: [f64; 2],
    pub radius: f64,
    pub albedo: Color,
    /// Share of the lamp's light that it mirrors, and how sharply.
    pub gloss: f64,
    pub sharpness: f64,
}

#[derive(Clone)]
pub struct World {
    pub camera: Pinhole,
    pub lamps: Vec<Lamp>,
    /// Irradiance of what faces the sky, from everywhere evenly.
    pub ambient: f64,
    pub floor: Color,
    pub line: Color,
    /// Half width of lines, their places: x, y, and the radius of a circle around the middle.
    pub line_half: f64,
    pub lines_x: Vec<f64>,
    pub lines_y: Vec<f64>,
    pub circle: f64,
    pub ball: Ball,
    pub blocks: Vec<Block>,
    pub exposure_s: f64,
    pub dice: Dice,
}

/// The first thing on a ray.
enum Met {
    Floor(Vec3),
    Ball(Vec3, Vec3),
    Block(Vec3, Vec3, Color),
}

impl World {
    fn ball_center(&self, time: f64) -> Vec3 {
        let Ball { position, velocity, radius, .. } = self.ball;
        [position[0] + time * velocity[0], position[1] + time * velocity[1], radius]
    }

    fn meets_ball(&self, from: Vec3, ray: Vec3, center: Vec3) -> Option<f64> {
        let to = add(center, from, -1.0);
        let along = dot(to, ray);
        let beside = dot(to, to) - along * along;
        let half = self.ball.radius * self.ball.radius - beside;
        (half > 0.0 && along - half.sqrt() > 1e-6).then(|| along - half.sqrt())
    }

    fn meets_block(block: &Block, from: Vec3, ray: Vec3) -> Option<(f64, Vec3)> {
        let (sin, cos) = block.turn.sin_cos();
        let into = |[x, y, z]: Vec3| [x * cos + y * sin, y * cos - x * sin, z];
        let at = into(add(from, [block.center[0], block.center[1], 0.0], -1.0));
        let ray = into(ray);
        let (mut near, mut far, mut normal) = (1e-6, f64::INFINITY, [0.0; 3]);
        for (axis, slope) in ray.into_iter().enumerate() {
            let [low, high] = match axis {
                2 => [0.0, block.height],
                _ => [-block.half[axis], block.half[axis]],
            };
            if slope.abs() < 1e-12 {
                if at[axis] < low || at[axis] > high {
                    return None;
                }
                continue;
            }
            let (a, b) = ((low - at[axis]) / slope, (high - at[axis]) / slope);
            if a.min(b) > near {
                near = a.min(b);
                normal = [0.0; 3];
                normal[axis] = -slope.signum();
            }
            far = far.min(a.max(b));
        }
        let [x, y, z] = normal;
        (near < far && near > 1e-5).then_some((near, [x * cos - y * sin, y * cos + x * sin, z]))
    }

    fn meet(&self, from: Vec3, ray: Vec3, ball: Vec3) -> Met {
        let mut distance = if ray[2] < 0.0 { -from[2] / ray[2] } else { f64::INFINITY };
        let mut met = Met::Floor(add(from, ray, distance));
        if let Some(to_ball) = self.meets_ball(from, ray, ball)
            && to_ball < distance
        {
            distance = to_ball;
            let point = add(from, ray, distance);
            met = Met::Ball(point, unit(add(point, ball, -1.0)));
        }
        for block in &self.blocks {
            if let Some((to_block, normal)) = Self::meets_block(block, from, ray)
                && to_block < distance
            {
                distance = to_block;
                let point = add(from, ray, distance);
                let (sin, cos) = block.turn.sin_cos();
                let (dx, dy) = (point[0] - block.center[0], point[1] - block.center[1]);
                let (x, y) = (dx * cos + dy * sin, dy * cos - dx * sin);
                let patch = block.patches.iter().find(|([left, bottom, right, top], _)| {
                    normal[2] > 0.5 && x > *left && x < *right && y > *bottom && y < *top
                });
                met = Met::Block(point, normal, patch.map_or(block.body, |patch| patch.1));
            }
        }
        met
    }

    fn is_shaded(&self, from: Vec3, ray: Vec3, ball: Vec3) -> bool {
        self.meets_ball(from, ray, ball).is_some()
            || self.blocks.iter().any(|block| Self::meets_block(block, from, ray).is_some())
    }

    /// Irradiance of a surface, and what of each lamp arrives.
    fn irradiance(&self, at: Vec3, normal: Vec3, ball: Vec3, dice: &mut Dice) -> (f64, Vec<f64>) {
        // Half of a hemisphere that leans sees the floor, which is dark.
        let bounce = 0.6 * self.floor[1];
        let mut sum = self.ambient * (0.5 + 0.5 * normal[2] + (0.5 - 0.5 * normal[2]) * bounce);
        if normal[2] > 0.99 && at[2] < 1.0 {
            // The ball hides a part of the sky from the floor.
            let d = add(ball, at, -1.0);
            sum *= 1.0 - (self.ball.radius / dot(d, d).sqrt().max(self.ball.radius)).powi(3);
        }
        let mut arrives = Vec::with_capacity(self.lamps.len());
        for lamp in &self.lamps {
            let wobble = [0; 3].map(|_| lamp.size * dice.between(-1.0, 1.0));
            let to = unit(add(lamp.direction, wobble, 1.0));
            let facing = dot(normal, to);
            let lit = facing > 0.0 && !self.is_shaded(add(at, normal, 1e-3), to, ball);
            arrives.push(if lit { lamp.strength } else { 0.0 });
            if lit {
                sum += facing * lamp.strength;
            }
        }
        (sum, arrives)
    }

    fn floor_color(&self, x: f64, y: f64) -> Color {
        let on = |off: f64| off.abs() < self.line_half;
        let is_line = self.lines_x.iter().any(|line| on(x - line))
            || self.lines_y.iter().any(|line| on(y - line))
            || on(x.hypot(y) - self.circle);
        if is_line { self.line } else { self.floor }
    }

    fn look(&self, point: [f64; 2], time: f64, dice: &mut Dice) -> Color {
        let ball = self.ball_center(time);
        let ray = self.camera.ray(point);
        match self.meet(self.camera.lens, ray, ball) {
            Met::Floor(at) => {
                let (light, _) = self.irradiance(at, [0.0, 0.0, 1.0], ball, dice);
                self.floor_color(at[0], at[1]).map(|albedo| albedo * light)
            }
            Met::Block(at, normal, color) => {
                let (light, _) = self.irradiance(at, normal, ball, dice);
                color.map(|albedo| albedo * light)
            }
            Met::Ball(at, normal) => {
                let (light, arrives) = self.irradiance(at, normal, ball, dice);
                let mut shine = 0.0;
                for (lamp, arrives) in self.lamps.iter().zip(arrives) {
                    let half = unit(add(unit(lamp.direction), ray, -1.0));
                    let facing = dot(half, normal).max(0.0);
                    shine += self.ball.gloss * arrives * facing.powf(self.ball.sharpness);
                }
                self.ball.albedo.map(|albedo| albedo * light + shine)
            }
        }
    }

    /// Share of the ball's outline in the picture that nothing hides.
    pub fn visible_share(&self) -> f64 {
        let ball = self.ball_center(0.0);
        let [x, y] = self.camera.image_of(ball);
        let (mut all, mut seen) = (0, 0);
        for row in -60..60 {
            for column in -60..60 {
                let point = [x + f64::from(column) * 0.25, y + f64::from(row) * 0.25];
                let ray = self.camera.ray(point);
                if self.meets_ball(self.camera.lens, ray, ball).is_some() {
                    all += 1;
                    let met = self.meet(self.camera.lens, ray, ball);
                    seen += usize::from(matches!(met, Met::Ball(..)));
                }
            }
        }
        seen as f64 / all.max(1) as f64
    }

    /// The whole picture, without noise, a look for each pixel.
    pub fn backdrop(&self, config: &Config) -> Vec<f64> {
        let [width, height] = self.camera.size;
        let mut dice = self.dice.clone();
        let order = config.camera.bayer_order;
        (0..width * height)
            .map(|index| {
                let (column, row) = (index % width, index / width);
                let color = self.look([column as f64, row as f64], 0.0, &mut dice);
                255.0 * color[order.channel_at(column, row)]
            })
            .collect()
    }

    /// Paints what is around the ball into a backdrop: pixels as a sensor integrates them.
    pub fn paint_around(&mut self, config: &Config, pixels: &mut [f64], reach_px: usize) {
        let [width, height] = self.camera.size;
        let [x, y] = self.camera.image_of(self.ball_center(0.0));
        let left = (x as usize).saturating_sub(reach_px);
        let top = (y as usize).saturating_sub(reach_px);
        let (right, bottom) =
            ((x as usize + reach_px).min(width), (y as usize + reach_px).min(height));
        // A border for the lens.
        const BORDER: usize = 3;
        let (columns, rows) =
            ((right - left + 2 * BORDER) * RAYS, (bottom - top + 2 * BORDER) * RAYS);
        let mut dice = self.dice.clone();
        let mut fine = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            for column in 0..columns {
                let place = |index: usize, first: usize, dice: &mut Dice| {
                    first as f64 - BORDER as f64 - 0.5 + (index as f64 + dice.even()) / RAYS as f64
                };
                let point = [place(column, left, &mut dice), place(row, top, &mut dice)];
                let time = self.exposure_s * (dice.even() - 0.5);
                fine.push(self.look(point, time, &mut dice));
            }
        }
        self.dice = dice;
        // The lens, then the pixel's area: along rows, then along columns.
        let sigma = self.camera.lens_spot_px * RAYS as f64;
        let half = (3 * RAYS) as i64 - 1;
        let kernel: Vec<f64> = (-half..=half)
            .map(|offset| {
                (0..RAYS)
                    .map(|ray| {
                        let d = offset as f64 - ray as f64 + (RAYS as f64 - 1.0) / 2.0;
                        (-(d / sigma).powi(2) / 2.0).exp()
                    })
                    .sum()
            })
            .collect();
        let total: f64 = kernel.iter().sum();
        let middle = |pixel: usize| ((pixel + BORDER) * RAYS + RAYS / 2) as f64 - 0.5;
        // The middle of a pixel lies between two rays; both halves of the kernel are used.
        let weigh = |pixel: usize, index: usize| {
            let off = index as f64 - middle(pixel);
            let (low, part) = (off.floor(), off - off.floor());
            let at = |offset: f64| {
                let place = offset as i64 + half;
                kernel.get(place as usize).filter(|_| place >= 0).copied().unwrap_or(0.0)
            };
            (at(low) * (1.0 - part) + at(low + 1.0) * part) / total
        };
        let order = config.camera.bayer_order;
        let mut across = vec![[0.0; 3]; (right - left) * rows];
        for row in 0..rows {
            for pixel in 0..right - left {
                let first = pixel * RAYS;
                for index in first..(first + (2 * BORDER + 1) * RAYS).min(columns) {
                    let weight = weigh(pixel, index);
                    for channel in 0..3 {
                        across[row * (right - left) + pixel][channel] +=
                            weight * fine[row * columns + index][channel];
                    }
                }
            }
        }
        for row in top..bottom {
            for column in left..right {
                let channel = order.channel_at(column, row);
                let pixel = row - top;
                let first = pixel * RAYS;
                let value: f64 = (first..(first + (2 * BORDER + 1) * RAYS).min(rows))
                    .map(|index| {
                        weigh(pixel, index)
                            * across[index * (right - left) + column - left][channel]
                    })
                    .sum();
                pixels[row * width + column] = 255.0 * value;
            }
        }
    }

    /// The picture as the sensor reads it out.
    pub fn with_noise(&mut self, pixels: &[f64], read: f64, shot: f64) -> Vec<u8> {
        pixels
            .iter()
            .map(|value| {
                let sigma = (read * read + shot * value.max(0.0)).sqrt();
                (value + sigma * self.dice.normal()).round().clamp(0.0, 255.0) as u8
            })
            .collect()
    }
}
