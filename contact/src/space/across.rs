//! Computes the base pressure under a pressure that does not vary along an axis, and its means over
//! tactels. The second integral of the base pressure across the axis is kept on a uniform grid: the
//! mean over a tactel in any direction is a second difference of it. Lengths are in thicknesses.
//!
//! The line loads that represent the pressure become one stencil on the tabulated second integral
//! of a unit line's base pressure, so a contact costs one convolution and a tactel four
//! interpolations. Neither allocates nor panics.

use super::super::kernel::BASE_CUTOFF;
use super::super::layer::Transfer;
use crate::numeric::interpolation::six_point;
use core::f64::consts::PI;

/// Grid points per thickness: the interpolation through six points has an error of 3e-8 of the
/// peak.
const POINTS_PER_THICKNESS: f64 = 16.0;
/// Distance at which the base pressure of a line has decayed to 1e-8 of its peak.
const LINE_REACH: f64 = 25.0;
/// Period of the sums that make the table.
const IMAGE_PERIOD: f64 = 88.0;
/// Boxes of a half-width under this are integrated by Gauss's rule of three points instead of
/// exactly, because the second difference divides the table's error by the width.
const NARROW_BOX_HALF_WIDTH: f64 = 0.12;
/// Points on (-1, 1) and weights, of sum 1, of Gauss's rule of three points.
const GAUSS_POINTS_3: [(f64, f64); 3] = [
    (-0.774_596_669_241_483_4, 5.0 / 18.0),
    (0.0, 4.0 / 9.0),
    (0.774_596_669_241_483_4, 5.0 / 18.0),
];
/// Grid points before the axis, which differences and interpolation need.
const POINTS_BEFORE_AXIS: usize = 5;
/// Grid points beyond the end, which differences and interpolation need.
const POINTS_BEYOND_END: usize = 7;

/// The second integral of the base pressure across the axis.
#[derive(Clone, Debug)]
pub(crate) struct Across {
    /// Second integral of a unit line's base pressure; the line itself is at grid point `zero`.
    line: Vec<f64>,
    zero: usize,
    /// The constant of that integral beyond LINE_REACH, where it is half the distance plus this.
    line_offset: f64,
    /// Loads on the grid points about the axis.
    stencil: Vec<f64>,
    /// Second integral of the base pressure; the axis is at grid point `POINTS_BEFORE_AXIS`.
    second: Vec<f64>,
    /// Its slope, the first integral, on the same grid.
    first: Vec<f64>,
    /// Distance from the axis at which the grid ends.
    end: f64,
    /// Constant and slope of the second integral beyond the end, where it is a straight line.
    asymptote: [f64; 2],
    /// 1 for an even pressure, -1 for an odd one.
    mirror: f64,
}

impl Across {
    /// Tabulates the unit line and allocates room for contacts up to a half-width.
    pub(crate) fn new(transfer: &Transfer, widest: f64) -> Self {
        let (spread, points) =
            (spread(widest), POINTS_BEFORE_AXIS + nodes(widest) + POINTS_BEYOND_END);
        let zero = spread + POINTS_BEFORE_AXIS;
        let table = second_integral(transfer);
        let last = table.len() - 1;
        let line_offset = table[last] - 0.5 * last as f64 / POINTS_PER_THICKNESS;
        let at = |i: usize| {
            let distance = i.abs_diff(zero);
            table
                .get(distance)
                .copied()
                .unwrap_or(0.5 * distance as f64 / POINTS_PER_THICKNESS + line_offset)
        };
        Self {
            line: (0..zero + points + spread).map(at).collect(),
            zero,
            line_offset,
            stencil: vec![0.0; 2 * spread + 1],
            second: vec![0.0; points],
            first: vec![0.0; points],
            end: 0.0,
            asymptote: [0.0; 2],
            mirror: 1.0,
        }
    }

    /// Computes the base pressure under pairs of line loads. A pair is the place (above 0) and the
    /// load of one line; the other line mirrors it and has `mirror` times that load.
    pub(crate) fn set_lines(&mut self, lines: &[[f64; 2]], mirror: f64) {
        let widest = lines.iter().fold(0.0_f64, |most, [x, _]| most.max(*x));
        let middle = spread(widest).min(self.stencil.len() / 2);
        let stencil = &mut self.stencil[..=2 * middle];
        stencil.fill(0.0);
        let (mut whole, mut moment) = (0.0, 0.0);
        for &[x, load] in lines {
            for (place, load) in [(x, load), (-x, mirror * load)] {
                let place = place * POINTS_PER_THICKNESS + middle as f64;
                let cell = (place as usize).clamp(2, 2 * middle - 3);
                for (value, weight) in
                    stencil[cell - 2..].iter_mut().zip(six_point_weights(place - cell as f64))
                {
                    *value += weight * load;
                }
                whole += load;
            }
            moment += 2.0 * x * load;
        }
        let count = (POINTS_BEFORE_AXIS + nodes(widest) + POINTS_BEYOND_END).min(self.second.len());
        let second = &mut self.second[..count];
        second.fill(0.0);
        for (m, weight) in stencil.iter().enumerate() {
            let from = self.zero + middle - POINTS_BEFORE_AXIS - m;
            for (value, line) in second.iter_mut().zip(&self.line[from..]) {
                *value += weight * line;
            }
        }
        for i in 3..count - 3 {
            let rise = |k: usize| second[i + k] - second[i - k];
            self.first[i] =
                POINTS_PER_THICKNESS / 60.0 * (45.0 * rise(1) - 9.0 * rise(2) + rise(3));
        }
        self.end = (count - POINTS_BEFORE_AXIS - POINTS_BEYOND_END) as f64 / POINTS_PER_THICKNESS;
        self.mirror = mirror;
        let even = mirror > 0.0;
        self.asymptote =
            if even { [self.line_offset * whole, 0.5 * whole] } else { [-0.5 * moment, 0.0] };
    }

