//! Which pixels are looked at at all.

/// A stretch of columns, `begin..end`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Span {
    /// First column.
    pub begin: usize,
    /// Column behind the last one; above `begin`.
    pub end: usize,
}

/// The pixels that are classified, row by row; all others are background.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldMask {
    /// Of all rows, from top to bottom.
    spans: Vec<Span>,
    /// For each row, where its spans end in the list; they begin where those of the row above end.
    ends: Vec<usize>,
}

impl FieldMask {
    /// All pixels of pictures of this size.
    pub fn everything(width: u32, height: u32) -> Self {
        let (width, height) = (width as usize, height as usize);
        Self { spans: vec![Span { begin: 0, end: width }; height], ends: (1..=height).collect() }
    }

    /// The spans of a row, from left to right; they neither overlap nor touch.
    ///
    /// # Panics
    /// If there is no such row.
    pub fn spans(&self, row: usize) -> &[Span] {
        let begin = if row == 0 { 0 } else { self.ends[row - 1] };
        &self.spans[begin..self.ends[row]]
    }
}
