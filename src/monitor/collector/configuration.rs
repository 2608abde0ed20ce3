//! The configuration that the monitor counts and scores with: always the group's newest.

use super::Collector;
use crate::top_scale::TopScale;
use config::Config;
use std::sync::Arc;
use std::time::Duration;

impl Collector {
    /// Goes over to the group's newest configuration. What was counted so far stays, but the size of tops is
    /// measured anew if geometry, colours or layout have changed.
    pub(super) fn use_newest_config(&mut self) {
        let Some((revision, config)) = self.view.other_config(self.config.0) else { return };
        let before = std::mem::replace(&mut self.config, (revision, Arc::clone(&config))).1;
        self.base.camera.fps = config.camera.fps;
        self.base.found.robots_configured = config.robots.identities.len() as u32;
        self.commanders.use_config(&config);
        self.unknown_scorer.use_config(&config);
        let tops_of = |config: &Config| {
            let Config { geometry, colors, teams, robots, .. } = config;
            (geometry.clone(), colors.clone(), teams.clone(), robots.clone())
        };
        if tops_of(&before) != tops_of(&config) {
            self.tops = TopScale::new(&config).ok();
        }
    }

    /// Time between two rounds of reading, in which a part of the buffer of `frames` fills.
    pub fn poll_period(&self) -> Duration {
        super::super::poll_period(self.kept_frames, self.base.camera.fps)
    }
}