    /// Mean base pressure over the convolution of two boxes of half-widths `wide` and `narrow` at
    /// `u`.
    pub(crate) fn mean(&self, u: f64, wide: f64, narrow: f64) -> f64 {
        // A narrow box is integrated by Gauss's rule over differences of the first integral.
        if narrow < NARROW_BOX_HALF_WIDTH {
            let along = |u: f64| self.first(u + wide) - self.first(u - wide);
            let sum: f64 = GAUSS_POINTS_3.iter().map(|(x, w)| w * along(u + x * narrow)).sum();
            return sum / (2.0 * wide);
        }
        let (sum, rest) = (wide + narrow, wide - narrow);
        let outer = self.second(u + sum) + self.second(u - sum);
        let inner = self.second(u + rest) + self.second(u - rest);
        (outer - inner) / (4.0 * wide * narrow)
    }

    fn second(&self, u: f64) -> f64 {
        let distance = u.abs();
        let value = if distance < self.end {
            six_point(&self.second[POINTS_BEFORE_AXIS - 2..], distance * POINTS_PER_THICKNESS)
        } else {
            self.asymptote[0] + self.asymptote[1] * distance
        };
        if u < 0.0 { self.mirror * value } else { value }
    }

    fn first(&self, u: f64) -> f64 {
        let distance = u.abs();
        let value = if distance < self.end {
            six_point(&self.first[POINTS_BEFORE_AXIS - 2..], distance * POINTS_PER_THICKNESS)
        } else {
            self.asymptote[1]
        };
        if u < 0.0 { -self.mirror * value } else { value }
    }
}

/// Grid points on each side of the axis that lines up to a half-width need.
fn spread(widest: f64) -> usize {
    libm::ceil(widest * POINTS_PER_THICKNESS) as usize + 3
}

/// Grid points from the axis to where the second integral is a straight line.
fn nodes(widest: f64) -> usize {
    libm::ceil((widest + LINE_REACH) * POINTS_PER_THICKNESS) as usize
}

/// Weights of the values at -2, -1 ... 3 in the interpolating polynomial at `x`.
fn six_point_weights(x: f64) -> [f64; 6] {
    let (d0, d1, d2, d3, d4, d5) = (x + 2.0, x + 1.0, x, x - 1.0, x - 2.0, x - 3.0);
    let (low, high) = (d0 * d1 * d2, d3 * d4 * d5);
    [
        d1 * d2 * high / -120.0,
        d0 * d2 * high / 24.0,
        d0 * d1 * high / -12.0,
        d4 * d5 * low / 12.0,
        d3 * d5 * low / -24.0,
        d3 * d4 * low / 120.0,
    ]
}

/// Second integral from 0 of a unit line's base pressure at 0, 1 ... grid spacings, out to its
/// reach: (1/pi) times the integral of f(a) (1 - cos(a x))/a^2.
fn second_integral(transfer: &Transfer) -> Vec<f64> {
    let step = 2.0 * PI / IMAGE_PERIOD;
    let samples = libm::ceil(BASE_CUTOFF / step) as usize;
    let mut table = vec![0.0; (LINE_REACH * POINTS_PER_THICKNESS) as usize + 1];
    for k in 0..=samples {
        let a = k as f64 * step;
        let weight = step / PI * transfer.base_normal(a);
        for (i, sum) in table.iter_mut().enumerate() {
            let x = i as f64 / POINTS_PER_THICKNESS;
            let half = libm::sin(0.5 * a * x);
            *sum += weight * if k == 0 { 0.25 * x * x } else { 2.0 * half * half / (a * a) };
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lines lie between grid points; their sum is compared with the sum over single lines.
    #[test]
    fn means_equal_the_sum_over_single_lines() {
        let transfer = Transfer::new(0.45);
        let lines = [[0.13, 1.0], [0.777, 0.4], [1.91, 0.2]];
        let mut across = Across::new(&transfer, 2.5);
        let table = second_integral(&transfer);
        // One line on the axis and one box are the table's own second difference.
        across.set_lines(&[[0.0, 0.5]], 1.0);
        let own = (table[20] - 2.0 * table[16] + table[12]) / (4.0 * 0.125 * 0.125);
        let mean = across.mean(1.0, 0.125, 0.125);
        assert!((mean - own).abs() < 1e-9, "{mean} {own}");
        for mirror in [1.0, -1.0] {
            across.set_lines(&lines, mirror);
            for u in [-3.0, -0.4, 0.0, 0.3, 1.7, 6.0, 26.5, 40.0] {
                for (wide, narrow) in
                    [(0.9, 0.9), (1.0, 0.3), (1.0, 0.121), (1.0, 0.119), (1.0, 0.0)]
                {
                    let sum = |u: f64| {
                        let mut one = Across::new(&transfer, 0.1);
                        one.set_lines(&[[0.0, 0.5]], 1.0);
                        let pair = |x: f64| {
                            one.mean(u - x, wide, narrow) + mirror * one.mean(u + x, wide, narrow)
                        };
                        lines.iter().map(|[x, load]| load * pair(*x)).sum::<f64>()
                    };
                    let (got, wanted) = (across.mean(u, wide, narrow), sum(u));
                    assert!(
                        (got - wanted).abs() < 1e-6,
                        "{mirror} {u} {wide} {narrow}: {got} {wanted}"
                    );
                }
            }
        }
    }
}
