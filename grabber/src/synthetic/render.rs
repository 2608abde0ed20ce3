//! The renderer of the match.
//!
//! It composes sprites over a background. The empty pitch is rendered once. Each robot and the ball have a
//! sprite (`sprite.rs`) with light and coverage of its pixels, which is redrawn when its pose or motion
//! changes. A pixel becomes `light + (1 − cover) · below`, from the farthest sprite to the nearest. The
//! renderer keeps the composed picture without noise, and from frame to frame restores and recomposes only
//! the boxes around changed sprites, which gives the same picture as composing all of it. Noise is added
//! last, anew for every pixel of every frame.

use super::light::Light;
use super::motion::Twist;
use super::optics::{Optics, SoftEdge, spot_px};
use super::pitch;
use super::random::{Random, hash};
use super::shape::{BODY, Outline, PARTS, SIDE, Shape};
use super::simulation::{Robot, Simulation};
use super::sprite::{Layer, Palette, Rect, draw_ball, draw_robot};
use super::{SyntheticError, positive};
use config::{Config, PatchRole, Top};
use geometry::{CameraModel, FieldPoint, ImagePoint, Pose};
use std::sync::Arc;

/// Colours of robots between the patches and on the sides.
pub(super) const BODY_COLOR: [u8; 3] = [24, 25, 27];
const SIDE_COLOR: [u8; 3] = [38, 38, 40];

/// Number of noise values; a power of two.
const NOISE_VALUES: usize = 1 << 16;

const STREAM_NOISE: u64 = 3;

/// A sprite, and the state in which it was last drawn.
#[derive(Debug, Clone, Default)]
struct Sprite {
    layer: Layer,
    drawn: Option<(Pose, Twist, [f64; 2])>,
}

/// Renders pictures.
#[derive(Debug, Clone)]
pub struct Renderer {
    optics: Optics,
    /// Indexed as `robots.identities`; equal ones are shared.
    shapes: Vec<Arc<Shape>>,
    ball_color: [u8; 3],
    ball_radius_mm: f64,
    /// Indexed as `robots.identities`.
    palettes: Vec<Palette>,
    background: Vec<u8>,
    /// The picture without noise.
    clean: Vec<u8>,
    /// The robots, then the ball.
    sprites: Vec<Sprite>,
    /// Indices into `sprites`, lowest first.
    order: Vec<usize>,
    dirty: Vec<Rect>,
    noise: Vec<i8>,
    noise_seed: u64,
}

impl Renderer {
    /// Renders the empty pitch.
    pub fn new(config: &Config) -> Result<Self, SyntheticError> {
        let camera = &config.camera;
        let model = CameraModel::new(&config.geometry, camera.width, camera.height)?;
        let lens_mm = config.geometry.camera_mm;
        let ball_radius_mm = config.ball.diameter_mm / 2.0;
        let tallest_mm = config.tallest_robot_mm();
        for (key, height) in
            [("robots.height_mm", tallest_mm), ("ball.diameter_mm", ball_radius_mm)]
        {
            if !(height >= 0.0 && height < 0.9 * lens_mm[2]) {
                return Err(SyntheticError::Impossible { key, value: height });
            }
        }
        let optics = Optics {
            model,
            lens_mm,
            width: camera.width as usize,
            height: camera.height as usize,
            order: camera.bayer_order,
            exposure_s: f64::from(camera.exposure_us) * 1e-6,
            shutter: camera.rolling_shutter(),
            light: Light::new(config),
            spot_px: spot_px(config.synthetic.defocus_px),
            edge: SoftEdge::new(),
        };
        // The scale hardly changes over the picture, so one table serves for all of it.
        let middle = optics.model.image_from_field(FieldPoint::default(), tallest_mm);
        let area_mm2 = optics.model.pixel_area_mm2(middle, tallest_mm);
        let spot_mm = positive("geometry.points", area_mm2.sqrt() * optics.spot_px)?;
        let background = pitch::paint(&config.field, config.synthetic.floor_rgb, &optics);
        let mut tops: Vec<(Top, Arc<Shape>)> = Vec::new();
        let mut shapes = Vec::with_capacity(config.robots.identities.len());
        for identity in &config.robots.identities {
            let top = config.top_of(identity);
            if !tops.iter().any(|(known, _)| *known == top) {
                tops.push((top, Arc::new(Shape::new(&config.robots, top, spot_mm))));
            }
            let of_top = tops.iter().filter(|(known, _)| *known == top);
            shapes.extend(of_top.map(|(_, shape)| shape.clone()));
        }
        let palettes = (0..config.robots.identities.len())
            .map(|identity| palette(config, identity))
            .collect::<Result<_, _>>()?;
        let robots = config.robots.identities.len();
        Ok(Self {
            optics,
            shapes,
            ball_color: display_color(config, &config.ball.color)?,
            ball_radius_mm,
            palettes,
            clean: background.clone(),
            background,
            sprites: vec![Sprite::default(); robots + 1],
            order: Vec::with_capacity(robots + 1),
            dirty: Vec::with_capacity(robots + 1),
            noise: noise_values(config),
            noise_seed: hash(config.synthetic.seed, STREAM_NOISE),
        })
    }

