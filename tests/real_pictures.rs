//! `touchline detect` on photographs of real pitches, with everything in them labelled by hand.
//!
//! The photographs are not ours to redistribute: they are looked for beside the checkout, and
//! without them nothing is tested here, loudly. What is printed (`--nocapture`) is the score of
//! every picture.

mod support;

use serde_json::Value;
use std::path::{Path, PathBuf};
use support::{Scratch, output_of};

/// A labelled picture, and what `detect` says about it.
struct Picture {
    name: String,
    labels: Value,
    answer: Value,
}

/// How far a robot lies from its label.
struct Offset {
    px: f64,
    deg: f64,
}

fn number(object: &Value, key: &str) -> f64 {
    object[key].as_f64().unwrap_or_else(|| panic!("no {key} in {object:#}"))
}

fn distance_px(a: &Value, [x, y]: [f64; 2]) -> f64 {
    (number(a, "x_px") - x).hypot(number(a, "y_px") - y)
}

fn place(object: &Value) -> [f64; 2] {
    [number(object, "x_px"), number(object, "y_px")]
}

fn list<'a>(object: &'a Value, key: &str) -> &'a [Value] {
    object[key].as_array().unwrap_or_else(|| panic!("no {key} in {object:#}"))
}

fn is_clear(label: &Value) -> bool {
    label["quality"] == "clear"
}

/// Runs `detect` with `tests/data/<set>.toml` on all labelled pictures of a set; `None` if they are
/// not there.
fn detect(set: &str) -> Option<Vec<Picture>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = root.join("../shared/real").join(set);
    let Ok(labels) = std::fs::read_to_string(folder.join("labels.json")) else {
        eprintln!("SKIPPED: the labelled pictures {} are not there", folder.display());
        return None;
    };
    let labels: Value = serde_json::from_str(&labels).unwrap();
    let paths: Vec<PathBuf> = list(&labels, "images")
        .iter()
        .map(|image| folder.join(image["file"].as_str().unwrap()))
        .collect();
    let config = root.join("tests/data").join(format!("{set}.toml"));
    let mut args = vec!["detect", "--json", "--config", config.to_str().unwrap()];
    args.extend(paths.iter().map(|path| path.to_str().unwrap()));
    let output = output_of(&Scratch::new(&format!("real-{set}")), &args);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    let answers: Vec<Value> =
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(answers.len(), paths.len());
    let pictures = list(&labels, "images").iter().zip(answers).map(|(labels, answer)| Picture {
        name: labels["file"].as_str().unwrap().to_string(),
        labels: labels.clone(),
        answer,
    });
    Some(pictures.collect())
}

impl Picture {
    fn clear_robots(&self) -> impl Iterator<Item = &Value> {
        list(&self.labels, "robots").iter().filter(|label| is_clear(label))
    }

    fn robots(&self) -> &[Value] {
        list(&self.answer, "robots")
    }

    /// How well the robot of a label was found: under its own name.
    fn offset(&self, label: &Value) -> Option<Offset> {
        let is_it =
            |robot: &&Value| (&robot["team"], &robot["id"]) == (&label["team"], &label["id"]);
        let robot = self.robots().iter().find(is_it)?;
        let turned = number(robot, "heading_image_deg") - number(label, "heading_deg");
        let deg = ((turned + 180.0).rem_euclid(360.0) - 180.0).abs();
        Some(Offset { px: distance_px(robot, place(label)), deg })
    }

    /// Names of robots that stand where somebody else does, or nobody.
    fn wrong_robots(&self, reach_px: f64) -> Vec<String> {
        let labels = list(&self.labels, "robots");
        let is_right = |robot: &Value| {
            labels.iter().any(|label| {
                (&robot["team"], &robot["id"]) == (&label["team"], &label["id"])
                    && distance_px(robot, place(label)) < reach_px
            })
        };
        let wrong = self.robots().iter().filter(|robot| !is_right(robot));
        wrong.map(|robot| format!("{} {}", robot["team"], robot["id"])).collect()
    }

