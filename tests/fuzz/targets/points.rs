//! Calibration with any names of points, and any points. An accepted camera sees each of them at its
//! mark, within the tolerance.
#![no_main]

use offline::calibration::{KnownLens, Mark, calibrate, resolve_landmark};
use config::Config;
use libfuzzer_sys::fuzz_target;

const WITHIN_PX: f64 = 3.0;
/// The more points, the longer a fit takes; a dozen are as good as a hundred here.
const MOST_POINTS: usize = 12;

/// A plausible number or, rarely, any at all.
fn number(bytes: &[u8], scale: f64) -> f64 {
    let value = u16::from_le_bytes([bytes[0], bytes[1]]);
    match value {
        0xffff => f64::NAN,
        0xfffe => f64::INFINITY,
        0xfffd => -1e300,
        _ => (f64::from(value) / 32768.0 - 1.0) * scale,
    }
}

fuzz_target!(|bytes: &[u8]| {
    let Some((&kind, rest)) = bytes.split_first() else { return };
    let config = Config::default();
    if let Ok(name) = std::str::from_utf8(rest) {
        let wall = (kind & 1 == 1).then_some(f64::from(kind));
        if let Ok(place) = resolve_landmark(name, &config.field, wall) {
            assert!(place.iter().all(|value| value.is_finite()), "{name}: {place:?}");
        }
    }
    let marks: Vec<Mark> = rest
        .chunks_exact(9)
        .take(MOST_POINTS)
        .map(|bytes| {
            let height = if bytes[8] & 1 == 1 { f64::from(bytes[8]) } else { 0.0 };
            Mark {
                field_mm: [number(&bytes[..2], 1200.0), number(&bytes[2..4], 1000.0), height],
                image_px: [number(&bytes[4..6], 700.0), number(&bytes[6..8], 700.0)],
            }
        })
        .collect();
    let height_mm = f64::from(kind) * 20.0;
    let lens = match kind % 3 {
        0 => KnownLens::Guess([0.0, 0.0, height_mm]),
        1 => KnownLens::HeightMm(height_mm),
        _ => KnownLens::Position([f64::from(kind), 0.0, height_mm]),
    };
    let Ok(found) = calibrate(&marks, lens, &config.field, &config.camera, WITHIN_PX) else {
        return;
    };
    assert_eq!(found.errors_px.len(), marks.len());
    let (_, worst) = found.worst();
    assert!(worst <= WITHIN_PX * 1.01, "{worst} px");
});
