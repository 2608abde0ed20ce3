//! Suspects wrong settings when hardly any robot is found, and names the likely one.
//!
//! A wrong order of the Bayer filter exchanges colours, a flipped stream mirrors robots, and a grey
//! photograph passes for a raw picture. Each makes some detections wrong and most vanish, without an
//! error. So the first pictures are processed again under each of these assumptions.

use crate::commands::CommandError;
use config::Config;
use messages::BayerOrder;
use offline::chain::Chain;
use touchline::colorless::{COLORLESS, has_color};

/// Most pictures kept for the second pass.
const MOST_KEPT: usize = 3;

/// The first pictures, and the number of robots identified in them.
#[derive(Debug, Default)]
pub struct Doubts {
    pictures: Vec<Vec<u8>>,
    named: usize,
    are_raw: bool,
}

impl Doubts {
    /// Keeps a picture, if it is one of the first. Raw pictures are kept as the sensor gave them; others
    /// have passed through a synthetic filter of the configured order.
    pub fn keep(&mut self, bayer: &[u8], is_raw: bool, named: usize) {
        if self.pictures.len() < MOST_KEPT {
            self.are_raw |= is_raw;
            self.pictures.push(bayer.to_vec());
            self.named += named;
        }
    }

    /// The suspicion to report about the pictures, if any.
    pub fn say(&self, config: &Config) -> Result<Option<String>, CommandError> {
        if self.pictures.is_empty() {
            return Ok(None);
        }
        let width = config.camera.width as usize;
        if self.named == 0 && !self.pictures.iter().any(|frame| has_color(frame, width, width)) {
            return Ok(Some(COLORLESS.into()));
        }
        let mut best: Option<(usize, String)> = None;
        for (other, advice) in self.others(config) {
            let named = self.named_with(&other)?;
            if best.as_ref().is_none_or(|(most, _)| named > *most) {
                best = Some((named, advice));
            }
        }
        // A difference of one robot may be chance. With exchanged colours, some robots are taken for
        // others.
        let is_clear = |named: usize| named >= self.named + 2 && 2 * named >= 3 * self.named;
        let found = best.filter(|(named, _)| is_clear(*named));
        Ok(found.map(|(named, advice)| {
            let all = config.robots.identities.len() * self.pictures.len();
            format!("{} of {all} robots are found; {advice} {named} of {all} would be", self.named)
        }))
    }

    /// Configurations that differ in one suspected setting, with the advice for each.
    fn others(&self, config: &Config) -> Vec<(Config, String)> {
        let mut others = Vec::new();
        for order in BayerOrder::ALL {
            let configured = config.camera.bayer_order;
            let mut other = config.clone();
            other.camera.bayer_order = order;
            let name = format!("{order:?}").to_lowercase();
            if order != configured && self.are_raw {
                others.push((other, format!("with camera.bayer_order = \"{name}\"")));
            } else if red_is_opposite(order, configured) {
                others.push((other, "with red and blue exchanged in the pictures".into()));
            }
        }
        let mut mirrored = config.clone();
        let right = f64::from(config.camera.width) - 1.0;
        for pair in &mut mirrored.geometry.points {
            pair.image_px[0] = right - pair.image_px[0];
        }
        let center = &mut mirrored.geometry.distortion.center_px[0];
        *center = right - *center;
        others.push((
            mirrored,
            "the pictures look mirrored: calibrated with camera.mirrored = true,".into(),
        ));
        others
    }

    fn named_with(&self, config: &Config) -> Result<usize, CommandError> {
        let mut chain = Chain::new(config)?;
        let mut named = 0;
        for frame in &self.pictures {
            let seen = chain.look_at(frame)?;
            named += seen.robots().iter().filter(|robot| robot.is_identified()).count();
        }
        Ok(named)
    }
}

/// Whether red in one order coincides with blue in the other.
fn red_is_opposite(a: BayerOrder, b: BayerOrder) -> bool {
    let is_green = |order: BayerOrder, column| order.channel_at(column, 0) == 1;
    a != b && (0..2).all(|column| is_green(a, column) == is_green(b, column))
}
