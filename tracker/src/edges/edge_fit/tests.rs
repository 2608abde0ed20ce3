use super::*;
use crate::edges::NO_EDGE;
use config::{Config, Pair, Preset};
use geometry::ImagePoint;
use geometry::layout::topmost_patch;
use messages::BayerOrder;
use proptest::prelude::*;

/// Red, green, blue.
type Color = [f64; 3];
const PATCH_COLORS: [Color; 5] = [
    [210.0, 190.0, 40.0],
    [40.0, 60.0, 190.0],
    [200.0, 40.0, 120.0],
    [50.0, 180.0, 60.0],
    [60.0, 190.0, 210.0],
];
const BODY: Color = [24.0, 25.0, 27.0];
const FLOOR: Color = [30.0, 34.0, 33.0];

/// A pitch with one robot, and what is painted over it.
struct Scene {
    config: Config,
    camera: CameraModel,
    pixels: Vec<u8>,
}

impl Scene {
    fn new(preset: Preset) -> Self {
        let config = preset.config();
        let (width, height) = (config.camera.width, config.camera.height);
        let camera = CameraModel::new(&config.geometry, width, height).unwrap();
        let pixels = vec![30; (width * height) as usize];
        Self { config, camera, pixels }
    }

    /// Paints what is near `pose` as a lens with a spot of `spot_px` shows it; `over` may paint over
    /// the top, in the frame of the robot.
    fn paint(&mut self, pose: &Pose, spot_px: f64, over: impl Fn(Pair) -> Option<Color>) {
        const LOOKS: u32 = 400;
        let robots = &self.config.robots;
        let width = self.config.camera.width as usize;
        let color_at = |point: ImagePoint| {
            let at = self.camera.field_from_image(point, robots.height_mm);
            let at = crate::pose::robot_from_field(pose, at);
            over(at).unwrap_or_else(|| match topmost_patch(robots, at) {
                Some(patch) => PATCH_COLORS[patch],
                None if at[0].abs().max(at[1].abs()) < robots.size_mm / 2.0 => BODY,
                None => FLOOR,
            })
        };
        let center = self.camera.image_from_field(pose.position, robots.height_mm);
        let order = self.config.camera.bayer_order;
        for row in (center.y_px - 22.0) as usize..(center.y_px + 22.0) as usize {
            for column in (center.x_px - 22.0) as usize..(center.x_px + 22.0) as usize {
                let channel = order.channel_at(column, row);
                let (mut sum, mut weights) = (0.0, 0.0);
                for look in 0..LOOKS {
                    // No two of them are above each other, or beside.
                    let spread = |step: f64| 5.6 * ((f64::from(look) * step).fract() - 0.5);
                    let (x, y) = (spread(0.754_877_666), spread(0.569_840_296));
                    let weight = (-(x * x + y * y) / 2.0).exp();
                    let point =
                        ImagePoint::new(column as f64 + x * spot_px, row as f64 + y * spot_px);
                    sum += weight * color_at(point)[channel];
                    weights += weight;
                }
                self.pixels[row * width + column] = (sum / weights).round() as u8;
            }
        }
    }

    fn mm_per_px(&self) -> f64 {
        mm_per_px(&self.config, &self.camera)
    }

    fn fit(&self, start: &Pose) -> Option<Fitted> {
        self.fit_expected(start, None)
    }

    fn fit_expected(&self, start: &Pose, expected: Option<&Pose>) -> Option<Fitted> {
        let deviations = Deviations { position_mm: 1.0, heading_rad: 0.04 };
        self.fit_within(start, &deviations, expected)
    }

    fn fit_within(
        &self,
        start: &Pose,
        deviations: &Deviations,
        expected: Option<&Pose>,
    ) -> Option<Fitted> {
        let camera = &self.config.camera;
        let header = camera.frame_header();
        let frame = RawFrame::new(&header, &self.pixels, camera.width, camera.height).unwrap();
        fitter(&self.config, &self.camera).fit(&self.camera, &frame, start, deviations, expected)
    }
}

fn fitter(config: &Config, camera: &CameraModel) -> EdgeFitter {
    let robots = &config.robots;
    let outlines: Vec<&[Pair]> =
        robots.patches.iter().map(|patch| patch.outline_mm.as_slice()).collect();
    let mm_per_px = mm_per_px(config, camera);
    let map = EdgeMap::new(&outlines, |point| topmost_patch(robots, point), mm_per_px);
    EdgeFitter::new(map, robots.height_mm)
}

