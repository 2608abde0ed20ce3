//! Robot tops by league: arrangements of patches, and the colours of each robot.

use super::{IdentityConfig, Pair, PatchConfig, PatchRole};
use messages::Team;

/// The corners of a square.
fn square(center: Pair, side: f64) -> Vec<Pair> {
    rectangle(center, [side, side])
}

/// The corners of a rectangle with sides along x and y.
fn rectangle([x, y]: Pair, [along_x, along_y]: Pair) -> Vec<Pair> {
    let (a, b) = (along_x / 2.0, along_y / 2.0);
    vec![[x + a, y + b], [x - a, y + b], [x - a, y - b], [x + a, y - b]]
}

/// The paper's layout (Fig. 2): two squares on a diagonal, the team's nearer to the front.
pub(super) fn diagonal_squares() -> Vec<PatchConfig> {
    vec![
        PatchConfig { role: PatchRole::Team, outline_mm: square([18.0, 18.0], 34.0) },
        PatchConfig { role: PatchRole::Identification, outline_mm: square([-18.0, -18.0], 34.0) },
    ]
}

/// A stripe of the team colour across the front half, and two identification squares behind it.
pub(super) fn stripe_and_two_patches() -> Vec<PatchConfig> {
    vec![
        PatchConfig { role: PatchRole::Team, outline_mm: rectangle([18.5, 0.0], [33.0, 70.0]) },
        PatchConfig { role: PatchRole::Identification, outline_mm: square([-18.5, 18.5], 33.0) },
        PatchConfig { role: PatchRole::Identification, outline_mm: square([-18.5, -18.5], 33.0) },
    ]
}

/// A square of 65 mm, cut along a diagonal. The front left half has the team's colour; the rear right
/// half is cut into two triangles with identification colours, the rear left one first.
pub(super) fn triangles() -> Vec<PatchConfig> {
    let half = 32.5;
    let identification = |outline_mm| PatchConfig { role: PatchRole::Identification, outline_mm };
    vec![
        PatchConfig {
            role: PatchRole::Team,
            outline_mm: vec![[half, half], [-half, half], [half, -half]],
        },
        identification(vec![[0.0, 0.0], [-half, half], [-half, -half]]),
        identification(vec![[0.0, 0.0], [-half, -half], [half, -half]]),
    ]
}

/// Four squares: the team's at the front left, identification squares at the front right, rear left and
/// rear right.
pub(super) fn quadrants() -> Vec<PatchConfig> {
    let identification =
        |center| PatchConfig { role: PatchRole::Identification, outline_mm: square(center, 34.0) };
    vec![
        PatchConfig { role: PatchRole::Team, outline_mm: square([18.0, 18.0], 34.0) },
        identification([18.0, -18.0]),
        identification([-18.0, 18.0]),
        identification([-18.0, -18.0]),
    ]
}

/// A square of 66 mm in the team's colour, with an identification square in its front left corner.
pub(super) fn corner_patch() -> Vec<PatchConfig> {
    vec![
        PatchConfig { role: PatchRole::Team, outline_mm: square([0.0, 0.0], 66.0) },
        PatchConfig { role: PatchRole::Identification, outline_mm: square([20.0, 20.0], 26.0) },
    ]
}

/// The standard pattern of the Small Size League: the team's dot of 50 mm in the middle, and dots of 40
/// mm at the front left and right and the rear left and right, all 65 mm from the middle.
pub(super) fn butterfly() -> Vec<PatchConfig> {
    let identification =
        |center| PatchConfig { role: PatchRole::Identification, outline_mm: dot(center, 40.0) };
    let (near, far) = (35.0, 54.772);
    vec![
        PatchConfig { role: PatchRole::Team, outline_mm: dot([0.0, 0.0], 50.0) },
        identification([near, far]),
        identification([near, -far]),
        identification([-far, near]),
        identification([-far, -near]),
    ]
}

/// A regular polygon with the area of a disc.
fn dot([x, y]: Pair, diameter: f64) -> Vec<Pair> {
    const CORNERS: u32 = 24;
    let step = std::f64::consts::TAU / f64::from(CORNERS);
    // A polygon of n corners has the area n/2·sin(2π/n)·r², a disc n/2·(2π/n)·r².
    let radius = diameter / 2.0 * (step / step.sin()).sqrt();
    let corner = |index: u32| {
        let (sin, cos) = (step * f64::from(index)).sin_cos();
        [x + radius * cos, y + radius * sin].map(|value| (value * 1e3).round() / 1e3)
    };
    (0..CORNERS).map(corner).collect()
}

/// Identification colours of the standard palette.
const IDENTIFICATION_COLORS: [&str; 5] = ["green", "cyan", "pink", "violet", "red"];

/// Robots 0 to `count` − 1 of both teams, each with its own identification colour.
pub(super) fn one_color_identities(count: u32) -> Vec<IdentityConfig> {
    identities(count, |id| vec![IDENTIFICATION_COLORS[id as usize].to_string()])
}

/// Robots 0 to `count` − 1 of both teams, each with an ordered pair of two different colours.
pub(super) fn two_color_identities(count: u32) -> Vec<IdentityConfig> {
    let pairs: Vec<Vec<String>> = IDENTIFICATION_COLORS
        .iter()
        .flat_map(|left| {
            IDENTIFICATION_COLORS
                .iter()
                .filter(move |&right| right != left)
                .map(move |right| vec![left.to_string(), right.to_string()])
        })
        .collect();
    identities(count, |id| pairs[id as usize].clone())
}

/// Robots 0 to `count` − 1 of both teams, each with its own set of three different colours.
pub(super) fn three_color_identities(count: u32) -> Vec<IdentityConfig> {
    identities(count, |id| {
        // Each set starts one colour later.
        let color = |step: usize| {
            IDENTIFICATION_COLORS[(id as usize + step) % IDENTIFICATION_COLORS.len()].to_string()
        };
        vec![color(0), color(1), color(2)]
    })
}

/// Robots of both teams, numbered in the order of these colours.
pub(super) fn identities_of_colors(colors: Vec<Vec<String>>) -> Vec<IdentityConfig> {
    identities(colors.len() as u32, |id| colors[id as usize].clone())
}

/// Colours of the Small Size League's sixteen robots, in the order of [`butterfly`]: front left and
/// right, rear left and right.
pub(super) fn standard_patterns() -> Vec<Vec<String>> {
    const PATTERNS: [&str; 16] = [
        "ppgp", "gpgp", "gggp", "pggp", "pppg", "gppg", "ggpg", "pgpg", "gggg", "pppp", "ppgg",
        "ggpp", "gpgg", "gppp", "pggg", "pgpp",
    ];
    let color = |letter| if letter == 'g' { "green" } else { "pink" };
    let pattern = |letters: &str| letters.chars().map(|letter| color(letter).to_string()).collect();
    PATTERNS.iter().map(|letters| pattern(letters)).collect()
}

fn identities(count: u32, colors: impl Fn(u32) -> Vec<String>) -> Vec<IdentityConfig> {
    Team::ALL
        .into_iter()
        .flat_map(|team| (0..count).map(move |id| (team, id)))
        .map(|(team, id)| IdentityConfig::new(team, id, colors(id)))
        .collect()
}
