//! The group's configuration as a page draws it, and messages in its terms: positions in the picture, names,
//! reasons in words. Pure.

mod field;
pub mod messages;

use ::messages::Team;
use classifier::second_look::SecondLook;
use config::Config;
use config::snapshot::Snapshot;
use geometry::settings::{Pair, PatchRole};
use geometry::{CameraModel, FieldPoint, Pose};
use serde_json::{Value, json};

/// A configuration, ready for drawing.
pub struct Scene {
    /// The configuration.
    pub config: Config,
    /// Its revision.
    pub revision: u32,
    camera: CameraModel,
}

impl Scene {
    /// The scene of a configuration; `None` if its geometry cannot be used.
    pub fn new(snapshot: &Snapshot) -> Option<Self> {
        let Config { geometry, camera: picture, .. } = &snapshot.config;
        let camera = CameraModel::new(geometry, picture.width, picture.height).ok()?;
        let revision = snapshot.revision.number;
        Some(Self { config: snapshot.config.clone(), revision, camera })
    }

    /// Where a point of the field, in millimetres and so high above the floor, appears in the picture.
    fn px(&self, [x_mm, y_mm]: Pair, height_mm: f64) -> Pair {
        let seen = self.camera.image_from_field(FieldPoint::new(x_mm, y_mm), height_mm);
        [round(seen.x_px, 2), round(seen.y_px, 2)]
    }

    /// Where the floor is that a pixel shows, in millimetres.
    pub fn field_mm(&self, x_px: f64, y_px: f64) -> Pair {
        let point = self.camera.field_from_image(geometry::ImagePoint::new(x_px, y_px), 0.0);
        [round(point.x_mm, 1), round(point.y_mm, 1)]
    }

    /// Names of the colours that admit a pixel, by boxes and by hue and saturation, before any correction of
    /// the light.
    pub fn colors_of(&self, rgb: [u8; 3]) -> Vec<&str> {
        let is_in = |bounds: [u8; 2], value| (bounds[0]..=bounds[1]).contains(&value);
        let admits = |color: &&config::ColorConfig| {
            let boxes = [color.red, color.green, color.blue];
            let look = SecondLook::new(color).ok().flatten();
            boxes.into_iter().zip(rgb).all(|(bounds, value)| is_in(bounds, value))
                && look.is_none_or(|look| look.admits(rgb))
        };
        self.config.colors.iter().filter(admits).map(|color| color.name.as_str()).collect()
    }

    /// Outline of a robot's top in the picture, and its heading from the centre to the front.
    fn robot_px(&self, team: u32, id: Option<u32>, pose: Pose) -> (Vec<Pair>, [Pair; 2]) {
        let top = self.config.top(team, id);
        let body = self.config.robots.body(top.patches);
        let at = |point: Pair| {
            let point = pose.field_from_robot(point);
            self.px([point.x_mm, point.y_mm], top.height_mm)
        };
        let outline = body.outline().into_iter().map(at).collect();
        (outline, [at([0.0, 0.0]), at([body.front_mm(), 0.0])])
    }

    /// Everything that is needed to draw, and does not change from frame to frame.
    pub fn model(&self) -> Value {
        let Config { camera, colors, teams, robots, ball, field, .. } = &self.config;
        let body = robots.body(&robots.patches);
        let color = |(class, color): (usize, &config::ColorConfig)| json!({ "class": class, "name": color.name, "looks": color.looks });
        let robot = |it: &config::IdentityConfig| {
            json!({
                "team": it.team.name(), "identity": it.id, "name": name(it.team as u32, Some(it.id)),
                "colors": it.colors,
            })
        };
        let patch = |patch: &geometry::settings::PatchConfig| {
            let role = match patch.role {
                PatchRole::Team => "team",
                PatchRole::Identification => "identification",
            };
            json!({ "role": role, "polygon_mm": patch.outline_mm })
        };
        let lines = field::lines_mm(&self.config);
        let on_floor =
            |line: &Vec<Pair>| line.iter().map(|&point| self.px(point, 0.0)).collect::<Vec<_>>();
        let lines_px: Vec<_> = lines.iter().map(|line| on_floor(&field::finer(line))).collect();
        let outline = field::finer(&field::outline_mm(field, 0.0));
        let mask = field.mask.then(|| field::finer(&field::outline_mm(field, field.margin_mm)));
        json!({
            "revision": self.revision,
            "picture": { "width": camera.width, "height": camera.height, "fps": camera.fps },
            "colors": colors.iter().enumerate().map(color).collect::<Vec<_>>(),
            "teams": {
                "yellow": { "color": teams.color(Team::Yellow) },
                "blue": { "color": teams.color(Team::Blue) },
            },
            "robots": robots.identities.iter().map(robot).collect::<Vec<_>>(),
            "body": {
                "outline_mm": body.outline(), "front_mm": body.front_mm(),
                "height_mm": robots.height_mm,
                "patches": robots.patches.iter().map(patch).collect::<Vec<_>>(),
            },
            "ball": { "radius_mm": ball.diameter_mm / 2.0, "color": ball.color },
            "field": {
                "length_mm": field.length_mm, "width_mm": field.width_mm,
                "lines_mm": lines, "lines_px": lines_px, "outline_px": on_floor(&outline),
            },
            "mask_px": mask.map(|mask| on_floor(&mask)),
        })
    }
}

/// `yellow 3`; `yellow` if the number is unknown.
fn name(team: u32, id: Option<u32>) -> String {
    let team = Team::from_number(team).map_or("robot", Team::name);
    id.map_or_else(|| team.into(), |id| format!("{team} {id}"))
}

/// To so many decimals, to keep messages small.
fn round(value: f64, decimals: i32) -> f64 {
    let factor = 10f64.powi(decimals);
    (value * factor).round() / factor
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Preset;

    #[test]
    fn every_preset_can_be_drawn() {
        for preset in Preset::ALL {
            let scene = Scene::new(&Snapshot::first(preset.config())).unwrap();
            let model = scene.model();
            let outline = model["field"]["outline_px"].as_array().unwrap();
            assert!(outline.len() > 8);
            for point in outline {
                let (x, y) = (point[0].as_f64().unwrap(), point[1].as_f64().unwrap());
                let camera = &scene.config.camera;
                assert!((0.0..f64::from(camera.width)).contains(&x), "{}: {x}", preset.name());
                assert!((0.0..f64::from(camera.height)).contains(&y), "{}: {y}", preset.name());
                let [x_mm, y_mm] = scene.field_mm(x, y);
                assert!(x_mm.abs() <= scene.config.field.length_mm / 2.0 + 20.0);
                assert!(y_mm.abs() <= scene.config.field.width_mm / 2.0 + 20.0);
            }
            assert_eq!(model["revision"], 1);
        }
    }
}
