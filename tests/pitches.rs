//! A pitch of every league, set up as a user would: preset, `calibrate`, `learn`, `detect`.
//!
//! The pictures come from a renderer that is independent of the synthetic match (`painter`): another
//! palette, lamps to one side, a lens with its centre off the picture's. Colours are learned from some
//! pictures and tested on others of the same pitch. `cargo test --release --test pitches --
//! --nocapture` prints the table of `docs/accuracy.md`.

mod painter;
mod support;

use config::{Config, PatchRole, Preset};
use geometry::{CameraModel, FieldPoint};
use painter::random::Random;
use painter::{Ball, Floor, Lamp, Lens, Marking, Rgb, Robot, Scene, Sensor, Shape};
use serde_json::{Value, json};
use std::path::PathBuf;
use support::{Scratch, output_of};

/// Number of pictures for learning, and for testing.
const TAUGHT: u64 = 4;
const TRIED: u64 = 3;
/// Standard deviation with which a user marks points, px.
const MARKED_TO_PX: f64 = 0.3;

/// A league's pitch as a user might build it.
struct Pitch {
    floor: Rgb,
    /// Height of the camera, mm.
    camera_mm: f64,
    shape: Shape,
    robots_each: usize,
}

/// Paints of another palette, as linear reflectances.
fn paint_of(color: &str) -> Rgb {
    match color {
        "orange" => [0.88, 0.24, 0.03],
        "yellow" => [0.82, 0.62, 0.05],
        "blue" => [0.03, 0.12, 0.58],
        "green" => [0.07, 0.52, 0.13],
        "cyan" => [0.05, 0.48, 0.62],
        "pink" => [0.85, 0.18, 0.48],
        "violet" => [0.32, 0.11, 0.58],
        "red" => [0.68, 0.04, 0.05],
        other => panic!("no paint for {other}"),
    }
}

/// A picture and its truth.
struct Picture {
    file: PathBuf,
    robots: Vec<Value>,
    ball: Value,
}

impl Pitch {
    /// A pitch of a league.
    fn of(preset: Preset) -> Self {
        let black = [0.045, 0.048, 0.05];
        let green = [0.055, 0.14, 0.07];
        let (floor, camera_mm, shape, robots_each) = match preset {
            Preset::Mirosot5v5 | Preset::MirosotTriangles | Preset::MirosotQuadrants => {
                (black, 2300.0, Shape::Square(37.5), 5)
            }
            Preset::MirosotLarge => (black, 3900.0, Shape::Square(37.5), 11),
            Preset::Vsss3v3 | Preset::VsssCorner => (black, 2000.0, Shape::Square(38.0), 3),
            Preset::SslDivisionB => (green, 6000.0, Shape::Disc(90.0, 75.0), 6),
        };
        Self { floor, camera_mm, shape, robots_each }
    }

    fn lens(&self, config: &Config) -> Lens {
        let (width, height) = (config.camera.width, config.camera.height);
        let field = &config.field;
        let mut lens = Lens {
            width,
            height,
            position: [0.03 * field.length_mm, -0.02 * field.width_mm, self.camera_mm],
            tilt_deg: [1.2, -0.8, 1.5],
            focal_px: f64::from(width),
            center_px: [f64::from(width) * 0.515 + 3.0, f64::from(height) * 0.48 - 2.0],
            k1: -0.08,
            k2: 0.01,
        };
        let reach = [field.length_mm / 2.0 + field.goal_depth_mm, field.width_mm / 2.0];
        let is_seen = |lens: &Lens| {
            [[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]].iter().all(|[sx, sy]| {
                let top = [sx * reach[0], sy * reach[1], config.robots.height_mm];
                let [x, y] = lens.project(top);
                (6.0..f64::from(width) - 7.0).contains(&x)
                    && (6.0..f64::from(height) - 7.0).contains(&y)
            })
        };
        while !is_seen(&lens) {
            lens.focal_px *= 0.99;
        }
        lens
    }

    /// The file of points as a user marks them: named points, each slightly off.
    fn points(&self, config: &Config, lens: &Lens, random: &mut Random) -> String {
        let field = &config.field;
        let (half_x, half_y) = (field.length_mm / 2.0, field.width_mm / 2.0);
        let goal = field.goal_width_mm / 2.0;
        let places = [
            ("corner top left", [-half_x, half_y]),
            ("corner top right", [half_x, half_y]),
            ("corner bottom right", [half_x, -half_y]),
            ("corner bottom left", [-half_x, -half_y]),
            ("centre line top", [0.0, half_y]),
            ("centre line bottom", [0.0, -half_y]),
            ("goal left top post", [-half_x, goal]),
            ("goal left bottom post", [-half_x, -goal]),
            ("goal right top post", [half_x, goal]),
            ("goal right bottom post", [half_x, -goal]),
            ("circle top", [0.0, field.center_circle_radius_mm]),
            ("circle bottom", [0.0, -field.center_circle_radius_mm]),
        ];
        let mut text = format!("camera_height_mm = {}\npoints = [\n", self.camera_mm);
        for (name, [x, y]) in places {
            let [x, y] = lens.project([x, y, 0.0]).map(|px| px + MARKED_TO_PX * random.normal());
            text += &format!("    {{ at = \"{name}\", image_px = [{x:.2}, {y:.2}] }},\n");
        }
        text + "]\n"
    }

