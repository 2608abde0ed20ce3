//! Conversion from YUV to RGB, for colours without a box in YUV, for the second look, and for overlays.

/// The RGB colour of a YUV pixel: ITU-R BT.601 with Y from 16 to 235 and U, V from 16 to 240 around 128, the
/// default of V4L2. In fixed point with 8 fractional bits, rounded half up, and clipped to 0–255:
///
/// ```text
/// R = 1.164 (Y − 16)                     + 1.596 (V − 128)
/// G = 1.164 (Y − 16) − 0.391 (U − 128)   − 0.813 (V − 128)
/// B = 1.164 (Y − 16) + 2.016 (U − 128)
/// ```
#[inline(always)]
pub fn rgb_from_yuv([y, u, v]: [u8; 3]) -> [u8; 3] {
    let y = 298 * (i32::from(y) - 16);
    let (u, v) = (i32::from(u) - 128, i32::from(v) - 128);
    [y + 409 * v, y - 100 * u - 208 * v, y + 516 * u]
        .map(|value| ((value + 128) >> 8).clamp(0, 255) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_standards_colors_are_converted() {
        for (yuv, rgb) in [
            ([16, 128, 128], [0, 0, 0]),
            ([235, 128, 128], [255, 255, 255]),
            ([126, 128, 128], [128, 128, 128]),
            ([81, 90, 240], [255, 0, 0]),
            ([145, 54, 34], [0, 255, 1]), // the standard's codes are rounded themselves
            ([41, 240, 110], [0, 0, 255]),
            ([0, 0, 0], [0, 135, 0]),
            ([255, 255, 255], [255, 125, 255]),
        ] {
            let got = rgb_from_yuv(yuv);
            let distance = (0..3).map(|i| got[i].abs_diff(rgb[i])).max();
            assert!(distance <= Some(1), "{yuv:?}: {got:?}, not {rgb:?}");
        }
    }

    #[test]
    fn it_agrees_with_the_formula_in_real_numbers() {
        for index in 0..4096u32 {
            let yuv = [index / 256 * 17, index / 16 % 16 * 17, index % 16 * 17].map(|v| v as u8);
            let [y, u, v] = yuv.map(f64::from);
            let (y, u, v) = (255.0 / 219.0 * (y - 16.0), u - 128.0, v - 128.0);
            let (to_v, to_u) = (1.402 * 255.0 / 224.0, 1.772 * 255.0 / 224.0);
            let green = y - (0.114 * to_u * u + 0.299 * to_v * v) / 0.587;
            let real = [y + to_v * v, green, y + to_u * u];
            for (got, real) in rgb_from_yuv(yuv).into_iter().zip(real) {
                assert!((f64::from(got) - real.clamp(0.0, 255.0)).abs() < 1.0, "{yuv:?}");
            }
        }
    }
}
