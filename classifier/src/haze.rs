//! Glare: a lamp that is mirrored in the floor or on the tops lays white light over a part of the
//! picture, and colours fade to grey there.
//!
//! What lies over a place is seen by its floor, whose darkest channel is nearly black elsewhere (the
//! dark channel of He, Sun and Tang, *Single image haze removal using dark channel prior*, 2009; robots'
//! bodies are as dark, and so is some channel of every patch). So the darkest channel is looked at on
//! a lattice of places, a quantile over those around each place is what the floor or a body shows there,
//! and what it is brighter than the pitch as a whole is taken off, in steps of [`STEP`]. As with the
//! lamps ([`lamp`](crate::lamp)) that happens to the tables and not to the pixels: the parts of the picture
//! under each level of haze are classified with tables of their own.
//!
//! All of it is in integers. Where nothing is hazy, which is found out first and cheaply, nothing more
//! is done.

use crate::kernels::{Kernel, Written};
use crate::lattice::{Grid, Lattice};
use crate::mask::{FieldMask, Span};
use crate::picture::Picture;
use crate::ranks::Ranks;
use crate::tables::version_by_parts;
use crate::zones::{ZonedTables, Zones};
use crate::{ClassTables, ClassifierError};
use common::config::Config;
use common::geometry::{CameraModel, ImagePoint};
use common::messages::{MAX_RUNS, Run};
use std::ops::Range;

/// Grey levels from one level of haze to the next.
const STEP: u8 = 8;
/// Levels beside none; what is brighter leaves no colour.
const LEVELS: usize = 18;
/// Places in a row and column of a block that is looked at first.
const BLOCK: usize = 4;
/// Places around one, to each side, that count with it.
const AROUND: usize = 2;
/// So much brighter than the pitch, as a share of it and in grey levels, a place may be without haze.
const UNEVEN_PART: u16 = 4;
const UNEVEN: u16 = 12;
/// With fewer places on the field it is not known what the floor shows.
const FEWEST: usize = 6;
/// Beside a hazy block so little more is haze already.
const FAINT: u16 = 6;

/// Finds haze, and classifies what lies under it.
#[derive(Debug, Clone)]
pub(crate) struct Haze {
    grid: Grid,
    on_field: Vec<bool>,
    /// How many places are on the field, all in all and in each block.
    count: usize,
    counts: Vec<u8>,
    /// Darkest channel of each place; of those that are not on the field, 255.
    values: Vec<u8>,
    /// Room for finding their median.
    ranks: Ranks,
    /// Level of haze of each place.
    levels: Vec<u8>,
    /// For each level, the pixels under it.
    masks: [FieldMask; LEVELS + 1],
    /// For each level above 0, the tables, and the version of what they were made of.
    tables: [(ClassTables, Option<u64>); LEVELS],
    one_zone: Zones,
    found: Vec<Run>,
}

