//! Gauss-Jacobi rules with exponents that add up to -1 or +1: the nodes and weights by which
//! singular integral equations of contact are solved (Erdogan, Gupta and Cook, Mechanics of
//! Fracture 1, 1973). Filling a rule does not allocate as long as it stays within its capacity.
//! Exponents at or below -1 and at or above 1 are the caller's mistake.

use core::f64::consts::{LN_2, PI};

/// Most Newton steps for one block of nodes; from the asymptotic guess four are enough.
const NEWTON_STEPS_MAX: usize = 12;
/// A Newton step shorter than this part of the node's distance from the ends is the last one, since
/// the next would be of the order of its square. The second value is that of coarse rules.
const STEP_TOLERANCE: [f64; 2] = [1e-8, 1e-4];
/// Nodes that are iterated together, side by side in registers.
const NODES_AT_ONCE: usize = 4;

/// Nodes, descending, with weights for (1 - x)^alpha (1 + x)^beta.
#[derive(Clone, Debug, Default)]
pub(crate) struct JacobiRule {
    /// Zeros of the Jacobi polynomial.
    pub(crate) nodes: Vec<f64>,
    /// Their weights; the sum is the integral of the weight function.
    pub(crate) weights: Vec<f64>,
    /// Barycentric weights of the interpolation through the nodes.
    barycentric: Vec<f64>,
    recurrence: JacobiRecurrence,
    alpha: f64,
    beta: f64,
}

/// P_k = (a x + b) P_{k-1} - c P_{k-2} for k = 2, 3 ...
#[derive(Clone, Debug, Default)]
pub(crate) struct JacobiRecurrence {
    steps: Vec<[f64; 3]>,
    exponents: [f64; 2],
    coarse: bool,
}

impl JacobiRecurrence {
    pub(crate) fn with_capacity(capacity: usize) -> Self {
        Self { steps: Vec::with_capacity(capacity), exponents: [0.0; 2], coarse: false }
    }

    /// The same with zeros right to about 1e-8.
    pub(crate) fn with_coarse_tolerance(self) -> Self {
        Self { coarse: true, ..self }
    }

    fn prepare(&mut self, n: usize, alpha: f64, beta: f64) {
        if self.exponents != [alpha, beta] {
            self.steps.clear();
            self.exponents = [alpha, beta];
        }
        let sum = alpha + beta;
        for k in self.steps.len() + 2..=n {
            let k = k as f64;
            let two = 2.0 * k + sum;
            let over = 1.0 / (2.0 * k * (k + sum) * (two - 2.0));
            self.steps.push([
                over * (two - 1.0) * two * (two - 2.0),
                over * (two - 1.0) * (alpha * alpha - beta * beta),
                over * 2.0 * (k + alpha - 1.0) * (k + beta - 1.0) * two,
            ]);
        }
    }

    /// P_n and (1 - x^2) P_n' at some places.
    fn evaluate(&self, n: usize, x: &[f64; NODES_AT_ONCE]) -> [[f64; NODES_AT_ONCE]; 2] {
        let [alpha, beta] = self.exponents;
        let mut before = [1.0; NODES_AT_ONCE];
        let mut here = x.map(|x| (alpha + 1.0) + 0.5 * (alpha + beta + 2.0) * (x - 1.0));
        for [a, b, c] in &self.steps[..n.saturating_sub(1)] {
            for i in 0..NODES_AT_ONCE {
                let next = (a * x[i] + b) * here[i] - c * before[i];
                (before[i], here[i]) = (here[i], next);
            }
        }
        let n = n as f64;
        let two = 2.0 * n + alpha + beta;
        let scaled = core::array::from_fn(|i| {
            let own = n * (alpha - beta - two * x[i]) * here[i];
            (own + 2.0 * (n + alpha) * (n + beta) * before[i]) / two
        });
        [here, scaled]
    }