    fn floor(&self, config: &Config) -> Floor {
        let field = &config.field;
        let (half_x, half_y) = (field.length_mm / 2.0, field.width_mm / 2.0);
        // The leagues' lines are about this wide.
        let width_mm = (field.length_mm / 300.0).clamp(5.0, 10.0);
        let line = |from, to| Marking::Line { from, to, width_mm };
        Floor {
            color: self.floor,
            grain: 0.06,
            markings: vec![
                line([-half_x, half_y], [half_x, half_y]),
                line([half_x, half_y], [half_x, -half_y]),
                line([half_x, -half_y], [-half_x, -half_y]),
                line([-half_x, -half_y], [-half_x, half_y]),
                line([0.0, half_y], [0.0, -half_y]),
                Marking::Circle { radius_mm: field.center_circle_radius_mm, width_mm },
            ],
            half_mm: [half_x + field.goal_depth_mm, half_y + field.goal_depth_mm],
            around: [0.16, 0.15, 0.14],
        }
    }

    /// Robots and a ball at random positions on the pitch.
    fn scene(&self, config: &Config, random: &mut Random) -> (Scene, Vec<(&'static str, u32)>) {
        let field = &config.field;
        let reach = match self.shape {
            Shape::Square(half) => half * std::f64::consts::SQRT_2,
            Shape::Disc(radius, _) => radius,
        };
        let mut taken: Vec<[f64; 3]> = vec![];
        let mut place = |random: &mut Random, radius: f64| loop {
            let x = random.between(-1.0, 1.0) * (field.length_mm / 2.0 - radius);
            let y = random.between(-1.0, 1.0) * (field.width_mm / 2.0 - radius);
            if taken
                .iter()
                .all(|other| (other[0] - x).hypot(other[1] - y) > other[2] + radius + 5.0)
            {
                taken.push([x, y, radius]);
                return (x, y);
            }
        };
        let mut robots = vec![];
        let mut names = vec![];
        for team in messages::Team::ALL {
            let mut identities: Vec<_> =
                config.robots.identities.iter().filter(|identity| identity.team == team).collect();
            while identities.len() > self.robots_each {
                identities.remove(random.between(0.0, identities.len() as f64) as usize);
            }
            for identity in identities {
                let (x, y) = place(random, reach);
                let mut colors = identity.colors.iter();
                let patches = config.robots.patches.iter().map(|patch| {
                    let color = match patch.role {
                        PatchRole::Team => paint_of(config.teams.color(team)),
                        PatchRole::Identification => paint_of(colors.next().unwrap()),
                    };
                    (patch.outline_mm.clone(), color)
                });
                robots.push(Robot {
                    x,
                    y,
                    heading: random.between(-180.0, 180.0).to_radians(),
                    shape: self.shape,
                    height: config.robots.height_mm,
                    patches: patches.collect(),
                });
                names.push((team.name(), identity.id));
            }
        }
        let radius = config.ball.diameter_mm / 2.0;
        // Not so near to a robot that it hides the ball.
        let (x, y) = place(random, 3.0 * radius);
        let ball = Ball { x, y, radius, color: paint_of(&config.ball.color) };
        let lamp = Lamp {
            position: [0.45 * field.length_mm, 0.4 * field.width_mm, 1.2 * self.camera_mm],
            tint: [1.0, 0.93, 0.78],
            ambient: 0.45,
        };
        (Scene { floor: self.floor(config), lamp, robots, balls: vec![ball] }, names)
    }

    fn picture(&self, config: &Config, lens: &Lens, seed: u64, scratch: &Scratch) -> Picture {
        let mut random = Random::new(seed);
        let (scene, names) = self.scene(config, &mut random);
        let file = scratch.path.join(format!("{seed}.png")).display().to_string();
        let file = photograph(&scene, lens, &mut random, &file);
        let robots = scene.robots.iter().zip(names).map(|(robot, (team, id))| {
            let [x, y] = lens.project([robot.x, robot.y, robot.height]);
            let (sin, cos) = robot.heading.sin_cos();
            let ahead = lens.project([robot.x + 20.0 * cos, robot.y + 20.0 * sin, robot.height]);
            let heading = (y - ahead[1]).atan2(ahead[0] - x).to_degrees();
            json!({
                "team": team, "id": id, "x_px": x, "y_px": y, "heading_deg": heading,
                "x_mm": robot.x, "y_mm": robot.y,
            })
        });
        let ball = &scene.balls[0];
        let [x, y] = lens.project([ball.x, ball.y, ball.radius]);
        let ball = json!({ "x_px": x, "y_px": y, "x_mm": ball.x, "y_mm": ball.y });
        Picture { file, robots: robots.collect(), ball }
    }
}

/// Writes a raw Bayer picture.
fn photograph(scene: &Scene, lens: &Lens, random: &mut Random, file: &str) -> PathBuf {
    let light = painter::paint(scene, lens);
    let bytes = painter::expose(&light, lens.width, &Sensor::default(), random);
    image::save_buffer(file, &bytes, lens.width, lens.height, image::ColorType::L8).unwrap();
    file.into()
}

/// A pitch with its geometry set up, and pictures of it.
struct SetUp {
    name: &'static str,
    scratch: Scratch,
    calibrated: String,
    taught: Vec<Picture>,
    tried: Vec<Picture>,
}

impl SetUp {
    fn new(preset: Preset) -> Self {
        let (config, name) = (preset.config(), preset.name());
        let pitch = Pitch::of(preset);
        let scratch = Scratch::new(&format!("pitch-{name}"));
        let lens = pitch.lens(&config);
        scratch.write("match.toml", &format!("preset = \"{name}\"\n"));
        scratch.write("points.toml", &pitch.points(&config, &lens, &mut Random::new(7)));
        let path = |file: &str| scratch.path.join(file).display().to_string();
        let [points, before, calibrated] =
            ["points.toml", "match.toml", "calibrated.toml"].map(path);
        // The empty pitch: the marks are refined on its lines.
        let mut empty = pitch.scene(&config, &mut Random::new(0)).0;
        empty.robots.clear();
        empty.balls.clear();
        let empty = photograph(&empty, &lens, &mut Random::new(0), &path("empty.png"));
        let empty = empty.to_str().unwrap();
        let args = ["calibrate", "--points", &points, "--config", &before, "--picture", empty];
        said_by(&scratch, &[&args[..], &["-o", &calibrated]].concat());
        let picture = |number| pitch.picture(&config, &lens, number, &scratch);
        let taught = (1..=TAUGHT).map(picture).collect();
        let tried = (TAUGHT + 1..=TAUGHT + TRIED).map(picture).collect();
        Self { name, scratch, calibrated, taught, tried }
    }

