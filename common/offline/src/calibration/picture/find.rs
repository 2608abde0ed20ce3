//! Finds the pitch in a picture without any marks.
//!
//! The lines that every pitch has (border, centre line, centre circle) are laid over the edges of the picture
//! in many sizes, places and directions, and each is fitted by moving the four corners and bending for the
//! lens (Gauss–Newton on the distance to the nearest edge across the line). The one of which most lies on edges is
//! the pitch. Border and wall look alike to this, and the fit is good to about a pixel of a reduced
//! picture, so a refinement on lines ([`super::lines`]) has to follow.
//!
//! A pitch looks the same from both ends. Its left end, at negative x, is taken to be the left or the upper
//! one in the picture.

use super::brightness::Brightness;
use super::edges::EdgeMap;
use super::pitch::{Insets, Line, lines};
use crate::calibration::Mark;
use config::FieldConfig;
use image::RgbImage;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// A pitch found in a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundPitch {
    /// Where the corners of the pitch are seen, in the order of [`FieldConfig::corners`], and points
    /// between them.
    pub marks: Vec<Mark>,
    /// The share of its lines that lies on edges of the picture.
    pub agreement: f64,
}

/// No pitch was found.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "no pitch of the configured size was found: the best guess has {:.0} % of its lines on edges of the picture. \
     Are the pitch's sizes right, and is all of it in the picture? Otherwise mark its corners",
    100.0 * agreement
)]
pub struct NotFound {
    /// The share of the best guess's lines that lies on edges of the picture.
    pub agreement: f64,
}

/// Width to which pictures are reduced, and the width for the last fit.
const WIDTHS: [usize; 2] = [320, 640];
/// Samples of the pitch's lines.
const SAMPLES: f64 = 240.0;
/// A round of fits: distances from an edge count up to this, in thousandths of the map's width, and so many guesses
/// are fitted further.
struct Round {
    reach: f64,
    kept: usize,
}

const ROUNDS: [Round; 3] = [
    Round { reach: 60.0, kept: 150 },
    Round { reach: 30.0, kept: 60 },
    Round { reach: 12.0, kept: 24 },
];
/// The same for the last fits, on the larger map.
const LAST_REACHES: [f64; 2] = [12.0, 6.0];
/// Cost of edges inside the pitch that belong to no line, such as those of a wall in a pitch that is too large,
/// relative to the length of the lines.
const STRAY_COST: f64 = 0.15;
/// A sample so near to an edge lies on it, in thousandths of the map's width.
const ON_EDGE: f64 = 5.0;
/// Largest ratio of opposite sides as seen by a camera above the pitch, and largest factor by which such a camera
/// stretches the pitch in one direction, lens and pixels included.
const MOST_KEYSTONE: f64 = 1.35;
const MOST_STRETCH: f64 = 1.2;
/// Smallest share of the lines on edges.
const LEAST_AGREEMENT: f64 = 0.5;
/// Smallest share of the lines in the picture.
const LEAST_SEEN: f64 = 0.7;

/// Four corners as seen, and the bend of the lens, all in units of the map's width.
type Shape = SVector<f64, 9>;

/// Finds the pitch.
/// `mirrored` is [`CameraConfig::mirrored`](config::CameraConfig::mirrored).
pub fn find(
    picture: &RgbImage,
    field: &FieldConfig,
    mirrored: bool,
) -> Result<FoundPitch, NotFound> {
    let brightness = Brightness::of(picture);
    let pitch = Pitch::new(field, mirrored);
    let coarse = EdgeMap::of(&brightness, WIDTHS[0]);
    let mut shapes = beginnings(&coarse, field);
    for Round { reach, kept } in ROUNDS {
        let cost = |shape: Shape| (pitch.cost(&coarse, &shape, reach), shape);
        let fitted = shapes.into_iter().map(|shape| pitch.fitted(&coarse, shape, reach, false));
        let mut guesses: Vec<(f64, Shape)> = fitted.map(cost).collect();
        guesses.sort_by(|a, b| a.0.total_cmp(&b.0));
        guesses.truncate(kept);
        shapes = guesses.into_iter().map(|(_, shape)| shape).collect();
    }
    let fine = EdgeMap::of(&brightness, WIDTHS[1]);
    let mut best = (0.0, 0.0, Shape::zeros());
    for mut shape in shapes {
        for reach in LAST_REACHES {
            shape = pitch.fitted(&fine, shape, reach, true);
        }
        let agreement = pitch.agreement(&fine, &shape);
        let score = agreement - STRAY_COST * pitch.stray(&fine, &shape);
        if score > best.0 {
            best = (score, agreement, shape);
        }
    }
    let (_, agreement, shape) = best;
    if agreement < LEAST_AGREEMENT {
        return Err(NotFound { agreement });
    }
    let camera = Seen::new(&pitch, &fine, &shape).ok_or(NotFound { agreement })?;
    let unit = fine.width as f64 / fine.scale;
    let half = 0.5 / fine.scale - 0.5;
    let marks = field.corners().into_iter().chain(between(field)).map(|[x, y]| {
        let image_px = camera.at([x, y]).map(|part| part * unit + half);
        Mark { field_mm: [x, y, 0.0], image_px }
    });
    Ok(FoundPitch { marks: marks.collect(), agreement })
}

