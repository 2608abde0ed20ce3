//! The field mask: pixels that can show something on the field.
//!
//! Robots and ball are on the field or near it. Spectators, cables and a referee's shoes beside it only cost
//! time and can be taken for a ball. At construction, the line of sight of each pixel is followed from the
//! height of a robot's top down to the floor: if all of it lies outside the field, the pixel is left out.

use config::Config;
use geometry::layout::contains;
use geometry::{CameraModel, FieldPoint, ImagePoint};

/// A stretch of columns, `begin..end`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Span {
    /// First column.
    pub begin: usize,
    /// Column behind the last one; above `begin`.
    pub end: usize,
}

impl Span {
    /// From the first column of an ordered list of spans to its last; `None` if the list is empty.
    #[inline(always)]
    pub fn hull(spans: &[Self]) -> Option<Self> {
        match spans {
            [] => None,
            [first, .., last] => Some(Self { begin: first.begin, end: last.end }),
            [only] => Some(*only),
        }
    }

    /// The shortest span that contains both.
    #[inline(always)]
    pub fn hull_with(self, other: Self) -> Self {
        Self { begin: self.begin.min(other.begin), end: self.end.max(other.end) }
    }

    /// The columns in both; if there are none, `begin` is not below `end`.
    #[inline(always)]
    pub fn within(self, other: Self) -> Self {
        Self { begin: self.begin.max(other.begin), end: self.end.min(other.end) }
    }

    /// A bit for each of the columns `start..start + count` that is in the span; `count` is at most 64.
    #[inline(always)]
    pub fn bits(self, start: usize, count: usize) -> u64 {
        let begin = self.begin.max(start);
        let end = self.end.min(start + count);
        if begin < end { !0 >> (64 - (end - begin)) << (begin - start) } else { 0 }
    }
}

/// The pixels that are classified, row by row; all others are background.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldMask {
    /// The spans of all rows, from top to bottom.
    spans: Vec<Span>,
    /// For each row, the end of its spans in the list; they begin where those of the row above end.
    ends: Vec<usize>,
}

impl FieldMask {
    /// All pixels of pictures of this size.
    pub fn everything(width: u32, height: u32) -> Self {
        let (width, height) = (width as usize, height as usize);
        Self { spans: vec![Span { begin: 0, end: width }; height], ends: (1..=height).collect() }
    }

    /// For the configured field, margin, goals and further areas. All pixels if the mask is switched off, if
    /// there is no usable geometry, or if by the geometry the picture shows nothing of the field.
    pub fn new(config: &Config) -> Self {
        let (width, height) = (config.camera.width, config.camera.height);
        let everything = || Self::everything(width, height);
        if !config.field.mask {
            return everything();
        }
        let Ok(model) = CameraModel::new(&config.geometry, width, height) else {
            return everything();
        };
        let area = Area::new(config, model);
        Self::of_tiles(width, height, |point| area.may_show_at(point)).unwrap_or_else(everything)
    }

    /// Evaluates `is_inside` at the corners of square tiles, about 160 in a row, and takes all tiles within
    /// one tile of a corner where it holds: a margin of at least 1/160 of the picture. `None` if it holds
    /// nowhere.
    fn of_tiles(width: u32, height: u32, is_inside: impl Fn(ImagePoint) -> bool) -> Option<Self> {
        let (width, height) = (width as usize, height as usize);
        let tile = width.max(height).div_ceil(160).max(4);
        let (columns, rows) = (width.div_ceil(tile), height.div_ceil(tile));
        let corners: Vec<bool> = (0..(columns + 1) * (rows + 1))
            .map(|index| (index % (columns + 1) * tile, index / (columns + 1) * tile))
            .map(|(x, y)| is_inside(ImagePoint::new(x as f64, y as f64)))
            .collect();
        // The tile's own corners, and those one tile further.
        let is_near = |column: usize, row: usize| {
            let around =
                |index: usize, last: usize| index.saturating_sub(1)..=(index + 2).min(last);
            around(row, rows)
                .any(|y| around(column, columns).any(|x| corners[y * (columns + 1) + x]))
        };
        let mut mask = Self { spans: Vec::new(), ends: Vec::with_capacity(height) };
        for tile_row in 0..rows {
            let mut spans: Vec<Span> = Vec::new();
            for column in (0..columns).filter(|&column| is_near(column, tile_row)) {
                let (begin, end) = (column * tile, ((column + 1) * tile).min(width));
                match spans.last_mut() {
                    Some(last) if last.end == begin => last.end = end,
                    _ => spans.push(Span { begin, end }),
                }
            }
            for _ in tile_row * tile..((tile_row + 1) * tile).min(height) {
                mask.spans.extend_from_slice(&spans);
                mask.ends.push(mask.spans.len());
            }
        }
        (!mask.spans.is_empty()).then_some(mask)
    }

