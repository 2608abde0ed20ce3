//! Revisions of the configuration.

use serde::{Deserialize, Serialize};

/// Which configuration a process runs with. A group starts with revision 1, and each accepted change
/// takes the next number. Every output of a stage names the revision that made it. 0 in a process that
/// was started by hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Revision {
    /// The number.
    pub number: u32,
    /// The first revision with the same colours in the same order: runs classified by one of those
    /// from there on have the same class numbers.
    pub classes_since: u32,
}

impl Revision {
    /// The configuration that a group starts with.
    pub const FIRST: Self = Self { number: 1, classes_since: 1 };

    /// The one after this.
    pub fn next(self, has_same_classes: bool) -> Self {
        let number = self.number + 1;
        Self { number, classes_since: if has_same_classes { self.classes_since } else { number } }
    }
}

/// `5:3`: revision 5, with the colours of revision 3.
impl std::fmt::Display for Revision {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}:{}", self.number, self.classes_since)
    }
}

/// Reads what `Display` writes.
impl std::str::FromStr for Revision {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (number, classes_since) = text.split_once(':').unwrap_or((text, text));
        let parse =
            |part: &str| part.parse::<u32>().map_err(|_| format!("{text:?} is no revision"));
        let revision = Self { number: parse(number)?, classes_since: parse(classes_since)? };
        if revision.classes_since > revision.number {
            return Err(format!("{text:?}: the colours cannot be newer than the revision"));
        }
        Ok(revision)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn revisions_rise_and_keep_the_origin_of_their_colours() {
        let second = Revision::FIRST.next(true);
        assert_eq!(second, Revision { number: 2, classes_since: 1 });
        let third = second.next(false);
        assert_eq!(third, Revision { number: 3, classes_since: 3 });
        for revision in [Revision::default(), Revision::FIRST, second, third] {
            assert_eq!(revision.to_string().parse(), Ok(revision));
        }
        for text in ["", "a", "1:", "2:3", "-1"] {
            assert!(text.parse::<Revision>().is_err(), "{text}");
        }
    }
}