    /// Fills `zeros` with the n >= 1 zeros of P_n, descending, and passes each zero with its
    /// (1 - x^2) P_n' to `note`. If `zeros` already holds n zeros for nearly the same exponents,
    /// Newton's method starts from them.
    pub(crate) fn zeros(
        &mut self,
        n: usize,
        [alpha, beta]: [f64; 2],
        zeros: &mut Vec<f64>,
        mut note: impl FnMut(f64, f64),
    ) {
        let [old, _] = self.exponents;
        let warm = zeros.len() == n && !self.steps.is_empty() && (old - alpha).abs() < 0.02;
        self.prepare(n, alpha, beta);
        if !warm {
            let count = n as f64 + 0.5 * (alpha + beta + 1.0);
            let guess = |k: usize| libm::cos(PI * (k as f64 + 0.75 + 0.5 * alpha) / count);
            zeros.clear();
            zeros.extend((0..n).map(guess));
        }
        for block in zeros.chunks_mut(NODES_AT_ONCE) {
            // A last block with fewer nodes repeats its first one.
            let mut x: [f64; NODES_AT_ONCE] =
                core::array::from_fn(|i| block.get(i).copied().unwrap_or(block[0]));
            let mut slopes = [1.0; NODES_AT_ONCE];
            for _ in 0..NEWTON_STEPS_MAX {
                let [value, scaled] = self.evaluate(n, &x);
                slopes = scaled;
                let mut largest: f64 = 0.0;
                for i in 0..NODES_AT_ONCE {
                    let inside = 1.0 - x[i] * x[i];
                    let step = value[i] * inside / scaled[i];
                    // The slope at the new place, from the polynomial's differential equation.
                    let bend = alpha - beta + (alpha + beta) * x[i];
                    slopes[i] -= step * bend / inside * scaled[i];
                    x[i] -= step;
                    largest = largest.max(step.abs() / inside);
                }
                if largest < STEP_TOLERANCE[usize::from(self.coarse)] {
                    break;
                }
            }
            for ((zero, x), slope) in block.iter_mut().zip(x).zip(slopes) {
                *zero = x;
                note(x, slope);
            }
        }
    }
}

impl JacobiRule {
    /// An empty rule with room for `capacity` nodes.
    pub(crate) fn with_capacity(capacity: usize) -> Self {
        let room = || Vec::with_capacity(capacity);
        let recurrence = JacobiRecurrence::with_capacity(capacity);
        let (nodes, weights, barycentric) = (room(), room(), room());
        Self { nodes, weights, barycentric, recurrence, alpha: 0.0, beta: 0.0 }
    }

    /// The same with nodes right to about 1e-8.
    pub(crate) fn with_coarse_tolerance(self) -> Self {
        Self { recurrence: self.recurrence.with_coarse_tolerance(), ..self }
    }

    /// Makes this the rule of `n` nodes for exponents with alpha + beta = -1.
    pub(crate) fn fill(&mut self, n: usize, alpha: f64, beta: f64) {
        if self.nodes.len() == n && self.alpha == alpha && self.beta == beta {
            return;
        }
        (self.alpha, self.beta) = (alpha, beta);
        let Self { nodes, weights, barycentric, recurrence, .. } = self;
        weights.clear();
        barycentric.clear();
        if alpha == -0.5 {
            // Chebyshev's polynomials.
            let angle = |j: usize| PI * (2 * j + 1) as f64 / (2 * n) as f64;
            nodes.clear();
            nodes.extend((0..n).map(|j| libm::cos(angle(j))));
            weights.resize(n, PI / n as f64);
            let sign = |j: usize| if j.is_multiple_of(2) { 1.0 } else { -1.0 };
            barycentric.extend((0..n).map(|j| sign(j) * (1.0 - nodes[j] * nodes[j]).sqrt()));
            return;
        }
        recurrence.zeros(n, [alpha, beta], nodes, |x, slope| {
            weights.push((1.0 - x * x) / (slope * slope));
        });
        let scale = weight_integral(alpha) / weights.iter().sum::<f64>();
        let mut sign = 1.0;
        for (x, weight) in nodes.iter().zip(weights) {
            *weight *= scale;
            barycentric.push(sign * ((1.0 - x * x) * *weight).sqrt());
            sign = -sign;
        }
    }

