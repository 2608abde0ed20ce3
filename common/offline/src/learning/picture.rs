//! Demosaiced pictures, as the classifier sees them.

use geometry::ImagePoint;

/// A demosaiced picture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: usize,
    /// Pixels row by row, without padding.
    pub rgb: Vec<[u8; 3]>,
}

impl Picture {
    /// From rows of three bytes per pixel.
    ///
    /// # Panics
    ///
    /// If `width` is 0 or does not divide the number of pixels.
    pub fn new(width: usize, bytes: &[u8]) -> Self {
        assert!(width > 0 && bytes.len().is_multiple_of(3 * width), "not a picture");
        Self { width, rgb: bytes.chunks_exact(3).map(|rgb| [rgb[0], rgb[1], rgb[2]]).collect() }
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.rgb.len() / self.width
    }

    /// Position of a pixel.
    pub fn point(&self, index: usize) -> ImagePoint {
        ImagePoint::new((index % self.width) as f64, (index / self.width) as f64)
    }

    /// Index and position of all pixels within a distance of a point.
    pub fn around(
        &self,
        center: ImagePoint,
        reach_px: f64,
    ) -> impl Iterator<Item = (usize, ImagePoint)> {
        let span = |middle: f64, size: usize| {
            let clip = |value: f64| value.clamp(0.0, size as f64) as usize;
            clip((middle - reach_px).ceil())..clip((middle + reach_px).floor() + 1.0)
        };
        let columns = span(center.x_px, self.width);
        let width = self.width;
        span(center.y_px, self.height()).flat_map(move |row| {
            columns.clone().filter_map(move |column| {
                let point = ImagePoint::new(column as f64, row as f64);
                let (dx, dy) = (point.x_px - center.x_px, point.y_px - center.y_px);
                (dx * dx + dy * dy <= reach_px * reach_px).then_some((row * width + column, point))
            })
        })
    }

    /// The picture with each channel of each pixel replaced by its entry in a table; `tables_at` gives the
    /// tables for a column and row.
    pub fn corrected<'a>(&self, tables_at: impl Fn(usize, usize) -> &'a [[u8; 256]; 3]) -> Self {
        let correct = |(index, rgb): (usize, &[u8; 3])| {
            let tables = tables_at(index % self.width, index / self.width);
            [0, 1, 2].map(|channel: usize| tables[channel][usize::from(rgb[channel])])
        };
        Self { width: self.width, rgb: self.rgb.iter().enumerate().map(correct).collect() }
    }
}
