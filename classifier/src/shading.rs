//! Uneven light: a pitch is bright under its lamps and dark in its corners, and so are the patches that lie
//! there.
//!
//! Shading is estimated in each frame by fitting a surface of second degree to the logarithm of the floor's
//! brightness, as retrospective shading correction does in microscopy. The picture is divided into some fifty
//! cells; the median of the green channel over a cell's places on the pitch measures its floor, since robots,
//! lines and arms cover less than half of a cell. With `t = (1, u, v, u², uv, v²)` at a cell's mean place,
//! `w` its number of places and `m` the logarithm of its median, weighted least squares give the coefficients
//! `c = (Σ w t tᵀ)⁻¹ Σ w t m`. The inverse depends on the geometry alone and is computed once. Relative to
//! its median over the pitch, `c · t` says by how many octaves the floor is too bright at a place. Patches
//! are too bright by a part of that (`light.unevenness`: 1 on a dull floor, little on a black one that
//! mirrors lamps). Square tiles of the picture are put into [zones](crate::zones) by the gain that undoes it,
//! in steps of an eighth of an octave (9 %), and each zone has tables of its own.
//!
//! Only integers and floating-point sums, products and quotients in a fixed order are used, so the same frame
//! gives the same zones on every machine.

use crate::ClassTables;
use crate::correction::Correction;
use crate::lattice::{Grid, Lattice};
use crate::ranks::Ranks;
use crate::tables::version_by_parts;
use crate::white_balance::{Gains, LOG, PitchProbe, UNITS_PER_OCTAVE};
use crate::zones::{ZonedTables, Zones};
use config::{Config, LightConfig};
use geometry::GeometryError;
use nalgebra::{SMatrix, SVector};

/// Gain steps (1/16 octave) between neighbouring zones.
const ZONE_STEPS: i32 = 2;
/// Zones darker than the middle of the pitch, and as many brighter ones.
const ZONES_EACH: i32 = 10;
pub(crate) const ZONES: usize = 2 * ZONES_EACH as usize + 1;
/// The zone without correction.
pub(crate) const MIDDLE: usize = ZONES_EACH as usize;
/// [`LOG`] units (1/64 octave) per zone.
const UNITS_PER_ZONE: f64 = (UNITS_PER_OCTAVE * ZONE_STEPS / 16) as f64;
/// Cells, and tiles, along the longer side of a picture, about.
const CELLS: usize = 8;
const TILES: usize = 20;
/// Minimum places on the pitch for a cell to be used.
const MIN_SITES: usize = 8;
/// Coefficients of a surface of second degree.
const TERMS: usize = 6;
/// Limit of the estimated deviation from the middle of the pitch, octaves.
const MAX_OCTAVES: f64 = 6.0;

type Terms = SVector<f64, TERMS>;
type Matrix = SMatrix<f64, TERMS, TERMS>;

/// Brightness of the pitch relative to its middle, for each part of a picture.
#[derive(Debug, Clone)]
pub struct Shading {
    /// Indices of the lattice's places on the pitch, sorted by cell.
    sites: Vec<usize>,
    /// For each cell: the end of its places in `sites`, and the vector that its median is multiplied with.
    /// The sum of these products is the surface.
    cells: Vec<(usize, Terms)>,
    /// The surface's terms at each tile's centre.
    tiles: Vec<Terms>,
    /// Whether a tile has a place on the pitch.
    is_on_pitch: Vec<bool>,
    /// Latest measurement: brightness of each tile relative to the middle of the pitch, [`LOG`] units.
    units: Vec<f64>,
    /// Reused allocation for sorting `units`.
    sorted: Vec<f64>,
    values: Ranks,
    tile_px: usize,
    columns: usize,
}

