//! Refines a calibration on the lines of the pitch, located to a fraction of a pixel near where the
//! marks predict them.
//!
//! Sample places lie a few pixels apart along every line of the pitch. At each, the brightness profile
//! across the line, straight in the calibration's field coordinates, is searched: a painted line is a
//! ridge, the foot of a wall a step. The camera is fitted to the edges found, outliers are dropped
//! (robots stand on lines), and the search is repeated with a shorter reach.

use super::brightness::{Brightness, MARGIN_PX};
use super::pitch::{Insets, lines};
use crate::calibration::{Calibration, CalibrationError, EdgeMark, KnownLens, Mark, refine};
use config::{Config, FieldConfig};
use geometry::{CameraModel, FieldPoint};
use image::RgbImage;

/// The lines on which a calibration was refined.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinesFound {
    /// Places that were found.
    pub found: usize,
    /// Places that were searched.
    pub wanted: usize,
    /// Root mean square residual of the lines after the fit.
    pub rms_px: f64,
    /// Displacement of the pitch's outline in the picture by the lines: root mean square and maximum.
    pub moved_px: [f64; 2],
}

impl LinesFound {
    /// The same as text.
    pub fn text(&self) -> String {
        let Self { found, wanted, rms_px, moved_px: [mean, most] } = self;
        format!(
            "found at {found} of {wanted} places, rms {rms_px:.2} px; they moved the pitch by {mean:.1} px in the \
             mean,\n            {most:.1} px at most"
        )
    }
}

/// Reason why a calibration is left unchanged.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
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

/// The camera fitted to the lines near where `rough` has them, unless they move the marks by more than
/// `may_move_px` (root mean square).
pub fn refined(
    picture: &RgbImage,
    config: &Config,
    marks: &[Mark],
    lens: KnownLens,
    rough: &Calibration,
    may_move_px: f64,
) -> Result<(Calibration, LinesFound), NotRefined> {
    let brightness = Brightness::of(picture);
    let (field, camera) = (&config.field, &config.camera);
    let search = Search { brightness: &brightness, marks, lens, config };
    let centered = search.from(rough, Insets::default(), &REACHES_PX)?;
    let best = search.better_inset(centered);
    if best.rms_px > MAX_RMS_PX {
        return Err(NotRefined::Scattered { rms_px: best.rms_px });
    }
    let rms_px = best.calibration.rms_px();
    if rms_px > may_move_px {
        return Err(NotRefined::Contradicted { rms_px });
    }
    let moved_px =
        moved(&rough.model, &best.calibration.model, field, [camera.width, camera.height]);
    let Found { calibration, found, wanted, rms_px, .. } = best;
    Ok((calibration, LinesFound { found, wanted, rms_px, moved_px }))
}

/// Largest root mean square displacement of points marked by hand, from where they were marked, that lines may
/// cause.
pub fn marking_error_px(by_points: &Calibration) -> f64 {
    let surplus = by_points.surplus;
    if surplus < SUFFICIENT_SURPLUS {
        return ROUGH_POINTS_PX;
    }
    let equations = 2.0 * by_points.errors_px.len() as f64;
    let deviation_px = by_points.rms_px() * (equations / surplus as f64).sqrt();
    MAX_DEVIATIONS * deviation_px.max(FINE_POINTS_PX)
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
