//! The fit itself: which numbers are free, and what they are.

use super::least_squares::{Minimum, minimise};
use super::{KnownLens, LensSource, Mark};
use crate::config::{DistortionConfig, GeometryConfig, PointPair};
use crate::geometry::{CameraModel, FieldPoint, GeometryError, homography};
use nalgebra::{DVector, Matrix3, Vector2, Vector3};

/// Points to fit a camera to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Task<'a> {
    pub marks: &'a [Mark],
    pub known_lens: KnownLens,
    pub picture_px: [u32; 2],
    /// Parameters of distortion that may be fitted at most.
    pub max_distortion: usize,
}

/// The camera that fits.
#[derive(Debug, Clone)]
pub(super) struct Fitted {
    pub model: CameraModel,
    pub lens_mm: [f64; 3],
    pub distortion: DistortionConfig,
    pub lens_source: LensSource,
    pub lens_sigma_mm: [f64; 3],
    pub surplus: usize,
    pub distortion_parameters: usize,
    sum_of_squares: f64,
}

/// Parameters of distortion: k1, k2 and the centre.
pub(super) const MAX_DISTORTION: usize = 4;

/// The numbers of a camera, scaled to order one: the homography from the floor to the undistorted
/// picture, both normalised; the lens in units of the floor's scale; k1, k2 and the distortion's
/// centre.
#[derive(Debug, Clone, Copy)]
struct Numbers([f64; COUNT]);

const COUNT: usize = HOMOGRAPHY + 3 + MAX_DISTORTION;
const HOMOGRAPHY: usize = 8;
const LENS: usize = HOMOGRAPHY;
const DISTORTION: usize = LENS + 3;

/// Points of the floor and pixels, moved and scaled to order one.
#[derive(Debug, Clone, Copy)]
struct Scales {
    field_center_mm: Vector2<f64>,
    field_scale_mm: f64,
    image_center_px: Vector2<f64>,
    half_diagonal_px: f64,
}

/// A point further than this from the height most points have is raised.
const RAISED_MM: f64 = 1.0;
/// A marked point is hardly ever better than this.
const MARKING_SIGMA_PX: f64 = 0.2;
/// A lens is told by raised points if they leave its height open by no more than this share.
const MAX_LENS_SIGMA: f64 = 0.25;
/// Without this error left there is no distortion to look for.
const NEGLIGIBLE_RMS_PX: f64 = 0.01;

