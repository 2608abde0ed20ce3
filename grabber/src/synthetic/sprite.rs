//! Rendering of one robot or one ball: coverage and light of each pixel.
//!
//! For each pixel near the sprite, the projection is inverted by a quadratic approximation around the
//! sprite's centre, which gives the point seen in the robot's frame. The table of the robot's top ([`Shape`])
//! already contains the camera's spot, so one sample at a pixel's middle gives its colour, the weighted mean
//! of the colours of the parts there. Motion blur is the mean over the exposure, by Gauss–Legendre quadrature
//! with two points per pixel of motion. Sides are the swept outline of the body minus the top.

use super::motion::{Twist, drive};
use super::optics::{Optics, SPOT_REACH};
use super::shape::{Outline, PARTS, SIDE, Shape, WHOLE};
use geometry::{CameraModel, FieldPoint, ImagePoint, Pose};

/// Pixels `left..right` of rows `top..bottom`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Rect {
    /// First column.
    pub left: usize,
    /// First row.
    pub top: usize,
    /// Column behind the last.
    pub right: usize,
    /// Row behind the last.
    pub bottom: usize,
}

impl Rect {
    /// The common part; may be empty.
    pub fn intersection(self, other: Self) -> Self {
        let (left, top) = (self.left.max(other.left), self.top.max(other.top));
        Self {
            left,
            top,
            right: self.right.min(other.right).max(left),
            bottom: self.bottom.min(other.bottom).max(top),
        }
    }

    /// The smallest rectangle that contains both.
    pub fn union(self, other: Self) -> Self {
        if self.is_empty() {
            return other;
        }
        if other.is_empty() {
            return self;
        }
        Self {
            left: self.left.min(other.left),
            top: self.top.min(other.top),
            right: self.right.max(other.right),
            bottom: self.bottom.max(other.bottom),
        }
    }

    /// Whether it contains no pixel.
    pub fn is_empty(self) -> bool {
        self.left >= self.right || self.top >= self.bottom
    }

    fn width(self) -> usize {
        self.right - self.left
    }

    /// The pixels of a picture within `margin_px` of the bounding box of some points.
    fn around(points: &[ImagePoint], margin_px: f64, width: usize, height: usize) -> Self {
        let span = |values: &mut dyn Iterator<Item = f64>, limit: usize| {
            let (low, high) = values
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                    (low.min(value), high.max(value))
                });
            // Conversion maps negative numbers to 0.
            let first = ((low - margin_px).ceil() as usize).min(limit);
            let behind = ((high + margin_px).floor() + 1.0) as usize;
            (first, behind.clamp(first, limit))
        };
        let (left, right) = span(&mut points.iter().map(|point| point.x_px), width);
        let (top, bottom) = span(&mut points.iter().map(|point| point.y_px), height);
        Self { left, top, right, bottom }
    }
}

/// A pixel of a sprite, in 256ths: its coverage, and its light.
#[derive(Debug, Clone, Copy, Default)]
struct Cell {
    light: u16,
    cover: u16,
}

/// Full coverage.
const FULL: u16 = 256;

/// A sprite's pixels, ready to be composed over a background.
#[derive(Debug, Clone, Default)]
pub struct Layer {
    /// The pixels that may be covered.
    pub rect: Rect,
    cells: Vec<Cell>,
}

impl Layer {
    fn reset(&mut self, rect: Rect) {
        self.rect = rect;
        self.cells.clear();
        self.cells.resize(rect.width() * (rect.bottom - rect.top), Cell::default());
    }

    /// Composes it over the part of a picture (rows of `width` pixels) in `clip`.
    pub fn blend(&self, picture: &mut [u8], width: usize, clip: Rect) {
        let area = self.rect.intersection(clip);
        if area.is_empty() {
            return;
        }
        for row in area.top..area.bottom {
            let pixels = &mut picture[row * width + area.left..row * width + area.right];
            let start = (row - self.rect.top) * self.rect.width() + area.left - self.rect.left;
            for (pixel, cell) in pixels.iter_mut().zip(&self.cells[start..]) {
                let behind = (FULL - cell.cover) * u16::from(*pixel);
                *pixel = (cell.light.saturating_add(behind).saturating_add(FULL / 2) / FULL) as u8;
            }
        }
    }
}

