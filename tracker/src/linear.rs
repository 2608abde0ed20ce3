//! Symmetric matrices of three rows, as their upper triangle row by row.

/// Rows and columns of an upper triangle.
pub(crate) const UPPER: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

/// A symmetric matrix times a vector.
pub(crate) fn times(m: &[f64; 6], v: &[f64; 3]) -> [f64; 3] {
    [
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[1] * v[0] + m[3] * v[1] + m[4] * v[2],
        m[2] * v[0] + m[4] * v[1] + m[5] * v[2],
    ]
}

/// Inverse of a positive definite matrix.
pub(crate) fn inverse(&[xx, xy, xz, yy, yz, zz]: &[f64; 6]) -> Option<[f64; 6]> {
    let (a, b, c) = (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy);
    let determinant = xx * a + xy * b + xz * c;
    let inverse = [a, b, c, xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy]
        .map(|cofactor| cofactor / determinant);
    let is_positive = [0, 3, 5].iter().all(|&index| inverse[index] > 0.0);
    (determinant > 0.0 && is_positive && inverse.iter().all(|term| term.is_finite()))
        .then_some(inverse)
}