impl Task<'_> {
    /// The camera with as many free numbers as the points can tell.
    pub fn best_fit(&self) -> Result<Fitted, GeometryError> {
        self.best_fit_of(self.lens_freedom()).or_else(|error| match self.known_lens {
            // Raised points that tell nothing of the lens: all in a line below it, say.
            KnownLens::Guess(_) if self.lens_freedom() == [true; 3] => self.best_fit_of([false; 3]),
            _ => Err(error),
        })
    }

    /// About how well the points fit at best, root mean square: a quick look.
    pub fn rough_rms_px(&self) -> f64 {
        let Ok(start) = self.start() else { return f64::INFINITY };
        let scales = self.scales();
        let squares = self.marks.iter().map(|mark| {
            (start.image(&scales, mark.field_mm) - Vector2::from(mark.image_px)).norm_squared()
        });
        (squares.sum::<f64>() / self.marks.len() as f64).sqrt()
    }

    fn best_fit_of(&self, lens: [bool; 3]) -> Result<Fitted, GeometryError> {
        let start = self.start()?;
        let mut best = self.fit_from(start, start, lens, 0);
        for parameters in [1, 2, 4].into_iter().filter(|&count| count <= self.max_distortion) {
            let from = best.as_ref().map_or(start, |&(numbers, _)| numbers);
            let Ok((numbers, minimum)) = self.fit_from(from, start, lens, parameters) else {
                break;
            };
            let is_better = best.as_ref().map_or(true, |(_, few)| self.is_worth_it(few, &minimum));
            if !is_better || !self.is_usable(&numbers) {
                // One more number may need the next to show its worth, but not the centre.
                if parameters == 1 { continue } else { break }
            }
            best = Ok((numbers, minimum));
        }
        self.finished(best?, lens)
    }

    /// The better one of two fits: from what is given, and from where the lens is thought to be, where it
    /// is held at first. Raised points tell little of a lens that hangs high above them, and a distortion
    /// that is not allowed for yet may send it anywhere, from where it does not find back.
    fn fit_from(
        &self,
        given: Numbers,
        start: Numbers,
        lens: [bool; 3],
        distortion: usize,
    ) -> Result<(Numbers, Minimum), GeometryError> {
        let held = self.fit(start, [false; 3], distortion);
        let held = held.and_then(|(numbers, _)| self.fit(numbers, lens, distortion));
        match (self.fit(given, lens, distortion), held) {
            (Ok(a), Ok(b)) => Ok(if a.1.sum_of_squares <= b.1.sum_of_squares { a } else { b }),
            (a, b) => a.or(b),
        }
    }

    /// Which coordinates of the lens the points may decide.
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

    /// Points not at the height at which most are.
    fn raised(&self) -> usize {
        let at = |height: f64| {
            let near = |mark: &&Mark| (mark.field_mm[2] - height).abs() <= RAISED_MM;
            self.marks.iter().filter(near).count()
        };
        let level = self.marks.iter().map(|mark| at(mark.field_mm[2])).max().unwrap_or(0);
        self.marks.len() - level
    }

    fn scales(&self) -> Scales {
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

    /// The homography that the direct linear transform gives, with the lens where it is thought to
    /// be, and no distortion.
    fn start(&self) -> Result<Numbers, GeometryError> {
        let scales = self.scales();
        let mut lens = match self.known_lens {
            KnownLens::Guess(lens) | KnownLens::Position(lens) => Vector3::from(lens),
            KnownLens::HeightMm(height) => {
                Vector3::new(scales.field_center_mm.x, scales.field_center_mm.y, height)
            }
        };
        let mut homography = homography(&self.shadows(lens))?;
        if let KnownLens::HeightMm(height) = self.known_lens {
            // Where the lens is depends a little on the homography, and the other way round.
            for _ in 0..3 {
                if let Some([x, y]) = lens_above(&homography, scales.image_center_px, height) {
                    lens = Vector3::new(x, y, height);
                    homography = self::homography(&self.shadows(lens))?;
                }
            }
        }
        Ok(Numbers::new(&scales, &homography, lens))
    }

    /// Where the marked points are seen against the floor.
    fn shadows(&self, lens: Vector3<f64>) -> Vec<PointPair> {
        let shadow = |mark: &Mark| {
            let [x, y, height] = mark.field_mm;
            let lift = height / lens.z;
            let field_mm = [(x - lens.x * lift) / (1.0 - lift), (y - lens.y * lift) / (1.0 - lift)];
            PointPair { field_mm, image_px: mark.image_px }
        };
        self.marks.iter().map(shadow).collect()
    }

    /// The least sum of squares over the homography, the free coordinates of the lens, and so many
    /// parameters of distortion.
    fn fit(
        &self,
        start: Numbers,
        lens: [bool; 3],
        distortion: usize,
    ) -> Result<(Numbers, Minimum), GeometryError> {
        let scales = self.scales();
        let is_free = |index: usize| match index {
            LENS..DISTORTION => lens[index - LENS],
            DISTORTION.. => index - DISTORTION < distortion,
            _ => true,
        };
        let free: Vec<usize> = (0..COUNT).filter(|&index| is_free(index)).collect();
        if free.len() > 2 * self.marks.len() {
            return Err(GeometryError::Degenerate);
        }
        let with = |values: &DVector<f64>| {
            let mut numbers = start;
            free.iter().zip(values.iter()).for_each(|(&index, &value)| numbers.0[index] = value);
            numbers
        };
        let residuals = |values: &DVector<f64>| {
            let numbers = with(values);
            let errors = self.marks.iter().flat_map(|mark| {
                let seen = numbers.image(&scales, mark.field_mm);
                [seen.x - mark.image_px[0], seen.y - mark.image_px[1]]
            });
            DVector::from_iterator(2 * self.marks.len(), errors)
        };
        let start = DVector::from_iterator(free.len(), free.iter().map(|&index| start.0[index]));
        let minimum = minimise(start, residuals).ok_or(GeometryError::Degenerate)?;
        if minimum.covariance.is_none() {
            return Err(GeometryError::Degenerate);
        }
        Ok((with(&minimum.parameters), minimum))
    }

    fn surplus(&self, minimum: &Minimum) -> usize {
        2 * self.marks.len() - minimum.parameters.len()
    }

    /// Whether more numbers fit better by more than chance has it: an F test at about 1 %.
    fn is_worth_it(&self, few: &Minimum, many: &Minimum) -> bool {
        let surplus = self.surplus(many) as f64;
        let rms = (few.sum_of_squares / self.marks.len() as f64).sqrt();
        if surplus < 3.0 || rms < NEGLIGIBLE_RMS_PX {
            return false;
        }
        let added = (many.parameters.len() - few.parameters.len()) as f64;
        let gain = (few.sum_of_squares - many.sum_of_squares) / added;
        // 34 for one number and three more equations than unknowns, 6.6 for very many.
        let threshold = 6.6 * (1.0 + 12.0 / surplus);
        gain > threshold * many.sum_of_squares / surplus
    }

    /// Whether the lens folds nothing over that is to be seen.
    fn is_usable(&self, numbers: &Numbers) -> bool {
        let scales = self.scales();
        let (distortion, [width, height]) = (numbers.distortion(&scales), self.picture_px);
        let model = numbers.model(&scales, self.picture_px);
        let reach = 1.0
            + (Vector2::from(distortion.center_px) - scales.image_center_px).norm()
                / scales.half_diagonal_px;
        let geometry = GeometryConfig { distortion, ..GeometryConfig::default() };
        reach < 1.5 && model.is_ok() && CameraModel::new(&geometry, width, height).is_ok()
    }

    fn finished(
        &self,
        (numbers, minimum): (Numbers, Minimum),
        free: [bool; 3],
    ) -> Result<Fitted, GeometryError> {
        let scales = self.scales();
        let surplus = self.surplus(&minimum);
        let variance = if surplus == 0 { 0.0 } else { minimum.sum_of_squares / surplus as f64 };
        let sigma = variance.sqrt().max(MARKING_SIGMA_PX) * scales.field_scale_mm;
        let lens = numbers.lens_mm(&scales);
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
        let fixed = HOMOGRAPHY + free.iter().filter(|&&free| free).count();
        Ok(Fitted {
            model: numbers.model(&scales, self.picture_px)?,
            lens_mm: lens.into(),
            distortion: numbers.distortion(&scales),
            lens_source,
            lens_sigma_mm,
            surplus,
            distortion_parameters: minimum.parameters.len() - fixed,
            sum_of_squares: minimum.sum_of_squares,
        })
    }
}

