//! Diagnostics of a configuration, shown like a compiler's: the line, with the fault underlined.

use super::problem::Problem;
use std::fmt;
use std::ops::Range;

/// All problems of a text, in text order. Displayed as one block each.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnostics {
    /// The problems.
    pub list: Vec<Diagnostic>,
}

/// A problem and its position in the text. Displayed like a compiler's message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnostic {
    /// Name of the text, usually its path.
    pub origin: String,
    /// The problem.
    pub problem: Problem,
    /// Position; `None` if it concerns the whole text, or a part that is missing from it.
    pub place: Option<Place>,
}

/// A part of a line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// Line number, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
    /// Characters to underline; at least 1.
    pub width: usize,
    /// The line.
    pub source: String,
}

/// Problems shown in full; a file of another kind can have thousands.
const MAX_SHOWN: usize = 20;

impl fmt::Display for Diagnostics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, diagnostic) in self.list.iter().take(MAX_SHOWN).enumerate() {
            if index > 0 {
                f.write_str("\n\n")?;
            }
            write!(f, "{diagnostic}")?;
        }
        match self.list.len().saturating_sub(MAX_SHOWN) {
            0 => Ok(()),
            more => write!(f, "\n\n… and {more} more"),
        }
    }
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.origin)?;
        if let Some(place) = &self.place {
            write!(f, ":{}:{}", place.line, place.column)?;
        }
        let separator = if self.problem.path.is_empty() { "" } else { ": " };
        write!(f, ": {}{separator}{}", self.problem.path, self.problem.message)?;
        let help = self.problem.help.as_deref().unwrap_or_default();
        match &self.place {
            Some(place) => place.show(f, help),
            None if help.is_empty() => Ok(()),
            None => write!(f, "\n     = {help}"),
        }
    }
}

impl Place {
    /// Position of a range of bytes; only its first line is kept.
    pub(super) fn new(text: &str, span: Range<usize>) -> Self {
        let boundary = |index: usize| {
            (0..=index.min(text.len())).rev().find(|&index| text.is_char_boundary(index))
        };
        let start = boundary(span.start).unwrap_or(0);
        let end = boundary(span.end).unwrap_or(0).max(start);
        let line_start = text[..start].rfind('\n').map_or(0, |newline| newline + 1);
        let line_end = text[start..].find('\n').map_or(text.len(), |newline| start + newline);
        let source = text[line_start..line_end].trim_end_matches('\r');
        Self {
            line: text[..start].matches('\n').count() + 1,
            column: text[line_start..start].chars().count() + 1,
            width: text[start..end.min(line_end)].trim_end().chars().count().max(1),
            source: source.to_string(),
        }
    }

    /// The line, and carets with the help below.
    fn show(&self, f: &mut fmt::Formatter<'_>, help: &str) -> fmt::Result {
        // Only the surroundings of the fault are shown of a long line.
        const MOST: usize = 100;
        let skipped = if self.column > MOST - 20 { self.column - 20 } else { 0 };
        // Tabs would move the carets, and other control characters would control the terminal.
        let visible = |c: char| if c.is_control() { ' ' } else { c };
        let part: String = self.source.chars().skip(skipped).take(MOST).map(visible).collect();
        let (before, after) = (
            if skipped > 0 { "…" } else { "" },
            if self.source.chars().count() > skipped + MOST { "…" } else { "" },
        );
        let indent = self.column - 1 - skipped + before.chars().count();
        let carets = "^".repeat(self.width.min(MOST.saturating_sub(indent)).max(1));
        write!(f, "\n{:>4} | {before}{}{after}", self.line, part.trim_end())?;
        let space = if help.is_empty() { "" } else { " " };
        write!(f, "\n     | {:indent$}{carets}{space}{help}", "")
    }
}

#[cfg(test)]
mod tests {
    use crate::Config;

    fn message(text: &str) -> String {
        Config::parse(text, "match.toml").unwrap_err().to_string()
    }

    #[test]
    fn long_lines_are_shown_around_the_fault() {
        let names = "\"ä\", ".repeat(200);
        let message = message(&format!("ball = {{ diameter_mm = 40, color = [{names}], x = 0 }}"));
        assert!(message.lines().all(|line| line.chars().count() < 120), "{message}");
        assert!(message.lines().nth(5).unwrap().contains("x = 0"), "{message}");
    }

    #[test]
    fn a_terminal_is_not_told_to_do_things() {
        let message = message("[camera]\nfps = \"\u{9b}2J\"\n\"a\\u001b[2J\" = 1\n");
        assert!(!message.contains(|c: char| c.is_control() && c != '\n'), "{message:?}");
    }
}
