//! The stage's core: one frame in, one list of runs out.

use crate::haze::Haze;
use crate::kernels::{Kernel, SimdChoice, SimdLevel};
use crate::lattice::Lattice;
use crate::mask::FieldMask;
use crate::picture::Picture;
use crate::shading::ShadedTables;
use crate::white_balance::{self, Gains, NO_GAINS, WhiteBalance};
use crate::zones::{ZonedTables, Zones};
use crate::{ClassTables, ClassifierError};
use config::Config;
use messages::{FrameFault, FrameHeader, LightCorrection, PixelLayout, Run, RunsHeader};

/// Turns frames into runs. Frames are independent of each other, so no state is handed over.
#[derive(Debug, Clone)]
pub struct Classifier {
    width: u32,
    height: u32,
    tables: ClassTables,
    lattice: Lattice,
    white_balance: Option<WhiteBalance>,
    /// The light of the last frame, and the tables for it: a cache, not state.
    gains: Gains,
    lit_tables: ClassTables,
    /// For reports: how the last frame was corrected.
    is_pitch_seen: bool,
    is_under_glare: bool,
    changes: u64,
    shaded: Option<Box<ShadedTables>>,
    one_zone: Zones,
    haze: Option<Box<Haze>>,
    mask: FieldMask,
    kernel: Kernel,
}

impl Classifier {
    /// Uses the configured picture size and colours, and the instructions of
    /// [`SimdChoice::of_process`].
    pub fn new(config: &Config) -> Result<Self, ClassifierError> {
        Self::with_level(config, SimdChoice::of_process().level)
    }

    /// With the instructions of a given level, for tests and benchmarks. All levels give the same runs. A
    /// level that this machine does not have is replaced by [`SimdLevel::Scalar`].
    pub fn with_level(config: &Config, level: SimdLevel) -> Result<Self, ClassifierError> {
        let (width, height) = (config.camera.width, config.camera.height);
        if width < 2 || height < 2 {
            return Err(ClassifierError::ImageTooSmall { width, height });
        }
        if width.max(height) > u32::from(u16::MAX) {
            return Err(ClassifierError::ImageTooLarge { width, height });
        }
        let tables = ClassTables::new(&config.colors)?;
        let white_balance = WhiteBalance::new(config)?;
        let (gains, lit_tables) = (NO_GAINS, tables.clone());
        let haze = config.light.glare.then(|| Haze::new(config, &tables)).transpose()?;
        let haze = haze.map(Box::new);
        let shaded = ShadedTables::new(config, &tables)?.map(Box::new);
        let one_zone = Zones::one();
        let mask = FieldMask::new(config);
        let kernel = Kernel::new(level, &tables);
        Ok(Self {
            width,
            height,
            tables,
            lattice: Lattice::new(&config.camera),
            white_balance,
            gains,
            lit_tables,
            is_pitch_seen: true,
            is_under_glare: false,
            changes: 0,
            shaded,
            one_zone,
            haze,
            mask,
            kernel,
        })
    }

    /// Checks whether a frame with this header and number of bytes can be classified.
    pub fn check(&self, header: &FrameHeader, bytes: usize) -> Result<PixelLayout, FrameFault> {
        header.check(self.width, self.height, bytes)
    }

    /// Classifies a frame. On success `out` begins with [`RunsHeader::run_count`] runs, and `out_header` is
    /// complete except for [`RunsHeader::t_frame_taken_ns`] and [`RunsHeader::t_sent_ns`], which are 0 until
    /// the runs are sent. A frame that fails [`check`](Self::check) leaves both untouched.
    pub fn step(
        &mut self,
        header: &FrameHeader,
        pixels: &[u8],
        out_header: &mut RunsHeader,
        out: &mut [Run],
    ) -> Result<(), FrameFault> {
        let layout = self.check(header, pixels.len())?;
        let picture = Picture::new(pixels, header.width, header.height, header.stride, layout)
            .expect("the header agrees with a size that Classifier::new has accepted");
        if self.white_balance.is_some() || self.haze.is_some() {
            self.lattice.sample(&picture);
        }
        self.update_white_balance();
        let Self {
            kernel, tables, lattice, gains, lit_tables, mask, shaded, one_zone, haze, ..
        } = self;
        let hazy = haze.as_deref_mut().and_then(|haze| haze.find(lattice).then_some(haze));
        self.is_under_glare = hazy.is_some();
        if let Some(haze) = &hazy {
            haze.clear(lattice);
        }
        if let Some(shaded) = shaded {
            shaded.measure(lattice);
        }
        let middle = lit_tables.version();
        let (zoned, class_table_version) = match (hazy, shaded.as_deref_mut()) {
            (Some(haze), shaded) => haze.tables_for(tables, *gains, middle, shaded.as_deref()),
            (None, Some(shaded)) => {
                let version = shaded.version(middle);
                (shaded.tables_for(tables, *gains), version)
            }
            (None, None) => (ZonedTables::everywhere(tables, lit_tables, one_zone), middle),
        };
        let written = kernel.classify(&picture, zoned, mask, out);
        *out_header = RunsHeader {
            frame: *header,
            t_frame_taken_ns: 0,
            t_sent_ns: 0,
            class_table_version,
            run_count: written.count,
            flags: if written.is_cut_off { RunsHeader::OVERFLOW } else { 0 },
            revision: 0,
            classes_since: 0,
        };
        Ok(())
    }

    /// Updates the tables for the light of the picture that the lattice has sampled.
    fn update_white_balance(&mut self) {
        let Some(white_balance) = &self.white_balance else { return };
        let gains = white_balance.gains(&self.lattice);
        self.is_pitch_seen = gains.is_some();
        let gains = gains.unwrap_or(NO_GAINS);
        if gains != self.gains {
            self.gains = gains;
            self.changes += 1;
            self.lit_tables = self.tables.corrected(gains);
        }
    }

    /// Report on the correction of the last frame's light.
    pub fn light(&self) -> LightCorrection {
        let spread = match &self.shaded {
            Some(shaded) => shaded.gain_range(),
            None => [0; 2],
        };
        let flags = [
            (self.white_balance.is_some(), LightCorrection::FOLLOWED),
            (white_balance::is_at_bound(self.gains), LightCorrection::AT_BOUND),
            (!self.is_pitch_seen, LightCorrection::PITCH_UNSEEN),
            (self.is_under_glare, LightCorrection::GLARE),
        ];
        LightCorrection {
            gains: self.gains.map(white_balance::factor),
            flags: flags.into_iter().filter(|(is_set, _)| *is_set).map(|(_, flag)| flag).sum(),
            zones: spread.map(white_balance::factor),
            changes: self.changes,
        }
    }

    /// The instruction set in use.
    pub fn level(&self) -> SimdLevel {
        self.kernel.level()
    }

    /// The pixels that are classified.
    pub fn mask(&self) -> &FieldMask {
        &self.mask
    }

    /// The colours in use, before any correction.
    pub fn tables(&self) -> &ClassTables {
        &self.tables
    }
}
