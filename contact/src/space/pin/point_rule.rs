//! Points across a strip that stand for its pressure in an image, and the sums of its cosines at
//! them.

use core::f64::consts::PI;

/// Most points across half a strip.
pub(super) const POINTS_MAX: usize = 96;

/// Points across half a strip of half-width `b` that stand for wave numbers up to `cutoff`: the
/// error of the Gauss-Chebyshev rule with 2 n points is the Bessel function J_4n(cutoff b).
pub(super) fn points_for(cutoff: f64, b: f64) -> usize {
    (libm::ceil(0.25 * (cutoff * b + 0.5 * cutoff)) as usize).clamp(2, POINTS_MAX)
}

/// Points across half a strip, and cos(2 k theta) at them.
#[derive(Clone, Debug)]
pub(super) struct PointRule {
    /// cos(theta), from the edge inwards.
    pub(super) places: Vec<f64>,
    /// cos(2 k theta) at the outer half of the points, k after k; the inner half mirrors them, with
    /// the sign changed for every other k.
    cosines: Vec<f64>,
}

impl PointRule {
    /// A rule of so many points for so many cosines; allocates.
    pub(super) fn new(points: usize, cosines: usize) -> Self {
        let angle = |i: usize| PI * (2 * i + 1) as f64 / (4 * points) as f64;
        let outer = points.div_ceil(2);
        let of = |k: usize| (0..outer).map(move |i| libm::cos(2.0 * k as f64 * angle(i)));
        Self {
            places: (0..points).map(|i| libm::cos(angle(i))).collect(),
            cosines: (0..cosines).flat_map(of).collect(),
        }
    }

    /// Places of the points, over the half-width, and sums of some cosines at them, from the edge
    /// inwards.
    pub(super) fn at<'a>(
        &'a self,
        a: &[f64],
        out: &'a mut [f64; POINTS_MAX],
    ) -> impl Iterator<Item = (f64, f64)> + 'a {
        let (points, outer) = (self.places.len(), self.places.len().div_ceil(2));
        let mut odd = [0.0; POINTS_MAX / 2];
        let (even, odd) = (&mut out[..outer], &mut odd[..outer]);
        even.fill(0.0);
        for (two, a) in self.cosines.chunks(2 * outer).zip(a.chunks(2)) {
            let (first, second) = two.split_at(outer);
            even.iter_mut().zip(first).for_each(|(sum, cosine)| *sum += a[0] * cosine);
            if let [_, a] = a {
                odd.iter_mut().zip(second).for_each(|(sum, cosine)| *sum += a * cosine);
            }
        }
        for i in 0..outer {
            let (even, odd) = (out[i], odd[i]);
            out[points - 1 - i] = even - odd;
            out[i] = even + odd;
        }
        self.places.iter().copied().zip(out.iter().copied())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The sums over half of the points, mirrored, against the plain sums.
    #[test]
    fn rules_sum_cosines() {
        for points in 1..12 {
            for cosines in 1..7 {
                let rule = PointRule::new(points, cosines);
                let a: Vec<f64> = (0..cosines).map(|k| 0.3 + libm::sin(k as f64)).collect();
                let mut sums = [0.0; POINTS_MAX];
                for (i, (place, sum)) in rule.at(&a, &mut sums).enumerate() {
                    let angle = libm::acos(place);
                    let of = |(k, a): (usize, &f64)| a * libm::cos(2.0 * k as f64 * angle);
                    let exact: f64 = a.iter().enumerate().map(of).sum();
                    assert!((sum - exact).abs() < 1e-12, "{points} {cosines} {i}");
                }
            }
        }
    }
}
