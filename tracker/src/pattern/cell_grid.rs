//! A square grid of cells around the centre of a robot's top: the index of tables by place.

/// A grid of `columns` × `columns` cells. Copy it before a loop over places: the compiler then keeps it in
/// registers and makes vector instructions of the loop.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CellGrid {
    cells_per_mm: f32,
    /// Index of the cell at the origin, with a fraction.
    origin: f32,
    /// Index of the last row and column.
    last: f32,
    columns: u32,
}

impl CellGrid {
    /// A grid whose cell `origin` (with a fraction) is at the origin in both directions.
    pub fn new(columns: usize, cells_per_mm: f32, origin: f32) -> Self {
        Self { cells_per_mm, origin, last: (columns - 1) as f32, columns: columns as u32 }
    }

    /// Index of the cell in which a point lies; of the nearest one for a point outside.
    #[inline(always)]
    pub fn cell_at(&self, x_mm: f32, y_mm: f32) -> u32 {
        // Adding 2²³ rounds to the nearest whole number and leaves it in the lowest bits: a conversion that
        // vector instructions have, other than the language's saturating one.
        const WHOLE_BITS: f32 = (1 << 23) as f32;
        // `max` turns NaN into 0.
        let index = |at_mm: f32| {
            let place = (at_mm * self.cells_per_mm + self.origin).max(0.0).min(self.last);
            (place + WHOLE_BITS).to_bits() & ((1 << 23) - 1)
        };
        index(y_mm) * self.columns + index(x_mm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_in_the_nearest_cell() {
        let grid = CellGrid::new(5, 0.5, 2.0);
        for (point, cell) in [
            ([0.0, 0.0], 12),
            ([1.9, -1.9], 8),
            ([-4.0, 4.0], 20),
            ([1e9, f32::INFINITY], 24),
            ([f32::NAN, f32::NEG_INFINITY], 0),
        ] {
            assert_eq!(grid.cell_at(point[0], point[1]), cell, "{point:?}");
        }
    }
}
