//! A problem of a configuration, named by the path of the key: `colors[2].red`.

use std::fmt;

/// One problem of a configuration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// The key: `camera.fps`, `colors[2].red`.
    pub path: String,
    /// The problem.
    pub message: String,
    /// The remedy, if it can be guessed.
    pub help: Option<String>,
    /// The key itself is at fault, not its value.
    pub at_key: bool,
    /// Another key involved; it is blamed if the file does not set `path`.
    pub related: Option<String>,
}

impl Problem {
    pub(super) fn new(path: impl Into<String>, message: impl Into<String>) -> Self {
        Self {
            path: path.into(),
            message: message.into(),
            help: None,
            at_key: false,
            related: None,
        }
    }

    pub(super) fn help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }

    pub(super) fn related(mut self, path: impl Into<String>) -> Self {
        self.related = Some(path.into());
        self
    }

    pub(super) fn at_key(mut self) -> Self {
        self.at_key = true;
        self
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.path.is_empty() {
            write!(f, "{}: ", self.path)?;
        }
        f.write_str(&self.message)?;
        match &self.help {
            Some(help) => write!(f, " ({help})"),
            None => Ok(()),
        }
    }
}

/// Path of a key in the table at `parent`, quoted if TOML requires it.
pub(super) fn key_path(parent: &str, key: &str) -> String {
    let bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let dot = if parent.is_empty() { "" } else { "." };
    if !key.is_empty() && key.chars().all(bare) {
        format!("{parent}{dot}{key}")
    } else {
        format!("{parent}{dot}{key:?}")
    }
}

/// Path of an element of the array at `parent`.
pub(super) fn element_path(parent: &str, index: usize) -> String {
    format!("{parent}[{index}]")
}

/// The candidate probably meant, if one is similar.
pub(super) fn nearest<'a>(
    written: &str,
    candidates: impl IntoIterator<Item = &'a str>,
) -> Option<&'a str> {
    let fold =
        |text: &str| -> Vec<char> { text.to_lowercase().replace('-', "_").chars().collect() };
    let written = fold(written);
    candidates
        .into_iter()
        .map(|candidate| (candidate, fold(candidate)))
        .filter(|(_, folded)| folded.len().abs_diff(written.len()) <= 4)
        .map(|(candidate, folded)| {
            let limit = folded.len().max(written.len()).div_ceil(3);
            (edit_distance(&written, &folded), limit, candidate)
        })
        .filter(|&(distance, limit, _)| distance <= limit)
        .min_by_key(|&(distance, ..)| distance)
        .map(|(.., candidate)| candidate)
}

/// Smallest number of letters to insert, delete, replace or swap with a neighbour (optimal string
/// alignment distance).
fn edit_distance(a: &[char], b: &[char]) -> usize {
    let mut table = vec![vec![0; b.len() + 1]; a.len() + 1];
    for i in 0..=a.len() {
        for j in 0..=b.len() {
            table[i][j] = if i == 0 || j == 0 {
                i + j
            } else {
                let replaced = table[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
                let best = replaced.min(table[i - 1][j] + 1).min(table[i][j - 1] + 1);
                if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                    best.min(table[i - 2][j - 2] + 1)
                } else {
                    best
                }
            };
        }
    }
    table[a.len()][b.len()]
}

/// The text in quotes, shortened if it is long.
pub(super) fn quoted(text: &str) -> String {
    const MOST: usize = 40;
    if text.chars().count() <= MOST {
        return format!("{text:?}");
    }
    let start: String = text.chars().take(MOST).collect();
    format!("{start:?}…")
}

/// "a, b and c".
pub(super) fn listed<'a>(items: impl IntoIterator<Item = &'a str>) -> String {
    let items: Vec<&str> = items.into_iter().collect();
    match items.split_last() {
        None => String::new(),
        Some((only, [])) => (*only).to_string(),
        Some((last, rest)) => format!("{} and {last}", rest.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_of_the_finger_are_recognised() {
        let keys = ["width", "height", "fps", "bayer_order", "exposure_us"];
        for (written, meant) in [
            ("fsp", Some("fps")),
            ("FPS", Some("fps")),
            ("heigth", Some("height")),
            ("with", Some("width")),
            ("bayer-order", Some("bayer_order")),
            ("exposure", Some("exposure_us")),
            ("colour", None),
            ("", None),
        ] {
            assert_eq!(nearest(written, keys), meant, "{written}");
        }
    }

    #[test]
    fn the_edit_distance_counts_edits() {
        let distance = |a: &str, b: &str| {
            edit_distance(&a.chars().collect::<Vec<_>>(), &b.chars().collect::<Vec<_>>())
        };
        assert_eq!(distance("", "abc"), 3);
        assert_eq!(distance("kitten", "sitting"), 3);
        assert_eq!(distance("fsp", "fps"), 1);
        assert_eq!(distance("grün", "grn"), 1);
        assert_eq!(distance("same", "same"), 0);
    }

    #[test]
    fn paths_quote_what_toml_would_quote() {
        assert_eq!(key_path("", "camera"), "camera");
        assert_eq!(key_path("camera", "fps"), "camera.fps");
        assert_eq!(key_path("camera", "a.b"), "camera.\"a.b\"");
        assert_eq!(key_path(&element_path("colors", 2), ""), "colors[2].\"\"");
    }
}