    /// Whether something of the team's colour was seen where the label's robot has its team patch:
    /// in a robot, under whatever name, or as a rejected candidate. The patch lies ahead of the
    /// centre.
    fn shows_team_patch(&self, label: &Value, ahead_px: f64, reach_px: f64) -> bool {
        let [x, y] = place(label);
        let (sin, cos) = number(label, "heading_deg").to_radians().sin_cos();
        let patch = [x + ahead_px * cos, y - ahead_px * sin];
        let is_of_team = |found: &&Value| found["team"] == label["team"];
        let robots = self.robots().iter().filter(is_of_team);
        let rejected = list(&self.answer, "rejected").iter().filter(is_of_team);
        robots.map(|robot| distance_px(robot, [x, y])).any(|distance| distance < reach_px)
            || rejected.map(|found| distance_px(found, patch)).any(|distance| distance < reach_px)
    }

    /// Distance of the ball from its label; `None` if it has none.
    fn ball_offset_px(&self) -> Option<f64> {
        let label = self.labels["ball"].as_object().map(|_| &self.labels["ball"])?;
        let ball = &self.answer["ball"];
        let offset = if ball.is_null() { f64::INFINITY } else { distance_px(ball, place(label)) };
        Some(offset)
    }
}

#[test]
fn every_robot_and_the_ball_of_the_vsss_pitch_are_found() {
    let Some(pictures) = detect("vsss") else { return };
    for picture in &pictures {
        for label in picture.clear_robots() {
            let name = format!("{}: {} {}", picture.name, label["team"], label["id"]);
            let Some(offset) = picture.offset(label) else {
                panic!("{name} is not found: {:#}", picture.answer)
            };
            println!("{name}: {:.2} px, {:.1}°", offset.px, offset.deg);
            assert!(offset.px <= 2.0 && offset.deg <= 5.0, "{name}: {:#}", picture.answer);
        }
        assert_eq!(picture.wrong_robots(2.0), Vec::<String>::new(), "{}", picture.name);
        let ball = picture.ball_offset_px();
        println!("{}: ball {ball:.2?} px", picture.name);
        assert!(ball.is_none_or(|offset| offset <= 2.0), "{}: {:#}", picture.name, picture.answer);
    }
}

/// Clear robots of all pictures that `agh.toml` finds under their own name within 3 px and 6°, less
/// a few.
const AGH_COMPLETE_AT_LEAST: usize = 45;
/// Robots of all pictures that may be taken for another: under the bluest lamp red looks violet.
const AGH_WRONG_AT_MOST: usize = 2;

#[test]
fn team_patches_and_the_ball_of_the_mirosot_pitch_are_found_under_all_lamps() {
    let Some(pictures) = detect("agh") else { return };
    let (mut complete, mut clear, mut mistaken) = (0, 0, 0);
    for picture in &pictures {
        let (mut named, mut patches, mut here) = (0, 0, 0);
        let mut unseen = Vec::new();
        for label in picture.clear_robots() {
            here += 1;
            // The team's half of a tag of 65 mm has its centroid 15 mm ahead.
            if picture.shows_team_patch(label, 3.5, 4.0) {
                patches += 1;
            } else {
                unseen.push(format!("{} {}", label["team"], label["id"]));
            }
            let offset = picture.offset(label);
            named +=
                usize::from(offset.is_some_and(|offset| offset.px <= 3.0 && offset.deg <= 6.0));
        }
        let wrong = picture.wrong_robots(3.0);
        let ball = picture.ball_offset_px();
        println!(
            "{}: {patches} of {here} team patches, {named} complete, wrong {wrong:?}, ball {ball:.2?} px",
            picture.name
        );
        assert!(unseen.is_empty(), "{}: no team patch of {unseen:?}", picture.name);
        assert!(ball.is_none_or(|offset| offset <= 2.0), "{}: {:#}", picture.name, picture.answer);
        complete += named;
        mistaken += wrong.len();
        clear += here;
    }
    println!("complete: {complete} of {clear}");
    assert!(complete >= AGH_COMPLETE_AT_LEAST, "complete: {complete} of {clear}");
    assert!(mistaken <= AGH_WRONG_AT_MOST, "{mistaken} of {clear} taken for another");
}
