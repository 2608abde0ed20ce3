//! The camera fit: chooses the free parameters and finds their values.
//!
//! For a given set of free parameters, the Levenberg–Marquardt method minimises the sum of squared
//! distances in the picture, from a start given by the direct linear transform (`homography`). Free are
//! the eight parameters of the homography, those lens coordinates that points at different heights or a
//! measured height can determine, and 0, 1, 2 or 4 distortion parameters. A larger number of distortion
//! parameters is accepted if the improvement is significant at about 1 % by an F test, with sums of
//! squares S, the number of added parameters, and the surplus of equations over parameters:
//!
//! ```text
//! (S_few − S_many) / added > 6.6 · (1 + 12 / surplus) · S_many / surplus
//! ```
//!
//! If the lens found bends the picture strongly, or the residual stays large, the physical cameras of
//! `physical.rs` compete with this free fit. The winner has the smallest corrected Akaike criterion for n
//! equations and k parameters (Hurvich & Tsai, *Regression and time series model selection in small
//! samples*, 1989), plus an Occam term that charges each parameter for how much closer the points
//! determine it than its prior. σ keeps differences smaller than marking errors from deciding:
//!
//! ```text
//! AICc = n·ln(S/n + σ²) + 2k + 2k·(k + 1) / (n − k − 1)
//! ```

use super::least_squares::{Minimum, minimise};
use super::parameters::{COUNT, DISTORTION, HOMOGRAPHY, LENS, Parameters, Scales};
use super::perspective::lens_above;
use super::physical::{self, LensForm, Physical, QuickCamera};
use super::{EdgeMark, KnownLens, LensSource, Mark};
use config::{DistortionConfig, DistortionModel, FieldConfig, PointPair};
use geometry::lens::Lens;
use geometry::{CameraModel, FieldPoint, GeometryError, homography};
use nalgebra::{DVector, Matrix3, Vector2, Vector3};

/// The points and edges to fit, and the prior knowledge.
#[derive(Debug, Clone, Copy)]
pub(super) struct Task<'a> {
    pub marks: &'a [Mark],
    /// Weight of a mark's residual relative to an edge's.
    pub mark_weight: f64,
    /// Points of lines of the pitch found in the picture.
    pub edges: &'a [EdgeMark],
    pub known_lens: KnownLens,
    pub field: &'a FieldConfig,
    pub picture_px: [u32; 2],
    /// Whether the picture is known to be mirrored.
    pub is_mirrored: bool,
    /// Most distortion parameters to fit.
    pub max_distortion: usize,
}

/// A fitted camera.
#[derive(Debug, Clone)]
pub(super) struct Fitted {
    pub model: CameraModel,
    pub lens_mm: [f64; 3],
    pub distortion: DistortionConfig,
    pub lens_source: LensSource,
    pub lens_sigma_mm: [f64; 3],
    pub surplus: usize,
    pub distortion_parameters: usize,
    /// Whether square pixels were assumed.
    pub is_physical: bool,
    /// Sum of the points' squared residuals, px².
    sum_of_squares: f64,
    /// Variance of a marked coordinate, from the residuals.
    variance_px2: f64,
    /// Corrected Akaike information criterion plus Occam term; the smallest is the likeliest.
    criterion: f64,
    /// The criterion with the larger σ of marks by hand.
    criterion_by_hand: f64,
}

/// Distortion parameters of the polynomial model: k1, k2 and the centre.
pub(super) const POLYNOMIAL: usize = 4;
/// Most distortion parameters of any model: those of a fisheye, k1, k2, the centre and a focal length.
pub(super) const MAX_DISTORTION: usize = 5;

