//! With which prefilter to look at a block of pixels.

use super::Prefilters;
use crate::zones::Zones;

/// With which prefilter the blocks of a row are looked at. Where a block is in several zones, with one
/// that lets pass what any of theirs does.
#[derive(Debug, Clone, Default)]
pub struct BlockFilters {
    /// For each block; empty if all are in one zone.
    merged: Vec<Prefilters>,
    zone: usize,
    /// All this holds for the rows before this one.
    end_row: usize,
}

/// One for all blocks of a row, or one for each.
#[derive(Clone, Copy)]
pub struct RowFilters<'a> {
    filters: &'a [Prefilters],
    step: usize,
    zone: Option<usize>,
}

impl BlockFilters {
    /// Begins with a picture.
    pub fn begin(&mut self) {
        self.end_row = 0;
    }

    /// For a row, which is not above the one asked for before, of so many blocks of `block` pixels.
    #[inline(always)]
    pub fn of_row<'a>(
        &'a mut self,
        prefilters: &'a [Prefilters],
        zones: &Zones,
        row: usize,
        blocks: usize,
        block: usize,
    ) -> RowFilters<'a> {
        if row >= self.end_row {
            self.merge(prefilters, zones, row, blocks, block);
        }
        match self.merged[..] {
            [] => {
                let filters = &prefilters[self.zone..self.zone + 1];
                RowFilters { filters, step: 0, zone: Some(self.zone) }
            }
            _ => RowFilters { filters: &self.merged, step: 1, zone: None },
        }
    }

    #[inline(never)]
    fn merge(
        &mut self,
        prefilters: &[Prefilters],
        zones: &Zones,
        row: usize,
        blocks: usize,
        block: usize,
    ) {
        let tile = zones.tile_px();
        let tiles = zones.tiles_of_row(row);
        self.end_row = (row / tile + 1) * tile;
        self.zone = usize::from(tiles[0]);
        self.merged.clear();
        // With the first picture, even if that is in one zone.
        self.merged.reserve(blocks);
        if tiles.iter().all(|&zone| zone == tiles[0]) {
            return;
        }
        self.merged.extend((0..blocks).map(|index| {
            let end = ((index + 1) * block).div_ceil(tile).min(tiles.len());
            let zones = tiles[index * block / tile..end].chunk_by(|a, b| a == b);
            let mut filters = zones.map(|equal| &prefilters[usize::from(equal[0])]);
            let mut merged = *filters.next().unwrap_or(&prefilters[self.zone]);
            filters.for_each(|next| merged.add(next));
            merged
        }));
    }
}

impl RowFilters<'_> {
    /// For a block.
    #[inline(always)]
    pub fn of_block(&self, index: usize) -> &Prefilters {
        &self.filters[index * self.step]
    }

    /// The zone that all of the row is in, if it is in one.
    #[inline(always)]
    pub fn only_zone(&self) -> Option<usize> {
        self.zone
    }
}
