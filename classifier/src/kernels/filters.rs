//! Choice of the prefilter for each block of pixels.

use super::Prefilters;
use crate::zones::Zones;

/// The prefilters of the blocks of a row. A block in several zones has one that passes every pixel that a
/// prefilter of one of its zones passes.
#[derive(Debug, Clone, Default)]
pub struct BlockFilters {
    /// Indexed by block; empty if all are in one zone.
    merged: Vec<Prefilters>,
    zone: usize,
    /// Valid for rows `< end_row`.
    end_row: usize,
}

/// One prefilter for all blocks of a row, or one for each.
#[derive(Clone, Copy)]
pub struct RowFilters<'a> {
    filters: &'a [Prefilters],
    step: usize,
    zone: Option<usize>,
}

impl BlockFilters {
    /// Begins a picture.
    pub fn begin(&mut self) {
        self.end_row = 0;
    }

    /// The prefilters of a row of `blocks` blocks with `block` pixels each. Rows must be requested from top
    /// to bottom.
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
        // Allocates at the first picture, even if that is in one zone.
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
    /// The prefilter of a block.
    #[inline(always)]
    pub fn of_block(&self, index: usize) -> &Prefilters {
        &self.filters[index * self.step]
    }

    /// The zone of the whole row, if there is only one.
    #[inline(always)]
    pub fn only_zone(&self) -> Option<usize> {
        self.zone
    }
}
