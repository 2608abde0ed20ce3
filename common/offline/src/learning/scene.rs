//! Data common to all pictures of a camera: the pixels on the pitch, and maps of the robots' tops. Evaluating
//! geometry and layout for each pixel takes long, so it is done once.

use config::{Config, PatchConfig};
use geometry::layout::{Outlines, reach_mm};
use geometry::{CameraModel, FieldPoint, GeometryError, ImagePoint};

/// Camera, pitch and robots as configured.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The camera.
    pub camera: CameraModel,
    /// For each pixel, row by row, whether a robot's top can be there.
    pub is_on_pitch: Vec<bool>,
    /// Robots' tops: layout and map.
    tops: Vec<(Vec<PatchConfig>, TopMap)>,
}

/// Pixels projected to the field at once.
const PIXELS_AT_ONCE: usize = 8;

impl Scene {
    /// Fails if the geometry is unusable.
    pub fn new(config: &Config) -> Result<Self, GeometryError> {
        let (width, height) = (config.camera.width, config.camera.height);
        let camera = CameraModel::new(&config.geometry, width, height)?;
        let mut is_on_pitch = Vec::with_capacity((width * height) as usize);
        for row in 0..height {
            for first in (0..width).step_by(PIXELS_AT_ONCE) {
                let points: [ImagePoint; PIXELS_AT_ONCE] = std::array::from_fn(|index| {
                    ImagePoint::new(f64::from(first) + index as f64, row.into())
                });
                let places = camera.fields_from_image(points, config.robots.height_mm);
                let count = PIXELS_AT_ONCE.min((width - first) as usize);
                is_on_pitch.extend(places[..count].iter().map(|&place| is_in_play(config, place)));
            }
        }
        let robots = &config.robots;
        let mut tops = vec![(robots.patches.clone(), TopMap::new(&robots.patches))];
        for patches in robots.identities.iter().filter_map(|identity| identity.patches.as_ref()) {
            if !tops.iter().any(|(known, _)| known == patches) {
                tops.push((patches.clone(), TopMap::new(patches)));
            }
        }
        Ok(Self { camera, is_on_pitch, tops })
    }

    /// The map of a configured robot's top with these patches.
    ///
    /// # Panics
    /// If no configured robot has them.
    pub fn top_map(&self, patches: &[PatchConfig]) -> &TopMap {
        let top = self.tops.iter().find(|(known, _)| known == patches);
        &top.expect("the patches are those of a configured robot").1
    }
}

/// Whether a place is in play: on the field, in its margin, or in the goals.
fn is_in_play(config: &Config, place: FieldPoint) -> bool {
    let field = &config.field;
    let (x, y) = (place.x_mm.abs(), place.y_mm.abs());
    let (length, width) = (field.length_mm / 2.0 + field.margin_mm, field.width_mm / 2.0);
    (x <= length && y <= width + field.margin_mm)
        || (x <= length + field.goal_depth_mm && y <= field.goal_width_mm / 2.0 + field.margin_mm)
}

/// Map of a robot's top: the patch at each point.
#[derive(Debug, Clone)]
pub struct TopMap {
    cells: Vec<u8>,
    side: usize,
    reach_mm: f64,
}

const CELL_MM: f64 = 0.5;
const NO_PATCH: u8 = u8::MAX;

impl TopMap {
    /// For a layout.
    pub fn new(patches: &[PatchConfig]) -> Self {
        let reach_mm = reach_mm(patches);
        let side = (2.0 * reach_mm / CELL_MM).ceil() as usize;
        let place = |cell: usize| (cell as f64 + 0.5) * CELL_MM - reach_mm;
        let outlines = Outlines::new(patches);
        let cells = (0..side * side).map(|cell| {
            let patch = outlines.topmost([place(cell % side), place(cell / side)]);
            patch.map_or(NO_PATCH, |patch| patch as u8)
        });
        Self { cells: cells.collect(), side, reach_mm }
    }

    /// The patch at a point (x forward, y left), to half a cell.
    pub fn patch_at(&self, point: [f64; 2]) -> Option<usize> {
        let [column, row] = point.map(|value| ((value + self.reach_mm) / CELL_MM).floor());
        let is_inside = |cell: f64| cell >= 0.0 && cell < self.side as f64;
        if !is_inside(column) || !is_inside(row) {
            return None;
        }
        let patch = self.cells[row as usize * self.side + column as usize];
        (patch != NO_PATCH).then_some(usize::from(patch))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Preset;
    use geometry::layout::topmost_patch;

    #[test]
    fn the_map_agrees_with_the_layout() {
        for preset in Preset::ALL {
            let robots = preset.config().robots;
            let map = TopMap::new(&robots.patches);
            let mut wrong = 0;
            for row in -120..120 {
                for column in -120..120 {
                    let point = [f64::from(column) * 0.97, f64::from(row) * 0.97];
                    wrong += u32::from(map.patch_at(point) != topmost_patch(&robots, point));
                }
            }
            // Edges run through cells.
            assert!(wrong < 600, "{}: {wrong} of {}", preset.name(), 240 * 240);
        }
    }
}