/// Quadratic approximation of the camera model near a place: millimetres on the field from pixels, both
/// relative to that place. Its error is of third order.
#[derive(Debug, Clone)]
struct LocalMap {
    center: ImagePoint,
    /// For x and y on the field: coefficients of u, v, u², uv, v².
    terms: [[f32; 5]; 2],
}

impl LocalMap {
    fn new(model: &CameraModel, place: FieldPoint, height_mm: f64, reach_mm: f64) -> Self {
        let center = model.image_from_field(place, height_mm);
        let area = model.pixel_area_mm2(center, height_mm);
        // Fitted through points about as far away as the sprite reaches.
        let step = (reach_mm / area.sqrt().max(1e-3)).clamp(1.0, 1000.0);
        let look = |u: f64, v: f64| {
            let point = ImagePoint::new(center.x_px + u * step, center.y_px + v * step);
            let seen = model.field_from_image(point, height_mm);
            [seen.x_mm - place.x_mm, seen.y_mm - place.y_mm]
        };
        let (right, left, down, up) =
            (look(1.0, 0.0), look(-1.0, 0.0), look(0.0, 1.0), look(0.0, -1.0));
        let (near, far) = (look(1.0, 1.0), look(-1.0, -1.0));
        let terms = std::array::from_fn(|axis| {
            let u = (right[axis] - left[axis]) / (2.0 * step);
            let v = (down[axis] - up[axis]) / (2.0 * step);
            let uu = (right[axis] + left[axis]) / (2.0 * step * step);
            let vv = (down[axis] + up[axis]) / (2.0 * step * step);
            let uv = (near[axis] + far[axis]) / (2.0 * step * step) - uu - vv;
            [u as f32, v as f32, uu as f32, uv as f32, vv as f32]
        });
        Self { center, terms }
    }

    /// The map to the frame of a body at the place, with heading `orientation`.
    fn rotated(&self, orientation: f64) -> Self {
        let (sin, cos) = orientation.sin_cos();
        let (sin, cos) = (sin as f32, cos as f32);
        let [x, y] = &self.terms;
        let turn = |a: f32, b: f32| std::array::from_fn(|term| a * x[term] + b * y[term]);
        Self { center: self.center, terms: [turn(cos, sin), turn(-sin, cos)] }
    }

    /// Point, relative to the place, that pixel (`column`, `row`) sees, in millimetres.
    fn at(&self, column: usize, row: usize) -> [f32; 2] {
        let u = (column as f64 - self.center.x_px) as f32;
        let v = (row as f64 - self.center.y_px) as f32;
        self.terms.map(|[a, b, c, d, e]| u * (a + c * u + d * v) + v * (b + e * v))
    }

    /// Millimetres per pixel.
    fn mm_per_px(&self) -> f32 {
        let [[a, b, ..], [c, d, ..]] = self.terms;
        (a * d - b * c).abs().sqrt()
    }
}

/// Transform from a body's frame in the middle of the exposure to its frame at another time of the exposure.
#[derive(Debug, Clone, Copy, Default)]
struct View {
    cos: f32,
    sin: f32,
    x_mm: f32,
    y_mm: f32,
}

impl View {
    fn new(turn: f32, [x, y]: [f32; 2]) -> Self {
        let (sin, cos) = turn.sin_cos();
        Self { cos, sin, x_mm: -(cos * x + sin * y), y_mm: -(cos * y - sin * x) }
    }

    fn apply(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        [self.cos * x + self.sin * y + self.x_mm, self.cos * y - self.sin * x + self.y_mm]
    }
}

/// Maximum number of samples per pixel.
const MAX_VIEWS: usize = 32;

/// Sampling times of an object that moves by `blur_px` during the exposure, in exposures from its middle: two
/// Gauss–Legendre points in each stretch of about a pixel, which is exact enough for a scene as smooth as the
/// camera's spot makes it.
fn instants(blur_px: f32) -> impl Iterator<Item = f32> {
    let stretches = if blur_px < 0.01 { 0 } else { (blur_px.ceil() as usize).min(MAX_VIEWS / 2) };
    let still = (stretches == 0).then_some(0.0);
    let moving = (0..2 * stretches).map(move |index| {
        let side = if index % 2 == 0 { -0.5 } else { 0.5 } / 3f32.sqrt();
        ((index / 2) as f32 + 0.5 + side) / stretches as f32 - 0.5
    });
    still.into_iter().chain(moving)
}

/// The colours of a robot's parts, by colour channel.
#[derive(Debug, Clone)]
pub struct Palette([[u32; PARTS]; 3]);