    fn labels(&self, file: &str, pictures: &[Picture]) -> String {
        let image = |picture: &Picture| json!({ "file": picture.file, "robots": picture.robots, "ball": picture.ball });
        let images: Vec<Value> = pictures.iter().map(image).collect();
        self.scratch.write(file, &json!({ "images": images }).to_string()).display().to_string()
    }

    /// The score of the test pictures, with colours learned with these arguments.
    fn score(&self, learning: &[&str]) -> Value {
        let learned = self.scratch.path.join(format!("learned{}.toml", learning[0]));
        let learned = learned.display().to_string();
        let files = self.taught.iter().map(|picture| picture.file.to_str().unwrap());
        let mut args = vec!["learn", "--config", &self.calibrated, "-o", &learned];
        args.extend(learning.iter().copied().chain(files));
        said_by(&self.scratch, &args);
        let labels = self.labels("tried.json", &self.tried);
        let score = said_by(&self.scratch, &["score", &labels, "--config", &learned, "--json"]);
        let score: Value = serde_json::from_str(&score).unwrap();
        let total = &score["total"];
        let [robots_mm, ball_mm] = self.errors_mm(&learned);
        println!(
            "{} {}: {} of {} robots right, ball in {} of {TRIED} pictures; {robots_mm:.2} mm rms robots, \
             {ball_mm:.2} mm ball",
            self.name, learning[0], total["right"], total["robots"], total["balls_right"],
        );
        assert!(robots_mm < 1.0 && ball_mm < 1.5, "{learning:?}: {robots_mm} mm, {ball_mm} mm");
        score
    }

