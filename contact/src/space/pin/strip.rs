//! Tabulates the plane contact problem of one slice of a pin over the half-width b of the contact.
//! The pressure is a cosine series times the singularity of the square root, p = modulus
//! psi(theta)/(b sin theta), x = b cos theta, psi = sum a_k cos(2 k theta). A row of the table
//! holds the Galerkin matrix of the layer's plane kernel, the moments of the shape, and the two
//! plane solutions (contact and flat punch) that the solver in space starts from.
//!
//! Lengths are in thicknesses. Contacts beyond the bounds are refused when the table is made;
//! reading a row cannot fail.

use super::super::super::Invalid;
use super::super::super::kernel::SurfaceKernel;
use super::super::super::layer::Transfer;
use crate::numeric::cholesky::{factor, solve};
use crate::numeric::interpolation::cubic;
use core::f64::consts::{LN_2, PI};

/// Rows of the table over the half-width.
const TABLE_ROWS: usize = 96;
/// Slices over which the force of an estimated penetration is summed.
const ESTIMATE_SLICES: usize = 16;
/// Most bisections of the estimated penetration.
const BISECTIONS_MAX: usize = 40;
/// Most iterations that find the half-width of a penetration.
const INVERSION_STEPS_MAX: usize = 12;
/// Relative error of the penetration at which these iterations end.
const INVERSION_TOLERANCE: f64 = 1e-9;
/// Most cosines of a row.
pub(crate) const COSINES_MAX: usize = 96;
/// Largest half-width in thicknesses.
const HALF_WIDTH_MAX: f64 = 40.0;
/// Largest half-width in radii.
const HALF_WIDTH_RATIO_MAX: f64 = 0.95;

/// Cross-section of a pin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Section {
    /// The exact circle of this radius.
    Circle(f64),
    /// A flat bar of this half-width.
    Flat(f64),
}

/// Indices of the parts of a row, for a number of cosines.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StripLayout {
    pub(crate) cosines: usize,
}

impl StripLayout {
    /// Entry (k, l <= k) of the matrix.
    pub(crate) fn matrix(self, k: usize, l: usize) -> usize {
        k * (k + 1) / 2 + l
    }
    /// Moment k of the shape.
    pub(crate) fn shape(self, k: usize) -> usize {
        self.matrix(self.cosines, 0) + k
    }
    /// Coefficient k of the plane contact of this width.
    pub(crate) fn contact(self, k: usize) -> usize {
        self.shape(self.cosines) + k
    }
    /// Coefficient k of the flat punch of this width, per unit penetration.
    pub(crate) fn punch(self, k: usize) -> usize {
        self.contact(self.cosines) + k
    }
    /// Penetration of the plane contact.
    pub(crate) fn penetration(self) -> usize {
        self.punch(self.cosines)
    }
    /// Sum of the punch's coefficients: the strength of its singularity at the edge.
    pub(crate) fn edge(self) -> usize {
        self.penetration() + 1
    }
    /// The penetration without its logarithm of the half-width: this smooth part is interpolated.
    pub(crate) fn smooth(self) -> usize {
        self.edge() + 1
    }
    /// Numbers in a row.
    pub(crate) fn len(self) -> usize {
        self.smooth() + 1
    }
}

/// Plane problems of one section over the half-width.
#[derive(Clone, Debug)]
pub(crate) struct StripTable {
    pub(crate) layout: StripLayout,
    section: Section,
    /// Half-width of the last row. The table of a flat bar has one row only.
    widest: f64,
    rows: Vec<f64>,
}