fn mm_per_px(config: &Config, camera: &CameraModel) -> f64 {
    let height = config.robots.height_mm;
    let middle = camera.image_from_field(FieldPoint::default(), height);
    camera.pixel_area_mm2(middle, height).sqrt()
}

fn pose(x: f64, y: f64, degrees: f64) -> Pose {
    Pose { position: FieldPoint::new(x, y), orientation: degrees.to_radians() }
}

/// Off by a quarter of a pixel and two degrees.
fn nearby(pose: &Pose) -> Pose {
    let FieldPoint { x_mm, y_mm } = pose.position;
    Pose {
        position: FieldPoint::new(x_mm + 0.8, y_mm - 0.6),
        orientation: pose.orientation + 0.035,
    }
}

/// Millimetres and degrees off.
fn error(fitted: &Fitted, truth: &Pose) -> (f64, f64) {
    let off = fitted.pose.position.distance(truth.position);
    (off, wrap_angle(fitted.pose.orientation - truth.orientation).abs().to_degrees())
}

const POSES: [(f64, f64, f64); 6] = [
    (0.0, 0.0, 0.0),
    (1.3, -2.1, 90.0),
    (311.7, -250.2, 17.0),
    (-500.4, 310.9, -45.0),
    (402.2, 333.3, 133.0),
    (-351.0, -299.5, 179.0),
];

#[test]
fn poses_are_found_to_hundredths_of_a_pixel_in_every_layout_and_focus() {
    // In pixels of 4 mm; a picture that is sharper or softer than the fit takes it for.
    for (spot_px, most_mm, most_deg) in [(0.5, 0.5, 0.8), (0.62, 0.2, 0.3), (0.8, 0.5, 0.9)] {
        for preset in Preset::ALL {
            let (mut worst_mm, mut worst_deg) = (0.0f64, 0.0f64);
            for (x, y, degrees) in POSES {
                let truth = pose(x, y, degrees);
                let mut scene = Scene::new(preset);
                scene.paint(&truth, spot_px, |_| None);
                let fitted = scene.fit(&nearby(&truth)).unwrap();
                let (mm, deg) = error(&fitted, &truth);
                (worst_mm, worst_deg) =
                    (worst_mm.max(4.0 * mm / scene.mm_per_px()), worst_deg.max(deg));
                assert!(fitted.samples > 100, "{fitted:?}");
            }
            let what = format!("{}, spot {spot_px} px", preset.name());
            eprintln!("{what}: worst {worst_mm:.3} mm {worst_deg:.3}°");
            assert!(worst_mm < most_mm && worst_deg < most_deg, "{what}: {worst_mm} {worst_deg}");
        }
    }
}

/// Another robot's patch, brighter than ours, touches two of ours; nothing is known of it.
#[test]
fn what_touches_a_robot_hardly_moves_it() {
    for (x, y, degrees) in POSES {
        let truth = pose(x, y, degrees);
        let mut scene = Scene::new(Preset::Mirosot5v5);
        scene.paint(&truth, 0.62, |[x, _]| (x > 40.0).then_some([250.0, 250.0, 250.0]));
        let (mm, deg) = error(&scene.fit(&nearby(&truth)).unwrap(), &truth);
        assert!(mm < 0.3 && deg < 0.4, "{truth:?}: {mm} mm {deg}°");
    }
}

#[test]
fn a_hand_over_half_a_patch_hardly_moves_the_robot() {
    for (x, y, degrees) in POSES {
        let truth = pose(x, y, degrees);
        let mut scene = Scene::new(Preset::Mirosot5v5);
        scene.paint(&truth, 0.62, |[x, y]| (y > 20.0 + 0.2 * x).then_some([150.0, 110.0, 90.0]));
        let (mm, deg) = error(&scene.fit(&nearby(&truth)).unwrap(), &truth);
        assert!(mm < 0.3 && deg < 0.5, "{truth:?}: {mm} mm {deg}°");
    }
}