    /// Renders frame number `frame_number`: writes every pixel of every row, and nothing between rows.
    pub fn render(
        &mut self,
        simulation: &Simulation,
        frame_number: u64,
        pixels: &mut [u8],
        stride: usize,
    ) {
        self.draw(simulation);
        let width = self.optics.width;
        let frame_seed = hash(self.noise_seed, frame_number);
        let rows = pixels.chunks_mut(stride).zip(self.clean.chunks_exact(width));
        for (row, (pixels, clean)) in rows.enumerate() {
            let start = hash(frame_seed, row as u64) as usize % NOISE_VALUES;
            let noise = &self.noise[start..start + width];
            for ((pixel, &clean), &noise) in pixels[..width].iter_mut().zip(clean).zip(noise) {
                *pixel = (i16::from(clean) + i16::from(noise)).clamp(0, 255) as u8;
            }
        }
    }

    /// Whether all of a robot's top is in the picture and no taller robot stands between it and the camera.
    pub fn shows_robot(&self, robot: &Robot, robots: &[Robot]) -> bool {
        let shape = &self.shapes[robot.identity];
        let reach = f64::from(shape.reach_mm);
        let all_inside =
            [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)].into_iter().all(|(x, y)| {
                let corner = robot.pose.field_from_robot([x * reach, y * reach]);
                self.shows(self.optics.model.image_from_field(corner, shape.height_mm))
            });
        let is_taller = |other: &&Robot| self.shapes[other.identity].height_mm > shape.height_mm;
        let mut taller = robots.iter().filter(is_taller);
        let (place, radius_mm) = (robot.pose.position, shape.body.half_mm());
        all_inside && !taller.any(|other| self.hides(other, place, shape.height_mm, radius_mm))
    }

    /// Whether all of the ball is in the picture and no robot stands between it and the camera.
    pub fn shows_ball(&self, ball: FieldPoint, robots: &[Robot]) -> bool {
        let radius = self.ball_radius_mm;
        let all_inside =
            [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)].into_iter().all(|(x, y)| {
                let rim = FieldPoint::new(ball.x_mm + x * radius, ball.y_mm + y * radius);
                self.shows(self.optics.model.image_from_field(rim, radius))
            });
        all_inside && !robots.iter().any(|robot| self.hides(robot, ball, radius, radius))
    }

    /// Whether a robot may hide a part of a disc at a height above a place: whether the disc, swept along its
    /// line of sight up to the height of the robot, touches it.
    fn hides(&self, robot: &Robot, place: FieldPoint, height_mm: f64, radius_mm: f64) -> bool {
        let (shape, robot) = (&self.shapes[robot.identity], &robot.pose);
        let [lens_x, lens_y, lens_height] = self.optics.lens_mm;
        let climb = (shape.height_mm - height_mm).max(0.0) / (lens_height - height_mm);
        let (dx, dy) = (place.x_mm - robot.position.x_mm, place.y_mm - robot.position.y_mm);
        let (step_x, step_y) = ((lens_x - place.x_mm) * climb, (lens_y - place.y_mm) * climb);
        let (sin, cos) = robot.orientation.sin_cos();
        let into_robot = |x: f64, y: f64| [(x * cos + y * sin) as f32, (y * cos - x * sin) as f32];
        let overhang_mm = f64::from(shape.reach_mm) - shape.body.half_mm();
        let swollen = shape.body.grown(overhang_mm.max(0.0) + radius_mm);
        let [x, y] = into_robot(dx, dy);
        Outline::new(&swollen, into_robot(step_x, step_y)).depth(x, y) > 0.0
    }

    fn shows(&self, point: ImagePoint) -> bool {
        (0.0..=(self.optics.width - 1) as f64).contains(&point.x_px)
            && (0.0..=(self.optics.height - 1) as f64).contains(&point.y_px)
    }

    /// Updates the picture without noise.
    fn draw(&mut self, simulation: &Simulation) {
        self.dirty.clear();
        for (robot, sprite) in simulation.robots.iter().zip(&mut self.sprites) {
            let state = (robot.pose, robot.twist, [0.0; 2]);
            if sprite.drawn == Some(state) {
                continue;
            }
            let before = sprite.layer.rect;
            draw_robot(
                &self.optics,
                &self.shapes[robot.identity],
                &self.palettes[robot.identity],
                robot.pose,
                robot.twist,
                &mut sprite.layer,
            );
            sprite.drawn = Some(state);
            self.dirty.push(before.union(sprite.layer.rect));
        }
        let ball_pose = Pose { position: simulation.ball.position, orientation: 0.0 };
        let state = (ball_pose, Twist::default(), simulation.ball.velocity_mm_s);
        if let Some(sprite) = self.sprites.last_mut()
            && sprite.drawn != Some(state)
        {
            let before = sprite.layer.rect;
            draw_ball(
                &self.optics,
                self.ball_color,
                self.ball_radius_mm,
                simulation.ball.position,
                simulation.ball.velocity_mm_s,
                &mut sprite.layer,
            );
            sprite.drawn = Some(state);
            // Separate boxes, since the ball may have been put somewhere else altogether.
            self.dirty.extend([before, sprite.layer.rect]);
        }
        self.sort(simulation);
        self.compose();
    }

    /// Orders the sprites: the ball is lower than robots; of two robots, the one nearer to the lens may hide
    /// part of the other's side, never of its top.
    fn sort(&mut self, simulation: &Simulation) {
        let [lens_x, lens_y, _] = self.optics.lens_mm;
        let lens = FieldPoint::new(lens_x, lens_y);
        let distance = |index: usize| match simulation.robots.get(index) {
            Some(robot) => robot.pose.position.distance(lens),
            None => f64::INFINITY,
        };
        self.order.clear();
        self.order.extend(0..self.sprites.len());
        self.order.sort_by(|&a, &b| distance(b).total_cmp(&distance(a)));
    }

    /// Recomposes the changed boxes of the picture.
    fn compose(&mut self) {
        let width = self.optics.width;
        for &dirty in &self.dirty {
            for row in dirty.top..dirty.bottom {
                let span = row * width + dirty.left..row * width + dirty.right.max(dirty.left);
                self.clean[span.clone()].copy_from_slice(&self.background[span]);
            }
            for &index in &self.order {
                self.sprites[index].layer.blend(&mut self.clean, width, dirty);
            }
        }
    }
}

