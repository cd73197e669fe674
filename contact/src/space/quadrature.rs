//! Gauss's rules.

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
            let next = x - p / slope;
            if next == x {
                break;
            }
            x = next;
        }
        (x, 2.0 / ((1.0 - x * x) * slope * slope))
    };
    let mut rule: Vec<(f64, f64)> = (0..n).map(root).collect();
    rule.reverse();
    rule
}
