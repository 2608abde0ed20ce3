use super::*;
use crate::regions::RegionFinder;
use bytemuck::Zeroable;
use config::Config;
use messages::{Run, Team};

/// Candidates for the yellow team patch among yellow rectangles [left, top, right, bottom), the
/// right and bottom ends not included; nine pixels are about a patch.
fn yellow_candidates(rectangles: &[[u16; 4]]) -> (CandidateFinder, usize) {
    let config = Config::default();
    let pattern = Pattern::new(&config).unwrap();
    let kind = pattern.team_kinds(Team::Yellow)[0];
    let mut runs = Vec::new();
    for row in 0..480u16 {
        let mut columns: Vec<u16> = rectangles
            .iter()
            .filter(|[_, top, _, bottom]| (*top..*bottom).contains(&row))
            .flat_map(|[left, _, right, _]| *left..*right)
            .collect();
        columns.sort_unstable();
        for stretch in columns.chunk_by(|a, b| a + 1 == *b) {
            let (begin, end) = (stretch[0], stretch[stretch.len() - 1] + 1);
            let class = pattern.kinds[kind].class as u8;
            runs.push(Run { row, begin, end, class, reserved: 0 });
        }
    }
    let mut frame = Box::new(DetectionFrame::zeroed());
    RegionFinder::new(640, 480, 8, 8).find(&runs, &mut frame);
    let camera = CameraModel::new(&config.geometry, 640, 480).unwrap();
    let mut finder = CandidateFinder::default();
    let mut index = ClassIndex::default();
    index.fill(&frame);
    finder.find(&pattern, &camera, &Pitch::new(&config), &frame, &index);
    (finder, kind)
}

#[test]
fn a_patch_is_a_candidate() {
    let (finder, kind) = yellow_candidates(&[[300, 200, 309, 209]]);
    let [candidate] = finder.of_kind(kind) else { panic!("{:?}", finder.of_kind(kind)) };
    assert!((900.0..1400.0).contains(&candidate.measure.area_mm2), "{candidate:?}");
    assert!((candidate.measure.image.x_px - 304.0).abs() < 1e-9);
}

#[test]
fn rims_around_patches_are_not() {
    // A rim one pixel wide around a patch, half of one two pixels wide, and a string.
    for rim in [
        vec![
            [300, 200, 311, 201],
            [300, 201, 301, 210],
            [310, 201, 311, 210],
            [300, 210, 311, 211],
        ],
        vec![[300, 200, 313, 202], [300, 202, 302, 213]],
        vec![[300, 200, 330, 201]],
        vec![[300, 200, 322, 202]],
    ] {
        let (finder, kind) = yellow_candidates(&rim);
        assert_eq!(finder.by_height[0].all().len(), 1, "{rim:?} is not one region");
        assert!(finder.of_kind(kind).is_empty(), "{rim:?}: {:?}", finder.of_kind(kind));
    }
}

#[test]
fn fragments_are_averaged_by_weight() {
    let (finder, kind) = yellow_candidates(&[[300, 200, 304, 209], [305, 200, 309, 209]]);
    let merged = finder.of_kind(kind)[0];
    assert_eq!(merged.parts().len(), 2);
    assert!((merged.measure.image.x_px - 304.0).abs() < 1e-3, "{merged:?}");
    // The halves alone stay possible, but less likely.
    assert!(finder.of_kind(kind)[1..].iter().all(|candidate| candidate.parts().len() == 1));
    assert_eq!(finder.of_kind(kind).len(), 3);
}

#[test]
fn two_patches_side_by_side_are_not_averaged() {
    let (finder, kind) = yellow_candidates(&[[300, 200, 309, 209], [310, 200, 319, 209]]);
    assert_eq!(finder.of_kind(kind).len(), 2);
    assert!(finder.of_kind(kind).iter().all(|candidate| candidate.parts().len() == 1));
}

#[test]
fn two_patches_grown_together_come_apart() {
    let (finder, kind) = yellow_candidates(&[[300, 200, 317, 209]]);
    let pieces: Vec<&Candidate> =
        finder.of_kind(kind).iter().filter(|candidate| candidate.seed().pieces == 2).collect();
    let [a, b] = pieces[..] else { panic!("{:?}", finder.of_kind(kind)) };
    assert!(!a.overlaps(b));
    let whole = finder.of_kind(kind).iter().find(|c| c.seed().pieces == 1).unwrap();
    assert!(whole.overlaps(a) && whole.overlaps(b));
}

#[test]
fn regions_outside_the_pitch_are_not_candidates() {
    // Beside a goal, behind the goal line; and a proper one.
    let (finder, kind) = yellow_candidates(&[[4, 60, 13, 69], [300, 200, 309, 209]]);
    let outside: Vec<bool> =
        finder.by_height[0].all().iter().map(|measured| measured.outside).collect();
    assert_eq!(outside.iter().filter(|&&outside| outside).count(), 1);
    let [candidate] = finder.of_kind(kind) else { panic!("{:?}", finder.of_kind(kind)) };
    assert!((candidate.measure.image.x_px - 304.0).abs() < 1e-9);
}
