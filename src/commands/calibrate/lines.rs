//! Refines a calibration on the lines of the pitch, located to a fraction of a pixel near where the
//! marks predict them.
//!
//! Sample places lie a few pixels apart along every line of the pitch. At each, the brightness profile
//! across the line, straight in the calibration's field coordinates, is searched: a painted line is a
//! ridge, the foot of a wall a step. The camera is fitted to the edges found, outliers are dropped
//! (robots stand on lines), and the search is repeated with a shorter reach.

use config::{Config, FieldConfig};
use geometry::{CameraModel, FieldPoint, ImagePoint};
use image::RgbImage;
use setup::calibration::{Calibration, CalibrationError, EdgeMark, KnownLens, Mark, refine};
use std::f64::consts::TAU;

/// A calibration refined on lines.
pub struct Refined {
    pub calibration: Calibration,
    /// Places that were found, and places that were searched.
    pub found: usize,
    pub wanted: usize,
    /// Root mean square residual of the lines after the fit.
    pub rms_px: f64,
    /// Displacement of the pitch's outline in the picture by the fit: root mean square and maximum.
    pub moved_px: [f64; 2],
}

/// Reason why a calibration is left unchanged.
#[derive(Debug, thiserror::Error)]
pub enum NotRefined {
    #[error("only {found} of {wanted} places on lines were found")]
    TooFew { found: usize, wanted: usize },
    #[error("what was found of the lines does not fit together: {rms_px:.1} px")]
    Scattered { rms_px: f64 },
    #[error(
        "what was found of the lines contradicts the points, which would be {rms_px:.1} px beside where they were \
         marked; does the pitch have the configured sizes and lines?"
    )]
    Contradicted { rms_px: f64 },
    #[error("the lines found do not determine the camera: {0}")]
    Undetermined(#[from] CalibrationError),
}

/// Reach of the search across a line, px, per iteration.
const REACHES_PX: [f64; 4] = [14.0, 9.0, 6.0, 6.0];
/// Reaches when only a small correction is expected.
const LAST_REACHES_PX: &[f64] = &[6.0];
/// Distance between neighbouring places on a line.
const SPACING_PX: f64 = 10.0;
/// Fewest places found, and smallest share of those searched, for a refinement.
const LEAST_FOUND: usize = 40;
const LEAST_SHARE: f64 = 0.25;
/// Above this residual the edges do not belong to the pitch's lines.
const MAX_RMS_PX: f64 = 0.8;
/// Largest root mean square error assumed for points marked by hand.
const ROUGH_POINTS_PX: f64 = 3.0;
/// With at least this surplus of equations over unknowns, the points' own residuals give their marking
/// error. Lines that move the points by more than the given number of deviations are not those of the
/// pitch.
const SUFFICIENT_SURPLUS: usize = 3;
const MAX_DEVIATIONS: f64 = 4.0;
/// Smallest marking error assumed for the points.
const FINE_POINTS_PX: f64 = 0.25;

/// Fits the camera to the lines.
pub fn refined(
    picture: &RgbImage,
    config: &Config,
    marks: &[Mark],
    lens: KnownLens,
    rough: &Calibration,
) -> Result<Refined, NotRefined> {
    let brightness = Brightness::of(picture);
    let (field, camera) = (&config.field, &config.camera);
    let search = Search { brightness: &brightness, marks, lens, config };
    let centered = search.from(rough, Insets::default(), &REACHES_PX)?;
    let best = search.better_inset(centered);
    if best.rms_px > MAX_RMS_PX {
        return Err(NotRefined::Scattered { rms_px: best.rms_px });
    }
    let rms_px = best.calibration.rms_px();
    if rms_px > may_move_px(rough) {
        return Err(NotRefined::Contradicted { rms_px });
    }
    let moved_px =
        moved(&rough.model, &best.calibration.model, field, [camera.width, camera.height]);
    let Found { calibration, found, wanted, rms_px, .. } = best;
    Ok(Refined { calibration, found, wanted, rms_px, moved_px })
}

/// Largest root mean square displacement of the points, from where they were marked, that lines may
/// cause.
fn may_move_px(by_points: &Calibration) -> f64 {
    let surplus = by_points.surplus;
    if surplus < SUFFICIENT_SURPLUS {
        return ROUGH_POINTS_PX;
    }
    let equations = 2.0 * by_points.errors_px.len() as f64;
    let deviation_px = by_points.rms_px() * (equations / surplus as f64).sqrt();
    MAX_DEVIATIONS * deviation_px.max(FINE_POINTS_PX)
}

