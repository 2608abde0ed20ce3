//! Zones: parts of a picture that are classified with tables of their own.

use crate::ClassTables;
use crate::mask::Span;

/// Assignment of square tiles of a picture to zones.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Zones {
    /// Side of a tile, pixels; even, so that both rows of a pair are in one tile.
    tile_px: usize,
    /// Tiles in a row.
    columns: usize,
    zone_by_tile: Vec<u8>,
}

/// Zones and the tables of each: all of the same colours, each corrected for its zone's light.
#[derive(Debug, Clone, Copy)]
pub struct ZonedTables<'a> {
    /// Tables for the light in which the colours were set.
    pub colors: &'a ClassTables,
    /// Indexed by zone, for all zones that occur. Made by [`ClassTables::corrected`] or
    /// [`ClassTables::corrected_with_haze`] of `colors`.
    pub tables: &'a [ClassTables],
    /// Assigns tiles to `tables`.
    pub zones: &'a Zones,
}

impl<'a> ZonedTables<'a> {
    /// The same light everywhere; `zones` are [`Zones::one`].
    pub fn everywhere(colors: &'a ClassTables, tables: &'a ClassTables, zones: &'a Zones) -> Self {
        Self { colors, tables: std::slice::from_ref(tables), zones }
    }
}

impl Zones {
    /// Everything is in zone 0.
    pub fn one() -> Self {
        Self { tile_px: 1 << 16, columns: 1, zone_by_tile: vec![0] }
    }

    /// Tiles of a picture of this size, all in zone 0.
    ///
    /// # Panics
    /// If `tile_px` is odd or 0.
    pub fn tiled(width: usize, height: usize, tile_px: usize) -> Self {
        assert!(tile_px > 0 && tile_px.is_multiple_of(2), "tiles of {tile_px} px");
        let (columns, rows) = (width.div_ceil(tile_px), height.div_ceil(tile_px));
        Self { tile_px, columns, zone_by_tile: vec![0; columns * rows] }
    }

    /// The side of a tile in pixels.
    pub fn tile_px(&self) -> usize {
        self.tile_px
    }

    /// Number of tiles in a row.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The zone of each tile, row by row.
    pub fn by_tile(&self) -> &[u8] {
        &self.zone_by_tile
    }

    /// The zone of each tile, mutable.
    pub fn by_tile_mut(&mut self) -> &mut [u8] {
        &mut self.zone_by_tile
    }

    /// The zone of a pixel.
    ///
    /// # Panics
    /// If it lies outside the picture.
    pub fn at(&self, column: usize, row: usize) -> usize {
        let tile = row / self.tile_px * self.columns + column / self.tile_px;
        usize::from(self.zone_by_tile[tile])
    }

    /// The zones of the tiles along a row, from left to right.
    #[inline]
    pub fn tiles_of_row(&self, row: usize) -> &[u8] {
        let line = row / self.tile_px * self.columns;
        &self.zone_by_tile[line..line + self.columns]
    }

    /// The parts of a span in one zone each, from left to right; neighbours differ in zone.
    #[inline]
    pub fn divide(&self, row: usize, span: Span) -> impl Iterator<Item = (Span, usize)> {
        let line = self.tiles_of_row(row);
        let mut begin = span.begin;
        std::iter::from_fn(move || {
            if begin >= span.end {
                return None;
            }
            let mut tile = begin / self.tile_px;
            let zone = line[tile];
            let mut end = (tile + 1) * self.tile_px;
            while end < span.end && line[tile + 1] == zone {
                tile += 1;
                end += self.tile_px;
            }
            let part = Span { begin, end: end.min(span.end) };
            begin = part.end;
            Some((part, usize::from(zone)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_span_is_divided_by_zone(
            (width, height) in (1usize..300, 1usize..40),
            tile in 1usize..40,
            zones in proptest::collection::vec(0u8..3, 300),
            ends in (0usize..300, 0usize..300),
        ) {
            let mut all = Zones::tiled(width, height, 2 * tile);
            for (tile, zone) in all.by_tile_mut().iter_mut().zip(zones.iter().cycle()) {
                *tile = *zone;
            }
            let (begin, end) = (ends.0.min(ends.1).min(width), ends.0.max(ends.1).min(width));
            for row in 0..height {
                let mut reached = begin;
                let mut last = None;
                for (part, zone) in all.divide(row, Span { begin, end }) {
                    prop_assert!(part.begin == reached && part.begin < part.end);
                    prop_assert!(last != Some(zone));
                    prop_assert!((part.begin..part.end).all(|column| all.at(column, row) == zone));
                    (reached, last) = (part.end, Some(zone));
                }
                prop_assert_eq!(reached, end);
            }
        }
    }
}