impl Palette {
    /// From the parts' colours.
    pub fn new(colors: &[[u8; 3]; PARTS]) -> Self {
        Self(std::array::from_fn(|channel| colors.map(|color| u32::from(color[channel]))))
    }
}

/// Weight of a spot that lies on the top except for less than a grey level.
const NEARLY_WHOLE: u32 = WHOLE - WHOLE / 128;

/// Draws a robot: its top, and the visible part of its sides.
pub fn draw_robot(
    optics: &Optics,
    shape: &Shape,
    palette: &Palette,
    pose: Pose,
    twist: Twist,
    layer: &mut Layer,
) {
    let (reach, height_mm) = (f64::from(shape.reach_mm), shape.height_mm);
    // Drawn whole, at the time of the row of its middle: the skew of a rolling shutter is not rendered.
    let row_px = optics.model.image_from_field(pose.position, height_mm).y_px;
    let pose = drive(pose, twist, optics.shutter.delay_s(row_px));
    let map = LocalMap::new(&optics.model, pose.position, height_mm, reach);
    let map = map.rotated(pose.orientation);
    // Maximum displacement of any point of the robot from the middle of the exposure.
    let speed = twist.v_mm_s.abs() + twist.omega.abs() * reach * std::f64::consts::SQRT_2;
    let blur_mm = (speed * optics.exposure_s / 2.0) as f32;
    let blur_px = blur_mm / map.mm_per_px();
    let margin_mm = SPOT_REACH * shape.spot_mm + blur_mm;

    let corners: [ImagePoint; 8] = std::array::from_fn(|index| {
        let sign = |bit: usize| if index & bit == 0 { reach } else { -reach };
        let height = if index & 4 == 0 { height_mm } else { 0.0 };
        optics.model.image_from_field(pose.field_from_robot([sign(1), sign(2)]), height)
    });
    let margin_px = f64::from(SPOT_REACH) * optics.spot_px + f64::from(blur_px) + 0.5;
    layer.reset(Rect::around(&corners, margin_px, optics.width, optics.height));

    let mut views = [View::default(); MAX_VIEWS];
    let mut view_count = 0;
    for (view, instant) in views.iter_mut().zip(instants(2.0 * blur_px)) {
        let time = instant * optics.exposure_s as f32;
        let (turn, way) = (twist.omega as f32 * time, twist.v_mm_s as f32 * time);
        let (sin, cos) = (turn / 2.0).sin_cos();
        *view = View::new(turn, [way * cos, way * sin]);
        view_count += 1;
    }
    let views = &views[..view_count];

    // Distance from a point of the top, along its line of sight, to the floor, relative to the point's
    // distance from the lens.
    let farther = height_mm / (optics.lens_mm[2] - height_mm);
    let from_lens = [
        (pose.position.x_mm - optics.lens_mm[0]) * farther,
        (pose.position.y_mm - optics.lens_mm[1]) * farther,
    ];
    let (sin, cos) = pose.orientation.sin_cos();
    let onward = [
        (cos * from_lens[0] + sin * from_lens[1]) as f32,
        (cos * from_lens[1] - sin * from_lens[0]) as f32,
    ];
    let outline = Outline::new(&shape.body, onward);
    let overhang = shape.reach_mm - shape.body.half_mm() as f32;
    let per_sigma = 1.0 / shape.spot_mm;

    let rect = layer.rect;
    let mut cells = layer.cells.iter_mut();
    for row in rect.top..rect.bottom {
        for column in rect.left..rect.right {
            let Some(cell) = cells.next() else { return };
            let seen = map.at(column, row);
            if outline.depth(seen[0], seen[1]) + overhang < -margin_mm {
                continue;
            }
            let mut sums = [0u32; PARTS];
            for view in views {
                let [x, y] = view.apply(seen);
                let weights = shape.weights(x, y);
                let mut top = 0;
                for (sum, weight) in sums.iter_mut().zip(weights) {
                    *sum += u32::from(weight);
                    top += u32::from(weight);
                }
                if top < NEARLY_WHOLE {
                    let all = optics.edge.part(outline.depth(x, y) * per_sigma) * WHOLE as f32;
                    sums[SIDE] += (all as u32).saturating_sub(top);
                }
            }
            let colors = &palette.0[optics.order.channel_at(column, row)];
            let cover: u32 = sums.iter().sum();
            let light: u32 = sums.iter().zip(colors).map(|(sum, color)| sum * color).sum();
            let scale = f32::from(FULL) / (WHOLE * view_count as u32) as f32;
            *cell = Cell {
                light: (light as f32 * scale * optics.light.at(column, row)
                    + cover as f32 * scale * optics.light.glare_at(column, row)
                    + 0.5) as u16,
                cover: ((cover as f32 * scale + 0.5) as u16).min(FULL),
            };
        }
    }
}

