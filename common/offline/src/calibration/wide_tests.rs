//! Tests with wide-angle cameras of all projections: marks are computed through a known camera, and the
//! camera is recovered.

use super::*;
use nalgebra::{Rotation3, Vector3};

/// Textbook projections: distance from the centre as a function of the angle from the axis, for focal
/// length 1.
#[derive(Debug, Clone, Copy)]
enum Projection {
    Equidistant,
    Stereographic,
    EqualArea,
    /// An ideal picture distorted by r·(1 + k1·r²), r in half diagonals; so is the focal length.
    Barrel {
        k1: f64,
        focal: f64,
    },
}

impl Projection {
    fn distance(self, angle: f64) -> f64 {
        match self {
            Self::Equidistant => angle,
            Self::Stereographic => 2.0 * (angle / 2.0).tan(),
            Self::EqualArea => 2.0 * (angle / 2.0).sin(),
            Self::Barrel { k1, focal } => angle.tan() * (1.0 + k1 * (focal * angle.tan()).powi(2)),
        }
    }
}

/// An independent camera above the pitch; it shares no code with the code under test.
#[derive(Debug, Clone)]
struct Wide {
    projection: Projection,
    focal_px: f64,
    lens_mm: [f64; 3],
    /// Tilts about x and y, turn about z.
    turns: [f64; 3],
    middle_px: Pair,
}

const PICTURE: [u32; 2] = [640, 480];
const HALF_DIAGONAL: f64 = 400.0;

impl Wide {
    /// Above the middle, with the pitch filling the picture.
    fn above(projection: Projection, height: f64) -> Self {
        let corner = (1100f64.hypot(900.0) / height).atan();
        let projection = match projection {
            Projection::Barrel { k1, .. } => {
                // Places the corner of the pitch at 0.72 half diagonals.
                let mut radius = 0.72;
                for _ in 0..50 {
                    radius = 0.72 / (1.0 + k1 * radius * radius);
                }
                Projection::Barrel { k1, focal: radius / corner.tan() }
            }
            other => other,
        };
        let focal_px = 0.72 * HALF_DIAGONAL / projection.distance(corner);
        Self {
            projection,
            focal_px,
            lens_mm: [0.0, 0.0, height],
            turns: [0.0; 3],
            middle_px: [319.5, 239.5],
        }
    }

    fn sees(&self, field_mm: [f64; 3]) -> Pair {
        let [tilt_x, tilt_y, turn] = self.turns;
        // Looks down, rows run against y.
        let down = nalgebra::Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
        let rotation = Rotation3::from_euler_angles(tilt_x, tilt_y, turn).into_inner() * down;
        let ray = rotation * (Vector3::from(field_mm) - Vector3::from(self.lens_mm));
        let across = ray.xy().norm().max(1e-12);
        let distance = self.focal_px * self.projection.distance(across.atan2(ray.z));
        [0, 1].map(|axis| self.middle_px[axis] + distance * ray[axis] / across)
    }

    /// Adds normal errors of this standard deviation; the same for the same seed.
    fn marks(&self, places: &[Pair], sigma_px: f64, seed: u64) -> Vec<Mark> {
        let mut noise = Noise(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
        let mark = |&[x, y]: &Pair| {
            let field_mm = [x, y, 0.0];
            let image_px = self.sees(field_mm).map(|value| value + sigma_px * noise.normal());
            Mark { field_mm, image_px }
        };
        places.iter().map(mark).collect()
    }

    /// Root mean square error of robot positions all over the pitch.
    fn robots_rms_mm(&self, found: &Calibration) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for x in [-1000.0, -500.0, 0.0, 500.0, 1000.0] {
            for y in [-800.0, -400.0, 0.0, 400.0, 800.0] {
                let [x_px, y_px] = self.sees([x, y, 75.0]);
                let place = found.model.field_from_image(ImagePoint::new(x_px, y_px), 75.0);
                sum += (place.x_mm - x).powi(2) + (place.y_mm - y).powi(2);
                count += 1.0;
            }
        }
        f64::sqrt(sum / count)
    }
}

struct Noise(u64);

