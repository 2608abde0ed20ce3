//! The stage's core: one frame in, one list of runs out.

use crate::kernels::{BayerImage, scalar};
use crate::{ClassTables, ClassifierError};
use common::config::Config;
use common::messages::{BayerOrder, FrameFault, FrameHeader, Run, RunsHeader};

/// Turns frames into runs. Frames are independent of each other: there is nothing to remember and
/// nothing to hand over.
#[derive(Debug, Clone)]
pub struct Classifier {
    width: u32,
    height: u32,
    tables: ClassTables,
}

impl Classifier {
    /// Uses the configured picture size and colours.
    pub fn new(config: &Config) -> Result<Self, ClassifierError> {
        let (width, height) = (config.camera.width, config.camera.height);
        if width < 2 || height < 2 {
            return Err(ClassifierError::ImageTooSmall { width, height });
        }
        if width.max(height) > u32::from(u16::MAX) {
            return Err(ClassifierError::ImageTooLarge { width, height });
        }
        Ok(Self { width, height, tables: ClassTables::new(&config.colors)? })
    }

    /// Whether a frame with this header and so many bytes can be classified.
    pub fn check(&self, header: &FrameHeader, bytes: usize) -> Result<BayerOrder, FrameFault> {
        header.check(self.width, self.height, bytes)
    }

    /// Classifies a frame. On success `out` begins with [`RunsHeader::run_count`] runs and
    /// `out_header` is complete except for [`RunsHeader::t_sent_ns`], which is 0 until the runs
    /// are handed on. A frame that fails [`check`](Self::check) leaves both untouched.
    pub fn step(
        &mut self,
        header: &FrameHeader,
        pixels: &[u8],
        out_header: &mut RunsHeader,
        out: &mut [Run],
    ) -> Result<(), FrameFault> {
        let order = self.check(header, pixels.len())?;
        let image = BayerImage::new(pixels, header.width, header.height, header.stride, order)
            .expect("the header agrees with a size that Classifier::new has accepted");
        let written = scalar::classify(&image, &self.tables, out);
        *out_header = RunsHeader {
            frame: *header,
            t_sent_ns: 0,
            class_table_version: self.tables.version(),
            run_count: written.count,
            flags: if written.is_cut_off { RunsHeader::OVERFLOW } else { 0 },
        };
        Ok(())
    }

    /// The colours in use.
    pub fn tables(&self) -> &ClassTables {
        &self.tables
    }
}
