//! Estimates the size of the robots' tops relative to the configured layout, over many robots.
//!
//! A layout configured in the wrong size can go unnoticed: patches may be off their places by the
//! tolerance, so robots are found a centimetre or two off, or none is found without an obvious reason. So
//! the scale is measured independently of recognition, by a Hough transform over the scale (Ballard,
//! *Generalizing the Hough transform to detect arbitrary shapes*, 1981). Each pair of a region in a team's
//! colour and one in an identification colour votes for the scale
//!
//! ```text
//! s = (distance of the two regions) / (distance of the two patches in the layout)
//! ```
//!
//! if both regions have about s² times the area of these patches. Votes are counted in bins of ln s. Pairs
//! of patches on one robot agree on the scale; all other pairs are spread, and fewer.
//!
//! In poor light the votes for one scale spread over thirty bins (measured: 0.89 to 1.19), so those for a top that is
//! a tenth too large reach into the bins around 1 and look like a smaller deviation. From the configured scale the
//! mean of the votes within ±18 bins is therefore followed uphill to where it stays (mean shift: Fukunaga and
//! Hostetler, *The estimation of the gradient of a density function*, 1975). The configured scale, ±6 bins, is given
//! up for that one if it has more than 1.25 times as many votes within ±18 bins, and then for the bin with most votes
//! within ±3 bins if it has more than 1.5 times as many. Where patches bleed into their surroundings their centroids
//! are some 4 % farther apart than they should be.

use config::Config;
use control::report::Tops;
use geometry::layout::Layout;
use geometry::{CameraModel, FieldPoint, GeometryError, ImagePoint};
use messages::DetectionFrame;
use std::ops::RangeInclusive;

/// Fewest votes for a result.
const MIN_VOTES: u64 = 3;
/// Smallest deviation from 1 that is reported: patches bleed, and heights are not exact.
const WORTH_TELLING: f64 = 0.06;
/// Factor by which the votes for another scale must exceed those for the configured one.
const MORE_VOTES: f64 = 1.5;
/// Ratio of the square roots of a region's area and its patch's area at the right scale. Rims are often
/// lost, and in poor light two thirds of a small patch.
const SIZES: RangeInclusive<f64> = 0.55..=1.25;
/// Scales considered.
const SCALES: RangeInclusive<f64> = 0.4..=2.5;
/// Width of a bin, as a natural logarithm …
const STEP: f64 = 0.01;
/// … and number of bins to each side that are counted together.
const SPREAD: usize = 3;
/// Bins to each side that are followed uphill.
const NEARBY: usize = 18;
/// Factor by which the votes uphill must exceed those for the configured scale.
const MORE_NEARBY: f64 = 1.25;
/// Most regions in patch colours per frame, the largest ones; a match has about a hundred.
const MAX_REGIONS: usize = 300;

/// Collects the votes of frames.
#[derive(Debug, Clone)]
pub struct TopScale {
    camera: CameraModel,
    /// Half extents of the field with its goals and the margin: a wooden floor beside it may be as
    /// yellow as patches.
    half_mm: [f64; 2],
    /// The different heights of tops.
    heights_mm: Vec<f64>,
    pairs: Vec<PatchPair>,
    votes: Vec<u64>,
    /// Reused allocation.
    regions: Vec<Measured>,
}

/// A team patch and an identification patch of one robot.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PatchPair {
    /// Colour classes of the two patches.
    classes: [u32; 2],
    areas_mm2: [f64; 2],
    distance_mm: f64,
    /// Index into `heights_mm`.
    height: usize,
}

/// A region projected onto the plane of a height.
#[derive(Debug, Clone, Copy)]
struct Measured {
    class: u32,
    place: FieldPoint,
    area_mm2: f64,
}

/// Result of the votes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// Size of tops relative to the configured size.
    pub scale: f64,
    /// Number of pairs of patches that agree on it, summed over frames.
    pub votes: u64,
}

