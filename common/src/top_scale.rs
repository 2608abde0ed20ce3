//! How large robots' tops are against the configured layout, measured over many robots.
//!
//! A layout that was entered in another size than the tops have is no error that stops anything: patches
//! may lie off their places by the tolerance, and robots are found, a centimetre or two off. What tells
//! is the scale that brings the layout onto the measured centroids. For one robot it is as uncertain as a
//! centroid is; the median over many robots is not.

use crate::config::{Config, Pair, PatchConfig, Top};
use crate::geometry::{CameraModel, FieldPoint, GeometryError, ImagePoint};
use crate::layout::Layout;
use crate::messages::{DetectedRobot, DetectionFrame};

/// Fewer measurements tell nothing.
const LEAST_MEASUREMENTS: u64 = 3;
/// Scales nearer to 1 are not told of: patches bleed, and heights are not exact.
const WORTH_TELLING: f64 = 0.06;
/// The median is counted in steps of this, from 0 to [`MOST`].
const STEP: f64 = 0.005;
const MOST: f64 = 3.0;
/// A region whose area is so many times that of its patch is more than the patch.
const MERGED_RATIO: f64 = 1.6;

/// Collects measurements.
#[derive(Debug, Clone)]
pub struct TopScale {
    camera: CameraModel,
    /// Team and number of each robot, with its height and the patches of its top.
    robots: Vec<(u32, u32, f64, Vec<Dot>)>,
    /// How many measurements fell into each step.
    counts: Vec<u64>,
    total: u64,
}

/// A patch of a top.
#[derive(Debug, Clone, Copy)]
struct Dot {
    place_mm: Pair,
    area_mm2: f64,
}

/// What the measurements say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// How many times as large as configured.
    pub scale: f64,
    /// Robots measured, each in every frame.
    pub measurements: u64,
}

impl TopScale {
    /// For pictures of the configured camera.
    pub fn new(config: &Config) -> Result<Self, GeometryError> {
        let camera = &config.camera;
        let mut layouts: Vec<(&[PatchConfig], Vec<Dot>)> = Vec::new();
        let mut robots = Vec::new();
        for identity in &config.robots.identities {
            let Top { patches, height_mm } = config.top_of(identity);
            let known = layouts.iter().position(|(known, _)| *known == patches);
            let known = known.unwrap_or_else(|| {
                let dots = Layout::new(patches)
                    .patches
                    .into_iter()
                    .map(|patch| Dot { place_mm: patch.centroid_mm, area_mm2: patch.area_mm2 });
                layouts.push((patches, dots.collect()));
                layouts.len() - 1
            });
            let dots = layouts[known].1.clone();
            robots.push((identity.team as u32, identity.id, height_mm, dots));
        }
        Ok(Self {
            camera: CameraModel::new(&config.geometry, camera.width, camera.height)?,
            robots,
            counts: vec![0; (MOST / STEP) as usize],
            total: 0,
        })
    }

    /// Measures the robots of a frame.
    pub fn add(&mut self, seen: &DetectionFrame) {
        for robot in seen.robots() {
            let Some(scale) = self.scale_of(seen, robot) else { continue };
            if let Some(count) = self.counts.get_mut((scale / STEP) as usize) {
                *count += 1;
                self.total += 1;
            }
        }
    }

    /// The median of all measurements, when there are enough.
    pub fn measured(&self) -> Option<Measured> {
        let mut below = 0;
        let median = self.counts.iter().position(|count| {
            below += count;
            2 * below >= self.total
        });
        let scale = (median? as f64 + 0.5) * STEP;
        (self.total >= LEAST_MEASUREMENTS).then_some(Measured { scale, measurements: self.total })
    }

    /// The scale that brings a robot's layout onto the centroids of its patches: of all similarities the
    /// one that fits best, weighted by area.
    fn scale_of(&self, seen: &DetectionFrame, robot: &DetectedRobot) -> Option<f64> {
        let is_it =
            |known: &&(u32, u32, f64, Vec<Dot>)| (known.0, known.1) == (robot.team, robot.robot_id);
        let (_, _, height_mm, dots) = self.robots.iter().find(is_it)?;
        let patches = robot.patch_regions.iter().zip(dots).filter_map(|(&region, dot)| {
            let region = seen.regions().get(region as usize)?;
            let image = ImagePoint::new(region.x_px.into(), region.y_px.into());
            let pixel_mm2 = self.camera.pixel_area_mm2(image, *height_mm);
            // Whatever the scale, all patches are larger or smaller alike; one that is not is grown
            // together with something.
            let area_mm2 = f64::from(region.pixel_count) * pixel_mm2;
            Some((dot, self.camera.field_from_image(image, *height_mm), area_mm2 / dot.area_mm2))
        });
        let least = patches.clone().map(|(_, _, ratio)| ratio).fold(f64::INFINITY, f64::min);
        let patches = patches.filter(|(_, _, ratio)| *ratio <= MERGED_RATIO * least);
        similarity(patches.map(|(dot, place, _)| (dot.place_mm, place, dot.area_mm2)))
    }
}