/// Distance by which the middle of a painted line lies inside the dimension it marks. Leagues differ in
/// whether a dimension is measured to the middle or to the outer edge of the line.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Insets {
    border_mm: f64,
    circle_mm: f64,
}

/// Result of a search for the lines.
struct Found {
    calibration: Calibration,
    found: usize,
    wanted: usize,
    rms_px: f64,
    /// Apparent width of the border's line; 0 if the border is not a painted line.
    line_mm: f64,
}

struct Search<'a> {
    brightness: &'a Brightness,
    marks: &'a [Mark],
    lens: KnownLens,
    config: &'a Config,
}

impl Search<'_> {
    /// Searches for the lines around their place in a calibration, iteratively with shorter reaches.
    fn from(
        &self,
        start: &Calibration,
        insets: Insets,
        reaches_px: &[f64],
    ) -> Result<Found, NotRefined> {
        let mut calibration = start.clone();
        let mut last = (0, 0, 0.0, 0.0);
        for &reach_px in reaches_px {
            let (edges, wanted, line_mm) = find_edges(
                self.brightness,
                &self.config.field,
                &calibration.model,
                insets,
                reach_px,
            );
            if edges.len() < LEAST_FOUND || (edges.len() as f64) < LEAST_SHARE * wanted as f64 {
                return Err(NotRefined::TooFew { found: edges.len(), wanted });
            }
            let (fitted, found, rms_px) =
                fit_without_outliers(edges, self.marks, self.lens, self.config)?;
            calibration = fitted;
            last = (found, wanted, rms_px, line_mm);
        }
        let (found, wanted, rms_px, line_mm) = last;
        Ok(Found { calibration, found, wanted, rms_px, line_mm })
    }

    /// The result with lines inset from the dimensions they mark, if that fits better: only the border,
    /// or the circle too. The squared error is a parabola of the inset.
    fn better_inset(&self, centered: Found) -> Found {
        let half_mm = centered.line_mm / 2.0;
        let mut best = centered;
        if half_mm <= 0.0 {
            return best;
        }
        let start = best.calibration.clone();
        let square = best.rms_px.powi(2);
        for circle in [1.0, 0.0] {
            let inside = |inset_mm: f64| {
                let insets = Insets { border_mm: inset_mm, circle_mm: circle * inset_mm };
                self.from(&start, insets, LAST_REACHES_PX)
            };
            let Ok(at_half) = inside(half_mm) else { continue };
            let Ok(at_whole) = inside(2.0 * half_mm) else { continue };
            let (a, b, c) = (square, at_half.rms_px.powi(2), at_whole.rms_px.powi(2));
            let curvature = a - 2.0 * b + c;
            let lowest = half_mm * (1.0 + (a - c) / (2.0 * curvature));
            // The line is painted symmetrically, or the other lines do not determine the inset.
            if curvature <= 0.0 || !(0.2 * half_mm..1.8 * half_mm).contains(&lowest) {
                continue;
            }
            if let Ok(found) = inside(lowest)
                && found.rms_px < CLEARLY * best.rms_px
            {
                best = found;
            }
        }
        best
    }
}

/// An inset is accepted if it reduces the residual to less than this share.
const CLEARLY: f64 = 0.8;

/// A line of the pitch: gives its points for a parameter from 0 to 1.
struct Line {
    at: Box<dyn Fn(f64) -> [f64; 2]>,
    length_mm: f64,
    /// Towards the pitch's middle, for the border.
    inwards: Option<[f64; 2]>,
    /// Distance of its points inside the dimension it marks.
    inset_mm: f64,
}

