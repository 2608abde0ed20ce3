//! Finds the marked points that are to blame when the points do not fit together.
//!
//! A fit is good if every point lies within the tolerance of its mark and the pitch is not turned
//! inside out. If the fit of all points is not, explanations are tried, and each one is accepted only
//! if it makes the fit good:
//!
//! 1. A pair of points swapped in the picture. All pairs of the 16 worst points are tried; among
//!    several, those whose view is least distorted (`strangeness`) are reported. A mirrored picture is
//!    reported instead if all points fit mirrored and no swap gives an equally plausible view.
//! 2. A few wrong points, by backward elimination: the point whose removal lowers the residual most is
//!    removed, again and again, up to a quarter of the points. n removed points must lower the root
//!    mean square residual by at least 2ⁿ. If removing another point instead is about as good, the
//!    culprit is ambiguous. This is tried with an ordinary lens first, since a lens that may bend
//!    freely hides a wrong point by bending.
//! 3. Otherwise the residuals of a straight lens decide: mostly radial ones mean that no lens model
//!    fits; others mean a contradiction.
//!
//! A good fit is checked too: if a straighter lens fits about as well without a few points, the lens
//! was bent around wrong points.

use super::Mark;
use super::fit::{self, Fitted, Task, senses};
use geometry::{CameraModel, FieldPoint};
use std::fmt;

/// Problem of the points. They are numbered from 0 here, and from 1 in the text.
#[derive(Debug, Clone, PartialEq)]
pub enum Suspicion {
    /// Swapping these two in the picture makes all points fit. If there are several pairs, any one of
    /// them would do, the likeliest first.
    Swapped(Vec<(usize, usize)>),
    /// Without these the other points fit; with the distance in pixels from the position at which the
    /// others expect each.
    Off(Vec<(usize, f64)>),
    /// Without any one of these the other points fit.
    OneOf(Vec<usize>),
    /// The points do not fit, and the culprit cannot be identified.
    Contradiction {
        /// The point farthest off.
        worst: usize,
        /// Its distance.
        distance_px: f64,
    },
    /// All points fit in a mirror image.
    Mirrored,
    /// All points fit without the configured mirror.
    NotMirrored,
    /// No lens model fits, and no few points are to blame: the residuals are radial and grow with the
    /// distance from the picture's middle.
    Lens {
        /// The point farthest off.
        worst: usize,
        /// Its distance.
        distance_px: f64,
    },
    /// The points turn part of the pitch inside out.
    InsideOut,
}

/// Most points tried as culprits, the ones farthest off.
const MAX_TRIED: usize = 16;
/// Most work for removing points, in fits times points: every removal with up to 22 points, some
/// seconds with any number. Among many points a few culprits are the ones farthest off.
const MAX_WORK: usize = 2000;
/// A rough fit without distortion and with a guessed lens puts good points off by at most this many
/// tolerances.
const ROUGHLY: f64 = 15.0;
/// A rough fit with a few distortions puts good points off by at most this many tolerances.
const NEARLY: f64 = 3.0;
/// A fit that needs fewer parameters counts as equally good up to this ratio of variances.
const AS_GOOD: f64 = 1.5;
/// A fit counts as much better below this ratio of variances.
const MUCH_BETTER: f64 = 0.25;
/// With fewer surplus equations a small variance may be chance.
const MIN_SURPLUS: usize = 6;
/// Views whose strangeness differs by less are equally likely.
const EQUALLY_STRANGE: f64 = 0.2;

impl fmt::Display for Suspicion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Swapped(pairs) => {
                for (index, (a, b)) in pairs.iter().enumerate() {
                    f.write_str(if index == 0 { "points " } else { ", or " })?;
                    write!(f, "{} and {}", a + 1, b + 1)?;
                }
                f.write_str(" look swapped")
            }
            Self::Off(points) => {
                for (index, (point, distance_px)) in points.iter().enumerate() {
                    f.write_str(if index == 0 { "" } else { ", " })?;
                    write!(f, "point {} is off by {distance_px:.0} px", point + 1)?;
                }
                f.write_str(", judging by the others")
            }
            Self::OneOf(points) => {
                let numbers: Vec<String> =
                    points.iter().map(|point| (point + 1).to_string()).collect();
                write!(f, "one of the points {} is wrong: ", numbers.join(", "))?;
                f.write_str("without any of them the others fit; mark more to tell which")
            }
            Self::Contradiction { worst, distance_px } => write!(
                f,
                "the points contradict each other: point {} lies {distance_px:.0} px from where \
                 it should; some are marked at the wrong place, or the pitch has not the size \
                 configured; with more points it could be told which",
                worst + 1
            ),
            Self::Mirrored => f.write_str(
                "the points show the pitch as in a mirror. If the camera looks through one, or its pictures come \
                 flipped, write `mirrored = true` under [camera]. Otherwise points have each other's place: x runs \
                 towards the right goal, y to the left of x, that is towards the top of an upright picture",
            ),
            Self::NotMirrored => f.write_str(
                "the configuration says camera.mirrored = true, but the points show the pitch as a camera sees it \
                 without a mirror: write `mirrored = false`, or check the points' places",
            ),
            Self::Lens { worst, distance_px } => write!(
                f,
                "the lens bends the picture more than these points can tell: point {} lies {distance_px:.0} px from \
                 where the best lens has it, and no few points are to blame; mark more of them, eight or more, also \
                 between the middle and the edges",
                worst + 1
            ),
            Self::InsideOut => f.write_str(
                "the points turn part of the pitch inside out: some of them have each other's place",
            ),
        }
    }
}