impl From<Scale> for Tops {
    fn from(measured: Scale) -> Self {
        let problem = if measured.is_off() { measured.advice() } else { String::new() };
        let scale = (measured.scale * 1000.0).round() / 1000.0;
        Self { scale, votes: measured.votes, problem }
    }
}

impl TopScale {
    /// Prepares for pictures of the configured camera.
    pub fn new(config: &Config) -> Result<Self, GeometryError> {
        let camera = CameraModel::new(&config.geometry, config.camera.width, config.camera.height)?;
        let class = |name: &str| config.colors.iter().position(|color| color.name == name);
        let (mut heights_mm, mut pairs) = (Vec::new(), Vec::new());
        let mut layouts: Vec<(&[_], Layout)> = Vec::new();
        for identity in &config.robots.identities {
            let top = config.top_of(identity);
            if !layouts.iter().any(|(known, _)| *known == top.patches) {
                layouts.push((top.patches, Layout::new(top.patches)));
            }
            let layout = layouts.iter().find(|(known, _)| *known == top.patches);
            let Some((_, layout)) = layout else { continue };
            let height = heights_mm.iter().position(|known| *known == top.height_mm);
            let height = height.unwrap_or_else(|| {
                heights_mm.push(top.height_mm);
                heights_mm.len() - 1
            });
            let (Some(team), Some(team_class)) =
                (layout.team_patch(), class(config.teams.color(identity.team)))
            else {
                continue;
            };
            for (patch, color) in layout.identification_patches().zip(&identity.colors) {
                let Some(class) = class(color) else { continue };
                let [dx, dy] = [0, 1].map(|axis| patch.centroid_mm[axis] - team.centroid_mm[axis]);
                let pair = PatchPair {
                    classes: [team_class as u32, class as u32],
                    // Rounded, so that patches equal but for the sampling grid compare equal.
                    areas_mm2: [team.area_mm2, patch.area_mm2].map(f64::round),
                    distance_mm: dx.hypot(dy).round(),
                    height,
                };
                if pair.distance_mm > 0.0 && !pairs.contains(&pair) {
                    pairs.push(pair);
                }
            }
        }
        let bins = bin(*SCALES.end()) + 1;
        let field = &config.field;
        let half_mm = [
            field.length_mm / 2.0 + field.goal_depth_mm + field.margin_mm,
            field.width_mm / 2.0 + field.margin_mm,
        ];
        Ok(Self { camera, half_mm, heights_mm, pairs, votes: vec![0; bins], regions: Vec::new() })
    }

    /// Counts the votes of a frame.
    pub fn add(&mut self, seen: &DetectionFrame) {
        let mut regions = std::mem::take(&mut self.regions);
        for height in 0..self.heights_mm.len() {
            self.measure(seen, height, &mut regions);
            regions.sort_unstable_by(|a, b| b.area_mm2.total_cmp(&a.area_mm2));
            regions.truncate(MAX_REGIONS);
            for pair in self.pairs.iter().filter(|pair| pair.height == height) {
                let of = |class: u32| regions.iter().filter(move |region| region.class == class);
                for team in of(pair.classes[0]) {
                    for other in of(pair.classes[1]) {
                        let distance_mm = team.place.distance(other.place);
                        let scale = distance_mm / pair.distance_mm;
                        let fits = |region: &Measured, area_mm2: f64| {
                            SIZES.contains(&((region.area_mm2 / area_mm2).sqrt() / scale))
                        };
                        if SCALES.contains(&scale)
                            && fits(team, pair.areas_mm2[0])
                            && fits(other, pair.areas_mm2[1])
                        {
                            self.votes[bin(scale)] += 1;
                        }
                    }
                }
            }
        }
        self.regions = regions;
    }

