//! A picture to draw on. Lines, circles and discs are all drawn the same way: every pixel near
//! them is blended by its signed distance from the shape, which makes their edges smooth.

use super::font;
use image::RgbImage;

/// Red, green, blue.
pub type Color = [u8; 3];

/// A point of the canvas in its pixels; whole numbers are pixel centres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CanvasPoint {
    /// Distance to the right of the origin.
    pub x: f32,
    /// Distance below the origin.
    pub y: f32,
}

/// A rectangle of the canvas: `left..right` by `top..bottom` pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Area {
    /// First column.
    pub left: i32,
    /// First row.
    pub top: i32,
    /// One past the last column.
    pub right: i32,
    /// One past the last row.
    pub bottom: i32,
}

/// The picture. Drawing is clipped to it.
pub struct Canvas {
    pixels: RgbImage,
}

impl Canvas {
    /// Copies the picture in `rgb` (three bytes a pixel, rows without padding), each pixel enlarged
    /// `scale` times, above an empty strip of `footer` rows.
    pub fn enlarged(rgb: &[u8], width: u32, scale: u32, footer: u32) -> Self {
        let height = (rgb.len() / 3) as u32 / width.max(1);
        let pixel = |column: u32, row: u32| {
            let at = 3 * ((row / scale) as usize * width as usize + (column / scale) as usize);
            image::Rgb(rgb.get(at..at + 3).and_then(|rgb| rgb.try_into().ok()).unwrap_or([0; 3]))
        };
        Self { pixels: RgbImage::from_fn(width * scale, height * scale + footer, pixel) }
    }

    /// The finished picture.
    pub fn into_image(self) -> RgbImage {
        self.pixels
    }

    /// The whole canvas.
    pub fn area(&self) -> Area {
        let (right, bottom) = (self.pixels.width() as i32, self.pixels.height() as i32);
        Area { left: 0, top: 0, right, bottom }
    }

    /// Fills a rectangle.
    pub fn rectangle(&mut self, area: Area, color: Color) {
        let area = area.clipped_to(&self.area());
        for y in area.top..area.bottom {
            for x in area.left..area.right {
                self.pixels.put_pixel(x as u32, y as u32, image::Rgb(color));
            }
        }
    }

    /// A straight line.
    pub fn line(&mut self, from: CanvasPoint, to: CanvasPoint, width: f32, color: Color) {
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        let length2 = (dx * dx + dy * dy).max(f32::MIN_POSITIVE);
        self.shape(Area::around(&[from, to], width), color, |x, y| {
            let (px, py) = (x - from.x, y - from.y);
            let along = ((px * dx + py * dy) / length2).clamp(0.0, 1.0);
            (px - along * dx).hypot(py - along * dy) - width / 2.0
        });
    }

    /// A closed line through all points.
    pub fn polygon(&mut self, points: &[CanvasPoint], width: f32, color: Color) {
        for (index, &from) in points.iter().enumerate() {
            self.line(from, points[(index + 1) % points.len()], width, color);
        }
    }

    /// A line with a tip at its end.
    pub fn arrow(&mut self, from: CanvasPoint, to: CanvasPoint, width: f32, color: Color) {
        self.line(from, to, width, color);
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        let length = dx.hypot(dy).max(1.0);
        let (dx, dy) = (dx / length, dy / length);
        let tip = 3.5 * width;
        for side in [-0.7, 0.7] {
            let barb =
                CanvasPoint { x: to.x - tip * (dx - side * dy), y: to.y - tip * (dy + side * dx) };
            self.line(barb, to, width, color);
        }
    }

    /// The outline of a circle.
    pub fn circle(&mut self, center: CanvasPoint, radius: f32, width: f32, color: Color) {
        self.shape(Area::around(&[center], 2.0 * radius + width), color, |x, y| {
            ((x - center.x).hypot(y - center.y) - radius).abs() - width / 2.0
        });
    }

    /// A filled circle.
    pub fn disc(&mut self, center: CanvasPoint, radius: f32, color: Color) {
        self.shape(Area::around(&[center], 2.0 * radius), color, |x, y| {
            (x - center.x).hypot(y - center.y) - radius
        });
    }

    /// A line of text with its top left corner at (`left`, `top`), each pixel of a letter `scale`
    /// times as large.
    pub fn text(&mut self, left: i32, top: i32, scale: i32, color: Color, text: &str) {
        for (index, letter) in (0..).zip(text.chars()) {
            for (row, bits) in (0..).zip(font::rows(letter)) {
                for column in (0..font::WIDTH).filter(|column| bits >> (4 - column) & 1 == 1) {
                    let left = left + (index * font::ADVANCE + column) * scale;
                    let top = top + row * scale;
                    let area = Area { left, top, right: left + scale, bottom: top + scale };
                    self.rectangle(area, color);
                }
            }
        }
    }

    /// Blends `color` over each pixel of `area` by its share of the region where `distance` is
    /// negative.
    fn shape(&mut self, area: Area, color: Color, distance: impl Fn(f32, f32) -> f32) {
        let area = area.clipped_to(&self.area());
        for y in area.top..area.bottom {
            for x in area.left..area.right {
                let share = (0.5 - distance(x as f32, y as f32)).clamp(0.0, 1.0);
                let pixel = self.pixels.get_pixel_mut(x as u32, y as u32);
                for (value, ink) in pixel.0.iter_mut().zip(color) {
                    *value = (f32::from(*value) * (1.0 - share) + f32::from(ink) * share) as u8;
                }
            }
        }
    }
}

