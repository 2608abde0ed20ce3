//! Conversion of a colour picture to the raw data of a sensor with a Bayer colour filter array.

use messages::BayerOrder;

/// Keeps, for each pixel of `rgb` (three bytes per pixel, rows of `width`), only the colour of its filter.
pub fn mosaic(rgb: &[u8], width: usize, order: BayerOrder, frame: &mut [u8]) {
    for (index, (pixel, site)) in rgb.chunks_exact(3).zip(frame).enumerate() {
        *site = pixel[order.channel_at(index % width, index / width)];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_site_keeps_its_own_colour() {
        let rgb = [1, 2, 3].repeat(4);
        let frames = BayerOrder::ALL.map(|order| {
            let mut frame = [0; 4];
            mosaic(&rgb, 2, order, &mut frame);
            frame
        });
        assert_eq!(frames, [[1, 2, 2, 3], [2, 1, 3, 2], [2, 3, 1, 2], [3, 2, 2, 1]]);
    }
}