impl StripTable {
    /// Tables up to a penetration (thicknesses).
    pub(crate) fn new(
        kernel: &SurfaceKernel,
        section: Section,
        penetration: f64,
        cosines: impl Fn(f64) -> usize,
    ) -> Result<Self, Invalid> {
        let widest = match section {
            Section::Flat(half) if half > HALF_WIDTH_MAX => {
                let what = format!("{half} thicknesses on each side");
                return Err(Invalid::new("width_mm", what, "give a narrower bar"));
            }
            Section::Flat(half) => half,
            Section::Circle(radius) => widest(kernel, section, radius, penetration)?,
        };
        let layout = StripLayout { cosines: cosines(widest).min(COSINES_MAX) };
        let mut rows = vec![0.0; layout.len() * (TABLE_ROWS + 1)];
        for (i, row) in rows.chunks_exact_mut(layout.len()).enumerate() {
            let b = match section {
                Section::Circle(_) => widest * (i as f64).max(0.01) / TABLE_ROWS as f64,
                Section::Flat(_) => widest,
            };
            if !fill(kernel, section, b, layout, row) {
                let what = format!("cosines over {b} thicknesses to each side lose their digits");
                return Err(Invalid::new("width_mm", what, "give a narrower contact"));
            }
            if i == 0 && matches!(section, Section::Circle(_)) {
                // The shape and the contact go as the square of the width: they are 0 at width 0.
                row[layout.shape(0)..layout.punch(0)].fill(0.0);
                (row[layout.penetration()], row[layout.smooth()]) = (0.0, 0.0);
            }
            if matches!(section, Section::Flat(_)) {
                let own = row.to_vec();
                rows.truncate(0);
                rows.extend_from_slice(&own);
                break;
            }
        }
        Ok(Self { layout, section, widest, rows })
    }

    /// The odd problem of a bar of half-width `half`: the displacement is proportional to the
    /// distance from the axis, psi = sum a_k cos((2 k + 1) theta). Absent where the even problem
    /// has no solution either.
    pub(crate) fn odd(transfer: &Transfer, half: f64, cosines: usize) -> Option<Self> {
        let kernel = SurfaceKernel::new(|a| transfer.normal_compliance(a));
        let layout = StripLayout { cosines };
        let mut rows = vec![0.0; layout.len()];
        let solved = fill_odd(&kernel, half, layout, &mut rows);
        solved.then_some(Self { layout, section: Section::Flat(half), widest: half, rows })
    }

    /// Largest half-width of the table.
    pub(crate) fn widest(&self) -> f64 {
        self.widest
    }

    /// Whether the width of the contact depends on the penetration.
    pub(crate) fn is_free(&self) -> bool {
        matches!(self.section, Section::Circle(_))
    }

    /// Writes the row of half-width `b` > 0, its logarithms of b included.
    pub(crate) fn row(&self, b: f64, out: &mut [f64]) {
        if !self.is_free() {
            out.copy_from_slice(&self.rows);
            return;
        }
        let (parts, w) = self.around(b);
        for (i, value) in out.iter_mut().enumerate() {
            *value =
                w[0] * parts[0][i] + w[1] * parts[1][i] + w[2] * parts[2][i] + w[3] * parts[3][i];
        }
        let (logarithm, layout) = (PI * libm::log(b), self.layout);
        out[layout.matrix(0, 0)] -= PI * logarithm;
        out[layout.penetration()] = out[layout.smooth()] - logarithm * out[layout.contact(0)];
    }

    /// Penetration of the plane contact of half-width `b` > 0, interpolated as in [`Self::row`].
    fn penetration(&self, b: f64) -> f64 {
        let (parts, w) = self.around(b);
        let at = |i: usize| (0..4).map(|k| w[k] * parts[k][i]).sum::<f64>();
        at(self.layout.smooth()) - PI * libm::log(b) * at(self.layout.contact(0))
    }

    /// The four rows around half-width `b` and their interpolation weights.
    fn around(&self, b: f64) -> ([&[f64]; 4], [f64; 4]) {
        let place = (b / self.widest).clamp(0.0, 1.0) * TABLE_ROWS as f64;
        let cell = (place as usize).min(TABLE_ROWS - 1);
        let width = self.layout.len();
        let s = place - cell as f64;
        let at = |i: isize| {
            let i = i.unsigned_abs().min(TABLE_ROWS);
            &self.rows[i * width..(i + 1) * width]
        };
        let cell = cell as isize;
        // Rows are even in b, which gives the row before the first; at the last cell the four rows
        // lie on one side.
        let shift = if cell as usize == TABLE_ROWS - 1 { 1 } else { 0 };
        let w = cubic(s + shift as f64);
        ([-1, 0, 1, 2].map(|k| at(cell - shift + k)), w)
    }

