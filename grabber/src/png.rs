//! Reduction of PNG files to the chunks that make the picture.

/// First bytes of a file.
const SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";
/// Chunk types that are kept: the picture, its palette and transparency, and its orientation.
const KEPT_CHUNKS: [&[u8; 4]; 6] = [b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND", b"eXIf"];
/// Length and type before a chunk's content, and the checksum behind it.
const CHUNK_OVERHEAD: usize = 12;

/// A PNG without texts, profiles and other metadata: a few kilobytes of these can become gigabytes when
/// decompressed, and none of it is used. Invalid chunks are left as they are, for the decoder to report.
pub fn essential_chunks(png: &[u8]) -> Vec<u8> {
    let Some(mut rest) = png.strip_prefix(SIGNATURE) else { return png.to_vec() };
    let mut kept = Vec::with_capacity(png.len());
    kept.extend_from_slice(SIGNATURE);
    while let Some((head, _)) = rest.split_at_checked(8) {
        let length = u32::from_be_bytes([head[0], head[1], head[2], head[3]]) as usize;
        let Some((chunk, after)) = rest.split_at_checked(length.saturating_add(CHUNK_OVERHEAD))
        else {
            break;
        };
        if KEPT_CHUNKS.iter().any(|kind| head[4..8] == **kind) {
            kept.extend_from_slice(chunk);
        }
        rest = after;
    }
    kept.extend_from_slice(rest);
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
        let mut chunk = (content.len() as u32).to_be_bytes().to_vec();
        chunk.extend(kind);
        chunk.extend(content);
        chunk.extend([0; 4]);
        chunk
    }

    #[test]
    fn metadata_is_removed_and_the_picture_kept() {
        let [ihdr, text, idat, iend] = [(b"IHDR", 13), (b"zTXt", 500), (b"IDAT", 40), (b"IEND", 0)]
            .map(|(kind, length)| chunk(kind, &vec![7; length]));
        let whole = [SIGNATURE, &ihdr, &text, &idat, &iend].concat();
        assert_eq!(essential_chunks(&whole), [SIGNATURE, &ihdr, &idat, &iend].concat());
        for cut in 0..whole.len() {
            let kept = essential_chunks(&whole[..cut]);
            assert!(kept.len() <= cut && whole.starts_with(&kept[..kept.len().min(33)]));
        }
        assert_eq!(essential_chunks(b"GIF89a"), b"GIF89a");
    }
}