impl Fitted {
    /// Root mean square distance of so many points.
    pub fn rms_px(&self, points: usize) -> f64 {
        (self.sum_of_squares / points.max(1) as f64).sqrt()
    }

    /// What the variance of a marked coordinate must be, going by what is left; `None` if nothing
    /// could have been left.
    pub fn variance_px2(&self) -> Option<f64> {
        (self.surplus > 0).then(|| self.sum_of_squares / self.surplus as f64)
    }
}

impl Numbers {
    fn new(scales: &Scales, image_from_floor: &Matrix3<f64>, lens: Vector3<f64>) -> Self {
        let normal = scales.normal_from_image() * image_from_floor * scales.floor_from_normal();
        let normal = normal / normal[(2, 2)];
        let mut numbers = [0.0; COUNT];
        for (index, number) in numbers.iter_mut().take(HOMOGRAPHY).enumerate() {
            *number = normal[(index / 3, index % 3)];
        }
        let offset = (lens.xy() - scales.field_center_mm) / scales.field_scale_mm;
        numbers[LENS..DISTORTION].copy_from_slice(&[
            offset.x,
            offset.y,
            lens.z / scales.field_scale_mm,
        ]);
        Self(numbers)
    }

    fn homography(&self) -> Matrix3<f64> {
        let h = &self.0;
        Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0)
    }

    /// Where a point of the pitch is seen. The same as [`CameraModel::image_from_field`], without
    /// inverting anything.
    fn image(&self, scales: &Scales, field_mm: [f64; 3]) -> Vector2<f64> {
        let place = (Vector2::new(field_mm[0], field_mm[1]) - scales.field_center_mm)
            / scales.field_scale_mm;
        let [x, y, z] = [self.0[LENS], self.0[LENS + 1], self.0[LENS + 2]];
        let lift = field_mm[2] / scales.field_scale_mm / z;
        let shadow = (place - Vector2::new(x, y) * lift) / (1.0 - lift);
        let projected = self.homography() * shadow.push(1.0);
        let undistorted = projected.xy() / projected.z;
        let [k1, k2, center_x, center_y] = [0, 1, 2, 3].map(|index| self.0[DISTORTION + index]);
        let center = Vector2::new(center_x, center_y);
        let offset = undistorted - center;
        let r2 = offset.norm_squared();
        let distorted = center + offset * (1.0 + r2 * (k1 + r2 * k2));
        scales.image_center_px + distorted * scales.half_diagonal_px
    }

    fn lens_mm(&self, scales: &Scales) -> Vector3<f64> {
        let [x, y, z] = [0, 1, 2].map(|axis| self.0[LENS + axis] * scales.field_scale_mm);
        Vector3::new(scales.field_center_mm.x + x, scales.field_center_mm.y + y, z)
    }

    fn distortion(&self, scales: &Scales) -> DistortionConfig {
        let [k1, k2, x, y] = [0, 1, 2, 3].map(|index| self.0[DISTORTION + index]);
        let center = scales.image_center_px + Vector2::new(x, y) * scales.half_diagonal_px;
        DistortionConfig { k1, k2, center_px: center.into() }
    }

    fn model(&self, scales: &Scales, picture_px: [u32; 2]) -> Result<CameraModel, GeometryError> {
        let image_from_floor =
            scales.image_from_normal() * self.homography() * scales.normal_from_floor();
        let lens = self.lens_mm(scales);
        CameraModel::from_homography(
            image_from_floor,
            lens.into(),
            self.distortion(scales),
            picture_px,
        )
    }
}

