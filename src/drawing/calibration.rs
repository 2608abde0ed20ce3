//! Draws the pitch over the picture in which it was measured: where drawn and painted lines coincide,
//! the geometry is right.
//!
//! * The lines of the pitch, projected by the calibration.
//! * Every marked point: a numbered ring where it was marked, and a dot where the calibration projects
//!   it. The distance from ring to dot is drawn ten times as long.
//! * A cross at the point below the lens.

use super::canvas::{Area, Canvas, CanvasPoint, Color, text_size};
use config::FieldConfig;
use geometry::{FieldPoint, ImagePoint};
use image::RgbImage;
use offline::calibration::Calibration;
use offline::calibration::picture::points::NamedMark;
use std::f64::consts::TAU;

/// Approximate width of an overlay.
const WIDTH_PX: u32 = 1920;
/// Factor by which errors are enlarged.
const ENLARGED: f64 = 10.0;
const LETTER: i32 = 2;

const BLACK: Color = [0, 0, 0];
const WHITE: Color = [255, 255, 255];
const LINE: Color = [90, 255, 130];
const RAISED: Color = [90, 200, 255];
const MARK: Color = [255, 60, 255];
const ERROR: Color = [255, 70, 70];

/// Draws pitch and points over the picture they were marked in.
pub fn draw(
    picture: &RgbImage,
    field: &FieldConfig,
    points: &[NamedMark],
    calibration: &Calibration,
) -> RgbImage {
    let scale = ((WIDTH_PX + picture.width() / 2) / picture.width().max(1)).clamp(1, 4);
    let canvas = Canvas::enlarged(picture.as_raw(), picture.width(), scale, 0);
    let mut drawing = Drawing { canvas, scale, calibration };
    let wall = points.iter().fold(0.0f64, |top, point| top.max(point.mark.field_mm[2]));
    let (x, y) = (field.length_mm / 2.0, field.width_mm / 2.0);
    let around = [[-x, y], [x, y], [x, -y], [-x, -y], [-x, y]];
    if wall > 0.0 {
        drawing.path(&around, wall, RAISED);
    }
    drawing.path(&around, 0.0, LINE);
    drawing.path(&[[0.0, y], [0.0, -y]], 0.0, LINE);
    let circle: Vec<[f64; 2]> = (0..=48)
        .map(|step| TAU * f64::from(step) / 48.0)
        .map(|angle| [angle.cos(), angle.sin()].map(|part| part * field.center_circle_radius_mm))
        .collect();
    drawing.path(&circle, 0.0, LINE);
    for side in [-1.0, 1.0] {
        let (goal, back) = (field.goal_width_mm / 2.0, side * (x + field.goal_depth_mm));
        let mouth = [[side * x, goal], [back, goal], [back, -goal], [side * x, -goal]];
        drawing.path(&mouth, 0.0, LINE);
    }
    drawing.below_the_lens();
    for (index, (point, error)) in points.iter().zip(&calibration.errors_px).enumerate() {
        drawing.mark(index + 1, point.mark.image_px, *error);
    }
    drawing.canvas.into_image()
}

struct Drawing<'a> {
    canvas: Canvas,
    scale: u32,
    calibration: &'a Calibration,
}

impl Drawing<'_> {
    fn spot(&self, [x_px, y_px]: [f64; 2]) -> CanvasPoint {
        let at = |value: f64| ((value + 0.5) * f64::from(self.scale) - 0.5) as f32;
        CanvasPoint { x: at(x_px), y: at(y_px) }
    }

    fn image_spot(&self, [x, y]: [f64; 2], height_mm: f64) -> CanvasPoint {
        let ImagePoint { x_px, y_px } =
            self.calibration.model.image_from_field(FieldPoint::new(x, y), height_mm);
        self.spot([x_px, y_px])
    }

    /// Draws straight lines of the pitch, bent by the lens.
    fn path(&mut self, corners: &[[f64; 2]], height_mm: f64, color: Color) {
        const STEPS: i32 = 24;
        for pair in corners.windows(2) {
            let at = |step: i32| {
                let share = f64::from(step) / f64::from(STEPS);
                [0, 1].map(|axis| pair[0][axis] + share * (pair[1][axis] - pair[0][axis]))
            };
            for step in 0..STEPS {
                let from = self.image_spot(at(step), height_mm);
                let to = self.image_spot(at(step + 1), height_mm);
                self.canvas.line(from, to, 1.0, color);
            }
        }
    }

    fn below_the_lens(&mut self) {
        let [x, y, _] = self.calibration.geometry.camera_mm;
        let CanvasPoint { x, y } = self.image_spot([x, y], 0.0);
        for (width, color) in [(4.0, BLACK), (2.0, WHITE)] {
            let arm = 10.0;
            self.canvas.line(
                CanvasPoint { x: x - arm, y },
                CanvasPoint { x: x + arm, y },
                width,
                color,
            );
            self.canvas.line(
                CanvasPoint { x, y: y - arm },
                CanvasPoint { x, y: y + arm },
                width,
                color,
            );
        }
        self.label(CanvasPoint { x: x + 14.0, y: y + 14.0 }, "lens", WHITE);
    }

    fn mark(&mut self, number: usize, marked_px: [f64; 2], error_px: [f64; 2]) {
        let marked = self.spot(marked_px);
        let fitted = self.spot([0, 1].map(|axis| marked_px[axis] - error_px[axis]));
        let far = self.spot([0, 1].map(|axis| marked_px[axis] - ENLARGED * error_px[axis]));
        self.canvas.line(marked, far, 2.0, ERROR);
        self.canvas.circle(marked, 9.0, 4.0, BLACK);
        self.canvas.circle(marked, 9.0, 2.0, MARK);
        self.canvas.disc(fitted, 3.0, BLACK);
        self.canvas.disc(fitted, 2.0, WHITE);
        let beside = CanvasPoint { x: marked.x + 14.0, y: marked.y + 8.0 };
        self.label(beside, &number.to_string(), MARK);
    }

    fn label(&mut self, at: CanvasPoint, text: &str, color: Color) {
        let (width, height) = text_size(LETTER, text);
        let bounds = self.canvas.area();
        // Kept inside the picture, also for points at its edge.
        let left = (at.x as i32).clamp(2, (bounds.right - width - 2).max(2));
        let top = (at.y as i32).clamp(2, (bounds.bottom - height - 2).max(2));
        let area = Area { left, top, right: left + width, bottom: top + height };
        self.canvas.rectangle(area.grown(2), BLACK);
        self.canvas.text(left, top, LETTER, color, text);
    }
}
