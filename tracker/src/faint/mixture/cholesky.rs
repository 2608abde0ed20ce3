//! Cholesky factorisation of small positive definite matrices.

use super::PARTS;

pub(super) type Square = [[f64; PARTS]; PARTS];

/// Cholesky factor of a positive definite matrix: A = L·Lᵀ.
pub(super) struct Factor {
    rows: usize,
    lower: Square,
    /// Reciprocals of L's diagonal.
    inverse: [f64; PARTS],
}

impl Factor {
    /// Factorises the first `rows` rows and columns; `None` if they are not positive definite.
    pub fn new(matrix: &Square, rows: usize) -> Option<Self> {
        let mut factor = Self { rows, lower: Square::default(), inverse: [0.0; PARTS] };
        for (row, terms) in matrix.iter().enumerate().take(rows) {
            for column in 0..=row {
                let (own, other) = (&factor.lower[row], &factor.lower[column]);
                let known = own[..column].iter().zip(&other[..column]).map(|(a, b)| a * b);
                let left = terms[column] - known.sum::<f64>();
                if row != column {
                    factor.lower[row][column] = left * factor.inverse[column];
                } else if left > 1e-9 && left.is_finite() {
                    factor.lower[row][row] = left.sqrt();
                    factor.inverse[row] = 1.0 / factor.lower[row][row];
                } else {
                    return None;
                }
            }
        }
        Some(factor)
    }

    /// Solves A·x = right.
    pub fn solve(&self, right: [f64; PARTS]) -> [f64; PARTS] {
        let mut x = right;
        for row in 0..self.rows {
            let known = (0..row).map(|k| self.lower[row][k] * x[k]).sum::<f64>();
            x[row] = (x[row] - known) * self.inverse[row];
        }
        for row in (0..self.rows).rev() {
            let known = (row + 1..self.rows).map(|k| self.lower[k][row] * x[k]).sum::<f64>();
            x[row] = (x[row] - known) * self.inverse[row];
        }
        x
    }
}