/// Problem of a fit; `None` if there is none.
pub(super) fn suspicion(task: &Task, fitted: Option<&Fitted>, within_px: f64) -> Option<Suspicion> {
    let judge = Judge { within_px };
    let Some(fitted) = fitted else {
        // Swapped corners can turn the pitch inside out so far that no model can be built.
        let first: Vec<usize> = (0..task.marks.len().min(MAX_TRIED)).collect();
        return Suspicion::of_swapped(&judge.swapped(task, &first));
    };
    if judge.is_fine(fitted, task) {
        return judge.bent_around(task, fitted);
    }
    let senses = senses(&fitted.model, task);
    let swapped = judge.swapped(task, &furthest_off(&fitted.model, task.marks));
    if senses.iter().all(|&from_above| !from_above) {
        let in_mirror = strangeness(&fitted.model, task.marks);
        let likelier = swapped.first().filter(|swap| swap.2 < in_mirror + EQUALLY_STRANGE);
        if likelier.is_none() && judge.is_near(fitted, task.marks) {
            let is_expected = task.is_mirrored;
            return Some(if is_expected { Suspicion::NotMirrored } else { Suspicion::Mirrored });
        }
    }
    if let Some(swapped) = Suspicion::of_swapped(&swapped) {
        return Some(swapped);
    }
    // A lens that is free to bend can hide one wrong point behind another.
    let straight = Task { max_distortion: 0, ..*task };
    let off_straight = || judge.off(&straight, &straight.best_fit().ok()?);
    // A wide lens, which bends even more, can do the same.
    let ordinary = Task { max_distortion: fit::POLYNOMIAL.min(task.max_distortion), ..*task };
    let off_ordinary = || judge.off(&ordinary, &ordinary.best_fit().ok()?);
    let off_any = || judge.off(task, fitted);
    if let Some((found, _)) = off_ordinary().or_else(off_any).or_else(off_straight) {
        return Some(found);
    }
    if !judge.is_near(fitted, task.marks) {
        let (worst, distance_px) = worst(&fitted.model, task.marks);
        if is_bent_around_the_middle(task, &straight) {
            return Some(Suspicion::Lens { worst, distance_px });
        }
        return Some(Suspicion::Contradiction { worst, distance_px });
    }
    Some(Suspicion::InsideOut)
}

impl Suspicion {
    fn of_swapped(pairs: &[(usize, usize, f64)]) -> Option<Self> {
        let names = || pairs.iter().map(|&(a, b, _)| (a, b)).collect();
        (!pairs.is_empty()).then(|| Self::Swapped(names()))
    }
}

/// Whether the residuals of a straight lens point towards or away from the picture's middle: more than
/// 80 % of their squares are radial, as a lens would leave them.
fn is_bent_around_the_middle(task: &Task, straight: &Task) -> bool {
    let Ok(fitted) = straight.best_fit() else { return false };
    let middle = task.picture_px.map(|size| (f64::from(size) - 1.0) / 2.0);
    let (mut all, mut radial) = (0.0, 0.0);
    for mark in task.marks {
        let [x, y, height] = mark.field_mm;
        let seen = fitted.model.image_from_field(FieldPoint::new(x, y), height);
        let error = [mark.image_px[0] - seen.x_px, mark.image_px[1] - seen.y_px];
        let out = [0, 1].map(|axis| mark.image_px[axis] - middle[axis]);
        let across = error[0] * out[0] + error[1] * out[1];
        all += error[0].powi(2) + error[1].powi(2);
        radial += across.powi(2) / (out[0].powi(2) + out[1].powi(2)).max(1.0);
    }
    // Errors in random directions are radial by half.
    radial > 0.8 * all
}

struct Judge {
    within_px: f64,
}