/// Points between the corners, which tell how the lens bends.
fn between(field: &FieldConfig) -> [[f64; 2]; 5] {
    let (x, y) = (field.length_mm / 2.0, field.width_mm / 2.0);
    [[0.0, y], [0.0, -y], [-x, 0.0], [x, 0.0], [0.0, 0.0]]
}

/// Where the pitch may be: in the middle or beside it, large or small, along the picture or across.
fn beginnings(map: &EdgeMap, field: &FieldConfig) -> Vec<Shape> {
    let [width, height] = [1.0, map.height as f64 / map.width as f64];
    let mut begin = Vec::new();
    for quarter in [0.0f64, 0.25] {
        let aspect = field.width_mm / field.length_mm;
        let largest = match quarter == 0.0 {
            true => f64::min(width, height / aspect),
            false => f64::min(height, width / aspect),
        };
        for size in [1.0, 0.92, 0.84, 0.76, 0.68, 0.6, 0.52] {
            for turn in [-0.015, 0.0, 0.015] {
                for x in [-0.06, 0.0, 0.06] {
                    for y in [-0.06, 0.0, 0.06] {
                        let (sin, cos) = (std::f64::consts::TAU * (quarter + turn)).sin_cos();
                        let corner = |[along, across]: [f64; 2]| {
                            let (along, across) =
                                (along * size * largest, across * size * largest * aspect);
                            [
                                width / 2.0 + x + along * cos - across * sin,
                                height / 2.0 + y + along * sin + across * cos,
                            ]
                        };
                        let corners =
                            [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]].map(corner);
                        let mut shape = Shape::zeros();
                        shape.iter_mut().zip(corners.iter().flatten()).for_each(|(a, b)| *a = *b);
                        begin.push(shape);
                    }
                }
            }
        }
    }
    begin
}

/// The samples of the pitch's lines: a point and another one close to it along the line, field mm.
struct Pitch {
    samples: Vec<[[f64; 2]; 2]>,
    /// Field mm, in the order that is clockwise in the picture, which a mirrored camera reverses.
    corners: [[f64; 2]; 4],
}

impl Pitch {
    fn new(field: &FieldConfig, mirrored: bool) -> Self {
        let all = lines(field, Insets::default());
        let length_mm: f64 = all.iter().map(|line| line.length_mm).sum();
        let sampled = |line: &Line| -> Vec<[[f64; 2]; 2]> {
            let count = (SAMPLES * line.length_mm / length_mm).ceil();
            let at = |index: u32| {
                let part = (f64::from(index) + 0.5) / count;
                [(line.at)(part - 0.1 / count), (line.at)(part + 0.1 / count)]
            };
            (0..count as u32).map(at).collect()
        };
        Self {
            samples: all.iter().flat_map(sampled).collect(),
            corners: field.corners().map(|[x, y]| [x, if mirrored { -y } else { y }]),
        }
    }

