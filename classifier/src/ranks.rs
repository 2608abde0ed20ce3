//! Medians and other order statistics of a few bytes.

/// Bytes whose order statistics are needed.
#[derive(Debug, Clone, Default)]
pub(crate) struct Ranks {
    values: Vec<u8>,
}

/// Values counted per step; a sum of so many flags fits into a byte.
const AT_ONCE: usize = 32;

impl Ranks {
    /// With memory for `values` values.
    pub fn with_room(values: usize) -> Self {
        Self { values: Vec::with_capacity(values.next_multiple_of(AT_ONCE)) }
    }

    /// Replaces the values.
    pub fn fill(&mut self, values: impl Iterator<Item = u8>) {
        self.values.clear();
        self.values.extend(values);
        // Padding that comes last in the order.
        self.values.resize(self.values.len().next_multiple_of(AT_ONCE), u8::MAX);
    }

    /// The value of rank `count` (0 is the lowest); 255 if there are not as many. The value is found bit by
    /// bit, by counting values below a candidate: a fifth of the time of selection, and the same for any
    /// values.
    pub fn nth(&self, count: usize) -> u8 {
        let (chunks, _) = self.values.as_chunks::<AT_ONCE>();
        let mut found = 0u8;
        for bit in (0..8).rev() {
            let candidate = found | 1 << bit;
            let below = |chunk: &[u8; AT_ONCE]| -> usize {
                chunk.iter().map(|&value| u8::from(value < candidate)).sum::<u8>().into()
            };
            if chunks.iter().map(below).sum::<usize>() <= count {
                found = candidate;
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn ranks_equal_those_of_sorted_values(
            values in proptest::collection::vec(any::<u8>(), 1..300),
            few in 0u8..3,
            at in 0.0..1.0f64,
        ) {
            let mut values = values;
            values.iter_mut().for_each(|value| *value >>= 3 * few);
            let mut ranks = Ranks::with_room(values.len());
            ranks.fill(values.iter().copied());
            values.sort_unstable();
            let at = (at * values.len() as f64) as usize;
            prop_assert_eq!(ranks.nth(at), values[at]);
        }
    }
}