    /// Number of pixels to classify.
    pub fn pixels(&self) -> usize {
        self.spans.iter().map(|span| span.end - span.begin).sum()
    }

    /// The spans of a row, from left to right; they neither overlap nor touch.
    ///
    /// # Panics
    /// If there is no such row.
    pub fn spans(&self, row: usize) -> &[Span] {
        let begin = if row == 0 { 0 } else { self.ends[row - 1] };
        &self.spans[begin..self.ends[row]]
    }
}

/// The area of interest on the field, and the camera that sees it.
struct Area<'a> {
    model: CameraModel,
    /// Half extents of the field and of the field with its goals, each with margin and half a robot: a robot
    /// counts if its centre is within the margin.
    rectangles: [[f64; 2]; 2],
    further: &'a [Vec<[f64; 2]>],
    /// Height of the tallest object.
    height_mm: f64,
}

/// Intervals between floor and robot's top at which a line of sight is tested.
const HEIGHTS: u32 = 4;

impl<'a> Area<'a> {
    fn new(config: &'a Config, model: CameraModel) -> Self {
        let (field, robots) = (&config.field, &config.robots);
        // Reach of a robot's body, or of a ball if that is larger.
        let body_mm = robots.body(&robots.patches).reach_mm();
        let reach_mm = field.margin_mm + (1.01 * body_mm).max(config.ball.diameter_mm);
        let (half_length, half_width) = (field.length_mm / 2.0, field.width_mm / 2.0);
        Self {
            model,
            rectangles: [
                [half_length, half_width],
                [half_length + field.goal_depth_mm, field.goal_width_mm / 2.0],
            ]
            .map(|half| half.map(|half| half + reach_mm)),
            further: &field.also_look_at_mm,
            height_mm: config.tallest_robot_mm().max(config.ball.diameter_mm),
        }
    }

    /// Whether a pixel can show something in the area.
    fn may_show_at(&self, pixel: ImagePoint) -> bool {
        let floor = self.model.field_from_image(pixel, 0.0);
        let top = self.model.field_from_image(pixel, self.height_mm);
        // A line of sight is straight.
        (0..=HEIGHTS).map(|step| f64::from(step) / f64::from(HEIGHTS)).any(|share| {
            let between = |a: f64, b: f64| a + share * (b - a);
            let point =
                FieldPoint::new(between(floor.x_mm, top.x_mm), between(floor.y_mm, top.y_mm));
            self.holds(point)
        })
    }