/// A point farther than this from the height of most points counts as raised.
const RAISED_MM: f64 = 1.0;
/// Smallest standard deviation assumed for a marked point.
const MARKING_SIGMA_PX: f64 = 0.2;
/// Raised points determine the lens if its height's relative standard deviation is at most this.
const MAX_LENS_SIGMA: f64 = 0.25;
/// Below this residual no distortion is looked for.
const NEGLIGIBLE_RMS_PX: f64 = 0.01;
/// σ of the criterion: smaller differences do not distinguish cameras.
const TELLING_SIGMA_PX: f64 = 0.03;
/// σ of the criterion among physical cameras: nobody marks points better than this.
const BY_HAND_SIGMA_PX: f64 = 0.1;
/// Above this residual further models are tried, even if the points are too few to show them.
const TOO_LARGE_RMS_PX: f64 = 1.0;
/// Smallest third coordinate of the ray of a marked point.
const MIN_DEPTH: f64 = 0.1;
/// Values of k1 at which to start when a straight lens does not lead to a good fit.
const BARRELS: [f64; 6] = [0.1, -0.06, -0.12, -0.18, -0.24, -0.3];
/// Relative displacement of points above which a lens counts as strongly bent, so that other models are
/// tried.
const STRONG_BENDING: f64 = 0.08;
/// Occam term of a parameter without prior: twice the logarithm of the ratio of its range and its final
/// uncertainty.
const FREEDOM: f64 = 6.0;
/// Parameters of the free camera that a physical one does not have: the two of the pixel shape.
const NOT_PHYSICAL: usize = 2;
/// Fewest equations for a physical camera: it has at least seven free parameters, one of which stays
/// undetermined by points of one height.
const MIN_PHYSICAL_EQUATIONS: usize = 10;