    /// Writes the cosine coefficients of the plane contact of a penetration above 0, whose
    /// half-width is `b`. Returns the first coefficient at that penetration or at `least`,
    /// whichever is deeper.
    pub(crate) fn plane_pressure(
        &self,
        penetration: f64,
        b: f64,
        least: f64,
        out: &mut [f64],
    ) -> f64 {
        self.contact(b, out);
        if penetration >= least {
            return out[0];
        }
        let mut first = [0.0];
        self.contact(self.half_width(least), &mut first);
        first[0]
    }

    /// Writes the first cosines of the plane contact of half-width `b`.
    fn contact(&self, b: f64, out: &mut [f64]) {
        let (parts, w) = self.around(b);
        let from = self.layout.contact(0);
        for (i, value) in (from..).zip(out) {
            *value =
                w[0] * parts[0][i] + w[1] * parts[1][i] + w[2] * parts[2][i] + w[3] * parts[3][i];
        }
    }

    /// Half-width of the plane contact of a penetration above 0, at most the table's largest: the
    /// inverse of [`Self::penetration`].
    pub(crate) fn half_width(&self, penetration: f64) -> f64 {
        let (low, part) = self.place(penetration);
        if part >= 1.0 {
            return self.widest;
        }
        // The penetration goes nearly as the square of the width.
        let (first, width) = (self.layout.penetration(), self.layout.len());
        let [below, above] = [low, low + 1].map(|i| self.rows[i * width + first]);
        let below = if low == 0 { 0.0 } else { below };
        let (low, high) = (low as f64, low as f64 + 1.0);
        let per = (high * high - low * low) / (above - below);
        let mut square = low * low + part * (high * high - low * low);
        let unit = self.widest / TABLE_ROWS as f64;
        for _ in 0..INVERSION_STEPS_MAX {
            let found = self.penetration(unit * square.sqrt());
            let miss = penetration - found;
            // In the first cell the penetration is nearly b^2 log(1/b): the slope is taken at the
            // current half-width.
            let per = if low == 0.0 && found > 0.0 { square / found } else { per };
            square = (square + per * miss).max(0.5 * square);
            if miss.abs() <= INVERSION_TOLERANCE * penetration {
                break;
            }
        }
        (unit * square.sqrt()).min(self.widest)
    }

    /// The row below a penetration and the part of the way to the next, at most the table's end.
    fn place(&self, penetration: f64) -> (usize, f64) {
        let (width, place) = (self.layout.len(), self.layout.penetration());
        let at = |i: usize| if i == 0 { 0.0 } else { self.rows[i * width + place] };
        if !self.is_free() || penetration.is_nan() || penetration >= at(TABLE_ROWS) {
            return (TABLE_ROWS - 1, 1.0);
        }
        let (mut low, mut high) = (0, TABLE_ROWS);
        while high - low > 1 {
            let middle = usize::midpoint(low, high);
            if at(middle) <= penetration { low = middle } else { high = middle }
        }
        (low, (penetration - at(low)) / (at(high) - at(low)))
    }

    /// Largest penetration of the table; 1 thickness for a flat bar, which has no bound of its own.
    pub(crate) fn deepest(&self) -> f64 {
        let last = self.rows.len() - self.layout.len();
        if self.is_free() { self.rows[last + self.layout.penetration()] } else { 1.0 }
    }

    /// Largest penetration along a pin of a length and slope at which independent plane slices
    /// carry a force (in units of the kernels). It is the end of the table if the force is more
    /// than the slices carry there: a short pin carries more than its slices would alone.
    pub(crate) fn depth_of(&self, force: f64, slope: f64, length: f64) -> f64 {
        let carried = |depth: f64| {
            let touched = if slope * length > depth { depth / slope } else { length };
            let part = touched / ESTIMATE_SLICES as f64;
            let at = |i: usize| self.load(depth - slope * part * (i as f64 + 0.5));
            part * (0..ESTIMATE_SLICES).map(at).sum::<f64>()
        };
        let (mut low, mut high) = (0.0, self.deepest());
        for _ in 0..BISECTIONS_MAX {
            let middle = 0.5 * (low + high);
            if carried(middle) < force {
                low = middle
            } else {
                high = middle
            }
            if high - low < 0.01 * high {
                break;
            }
        }
        0.5 * (low + high)
    }