    /// The distances of all samples from edges, at most `reach`, in units of the reach; those outside the
    /// picture are that far.
    fn distances(&self, map: &EdgeMap, shape: &Shape, reach: f64) -> Option<Vec<f64>> {
        let camera = Seen::new(self, map, shape)?;
        let unit = map.width as f64;
        let reach = reach * unit / 1000.0;
        let distance = |[behind, ahead]: &[[f64; 2]; 2]| {
            let [a, b] = [behind, ahead].map(|&point| camera.at(point).map(|part| part * unit));
            let place = [0, 1].map(|axis| (a[axis] + b[axis]) / 2.0);
            let normal = [a[1] - b[1], b[0] - a[0]];
            map.distance(place, normal, reach).map_or(1.0, |distance| distance / reach)
        };
        Some(self.samples.iter().map(distance).collect())
    }

    /// The share of the lines that lies on edges, less for a pitch that is not all in the picture.
    fn agreement(&self, map: &EdgeMap, shape: &Shape) -> f64 {
        let Some(camera) = Seen::new(self, map, shape) else { return 0.0 };
        let height = map.height as f64 / map.width as f64;
        let is_seen = |[point, _]: &&[[f64; 2]; 2]| {
            let [x, y] = camera.at(*point);
            (0.0..1.0).contains(&x) && (0.0..height).contains(&y)
        };
        let seen = self.samples.iter().filter(is_seen).count() as f64 / self.samples.len() as f64;
        if seen < LEAST_SEEN || !self.is_plausible(shape) {
            return 0.0;
        }
        let Some(distances) = self.distances(map, shape, ON_EDGE) else { return 0.0 };
        distances.iter().filter(|&&distance| distance < 1.0).count() as f64 / distances.len() as f64
    }

    /// Sum of the squared distances from edges.
    fn cost(&self, map: &EdgeMap, shape: &Shape, reach: f64) -> f64 {
        let distances = self.distances(map, shape, reach).filter(|_| self.is_plausible(shape));
        distances.map_or(f64::INFINITY, |distances| sum_of_squares(&distances))
    }

