//! Supported pixel formats of Video for Linux.

use messages::BayerOrder::{self, *};
use messages::PixelFormat::{self, *};

/// Treatment of a format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Use {
    /// Published unchanged.
    Raw(PixelFormat, BayerOrder),
    /// Each picture is decoded into red, green and blue: costs the grabber a few milliseconds per frame, and
    /// blurs colours at the edges of patches.
    Jpeg,
    /// Not supported, for this reason.
    Refused(&'static str),
}

/// A four-character code, as the kernel writes it.
pub const fn fourcc(name: &[u8; 4]) -> u32 {
    u32::from_le_bytes(*name)
}

/// A format's characters; unprintable ones become dots.
pub fn name(fourcc: u32) -> String {
    let printable = |byte: u8| if (32..127).contains(&byte) { byte as char } else { '.' };
    fourcc.to_le_bytes().map(printable).iter().collect::<String>().trim_end().to_string()
}

const NO_COLOR: &str = "has no colour: robots and ball are told apart by colour";
const PACKED: &str = "packs several pixels into common bytes; choose its unpacked relative";

/// All supported formats, best first: raw formats preserve all sensor data, and take the least bandwidth.
pub const USABLE: [(u32, Use); 23] = [
    (fourcc(b"RGGB"), Use::Raw(Bayer8, Rggb)),
    (fourcc(b"GRBG"), Use::Raw(Bayer8, Grbg)),
    (fourcc(b"GBRG"), Use::Raw(Bayer8, Gbrg)),
    (fourcc(b"BA81"), Use::Raw(Bayer8, Bggr)),
    (fourcc(b"UYVY"), Use::Raw(Uyvy, Rggb)),
    (fourcc(b"YUYV"), Use::Raw(Yuyv, Rggb)),
    (fourcc(b"RG10"), Use::Raw(Bayer10, Rggb)),
    (fourcc(b"BA10"), Use::Raw(Bayer10, Grbg)),
    (fourcc(b"GB10"), Use::Raw(Bayer10, Gbrg)),
    (fourcc(b"BG10"), Use::Raw(Bayer10, Bggr)),
    (fourcc(b"RG12"), Use::Raw(Bayer12, Rggb)),
    (fourcc(b"BA12"), Use::Raw(Bayer12, Grbg)),
    (fourcc(b"GB12"), Use::Raw(Bayer12, Gbrg)),
    (fourcc(b"BG12"), Use::Raw(Bayer12, Bggr)),
    (fourcc(b"RG16"), Use::Raw(Bayer16, Rggb)),
    (fourcc(b"GR16"), Use::Raw(Bayer16, Grbg)),
    (fourcc(b"GB16"), Use::Raw(Bayer16, Gbrg)),
    (fourcc(b"BYR2"), Use::Raw(Bayer16, Bggr)),
    (fourcc(b"NV12"), Use::Raw(Nv12, Rggb)),
    (fourcc(b"YU12"), Use::Raw(I420, Rggb)),
    (fourcc(b"RGB3"), Use::Raw(Rgb24, Rggb)),
    (fourcc(b"MJPG"), Use::Jpeg),
    (fourcc(b"JPEG"), Use::Jpeg),
];

/// Treatment of a format.
pub fn use_of(fourcc: u32) -> Use {
    if let Some(&(_, usage)) = USABLE.iter().find(|&&(known, _)| known == fourcc) {
        return usage;
    }
    let name = name(fourcc);
    if ["GREY", "Y8", "Y10", "Y12", "Y14", "Y16"].iter().any(|grey| name.starts_with(grey)) {
        Use::Refused(NO_COLOR)
    } else if ["pBAA", "pGAA", "pgAA", "pRAA", "pBCC", "pGCC", "pgCC", "pRCC"]
        .contains(&name.as_str())
    {
        Use::Refused(PACKED)
    } else {
        Use::Refused("is not supported")
    }
}

/// Position in the order of preference; lower is better.
pub fn preference(fourcc: u32) -> usize {
    USABLE.iter().position(|&(known, _)| known == fourcc).unwrap_or(usize::MAX)
}

/// The format with these characters.
pub fn parse(letters: &str) -> Result<u32, String> {
    let bytes = letters.as_bytes();
    if bytes.is_empty() || bytes.len() > 4 || !letters.is_ascii() {
        return Err(format!("{letters:?} is not the four letters of a V4L2 format"));
    }
    let mut name = [b' '; 4];
    name[..bytes.len()].copy_from_slice(bytes);
    match use_of(fourcc(&name)) {
        Use::Refused(reason) => Err(format!("{letters} {reason}")),
        _ => Ok(fourcc(&name)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_map_to_their_layout() {
        assert_eq!(use_of(fourcc(b"BA81")), Use::Raw(Bayer8, Bggr));
        assert_eq!(use_of(fourcc(b"YUYV")), Use::Raw(Yuyv, Rggb));
        assert_eq!(use_of(fourcc(b"MJPG")), Use::Jpeg);
        for grey in [b"GREY", b"Y10 ", b"Y16 "] {
            assert_eq!(use_of(fourcc(grey)), Use::Refused(NO_COLOR));
        }
        assert_eq!(use_of(fourcc(b"pRAA")), Use::Refused(PACKED));
        assert!(matches!(use_of(fourcc(b"H264")), Use::Refused(_)));
    }

    #[test]
    fn formats_are_parsed_and_refusals_give_reasons() {
        assert_eq!(parse("RGGB"), Ok(fourcc(b"RGGB")));
        assert_eq!(name(fourcc(b"Y10 ")), "Y10");
        assert!(parse("GREY").unwrap_err().contains("no colour"));
        assert!(parse("Y10").unwrap_err().contains("no colour"));
        assert!(parse("").is_err() && parse("RGGB8").is_err() && parse("é").is_err());
    }

    #[test]
    fn raw_comes_before_decoded() {
        let order: Vec<usize> =
            [b"RGGB", b"UYVY", b"RGB3", b"MJPG"].map(|name| preference(fourcc(name))).into();
        assert!(order.is_sorted(), "{order:?}");
    }
}