    /// The scale on which most pairs agree, if they are enough.
    pub fn measured(&self) -> Option<Scale> {
        let around = |center: usize, spread: usize| {
            center.saturating_sub(spread)..(center + spread + 1).min(self.votes.len())
        };
        let votes = |bins: std::ops::Range<usize>| self.votes[bins].iter().sum::<u64>();
        let bins = 0..self.votes.len();
        let most = bins.max_by_key(|&center| votes(around(center, SPREAD)))?;
        let (configured, uphill) = (bin(1.0), self.uphill_from(bin(1.0)));
        let has_more = votes(around(uphill, NEARBY)) as f64
            > MORE_NEARBY * votes(around(configured, NEARBY)) as f64;
        let believed = if has_more {
            around(uphill, NEARBY)
        } else {
            around(configured, (WORTH_TELLING / STEP) as usize)
        };
        let other_wins =
            votes(around(most, SPREAD)) as f64 > MORE_VOTES * votes(believed.clone()) as f64;
        let bins = if other_wins { around(most, SPREAD) } else { believed };
        let count = votes(bins.clone());
        if count < MIN_VOTES {
            return None;
        }
        let sum: f64 = bins.map(|bin| self.votes[bin] as f64 * scale_of(bin)).sum();
        Some(Scale { scale: sum / count as f64, votes: count })
    }

    /// The bin at which the mean of the votes within ±[`NEARBY`] bins stays, on the way uphill from another.
    fn uphill_from(&self, start: usize) -> usize {
        let mut center = start;
        // Each step leads to more votes; the bound is for steps between equals.
        for _ in 0..self.votes.len() {
            let first = center.saturating_sub(NEARBY);
            let around = self.votes.iter().enumerate().skip(first).take(2 * NEARBY + 1);
            let (count, sum) = around.fold((0, 0.0), |(count, sum), (bin, &votes)| {
                (count + votes, sum + bin as f64 * votes as f64)
            });
            let next = if count == 0 { center } else { (sum / count as f64).round() as usize };
            if next == center {
                break;
            }
            center = next;
        }
        center
    }

    /// The regions in patch colours, on the plane of a height.
    fn measure(&self, seen: &DetectionFrame, height: usize, regions: &mut Vec<Measured>) {
        regions.clear();
        let height_mm = self.heights_mm[height];
        for region in seen.regions() {
            if self.pairs.iter().any(|pair| pair.classes.contains(&region.class)) {
                let image = ImagePoint::new(region.x_px.into(), region.y_px.into());
                let place = self.camera.field_from_image(image, height_mm);
                let [half_length, half_width] = self.half_mm;
                if !(place.x_mm.abs() <= half_length && place.y_mm.abs() <= half_width) {
                    continue;
                }
                let pixel_mm2 = self.camera.pixel_area_mm2(image, height_mm);
                regions.push(Measured {
                    class: region.class,
                    place,
                    area_mm2: f64::from(region.pixel_count) * pixel_mm2,
                });
            }
        }
    }
}

/// Bin of a scale.
fn bin(scale: f64) -> usize {
    ((scale / SCALES.start()).ln() / STEP).round().max(0.0) as usize
}

fn scale_of(bin: usize) -> f64 {
    SCALES.start() * (bin as f64 * STEP).exp()
}

impl Scale {
    /// Whether tops have another size than configured.
    pub fn is_off(&self) -> bool {
        (self.scale - 1.0).abs() > WORTH_TELLING
    }

