//! Tells pictures without colours: a grey photograph, or a camera without a colour filter, passes for a raw Bayer
//! frame, and then no robot is found, without an error.
//!
//! In a raw frame of a coloured place some small even area exists in which the filter's colours differ. In a
//! grey picture they differ only where the brightness changes, that is, in uneven areas.

/// What is wrong, and why it matters.
pub const COLORLESS: &str =
    "no pixel has a colour: these look like grey photographs, and robots are told by colours";

/// Side of the areas examined.
const AREA: usize = 4;
/// Grey levels by which the sites of one colour may differ in an even area, and by which the sites of
/// two colours must differ in a coloured one.
const EVEN: u8 = 16;
const COLORED: u32 = 24;
/// Fewest coloured areas of a coloured picture: fewer than a patch has.
const LEAST_AREAS: usize = 2;

/// Whether there is an even area in which the filter's colours differ, in a Bayer frame of `width` pixels in a
/// row and `stride` bytes from row to row.
pub fn has_color(frame: &[u8], width: usize, stride: usize) -> bool {
    let rows: Vec<&[u8]> = frame.chunks(stride.max(1)).filter(|row| row.len() >= width).collect();
    let mut areas = 0;
    for band in rows.chunks_exact(AREA) {
        for left in (0..width.saturating_sub(AREA - 1)).step_by(AREA) {
            let mut means = [0; 4];
            let mut is_even = true;
            for (site, mean) in means.iter_mut().enumerate() {
                let values = (0..AREA * AREA / 4).map(|index| {
                    let (x, y) = (index % (AREA / 2), index / (AREA / 2));
                    band[2 * y + site / 2][left + 2 * x + site % 2]
                });
                let (least, most) = values
                    .clone()
                    .fold((u8::MAX, 0), |(least, most), value| (least.min(value), most.max(value)));
                is_even &= most - least <= EVEN;
                *mean = values.map(u32::from).sum::<u32>() / (AREA * AREA / 4) as u32;
            }
            let spread = means.iter().max().unwrap_or(&0) - means.iter().min().unwrap_or(&0);
            areas += usize::from(is_even && spread >= COLORED);
            if areas >= LEAST_AREAS {
                return true;
            }
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coloured_patch_is_a_colour_and_a_grey_gradient_is_none() {
        let (width, stride) = (64, 70);
        let grey: Vec<u8> = (0..stride * 48).map(|index| (index % stride * 3) as u8).collect();
        assert!(!has_color(&grey, width, stride));
        let mut colored = grey;
        for row in 20..30 {
            for column in 20..30 {
                let is_red = row % 2 == 0 && column % 2 == 0;
                colored[row * stride + column] = if is_red { 200 } else { 60 };
            }
        }
        assert!(has_color(&colored, width, stride));
        assert!(!has_color(&[], width, stride));
    }
}
