//! Features of the stress szz at one depth: exact moments over the infinite layer; moments of the
//! compressive part over a sensor, its peak, and its widths above thresholds. x is measured from
//! the indenter's centre, over which the sensor is centred. Lengths are in mm. The functions
//! allocate.

use super::spectrum::{PointForce, Spectrum};
use crate::layer::{Layer, Transfer};
use crate::numeric::quadrature::legendre_array;
use crate::stack::Stack;
use crate::wave_grid::{FIELD_REACH, GAUSS_POINTS};

/// Half the width of the tactile array (25.4 mm): over which the compressive part is
/// integrated.
pub const SENSOR_HALF_MM: f64 = 12.7;
/// Least and most cells of equal width over the sensor; where more would be needed, each cell is as
/// wide as the stress is smooth.
const CELLS_MIN: f64 = 48.0;
const CELLS_MAX: f64 = 600.0;
/// Step, in parts of a cell, with which the end of a width is searched.
const SEARCH_STEP_CELLS: f64 = 0.25;
/// Most steps of that search.
const SEARCH_STEPS_MAX: usize = 100_000;
/// Most steps of a root search.
const ROOT_ITERATIONS_MAX: usize = 80;
/// Wave numbers, each half the one before, from which the moments over a stack are extrapolated.
const EXTRAPOLATION_STEPS: usize = 4;

/// Moments M0..M3 of szz about x = 0 in N/mm, N, N mm, N mm^2, and the centroid M1/M0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments {
    /// M0 to M3.
    pub m: [f64; 4],
}

impl Moments {
    /// M1/M0 in mm; none when M0 is 0.
    #[must_use]
    pub fn centroid_mm(&self) -> Option<f64> {
        (self.m[0] != 0.0).then(|| self.m[1] / self.m[0])
    }
}

/// Features of the compressive part over the sensor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Compressive {
    /// Moments of min(szz, 0).
    pub moments: Moments,
    /// Place of the largest compression in mm.
    pub x_peak_mm: f64,
    /// The stress there in MPa.
    pub szz_peak_mpa: f64,
    /// Width of the connected part round the peak above each threshold in mm.
    pub widths_mm: Vec<f64>,
}

/// Moments over the infinite layer at a depth, from the tractions on the surface alone.
#[must_use]
pub fn moments(layer: &Layer, forces: &[PointForce], depth_mm: f64) -> Moments {
    moments_of_forces(line_moments(layer, depth_mm), forces)
}

/// The same over a stack, right to about 1e-9 of the load times its thickness squared and cubed.
#[must_use]
pub fn stack_moments(stack: &Stack, forces: &[PointForce], depth_mm: f64) -> Moments {
    let depth = depth_mm.min(stack.thickness_mm());
    let width = stack.reach_mm() / FIELD_REACH;
    // Taylor coefficients F = 1 + f2 k^2 and H = -depth k + h3 k^3 from small wave numbers: steps
    // halved, even powers of the step taken out.
    let mut rows = [[0.0; 2]; EXTRAPOLATION_STEPS];
    for (i, row) in rows.iter_mut().enumerate() {
        let k = 0.2 / width / f64::from(1_u32 << i);
        let (f, h) = stack.stress_transforms(k, depth);
        *row = [(f - 1.0) / (k * k), (h / k + depth) / (k * k)];
    }
    let mut power = 4.0;
    for order in 1..EXTRAPOLATION_STEPS {
        for i in 0..EXTRAPOLATION_STEPS - order {
            rows[i] = [0, 1].map(|j| (power * rows[i + 1][j] - rows[i][j]) / (power - 1.0));
        }
        power *= 4.0;
    }
    moments_of_forces([2.0 * rows[0][0], -depth, -6.0 * rows[0][1]], forces)
}

/// Moments of forces whose line loads have M2 of P, M1 and M3 of Q.
fn moments_of_forces([second, first, third]: [f64; 3], forces: &[PointForce]) -> Moments {
    let mut m = [0.0; 4];
    for &[x, p, q] in forces {
        m[0] -= p;
        m[1] -= x * p - q * first;
        m[2] += p * (second - x * x) + q * 2.0 * x * first;
        m[3] += p * x * (3.0 * second - x * x) + q * (3.0 * x * x * first + third);
    }
    Moments { m }
}