    /// Root mean square errors of robots under their own names, and of the ball.
    fn errors_mm(&self, config: &str) -> [f64; 2] {
        let (mut robots, mut balls) = (vec![], vec![]);
        for picture in &self.tried {
            let file = picture.file.to_str().unwrap();
            let answer = said_by(&self.scratch, &["detect", "--json", "--config", config, file]);
            let answer: Value = serde_json::from_str(&answer).unwrap();
            let found = answer["robots"].as_array().unwrap();
            for truth in &picture.robots {
                let it =
                    |robot: &&Value| robot["team"] == truth["team"] && robot["id"] == truth["id"];
                robots.extend(found.iter().find(it).map(|robot| distance_mm(robot, truth)));
            }
            if !answer["ball"].is_null() {
                balls.push(distance_mm(&answer["ball"], &picture.ball));
            }
        }
        [robots, balls].map(|errors| {
            let squares: f64 = errors.iter().map(|error| error * error).sum();
            (squares / errors.len() as f64).sqrt()
        })
    }
}

fn distance_mm(a: &Value, b: &Value) -> f64 {
    let [dx, dy] = ["x_mm", "y_mm"].map(|key| a[key].as_f64().unwrap() - b[key].as_f64().unwrap());
    dx.hypot(dy)
}

/// Standard output of the program, which must succeed.
fn said_by(scratch: &Scratch, args: &[&str]) -> String {
    let output = output_of(scratch, args);
    let complaint = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "touchline {}: {complaint}", args.join(" "));
    String::from_utf8(output.stdout).unwrap()
}

fn all_are_found(preset: Preset) {
    let pitch = SetUp::new(preset);
    let taught = pitch.labels("taught.json", &pitch.taught);
    for learning in [&["--samples", &taught][..], &["--auto"]] {
        let score = pitch.score(learning);
        let total = &score["total"];
        assert_eq!(total["wrong_identity"], 0, "{learning:?}: {score:#}");
        assert_eq!(total["phantoms"], 0, "{learning:?}: {score:#}");
        assert_eq!(total["right"], total["robots"], "{learning:?}: {score:#}");
        assert_eq!(total["balls_right"], total["balls"], "{learning:?}: {score:#}");
    }
}

#[test]
fn mirosot_5v5() {
    all_are_found(Preset::Mirosot5v5);
}

#[test]
fn mirosot_triangles() {
    all_are_found(Preset::MirosotTriangles);
}

#[test]
fn mirosot_quadrants() {
    all_are_found(Preset::MirosotQuadrants);
}

#[test]
fn mirosot_large() {
    all_are_found(Preset::MirosotLarge);
}

#[test]
fn vsss_3v3() {
    all_are_found(Preset::Vsss3v3);
}

#[test]
fn vsss_corner() {
    all_are_found(Preset::VsssCorner);
}

#[test]
fn ssl_division_b() {
    all_are_found(Preset::SslDivisionB);
}

/// Without any marks, on pictures with robots in them: the pitch is where the lens projects it.
#[test]
fn every_pitch_is_found_without_marks() {
    let mut off = Vec::new();
    for preset in [Preset::Mirosot5v5, Preset::MirosotLarge, Preset::Vsss3v3, Preset::SslDivisionB]
    {
        let (config, name) = (preset.config(), preset.name());
        let pitch = Pitch::of(preset);
        let scratch = Scratch::new(&format!("found-{name}"));
        let lens = pitch.lens(&config);
        let before = scratch.write("match.toml", &format!("preset = \"{name}\"\n"));
        let picture = pitch.picture(&config, &lens, 1, &scratch);
        let path = |file: &str| scratch.path.join(file).display().to_string();
        let (found, height) = (path("found.toml"), pitch.camera_mm.to_string());
        let args = ["calibrate", "--config", before.to_str().unwrap(), "-o", &found];
        let more = ["--camera-height-mm", &height, "--picture", picture.file.to_str().unwrap()];
        let output = output_of(&scratch, &[&args[..], &more].concat());
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        if !output.status.success() {
            off.push(format!("{name}: {said}"));
            continue;
        }
        let found = Config::load(found.as_ref()).unwrap();
        let camera = &found.camera;
        let model = CameraModel::new(&found.geometry, camera.width, camera.height).unwrap();
        let [x, y] = [config.field.length_mm / 2.0, config.field.width_mm / 2.0];
        let places = [[-x, y], [x, y], [x, -y], [-x, -y], [0.0, 0.0], [0.0, y], [x, 0.0]];
        let worst_px = places.map(|[x, y]| {
            let (seen, truth) =
                (model.image_from_field(FieldPoint::new(x, y), 0.0), lens.project([x, y, 0.0]));
            (seen.x_px - truth[0]).hypot(seen.y_px - truth[1])
        });
        let worst_px = worst_px.into_iter().fold(0.0, f64::max);
        println!("{name}: {worst_px:.2} px at most");
        if worst_px > 1.0 {
            off.push(format!("{name}: {worst_px} px off"));
        }
    }
    assert!(off.is_empty(), "{}", off.join("\n"));
}