impl Shading {
    /// For the configured camera and field; `None` if too little of the pitch is seen.
    pub fn new(config: &Config) -> Result<Option<Self>, GeometryError> {
        let (width, height) = (config.camera.width as usize, config.camera.height as usize);
        let cell_px = width.max(height).div_ceil(CELLS);
        let at: Vec<[usize; 2]> = Grid::new(&config.camera).places().collect();
        let cell_of = |&site: &usize| at[site].map(|place| place / cell_px);
        let mut sites: Vec<usize> = PitchProbe::new(config)?.places().collect();
        sites.sort_by_key(|site| {
            let [column, row] = cell_of(site);
            (row, column)
        });
        let mut by_cell: Vec<&[usize]> = sites.chunk_by(|a, b| cell_of(a) == cell_of(b)).collect();
        by_cell.retain(|sites| sites.len() >= MIN_SITES);

        let half = width.max(height) as f64 / 2.0;
        let terms = |x: f64, y: f64| {
            let (u, v) = ((x - width as f64 / 2.0) / half, (y - height as f64 / 2.0) / half);
            Terms::from([1.0, u, v, u * u, u * v, v * v])
        };
        // For each cell, its weight (number of places) and the terms at their mean.
        let rows: Vec<(f64, Terms)> = by_cell
            .iter()
            .map(|sites| {
                let count = sites.len() as f64;
                let mean = |axis: usize| {
                    sites.iter().map(|&site| at[site][axis] as f64).sum::<f64>() / count
                };
                (count, terms(mean(0), mean(1)))
            })
            .collect();
        let Some(inverse) = inverse_of_normal(&rows) else { return Ok(None) };
        let mut end = 0;
        let cells = rows.iter().zip(&by_cell).map(|((weight, row), sites)| {
            end += sites.len();
            (end, *weight * inverse * row)
        });
        let cells: Vec<(usize, Terms)> = cells.collect();

        let tile_px = width.max(height).div_ceil(TILES).next_multiple_of(2).max(16);
        let zones = Zones::tiled(width, height, tile_px);
        let columns = zones.columns();
        let tiles: Vec<Terms> = (0..zones.by_tile().len())
            .map(|tile| {
                [tile % columns, tile / columns].map(|at| (at as f64 + 0.5) * tile_px as f64)
            })
            .map(|[x, y]| terms(x, y))
            .collect();
        let mut is_on_pitch = vec![false; tiles.len()];
        for [x, y] in by_cell.iter().copied().flatten().map(|&site| at[site]) {
            is_on_pitch[y / tile_px * columns + x / tile_px] = true;
        }
        let most = by_cell.iter().map(|sites| sites.len()).max().unwrap_or(0);
        Ok(Some(Self {
            sites: by_cell.concat(),
            cells,
            units: vec![0.0; tiles.len()],
            sorted: Vec::with_capacity(tiles.len()),
            values: Ranks::with_room(most),
            tiles,
            is_on_pitch,
            tile_px,
            columns,
        }))
    }

    /// Measures the pitch in the picture that the lattice has sampled.
    pub fn measure(&mut self, lattice: &Lattice) {
        let [_, greens, _] = lattice.channels();
        let mut surface = Terms::zeros();
        let mut begin = 0;
        for (end, says) in &self.cells {
            let sites = &self.sites[begin..*end];
            self.values.fill(sites.iter().map(|&site| greens[site]));
            // The median of logarithms is the logarithm of the median.
            let median = LOG[usize::from(self.values.nth(sites.len() / 2))];
            surface += says * f64::from(median);
            begin = *end;
        }
        for (units, terms) in self.units.iter_mut().zip(&self.tiles) {
            *units = terms.dot(&surface);
        }
        self.sorted.clear();
        let on_pitch = self.units.iter().zip(&self.is_on_pitch);
        self.sorted
            .extend(on_pitch.filter(|(_, is_on_pitch)| **is_on_pitch).map(|(units, _)| units));
        if self.sorted.is_empty() {
            self.units.fill(0.0);
            return;
        }
        let middle = self.sorted.len() / 2;
        let middle = *self.sorted.select_nth_unstable_by(middle, f64::total_cmp).1;
        let most = MAX_OCTAVES * f64::from(UNITS_PER_OCTAVE);
        self.units.iter_mut().for_each(|units| *units = (*units - middle).clamp(-most, most));
    }

    /// Brightness of the floor at a pixel relative to the middle of the pitch, octaves, in the latest
    /// measurement.
    pub fn octaves_at(&self, column: usize, row: usize) -> f64 {
        let tile = row / self.tile_px * self.columns + column / self.tile_px;
        self.units[tile] / f64::from(UNITS_PER_OCTAVE)
    }
}

/// Tables for the zones of an unevenly lit picture.
#[derive(Debug, Clone)]
pub struct ShadedTables {
    shading: Shading,
    unevenness: f64,
    zones: Zones,
    /// Tables of each zone, and the gains of the middle of the pitch that they were made for.
    tables: Vec<ClassTables>,
    made_for: [Option<Gains>; ZONES],
}