/// M2 of a unit P, M1 and M3 of a unit Q, at a depth: Taylor coefficients of the transfer
/// functions at a = 0, F = 1 + f2 a^2 and H = -d/t a + h3 a^3.
fn line_moments(layer: &Layer, depth_mm: f64) -> [f64; 3] {
    let (t, Transfer { m, n, kap }) = (layer.thickness_mm, layer.transfer());
    let d = (depth_mm / t).min(1.0);
    let (above, mu) = (2.0 - d, m * m + n * n);
    let a2 = (1.0 - d) + 0.5 * d * above * (1.0 + kap) + 0.25 * (kap * above * above + mu * d * d);
    let f2 = (a2 - 2.0 * m) / (m * m);
    let b3 = -(1.0 - d) * d - m * n * d * d * d / 6.0 - 0.25 * d * (kap * above * above + d * d);
    let h3 = b3 / (m * m) + 2.0 * d / m;
    [2.0 * f2 * t * t, -d * t, -6.0 * h3 * t * t * t]
}

/// Edges of the cells in which a stress is integrated over the sensor. No cell is wider than the
/// stretch over which the stress is smooth, however small the layer or the contact is. Where the
/// stress has decayed there are no cells.
fn cell_edges(stress: &Spectrum) -> Vec<f64> {
    let count = equal_cell_count(stress);
    if count <= CELLS_MAX {
        let width = 2.0 * SENSOR_HALF_MM / count;
        return (0..=count as usize).map(|i| i as f64 * width - SENSOR_HALF_MM).collect();
    }
    let [low, high] = stress.span_mm().map(|x| x.clamp(-SENSOR_HALF_MM, SENSOR_HALF_MM));
    let (mut x, mut edges) = (low, vec![low]);
    while x < high {
        let next = (x + stress.smooth_stretch_mm(x, 1.0)).min(high);
        // Places that differ by less than their rounding are the same edge.
        if next <= x {
            break;
        }
        edges.push(next);
        x = next;
    }
    edges
}

/// Number of equal cells that the depth needs.
fn equal_cell_count(stress: &Spectrum) -> f64 {
    libm::ceil((2.0 * SENSOR_HALF_MM / (0.4 * stress.depth_mm())).max(CELLS_MIN))
}

/// Features of the compressive part of a stress over the sensor. `symmetric` says that the stress
/// is even in x.
#[must_use]
pub fn compressive(stress: &Spectrum, symmetric: bool, thresholds_mpa: &[f64]) -> Compressive {
    let szz = |x: f64| stress.szz(x);
    let edges = cell_edges(stress);
    let mut moments = Moments::default();
    // Stress, place, and the cell's width.
    let mut peak = [f64::INFINITY, 0.0, 0.0];
    let mut left = [edges[0], szz(edges[0])];
    for &edge in &edges[1..] {
        let right = [edge, szz(edge)];
        add_cell(&szz, left, right, &mut moments, &mut peak);
        left = right;
    }
    let (x_peak, at_peak) = refine_peak(stress, peak[1], 0.5 * peak[2]);
    let centre = szz(0.0);
    let (x_peak_mm, szz_peak_mpa) = if symmetric && centre <= at_peak * (1.0 - 1e-11) {
        (0.0, centre)
    } else {
        (x_peak, at_peak)
    };
    let even = 2.0 * SENSOR_HALF_MM / equal_cell_count(stress);
    let is_even = equal_cell_count(stress) <= CELLS_MAX;
    let step = |x: f64, side: f64| {
        SEARCH_STEP_CELLS * if is_even { even } else { stress.smooth_stretch_mm(x, side) }
    };
    let reach = |threshold: f64, side: f64| -> f64 {
        let excess = |x: f64| -szz(x) - threshold;
        let mut inner = x_peak_mm;
        for _ in 0..SEARCH_STEPS_MAX {
            let outer = inner + side * step(inner, side);
            if excess(outer) <= 0.0 {
                return side * (root(&excess, inner, outer) - x_peak_mm);
            }
            inner = outer;
        }
        f64::INFINITY
    };
    let width_above = |threshold: &f64| {
        if *threshold >= -szz_peak_mpa {
            return 0.0;
        }
        reach(*threshold, -1.0) + reach(*threshold, 1.0)
    };
    let widths_mm = thresholds_mpa.iter().map(width_above).collect();
    Compressive { moments, x_peak_mm, szz_peak_mpa, widths_mm }
}