    fn holds(&self, point: FieldPoint) -> bool {
        let FieldPoint { x_mm, y_mm } = point;
        let in_rectangle = |&[x, y]: &[f64; 2]| x_mm.abs() <= x && y_mm.abs() <= y;
        self.rectangles.iter().any(in_rectangle)
            || self.further.iter().any(|outline| contains(outline, [x_mm, y_mm]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Preset;

    fn is_in(mask: &FieldMask, point: ImagePoint) -> bool {
        let (x, y) = (point.x_px.round() as usize, point.y_px.round() as usize);
        mask.spans(y).iter().any(|span| span.begin <= x && x < span.end)
    }

    /// A camera at twice its height and off the middle, so that it sees much beside the field.
    fn high_camera() -> Config {
        let mut config = Config::default();
        for pair in &mut config.geometry.points {
            pair.image_px = [pair.image_px[0] / 2.0 + 200.0, pair.image_px[1] / 2.0 + 90.0];
        }
        config.geometry.camera_mm = [200.0, 100.0, 4000.0];
        config
    }

    #[test]
    fn all_relevant_pixels_are_in_the_mask() {
        for config in Preset::ALL.map(Preset::config).into_iter().chain([high_camera()]) {
            let mask = FieldMask::new(&config);
            let (width, height) = (config.camera.width, config.camera.height);
            let model = CameraModel::new(&config.geometry, width, height).unwrap();
            let robots = &config.robots;
            let body_mm = robots.body(&robots.patches).reach_mm();
            let reach = config.field.margin_mm + 0.99 * body_mm;
            let [x, y] = [config.field.length_mm, config.field.width_mm].map(|v| v / 2.0 + reach);
            let goal_x = x + config.field.goal_depth_mm;
            let goal_y = config.field.goal_width_mm / 2.0 + reach;
            let mut seen = 0;
            for step in 0..=400 {
                let t = f64::from(step) / 200.0 - 1.0;
                for (x, y) in [
                    (t * x, y),
                    (t * x, -y),
                    (x, t * y),
                    (-x, t * y),
                    (goal_x, t * goal_y),
                    (-goal_x, t * goal_y),
                    (t * x, t * y),
                ] {
                    for share in [0.0, 0.3, 0.6, 1.0] {
                        let height_mm = share * config.tallest_robot_mm();
                        let pixel = model.image_from_field(FieldPoint::new(x, y), height_mm);
                        let in_picture = pixel.x_px >= 0.0
                            && pixel.y_px >= 0.0
                            && pixel.x_px < f64::from(width) - 0.5
                            && pixel.y_px < f64::from(height) - 0.5;
                        if in_picture {
                            seen += 1;
                            assert!(is_in(&mask, pixel), "({x}, {y}) at {height_mm}: {pixel:?}");
                        }
                    }
                }
            }
            assert!(seen > 1000);
        }
    }

    #[test]
    fn pixels_far_outside_are_masked() {
        let config = high_camera();
        let mask = FieldMask::new(&config);
        let share = mask.pixels() as f64 / (640.0 * 480.0);
        assert!((0.2..0.45).contains(&share), "{share}");
        for (x, y) in [(0.0, 0.0), (639.0, 0.0), (0.0, 479.0), (639.0, 479.0), (150.0, 200.0)] {
            assert!(!is_in(&mask, ImagePoint::new(x, y)));
        }
        // Beside the goal, but not behind it.
        let model = CameraModel::new(&config.geometry, 640, 480).unwrap();
        let shows = |mask: &FieldMask, x, y| {
            is_in(mask, model.image_from_field(FieldPoint::new(x, y), 0.0))
        };
        assert!(shows(&mask, 1250.0, 0.0) && !shows(&mask, 1300.0, 600.0));

        let mut with_bench = config.clone();
        with_bench.field.also_look_at_mm =
            vec![vec![[1300.0, 500.0], [1500.0, 500.0], [1400.0, 800.0]]];
        let with_bench = FieldMask::new(&with_bench);
        assert!(shows(&with_bench, 1400.0, 600.0) && !shows(&mask, 1400.0, 600.0));
        assert!(with_bench.pixels() > mask.pixels());

        let mut unmasked = config;
        unmasked.field.mask = false;
        assert_eq!(FieldMask::new(&unmasked), FieldMask::everything(640, 480));
    }

    #[test]
    fn without_a_usable_geometry_nothing_is_masked() {
        let mut config = Config::default();
        config.geometry.points.truncate(2);
        assert_eq!(FieldMask::new(&config), FieldMask::everything(640, 480));
        let mut elsewhere = Config::default();
        for pair in &mut elsewhere.geometry.points {
            pair.image_px[0] += 5000.0;
        }
        elsewhere.geometry.distortion.k1 = 0.0;
        assert_eq!(FieldMask::new(&elsewhere), FieldMask::everything(640, 480));
    }

    #[test]
    fn spans_are_apart_and_in_order_for_any_shape() {
        // A star, in pictures whose sizes are no multiples of a tile.
        for (width, height) in [(2, 2), (3, 200), (641, 479), (1001, 333)] {
            let is_inside = |point: ImagePoint| {
                let (x, y) =
                    (point.x_px / f64::from(width) - 0.5, point.y_px / f64::from(height) - 0.5);
                (8.0 * y.atan2(x)).cos() * 0.5 > x.hypot(y)
            };
            let Some(mask) = FieldMask::of_tiles(width, height, is_inside) else {
                assert!(width < 10);
                continue;
            };
            for row in 0..height as usize {
                let spans = mask.spans(row);
                assert!(
                    spans.iter().all(|span| span.begin < span.end && span.end <= width as usize)
                );
                assert!(spans.windows(2).all(|pair| pair[0].end < pair[1].begin), "{spans:?}");
            }
        }
    }

    #[test]
    fn span_bits_match_columns() {
        for (begin, end) in [(0, 1), (3, 70), (64, 65), (10, 11), (63, 130)] {
            for (start, count) in [(0, 16), (1, 64), (60, 32), (100, 64)] {
                let bits = Span { begin, end }.bits(start, count);
                for lane in 0..64 {
                    let column = start + lane;
                    let expected = lane < count && begin <= column && column < end;
                    assert_eq!(bits >> lane & 1 == 1, expected);
                }
            }
        }
    }
}