impl Task<'_> {
    /// The camera with as many free parameters as the points can determine: the free fit or, if the
    /// picture is bent, the likeliest of all cameras.
    pub fn best_fit(&self) -> Result<Fitted, GeometryError> {
        let free = self.best_free_fit();
        let is_bent = free.as_ref().map_or(true, |fit| {
            self.bending(&fit.distortion) > STRONG_BENDING
                || fit.rms_px(self.marks.len()) > TOO_LARGE_RMS_PX
        });
        if !is_bent
            || self.max_distortion < MAX_DISTORTION
            || self.equations() < MIN_PHYSICAL_EQUATIONS
        {
            return free;
        }
        let cameras = LensForm::all().filter_map(|form| self.physical_fit(&form));
        let likeliest = cameras.min_by(|a, b| a.criterion_by_hand.total_cmp(&b.criterion_by_hand));
        let all = free.clone().into_iter().chain(likeliest);
        all.min_by(|a, b| a.criterion.total_cmp(&b.criterion)).map_or(free, Ok)
    }

    /// Largest relative displacement of a mark by the lens.
    fn bending(&self, distortion: &DistortionConfig) -> f64 {
        let lens = Lens::new(distortion, self.picture_px);
        let center = Vector2::from(distortion.center_px);
        let bending = self.marks.iter().map(|mark| {
            let pixel = Vector2::from(mark.image_px);
            let [ray] = lens.rays_from_image([pixel]);
            let (ideal, seen) = ((ray.xy() / ray.z - center).norm(), (pixel - center).norm());
            (ideal / seen.max(1.0) - 1.0).abs()
        });
        bending.fold(0.0, f64::max)
    }

    fn best_free_fit(&self) -> Result<Fitted, GeometryError> {
        self.best_fit_of(self.lens_freedom()).or_else(|error| match self.known_lens {
            // The raised points may not determine the lens, for example if all lie on a line below it.
            KnownLens::Guess(_) if self.lens_freedom() == [true; 3] => self.best_fit_of([false; 3]),
            _ => Err(error),
        })
    }

    fn physical_fit(&self, form: &LensForm) -> Option<Fitted> {
        let is_told = !matches!(self.known_lens, KnownLens::Guess(_)) || self.raised() >= 2;
        if form.model == DistortionModel::Polynomial && !is_told {
            // Its focal length and its height cannot be distinguished.
            return None;
        }
        let camera = physical::fit(self, form).ok()?;
        let model = camera.model(form, self).ok()?;
        let scales = self.scales();
        let distortion = camera.distortion(form, &scales);
        if !self.is_usable(&model, &distortion) {
            return None;
        }
        let Physical { minimum, expectations, distortion_parameters, lens_columns, .. } = &camera;
        let lens_source = match self.known_lens {
            KnownLens::Guess(_) if self.raised() >= 2 => LensSource::Points,
            KnownLens::Guess(_) => LensSource::Perspective,
            KnownLens::HeightMm(_) if self.raised() >= 1 => LensSource::HeightAndPoints,
            KnownLens::HeightMm(_) => LensSource::HeightAndPerspective,
            KnownLens::Position(_) => LensSource::Given,
        };
        let evidence =
            Evidence { minimum, expectations: *expectations, equations: self.equations() };
        let sigma = evidence.variance_px2().sqrt().max(MARKING_SIGMA_PX) * scales.field_scale_mm;
        let covariance = minimum.covariance.as_ref()?;
        let lens_sigma_mm = lens_columns
            .map(|column| column.map_or(0.0, |column| sigma * covariance[(column, column)].sqrt()));
        if lens_sigma_mm[2] > MAX_LENS_SIGMA * camera.lens_mm(&scales).z {
            return None;
        }
        Some(Fitted {
            sum_of_squares: self.sum_of_squares(&model),
            model,
            lens_mm: camera.lens_mm(&scales).into(),
            distortion,
            lens_source,
            lens_sigma_mm,
            surplus: evidence.surplus(),
            distortion_parameters: *distortion_parameters,
            variance_px2: evidence.variance_px2(),
            criterion: evidence.criterion(TELLING_SIGMA_PX) + camera.occam,
            criterion_by_hand: evidence.criterion(BY_HAND_SIGMA_PX) + camera.occam,
            is_physical: true,
        })
    }

    /// Number of equations from points and edges.
    pub fn equations(&self) -> usize {
        2 * self.marks.len() + self.edges.len()
    }

    /// Residuals of marks and edges for a camera.
    pub fn errors(&self, camera: &QuickCamera) -> Vec<f64> {
        let mut errors = Vec::with_capacity(self.equations());
        for mark in self.marks {
            let error = camera.image(mark.field_mm) - Vector2::from(mark.image_px);
            errors.extend([error.x, error.y].map(|error| self.mark_weight * error));
        }
        for edge in self.edges {
            let [x, y] = edge.field_mm;
            let error = camera.image([x, y, 0.0]) - Vector2::from(edge.image_px);
            errors.push(error.dot(&Vector2::from(edge.normal)));
        }
        errors
    }

    fn sum_of_squares(&self, model: &CameraModel) -> f64 {
        let square = |mark: &Mark| {
            let [x, y, height] = mark.field_mm;
            let seen = model.image_from_field(FieldPoint::new(x, y), height);
            (seen.x_px - mark.image_px[0]).powi(2) + (seen.y_px - mark.image_px[1]).powi(2)
        };
        self.marks.iter().map(square).sum()
    }

    /// Approximate root mean square residual of the best fit, from a quick look through a straight lens
    /// and a few bent ones.
    pub fn rough_rms_px(&self) -> [f64; 2] {
        [self.start(), self.bent_start()]
            .map(|start| start.map_or(f64::INFINITY, |start| self.rms_px(&start)))
    }

    fn rms_px(&self, camera: &Parameters) -> f64 {
        let errors = self.errors(&camera.through(&self.scales(), self.picture_px));
        let squares = errors.iter().map(|error| error * error).sum::<f64>();
        (2.0 * squares / self.equations() as f64).sqrt()
    }

    fn best_fit_of(&self, lens: [bool; 3]) -> Result<Fitted, GeometryError> {
        let start = self.start()?;
        let mut best = self.fit_from(start, start, lens, 0);
        let mut bent = None;
        for parameters in [1, 2, 4].into_iter().filter(|&count| count <= self.max_distortion) {
            let from = best.as_ref().map_or(start, |&(camera, _)| camera);
            let straight = self.fit_from(from, start, lens, parameters);
            let is_good =
                |(camera, _): &(Parameters, Minimum)| self.rms_px(camera) < TOO_LARGE_RMS_PX;
            let fit = if straight.as_ref().is_ok_and(is_good) {
                straight
            } else {
                // A strongly bent lens is not found from a straight start.
                let bent = bent.get_or_insert_with(|| self.bent_start()).clone();
                better(straight, bent.and_then(|bent| self.fit_from(bent, bent, lens, parameters)))
            };
            let Ok((camera, minimum)) = fit else { break };
            let is_better = best.as_ref().map_or(true, |(_, few)| self.is_worth_it(few, &minimum));
            let is_usable = camera
                .model(&self.scales(), self.picture_px, self.marks)
                .is_ok_and(|model| self.is_usable(&model, &camera.distortion(&self.scales())));
            if is_better && is_usable {
                best = Ok((camera, minimum));
            } else if parameters > 1 && lens != [false; 3] && best.as_ref().is_ok_and(is_good) {
                // One more parameter may need the next to show its benefit. The exception is the centre
                // where the lens position is free: each can stand for the other.
                break;
            }
        }
        self.finished(self.in_perspective(best?, lens), lens)
    }

    /// Moves a lens of known height, without raised points, to where the perspective of the fitted
    /// camera puts it, and fits again. The first fit used the perspective of an undistorted picture
    /// around its middle; an axis 13 px off the middle moves the lens by 50 mm.
    fn in_perspective(&self, fit: (Parameters, Minimum), lens: [bool; 3]) -> (Parameters, Minimum) {
        let KnownLens::HeightMm(height) = self.known_lens else { return fit };
        if lens != [false; 3] {
            return fit;
        }
        let (scales, (camera, minimum)) = (self.scales(), &fit);
        let axis_px = Vector2::from(camera.distortion(&scales).center_px);
        let Some([x, y]) = lens_above(&camera.ray_from_floor(&scales), axis_px, height) else {
            return fit;
        };
        let moved = camera.with_lens(&scales, Vector3::new(x, y, height));
        self.fit(moved, lens, minimum.parameters.len() - HOMOGRAPHY).unwrap_or(fit)
    }

    /// The better of two fits: one from `given`, and one from `start` that first holds the lens. Raised
    /// points determine a lens high above them only weakly, and distortion not yet modelled may send it
    /// far away, from where it does not return.
    fn fit_from(
        &self,
        given: Parameters,
        start: Parameters,
        lens: [bool; 3],
        distortion: usize,
    ) -> Result<(Parameters, Minimum), GeometryError> {
        let held = self.fit(start, [false; 3], distortion);
        let held = held.and_then(|(camera, _)| self.fit(camera, lens, distortion));
        better(self.fit(given, lens, distortion), held)
    }

    /// Lens coordinates that the points can determine.
    fn lens_freedom(&self) -> [bool; 3] {
        let raised = self.raised();
        match self.known_lens {
            KnownLens::Guess(_) if raised >= 2 && 2 * self.marks.len() >= HOMOGRAPHY + 3 => {
                [true; 3]
            }
            KnownLens::HeightMm(_) if raised >= 1 && 2 * self.marks.len() >= HOMOGRAPHY + 2 => {
                [true, true, false]
            }
            _ => [false; 3],
        }
    }

    /// Number of points not at the height of most points.
    fn raised(&self) -> usize {
        let at = |height: f64| {
            let near = |mark: &&Mark| (mark.field_mm[2] - height).abs() <= RAISED_MM;
            self.marks.iter().filter(near).count()
        };
        let level = self.marks.iter().map(|mark| at(mark.field_mm[2])).max().unwrap_or(0);
        self.marks.len() - level
    }

    pub fn scales(&self) -> Scales {
        let count = self.marks.len() as f64;
        let places =
            || self.marks.iter().map(|mark| Vector2::new(mark.field_mm[0], mark.field_mm[1]));
        let center = places().sum::<Vector2<f64>>() / count;
        let spread = places().map(|place| (place - center).norm()).sum::<f64>() / count;
        let [width, height] = self.picture_px.map(f64::from);
        Scales {
            field_center_mm: center,
            field_scale_mm: spread.max(1.0),
            image_center_px: Vector2::new((width - 1.0) / 2.0, (height - 1.0) / 2.0),
            half_diagonal_px: width.hypot(height) / 2.0,
        }
    }

    /// Start of the fit: the homography of the direct linear transform, the lens at its assumed
    /// position, no distortion.
    fn start(&self) -> Result<Parameters, GeometryError> {
        self.start_with(0.0)
    }

    /// Start with the best of a few barrel distortions.
    fn bent_start(&self) -> Result<Parameters, GeometryError> {
        let starts = BARRELS.into_iter().filter_map(|k1| self.start_with(k1).ok());
        let rated = starts.map(|start| (self.rms_px(&start), start));
        let best = rated.min_by(|a, b| a.0.total_cmp(&b.0));
        best.map(|(_, start)| start).ok_or(GeometryError::Degenerate)
    }

    fn start_with(&self, k1: f64) -> Result<Parameters, GeometryError> {
        let scales = self.scales();
        let mut camera = Parameters([0.0; COUNT]);
        camera.0[DISTORTION] = k1;
        let (homography, lens) = self.homography_through(&camera.distortion(&scales))?;
        Ok(Parameters::new(&scales, &homography, lens, k1))
    }

    /// The homography from the floor to the rays of a lens with this distortion, and the lens position
    /// assumed with it.
    pub fn homography_through(
        &self,
        distortion: &DistortionConfig,
    ) -> Result<(Matrix3<f64>, Vector3<f64>), GeometryError> {
        let distorting = Lens::new(distortion, self.picture_px);
        let ray = |mark: &Mark| {
            let pixel = Vector2::from(mark.image_px);
            let [ray] = distorting.rays_from_image([pixel]);
            let is_seen = ray.z > MIN_DEPTH && distorting.reaches_pixel(pixel);
            is_seen.then(|| [ray.x / ray.z, ray.y / ray.z])
        };
        let rays = self.marks.iter().map(ray).collect::<Option<Vec<_>>>();
        let rays = rays.ok_or(GeometryError::Degenerate)?;
        let scales = self.scales();
        let mut lens = match self.known_lens {
            KnownLens::Guess(lens) | KnownLens::Position(lens) => Vector3::from(lens),
            KnownLens::HeightMm(height) => {
                Vector3::new(scales.field_center_mm.x, scales.field_center_mm.y, height)
            }
        };
        let mut homography = homography(&self.shadows(lens, &rays))?;
        if let KnownLens::HeightMm(height) = self.known_lens {
            // The lens position depends slightly on the homography, and the homography on the lens
            // position.
            for _ in 0..3 {
                if let Some([x, y]) = lens_above(&homography, scales.image_center_px, height) {
                    lens = Vector3::new(x, y, height);
                    homography = self::homography(&self.shadows(lens, &rays))?;
                }
            }
        }
        Ok((homography, lens))
    }

    /// The floor points that hide or lie below the marked points as seen from the lens, with their
    /// rays.
    fn shadows(&self, lens: Vector3<f64>, rays: &[[f64; 2]]) -> Vec<PointPair> {
        let shadow = |(mark, &image_px): (&Mark, &[f64; 2])| {
            let [x, y, height] = mark.field_mm;
            let lift = height / lens.z;
            let field_mm = [(x - lens.x * lift) / (1.0 - lift), (y - lens.y * lift) / (1.0 - lift)];
            PointPair { field_mm, image_px }
        };
        self.marks.iter().zip(rays).map(shadow).collect()
    }

    /// Least squares over the homography, the free lens coordinates and this many distortion
    /// parameters.
    fn fit(
        &self,
        start: Parameters,
        lens: [bool; 3],
        distortion: usize,
    ) -> Result<(Parameters, Minimum), GeometryError> {
        let scales = self.scales();
        let is_free = |index: usize| match index {
            LENS..DISTORTION => lens[index - LENS],
            DISTORTION.. => index - DISTORTION < distortion,
            _ => true,
        };
        let free: Vec<usize> = (0..COUNT).filter(|&index| is_free(index)).collect();
        if free.len() > self.equations() {
            return Err(GeometryError::Degenerate);
        }
        let with = |values: &DVector<f64>| {
            let mut camera = start;
            free.iter().zip(values.iter()).for_each(|(&index, &value)| camera.0[index] = value);
            camera
        };
        let residuals = |values: &DVector<f64>| {
            let camera = with(values).through(&scales, self.picture_px);
            DVector::from_vec(self.errors(&camera))
        };
        let start = DVector::from_iterator(free.len(), free.iter().map(|&index| start.0[index]));
        let minimum = minimise(start, residuals).ok_or(GeometryError::Degenerate)?;
        if minimum.covariance.is_none() {
            return Err(GeometryError::Degenerate);
        }
        Ok((with(&minimum.parameters), minimum))
    }

    fn surplus(&self, minimum: &Minimum) -> usize {
        self.equations() - minimum.parameters.len()
    }

    /// Whether additional parameters improve the fit significantly: an F test at about 1 %.
    fn is_worth_it(&self, few: &Minimum, many: &Minimum) -> bool {
        let surplus = self.surplus(many) as f64;
        let rms = (2.0 * few.sum_of_squares / self.equations() as f64).sqrt();
        if surplus < 3.0 || rms < NEGLIGIBLE_RMS_PX {
            return false;
        }
        let added = (many.parameters.len() - few.parameters.len()) as f64;
        let gain = (few.sum_of_squares - many.sum_of_squares) / added;
        // 34 for one added parameter and a surplus of three; 6.6 for a large surplus.
        let threshold = 6.6 * (1.0 + 12.0 / surplus);
        gain > threshold * many.sum_of_squares / surplus
    }

    /// Whether the lens polynomial is valid at all marks and on the visible part of the pitch.
    fn is_usable(&self, model: &CameraModel, distortion: &DistortionConfig) -> bool {
        let scales = self.scales();
        let reach = 1.0
            + (Vector2::from(distortion.center_px) - scales.image_center_px).norm()
                / scales.half_diagonal_px;
        let marks = self.marks.iter().map(|mark| mark.field_mm);
        let outline = self.field.outline().map(|[x, y]| [x, y, 0.0]);
        let outline = outline.filter(|&[x, y, _]| {
            let seen = model.image_from_field(FieldPoint::new(x, y), 0.0);
            let [width, height] = self.picture_px.map(f64::from);
            (0.0..width).contains(&seen.x_px) && (0.0..height).contains(&seen.y_px)
        });
        let is_within = |[x, y, z]: [f64; 3]| model.is_within_lens(FieldPoint::new(x, y), z);
        reach < 1.5 && marks.chain(outline).all(is_within)
    }

    fn finished(
        &self,
        (camera, minimum): (Parameters, Minimum),
        free: [bool; 3],
    ) -> Result<Fitted, GeometryError> {
        let scales = self.scales();
        let evidence = Evidence { minimum: &minimum, expectations: 0, equations: self.equations() };
        let sigma = evidence.variance_px2().sqrt().max(MARKING_SIGMA_PX) * scales.field_scale_mm;
        let lens = camera.lens_mm(&scales);
        let mut lens_sigma_mm = [0.0; 3];
        let mut column = HOMOGRAPHY;
        for (axis, lens_sigma) in lens_sigma_mm.iter_mut().enumerate() {
            if free[axis] {
                let variance =
                    minimum.covariance.as_ref().map_or(f64::INFINITY, |c| c[(column, column)]);
                *lens_sigma = sigma * variance.sqrt();
                column += 1;
            }
        }
        let highest = self.marks.iter().fold(0.0f64, |top, mark| top.max(mark.field_mm[2]));
        if free[2] && (lens.z <= highest || lens_sigma_mm[2] > MAX_LENS_SIGMA * lens.z) {
            return Err(GeometryError::Degenerate);
        }
        let lens_source = match (self.known_lens, free) {
            (KnownLens::Guess(_), [true, ..]) => LensSource::Points,
            (KnownLens::Guess(_), _) => LensSource::Guessed,
            (KnownLens::HeightMm(_), [true, ..]) => LensSource::HeightAndPoints,
            (KnownLens::HeightMm(_), _) => LensSource::HeightAndPerspective,
            (KnownLens::Position(_), _) => LensSource::Given,
        };
        let model = camera.model(&scales, self.picture_px, self.marks)?;
        let fixed = HOMOGRAPHY + free.iter().filter(|&&free| free).count();
        Ok(Fitted {
            lens_mm: lens.into(),
            distortion: camera.distortion(&scales),
            lens_source,
            lens_sigma_mm,
            surplus: evidence.surplus(),
            distortion_parameters: minimum.parameters.len() - fixed,
            sum_of_squares: self.sum_of_squares(&model),
            model,
            variance_px2: evidence.variance_px2(),
            criterion: evidence.criterion(TELLING_SIGMA_PX)
                + FREEDOM * (NOT_PHYSICAL + minimum.parameters.len() - fixed) as f64,
            criterion_by_hand: evidence.criterion(BY_HAND_SIGMA_PX),
            is_physical: false,
        })
    }
}

