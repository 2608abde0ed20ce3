//! Physical camera model: square pixels, and a lens axis through the centre of the distortion.
//!
//! It has far fewer parameters than a homography with separate distortion: position, rotation, focal
//! length and lens terms. With eight points marked around a pitch this decides whether the camera is
//! determined. Prior knowledge is added as Gaussian priors: an axis near the middle of the picture, and
//! terms near those of textbook projections. A prior of standard deviation σ on a value v is one more
//! residual, v/σ in units of the marking error, beside those of the points.
//!
//! The fit starts from the best of several focal lengths and first terms: for each, the marks become
//! rays, the rays give a homography, and its columns give rotation and position (Zhang, *A flexible new
//! technique for camera calibration*, section 3.1).

use super::fit::Task;
use super::least_squares::{Minimum, minimise};
use super::parameters::Scales;
use super::{KnownLens, Mark};
use config::{DistortionConfig, DistortionModel};
use geometry::lens::Lens;
use geometry::{CameraModel, GeometryError};
use nalgebra::{DVector, Matrix3, Rotation3, Vector2, Vector3};

/// Lens model with its free parameters and the values of its fixed ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LensForm {
    pub model: DistortionModel,
    /// Polynomial terms that are not fitted.
    terms: [f64; 4],
    /// Number of fitted terms.
    free_terms: usize,
    /// Whether the centre is fitted.
    is_center_free: bool,
}

impl LensForm {
    /// All forms tried: textbook projections, a fisheye near them, and ordinary lenses; each with fixed
    /// and with free centre.
    pub fn all() -> impl Iterator<Item = Self> {
        let textbook = |terms| Self {
            model: DistortionModel::Fisheye,
            terms,
            free_terms: 0,
            is_center_free: false,
        };
        let near = Self { free_terms: 2, ..textbook([0.0; 4]) };
        let barrel = Self { model: DistortionModel::Polynomial, free_terms: 1, ..near };
        let forms = [
            textbook(EQUIDISTANT),
            textbook(STEREOGRAPHIC),
            textbook(EQUAL_AREA),
            near,
            barrel,
            Self { free_terms: 2, ..barrel },
        ];
        forms.into_iter().flat_map(|form| [form, Self { is_center_free: true, ..form }])
    }

    fn parameters(&self) -> usize {
        1 + self.free_terms + if self.is_center_free { 2 } else { 0 }
    }

    /// Standard deviations of the first two terms' priors.
    fn term_sigmas(&self) -> [f64; 2] {
        match self.model {
            // The textbook projections have first terms 0, 1/12 and −1/24, and second terms 0, 1/120
            // and 1/1920.
            DistortionModel::Fisheye => [0.08, 0.02],
            DistortionModel::Polynomial => [0.3, 0.05],
        }
    }
}

/// Equidistant projection, r = θ.
const EQUIDISTANT: [f64; 4] = [0.0; 4];
/// Stereographic projection, r = 2 tan(θ/2).
const STEREOGRAPHIC: [f64; 4] = [1.0 / 12.0, 1.0 / 120.0, 17.0 / 20_160.0, 31.0 / 362_880.0];
/// Equal-area projection, r = 2 sin(θ/2).
const EQUAL_AREA: [f64; 4] = [-1.0 / 24.0, 1.0 / 1920.0, -1.0 / 322_560.0, 1.0 / 92_897_280.0];

/// Assumed standard deviation of a mark.
const SIGMA_PX: f64 = 0.3;
/// Standard deviation of the centre from the picture's middle, in half diagonals.
const CENTER_SIGMA: f64 = 0.03;
/// Focal lengths at which to start, in half diagonals.
const FOCALS: [f64; 7] = [0.4, 0.55, 0.75, 1.0, 1.4, 2.0, 3.0];
/// First polynomial terms at which to start.
const BARRELS: [f64; 6] = [0.0, -0.06, -0.12, -0.18, -0.24, -0.3];

/// A fitted camera.
#[derive(Debug, Clone)]
pub(super) struct Physical {
    camera: Camera,
    pub minimum: Minimum,
    /// Number of prior equations.
    pub expectations: usize,
    /// Occam term: how much better than their priors the points determine the parameters, as the
    /// logarithm of the ratio of the variances.
    pub occam: f64,
    pub distortion_parameters: usize,
    /// Column of the covariance for each fitted lens coordinate.
    pub lens_columns: [Option<usize>; 3],
}

/// Camera parameters; lengths in the floor's scale and in half diagonals.
#[derive(Debug, Clone, Copy)]
struct Camera {
    /// Rotation from field axes to camera axes (right, down, forward), with a reflection if the picture
    /// is mirrored.
    turn: Matrix3<f64>,
    lens: Vector3<f64>,
    focal: f64,
    terms: [f64; 4],
    center: Vector2<f64>,
}