impl Judge {
    fn is_near(&self, fitted: &Fitted, marks: &[Mark]) -> bool {
        worst(&fitted.model, marks).1 <= self.within_px
    }

    fn is_fine(&self, fitted: &Fitted, task: &Task) -> bool {
        self.is_near(fitted, task.marks) && senses(&fitted.model, task).iter().all(|&sense| sense)
    }

    /// Pairs of the tried points that give a good fit when swapped in the picture, with the strangeness
    /// of the view; the likeliest first, without views that are much stranger than another.
    fn swapped(&self, task: &Task, tried: &[usize]) -> Vec<(usize, usize, f64)> {
        let mut marks = task.marks.to_vec();
        let mut found = Vec::new();
        for (index, &a) in tried.iter().enumerate() {
            for &b in &tried[..index] {
                swap_in_picture(&mut marks, a, b);
                let swapped = Task { marks: &marks, ..*task };
                if let Some(fitted) = self.fine_fit(&swapped) {
                    let strange = strangeness(&fitted.model, &marks);
                    found.push((a.min(b), a.max(b), strange, is_upright(&fitted.model, &marks)));
                }
                swap_in_picture(&mut marks, a, b);
            }
        }
        let least = found.iter().fold(f64::INFINITY, |least, found| least.min(found.2));
        found.retain(|found| found.2 <= least + EQUALLY_STRANGE);
        found.sort_by_key(|&(a, b, _, is_upright)| (!is_upright, a, b));
        found.into_iter().map(|(a, b, strange, _)| (a, b, strange)).collect()
    }

    /// A good fit, if there is one. Wide lenses are slow to fit, and are tried only if a rough fit with
    /// distortion is close enough.
    fn fine_fit(&self, task: &Task) -> Option<Fitted> {
        let [straight, bent] = task.rough_rms_px();
        let is_possible = straight.min(bent) < ROUGHLY * self.within_px;
        let is_maybe_wide = bent < NEARLY * self.within_px;
        let ordinary = Task { max_distortion: fit::POLYNOMIAL.min(task.max_distortion), ..*task };
        let fits = [(is_possible, ordinary), (is_possible && is_maybe_wide, *task)];
        let fits = fits.into_iter().filter(|(is_tried, _)| *is_tried);
        fits.filter_map(|(_, task)| task.best_fit().ok()).find(|fitted| self.is_fine(fitted, task))
    }

    /// Detects a lens bent around a wrong point: without the point, a straighter lens fits the others
    /// about as well.
    fn bent_around(&self, task: &Task, fitted: &Fitted) -> Option<Suspicion> {
        let variance_px2 = fitted.variance_px2()?;
        for max_distortion in [0, 1, 2].into_iter().filter(|&c| c < fitted.distortion_parameters) {
            let straighter = Task { max_distortion, ..*task };
            let Ok(fitted_straighter) = straighter.best_fit() else { continue };
            let Some((found, without)) = self.off(&straighter, &fitted_straighter) else {
                continue;
            };
            // A wrong point takes up two parameters. A fit that saves more than that may be slightly
            // worse.
            let Suspicion::Off(points) = &found else { continue };
            let saved = fitted.distortion_parameters.saturating_sub(without.distortion_parameters);
            let allowed = match fitted.is_physical {
                // A physical lens is too stiff to bend around a point unnoticed.
                true if without.surplus < MIN_SURPLUS => continue,
                true => MUCH_BETTER,
                false if saved >= 2 * points.len() => AS_GOOD,
                false => 1.0,
            };
            let is_as_good = without.variance_px2().is_some_and(|px2| px2 < allowed * variance_px2);
            if is_as_good && points.iter().any(|&(_, distance_px)| distance_px > self.within_px) {
                return Some(found);
            }
        }
        None
    }

