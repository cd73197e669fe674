//! Gauss-Legendre rules on (-1, 1).

use core::f64::consts::PI;

/// Newton steps for one node; from the asymptotic guess it has converged after four.
const NEWTON_STEPS: usize = 8;
/// Inner and outer nodes of the rules with two and with three points; the weights of three points
/// are 5/9, 8/9, 5/9.
pub(crate) const TWO_POINT_NODE: f64 = 0.577_350_269_189_625_8;
pub(crate) const THREE_POINT_NODE: f64 = 0.774_596_669_241_483_4;

/// Node i of n, counted from +1 downwards, with its weight: a zero of the Legendre polynomial by
/// Newton's method.
fn node_and_weight(n: usize, i: usize) -> (f64, f64) {
    let mut x = libm::cos(PI * (i as f64 + 0.75) / (n as f64 + 0.5));
    let mut slope = 1.0;
    for _ in 0..NEWTON_STEPS {
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
}

/// Nodes (ascending) and weights of the rule with `n` points.
pub(crate) fn legendre(n: usize) -> Vec<(f64, f64)> {
    let mut rule: Vec<(f64, f64)> = (0..n).map(|i| node_and_weight(n, i)).collect();
    rule.reverse();
    rule
}

/// Nodes (descending) and weights of the rule with N points, without allocation.
pub(crate) fn legendre_array<const N: usize>() -> [[f64; 2]; N] {
    core::array::from_fn(|i| node_and_weight(N, i).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rule_of_n_points_is_exact_for_powers_below_two_n() {
        let rule = legendre_array::<10>();
        for power in 0..20 {
            let term = |[x, w]: &[f64; 2]| (0..power).fold(*w, |term, _| term * x);
            let sum: f64 = rule.iter().map(term).sum();
            let exact = if power % 2 == 0 { 2.0 / f64::from(power + 1) } else { 0.0 };
            assert!((sum - exact).abs() < 1e-14, "{power}: {sum} {exact}");
        }
        let reversed = legendre(10).into_iter().rev();
        assert!(reversed.zip(rule).all(|((x, w), other)| [x, w] == other));
        assert!((legendre(2)[1].0 - TWO_POINT_NODE).abs() < 1e-15);
        assert!((legendre(3)[2].0 - THREE_POINT_NODE).abs() < 1e-15);
    }
}