    /// The polynomial through `values` at the nodes, at x.
    pub(crate) fn interpolate(&self, values: &[f64], x: f64) -> f64 {
        let (mut above, mut below) = (0.0, 0.0);
        for ((node, factor), value) in self.nodes.iter().zip(&self.barycentric).zip(values) {
            let distance = x - node;
            if distance == 0.0 {
                return *value;
            }
            let term = factor / distance;
            above += term * value;
            below += term;
        }
        above / below
    }

    /// The weight function at x inside (-1, 1).
    pub(crate) fn weight(&self, x: f64) -> f64 {
        if self.alpha == -0.5 {
            return 1.0 / ((1.0 - x) * (1.0 + x)).sqrt();
        }
        let (right, left) = (libm::log1p(-x), libm::log1p(x));
        libm::exp(self.alpha * right + self.beta * left)
    }
}

/// Integral of (1 - x)^alpha (1 + x)^(-1 - alpha) over (-1, 1).
pub(crate) fn weight_integral(alpha: f64) -> f64 {
    PI / libm::sin(PI * (alpha + 1.0))
}

/// Mean of ln(1 - x) under the weight (1 - x)^beta (1 + x)^(-1 - beta).
pub(crate) fn mean_log(beta: f64) -> f64 {
    LN_2 + digamma(beta + 1.0) - digamma(1.0)
}

/// The logarithmic derivative of the gamma function for x > 0: recurrence, then Stirling's series.
fn digamma(x: f64) -> f64 {
    let (mut x, mut sum) = (x, 0.0);
    while x < 12.0 {
        sum -= 1.0 / x;
        x += 1.0;
    }
    let s = 1.0 / (x * x);
    let series =
        1.0 / 12.0 - s * (1.0 / 120.0 - s * (1.0 / 252.0 - s * (1.0 / 240.0 - s * (1.0 / 132.0))));
    sum + libm::log(x) - 0.5 / x - s * series
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_are_exact_for_polynomials() {
        // Moments of the weight by the recurrence of the Beta function:
        // integral of (1 - x)^j times the weight = 2^j B(alpha + 1 + j, beta + 1).
        for alpha in [-0.5, -0.3, -0.72, -0.49] {
            let beta = -1.0 - alpha;
            for n in [1, 2, 5, 12, 45, 120] {
                let mut rule = JacobiRule::default();
                rule.fill(n, alpha, beta);
                assert!(rule.nodes.windows(2).all(|w| w[0] > w[1]), "{alpha} {n}");
                let mut exact = weight_integral(alpha);
                for j in 0..(2 * n).min(30) {
                    let sum: f64 = (rule.nodes.iter().zip(&rule.weights))
                        .map(|(x, w)| {
                            let mut power = *w;
                            (0..j).for_each(|_| power *= 1.0 - x);
                            power
                        })
                        .sum();
                    assert!((sum / exact - 1.0).abs() < 1e-12, "{alpha} {n} {j}: {sum} {exact}");
                    exact *= 2.0 * (alpha + 1.0 + j as f64) / (j as f64 + 1.0);
                }
            }
        }
    }

    #[test]
    fn interpolation_reaches_the_ends() {
        let mut rule = JacobiRule::default();
        rule.fill(9, -0.4, -0.6);
        let cubic = |x: f64| 2.0 - x + 3.0 * x * x * x;
        let values: Vec<f64> = rule.nodes.iter().map(|x| cubic(*x)).collect();
        for x in [-1.0, -0.2, 0.0, 0.77, 1.0] {
            assert!((rule.interpolate(&values, x) - cubic(x)).abs() < 1e-13);
        }
        assert_eq!(rule.interpolate(&values, rule.nodes[3]), values[3]);
    }

    #[test]
    fn digamma_is_known_at_one_and_a_half() {
        assert!((digamma(1.0) + 0.577_215_664_901_532_9).abs() < 4e-15);
        assert!((digamma(0.5) - digamma(1.0) + 2.0 * LN_2).abs() < 4e-15);
    }
}