/// Size of a line of text in pixels, across and down.
pub fn text_size(scale: i32, text: &str) -> (i32, i32) {
    let letters = text.chars().count() as i32;
    ((letters * font::ADVANCE - 1).max(0) * scale, font::HEIGHT * scale)
}

impl Area {
    /// The smallest area around all points with a margin of `width`.
    pub fn around(points: &[CanvasPoint], width: f32) -> Self {
        let reach = width / 2.0 + 1.0;
        let least =
            |of: fn(&CanvasPoint) -> f32| points.iter().map(of).fold(f32::INFINITY, f32::min);
        let most =
            |of: fn(&CanvasPoint) -> f32| points.iter().map(of).fold(f32::NEG_INFINITY, f32::max);
        // Conversion saturates: points far outside, or not finite, are clipped away.
        Self {
            left: (least(|spot| spot.x) - reach).floor() as i32,
            top: (least(|spot| spot.y) - reach).floor() as i32,
            right: ((most(|spot| spot.x) + reach).ceil() as i32).saturating_add(1),
            bottom: ((most(|spot| spot.y) + reach).ceil() as i32).saturating_add(1),
        }
    }

    /// Its part within `bounds`.
    pub fn clipped_to(&self, bounds: &Self) -> Self {
        Self {
            left: self.left.max(bounds.left),
            top: self.top.max(bounds.top),
            right: self.right.min(bounds.right),
            bottom: self.bottom.min(bounds.bottom),
        }
    }

    /// The area moved to the right and down by these pixels.
    pub fn moved(&self, [x, y]: [i32; 2]) -> Self {
        let Self { left, top, right, bottom } = *self;
        Self { left: left + x, top: top + y, right: right + x, bottom: bottom + y }
    }

    /// The area with `by` more pixels on each side.
    pub fn grown(&self, by: i32) -> Self {
        let Self { left, top, right, bottom } = *self;
        Self {
            left: left.saturating_sub(by),
            top: top.saturating_sub(by),
            right: right.saturating_add(by),
            bottom: bottom.saturating_add(by),
        }
    }

    /// Whether they share a pixel.
    pub fn overlaps(&self, other: &Self) -> bool {
        let both = self.clipped_to(other);
        both.left < both.right && both.top < both.bottom
    }

    /// Whether it lies within `bounds` as a whole.
    pub fn is_within(&self, bounds: &Self) -> bool {
        self.clipped_to(bounds) == *self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INK: Color = [255; 3];

    fn canvas() -> Canvas {
        Canvas::enlarged(&[0; 3 * 20 * 10], 20, 2, 5)
    }

    fn inked(canvas: &Canvas) -> usize {
        canvas.pixels.pixels().filter(|pixel| pixel.0[0] > 127).count()
    }

    #[test]
    fn pixels_become_squares_above_an_empty_strip() {
        let canvas = Canvas::enlarged(&[9, 8, 7, 1, 2, 3], 2, 3, 1);
        assert_eq!(canvas.area(), Area { left: 0, top: 0, right: 6, bottom: 4 });
        let image = canvas.into_image();
        assert_eq!(image.get_pixel(2, 2).0, [9, 8, 7]);
        assert_eq!(image.get_pixel(3, 0).0, [1, 2, 3]);
        assert_eq!(image.get_pixel(3, 3).0, [0; 3]);
    }

    #[test]
    fn shapes_have_their_size_and_place() {
        let mut canvas = canvas();
        canvas.line(CanvasPoint { x: 5.0, y: 5.0 }, CanvasPoint { x: 14.0, y: 5.0 }, 1.0, INK);
        assert_eq!(inked(&canvas), 10);
        assert_eq!(canvas.pixels.get_pixel(14, 5).0, INK);
        let mut canvas = self::canvas();
        canvas.disc(CanvasPoint { x: 20.0, y: 10.0 }, 6.0, INK);
        assert!((inked(&canvas) as f32 - 36.0 * std::f32::consts::PI).abs() < 10.0);
        canvas.disc(CanvasPoint { x: 20.0, y: 10.0 }, 7.0, [0; 3]);
        assert_eq!(inked(&canvas), 0);
    }

    #[test]
    fn text_is_as_large_as_announced() {
        let mut canvas = canvas();
        assert_eq!(text_size(2, "HI"), (22, 14));
        canvas.text(3, 2, 2, INK, "HI");
        let mut drawn = canvas.pixels.enumerate_pixels().filter(|(.., pixel)| pixel.0 == INK);
        // I is narrower than other letters by one pixel on each side.
        assert!(drawn.all(|(x, y, _)| (3..3 + 20).contains(&x) && (2..2 + 14).contains(&y)));
        assert_eq!(inked(&canvas), 4 * (17 + 11));
    }

    #[test]
    fn shapes_outside_the_canvas_are_clipped() {
        let mut canvas = canvas();
        let far = CanvasPoint { x: f32::INFINITY, y: -1e30 };
        let nowhere = CanvasPoint { x: f32::NAN, y: 3.0 };
        canvas.line(CanvasPoint { x: 3.0, y: 3.0 }, far, 3.0, INK);
        canvas.arrow(nowhere, far, 3.0, INK);
        canvas.circle(nowhere, 5.0, 1.0, INK);
        canvas.circle(CanvasPoint { x: 1e9, y: 1e9 }, f32::INFINITY, 1.0, INK);
        canvas.text(-7, 18, 2, INK, "CLIPPED ON ALL SIDES");
        assert!(Area { left: 38, top: 0, right: 42, bottom: 3 }.overlaps(&canvas.area()));
    }
}