/// Adds a cell, split where the stress changes its sign.
fn add_cell(
    szz: &impl Fn(f64) -> f64,
    left: [f64; 2],
    right: [f64; 2],
    moments: &mut Moments,
    peak: &mut [f64; 3],
) {
    let width = right[0] - left[0];
    for [x, s] in [left, right] {
        if s < peak[0] {
            *peak = [s, x, width];
        }
    }
    let mut add = |from: f64, to: f64| {
        for [u, w] in legendre_array::<GAUSS_POINTS>() {
            let x = 0.5 * (from + to) + 0.5 * (to - from) * u;
            let s = szz(x);
            if s < peak[0] {
                *peak = [s, x, width];
            }
            let part = 0.5 * (to - from) * w * s.min(0.0);
            let mut power = part;
            for m in &mut moments.m {
                *m += power;
                power *= x;
            }
        }
    };
    if (left[1] < 0.0) == (right[1] < 0.0) {
        add(left[0], right[0]);
        return;
    }
    let zero = root(szz, left[0], right[0]);
    if left[1] < 0.0 { add(left[0], zero) } else { add(zero, right[0]) }
}

/// Rates of the compressive part's moments over the sensor as the stress changes at the rate
/// `change` and shifts along x; where the stress changes its sign it is 0, so the ends of the part
/// add nothing. `moments` are those of the compressive part now.
pub(super) fn compressive_rate(
    stress: &Spectrum,
    change: &Spectrum,
    shift: f64,
    moments: &Moments,
) -> [f64; 4] {
    let szz = |x: f64| stress.szz(x);
    let edges = cell_edges(stress);
    let mut rate = [0.0; 4];
    let mut add = |from: f64, to: f64| {
        for [u, w] in legendre_array::<GAUSS_POINTS>() {
            let x = 0.5 * (from + to) + 0.5 * (to - from) * u;
            let mut power = 0.5 * (to - from) * w * change.szz(x);
            for m in &mut rate {
                *m += power;
                power *= x;
            }
        }
    };
    let mut left = szz(edges[0]);
    for cell in edges.windows(2) {
        let (from, to) = (cell[0], cell[1]);
        let right = szz(to);
        match (left < 0.0, right < 0.0) {
            (true, true) => add(from, to),
            (true, false) => add(from, root(&szz, from, to)),
            (false, true) => add(root(&szz, from, to), to),
            (false, false) => {}
        }
        left = right;
    }
    // The stress that moves past the sensor's ends.
    let ends = [-SENSOR_HALF_MM, SENSOR_HALF_MM].map(|x| (x, szz(x).min(0.0)));
    for (order, m) in rate.iter_mut().enumerate() {
        let own = if order == 0 { 0.0 } else { order as f64 * moments.m[order - 1] };
        let power = |x: f64| (0..order).fold(1.0, |power, _| power * x);
        let lost = ends[1].1 * power(ends[1].0) - ends[0].1 * power(ends[0].0);
        *m += shift * (own - lost);
    }
    rate
}

/// The extremum near the smallest sample, from the zero of the slope.
fn refine_peak(stress: &Spectrum, x: f64, reach: f64) -> (f64, f64) {
    let slope = |x: f64| stress.slope(x);
    let (low, high) = (x - reach, x + reach);
    if slope(low) < 0.0 && slope(high) > 0.0 {
        let x = root(&slope, low, high);
        return (x, stress.szz(x));
    }
    (x, stress.szz(x))
}