impl Physical {
    pub fn lens_mm(&self, scales: &Scales) -> Vector3<f64> {
        self.camera.lens_mm(scales)
    }

    pub fn distortion(&self, form: &LensForm, scales: &Scales) -> DistortionConfig {
        self.camera.distortion(form.model, scales)
    }

    pub fn model(&self, form: &LensForm, task: &Task) -> Result<CameraModel, GeometryError> {
        let scales = task.scales();
        let floor = task.marks.iter().map(|mark| [mark.field_mm[0], mark.field_mm[1]]);
        CameraModel::from_homography(
            self.camera.ray_from_floor(&scales),
            self.lens_mm(&scales).into(),
            &self.distortion(form, &scales),
            task.picture_px,
            floor,
        )
    }
}

/// Fits a camera of this form. The task says which lens coordinates are known.
pub(super) fn fit(task: &Task, form: &LensForm) -> Result<Physical, GeometryError> {
    let scales = task.scales();
    let start = start(task, form)?;
    let is_lens_free = match task.known_lens {
        KnownLens::Guess(_) => [true; 3],
        KnownLens::HeightMm(_) => [true, true, false],
        KnownLens::Position(_) => [false; 3],
    };
    let with = |values: &DVector<f64>| {
        let mut values = values.iter().copied();
        let mut next = || values.next().unwrap_or(0.0);
        let mut camera = start;
        camera.turn =
            Rotation3::new(Vector3::new(next(), next(), next())).into_inner() * start.turn;
        camera.focal = start.focal * next().exp();
        for axis in (0..3).filter(|&axis| is_lens_free[axis]) {
            camera.lens[axis] += next();
        }
        for term in camera.terms.iter_mut().take(form.free_terms) {
            *term += next();
        }
        if form.is_center_free {
            camera.center += Vector2::new(next(), next());
        }
        camera
    };
    let expectations = form.free_terms + if form.is_center_free { 2 } else { 0 };
    let residuals = |values: &DVector<f64>| {
        let camera = with(values);
        let seen = camera.through(form.model, &scales, task.picture_px);
        let mut errors = task.errors(&seen);
        let terms = camera.terms.into_iter().zip(form.term_sigmas()).take(form.free_terms);
        let unexpected = terms.map(|(term, sigma)| term / sigma);
        let off_center = camera.center.iter().map(|offset| offset / CENTER_SIGMA);
        let unexpected = unexpected.chain(off_center.take(if form.is_center_free { 2 } else { 0 }));
        errors.extend(unexpected.map(|sigmas| SIGMA_PX * sigmas));
        DVector::from_vec(errors)
    };
    let in_place = is_lens_free.iter().filter(|&&free| free).count();
    let free = 3 + in_place + form.parameters();
    if free > task.equations() + expectations {
        return Err(GeometryError::Degenerate);
    }
    let minimum = minimise(DVector::zeros(free), residuals).ok_or(GeometryError::Degenerate)?;
    let expected = (free - expectations)..free;
    let sigmas = form.term_sigmas().into_iter().take(form.free_terms).chain([CENTER_SIGMA; 2]);
    let before = sigmas.take(expectations).map(|sigma| 2.0 * sigma.ln()).sum::<f64>();
    let covariance = minimum.covariance.as_ref().ok_or(GeometryError::Degenerate)?;
    let block = covariance.view((expected.start, expected.start), (expectations, expectations));
    let after = (block * (SIGMA_PX * SIGMA_PX)).determinant().ln();
    let occam = if expectations == 0 { 0.0 } else { before - after };
    let mut column = 3 + 1;
    let lens_columns = is_lens_free.map(|free| {
        column += usize::from(free);
        free.then_some(column - 1)
    });
    Ok(Physical {
        camera: with(&minimum.parameters),
        minimum,
        expectations,
        occam,
        distortion_parameters: form.parameters(),
        lens_columns,
    })
}

/// The best of several start cameras.
fn start(task: &Task, form: &LensForm) -> Result<Camera, GeometryError> {
    let scales = task.scales();
    let firsts: &[f64] = match form.model {
        DistortionModel::Fisheye => &[form.terms[0]],
        DistortionModel::Polynomial => &BARRELS,
    };
    let mut best: Option<(f64, Camera)> = None;
    for &first in firsts {
        for focal in FOCALS {
            let [_, rest @ ..] = form.terms;
            let lens = Camera {
                turn: Matrix3::identity(),
                lens: Vector3::zeros(),
                focal,
                terms: [first, rest[0], rest[1], rest[2]],
                center: Vector2::zeros(),
            };
            let distortion = lens.distortion(form.model, &scales);
            let Ok((homography, _)) = task.homography_through(&distortion) else { continue };
            let Some(camera) = lens.placed(&scales, &homography, task) else { continue };
            let seen = camera.through(form.model, &scales, task.picture_px);
            let squares = task.errors(&seen).iter().map(|error| error * error).sum::<f64>();
            if squares.is_finite() && best.is_none_or(|(least, _)| squares < least) {
                best = Some((squares, camera));
            }
        }
    }
    best.map(|(_, camera)| camera).ok_or(GeometryError::Degenerate)
}

