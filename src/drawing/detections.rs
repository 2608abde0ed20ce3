//! Draws all detections over the picture, so that a person can judge at a glance whether colours, layout
//! and camera are set up right.
//!
//! * The field, as the camera geometry places it: thin grey lines.
//! * Every region, outlined in its colour.
//! * Every robot: its body, its patches joined, its heading, its name; a circle if only its team is
//!   known.
//! * The ball, circled.
//! * Every rejected candidate, crossed; with the reason as text where there is room.
//! * Below the picture: how many were found, and which of the configured robots were not.

use super::canvas::{Area, Canvas, CanvasPoint, Color, text_size};
use config::Config;
use config::{PatchConfig, Top};
use geometry::layout::Layout;
use geometry::{CameraModel, FieldPoint, GeometryError, ImagePoint, Pose};
use image::RgbImage;
use messages::{DetectedBall, DetectedRobot, DetectionFrame, Region, RejectReason, Rejected, Team};
use std::f32::consts::TAU;

/// Approximate width of an overlay: small pictures are enlarged until a patch can be judged.
const WIDTH_PX: u32 = 1920;
const MAX_SCALE: u32 = 4;
/// Scale of the letters: screen pixels per pixel of the font.
const LETTER: i32 = 2;
/// Padding between a text and the edge of its background.
const PADDING: i32 = 4;

const BLACK: Color = [0, 0, 0];
const WHITE: Color = [255, 255, 255];
const GREY: Color = [130, 130, 130];
const ALARM: Color = [255, 70, 70];
/// Magenta, a colour that no patch has.
const JOINED: Color = [255, 60, 255];

/// Draws overlays for one configuration.
pub struct Overlay<'a> {
    config: &'a Config,
    camera: CameraModel,
    /// One entry for each distinct arrangement of patches.
    layouts: Vec<(&'a [PatchConfig], Layout)>,
    scale: u32,
}

impl<'a> Overlay<'a> {
    /// For pictures of the configured size.
    pub fn new(config: &'a Config) -> Result<Self, GeometryError> {
        let (width, height) = (config.camera.width, config.camera.height);
        let mut layouts: Vec<(&[PatchConfig], Layout)> = Vec::new();
        for identity in &config.robots.identities {
            let Top { patches, .. } = config.top_of(identity);
            if !layouts.iter().any(|(known, _)| *known == patches) {
                layouts.push((patches, Layout::new(patches)));
            }
        }
        Ok(Self {
            config,
            camera: CameraModel::new(&config.geometry, width, height)?,
            layouts,
            scale: ((WIDTH_PX + width / 2) / width.max(1)).clamp(1, MAX_SCALE),
        })
    }

    /// Draws the detections over their picture (three bytes a pixel, rows without padding).
    pub fn draw(&self, rgb: &[u8], seen: &DetectionFrame) -> RgbImage {
        let line_height = text_size(LETTER, "").1 + 2 * PADDING;
        let footer = 2 * line_height as u32;
        let canvas = Canvas::enlarged(rgb, self.config.camera.width, self.scale, footer);
        let mut picture = canvas.area();
        picture.bottom -= footer as i32;
        let mut drawing = Drawing { overlay: self, canvas, picture, taken: Vec::new() };
        drawing.draw_field();
        for region in seen.regions() {
            drawing.outline(seen, region);
        }
        for robot in seen.robots() {
            drawing.draw_robot(seen, robot);
        }
        if let Some(ball) = seen.balls().first() {
            drawing.draw_ball(ball);
        }
        for rejected in seen.rejected() {
            drawing.cross_out(rejected);
        }
        // Names come last, when the areas that they must not cover are known.
        drawing.name_everything(seen);
        drawing.sum_up(seen, line_height);
        drawing.canvas.into_image()
    }

    fn spot(&self, x_px: f64, y_px: f64) -> CanvasPoint {
        let at = |value: f64| ((value + 0.5) * f64::from(self.scale) - 0.5) as f32;
        CanvasPoint { x: at(x_px), y: at(y_px) }
    }

    fn image_spot(&self, point: ImagePoint) -> CanvasPoint {
        self.spot(point.x_px, point.y_px)
    }

    fn looks(&self, color: &str) -> Color {
        let color = self.config.colors.iter().find(|known| known.name == color);
        color.map_or(WHITE, |color| color.looks)
    }

    fn team_color(&self, team: u32) -> Color {
        match Team::from_number(team) {
            Some(team) => self.looks(self.config.teams.color(team)),
            None if team == Rejected::BALL => self.looks(&self.config.ball.color),
            None => WHITE,
        }
    }

