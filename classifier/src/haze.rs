//! Glare: a lamp mirrored in the floor or on robots' tops adds white light to a part of the picture, and
//! colours fade to grey there.
//!
//! The added light is estimated by the dark channel prior (He, Sun and Tang, *Single image haze removal using
//! dark channel prior*, 2009): without glare, the darkest channel `min(R, G, B)` of the floor, of robots'
//! bodies and of every patch is nearly black. The darkest channel is sampled on a lattice of places. Its 40 %
//! quantile over the 5 × 5 places around each one measures the floor or a body there. Its excess over the
//! median of the whole pitch is subtracted from all channels, in steps of [`STEP`] grey levels. Each level of
//! haze is a [zone](crate::zones) with a [correction](crate::Correction) of its own, which includes the gains
//! of the [white balance](crate::white_balance).
//!
//! All of it is computed in integers. Blocks of places are tested first, at little cost, and only blocks that
//! are too bright are worked on.

use crate::lattice::{Grid, Lattice};
use crate::ranks::Ranks;
use crate::shading::{self, ShadedTables};
use crate::tables::version_by_parts;
use crate::white_balance::Gains;
use crate::zones::{ZonedTables, Zones};
use crate::{ClassTables, ClassifierError};
use config::Config;
use geometry::{CameraModel, ImagePoint};
use std::ops::Range;

/// Grey levels per level of haze.
const STEP: u8 = 8;
/// Number of haze levels above 0; brighter haze leaves no colour.
const LEVELS: usize = 18;
/// Under haze, only every second zone of uneven light is distinguished.
const HAZY_ZONES: usize = shading::ZONES.div_ceil(2);
/// Zones without haze, then the zones under each haze level.
const ZONES: usize = shading::ZONES + LEVELS * HAZY_ZONES;
/// Side of a block that is tested first, places.
const BLOCK: usize = 4;
/// Half-width of the window around a place, places.
const WINDOW_RADIUS: usize = 2;
/// Tolerated excess over the pitch without haze: pitch / `TOLERANCE_DIVISOR` + `TOLERANCE` grey levels.
const TOLERANCE_DIVISOR: u16 = 4;
const TOLERANCE: u16 = 12;
/// Minimum places on the field for a measurement of the floor.
const MIN_PLACES: usize = 6;
/// Excess that counts as haze beside a hazy block, grey levels.
const MIN_EXCESS: u16 = 6;

/// Finds haze, and makes tables for the parts of the picture under it.
#[derive(Debug, Clone)]
pub(crate) struct Haze {
    grid: Grid,
    on_field: Vec<bool>,
    /// Places on the field: in all, and in each block.
    count: usize,
    counts: Vec<u8>,
    /// Darkest channel of each place; 255 outside the field.
    values: Vec<u8>,
    /// Reused allocation for their median.
    ranks: Ranks,
    /// Haze level of each place.
    levels: Vec<u8>,
    zones: Zones,
    /// Tables of each zone, and the gains that they were made for.
    tables: Vec<ClassTables>,
    made_for: Vec<Option<Gains>>,
}

impl Haze {
    /// For the configured camera; `tables` only fill the memory until the first frame.
    pub fn new(config: &Config, tables: &ClassTables) -> Result<Self, ClassifierError> {
        let (width, height) = (config.camera.width, config.camera.height);
        let camera = CameraModel::new(&config.geometry, width, height)?;
        let grid = Grid::new(&config.camera);
        let Grid { columns, rows, .. } = grid;
        let half = [config.field.length_mm, config.field.width_mm].map(|size| size / 2.0);
        let on_field = grid.places().map(|[x, y]| {
            let floor = camera.field_from_image(ImagePoint::new(x as f64, y as f64), 0.0);
            floor.x_mm.abs() < half[0] && floor.y_mm.abs() < half[1]
        });
        let on_field: Vec<bool> = on_field.collect();
        let mut counts = vec![0; columns.div_ceil(BLOCK) * rows.div_ceil(BLOCK)];
        for place in (0..columns * rows).filter(|&place| on_field[place]) {
            let (column, row) = (place % columns / BLOCK, place / columns / BLOCK);
            counts[row * columns.div_ceil(BLOCK) + column] += 1;
        }
        Ok(Self {
            grid,
            count: on_field.iter().filter(|&&on_field| on_field).count(),
            on_field,
            counts,
            values: vec![u8::MAX; columns * rows],
            ranks: Ranks::with_room(columns * rows),
            levels: vec![0; columns * rows],
            zones: Zones::tiled(width as usize, height as usize, grid.step),
            tables: vec![tables.clone(); ZONES],
            made_for: vec![None; ZONES],
        })
    }

