//! The surface kernels as cubics in narrow panels on both sides of 0, right to about 1e-6, for the
//! fast solutions: each entry of their matrices then costs a few multiplications. Lengths are in
//! layer thicknesses.
//!
//! Beyond the reach of these tables the callers use the finer ones.

/// Panels per thickness.
const PANELS_PER_THICKNESS: f64 = 8.0;
/// Chebyshev points of a cubic.
const CHEBYSHEV_POINTS: [f64; COEFFICIENT_COUNT] = [
    0.923_879_532_511_286_7,
    0.382_683_432_365_089_8,
    -0.382_683_432_365_089_8,
    -0.923_879_532_511_286_7,
];
const COEFFICIENT_COUNT: usize = 4;
/// 2^52: adding it rounds a number to the nearest integer, which then stands in the low bits.
const ROUNDING_OFFSET: f64 = 4_503_599_627_370_496.0;

/// Coefficients of powers of the place inside each panel (-1 to 1).
pub(crate) type Cubic = [f64; COEFFICIENT_COUNT];

/// A function of either sign on panels from -reach to reach.
#[derive(Clone, Debug)]
pub(crate) struct PiecewiseCubic {
    panels: Vec<Cubic>,
}

/// The kernels of fast solutions: slope and coupling slope, descent and coupled descent.
#[derive(Clone, Debug)]
pub(crate) struct CoarseKernels {
    slope: [PiecewiseCubic; 2],
    descent: [PiecewiseCubic; 2],
    reach: f64,
}

/// The kernels combined for one coupling g, on both sides of 0.
#[derive(Clone, Debug, Default)]
pub(crate) struct CombinedKernel {
    panels: Vec<Cubic>,
    middle: f64,
}

impl PiecewiseCubic {
    fn new(reach: f64, of: impl Fn(f64) -> f64) -> Self {
        let side = libm::ceil(reach * PANELS_PER_THICKNESS);
        let panel = |i: usize| {
            let middle = (i as f64 + 0.5 - side) / PANELS_PER_THICKNESS;
            fit_cubic(CHEBYSHEV_POINTS.map(|u| of(middle + 0.5 * u / PANELS_PER_THICKNESS)))
        };
        Self { panels: (0..2 * side as usize).map(panel).collect() }
    }
}

/// The cubic through values at [`CHEBYSHEV_POINTS`], by their cosine series.
fn fit_cubic(values: [f64; COEFFICIENT_COUNT]) -> Cubic {
    let [p, q] = [CHEBYSHEV_POINTS[0], CHEBYSHEV_POINTS[1]];
    let [even, odd] = [
        [values[0] + values[3], values[1] + values[2]],
        [values[0] - values[3], values[1] - values[2]],
    ];
    // An even part a + c u^2 and an odd one b u + d u^3, each through two points.
    let c = 0.5 * (even[0] - even[1]) / (p * p - q * q);
    let a = 0.5 * even[0] - c * p * p;
    let d = 0.5 * (odd[0] / p - odd[1] / q) / (p * p - q * q);
    let b = 0.5 * odd[0] / p - d * p * p;
    [a, b, c, d]
}

impl CoarseKernels {
    /// From the kernels' slope, coupling slope, descent and coupling, out to `reach`.
    pub(crate) fn new(reach: f64, of: [&dyn Fn(f64) -> f64; 4]) -> Self {
        let [a, b, c, d] = of.map(|of| PiecewiseCubic::new(reach, of));
        Self { slope: [a, b], descent: [c, d], reach }
    }

    /// Whether distances up to `reach` thicknesses are in the tables.
    pub(crate) fn covers(&self, reach: f64) -> bool {
        reach <= self.reach - 2.0 / PANELS_PER_THICKNESS
    }

    /// Slope plus g times the coupling's, for distances up to `reach`.
    pub(crate) fn slopes(&self, g: f64, reach: f64, out: &mut CombinedKernel) {
        out.combine(&self.slope, g, reach);
    }

    /// Descent plus g times the coupling's.
    pub(crate) fn descents(&self, g: f64, reach: f64, out: &mut CombinedKernel) {
        out.combine(&self.descent, g, reach);
    }
}

impl CombinedKernel {
    /// Room for kernels that reach so far.
    pub(crate) fn with_capacity(reach: f64) -> Self {
        let side = libm::ceil(reach * PANELS_PER_THICKNESS) as usize + 1;
        Self { panels: Vec::with_capacity(2 * side), middle: 0.0 }
    }

    fn combine(&mut self, [first, second]: &[PiecewiseCubic; 2], g: f64, reach: f64) {
        let side = libm::ceil(reach * PANELS_PER_THICKNESS) as usize + 1;
        let from = (first.panels.len() / 2).saturating_sub(side);
        let whole = from..(first.panels.len() - from);
        let pairs = first.panels[whole.clone()].iter().zip(&second.panels[whole]);
        self.panels.clear();
        self.panels.extend(pairs.map(|(a, b)| core::array::from_fn(|i| a[i] + g * b[i])));
        self.middle = 0.5 * self.panels.len() as f64 - 0.5;
    }

    /// The kernel at a distance within the reach.
    #[inline(always)]
    pub(crate) fn at(&self, x: f64) -> f64 {
        let place = x * PANELS_PER_THICKNESS + self.middle;
        let whole = place + ROUNDING_OFFSET;
        let panel = (whole.to_bits() & 0xffff_ffff) as usize;
        let u = 2.0 * (place - (whole - ROUNDING_OFFSET));
        match self.panels.get(panel) {
            Some(c) => (c[0] + c[1] * u) + (c[2] + c[3] * u) * (u * u),
            None => f64::NAN,
        }
    }
}