    /// Load of the plane contact of a penetration above 0.
    fn load(&self, penetration: f64) -> f64 {
        let (width, layout) = (self.layout.len(), self.layout);
        if !self.is_free() {
            return PI * penetration * self.rows[layout.punch(0)];
        }
        let at = |i: usize| if i == 0 { 0.0 } else { self.rows[i * width + layout.contact(0)] };
        let (low, part) = self.place(penetration);
        PI * (at(low) + part * (at(low + 1) - at(low)))
    }

    /// Whether a penetration is within the table.
    pub(crate) fn contains(&self, penetration: f64) -> bool {
        let last = self.rows.len() - self.layout.len();
        !self.is_free() || penetration <= self.rows[last + self.layout.penetration()]
    }
}

/// Force of a plane punch of this half-width per unit penetration; NaN where it is too wide.
pub(crate) fn punch_force(kernel: &SurfaceKernel, half: f64) -> f64 {
    let layout = StripLayout { cosines: 12 + libm::ceil(2.0 * half) as usize };
    let mut row = vec![0.0; layout.len()];
    let solved = fill(kernel, Section::Flat(half), half, layout, &mut row);
    if solved { PI * row[layout.punch(0)] } else { f64::NAN }
}

/// Half-width of a contact 2 % deeper than `penetration`, to a relative accuracy of 1e-3.
fn widest(
    kernel: &SurfaceKernel,
    section: Section,
    radius: f64,
    penetration: f64,
) -> Result<f64, Invalid> {
    let layout = StripLayout { cosines: 12 };
    let mut row = vec![0.0; layout.len()];
    let mut reached = |b: f64| {
        if fill(kernel, section, b, layout, &mut row) {
            row[layout.penetration()]
        } else {
            f64::NAN
        }
    };
    let wanted = 1.02 * penetration;
    let (mut low, mut high) = (0.0, HALF_WIDTH_MAX.min(HALF_WIDTH_RATIO_MAX * radius));
    if reached(high).is_nan() || reached(high) < wanted {
        let what = format!("{penetration} thicknesses make the contact wider than the table");
        return Err(Invalid::new("penetration_max_mm", what, "press less"));
    }
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if reached(middle) < wanted {
            low = middle
        } else {
            high = middle
        }
        if high - low < 1e-3 * high {
            break;
        }
    }
    Ok(high)
}

/// Integration points on one half of a strip.
struct Points<'a> {
    x: &'a [f64],
    /// The cosines at the points, cosine after cosine.
    cosines: &'a [f64],
    weight: f64,
}

/// Adds the smooth part of the kernel to the Galerkin matrix of the cosines. The points `x` are on
/// one half of the strip; the other half mirrors them with the same sign (`parity` 1) or the
/// opposite one (-1).
fn add_smooth_part(
    kernel: &SurfaceKernel,
    points: &Points<'_>,
    parity: f64,
    layout: StripLayout,
    row: &mut [f64],
) {
    let Points { x, cosines, weight } = *points;
    let (n, half) = (layout.cosines, x.len());
    let mut acted = vec![0.0; n];
    for i in 0..half {
        acted.fill(0.0);
        for j in 0..half {
            let near = kernel.smooth((x[i] - x[j]).abs());
            let s = 0.5 * weight * weight * (near + parity * kernel.smooth(x[i] + x[j]));
            for (l, sum) in acted.iter_mut().enumerate() {
                *sum += s * cosines[l * half + j];
            }
        }
        for k in 0..n {
            for l in 0..=k {
                row[layout.matrix(k, l)] += cosines[k * half + i] * acted[l];
            }
        }
    }
}

/// The lower triangle of a row's matrix, row by row.
fn lower(layout: StripLayout, row: &[f64]) -> Vec<f64> {
    let n = layout.cosines;
    let mut matrix = vec![0.0; n * n];
    for k in 0..n {
        for l in 0..=k {
            matrix[k * n + l] = row[layout.matrix(k, l)];
        }
    }
    matrix
}