    /// Side of a robot in the overlay, at a point of the picture.
    fn robot_size(&self, x_px: f64, y_px: f64) -> f32 {
        self.length(self.config.robots.size_mm, self.config.robots.height_mm, x_px, y_px)
    }

    /// A length in the overlay, at a height above a point of the picture.
    fn length(&self, length_mm: f64, height_mm: f64, x_px: f64, y_px: f64) -> f32 {
        let pixel = self.camera.pixel_area_mm2(ImagePoint::new(x_px, y_px), height_mm);
        let size = length_mm / pixel.max(1e-6).sqrt() * f64::from(self.scale);
        (size as f32).clamp(4.0, 1000.0)
    }
}

struct Drawing<'a> {
    overlay: &'a Overlay<'a>,
    canvas: Canvas,
    /// The part of the canvas that shows the picture.
    picture: Area,
    /// Areas that no text may cover.
    taken: Vec<Area>,
}

impl Drawing<'_> {
    fn draw_field(&mut self) {
        /// Segments of a line, which the lens bends.
        const STEPS: i32 = 24;
        let field = &self.overlay.config.field;
        let (x, y) = (field.length_mm / 2.0, field.width_mm / 2.0);
        let corners = [(-x, y), (x, y), (x, -y), (-x, -y)];
        let mut points = Vec::new();
        for (index, from) in corners.iter().enumerate() {
            let to = corners[(index + 1) % corners.len()];
            for step in 0..STEPS {
                let share = f64::from(step) / f64::from(STEPS);
                let on_side = |from: f64, to: f64| from + (to - from) * share;
                let point = FieldPoint::new(on_side(from.0, to.0), on_side(from.1, to.1));
                let point = self.overlay.camera.image_from_field(point, 0.0);
                points.push(self.overlay.image_spot(point));
            }
        }
        self.canvas.polygon(&points, 1.0, GREY);
    }

    /// Draws a double line around the pixels of a region: its colour outside, black inside, so that it
    /// shows on pixels of that colour too.
    fn outline(&mut self, seen: &DetectionFrame, region: &Region) {
        let color = self.overlay.config.colors.get(region.class as usize);
        let color = color.map_or(WHITE, |color| color.looks);
        let columns = usize::from(region.right.saturating_sub(region.left)) + 1;
        let rows = usize::from(region.bottom.saturating_sub(region.top)) + 1;
        let mut inside = vec![false; columns * rows];
        for run in seen.runs_of(region) {
            for column in run.begin..run.end {
                let (x, y) = (column.wrapping_sub(region.left), run.row.wrapping_sub(region.top));
                if usize::from(x) < columns && usize::from(y) < rows {
                    inside[usize::from(y) * columns + usize::from(x)] = true;
                }
            }
        }
        let is_inside = |x: i32, y: i32| {
            let within = (0..columns as i32).contains(&x) && (0..rows as i32).contains(&y);
            within && inside[y as usize * columns + x as usize]
        };
        let scale = self.overlay.scale as i32;
        for y in 0..rows as i32 {
            for x in (0..columns as i32).filter(|&x| is_inside(x, y)) {
                let left = (i32::from(region.left) + x) * scale;
                let top = (i32::from(region.top) + y) * scale;
                let (right, bottom) = (left + scale, top + scale);
                let edges = [
                    (-1, 0, Area { left: left - 1, top, right: left, bottom }, [1, 0]),
                    (1, 0, Area { left: right, top, right: right + 1, bottom }, [-1, 0]),
                    (0, -1, Area { left, top: top - 1, right, bottom: top }, [0, 1]),
                    (0, 1, Area { left, top: bottom, right, bottom: bottom + 1 }, [0, -1]),
                ];
                for (dx, dy, outer, inward) in edges {
                    if !is_inside(x + dx, y + dy) {
                        let outer = outer.clipped_to(&self.picture);
                        self.canvas.rectangle(outer, color);
                        if scale > 1 {
                            self.canvas.rectangle(outer.moved(inward), BLACK);
                        }
                    }
                }
            }
        }
    }

    fn draw_robot(&mut self, seen: &DetectionFrame, robot: &DetectedRobot) {
        let overlay = self.overlay;
        let config = &overlay.config.robots;
        if !robot.is_identified() {
            let (x, y) = (f64::from(robot.x_px), f64::from(robot.y_px));
            let (center, diameter) = (overlay.spot(x, y), overlay.robot_size(x, y));
            self.canvas.circle(center, diameter / 2.0, 1.0, overlay.team_color(robot.team));
            self.taken.push(Area::around(&[center], diameter));
            return;
        }
        let pose = Pose {
            position: FieldPoint::new(f64::from(robot.x_mm), f64::from(robot.y_mm)),
            orientation: f64::from(robot.orientation),
        };
        let top = overlay.config.top(robot.team, robot.robot_id.number());
        let at = |point: [f64; 2]| {
            let point = pose.field_from_robot(point);
            overlay.image_spot(overlay.camera.image_from_field(point, top.height_mm))
        };
        let outline = config.body(top.patches).outline();
        let body: Vec<CanvasPoint> = outline.into_iter().map(at).collect();
        self.canvas.polygon(&body, 1.0, overlay.team_color(robot.team));

        let size = overlay.robot_size(f64::from(robot.x_px), f64::from(robot.y_px));
        let layout = overlay.layouts.iter().find(|(patches, _)| *patches == top.patches);
        let expected = layout.into_iter().flat_map(|(_, layout)| &layout.patches);
        let patches = robot.patch_regions.iter().take(robot.patch_count as usize);
        let patches: Vec<CanvasPoint> = patches
            .zip(expected)
            .filter_map(|(&region, patch)| Some((seen.regions().get(region as usize)?, patch)))
            .map(|(region, patch)| {
                let seen = overlay.spot(f64::from(region.x_px), f64::from(region.y_px));
                let expected = at(patch.centroid_mm);
                // If a region extends far beyond the robot, only a part of it is the patch.
                let off = (seen.x - expected.x).hypot(seen.y - expected.y);
                if off < size / 4.0 { seen } else { expected }
            })
            .collect();
        if patches.len() > 1 {
            self.canvas.polygon(&patches, 3.0, BLACK);
            self.canvas.polygon(&patches, 1.5, JOINED);
        }
        for &patch in &patches {
            self.canvas.disc(patch, 3.5, BLACK);
            self.canvas.disc(patch, 2.0, WHITE);
        }

        let (center, ahead) = (at([0.0, 0.0]), at([config.size_mm * 1.1, 0.0]));
        self.canvas.arrow(center, ahead, 4.0, BLACK);
        self.canvas.arrow(center, ahead, 2.0, WHITE);
        self.taken.push(Area::around(&body, 0.0));
        self.taken.push(Area::around(&[center, ahead], 6.0));
    }

    fn draw_ball(&mut self, ball: &DetectedBall) {
        let (x, y) = (f64::from(ball.x_px), f64::from(ball.y_px));
        let center = self.overlay.spot(x, y);
        let config = &self.overlay.config;
        let diameter =
            self.overlay.robot_size(x, y) as f64 * config.ball.diameter_mm / config.robots.size_mm;
        let radius = diameter as f32 / 2.0 + 8.0;
        self.canvas.circle(center, radius, 5.0, BLACK);
        self.canvas.circle(center, radius, 2.5, self.overlay.looks(&config.ball.color));
        self.canvas.disc(center, 2.5, BLACK);
        self.canvas.disc(center, 1.5, WHITE);
        self.taken.push(Area::around(&[center], 2.0 * radius));
    }

    fn cross_out(&mut self, rejected: &Rejected) {
        let (x, y) = (f64::from(rejected.x_px), f64::from(rejected.y_px));
        let center = self.overlay.spot(x, y);
        let arm = if is_noise(rejected) { 0.5 * CROSS_PX } else { CROSS_PX };
        let corner = |x: f32, y: f32| CanvasPoint { x: center.x + x * arm, y: center.y + y * arm };
        for (width, color) in [(5.0, BLACK), (2.5, self.overlay.team_color(rejected.team))] {
            self.canvas.line(corner(-1.0, -1.0), corner(1.0, 1.0), width, color);
            self.canvas.line(corner(-1.0, 1.0), corner(1.0, -1.0), width, color);
        }
        // A rejected robot still covers a robot's area: text must not hide the cause of the rejection.
        let size = if is_noise(rejected) { 2.0 * arm } else { self.overlay.robot_size(x, y) };
        self.taken.push(Area::around(&[center], size));
    }

    fn name_everything(&mut self, seen: &DetectionFrame) {
        for robot in seen.robots() {
            let (x, y) = (f64::from(robot.x_px), f64::from(robot.y_px));
            let text = short_name(robot.team, robot.robot_id.number());
            let radius = 0.75 * self.overlay.robot_size(x, y);
            let color = self.overlay.team_color(robot.team);
            self.label(self.overlay.spot(x, y), radius, &text, LETTER + 1, color, true);
        }
        if let Some(ball) = seen.balls().first() {
            let (x, y) = (f64::from(ball.x_px), f64::from(ball.y_px));
            let radius = 0.5 * self.overlay.robot_size(x, y);
            let color = self.overlay.team_color(Rejected::BALL);
            self.label(self.overlay.spot(x, y), radius, "ball", LETTER, color, true);
        }
        for rejected in seen.rejected() {
            let (x, y) = (f64::from(rejected.x_px), f64::from(rejected.y_px));
            let reason = RejectReason::from_number(rejected.reason);
            let text = reason.map_or("unknown reason", RejectReason::text);
            let color = self.overlay.team_color(rejected.team);
            let (letter, radius) = if is_noise(rejected) {
                (LETTER - 1, CROSS_PX)
            } else {
                (LETTER, 0.6 * self.overlay.robot_size(x, y))
            };
            self.label(self.overlay.spot(x, y), radius, text, letter, color, false);
        }
    }

    /// Writes next to a point where nothing is covered; without such room, over whatever is there if the
    /// text is required, or not at all.
    fn label(
        &mut self,
        center: CanvasPoint,
        radius: f32,
        text: &str,
        letter: i32,
        color: Color,
        must: bool,
    ) {
        let (width, height) = text_size(letter, text);
        let padding = PADDING * letter / LETTER;
        let (width, height) = (width + 2 * padding, height + 2 * padding);
        let beside = |step: u8, distance: f32| {
            // Above first, then around.
            let (sin, cos) = (TAU * (0.25 + f32::from(step) / 12.0)).sin_cos();
            let x = center.x + cos * (distance + width as f32 / 2.0);
            let y = center.y - sin * (distance + height as f32 / 2.0);
            let left = (x as i32).saturating_sub(width / 2);
            let top = (y as i32).saturating_sub(height / 2);
            Area {
                left,
                top,
                right: left.saturating_add(width),
                bottom: top.saturating_add(height),
            }
        };
        let free = |area: &Area| {
            area.is_within(&self.picture) && !self.taken.iter().any(|taken| taken.overlaps(area))
        };
        let mut places = [0.0, 0.6, 1.2]
            .into_iter()
            .flat_map(|further| (0..12).map(move |step| (step, radius * (1.0 + further))))
            .map(|(step, distance)| beside(step, distance));
        let anyway = || Some(beside(0, radius)).filter(|area| must && area.overlaps(&self.picture));
        let Some(area) = places.find(free).or_else(anyway) else { return };
        self.canvas.rectangle(area.grown(1), BLACK);
        self.canvas.rectangle(area, color);
        let (left, top) = (area.left + padding, area.top + padding);
        self.canvas.text(left, top, letter, ink_on(color), text);
        self.taken.push(area);
    }

    fn sum_up(&mut self, seen: &DetectionFrame, line_height: i32) {
        let robots = &self.overlay.config.robots.identities;
        let is_found = |team: u32, id: u32| {
            seen.robots()
                .iter()
                .any(|robot| (robot.team, robot.robot_id.number()) == (team, Some(id)))
        };
        let missing: Vec<String> = robots
            .iter()
            .filter(|robot| !is_found(robot.team as u32, robot.id))
            .map(|robot| short_name(robot.team as u32, Some(robot.id)))
            .collect();
        let known = seen.robots().iter().filter(|robot| robot.is_identified()).count();
        let unknown = match seen.robots().len() - known {
            0 => String::new(),
            count => format!(" and {count} unknown"),
        };
        let found = format!(
            "{known} of {} robots{unknown}, {}, {} regions, {} rejected",
            robots.len(),
            if seen.balls().is_empty() { "no ball" } else { "ball" },
            seen.regions().len(),
            seen.rejected().len(),
        );
        let left = PADDING;
        let mut top = self.picture.bottom + PADDING;
        self.canvas.text(left, top, LETTER, WHITE, &found);
        top += line_height;
        if !missing.is_empty() {
            let text = format!("not found: {}", missing.join(" "));
            self.canvas.text(left, top, LETTER, ALARM, &text);
        }
    }
}