/// Draws a ball: a disc at the height of its centre, brighter in the middle than at its rim.
pub fn draw_ball(
    optics: &Optics,
    color: [u8; 3],
    radius_mm: f64,
    position: FieldPoint,
    velocity_mm_s: [f64; 2],
    layer: &mut Layer,
) {
    let late_s = optics.shutter.delay_s(optics.model.image_from_field(position, radius_mm).y_px);
    let [vx, vy] = velocity_mm_s;
    let position = FieldPoint::new(position.x_mm + vx * late_s, position.y_mm + vy * late_s);
    let map = LocalMap::new(&optics.model, position, radius_mm, radius_mm);
    let outline = BallOutline::new(optics.lens_mm, position, radius_mm);
    let spot_mm = map.mm_per_px() * optics.spot_px as f32;
    let blur_mm = (velocity_mm_s[0].hypot(velocity_mm_s[1]) * optics.exposure_s / 2.0) as f32;
    let blur_px = blur_mm / map.mm_per_px();
    let corners: [ImagePoint; 4] = std::array::from_fn(|index| {
        let reach_mm = f64::from(outline.reach_mm());
        let sign = |bit: usize| if index & bit == 0 { reach_mm } else { -reach_mm };
        let corner = FieldPoint::new(position.x_mm + sign(1), position.y_mm + sign(2));
        optics.model.image_from_field(corner, radius_mm)
    });
    let margin_px = f64::from(SPOT_REACH) * optics.spot_px + f64::from(blur_px) + 0.5;
    layer.reset(Rect::around(&corners, margin_px, optics.width, optics.height));

    let mut shifts = [[0.0; 2]; MAX_VIEWS];
    let mut view_count = 0;
    for (shift, instant) in shifts.iter_mut().zip(instants(2.0 * blur_px)) {
        let time = instant * optics.exposure_s as f32;
        *shift = velocity_mm_s.map(|speed| speed as f32 * time);
        view_count += 1;
    }
    let shifts = &shifts[..view_count];

    let rect = layer.rect;
    let mut cells = layer.cells.iter_mut();
    for row in rect.top..rect.bottom {
        for column in rect.left..rect.right {
            let Some(cell) = cells.next() else { return };
            let [x, y] = map.at(column, row);
            let value = f32::from(color[optics.order.channel_at(column, row)]);
            let (mut cover, mut shade) = (0.0, 0.0);
            for shift in shifts {
                let (depth_mm, distance) = outline.depth(x - shift[0], y - shift[1]);
                let part = optics.edge.part(depth_mm / spot_mm);
                let rim = distance.min(1.0);
                cover += part;
                shade += part * (0.8 + 0.2 * (1.0 - rim * rim).sqrt());
            }
            let scale = f32::from(FULL) / view_count as f32;
            let light = value * shade * scale * optics.light.at(column, row)
                + cover * scale * optics.light.glare_at(column, row);
            *cell = Cell { light: (light + 0.5) as u16, cover: (cover * scale + 0.5) as u16 };
        }
    }
}

/// The outline of a ball on the plane of its centre. The rays from the lens that touch it form a cone, which
/// cuts the plane in an ellipse, elongated away from the point below the lens, and with its centre a little
/// farther from there.
struct BallOutline {
    /// Direction of the long axis.
    direction: [f32; 2],
    long_mm: f32,
    short_mm: f32,
    /// Offset of the ellipse's centre from the ball's.
    beyond_mm: f32,
}

impl BallOutline {
    fn new(lens_mm: [f64; 3], ball: FieldPoint, radius_mm: f64) -> Self {
        let (dx, dy) = (ball.x_mm - lens_mm[0], ball.y_mm - lens_mm[1]);
        let (beside, above) = (dx.hypot(dy), lens_mm[2] - radius_mm);
        // Rays to both ends of the long axis, on either side of the one to the centre.
        let angle = beside.atan2(above);
        let half = (radius_mm / beside.hypot(above)).min(1.0).asin();
        let far = above * (angle + half).min(1.5).tan();
        let near = above * (angle - half).tan();
        let long_mm = (far - near) / 2.0;
        // Across, it is as wide as a sphere's shadow: a sphere's outline in space is a circle.
        let opening = (angle.cos().powi(2) - half.sin().powi(2)).max(0.01);
        let direction = if beside > 1e-9 { [dx / beside, dy / beside] } else { [1.0, 0.0] };
        Self {
            direction: direction.map(|part| part as f32),
            long_mm: long_mm as f32,
            short_mm: (above * half.sin() / opening.sqrt()) as f32,
            beyond_mm: ((far + near) / 2.0 - beside) as f32,
        }
    }