impl Haze {
    /// For the configured camera; `tables` are any.
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
        let mask = || FieldMask::with_room(height as usize, columns * height as usize / 2 + 1);
        Ok(Self {
            grid,
            count: on_field.iter().filter(|&&on_field| on_field).count(),
            on_field,
            counts,
            values: vec![u8::MAX; columns * rows],
            ranks: Ranks::with_room(columns * rows),
            levels: vec![0; columns * rows],
            masks: std::array::from_fn(|_| mask()),
            tables: std::array::from_fn(|_| (tables.clone(), None)),
            one_zone: Zones::one(),
            found: Vec::with_capacity(MAX_RUNS),
        })
    }

    /// Looks for haze in the picture that was looked at; whether there is any.
    pub fn look_at(&mut self, lattice: &Lattice) -> bool {
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
        let bright = pitch + pitch / UNEVEN_PART + UNEVEN;
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

    /// Whether [`floor_in`](Self::floor_in) of a block is brighter than that: too few places are not.
    fn is_above(&self, bright: u8, left: usize, top: usize) -> bool {
        let Grid { columns, rows, .. } = self.grid;
        let count = usize::from(self.counts[top / BLOCK * columns.div_ceil(BLOCK) + left / BLOCK]);
        let dim = (top..(top + BLOCK).min(rows)).map(|row| {
            let line = &self.values[row * columns..(row + 1) * columns];
            let line = &line[left..(left + BLOCK).min(columns)];
            line.iter().filter(|&&value| value <= bright).count()
        });
        count >= FEWEST && dim.sum::<usize>() <= floor_rank(count)
    }

    /// Sets the levels in and around a block; whether there is one above 0.
    fn set_levels(&mut self, left: usize, top: usize, pitch: u16) -> bool {
        let Grid { columns, rows, .. } = self.grid;
        let mut is_hazy = false;
        for row in top.saturating_sub(BLOCK)..(top + 2 * BLOCK).min(rows) {
            for column in left.saturating_sub(BLOCK)..(left + 2 * BLOCK).min(columns) {
                let around = |index: usize| index.saturating_sub(AROUND)..index + AROUND + 1;
                let floor = self.floor_in(around(column), around(row));
                if floor > pitch + FAINT {
                    let step = u16::from(STEP);
                    let level = ((floor - pitch + step / 2) / step).min(LEVELS as u16);
                    self.levels[row * columns + column] = level as u8;
                    is_hazy |= level > 0;
                }
            }
        }
        is_hazy
    }

    /// What the floor shows in a window, robots or not: a little less than the median of the darkest
    /// channels of the places on the field; 0 if there are few.
    fn floor_in(&self, columns: Range<usize>, rows: Range<usize>) -> u16 {
        const MOST: usize = (2 * AROUND + 1) * (2 * AROUND + 1);
        let mut window = [0; MOST];
        let mut count = 0;
        for row in rows.start..rows.end.min(self.grid.rows) {
            let line = row * self.grid.columns;
            for place in line + columns.start..line + columns.end.min(self.grid.columns) {
                if self.on_field[place] && count < MOST {
                    window[count] = self.values[place];
                    count += 1;
                }
            }
        }
        if count < FEWEST {
            return 0;
        }
        u16::from(*window[..count].select_nth_unstable(floor_rank(count)).1)
    }

    /// Identifies what the picture looked at last is classified with, where `tables` is the version of those
    /// for no haze.
    pub fn version(&self, tables: u64) -> u64 {
        version_by_parts(tables, b"haze", &self.levels)
    }

    /// Classifies the picture that was looked at last, each part with the tables for its haze.
    pub fn classify(
        &mut self,
        kernel: &mut Kernel,
        picture: &Picture,
        tables: &ClassTables,
        mask: &FieldMask,
        out: &mut [Run],
    ) -> Written {
        self.divide(mask, picture.height());
        self.found.clear();
        self.found.resize(MAX_RUNS, Run { row: 0, begin: 0, end: 0, class: 0, reserved: 0 });
        let (mut count, mut is_cut_off) = (0, false);
        for (level, mask) in self.masks.iter().enumerate() {
            if mask.pixels() == 0 {
                continue;
            }
            let tables = match level.checked_sub(1) {
                None => tables,
                Some(index) => {
                    let (hazed, made_of) = &mut self.tables[index];
                    if *made_of != Some(tables.version()) {
                        *hazed = tables.without_haze(level as u8 * STEP);
                        *made_of = Some(tables.version());
                    }
                    hazed
                }
            };
            let zoned = ZonedTables::everywhere(tables, &self.one_zone);
            let written = kernel.classify(picture, zoned, mask, &mut self.found[count..]);
            count += written.count as usize;
            is_cut_off |= written.is_cut_off;
        }
        let found = &mut self.found[..count];
        found.sort_unstable_by_key(|run| (run.row, run.begin));
        join(found, is_cut_off, out)
    }

    /// Divides a mask among the levels.
    fn divide(&mut self, mask: &FieldMask, height: usize) {
        let Self { grid: Grid { step, columns, rows }, levels, masks, .. } = self;
        masks.iter_mut().for_each(FieldMask::clear);
        for row in 0..height {
            // The place in the middle of a cell stands for it.
            let line = ((row + *step / 2) / *step).min(*rows - 1) * *columns;
            for &Span { begin, end } in mask.spans(row) {
                let mut from = begin;
                while from < end {
                    let cell = ((from + *step / 2) / *step).min(*columns - 1);
                    let next = (cell + 1) * *step - *step / 2;
                    let to = if cell + 1 == *columns { end } else { next.min(end) };
                    masks[usize::from(levels[line + cell])]
                        .extend_row(Span { begin: from, end: to });
                    from = to;
                }
            }
            masks.iter_mut().for_each(FieldMask::end_row);
        }
    }
}

/// Runs in order, those joined that touch and have the same class.
fn join(found: &[Run], mut is_cut_off: bool, out: &mut [Run]) -> Written {
    let mut count = 0usize;
    for run in found {
        if let Some(last) = count.checked_sub(1).and_then(|last| out.get_mut(last))
            && (last.row, last.end, last.class) == (run.row, run.begin, run.class)
        {
            last.end = run.end;
        } else if let Some(slot) = out.get_mut(count) {
            *slot = *run;
            count += 1;
        } else {
            is_cut_off = true;
            break;
        }
    }
    Written { count: count as u32, is_cut_off }
}

/// Of so many places in a window, sorted by their darkest channel, the number of the one that stands for the
/// floor.
fn floor_rank(count: usize) -> usize {
    2 * count / 5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Classifier;
    use common::config::LightConfig;
    use common::messages::RunsHeader;

    const FLOOR: [u8; 3] = [34, 38, 32];
    const PATCHES: [[u8; 3]; 3] = [[180, 164, 32], [36, 152, 168], [28, 56, 172]];

    fn config(glare: bool) -> Config {
        let pitch_rgb = Some(FLOOR.map(f64::from));
        let light = LightConfig { pitch_rgb, brightness: 1.0, glare, ..LightConfig::default() };
        Config { light, ..Config::default() }
    }

    /// Squares of the palette's colours on the floor, and white light over a disc.
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
    fn colours_are_seen_through_haze() {
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

    #[test]
    fn blocks_are_above_what_their_floor_is_above() {
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
            lattice.look_at(&Picture::Bayer(image));
            haze.look_at(&lattice);
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
    fn what_is_no_pitch_is_survived() {
        for value in [0, 30, 128, 255] {
            let pixels = vec![value; config(true).camera.frame_bytes()];
            runs(&config(true), &pixels);
        }
    }
}
