//! Connected components of a class map: candidates for patches.

/// Class of pixels without a class.
pub const NOTHING: u8 = u8::MAX;

/// Pixels of one class that touch (4-connected).
#[derive(Debug, Clone, PartialEq)]
pub struct Blob {
    /// Class of all its pixels.
    pub class: u8,
    /// Number of pixels.
    pub pixels: u32,
    /// Mean column and row.
    pub center: [f64; 2],
    /// First and last column.
    pub columns: [u32; 2],
    /// First and last row.
    pub rows: [u32; 2],
}

/// The blobs of a class map, and the number of the blob of each pixel. The number is meaningless for pixels
/// without a class.
pub fn blobs(map: &[u8], width: usize) -> (Vec<Blob>, Vec<u32>) {
    let mut parents: Vec<u32> = Vec::new();
    let mut labels = vec![0u32; map.len()];
    for (row, classes) in map.chunks_exact(width).enumerate() {
        let begin = row * width;
        for (column, &class) in classes.iter().enumerate() {
            if class == NOTHING {
                continue;
            }
            let index = begin + column;
            let left = (column > 0 && map[index - 1] == class).then(|| labels[index - 1]);
            let above = (row > 0 && map[index - width] == class).then(|| labels[index - width]);
            labels[index] = match (left, above) {
                (Some(left), Some(above)) if left != above => join(&mut parents, left, above),
                (Some(label), _) | (None, Some(label)) => label,
                (None, None) => {
                    parents.push(parents.len() as u32);
                    parents.len() as u32 - 1
                }
            };
        }
    }
    // Blobs are numbered in the order of their first pixels.
    let mut numbers = vec![u32::MAX; parents.len()];
    let mut blobs: Vec<Blob> = Vec::new();
    for (index, &class) in map.iter().enumerate() {
        if class == NOTHING {
            continue;
        }
        let root = root(&mut parents, labels[index]) as usize;
        let (column, row) = ((index % width) as u32, (index / width) as u32);
        if numbers[root] == u32::MAX {
            numbers[root] = blobs.len() as u32;
            let (columns, rows) = ([column; 2], [row; 2]);
            blobs.push(Blob { class, pixels: 0, center: [0.0; 2], columns, rows });
        }
        labels[index] = numbers[root];
        let blob = &mut blobs[numbers[root] as usize];
        blob.pixels += 1;
        blob.center = [blob.center[0] + f64::from(column), blob.center[1] + f64::from(row)];
        blob.columns = [blob.columns[0].min(column), blob.columns[1].max(column)];
        blob.rows[1] = row;
    }
    for blob in &mut blobs {
        blob.center = blob.center.map(|sum| sum / f64::from(blob.pixels));
    }
    (blobs, labels)
}

/// Merges two labels, and returns the lower one.
fn join(parents: &mut [u32], a: u32, b: u32) -> u32 {
    let (a, b) = (root(parents, a), root(parents, b));
    parents[a.max(b) as usize] = a.min(b);
    a.min(b)
}

fn root(parents: &mut [u32], mut label: u32) -> u32 {
    while parents[label as usize] != label {
        // Path halving: shortens the path for later calls.
        parents[label as usize] = parents[parents[label as usize] as usize];
        label = parents[label as usize];
    }
    label
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connected_pixels_are_one_blob() {
        let text = "
            aa.b
            .a.b
            a..b
            aaab
            ....
            .b.a";
        let rows: Vec<&str> = text.split_whitespace().collect();
        let map: Vec<u8> = rows
            .concat()
            .bytes()
            .map(|letter| if letter == b'.' { NOTHING } else { letter - b'a' })
            .collect();
        let (blobs, numbers) = blobs(&map, 4);
        let found: Vec<(u8, u32)> = blobs.iter().map(|blob| (blob.class, blob.pixels)).collect();
        assert_eq!(found, [(0, 3), (1, 4), (0, 4), (1, 1), (0, 1)]);
        assert_eq!((blobs[1].columns, blobs[1].rows), ([3, 3], [0, 3]));
        assert_eq!((blobs[2].columns, blobs[2].rows), ([0, 2], [2, 3]));
        assert_eq!(blobs[1].center, [3.0, 1.5]);
        assert_eq!(numbers[5], 0);
        assert_eq!(numbers[12], 2);
    }
}