    /// Finds haze in the picture that the lattice has sampled; returns whether there is any.
    pub fn find(&mut self, lattice: &Lattice) -> bool {
        let [reds, greens, blues] = lattice.channels();
        let places = self.values.iter_mut().zip(&self.on_field);
        for (((value, on_field), (red, green)), blue) in
            places.zip(reds.iter().zip(greens)).zip(blues)
        {
            *value = if *on_field { *red.min(green).min(blue) } else { u8::MAX };
        }
        let Some(last) = self.count.checked_sub(1) else { return false };
        self.ranks.fill(self.values.iter().copied());
        let pitch = u16::from(self.ranks.nth(last / 2));
        let bright = pitch + pitch / TOLERANCE_DIVISOR + TOLERANCE;
        // Nothing is brighter than white.
        let Ok(bright) = u8::try_from(bright) else { return false };
        self.levels.fill(0);
        let mut is_hazy = false;
        for top in (0..self.grid.rows).step_by(BLOCK) {
            for left in (0..self.grid.columns).step_by(BLOCK) {
                if self.is_above(bright, left, top) {
                    is_hazy |= self.set_levels(left, top, pitch);
                }
            }
        }
        is_hazy
    }

    /// Whether [`floor_in`](Self::floor_in) of a block is above `bright`; false if it has too few places.
    fn is_above(&self, bright: u8, left: usize, top: usize) -> bool {
        let Grid { columns, rows, .. } = self.grid;
        let count = usize::from(self.counts[top / BLOCK * columns.div_ceil(BLOCK) + left / BLOCK]);
        let dim = (top..(top + BLOCK).min(rows)).map(|row| {
            let line = &self.values[row * columns..(row + 1) * columns];
            let line = &line[left..(left + BLOCK).min(columns)];
            line.iter().filter(|&&value| value <= bright).count()
        });
        count >= MIN_PLACES && dim.sum::<usize>() <= floor_rank(count)
    }

    /// Sets the levels in and around a block; returns whether one is above 0.
    fn set_levels(&mut self, left: usize, top: usize, pitch: u16) -> bool {
        let Grid { columns, rows, .. } = self.grid;
        let mut is_hazy = false;
        for row in top.saturating_sub(BLOCK)..(top + 2 * BLOCK).min(rows) {
            for column in left.saturating_sub(BLOCK)..(left + 2 * BLOCK).min(columns) {
                let around =
                    |index: usize| index.saturating_sub(WINDOW_RADIUS)..index + WINDOW_RADIUS + 1;
                let floor = self.floor_in(around(column), around(row));
                if floor > pitch + MIN_EXCESS {
                    let step = u16::from(STEP);
                    let level = ((floor - pitch + step / 2) / step).min(LEVELS as u16);
                    self.levels[row * columns + column] = level as u8;
                    is_hazy |= level > 0;
                }
            }
        }
        is_hazy
    }

    /// Brightness of the floor in a window, even between robots: the 40 % quantile of the darkest channels of
    /// its places on the field; 0 if they are few.
    fn floor_in(&self, columns: Range<usize>, rows: Range<usize>) -> u16 {
        const MAX_WINDOW: usize = (2 * WINDOW_RADIUS + 1) * (2 * WINDOW_RADIUS + 1);
        let mut window = [0; MAX_WINDOW];
        let mut count = 0;
        for row in rows.start..rows.end.min(self.grid.rows) {
            let line = row * self.grid.columns;
            for place in line + columns.start..line + columns.end.min(self.grid.columns) {
                if self.on_field[place] && count < MAX_WINDOW {
                    window[count] = self.values[place];
                    count += 1;
                }
            }
        }
        if count < MIN_PLACES {
            return 0;
        }
        u16::from(*window[..count].select_nth_unstable(floor_rank(count)).1)
    }

    /// Subtracts the haze found last from the lattice's colours.
    pub fn clear(&self, lattice: &mut Lattice) {
        for channel in lattice.channels_mut() {
            for (value, level) in channel.iter_mut().zip(&self.levels) {
                *value = value.saturating_sub(level * STEP);
            }
        }
    }