    /// Points without which the others fit well, found by backward elimination (see the module).
    fn off(&self, task: &Task, fitted: &Fitted) -> Option<(Suspicion, Fitted)> {
        let mut left: Vec<usize> = (0..task.marks.len()).collect();
        let rms_px = fitted.rms_px(left.len());
        let mut model = fitted.model.clone();
        let mut work_left = MAX_WORK;
        let tried = (MAX_TRIED * 22 / task.marks.len().max(1)).clamp(1, MAX_TRIED);
        while left.len() > (3 * task.marks.len()).div_ceil(4).max(4) {
            let marks: Vec<Mark> = left.iter().map(|&point| task.marks[point]).collect();
            let mut without = Vec::new();
            work_left = work_left.checked_sub(tried * marks.len())?;
            for place in furthest_off(&model, &marks).into_iter().take(tried) {
                let mut others = marks.clone();
                others.remove(place);
                let fitted = Task { marks: &others, ..*task }.best_fit();
                // With fewer surplus equations any points fit.
                if let Some(fitted) = fitted.ok().filter(|fitted| fitted.surplus >= 2) {
                    without.push((place, fitted.rms_px(others.len()), fitted, others));
                }
            }
            without.sort_by(|a, b| a.1.total_cmp(&b.1));
            let (place, rms_without, best, others) = without.first()?;
            if self.is_fine(best, &Task { marks: others, ..*task }) {
                // Removal must pay off for each point, but that shows only when all of them are
                // removed.
                let taken = task.marks.len() - others.len();
                if *rms_without > rms_px / 2f64.powi(taken as i32) {
                    return None;
                }
                // If removing another point is about as good, the culprit is ambiguous.
                let as_good = |(_, rms, fitted, others): &&(usize, f64, Fitted, Vec<Mark>)| {
                    let task = Task { marks: others, ..*task };
                    // A lens that must bend more for it is no equal explanation.
                    fitted.distortion_parameters <= best.distortion_parameters + 1
                        && *rms < 2.0 * rms_without + 0.1
                        && self.is_fine(fitted, &task)
                };
                let suspects: Vec<usize> =
                    without.iter().filter(as_good).map(|(place, ..)| left[*place]).collect();
                if suspects.len() > 1 && left.len() == task.marks.len() {
                    return Some((Suspicion::OneOf(suspects), best.clone()));
                }
                left.remove(*place);
                let gone = (0..task.marks.len()).filter(|point| !left.contains(point));
                let distances =
                    gone.map(|point| (point, distance_px(&best.model, &task.marks[point])));
                return Some((Suspicion::Off(distances.collect()), best.clone()));
            }
            model = best.model.clone();
            left.remove(*place);
        }
        None
    }
}

fn swap_in_picture(marks: &mut [Mark], a: usize, b: usize) {
    let image_px = marks[a].image_px;
    marks[a].image_px = marks[b].image_px;
    marks[b].image_px = image_px;
}

fn distance_px(model: &CameraModel, mark: &Mark) -> f64 {
    let [x, y, height] = mark.field_mm;
    let seen = model.image_from_field(FieldPoint::new(x, y), height);
    let distance = (seen.x_px - mark.image_px[0]).hypot(seen.y_px - mark.image_px[1]);
    // A point on the horizon has no pixel.
    if distance.is_nan() { f64::INFINITY } else { distance }
}

fn worst(model: &CameraModel, marks: &[Mark]) -> (usize, f64) {
    let distances = marks.iter().map(|mark| distance_px(model, mark)).enumerate();
    distances.max_by(|(_, a), (_, b)| a.total_cmp(b)).unwrap_or((0, 0.0))
}

/// Indices of the marks farthest off.
fn furthest_off(model: &CameraModel, marks: &[Mark]) -> Vec<usize> {
    let mut places: Vec<usize> = (0..marks.len()).collect();
    let distance = |&place: &usize| distance_px(model, &marks[place]);
    places.sort_by(|a, b| distance(b).total_cmp(&distance(a)));
    places.truncate(MAX_TRIED);
    places
}

/// Distortion of the view compared with a camera that looks straight down: 0 for one that shows squares
/// as squares, everywhere of the same size.
fn strangeness(model: &CameraModel, marks: &[Mark]) -> f64 {
    let mut stretch = 0.0f64;
    let (mut least, mut most) = (f64::INFINITY, 0.0f64);
    for mark in marks {
        let [along, across] = steps(model, mark);
        let determinant = (along[0] * across[1] - along[1] * across[0]).abs();
        let sum = along[0].hypot(along[1]).powi(2) + across[0].hypot(across[1]).powi(2);
        // For singular values a ≥ b, (a² + b²) / 2ab = cosh ln(a/b).
        stretch = stretch.max((sum / (2.0 * determinant)).max(1.0).acosh());
        least = least.min(determinant);
        most = most.max(determinant);
    }
    let strangeness = stretch + (most / least).ln() / 2.0;
    if strangeness.is_nan() { f64::INFINITY } else { strangeness }
}

/// Whether x runs to the right in the picture.
fn is_upright(model: &CameraModel, marks: &[Mark]) -> bool {
    marks.iter().map(|mark| steps(model, mark)[0][0]).sum::<f64>() > 0.0
}

/// Displacements in the picture of 1 mm along x and 1 mm along y.
fn steps(model: &CameraModel, mark: &Mark) -> [[f64; 2]; 2] {
    let [x, y, height] = mark.field_mm;
    let at = |dx: f64, dy: f64| model.image_from_field(FieldPoint::new(x + dx, y + dy), height);
    let (here, along, across) = (at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0));
    [along, across].map(|there| [there.x_px - here.x_px, there.y_px - here.y_px])
}
