//! Supported pixel formats of GenICam, and frame numbers of its cameras.

use messages::BayerOrder::{self, *};
use messages::PixelFormat::{self, *};

/// The names and numbers of the supported formats (GenICam's Pixel Format Naming Convention), best first: raw
/// formats preserve all sensor data, and take the least bandwidth.
pub const USABLE: [(&str, u32, PixelFormat, BayerOrder); 19] = [
    ("BayerRG8", 0x0108_0009, Bayer8, Rggb),
    ("BayerGR8", 0x0108_0008, Bayer8, Grbg),
    ("BayerGB8", 0x0108_000a, Bayer8, Gbrg),
    ("BayerBG8", 0x0108_000b, Bayer8, Bggr),
    ("YUV422_8_UYVY", 0x0210_001f, Uyvy, Rggb),
    ("YUV422_8", 0x0210_0032, Yuyv, Rggb),
    ("BayerRG10", 0x0110_000d, Bayer10, Rggb),
    ("BayerGR10", 0x0110_000c, Bayer10, Grbg),
    ("BayerGB10", 0x0110_000e, Bayer10, Gbrg),
    ("BayerBG10", 0x0110_000f, Bayer10, Bggr),
    ("BayerRG12", 0x0110_0011, Bayer12, Rggb),
    ("BayerGR12", 0x0110_0010, Bayer12, Grbg),
    ("BayerGB12", 0x0110_0012, Bayer12, Gbrg),
    ("BayerBG12", 0x0110_0013, Bayer12, Bggr),
    ("BayerRG16", 0x0110_002f, Bayer16, Rggb),
    ("BayerGR16", 0x0110_002e, Bayer16, Grbg),
    ("BayerGB16", 0x0110_0030, Bayer16, Gbrg),
    ("BayerBG16", 0x0110_0031, Bayer16, Bggr),
    ("RGB8", 0x0218_0014, Rgb24, Rggb),
];

/// Names of the same formats on older cameras.
const ALIASES: [(&str, &str); 4] = [
    ("YUV422Packed", "YUV422_8_UYVY"),
    ("YUYVPacked", "YUV422_8"),
    ("YUV422_YUYV_Packed", "YUV422_8"),
    ("RGB8Packed", "RGB8"),
];

/// Index in the list of a format with this name.
fn place(name: &str) -> Option<usize> {
    let alias = ALIASES.iter().find(|(alias, _)| *alias == name);
    let name = alias.map_or(name, |&(_, name)| name);
    USABLE.iter().position(|&(known, ..)| known == name)
}

/// The format with this GenICam number.
pub fn of_number(number: u32) -> Option<(PixelFormat, BayerOrder)> {
    let found = USABLE.iter().find(|&&(_, known, ..)| known == number)?;
    Some((found.2, found.3))
}

/// Reason for which a format cannot be used; `None` if it can.
pub fn refusal(name: &str) -> Option<&'static str> {
    if place(name).is_some() {
        None
    } else if name.starts_with("Mono") {
        Some("has no colour: robots and ball are told apart by colour")
    } else if name.contains("Packed") || name.ends_with('p') {
        Some("packs several pixels into common bytes; choose its unpacked relative")
    } else {
        Some("is not supported")
    }
}

/// The best of the formats that a camera offers.
pub fn best(offered: &[String]) -> Option<&String> {
    offered.iter().filter(|name| place(name).is_some()).min_by_key(|name| place(name))
}

/// Increment of a camera's frame number. GigE Vision counts in 16 bits and skips 0.
pub fn step(last: u64, id: u64) -> u64 {
    const END: u64 = 0xffff;
    if id < last && last <= END && last - id > END / 2 {
        END - last + id
    } else {
        id.wrapping_sub(last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_found_by_name_and_number() {
        assert_eq!(of_number(0x0108_000b), Some((Bayer8, Bggr)));
        assert_eq!(of_number(0x0108_0001), None, "Mono8");
        assert_eq!(refusal("BayerRG8"), None);
        assert_eq!(refusal("YUV422Packed"), None);
        assert!(refusal("Mono8").unwrap().contains("no colour"));
        assert!(refusal("BayerRG12p").unwrap().contains("packs"));
    }

    #[test]
    fn the_best_format_is_raw() {
        let offered = ["Mono8", "RGB8Packed", "BayerGR8", "YUV422Packed"].map(String::from);
        assert_eq!(best(&offered), Some(&"BayerGR8".to_string()));
        assert_eq!(best(&offered[..2]), Some(&"RGB8Packed".to_string()));
        assert_eq!(best(&offered[..1]), None);
    }

    #[test]
    fn sixteen_bit_numbers_wrap_without_zero() {
        assert_eq!(step(7, 8), 1);
        assert_eq!(step(65_535, 1), 1);
        assert_eq!(step(65_530, 3), 8);
        assert_eq!(step(1 << 40, (1 << 40) + 5), 5);
        assert!(step(100, 50) > 1 << 60, "a camera that was reset: no gap that anybody believes");
    }
}