fn lines(field: &FieldConfig, insets: Insets) -> Vec<Line> {
    let Insets { border_mm, circle_mm } = insets;
    let (x, y) = (field.length_mm / 2.0 - border_mm, field.width_mm / 2.0 - border_mm);
    let radius = field.center_circle_radius_mm - circle_mm;
    let straight = |from: [f64; 2], to: [f64; 2], inwards: Option<[f64; 2]>| Line {
        inset_mm: if inwards.is_some() { border_mm } else { 0.0 },
        at: Box::new(move |part| [0, 1].map(|axis| from[axis] + part * (to[axis] - from[axis]))),
        length_mm: (to[0] - from[0]).hypot(to[1] - from[1]),
        inwards,
    };
    let mut lines = vec![
        straight([-x, y], [x, y], Some([0.0, -1.0])),
        straight([-x, -y], [x, -y], Some([0.0, 1.0])),
        straight([-x, -y], [-x, y], Some([1.0, 0.0])),
        straight([x, -y], [x, y], Some([-1.0, 0.0])),
        straight([0.0, -y], [0.0, y], None),
    ];
    if radius > 0.0 {
        lines.push(Line {
            at: Box::new(move |part| {
                let (sin, cos) = (TAU * part).sin_cos();
                [radius * cos, radius * sin]
            }),
            length_mm: TAU * radius,
            inwards: None,
            inset_mm: circle_mm,
        });
    }
    lines
}

/// The edges found, the number of places searched, and the apparent width of the border's line.
fn find_edges(
    brightness: &Brightness,
    field: &FieldConfig,
    model: &CameraModel,
    insets: Insets,
    reach_px: f64,
) -> (Vec<EdgeMark>, usize, f64) {
    let mut edges = Vec::new();
    let mut widths_mm = Vec::new();
    let mut wanted = 0;
    for line in lines(field, insets) {
        let seen = |[x, y]: [f64; 2]| model.image_from_field(FieldPoint::new(x, y), 0.0);
        let middle = (line.at)(0.5);
        let mm_per_px = model.pixel_area_mm2(seen(middle), 0.0).sqrt();
        let count = (line.length_mm / mm_per_px / SPACING_PX).ceil().clamp(1.0, 2000.0) as usize;
        for index in 0..count {
            let part = (index as f64 + 0.5) / count as f64;
            let field_mm = (line.at)(part);
            let step = 0.5 / count as f64;
            let (here, ahead, behind) =
                (seen(field_mm), seen((line.at)(part + step)), seen((line.at)(part - step)));
            let along = [ahead.x_px - behind.x_px, ahead.y_px - behind.y_px];
            let length = along[0].hypot(along[1]);
            let mut normal = [-along[1] / length, along[0] / length];
            if let Some([x, y]) = line.inwards {
                // A point towards the pitch's middle distinguishes inside from outside.
                let inside = seen([field_mm[0] + mm_per_px * x, field_mm[1] + mm_per_px * y]);
                let across = [inside.x_px - here.x_px, inside.y_px - here.y_px];
                if normal[0] * across[0] + normal[1] * across[1] < 0.0 {
                    normal = normal.map(|part| -part);
                }
            }
            if !brightness.holds(here, reach_px + MARGIN_PX) {
                continue;
            }
            wanted += 1;
            let profile = brightness.profile(here, normal, reach_px);
            let Some((offset, width)) = profile.line(line.inwards.is_some()) else { continue };
            let image_px = [here.x_px + offset * normal[0], here.y_px + offset * normal[1]];
            let field_mm = match (width, line.inwards) {
                // The floor ends at the border itself.
                (None, Some(inwards)) => {
                    [0, 1].map(|axis| field_mm[axis] - line.inset_mm * inwards[axis])
                }
                (Some(width_px), Some(_)) => {
                    widths_mm.push(width_px * mm_per_px);
                    field_mm
                }
                _ => field_mm,
            };
            edges.push(EdgeMark { field_mm, image_px, normal });
        }
    }
    widths_mm.sort_by(f64::total_cmp);
    let width_mm = widths_mm.get(widths_mm.len() / 2).copied().unwrap_or(0.0);
    (edges, wanted, width_mm)
}