    /// Whether the corners go round once, and a camera above the pitch can see them so.
    fn is_plausible(&self, shape: &Shape) -> bool {
        let corner = |index: usize| [shape[2 * (index % 4)], shape[2 * (index % 4) + 1]];
        let side = |index: usize| {
            let (a, b) = (corner(index), corner(index + 1));
            (b[0] - a[0]).hypot(b[1] - a[1])
        };
        let turns = |index: usize| {
            let (a, b, c) = (corner(index), corner(index + 1), corner(index + 2));
            (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
        };
        let ratio = |a: f64, b: f64| f64::max(a / b, b / a);
        let [a, b, _, d] = self.corners;
        let aspect = (b[0] - a[0]).abs() / (d[1] - a[1]).abs();
        (0..4).all(|index| turns(index) > 0.0)
            && ratio(side(0), side(2)) < MOST_KEYSTONE
            && ratio(side(1), side(3)) < MOST_KEYSTONE
            && ratio(side(0) + side(2), aspect * (side(1) + side(3))) < MOST_STRETCH
    }

    /// Edges inside the pitch that are not on its lines, relative to the pixels of its lines.
    fn stray(&self, map: &EdgeMap, shape: &Shape) -> f64 {
        let Some(camera) = Seen::new(self, map, shape) else { return f64::INFINITY };
        let unit = map.width as f64;
        let near = ON_EDGE / 1000.0 * unit;
        let corner = |index: usize| camera.at(self.corners[index % 4]).map(|part| part * unit);
        let inside = |[x, y]: &[f64; 2]| {
            (0..4).all(|index| {
                let (a, b) = (corner(index), corner(index + 1));
                let length = (b[0] - a[0]).hypot(b[1] - a[1]);
                (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) > near * length
            })
        };
        let length: f64 = (0..4)
            .map(|index| {
                let (a, b) = (corner(index), corner(index + 1));
                (b[0] - a[0]).hypot(b[1] - a[1])
            })
            .sum();
        map.edges.iter().filter(|place| inside(place)).count() as f64 / length
    }

    /// The shape moved so that its lines lie on edges.
    fn fitted(&self, map: &EdgeMap, begin: Shape, reach: f64, bends: bool) -> Shape {
        const STEP: f64 = 1e-3;
        const ITERATIONS: usize = 8;
        let parameters = if bends { 9 } else { 8 };
        let mut shape = begin;
        let mut damping = 1e-3;
        let Some(mut here) = self.distances(map, &shape, reach) else { return begin };
        for _ in 0..ITERATIONS {
            let Some(slopes) = self.slopes(map, &shape, reach, parameters, STEP) else {
                return begin;
            };
            let mut normal = SMatrix::<f64, 9, 9>::zeros();
            let mut right = Shape::zeros();
            for (slope, &distance) in slopes.iter().zip(&here) {
                // Beyond the reach there is nothing to be drawn by.
                if distance < 1.0 {
                    normal += slope * slope.transpose();
                    right -= slope * distance;
                }
            }
            for index in 0..9 {
                normal[(index, index)] += damping * normal[(index, index)] + 1e-9;
            }
            let Some(step) = normal.cholesky().map(|normal| normal.solve(&right)) else { break };
            let next = shape + step;
            match self.distances(map, &next, reach) {
                Some(distances) if sum_of_squares(&distances) < sum_of_squares(&here) => {
                    (shape, here) = (next, distances);
                    damping /= 4.0;
                    if step.norm() < 1e-4 {
                        break;
                    }
                }
                _ => damping *= 10.0,
            }
        }
        shape
    }

    /// How each sample's distance changes with each parameter.
    fn slopes(
        &self,
        map: &EdgeMap,
        shape: &Shape,
        reach: f64,
        parameters: usize,
        step: f64,
    ) -> Option<Vec<Shape>> {
        let mut slopes = vec![Shape::zeros(); self.samples.len()];
        for parameter in 0..parameters {
            let mut moved = [*shape, *shape];
            moved[0][parameter] += step;
            moved[1][parameter] -= step;
            let [ahead, behind] = moved.map(|moved| self.distances(map, &moved, reach));
            for (slope, (a, b)) in slopes.iter_mut().zip(ahead?.iter().zip(&behind?)) {
                slope[parameter] = (a - b) / (2.0 * step);
            }
        }
        Some(slopes)
    }
}

fn sum_of_squares(distances: &[f64]) -> f64 {
    distances.iter().map(|distance| distance * distance).sum()
}

/// Where points of the pitch are seen by a camera of this shape, in units of the map's width.
struct Seen {
    homography: Matrix3<f64>,
    middle: [f64; 2],
    bend: f64,
}

impl Seen {
    fn new(pitch: &Pitch, map: &EdgeMap, shape: &Shape) -> Option<Self> {
        let corners = [0, 1, 2, 3].map(|index| [shape[2 * index], shape[2 * index + 1]]);
        let to = quadrangle(corners);
        let from = quadrangle(pitch.corners).try_inverse()?;
        let middle = [0.5, 0.5 * map.height as f64 / map.width as f64];
        Some(Self { homography: to * from, middle, bend: shape[8] })
    }

    fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let seen = self.homography * Vector3::new(x, y, 1.0);
        let off = [seen.x / seen.z - self.middle[0], seen.y / seen.z - self.middle[1]];
        let square = off[0] * off[0] + off[1] * off[1];
        [0, 1].map(|axis| self.middle[axis] + off[axis] * (1.0 + self.bend * square))
    }
}

/// The homography that maps the corners of the unit square, (0, 0), (1, 0), (1, 1), (0, 1), to these (Heckbert,
/// Fundamentals of Texture Mapping, 1989, section 2.2.3).
fn quadrangle([p0, p1, p2, p3]: [[f64; 2]; 4]) -> Matrix3<f64> {
    let sum = [0, 1].map(|axis| p0[axis] - p1[axis] + p2[axis] - p3[axis]);
    let (d1, d2) = ([0, 1].map(|axis| p1[axis] - p2[axis]), [0, 1].map(|axis| p3[axis] - p2[axis]));
    let area = d1[0] * d2[1] - d2[0] * d1[1];
    let g = (sum[0] * d2[1] - d2[0] * sum[1]) / area;
    let h = (d1[0] * sum[1] - sum[0] * d1[1]) / area;
    let row = |axis: usize| {
        [p1[axis] - p0[axis] + g * p1[axis], p3[axis] - p0[axis] + h * p3[axis], p0[axis]]
    };
    let ([a, b, c], [d, e, f]) = (row(0), row(1));
    Matrix3::new(a, b, c, d, e, f, g, h, 1.0)
}