    /// Limit of the distance of its points from the ball's centre along x or y.
    fn reach_mm(&self) -> f32 {
        self.long_mm.max(self.short_mm) + self.beyond_mm.abs()
    }

    /// Depth inside of a point relative to the ball's centre, and its relative radius, 0–1.
    fn depth(&self, x: f32, y: f32) -> (f32, f32) {
        let [cos, sin] = self.direction;
        let along = (x * cos + y * sin - self.beyond_mm) / self.long_mm;
        let across = (y * cos - x * sin) / self.short_mm;
        let distance = along.hypot(across);
        // Growth of the relative radius per millimetre outwards.
        let slope = (along / self.long_mm).hypot(across / self.short_mm) / distance.max(1e-6);
        let slope = if distance > 1e-3 { slope } else { 1.0 / self.short_mm };
        ((1.0 - distance) / slope, distance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Preset;

    #[test]
    fn the_local_map_agrees_with_the_camera_model_all_over_the_field() {
        for preset in Preset::ALL {
            let config = preset.config();
            let model =
                CameraModel::new(&config.geometry, config.camera.width, config.camera.height)
                    .unwrap();
            let (length, width) = (config.field.length_mm / 2.0, config.field.width_mm / 2.0);
            let mut worst = 0.0f64;
            for (x, y) in [(-1.0, -1.0), (-1.0, 0.9), (0.0, 0.0), (0.7, -0.3), (0.95, 1.0)] {
                let place = FieldPoint::new(x * (length - 40.0), y * (width - 40.0));
                let height = config.robots.height_mm;
                let map = LocalMap::new(&model, place, height, 37.5);
                let center = model.image_from_field(place, height);
                let reach = (45.0 / model.pixel_area_mm2(center, height).sqrt()) as i64;
                for dv in -reach..=reach {
                    for du in -reach..=reach {
                        let column = (center.x_px.round() as i64 + du) as usize;
                        let row = (center.y_px.round() as i64 + dv) as usize;
                        let pixel = ImagePoint::new(column as f64, row as f64);
                        let exact = model.field_from_image(pixel, height);
                        let [x, y] = map.at(column, row);
                        let seen =
                            FieldPoint::new(place.x_mm + f64::from(x), place.y_mm + f64::from(y));
                        worst = worst.max(seen.distance(exact) / f64::from(map.mm_per_px()));
                    }
                }
            }
            assert!(worst < 0.003, "{}: {worst} pixels off", preset.name());
        }
    }

    #[test]
    fn rectangles_meet() {
        let a = Rect { left: 2, top: 3, right: 8, bottom: 9 };
        let b = Rect { left: 6, top: 0, right: 12, bottom: 4 };
        assert_eq!(a.intersection(b), Rect { left: 6, top: 3, right: 8, bottom: 4 });
        assert_eq!(a.union(b), Rect { left: 2, top: 0, right: 12, bottom: 9 });
        assert!(a.intersection(Rect { left: 8, ..a }).is_empty());
        assert_eq!(a.union(Rect::default()), a);
    }

    #[test]
    fn bounding_boxes_stay_in_the_picture() {
        let around = |x, y| Rect::around(&[ImagePoint::new(x, y)], 2.2, 640, 480);
        assert_eq!(around(10.0, 20.0), Rect { left: 8, top: 18, right: 13, bottom: 23 });
        assert_eq!(around(-1.0, 479.0), Rect { left: 0, top: 477, right: 2, bottom: 480 });
        for (x, y) in [(-50.0, 10.0), (9999.0, 10.0), (f64::NAN, f64::NAN), (f64::INFINITY, 1.0)] {
            let rect = around(x, y);
            assert!(rect.right <= 640 && rect.bottom <= 480, "{rect:?}");
            assert!(rect.intersection(rect).is_empty(), "{rect:?}");
        }
    }
}
