//! The surface kernels as cubics in narrow panels on both sides of 0, right to about 1e-6, for the
//! fast accuracy: a few multiplications an entry of its matrices. Lengths in layer thicknesses.
//!
//! It refuses nothing: beyond its reach the callers take the finer tables.

/// Panels per thickness.
const DENSITY: f64 = 8.0;
/// Chebyshev points of a cubic.
const POINTS: [f64; TERMS] = [
    0.923_879_532_511_286_7,
    0.382_683_432_365_089_8,
    -0.382_683_432_365_089_8,
    -0.923_879_532_511_286_7,
];
const TERMS: usize = 4;
/// Adding it rounds to a whole number, which then stands in the low bits.
const WHOLE: f64 = 4_503_599_627_370_496.0;

/// Coefficients of powers of the place inside each panel (-1 to 1).
pub(crate) type Cubic = [f64; TERMS];

/// A function of either sign on panels from -reach to reach.
#[derive(Clone, Debug)]
pub(crate) struct Cubics {
    panels: Vec<Cubic>,
}

/// What the fast accuracy reads: slope and coupling slope, descent and coupled descent.
#[derive(Clone, Debug)]
pub(crate) struct Coarse {
    slope: [Cubics; 2],
    descent: [Cubics; 2],
    reach: f64,
}

/// A kernel about 0 for one coupling, ready to be read.
#[derive(Clone, Debug, Default)]
pub(crate) struct Mixed {
    panels: Vec<Cubic>,
    middle: f64,
}

impl Cubics {
    fn new(reach: f64, of: impl Fn(f64) -> f64) -> Self {
        let side = libm::ceil(reach * DENSITY);
        let panel = |i: usize| {
            let middle = (i as f64 + 0.5 - side) / DENSITY;
            fit(POINTS.map(|u| of(middle + 0.5 * u / DENSITY)))
        };
        Self { panels: (0..2 * side as usize).map(panel).collect() }
    }
}

/// The cubic through values at [`POINTS`], by their cosine series.
fn fit(values: [f64; TERMS]) -> Cubic {
    let [p, q] = [POINTS[0], POINTS[1]];
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

impl Coarse {
    /// From the kernels' slope, coupling slope, descent and coupling, out to `reach`.
    pub(crate) fn new(reach: f64, of: [&dyn Fn(f64) -> f64; 4]) -> Self {
        let [a, b, c, d] = of.map(|of| Cubics::new(reach, of));
        Self { slope: [a, b], descent: [c, d], reach }
    }

    /// Whether distances up to `reach` thicknesses are in the tables.
    pub(crate) fn covers(&self, reach: f64) -> bool {
        reach <= self.reach - 2.0 / DENSITY
    }

    /// Slope plus g times the coupling's, for distances up to `reach`.
    pub(crate) fn slopes(&self, g: f64, reach: f64, out: &mut Mixed) {
        out.mix(&self.slope, g, reach);
    }

    /// Descent plus g times the coupling's.
    pub(crate) fn descents(&self, g: f64, reach: f64, out: &mut Mixed) {
        out.mix(&self.descent, g, reach);
    }
}

impl Mixed {
    /// Room for kernels that reach so far.
    pub(crate) fn with_capacity(reach: f64) -> Self {
        let side = libm::ceil(reach * DENSITY) as usize + 1;
        Self { panels: Vec::with_capacity(2 * side), middle: 0.0 }
    }

    fn mix(&mut self, [first, second]: &[Cubics; 2], g: f64, reach: f64) {
        let side = libm::ceil(reach * DENSITY) as usize + 1;
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
        let place = x * DENSITY + self.middle;
        let whole = place + WHOLE;
        let panel = (whole.to_bits() & 0xffff_ffff) as usize;
        let u = 2.0 * (place - (whole - WHOLE));
        match self.panels.get(panel) {
            Some(c) => (c[0] + c[1] * u) + (c[2] + c[3] * u) * (u * u),
            None => f64::NAN,
        }
    }
}