#[test]
fn where_a_robot_is_expected_does_not_decide_where_it_is_found() {
    for (x, y, degrees) in POSES {
        let truth = pose(x, y, degrees);
        let mut scene = Scene::new(Preset::Mirosot5v5);
        scene.paint(&truth, 0.62, |_| None);
        let start = nearby(&truth);
        let alone = scene.fit(&start).unwrap();
        // Where it is, a little off, on the wrong side, so far away that it must be wrong, nowhere.
        for (dx, dy, turn) in [
            (0.0, 0.0, 0.0),
            (0.3, -0.2, 0.5),
            (-2.0, 1.0, -2.0),
            (40.0, 0.0, 90.0),
            (f64::NAN, 0.0, 0.0),
        ] {
            let expected = pose(x + dx, y + dy, degrees + turn);
            let fitted = scene.fit_expected(&start, Some(&expected)).unwrap();
            let (mm, deg) = error(&fitted, &alone.pose);
            assert!(mm < 0.06 && deg < 0.08, "{expected:?}: {mm} mm {deg}°");
        }
    }
}

#[test]
fn where_there_are_no_edges_there_is_no_pose() {
    let scene = Scene::new(Preset::Mirosot5v5);
    let start = pose(100.0, 100.0, 20.0);
    // The prior is all there is, or nothing at all; never somewhere else.
    if let Some(fitted) = scene.fit(&start) {
        assert!(error(&fitted, &start).0 < 0.01, "{fitted:?}");
        assert!(fitted.covariance[0] > 0.9, "{fitted:?}");
    }
    // Nothing of it is in the picture.
    assert_eq!(scene.fit(&pose(90_000.0, 0.0, 0.0)), None);
    assert_eq!(scene.fit(&pose(f64::NAN, 0.0, 0.0)), None);
}

#[test]
fn edges_are_only_where_they_can_be_seen() {
    let config = Config::default();
    let camera = Scene::new(Preset::Mirosot5v5).camera;
    let map = fitter(&config, &camera).map;
    // Two squares, from 1 to 35 and from −35 to −1.
    assert_eq!(map.stretch_count, 8);
    let at = |x, y| match map.in_cell(map.cell_at(x, y)) {
        NO_EDGE => None,
        index => Some(*map.edge(index)),
    };
    let edge = at(18.0, 34.0).unwrap();
    assert_eq!((edge.normal, edge.offset_mm), ([0.0, -1.0], -35.0));
    assert_eq!(at(18.0, 36.0).unwrap(), edge);
    assert_eq!(at(-2.0, -18.0).unwrap().normal, [-1.0, 0.0]);
    // Corners, the middle of a patch, the middle of the body, far away, nowhere.
    for (x, y) in [(34.0, 34.0), (18.0, 18.0), (0.0, 0.0), (90.0, 0.0), (f32::NAN, 0.0)] {
        assert!(at(x, y).is_none(), "{x} {y}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// Whatever the picture: no panic, and no pose far from where it began.
    #[test]
    fn rubbish_moves_nothing_far(
        seed: u64,
        x in -1200.0..1200.0f64,
        y in -1000.0..1000.0f64,
        degrees in -180.0..180.0f64,
    ) {
        let mut scene = Scene::new(Preset::Mirosot5v5);
        let mut state = seed | 1;
        for pixel in &mut scene.pixels {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            *pixel = (state >> 24) as u8;
        }
        let start = pose(x, y, degrees);
        if let Some(fitted) = scene.fit(&start) {
            let (mm, _) = error(&fitted, &start);
            prop_assert!(mm < 12.0, "{mm}");
            prop_assert!(fitted.covariance.iter().all(|term| term.is_finite()));
        }
    }

    /// The inverse of a symmetric positive definite matrix is one.
    #[test]
    fn the_inverse_is_one(root in prop::array::uniform9(-2.0..2.0f64)) {
        let entry = |row: usize, column: usize| {
            let sum: f64 = (0..3).map(|k| root[3 * row + k] * root[3 * column + k]).sum();
            sum + if row == column { 0.1 } else { 0.0 }
        };
        let matrix = UPPER.map(|(row, column)| entry(row, column));
        let inverse = inverse(&matrix).unwrap();
        for unit in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
            let back = times(&matrix, &times(&inverse, &unit));
            for axis in 0..3 {
                prop_assert!((back[axis] - unit[axis]).abs() < 1e-6, "{back:?}");
            }
        }
    }
}

#[test]
fn the_order_of_the_colour_filter_makes_no_difference() {
    let truth = pose(311.7, -250.2, 17.0);
    for order in BayerOrder::ALL {
        let mut scene = Scene::new(Preset::Mirosot5v5);
        scene.config.camera.bayer_order = order;
        scene.paint(&truth, 0.62, |_| None);
        let (mm, deg) = error(&scene.fit(&nearby(&truth)).unwrap(), &truth);
        assert!(mm < 0.15 && deg < 0.2, "{order:?}: {mm} {deg}");
    }
}