impl Measured {
    /// Whether tops have another size than configured.
    pub fn is_off(&self) -> bool {
        (self.scale - 1.0).abs() > WORTH_TELLING
    }

    /// What is wrong and what to do, for people.
    pub fn advice(&self) -> String {
        format!(
            "robots' tops are {:.2} times as large as configured (median of {} measurements), which puts \
             robots off by millimetres; correct the patches (`outline_mm`, all corners times {:.2}), or \
             the geometry if the pitch itself has another size",
            self.scale, self.measurements, self.scale
        )
    }
}

/// The scale of the similarity that fits best; `None` with fewer than two places.
fn similarity(patches: impl Iterator<Item = (Pair, FieldPoint, f64)> + Clone) -> Option<f64> {
    let (mut weight, mut layout, mut measured) = (0.0, [0.0; 2], [0.0; 2]);
    for ([x, y], place, w) in patches.clone() {
        weight += w;
        layout = [layout[0] + w * x, layout[1] + w * y];
        measured = [measured[0] + w * place.x_mm, measured[1] + w * place.y_mm];
    }
    let layout = layout.map(|sum| sum / weight);
    let measured = measured.map(|sum| sum / weight);
    let (mut along, mut across, mut spread) = (0.0, 0.0, 0.0);
    for ([x, y], place, w) in patches {
        let (px, py) = (x - layout[0], y - layout[1]);
        let (qx, qy) = (place.x_mm - measured[0], place.y_mm - measured[1]);
        along += w * (px * qx + py * qy);
        across += w * (px * qy - py * qx);
        spread += w * (px * px + py * py);
    }
    let scale = along.hypot(across) / spread;
    (spread > 1e-9 && scale.is_finite()).then_some(scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::messages::{MAX_PATCHES, Region};
    use bytemuck::Zeroable;

    /// A frame of the first robot at some poses, its patches `scale` times as far from its centre as
    /// configured.
    fn frame(config: &Config, scale: f64, count: usize) -> Box<DetectionFrame> {
        let camera = CameraModel::new(&config.geometry, config.camera.width, config.camera.height);
        let (camera, layout) = (camera.unwrap(), Layout::new(&config.robots));
        let mut frame = Box::new(DetectionFrame::zeroed());
        for index in 0..count {
            let position = FieldPoint::new(index as f64 * 150.0 - 400.0, 60.0);
            let pose = Pose { position, orientation: index as f64 };
            let mut patch_regions = [u32::MAX; MAX_PATCHES];
            for (patch, region) in layout.patches.iter().zip(&mut patch_regions) {
                let place = pose.field_from_robot(patch.centroid_mm.map(|value| scale * value));
                let image = camera.image_from_field(place, config.robots.height_mm);
                *region = frame.region_count;
                frame.regions[frame.region_count as usize] = Region {
                    x_px: image.x_px as f32,
                    y_px: image.y_px as f32,
                    pixel_count: (100.0 * scale * scale) as u32,
                    ..Region::default()
                };
                frame.region_count += 1;
            }
            frame.push_robot(DetectedRobot { patch_regions, ..DetectedRobot::default() });
        }
        frame
    }

    #[test]
    fn tops_of_another_size_are_told_of() {
        let config = Config::default();
        for (scale, is_off) in [(1.0, false), (1.03, false), (1.4, true), (0.8, true)] {
            let mut tops = TopScale::new(&config).unwrap();
            assert_eq!(tops.measured(), None);
            tops.add(&frame(&config, scale, 5));
            let measured = tops.measured().unwrap();
            assert!((measured.scale - scale).abs() < 0.01, "{measured:?} for {scale}");
            assert_eq!((measured.measurements, measured.is_off()), (5, is_off));
        }
        assert!(Measured { scale: 1.4, measurements: 5 }.advice().contains("1.40 times"));
    }

    #[test]
    fn two_robots_and_unknown_ones_tell_nothing() {
        let config = Config::default();
        let mut tops = TopScale::new(&config).unwrap();
        let mut seen = frame(&config, 1.4, 4);
        seen.robots[2].robot_id = DetectedRobot::UNKNOWN_ID;
        seen.robots[3].patch_regions[0] = u32::MAX;
        tops.add(&seen);
        assert_eq!(tops.measured(), None);
    }
}
