//! Gauss's rules and symmetric positive definite systems, in memory of the caller's. It refuses
//! nothing but a system that is not positive definite.

use core::f64::consts::PI;

/// Points (ascending) and weights of Gauss's rule with `n` points on (-1, 1).
pub(crate) fn legendre(n: usize) -> Vec<(f64, f64)> {
    let root = |i: usize| {
        let mut x = libm::cos(PI * (i as f64 + 0.75) / (n as f64 + 0.5));
        let mut slope = 1.0;
        for _ in 0..8 {
            let (mut p, mut q) = (1.0, 0.0);
            for j in 0..n {
                let (k, old) = (j as f64, q);
                q = p;
                p = ((2.0 * k + 1.0) * x * q - k * old) / (k + 1.0);
            }
            slope = n as f64 * (x * p - q) / (x * x - 1.0);
            x -= p / slope;
        }
        (x, 2.0 / ((1.0 - x * x) * slope * slope))
    };
    let mut rule: Vec<(f64, f64)> = (0..n).map(root).collect();
    rule.reverse();
    rule
}

/// Factors the lower triangle of a symmetric matrix of `n` rows in place; false when it is not
/// positive definite.
pub(crate) fn factor(matrix: &mut [f64], n: usize) -> bool {
    for i in 0..n {
        let (above, row) = matrix.split_at_mut(i * n);
        for j in 0..i {
            let other = &above[j * n..j * n + j];
            let dot: f64 = row[..j].iter().zip(other).map(|(a, b)| a * b).sum();
            row[j] = (row[j] - dot) / above[j * n + j];
        }
        let rest = row[i] - row[..i].iter().map(|a| a * a).sum::<f64>();
        if rest.is_nan() || rest <= 0.0 {
            return false;
        }
        row[i] = rest.sqrt();
    }
    true
}

/// Solves in place with the triangle of [`factor`].
pub(crate) fn solve(triangle: &[f64], n: usize, side: &mut [f64]) {
    for i in 0..n {
        let row = &triangle[i * n..i * n + i];
        let dot: f64 = row.iter().zip(&side[..i]).map(|(a, b)| a * b).sum();
        side[i] = (side[i] - dot) / triangle[i * n + i];
    }
    for i in (0..n).rev() {
        side[i] /= triangle[i * n + i];
        let (known, known_i) = (side[i], i);
        for (j, value) in side[..known_i].iter_mut().enumerate() {
            *value -= triangle[i * n + j] * known;
        }
    }
}