fn display_color(config: &Config, name: &str) -> Result<[u8; 3], SyntheticError> {
    let color = config.colors.iter().find(|color| color.name == name);
    color
        .map(|color| color.looks)
        .ok_or_else(|| SyntheticError::UnknownColor { name: name.to_string() })
}

/// The colours of the parts of one robot.
fn palette(config: &Config, identity: usize) -> Result<Palette, SyntheticError> {
    let robot = &config.robots.identities[identity];
    let mut colors = [BODY_COLOR; PARTS];
    let mut identification = robot.colors.iter();
    for (part, patch) in config.top_of(robot).patches.iter().enumerate().take(BODY) {
        let name = match patch.role {
            PatchRole::Team => Some(config.teams.color(robot.team)),
            PatchRole::Identification => identification.next().map(String::as_str),
        };
        if let Some(name) = name {
            colors[part] = display_color(config, name)?;
        }
    }
    colors[SIDE] = SIDE_COLOR;
    Ok(Palette::new(&colors))
}

/// Noise values, extended by a row's length, so that a row can start at any of the [`NOISE_VALUES`].
fn noise_values(config: &Config) -> Vec<i8> {
    let mut random = Random::new(config.synthetic.seed, STREAM_NOISE);
    let sigma = config.synthetic.noise.clamp(0.0, 60.0);
    let mut values: Vec<i8> =
        (0..NOISE_VALUES).map(|_| (random.normal() * sigma).round() as i8).collect();
    values.extend_from_within(..(config.camera.width as usize).min(NOISE_VALUES));
    values
}
