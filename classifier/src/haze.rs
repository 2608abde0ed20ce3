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
use crate::lamp::rgb_at;
use crate::mask::{FieldMask, Span};
use crate::picture::Picture;
use crate::tables::version_by_parts;
use crate::zones::{ZonedTables, Zones};
use crate::{ClassTables, ClassifierError};
use common::config::Config;
use common::geometry::{CameraModel, ImagePoint};
use common::messages::{MAX_RUNS, Run};

/// Grey levels from one level of haze to the next.
const STEP: u8 = 8;
/// Levels beside none; what is brighter leaves no colour.
const LEVELS: usize = 18;
/// About so many places are looked at.
const SITES: f64 = 3000.0;
/// Places in a row and column of a block that is looked at first.
const BLOCK: usize = 4;
/// Places around one, to each side, that count with it.
const AROUND: usize = 2;
/// So much brighter than the pitch, as a share of it and in grey levels, a place may be without haze.
const UNEVEN_PART: u16 = 4;
const UNEVEN: u16 = 12;
/// Beside a hazy block so little more is haze already.
const FAINT: u16 = 6;
/// In the place of a value: not on the field.
const OUTSIDE: u16 = u16::MAX;

/// Finds haze, and classifies what lies under it.
#[derive(Debug, Clone)]
pub(crate) struct Haze {
    /// Distance of the places, in pixels; even, as Bayer patterns are.
    step: usize,
    columns: usize,
    rows: usize,
    on_field: Vec<bool>,
    /// Darkest channel of each place.
    values: Vec<u16>,
    /// Level of haze of each place.
    levels: Vec<u8>,
    /// For each level, the pixels under it.
    masks: [FieldMask; LEVELS + 1],
    /// For each level above 0, the tables; those of another version than they were made of are old.
    tables: [ClassTables; LEVELS],
    made_of: Option<u64>,
    one_zone: Zones,
    found: Vec<Run>,
}

impl Haze {
    /// For the configured camera; `tables` are any.
    pub fn new(config: &Config, tables: &ClassTables) -> Result<Self, ClassifierError> {
        let (width, height) = (config.camera.width, config.camera.height);
        let camera = CameraModel::new(&config.geometry, width, height)?;
        let step = (f64::from(width) * f64::from(height) / SITES).sqrt() / 2.0;
        let step = (step.round() as usize).max(1) * 2;
        let (columns, rows) =
            ((width as usize - 1).div_ceil(step), (height as usize - 1).div_ceil(step));
        let half = [config.field.length_mm, config.field.width_mm].map(|size| size / 2.0);
        let on_field = (0..columns * rows).map(|place| {
            let (x, y) = (place % columns * step, place / columns * step);
            let floor = camera.field_from_image(ImagePoint::new(x as f64, y as f64), 0.0);
            floor.x_mm.abs() < half[0] && floor.y_mm.abs() < half[1]
        });
        let mask = || FieldMask::with_room(height as usize, columns * height as usize / 2 + 1);
        Ok(Self {
            step,
            columns,
            rows,
            on_field: on_field.collect(),
            values: vec![OUTSIDE; columns * rows],
            levels: vec![0; columns * rows],
            masks: std::array::from_fn(|_| mask()),
            tables: std::array::from_fn(|_| tables.clone()),
            made_of: None,
            one_zone: Zones::one(),
            found: Vec::with_capacity(MAX_RUNS),
        })
    }

    /// Looks for haze; whether there is any.
    pub fn look_at(&mut self, picture: &Picture) -> bool {
        let places = self.values.iter_mut().zip(&self.on_field).enumerate();
        let mut counts = [0u32; 256];
        for (place, (value, _)) in places.filter(|(_, (_, on_field))| **on_field) {
            let (x, y) = (place % self.columns * self.step, place / self.columns * self.step);
            let darkest = rgb_at(picture, x, y).into_iter().min().unwrap_or(0);
            *value = u16::from(darkest);
            counts[usize::from(darkest)] += 1;
        }
        let Some(pitch) = median(&counts) else { return false };
        let bright = pitch + pitch / UNEVEN_PART + UNEVEN;
        self.levels.fill(0);
        let mut is_hazy = false;
        for top in (0..self.rows).step_by(BLOCK) {
            for left in (0..self.columns).step_by(BLOCK) {
                if self.floor_in(left..left + BLOCK, top..top + BLOCK) > bright {
                    is_hazy |= self.set_levels(left, top, pitch);
                }
            }
        }
        is_hazy
    }

    /// Sets the levels in and around a block; whether there is one above 0.
    fn set_levels(&mut self, left: usize, top: usize, pitch: u16) -> bool {
        let mut is_hazy = false;
        for row in top.saturating_sub(BLOCK)..(top + 2 * BLOCK).min(self.rows) {
            for column in left.saturating_sub(BLOCK)..(left + 2 * BLOCK).min(self.columns) {
                let around = |index: usize| index.saturating_sub(AROUND)..index + AROUND + 1;
                let floor = self.floor_in(around(column), around(row));
                if floor > pitch + FAINT {
                    let step = u16::from(STEP);
                    let level = ((floor - pitch + step / 2) / step).min(LEVELS as u16);
                    self.levels[row * self.columns + column] = level as u8;
                    is_hazy |= level > 0;
                }
            }
        }
        is_hazy
    }

    /// What the floor shows in a window, robots or not: a little less than the median of the darkest
    /// channels of the places on the field; 0 if there are few.
    fn floor_in(&self, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> u16 {
        const MOST: usize = (2 * AROUND + 1) * (2 * AROUND + 1);
        const FEWEST: usize = 6;
        let mut window = [OUTSIDE; MOST];
        let mut count = 0;
        for row in rows.start..rows.end.min(self.rows) {
            let line = &self.values[row * self.columns..(row + 1) * self.columns];
            for &value in &line[columns.start..columns.end.min(self.columns)] {
                if value != OUTSIDE && count < MOST {
                    window[count] = value;
                    count += 1;
                }
            }
        }
        if count < FEWEST {
            return 0;
        }
        *window[..count].select_nth_unstable(2 * count / 5).1
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
        if self.made_of != Some(tables.version()) {
            for (level, hazed) in (1..).zip(&mut self.tables) {
                *hazed = tables.without_haze(level * STEP);
            }
            self.made_of = Some(tables.version());
        }
        self.divide(mask, picture.height());
        self.found.clear();
        self.found.resize(MAX_RUNS, Run { row: 0, begin: 0, end: 0, class: 0, reserved: 0 });
        let (mut count, mut is_cut_off) = (0, false);
        for (level, mask) in self.masks.iter().enumerate() {
            if mask.pixels() == 0 {
                continue;
            }
            let tables = if level == 0 { tables } else { &self.tables[level - 1] };
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
        let Self { step, columns, rows, levels, masks, .. } = self;
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

/// The value that half of them reach; `None` if there are none.
fn median(counts: &[u32; 256]) -> Option<u16> {
    let total: u32 = counts.iter().sum();
    let mut before = 0;
    let reaches = |&(_, &count): &(u16, &u32)| {
        before += count;
        2 * before >= total
    };
    (total > 0).then(|| (0..).zip(counts).find(reaches).map_or(0, |(value, _)| value))
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