impl ShadedTables {
    /// For the configured light; `None` if light is taken to be even, or too little of the pitch is seen.
    /// `tables` only fill the memory until the first frame.
    pub fn new(config: &Config, tables: &ClassTables) -> Result<Option<Self>, GeometryError> {
        let LightConfig { follow: true, pitch_rgb: Some(_), unevenness, .. } = config.light else {
            return Ok(None);
        };
        if unevenness <= 0.0 {
            return Ok(None);
        }
        let Some(shading) = Shading::new(config)? else { return Ok(None) };
        let (width, height) = (config.camera.width as usize, config.camera.height as usize);
        let mut zones = Zones::tiled(width, height, shading.tile_px);
        zones.by_tile_mut().fill(MIDDLE as u8);
        Ok(Some(Self {
            zones,
            shading,
            unevenness,
            tables: vec![tables.clone(); ZONES],
            made_for: [None; ZONES],
        }))
    }

    /// Measures the pitch in the picture that the lattice has sampled, and assigns its tiles to zones.
    pub fn measure(&mut self, lattice: &Lattice) {
        self.shading.measure(lattice);
        for (zone, units) in self.zones.by_tile_mut().iter_mut().zip(&self.shading.units) {
            let zones = (-self.unevenness * units / UNITS_PER_ZONE).round() as i32;
            *zone = (zones.clamp(-ZONES_EACH, ZONES_EACH) + ZONES_EACH) as u8;
        }
    }

    /// Lowest and highest gain of a zone on the pitch in the latest measurement, relative to the middle of
    /// the pitch, in gain steps.
    pub fn gain_range(&self) -> [i32; 2] {
        let on_pitch = self.zones.by_tile().iter().zip(&self.shading.is_on_pitch);
        let on_pitch = on_pitch.filter(|(_, is_on_pitch)| **is_on_pitch);
        let zones = on_pitch.map(|(&zone, _)| usize::from(zone));
        [zones.clone().min(), zones.max()].map(|zone| zone_steps(zone.unwrap_or(MIDDLE)))
    }

    /// The zones of the latest measurement.
    pub fn zones(&self) -> &Zones {
        &self.zones
    }

    /// Identifies the classification of the latest measurement, where `tables` is the version of the tables
    /// for the middle of the pitch: equal zones give equal versions, and `tables` itself if all tiles are
    /// middle.
    pub fn version(&self, tables: u64) -> u64 {
        let zones = self.zones.by_tile();
        match zones.iter().all(|&zone| usize::from(zone) == MIDDLE) {
            true => tables,
            false => version_by_parts(tables, b"zones", zones),
        }
    }

    /// For each zone, a table per channel from measured to corrected value, given the gains of the middle of
    /// the pitch.
    pub fn corrections(gains: Gains) -> Vec<[[u8; 256]; 3]> {
        (0..ZONES).map(|zone| Correction::new(zone_gains(gains, zone), 0).tables()).collect()
    }

    /// The tables for the latest measurement, given the gains of the middle of the pitch. `tables` must be
    /// the same at each call, since tables made of them are kept.
    pub fn tables_for<'a>(&'a mut self, tables: &'a ClassTables, gains: Gains) -> ZonedTables<'a> {
        for &zone in self.zones.by_tile() {
            let zone = usize::from(zone);
            if self.made_for[zone] != Some(gains) {
                self.tables[zone] = tables.corrected(zone_gains(gains, zone));
                self.made_for[zone] = Some(gains);
            }
        }
        ZonedTables { colors: tables, tables: &self.tables, zones: &self.zones }
    }
}

/// Gain of a zone relative to the middle of the pitch, in gain steps.
fn zone_steps(zone: usize) -> i32 {
    (zone as i32 - MIDDLE as i32) * ZONE_STEPS
}

pub(crate) fn zone_gains(gains: Gains, zone: usize) -> Gains {
    gains.map(|steps| steps + zone_steps(zone))
}

/// `(Σ w t tᵀ)⁻¹` over the rows `(w, t)`; `None` if they do not determine a surface.
fn inverse_of_normal(rows: &[(f64, Terms)]) -> Option<Matrix> {
    let square = |(weight, row): &(f64, Terms)| *weight * row * row.transpose();
    let normal: Matrix = rows.iter().map(square).sum();
    let factors = normal.cholesky()?;
    // The squares on its diagonal are what each term still determines once those before it are known.
    let total: f64 = rows.iter().map(|(weight, _)| weight).sum();
    let is_determined = factors.l_dirty().diagonal().iter().all(|l| l * l > 1e-6 * total);
    is_determined.then(|| factors.inverse())
}