    /// The tables for the haze found last and for `shaded` light, and their version. `gains` and `middle` are
    /// the gains of the middle of the pitch and the version of the tables under them. `tables` must be the
    /// same at each call, since tables made of them are kept.
    pub fn tables_for<'a>(
        &'a mut self,
        tables: &'a ClassTables,
        gains: Gains,
        middle: u64,
        shaded: Option<&ShadedTables>,
    ) -> (ZonedTables<'a>, u64) {
        let Grid { step, columns, rows } = self.grid;
        let tiles = self.zones.columns();
        for (index, tile) in self.zones.by_tile_mut().iter_mut().enumerate() {
            let [column, row] = [index % tiles, index / tiles];
            // A tile lies between four places.
            let level = |column: usize, row: usize| {
                let place = row.min(rows - 1) * columns + column.min(columns - 1);
                usize::from(self.levels[place])
            };
            let upper = level(column, row) + level(column + 1, row);
            let lower = level(column, row + 1) + level(column + 1, row + 1);
            let level = (upper + lower + 2) / 4;
            let light = shaded
                .map_or(shading::MIDDLE, |shaded| shaded.zones().at(column * step, row * step));
            let (zone, light) = match level.checked_sub(1) {
                None => (light, light),
                Some(index) => (shading::ZONES + index * HAZY_ZONES + light / 2, light / 2 * 2),
            };
            *tile = zone as u8;
            if self.made_for[zone] != Some(gains) {
                let gains = shading::zone_gains(gains, light);
                self.tables[zone] = tables.corrected_with_haze(gains, level as u8 * STEP);
                self.made_for[zone] = Some(gains);
            }
        }
        let version = version_by_parts(middle, b"haze", self.zones.by_tile());
        (ZonedTables { colors: tables, tables: &self.tables, zones: &self.zones }, version)
    }
}

const _: () = assert!(ZONES <= u8::MAX as usize + 1 && shading::MIDDLE.is_multiple_of(2));