/// Half the width of the cross over a rejected candidate.
const CROSS_PX: f32 = 10.0;

/// Whether the reason for rejection is one that busy surroundings cause in large numbers; drawn small.
fn is_noise(rejected: &Rejected) -> bool {
    [RejectReason::TooSmall, RejectReason::OutsideField]
        .iter()
        .any(|&reason| rejected.reason == reason as u32)
}

/// "Y3": team and number.
fn short_name(team: u32, id: Option<u32>) -> String {
    let team = Team::from_number(team).map_or("?", Team::name);
    let id = id.map_or("?".into(), |id| id.to_string());
    format!("{}{id}", team[..1].to_uppercase())
}

/// Black or white, whichever contrasts with a colour.
fn ink_on([red, green, blue]: Color) -> Color {
    let brightness = 3 * u32::from(red) + 6 * u32::from(green) + u32::from(blue);
    if brightness > 1200 { BLACK } else { WHITE }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use messages::Run;

    fn seen() -> Box<DetectionFrame> {
        let mut seen = Box::new(DetectionFrame::zeroed());
        for (index, row) in (10..20).enumerate() {
            seen.runs[index] = Run { row, begin: 30, end: 40, class: 1, reserved: 0 };
        }
        seen.run_count = 10;
        seen.region_count = 1;
        seen.regions[0] = Region {
            class: 1,
            pixel_count: 100,
            x_px: 34.5,
            y_px: 14.5,
            left: 30,
            top: 10,
            right: 39,
            bottom: 19,
            first_run: 0,
            run_count: 10,
        };
        seen
    }

    #[test]
    fn a_region_is_outlined_in_its_colour() {
        let config = Config::default();
        let overlay = Overlay::new(&config).unwrap();
        let image = overlay.draw(&[0; 640 * 480 * 3], &seen());
        let looks = image::Rgb(config.colors[1].looks);
        let colored = image.enumerate_pixels().filter(|(_, _, pixel)| **pixel == looks);
        let places: Vec<(u32, u32)> = colored.map(|(x, y, _)| (x, y)).collect();
        // Three pixels each; the outline lies just outside.
        assert_eq!(places.len(), 4 * 30);
        assert!(places.iter().all(|&(x, y)| (89..121).contains(&x) && (29..61).contains(&y)));
        assert!(places.contains(&(89, 30)) && places.contains(&(120, 59)));
    }

    #[test]
    fn robots_ball_and_rejected_are_drawn_where_they_are() {
        let config = Config::default();
        let overlay = Overlay::new(&config).unwrap();
        let blank = |seen: &DetectionFrame| overlay.draw(&[0; 640 * 480 * 3], seen);
        let mut seen = Box::new(DetectionFrame::zeroed());
        let before = blank(&seen);
        seen.push_robot(DetectedRobot {
            team: 1,
            robot_id: 2.into(),
            x_px: 320.0,
            y_px: 240.0,
            ..DetectedRobot::default()
        });
        seen.push_ball(DetectedBall { x_px: 100.0, y_px: 50.0, ..DetectedBall::default() });
        seen.push_rejected(Rejected { team: 0, reason: 5, x_px: 500.0, y_px: 400.0 });
        let after = blank(&seen);
        let changed_near = |x: u32, y: u32| {
            let (x, y) = (3 * x, 3 * y);
            (x - 40..x + 40)
                .flat_map(|x| (y - 40..y + 40).map(move |y| (x, y)))
                .any(|(x, y)| before.get_pixel(x, y) != after.get_pixel(x, y))
        };
        assert!(changed_near(100, 50) && changed_near(500, 400) && changed_near(320, 240));
        assert!(!changed_near(200, 350));
    }

    #[test]
    fn absurd_detections_do_not_fail() {
        let config = Config::default();
        let overlay = Overlay::new(&config).unwrap();
        let mut seen = seen();
        let nowhere = f32::NAN;
        seen.push_robot(DetectedRobot {
            team: 77,
            x_mm: f32::INFINITY,
            y_mm: nowhere,
            x_px: nowhere,
            y_px: f32::NEG_INFINITY,
            patch_count: u32::MAX,
            patch_regions: [0, 5, u32::MAX, 0, 0, 0],
            ..DetectedRobot::default()
        });
        seen.push_ball(DetectedBall { x_px: nowhere, y_px: 1e30, ..DetectedBall::default() });
        seen.push_rejected(Rejected { team: 9, reason: 99, x_px: -1e30, y_px: nowhere });
        seen.regions[0].right = 5;
        seen.regions[0].class = 40;
        let image = overlay.draw(&[0; 640 * 480 * 3], &seen);
        assert_eq!(image.width(), 1920);
        // A picture that is too short must not make it fail either.
        overlay.draw(&[0; 10], &seen);
    }
}
