//! Cholesky factors of symmetric positive definite matrices of which only the lower triangle is
//! stored, in memory that the caller owns.

pub(crate) use super::product::dot;
use super::wide::wide;

wide! {
    /// Cholesky's factor of a lower triangle of `size` rows in place; false when it is not
    /// positive.
    pub(crate) fn factor(matrix: &mut [f64], size: usize) -> bool = factor_in_place;

    /// Solves in place with the triangle of [`factor`].
    pub(crate) fn solve(triangle: &[f64], size: usize, side: &mut [f64]) = solve_in_place;

    /// The same for a side that is zero before `from`.
    pub(crate) fn solve_from(triangle: &[f64], size: usize, side: &mut [f64], from: usize)
        = solve_from_in_place;
}

#[inline(always)]
fn factor_in_place(matrix: &mut [f64], size: usize) -> bool {
    for i in 0..size {
        let (above, row) = matrix.split_at_mut(i * size);
        for j in 0..i {
            let value = row[j] - dot(&row[..j], &above[j * size..j * size + j]);
            row[j] = value / above[j * size + j];
        }
        let rest = row[i] - dot(&row[..i], &row[..i]);
        if rest.is_nan() || rest <= 0.0 {
            return false;
        }
        row[i] = rest.sqrt();
    }
    true
}

#[inline(always)]
fn solve_in_place(triangle: &[f64], size: usize, side: &mut [f64]) {
    solve_from_in_place(triangle, size, side, 0);
}

#[inline(always)]
fn solve_from_in_place(triangle: &[f64], size: usize, side: &mut [f64], from: usize) {
    for i in from..size {
        let row = &triangle[i * size..=i * size + i];
        side[i] = (side[i] - dot(&row[from..i], &side[from..i])) / row[i];
    }
    for i in (0..size).rev() {
        let row = &triangle[i * size..=i * size + i];
        let known = side[i] / row[i];
        side[i] = known;
        for (value, entry) in side[..i].iter_mut().zip(row) {
            *value -= known * entry;
        }
    }
}

/// Inverse of the Cholesky factor of the leading `count` rows of a small matrix.
pub(crate) fn inverse_factor<const N: usize>(
    products: &[[f64; N]; N],
    count: usize,
) -> [[f64; N]; N] {
    let mut lower = [[0.0_f64; N]; N];
    let mut out = [[0.0; N]; N];
    for i in 0..count {
        for j in 0..=i {
            let known: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
            let rest = products[i][j] - known;
            lower[i][j] = if i == j { rest.sqrt() } else { rest / lower[j][j] };
        }
    }
    for row in 0..count {
        let mut line = [0.0; N];
        for (column, slot) in line.iter_mut().enumerate().take(row + 1) {
            let known: f64 = (column..row).map(|k| lower[row][k] * out[k][column]).sum();
            let one = if row == column { 1.0 } else { 0.0 };
            *slot = (one - known) / lower[row][row];
        }
        out[row] = line;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_solved_system_gives_its_side_back() {
        let size = 21;
        let entry = |i: usize, j: usize| {
            let apart = i.abs_diff(j) as f64;
            if i == j { 3.0 } else { 1.0 / (1.0 + apart * apart) }
        };
        let mut matrix: Vec<f64> = (0..size * size).map(|at| entry(at / size, at % size)).collect();
        let side: Vec<f64> = (0..size).map(|i| if i < 4 { 0.0 } else { i as f64 - 9.0 }).collect();
        let (mut found, mut narrow) = (side.clone(), side.clone());
        let mut other = matrix.clone();
        assert!(factor(&mut matrix, size) && factor_in_place(&mut other, size));
        solve_from(&matrix, size, &mut found, 4);
        solve_from_in_place(&other, size, &mut narrow, 4);
        assert!(matrix == other && found == narrow, "to the last bit in registers of any width");
        solve(&matrix, size, &mut narrow);
        let mut again = found.clone();
        solve_in_place(&matrix, size, &mut again);
        assert!(narrow == again && narrow != found);
        for (i, wanted) in side.iter().enumerate() {
            let back: f64 = found.iter().enumerate().map(|(j, x)| entry(i, j) * x).sum();
            assert!((back - wanted).abs() < 1e-13, "{i}: {back} {wanted}");
        }
        matrix.fill(1.0);
        assert!(!factor(&mut matrix, size));
    }
}
