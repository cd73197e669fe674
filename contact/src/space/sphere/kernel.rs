//! The kernel of the sphere's integral equation, by which a layer differs from a half space. Beyond
//! the table its asymptote is used.

use super::super::super::layer::Transfer;
use super::super::table::Even;
use crate::numeric::quadrature::legendre;
use crate::wave_grid::FIELD_REACH;

/// Points per thickness of the table.
const POINTS_PER_THICKNESS: f64 = 32.0;

/// Cosine transform of 1 - M, in thicknesses.
#[derive(Clone, Debug)]
pub(super) struct Kernel {
    table: Even,
    /// Coefficients of 1/u^2 and 1/u^4 beyond the table.
    tail: [f64; 2],
}

impl Kernel {
    pub(super) fn new(transfer: &Transfer) -> Self {
        let count = (FIELD_REACH * POINTS_PER_THICKNESS) as usize + 8;
        let rule = legendre(24);
        let mut values = vec![0.0; count];
        // Panels short enough for the fastest cosine of the table; 1 - M dies as exp(-2a).
        let (panels, half) = (42, 0.25);
        for panel in 0..panels {
            for (g, w) in &rule {
                let a = half * ((2 * panel + 1) as f64 + g);
                let weight = half * w * (1.0 - a * transfer.normal_compliance(a));
                let (sine, cosine) =
                    (libm::sin(a / POINTS_PER_THICKNESS), libm::cos(a / POINTS_PER_THICKNESS));
                let (mut s, mut c) = (0.0, 1.0);
                for value in &mut values {
                    *value += weight * c;
                    (s, c) = (s * cosine + c * sine, c * cosine - s * sine);
                }
            }
        }
        let first = transfer.normal_compliance(0.0);
        let cubic = |a: f64| (transfer.normal_compliance(a) - first) / (a * a);
        let third = (4.0 * cubic(0.05) - cubic(0.1)) / 3.0;
        Self { table: Even::new(&values, POINTS_PER_THICKNESS), tail: [first, -6.0 * third] }
    }

    pub(super) fn at(&self, u: f64) -> f64 {
        let u = u.abs();
        if u < self.table.end() {
            return self.table.at(u);
        }
        let over = 1.0 / (u * u);
        over * (self.tail[0] + over * self.tail[1])
    }
}