impl Fitted {
    /// Root mean square distance of this many points.
    pub fn rms_px(&self, points: usize) -> f64 {
        (self.sum_of_squares / points.max(1) as f64).sqrt()
    }

    /// Variance of a marked coordinate, from the residuals; `None` without surplus equations.
    pub fn variance_px2(&self) -> Option<f64> {
        (self.surplus > 0).then_some(self.variance_px2)
    }
}

/// The better of two fits.
fn better(
    a: Result<(Parameters, Minimum), GeometryError>,
    b: Result<(Parameters, Minimum), GeometryError>,
) -> Result<(Parameters, Minimum), GeometryError> {
    match (a, b) {
        (Ok(a), Ok(b)) => Ok(if a.1.sum_of_squares <= b.1.sum_of_squares { a } else { b }),
        (a, b) => a.or(b),
    }
}

/// Statistics of a minimum.
struct Evidence<'a> {
    minimum: &'a Minimum,
    /// Prior equations besides those of the points.
    expectations: usize,
    equations: usize,
}

impl Evidence<'_> {
    fn surplus(&self) -> usize {
        self.equations + self.expectations - self.minimum.parameters.len()
    }

    fn variance_px2(&self) -> f64 {
        match self.surplus() {
            0 => 0.0,
            surplus => self.minimum.sum_of_squares / surplus as f64,
        }
    }

    /// Corrected Akaike criterion (see the module). A parameter with a prior does not count as free.
    fn criterion(&self, telling_sigma_px: f64) -> f64 {
        let count = self.equations as f64;
        let free = self.minimum.parameters.len() as f64 - self.expectations as f64;
        let left = count - free - 1.0;
        if left <= 0.0 {
            return f64::INFINITY;
        }
        let variance = self.minimum.sum_of_squares / count + telling_sigma_px.powi(2);
        count * variance.ln() + 2.0 * free + 2.0 * free * (free + 1.0) / left
    }
}

/// For each marked point, whether the picture has the orientation that a camera above the pitch sees: a
/// left turn on the floor is a right turn in the picture's rows and columns, unless the picture is
/// mirrored.
pub(super) fn senses(model: &CameraModel, task: &Task) -> Vec<bool> {
    let sense = |mark: &Mark| {
        let [x, y, _] = mark.field_mm;
        let at = |dx: f64, dy: f64| model.image_from_field(FieldPoint::new(x + dx, y + dy), 0.0);
        let (here, along, across) = (at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0));
        let turn = (along.x_px - here.x_px) * (across.y_px - here.y_px)
            - (along.y_px - here.y_px) * (across.x_px - here.x_px);
        if task.is_mirrored { turn > 0.0 } else { turn < 0.0 }
    };
    task.marks.iter().map(sense).collect()
}