/// Fits to the edges, and repeats without outliers.
fn fit_without_outliers(
    mut edges: Vec<EdgeMark>,
    marks: &[Mark],
    lens: KnownLens,
    config: &Config,
) -> Result<(Calibration, usize, f64), CalibrationError> {
    let mut calibration = refine(marks, &edges, lens, &config.field, &config.camera)?;
    for _ in 0..4 {
        let errors: Vec<f64> = edges.iter().map(|edge| off_by(&calibration.model, edge)).collect();
        let mut sizes: Vec<f64> = errors.iter().map(|error| error.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        // The median absolute value of normally distributed errors is 0.67 deviations.
        let limit = (4.5 * sizes[sizes.len() / 2]).max(0.3);
        let count = edges.len();
        let mut errors = errors.iter();
        edges.retain(|_| errors.next().is_some_and(|error| error.abs() <= limit));
        if edges.len() == count {
            break;
        }
        calibration = refine(marks, &edges, lens, &config.field, &config.camera)?;
    }
    let squares = edges.iter().map(|edge| off_by(&calibration.model, edge).powi(2)).sum::<f64>();
    let rms_px = (squares / edges.len().max(1) as f64).sqrt();
    Ok((calibration, edges.len(), rms_px))
}

fn off_by(model: &CameraModel, edge: &EdgeMark) -> f64 {
    let [x, y] = edge.field_mm;
    let seen = model.image_from_field(FieldPoint::new(x, y), 0.0);
    (seen.x_px - edge.image_px[0]) * edge.normal[0]
        + (seen.y_px - edge.image_px[1]) * edge.normal[1]
}

/// Displacement of the border in the picture between two models.
fn moved(
    from: &CameraModel,
    to: &CameraModel,
    field: &FieldConfig,
    [width, height]: [u32; 2],
) -> [f64; 2] {
    let (mut squares, mut most, mut count) = (0.0, 0.0f64, 0.0);
    for line in lines(field, Insets::default()) {
        for step in 0..=16 {
            let [x, y] = (line.at)(f64::from(step) / 16.0);
            let point = FieldPoint::new(x, y);
            let (a, b) = (from.image_from_field(point, 0.0), to.image_from_field(point, 0.0));
            let is_seen = (0.0..f64::from(width)).contains(&b.x_px)
                && (0.0..f64::from(height)).contains(&b.y_px);
            let distance = (a.x_px - b.x_px).hypot(a.y_px - b.y_px);
            if is_seen && distance.is_finite() {
                squares += distance * distance;
                most = most.max(distance);
                count += 1.0;
            }
        }
    }
    [f64::sqrt(squares / f64::max(count, 1.0)), most]
}

/// Brightness of each pixel.
struct Brightness {
    values: Vec<f32>,
    width: usize,
    height: usize,
}

/// Margin around a profile that interpolation needs, px.
const MARGIN_PX: f64 = 4.0;
/// Samples of a profile per pixel.
const STEPS_PER_PX: usize = 4;
/// Width of a brightness step, px.
const STEP_PX: usize = 2;
/// Smallest contrast, in grey levels, of a line against the floor on both sides.
const LEAST_CONTRAST: f32 = 12.0;

impl Brightness {
    fn of(picture: &RgbImage) -> Self {
        let values = picture.pixels().map(|pixel| {
            let [red, green, blue] = pixel.0.map(f32::from);
            0.25 * red + 0.5 * green + 0.25 * blue
        });
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        let brightness = Self { values: values.collect(), width, height };
        let is_grey = picture.pixels().all(|pixel| pixel.0.iter().all(|&part| part == pixel.0[0]));
        if is_grey { brightness.without_mosaic() } else { brightness }
    }

    /// The picture with its Bayer mosaic smoothed: each pixel averaged with its neighbours, so that all
    /// colours have equal weight.
    fn without_mosaic(&self) -> Self {
        let value = |index: usize| {
            let (column, row) = (index % self.width, index / self.width);
            let around = |place: usize, size: usize| {
                [(place.saturating_sub(1), 1.0), (place, 2.0), ((place + 1).min(size - 1), 1.0)]
            };
            let mut sum = 0.0;
            for (row, down) in around(row, self.height) {
                for (column, across) in around(column, self.width) {
                    sum += down * across * self.values[row * self.width + column];
                }
            }
            sum / 16.0
        };
        Self {
            values: (0..self.values.len()).map(value).collect(),
            width: self.width,
            height: self.height,
        }
    }

    fn holds(&self, point: ImagePoint, margin_px: f64) -> bool {
        let inside =
            |value: f64, size: usize| (margin_px..size as f64 - 1.0 - margin_px).contains(&value);
        inside(point.x_px, self.width) && inside(point.y_px, self.height)
    }

    fn at(&self, x: f64, y: f64) -> f32 {
        let (left, top) = (x.floor(), y.floor());
        let (right_part, down_part) = ((x - left) as f32, (y - top) as f32);
        let value = |column: usize, row: usize| {
            self.values[row.min(self.height - 1) * self.width + column.min(self.width - 1)]
        };
        let (left, top) = (left.max(0.0) as usize, top.max(0.0) as usize);
        let blend = |a: f32, b: f32, part: f32| a + part * (b - a);
        let above = blend(value(left, top), value(left + 1, top), right_part);
        let below = blend(value(left, top + 1), value(left + 1, top + 1), right_part);
        blend(above, below, down_part)
    }

    /// Brightness profile across a line, `reach_px` to each side; averaged over some pixels along the
    /// line, which also smooths the mosaic of a raw picture.
    fn profile(&self, here: ImagePoint, normal: [f64; 2], reach_px: f64) -> Profile {
        let steps = (2.0 * reach_px) as usize * STEPS_PER_PX + 1;
        let along = [-normal[1], normal[0]];
        let value = |index: usize| {
            let across = index as f64 / STEPS_PER_PX as f64 - reach_px;
            let sum: f32 = [-1.5, -0.5, 0.5, 1.5]
                .map(|beside| {
                    let x = here.x_px + across * normal[0] + beside * along[0];
                    let y = here.y_px + across * normal[1] + beside * along[1];
                    self.at(x, y)
                })
                .iter()
                .sum();
            sum / 4.0
        };
        Profile { values: (0..steps).map(value).collect(), reach_px }
    }
}

/// Brightness across a line.
struct Profile {
    values: Vec<f32>,
    reach_px: f64,
}

impl Profile {
    /// Position of the line, if exactly one is in the profile, and its width. Steps, where the floor
    /// ends at something brighter, are searched at the border only and have no width.
    fn line(&self, is_border: bool) -> Option<(f64, Option<f64>)> {
        if let Some([from, to]) = self.ridge() {
            return Some(((from + to) / 2.0, Some(to - from)));
        }
        if is_border { self.step().map(|place| (place, None)) } else { None }
    }

    /// Both edges of the one bright line in the profile.
    fn ridge(&self) -> Option<[f64; 2]> {
        let mut sorted = self.values.clone();
        sorted.sort_by(f32::total_cmp);
        let floor = sorted[sorted.len() / 4];
        let top = *sorted.last()?;
        if top - floor < LEAST_CONTRAST {
            return None;
        }
        let level = (floor + top) / 2.0;
        let above: Vec<usize> =
            (0..self.values.len()).filter(|&index| self.values[index] > level).collect();
        let (&first, &last) = (above.first()?, above.last()?);
        let is_whole = last - first + 1 == above.len();
        let is_inside = first > 2 && last + 3 < self.values.len();
        if !is_whole || !is_inside {
            return None;
        }
        // Both sides must be floor.
        let side = |range: std::ops::Range<usize>| {
            let values = &self.values[range];
            values.iter().sum::<f32>() / values.len().max(1) as f32
        };
        let (before, behind) =
            (side(0..first.saturating_sub(2).max(1)), side(last + 3..self.values.len()));
        let rise = (top - before).min(top - behind);
        if rise < LEAST_CONTRAST || (before - behind).abs() > 0.4 * rise {
            return None;
        }
        Some([
            self.crossing(first, (before + top) / 2.0)?,
            self.crossing(last + 1, (behind + top) / 2.0)?,
        ])
    }

    /// The step from something brighter outside down to the floor: the last step of the profile, because
    /// the floor is even.
    fn step(&self) -> Option<f64> {
        let far = STEP_PX * STEPS_PER_PX;
        let falls = |index: usize| self.values[index - far] - self.values[index + far];
        let places = far..self.values.len().checked_sub(far)?;
        let steepest = places.clone().map(falls).fold(0.0, f32::max);
        if steepest < LEAST_CONTRAST {
            return None;
        }
        let last = places.rev().find(|&index| falls(index) > 0.7 * steepest)?;
        // Backwards to the steepest fall.
        let index = (far.max(last.saturating_sub(2 * far))..=last)
            .max_by(|&a, &b| falls(a).total_cmp(&falls(b)))?;
        let level = (self.values[index - far] + self.values[index + far]) / 2.0;
        self.crossing(index, level)
    }

    /// Position where the profile crosses a level near this sample, in pixels from its middle.
    fn crossing(&self, near: usize, level: f32) -> Option<f64> {
        let range = near.saturating_sub(6).max(1)..(near + 6).min(self.values.len());
        let crosses =
            |&index: &usize| (self.values[index - 1] > level) != (self.values[index] > level);
        let index = range.filter(crosses).min_by_key(|index| index.abs_diff(near))?;
        let (before, behind) = (self.values[index - 1], self.values[index]);
        let part = f64::from((level - before) / (behind - before));
        Some((index as f64 - 1.0 + part) / STEPS_PER_PX as f64 - self.reach_px)
    }
}