/// A zero between two places of opposite sign, by the method of false position in its Illinois
/// form.
fn root(f: &impl Fn(f64) -> f64, from: f64, to: f64) -> f64 {
    let (mut a, mut b) = (from, to);
    let (mut fa, mut fb) = (f(a), f(b));
    for _ in 0..ROOT_ITERATIONS_MAX {
        if fb == 0.0 || (b - a).abs() < 1e-14 * (1.0 + b.abs()) {
            return b;
        }
        if fa == 0.0 {
            return a;
        }
        let c = b - fb * (b - a) / (fb - fa);
        let fc = f(c);
        if (fc < 0.0) == (fb < 0.0) {
            fa *= 0.5;
        } else {
            (a, fa) = (b, fb);
        }
        (b, fb) = (c, fc);
    }
    b
}

#[cfg(test)]
mod tests {
    use super::super::spectrum::transforms;
    use super::*;

    /// Tests a very narrow stress and one close under the surface: the stress of a line load is
    /// compressive everywhere, the peak is found, and the ends of the widths lie where the stress
    /// has the threshold's value.
    #[test]
    fn the_scan_sees_what_is_far_smaller_than_the_sensor() {
        for (t, depth) in [(0.008, 1.0), (1e-3, 1.0), (1e-6, 1.0), (0.8, 1e-3), (0.1, 0.01)] {
            let layer = Layer::new(t, 27.58, 0.49).expect("a layer");
            for [p, q] in [[0.7, 0.0], [0.7, 0.05], [0.01, -0.02]] {
                let forces = [[0.3, p, q]];
                let stress = Spectrum::new(&layer, &forces, depth * t, 20.0);
                let found = compressive(&stress, false, &[0.1]);
                let fine = (-40_000..=40_000).map(|i| 0.3 + 1e-4 * depth * t * f64::from(i));
                let lowest = fine.map(|x| stress.szz(x)).fold(0.0, f64::min);
                assert!((found.szz_peak_mpa / lowest - 1.0).abs() < 1e-6, "{t}: {found:?}");
                assert_eq!(stress.szz(found.x_peak_mm), found.szz_peak_mpa);
                let full = moments(&layer, &forces, depth * t).m;
                if q == 0.0 {
                    // There is hardly any tension under P alone.
                    let miss = found.moments.m[0] / full[0] - 1.0;
                    assert!((-1e-9..1e-3).contains(&miss), "{t}: {miss}");
                    assert!((found.x_peak_mm - 0.3).abs() < 1e-6 * t, "{t}: {found:?}");
                    let end = 0.3 + 0.5 * found.widths_mm[0];
                    assert!((stress.szz(end) + 0.1).abs() < 1e-5, "{t}: {}", stress.szz(end));
                }
            }
        }
    }

    #[test]
    fn moments_of_line_loads_are_those_of_the_reference_and_of_the_transfer_functions() {
        for nu in [0.2, 0.49, 0.5] {
            let t = 0.8;
            let layer = Layer::new(t, 27.58, nu).expect("a layer");
            let exact = [-nu / (1.0 - nu) * t * t, -t, t * t * t * (1.0 - 5.0 / (1.0 - nu))];
            for (found, exact) in line_moments(&layer, t).iter().zip(exact) {
                assert!((found - exact).abs() < 1e-14, "{nu}: {found} {exact}");
            }
            for depth in [0.1, 0.5, 0.9] {
                let [second, first, third] = line_moments(&layer, depth * t);
                let transfer = layer.transfer();
                let a = 0.01;
                let (f, h) = transforms(&transfer, a, depth);
                let off_f = (f - 1.0) / (a * a) - 0.5 * second / (t * t);
                let off_h = (h / a - first / t) / (a * a) + third / (6.0 * t * t * t);
                assert!(off_f.abs() < 2e-3 && off_h.abs() < 2e-3, "{nu} {depth}: {off_f} {off_h}");
            }
        }
    }
}