impl Scales {
    fn normal_from_floor(&self) -> Matrix3<f64> {
        to_normal(self.field_center_mm, self.field_scale_mm)
    }

    fn floor_from_normal(&self) -> Matrix3<f64> {
        from_normal(self.field_center_mm, self.field_scale_mm)
    }

    fn normal_from_image(&self) -> Matrix3<f64> {
        to_normal(self.image_center_px, self.half_diagonal_px)
    }

    fn image_from_normal(&self) -> Matrix3<f64> {
        from_normal(self.image_center_px, self.half_diagonal_px)
    }
}

fn to_normal(center: Vector2<f64>, scale: f64) -> Matrix3<f64> {
    let (s, c) = (1.0 / scale, center / scale);
    Matrix3::new(s, 0.0, -c.x, 0.0, s, -c.y, 0.0, 0.0, 1.0)
}

fn from_normal(center: Vector2<f64>, scale: f64) -> Matrix3<f64> {
    Matrix3::new(scale, 0.0, center.x, 0.0, scale, center.y, 0.0, 0.0, 1.0)
}

/// Above which point of the floor a lens of known height hangs, for square pixels and a lens over
/// the middle of the picture: with each focal length the homography's columns are two axes of the
/// floor and the way to its origin as the camera sees them (Zhang, A flexible new technique for
/// camera calibration, section 3.1), and the longer it is, the higher the camera must hang.
fn lens_above(
    image_from_floor: &Matrix3<f64>,
    image_center_px: Vector2<f64>,
    height_mm: f64,
) -> Option<[f64; 2]> {
    let centered = to_normal(image_center_px, 1.0) * image_from_floor;
    let lens = |focal_px: f64| {
        let camera = Matrix3::from_diagonal(&Vector3::new(1.0 / focal_px, 1.0 / focal_px, 1.0));
        let columns = camera * centered;
        let (x_axis, y_axis) = (columns.column(0).into_owned(), columns.column(1).into_owned());
        let unit = (x_axis.norm() * y_axis.norm()).sqrt();
        let axes = Matrix3::from_columns(&[x_axis, y_axis, x_axis.cross(&y_axis) / unit]);
        let lens = -(axes.try_inverse()? * columns.column(2));
        lens.iter().all(|value| value.is_finite()).then_some(lens)
    };
    let (mut short, mut long) = (1.0f64, 1e6f64);
    for _ in 0..100 {
        let focal_px = (short * long).sqrt();
        if lens(focal_px)?.z.abs() < height_mm { short = focal_px } else { long = focal_px }
    }
    let found = lens((short * long).sqrt())?;
    let is_that_high = (found.z.abs() - height_mm).abs() < 0.01 * height_mm;
    is_that_high.then_some([found.x, found.y])
}

/// Whether the camera sees every marked point from above: a turn to the left on the floor is one to
/// the right in a picture's rows and columns.
pub(super) fn senses(model: &CameraModel, marks: &[Mark]) -> Vec<bool> {
    let sense = |mark: &Mark| {
        let [x, y, _] = mark.field_mm;
        let at = |dx: f64, dy: f64| model.image_from_field(FieldPoint::new(x + dx, y + dy), 0.0);
        let (here, along, across) = (at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0));
        (along.x_px - here.x_px) * (across.y_px - here.y_px)
            < (along.y_px - here.y_px) * (across.x_px - here.x_px)
    };
    marks.iter().map(sense).collect()
}