impl Noise {
    fn normal(&mut self) -> f64 {
        let mut uniform = || {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            (self.0 >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        (0..12).map(|_| uniform()).sum()
    }
}

/// Corners and middles of the sides; no inner points.
fn around() -> Vec<Pair> {
    let mut places = FieldConfig::default().outline().step_by(4).collect::<Vec<_>>();
    places.truncate(8);
    places
}

/// Corners, ends of the centre line, and the centre circle.
fn marked() -> Vec<Pair> {
    let mut places = FieldConfig::default().corners().to_vec();
    places.extend([[0.0, 900.0], [0.0, -900.0], [-200.0, 0.0], [200.0, 0.0], [0.0, 200.0]]);
    places.extend([[0.0, -200.0], [0.0, 0.0]]);
    places
}

fn grid() -> Vec<Pair> {
    let steps = [-1.0, -0.5, 0.0, 0.5, 1.0];
    steps.into_iter().flat_map(|x| steps.map(|y| [1100.0 * x, 900.0 * y])).collect()
}

fn fit(marks: &[Mark], height: f64) -> Result<Calibration, CalibrationError> {
    let camera = CameraConfig { width: PICTURE[0], height: PICTURE[1], ..CameraConfig::default() };
    calibrate(marks, KnownLens::HeightMm(height), &FieldConfig::default(), &camera, 3.0)
}

fn lenses() -> Vec<Wide> {
    let mut lenses = Vec::new();
    for height in [900.0, 1500.0, 2200.0] {
        for projection in
            [Projection::Equidistant, Projection::Stereographic, Projection::EqualArea]
        {
            lenses.push(Wide::above(projection, height));
        }
    }
    // With an off-centre axis, corners of the pitch come near the point where −0.24 turns back.
    for k1 in [-0.08, -0.16, -0.2] {
        lenses.push(Wide::above(Projection::Barrel { k1, focal: 0.0 }, 2200.0));
    }
    let aslant: Vec<Wide> = lenses
        .iter()
        .map(|lens| Wide {
            middle_px: [330.0, 232.0],
            turns: [0.08, -0.06, 0.03],
            lens_mm: [lens.lens_mm[0] + 60.0, lens.lens_mm[1] - 80.0, lens.lens_mm[2]],
            ..lens.clone()
        })
        .collect();
    lenses.extend(aslant);
    lenses
}

/// Root mean square position error over many pictures; every camera must be found.
fn pooled_rms_mm(places: &[Pair], sigma_px: f64, seeds: u64, is_centered: bool) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    let lenses = lenses().into_iter().filter(|lens| (lens.middle_px[0] < 320.0) == is_centered);
    for lens in lenses {
        for seed in 0..seeds {
            let found = fit(&lens.marks(places, sigma_px, seed), lens.lens_mm[2]);
            let found = found.unwrap_or_else(|error| panic!("{lens:?} {seed}: {error}"));
            sum += lens.robots_rms_mm(&found).powi(2);
            count += 1.0;
        }
    }
    f64::sqrt(sum / count)
}

#[test]
fn lenses_of_all_projections_are_found_in_points_marked_exactly() {
    for lens in lenses() {
        let found = fit(&lens.marks(&marked(), 0.0, 0), lens.lens_mm[2]).unwrap();
        let error = lens.robots_rms_mm(&found);
        assert!(error < 0.3, "{lens:?}: {error} mm, {:?}", found.geometry.distortion);
        // The written configuration equals the fit.
        let written = CameraModel::new(&found.geometry, PICTURE[0], PICTURE[1]).unwrap();
        assert_eq!(written, found.model);
    }
}

/// A pixel is 4.1 mm at the edge of the pitch. The errors are within a fifth of those of a fit that
/// knows the lens beforehand.
#[test]
fn points_marked_to_a_third_of_a_pixel_are_enough() {
    assert!(pooled_rms_mm(&grid(), 0.3, 3, true) < 0.95);
    assert!(pooled_rms_mm(&grid(), 0.3, 3, false) < 1.05);
    assert!(pooled_rms_mm(&marked(), 0.2, 3, true) < 1.1);
    assert!(pooled_rms_mm(&around(), 0.2, 3, true) < 1.2);
}