impl Camera {
    /// The same lens, placed by a homography from the floor to its rays (Zhang, section 3.1).
    fn placed(self, scales: &Scales, ray_from_floor: &Matrix3<f64>, task: &Task) -> Option<Self> {
        let normal = self.intrinsics().try_inverse()?
            * scales.normal_from_image()
            * ray_from_floor
            * scales.floor_from_normal();
        let depth = |mark: &Mark| {
            let [x, y, _] = mark.field_mm;
            let place = (Vector2::new(x, y) - scales.field_center_mm) / scales.field_scale_mm;
            (normal * place.push(1.0)).z
        };
        let is_behind = task.marks.iter().map(depth).sum::<f64>() < 0.0;
        let normal = if is_behind { -normal } else { normal };
        let [along, across, origin] = [0, 1, 2].map(|index| normal.column(index).into_owned());
        let scale = (along.norm() * across.norm()).sqrt();
        let (along, across, origin) = (along.normalize(), across.normalize(), origin / scale);
        // The nearest orthogonal pair: both axes are turned by the same angle.
        let (middle, beside) = ((along + across).normalize(), (along - across).normalize());
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let (along, across) = ((middle + beside) * half, (middle - beside) * half);
        let up = along.cross(&across);
        let up = if up.dot(&origin) > 0.0 { -up } else { up };
        let turn = Matrix3::from_columns(&[along, across, up]);
        let mut lens = -(turn.transpose() * origin);
        match task.known_lens {
            KnownLens::Guess(_) => {}
            KnownLens::HeightMm(height) => lens.z = height / scales.field_scale_mm,
            KnownLens::Position(lens_mm) => lens = scales.normal_lens(lens_mm),
        }
        let is_usable = lens.iter().chain(turn.iter()).all(|value| value.is_finite());
        is_usable.then_some(Self { turn, lens, ..self })
    }

    fn intrinsics(&self) -> Matrix3<f64> {
        let (focal, center) = (self.focal, self.center);
        Matrix3::new(focal, 0.0, center.x, 0.0, focal, center.y, 0.0, 0.0, 1.0)
    }

    fn lens_mm(&self, scales: &Scales) -> Vector3<f64> {
        let lens = self.lens * scales.field_scale_mm;
        Vector3::new(scales.field_center_mm.x + lens.x, scales.field_center_mm.y + lens.y, lens.z)
    }

    fn distortion(&self, model: DistortionModel, scales: &Scales) -> DistortionConfig {
        let center = scales.image_center_px + self.center * scales.half_diagonal_px;
        let [k1, k2, k3, k4] = self.terms;
        DistortionConfig {
            model,
            focal_px: self.focal * scales.half_diagonal_px,
            k1,
            k2,
            k3,
            k4,
            center_px: center.into(),
        }
    }

    fn ray_from_floor(&self, scales: &Scales) -> Matrix3<f64> {
        let [along, across] = [0, 1].map(|index| self.turn.column(index).into_owned());
        let origin = -(self.turn * self.lens);
        let axes = Matrix3::from_columns(&[along, across, origin]);
        scales.image_from_normal() * self.intrinsics() * axes * scales.normal_from_floor()
    }

    fn through(
        &self,
        model: DistortionModel,
        scales: &Scales,
        picture_px: [u32; 2],
    ) -> QuickCamera {
        QuickCamera {
            ray_from_floor: self.ray_from_floor(scales),
            position: self.lens_mm(scales),
            lens: Lens::new(&self.distortion(model, scales), picture_px),
        }
    }
}

/// Like [`CameraModel`], but only forward, without inverses.
pub(super) struct QuickCamera {
    pub ray_from_floor: Matrix3<f64>,
    pub position: Vector3<f64>,
    pub lens: Lens,
}

impl QuickCamera {
    /// Pixel of a point of the pitch with its height.
    pub fn image(&self, [x, y, height]: [f64; 3]) -> Vector2<f64> {
        let lift = height / self.position.z;
        let shadow = (Vector2::new(x, y) - self.position.xy() * lift) / (1.0 - lift);
        self.lens.image_from_ray(&(self.ray_from_floor * shadow.push(1.0)))
    }
}