    /// The problem and its remedy, as text.
    pub fn advice(&self) -> String {
        format!(
            "robots' tops look {:.2} times as large as configured ({} pairs of patches say so), which puts \
             robots off or loses them; multiply the patches' corners (`outline_mm`) by {:.2}, or correct the \
             geometry if the pitch has another size, too",
            self.scale, self.votes, self.scale
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use config::Preset;
    use geometry::Pose;
    use messages::Region;

    /// All robots of a configuration in a grid, their patches `scale` times as large as configured and
    /// as far from the centre; `shown` is the recognised share of each. Regions only.
    fn frame(config: &Config, scale: f64, shown: f64) -> Box<DetectionFrame> {
        let camera = CameraModel::new(&config.geometry, config.camera.width, config.camera.height);
        let camera = camera.unwrap();
        let mut frame = Box::new(DetectionFrame::zeroed());
        for (index, identity) in config.robots.identities.iter().enumerate() {
            let top = config.top_of(identity);
            let layout = Layout::new(top.patches);
            let pitch_mm = config.field.width_mm / 8.0;
            let [x, y] = [index % 6, index / 6].map(|step| (step as f64 - 2.5) * pitch_mm);
            let pose = Pose { position: FieldPoint::new(x, y), orientation: index as f64 };
            let mut colors = identity.colors.iter().map(String::as_str);
            for patch in &layout.patches {
                let color = match patch.role {
                    config::PatchRole::Team => config.teams.color(identity.team),
                    config::PatchRole::Identification => colors.next().unwrap(),
                };
                let class = config.colors.iter().position(|known| known.name == color).unwrap();
                let place = pose.field_from_robot(patch.centroid_mm.map(|value| scale * value));
                let image = camera.image_from_field(place, top.height_mm);
                let pixel_mm2 = camera.pixel_area_mm2(image, top.height_mm);
                frame.regions[frame.region_count as usize] = Region {
                    class: class as u32,
                    x_px: image.x_px as f32,
                    y_px: image.y_px as f32,
                    // Part of the rim is lost.
                    pixel_count: (shown * scale * scale * patch.area_mm2 / pixel_mm2) as u32,
                    ..Region::default()
                };
                frame.region_count += 1;
            }
        }
        frame
    }

    #[test]
    fn tops_of_another_size_are_told_of() {
        for config in Preset::ALL.map(Preset::config) {
            for (scale, is_off) in
                [(1.0, false), (1.03, false), (1.15, true), (1.4, true), (1.7, true), (0.7, true)]
            {
                let mut tops = TopScale::new(&config).unwrap();
                assert_eq!(tops.measured(), None);
                tops.add(&frame(&config, scale, 0.8));
                let measured = tops.measured().unwrap();
                let name = config.preset.name();
                assert!(
                    (measured.scale / scale - 1.0).abs() < 0.03,
                    "{name} {scale}: {measured:?}"
                );
                assert_eq!(measured.is_off(), is_off, "{name} {scale}: {measured:?}");
            }
        }
        assert!(Scale { scale: 1.4, votes: 5 }.advice().contains("1.40 times"));
    }

    /// In poor light the centroids of patches are off by up to a sixth of their distance, differently on each robot.
    #[test]
    fn places_in_poor_light_hide_no_deviation() {
        let config = Preset::MirosotTriangles.config();
        for (scale, is_off) in [(1.0, false), (1.15, true), (0.85, true)] {
            let mut tops = TopScale::new(&config).unwrap();
            for step in -7..=7 {
                let off = 0.16 * f64::from(step) / 7.0;
                tops.add(&frame(&config, scale * (1.0 + off), 0.7));
            }
            let measured = tops.measured().unwrap();
            assert!((measured.scale / scale - 1.0).abs() < 0.03, "{scale}: {measured:?}");
            assert_eq!(measured.is_off(), is_off, "{scale}: {measured:?}");
        }
    }

    #[test]
    fn one_robot_tells_nothing() {
        let mut config = Config::default();
        let mut tops = TopScale::new(&config).unwrap();
        config.robots.identities.truncate(1);
        tops.add(&frame(&config, 1.4, 0.8));
        assert_eq!(tops.measured(), None);
    }

    #[test]
    fn specks_and_poor_light_hide_nothing() {
        let config = Preset::MirosotTriangles.config();
        let mut seen = frame(&config, 1.4, 0.4);
        for index in 0..800 {
            let (column, row) = (index % 40, index / 40);
            seen.regions[seen.region_count as usize] = Region {
                class: index as u32 % 8,
                x_px: 30.0 + 14.0 * column as f32,
                y_px: 30.0 + 20.0 * row as f32,
                pixel_count: 3,
                ..Region::default()
            };
            seen.region_count += 1;
        }
        let mut tops = TopScale::new(&config).unwrap();
        tops.add(&seen);
        let measured = tops.measured().unwrap();
        assert!((measured.scale / 1.4 - 1.0).abs() < 0.03, "{measured:?}");
    }
}
