//! Separation of samples by learned colours: the confusion table, and warnings.

use crate::learning::samples::Samples;

/// Classification results of samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Confusion {
    /// The colours' names.
    pub names: Vec<String>,
    /// For each true colour, the pixels classified as each colour, and last as none.
    pub counts: Vec<Vec<u64>>,
    /// For each true colour, the correct part of the pixels of its worst patch.
    pub worst_patch: Vec<f64>,
    /// Background pixels per picture classified as each colour.
    pub false_pixels: Vec<f64>,
}

/// Part of a colour's pixels classified as another one that is worth a warning.
const MAX_CONFUSION: f64 = 0.1;
/// Recall of the worst patch below which a colour is likely to be missed.
const MIN_RECALL: f64 = 0.3;

impl Confusion {
    /// Counts the results of `classify`, which returns an index into `names`, or anything else for none. The
    /// classes of samples are indices into `names`.
    pub fn new(names: Vec<String>, samples: &Samples, classify: impl Fn([u8; 3]) -> u8) -> Self {
        let colors = names.len();
        let mut counts = vec![vec![0; colors + 1]; colors];
        let mut patches = vec![[0u32; 2]; samples.patches as usize];
        let mut class_of_patch = vec![None; samples.patches as usize];
        for sample in &samples.pixels {
            let taken_for = usize::from(classify(sample.rgb)).min(colors);
            let (class, patch) = (usize::from(sample.class), sample.patch as usize);
            counts[class][taken_for] += 1;
            patches[patch][0] += 1;
            patches[patch][1] += u32::from(taken_for == class);
            class_of_patch[patch] = Some(class);
        }
        let mut worst_patch = vec![1.0; colors];
        for (&[all, right], class) in patches.iter().zip(class_of_patch) {
            if let Some(class) = class {
                worst_patch[class] =
                    f64::min(worst_patch[class], f64::from(right) / f64::from(all));
            }
        }
        let mut false_pixels = vec![0.0; colors];
        for &(rgb, pixels) in &samples.background {
            if let Some(count) = false_pixels.get_mut(usize::from(classify(rgb))) {
                *count += pixels;
            }
        }
        Self { names, counts, worst_patch, false_pixels }
    }

    /// Correctly classified part of a colour's pixels; `None` without pixels.
    pub fn recall(&self, class: usize) -> Option<f64> {
        let all: u64 = self.counts[class].iter().sum();
        (all > 0).then(|| self.counts[class][class] as f64 / all as f64)
    }

    /// The table as text.
    pub fn text(&self) -> String {
        let width = self.names.iter().map(|name| name.chars().count()).max().unwrap_or(0).max(6);
        let mut text = format!("{:<width$}", "");
        for name in self.names.iter().map(String::as_str).chain(["none"]) {
            text += &format!(" {name:>width$}");
        }
        text += "   recall  worst patch  false pixels\n";
        for (class, name) in self.names.iter().enumerate() {
            let Some(recall) = self.recall(class) else { continue };
            text += &format!("{name:<width$}");
            for &count in &self.counts[class] {
                text += &format!(" {count:>width$}");
            }
            text += &format!(
                " {:>6.1} % {:>10.0} % {:>13.0}\n",
                100.0 * recall,
                100.0 * self.worst_patch[class],
                self.false_pixels[class]
            );
        }
        text
    }

    /// Likely failures on the pitch.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        for (class, name) in self.names.iter().enumerate() {
            let all: u64 = self.counts[class].iter().sum();
            for (other, other_name) in self.names.iter().enumerate() {
                let part = self.counts[class][other] as f64 / all.max(1) as f64;
                if other != class && part > MAX_CONFUSION {
                    warnings.push(format!(
                        "{name} and {other_name} are too alike: {:.0} % of {name} looks like \
                         {other_name}; use another paint, or light both alike",
                        100.0 * part
                    ));
                }
            }
            if all > 0 && self.worst_patch[class] < MIN_RECALL {
                warnings.push(format!(
                    "of one patch of {name} only {:.0} % is recognised: too dark, too bright, or \
                     labelled wrongly",
                    100.0 * self.worst_patch[class]
                ));
            }
        }
        warnings
    }
}