/// Rank, among `count` darkest channels of a window, of the one that stands for the floor: the 40 % quantile.
fn floor_rank(count: usize) -> usize {
    2 * count / 5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Classifier;
    use crate::Picture;
    use config::LightConfig;
    use messages::{MAX_RUNS, Run, RunsHeader};

    const FLOOR: [u8; 3] = [34, 38, 32];
    const PATCHES: [[u8; 3]; 3] = [[180, 164, 32], [36, 152, 168], [28, 56, 172]];

    fn config(glare: bool) -> Config {
        let pitch_rgb = Some(FLOOR.map(f64::from));
        let light = LightConfig { pitch_rgb, brightness: 1.0, glare, ..LightConfig::default() };
        Config { light, ..Config::default() }
    }

    /// Squares in the palette's colours on the floor, and white light over a disc.
    fn frame(config: &Config, most: f64) -> Vec<u8> {
        let (width, height) = (config.camera.width as usize, config.camera.height as usize);
        let order = config.camera.bayer_order;
        (0..width * height)
            .map(|index| {
                let (x, y) = (index % width, index / width);
                let color = if x % 60 < 8 && y % 60 < 8 {
                    PATCHES[(x / 60 + y / 60) % PATCHES.len()]
                } else {
                    FLOOR
                };
                let apart = (x as f64 - 300.0).hypot(y as f64 - 240.0) / 80.0;
                let haze = most * (-apart * apart / 2.0).exp();
                (f64::from(color[order.channel_at(x, y)]) + haze).min(255.0) as u8
            })
            .collect()
    }

    fn runs(config: &Config, pixels: &[u8]) -> Vec<Run> {
        let camera = &config.camera;
        let header = camera.frame_header();
        let mut out_header = RunsHeader::default();
        let mut out = vec![Run { row: 0, begin: 0, end: 0, class: 0, reserved: 0 }; MAX_RUNS];
        let mut classifier = Classifier::new(config).unwrap();
        classifier.step(&header, pixels, &mut out_header, &mut out).unwrap();
        assert_eq!(out_header.flags, 0);
        out_header.valid(&out).to_vec()
    }

    /// Pixels of each class in the middle of the picture.
    fn counts(runs: &[Run]) -> [u32; 8] {
        let mut counts = [0; 8];
        for run in runs.iter().filter(|run| (150..330).contains(&run.row)) {
            if (210..390).contains(&run.begin) {
                counts[usize::from(run.class)] += u32::from(run.end - run.begin);
            }
        }
        counts
    }

    #[test]
    fn colours_under_haze_are_classified() {
        let clear = counts(&runs(&config(true), &frame(&config(true), 0.0)));
        let hazy = frame(&config(true), 70.0);
        let (seen, missed) =
            (counts(&runs(&config(true), &hazy)), counts(&runs(&config(false), &hazy)));
        let total: u32 = clear.iter().sum();
        assert!(total > 200, "{clear:?}");
        let off = |counts: [u32; 8]| -> u32 {
            counts.iter().zip(clear).map(|(&count, clear)| count.abs_diff(clear)).sum()
        };
        assert!(off(missed) > total / 3, "{clear:?} {missed:?}");
        assert!(off(seen) < total / 8, "{clear:?} {seen:?}");
    }

    /// Lamps light the left side half as much as the right, and white light lies over the middle.
    #[test]
    fn haze_and_uneven_light_are_corrected_together() {
        let with = |glare: bool, unevenness: f64| {
            let mut config = config(glare);
            config.light.unevenness = unevenness;
            config
        };
        let width = with(true, 1.0).camera.width as usize;
        let lit = |most: f64| -> Vec<u8> {
            let clear = frame(&config(true), 0.0);
            let hazy = frame(&config(true), most);
            let pixels = clear.into_iter().zip(hazy).enumerate();
            pixels
                .map(|(index, (clear, hazy))| {
                    let light = 0.65 + 0.7 * (index % width) as f64 / width as f64;
                    (f64::from(clear) * light + f64::from(hazy - clear)).min(255.0) as u8
                })
                .collect()
        };
        let counted = |config: &Config, pixels: &[u8]| {
            let mut counts = [0; 8];
            for run in runs(config, pixels) {
                counts[usize::from(run.class)] += run.pixels();
            }
            counts
        };
        let clear = counted(&config(false), &frame(&config(false), 0.0));
        let off = |glare: bool, unevenness: f64| -> u32 {
            let found = counted(&with(glare, unevenness), &lit(70.0));
            found.iter().zip(clear).map(|(&count, clear)| count.abs_diff(clear)).sum()
        };
        let total: u32 = clear.iter().sum();
        let (both, glare_only, light_only) = (off(true, 1.0), off(true, 0.0), off(false, 1.0));
        assert!(10 * both < total, "{both} of {total}");
        assert!(2 * both < glare_only && 4 * both < 3 * light_only, "{glare_only} {light_only}");
    }

    #[test]
    fn a_cut_off_list_is_the_beginning_of_the_whole() {
        let pixels = frame(&config(true), 60.0);
        let whole = runs(&config(true), &pixels);
        let header = config(true).camera.frame_header();
        for room in [0, 1, whole.len() / 2, whole.len() - 1] {
            let mut out_header = RunsHeader::default();
            let mut out = vec![Run::default(); room];
            let mut classifier = Classifier::new(&config(true)).unwrap();
            classifier.step(&header, &pixels, &mut out_header, &mut out).unwrap();
            assert_eq!(out_header.flags, RunsHeader::OVERFLOW);
            assert_eq!(out_header.valid(&out), &whole[..room]);
        }
    }

    #[test]
    fn the_block_test_agrees_with_the_floor_quantile() {
        let config = config(true);
        let tables = ClassTables::new(&config.colors).unwrap();
        let mut haze = Haze::new(&config, &tables).unwrap();
        let mut lattice = Lattice::new(&config.camera);
        let (width, height) = (config.camera.width, config.camera.height);
        let order = config.camera.bayer_order;
        for most in [0.0, 40.0, 300.0] {
            let mut pixels = frame(&config, most);
            for (index, pixel) in (0u32..).zip(&mut pixels) {
                *pixel = pixel.saturating_add((index.wrapping_mul(2_654_435_761) >> 27) as u8);
            }
            let image = crate::BayerImage::new(&pixels, width, height, width, order).unwrap();
            lattice.sample(&Picture::Bayer(image));
            haze.find(&lattice);
            let mut found = [0; 2];
            for bright in (20..=255).step_by(5) {
                for top in (0..haze.grid.rows).step_by(BLOCK) {
                    for left in (0..haze.grid.columns).step_by(BLOCK) {
                        let floor = haze.floor_in(left..left + BLOCK, top..top + BLOCK);
                        let is_above = haze.is_above(bright, left, top);
                        assert_eq!(is_above, floor > bright.into(), "{floor} {bright}");
                        found[usize::from(is_above)] += 1;
                    }
                }
            }
            assert!(found.iter().all(|&count| count > 300), "{found:?}");
        }
    }

    #[test]
    fn without_haze_nothing_changes() {
        let clear = frame(&config(true), 0.0);
        assert_eq!(runs(&config(true), &clear), runs(&config(false), &clear));
    }

    #[test]
    fn runs_under_haze_are_in_order_and_apart() {
        let found = runs(&config(true), &frame(&config(true), 60.0));
        for pair in found.windows(2) {
            let [a, b] = pair else { continue };
            assert!((a.row, a.begin) < (b.row, b.begin), "{a:?} {b:?}");
            let touch = a.row == b.row && a.end >= b.begin;
            assert!(!touch || (a.end == b.begin && a.class != b.class), "{a:?} {b:?}");
        }
    }

    #[test]
    fn pictures_without_a_pitch_are_survived() {
        for value in [0, 30, 128, 255] {
            let pixels = vec![value; config(true).camera.frame_bytes()];
            runs(&config(true), &pixels);
        }
    }
}