/// Writes the row of half-width `b`, its matrix without the logarithm of b for a circle. False
/// where the plane problem is no longer positive definite.
fn fill(
    kernel: &SurfaceKernel,
    section: Section,
    b: f64,
    layout: StripLayout,
    row: &mut [f64],
) -> bool {
    let n = layout.cosines;
    let half = n + 6 + libm::ceil(3.0 * b) as usize;
    let angle = |i: usize| PI * (2 * i + 1) as f64 / (4 * half) as f64;
    let cosines: Vec<f64> =
        (0..n * half).map(|m| libm::cos(2.0 * (m / half) as f64 * angle(m % half))).collect();
    let x: Vec<f64> = (0..half).map(|i| b * libm::cos(angle(i))).collect();
    let weight = PI / half as f64;
    row.fill(0.0);
    add_smooth_part(kernel, &Points { x: &x, cosines: &cosines, weight }, 1.0, layout, row);
    for i in 0..half {
        let height = match section {
            Section::Circle(r) => x[i] * x[i] / (r + (r * r - x[i] * x[i]).sqrt()),
            Section::Flat(_) => 0.0,
        };
        for k in 0..n {
            row[layout.shape(k)] += weight * cosines[k * half + i] * height;
        }
    }
    row[layout.matrix(0, 0)] += PI * PI * LN_2;
    for k in 1..n {
        row[layout.matrix(k, k)] += PI * PI / (4 * k) as f64;
    }
    let logarithm = PI * PI * libm::log(b);
    let mut matrix = lower(layout, row);
    matrix[0] -= logarithm;
    let mut punch = vec![0.0; n];
    punch[0] = PI;
    let mut shape: Vec<f64> = (0..n).map(|k| row[layout.shape(k)]).collect();
    if !factor(&mut matrix, n) {
        return false;
    }
    solve(&matrix, n, &mut punch);
    solve(&matrix, n, &mut shape);
    let edge: f64 = punch.iter().sum();
    let penetration = shape.iter().sum::<f64>() / edge;
    for k in 0..n {
        row[layout.contact(k)] = penetration * punch[k] - shape[k];
        row[layout.punch(k)] = punch[k];
    }
    row[layout.penetration()] = penetration;
    row[layout.smooth()] = penetration + PI * libm::log(b) * row[layout.contact(0)];
    row[layout.edge()] = edge;
    if !matches!(section, Section::Circle(_)) {
        row[layout.matrix(0, 0)] -= logarithm;
    }
    true
}

/// Writes the row of the odd problem: the matrix, and, in the place of the punch, the coefficients
/// for a displacement of 1 in the first odd cosine. False where the problem is not positive
/// definite. The logarithm of b is a constant, which has no odd part.
fn fill_odd(kernel: &SurfaceKernel, b: f64, layout: StripLayout, row: &mut [f64]) -> bool {
    let n = layout.cosines;
    let half = n + 6 + libm::ceil(3.0 * b) as usize;
    let angle = |i: usize| PI * (2 * i + 1) as f64 / (4 * half) as f64;
    let cosine = |k: usize, i: usize| libm::cos((2 * k + 1) as f64 * angle(i));
    let cosines: Vec<f64> = (0..n * half).map(|m| cosine(m / half, m % half)).collect();
    let x: Vec<f64> = (0..half).map(|i| b * libm::cos(angle(i))).collect();
    let weight = PI / half as f64;
    row.fill(0.0);
    add_smooth_part(kernel, &Points { x: &x, cosines: &cosines, weight }, -1.0, layout, row);
    for k in 0..n {
        row[layout.matrix(k, k)] += PI * PI / (4 * k + 2) as f64;
    }
    let mut matrix = lower(layout, row);
    let mut punch = vec![0.0; n];
    punch[0] = PI;
    if !factor(&mut matrix, n) {
        return false;
    }
    solve(&matrix, n, &mut punch);
    row[layout.punch(0)..layout.penetration()].copy_from_slice(&punch);
    row[layout.edge()] = punch.iter().sum();
    true
}
