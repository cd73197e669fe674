//! Tabulates how the base carries the load of a contact line: the share of the load left of a
//! place, over penetration and place. Reading a table neither allocates nor panics.

use super::kernel::BaseKernel;
use super::numeric::cubic_hermite::hermite;

/// Columns from the contact line out to where the share is 1.
const COLUMN_COUNT: usize = 160;
/// Distance beyond the contact's edge that a row covers, in thicknesses; exp(-0.739 * 20) is 4e-7.
const MARGIN_THICKNESSES: f64 = 20.0;
/// Reach of a step: only the line itself lies within it, and columns a mm are still a number.
const STEP_REACH_MM: f64 = 1e-30;

/// Pressure of a strip: points at +-`place` (in thicknesses), with the share of the load that each
/// pair carries.
pub(crate) struct StripPressure<'a> {
    pub(crate) half_width: f64,
    pub(crate) places: &'a [f64],
    pub(crate) weights: &'a [f64],
}

/// Share left of u and its slope per column.
type ShareRow = [[f64; 2]; COLUMN_COUNT + 1];

/// Rows over an index of penetration, columns over |u| as a part of the row's reach.
#[derive(Clone, Debug)]
pub(crate) struct ShareTable {
    rows: Vec<ShareRow>,
    /// Reach of each row in mm.
    reach_mm: Vec<f64>,
}

impl ShareTable {
    /// The table without rows.
    pub(crate) fn new() -> Self {
        Self { rows: Vec::new(), reach_mm: Vec::new() }
    }

    /// The table of a base that carries every load right under its line.
    pub(crate) fn step() -> Self {
        Self { rows: vec![[[1.0, 0.0]; COLUMN_COUNT + 1]; 2], reach_mm: vec![STEP_REACH_MM; 2] }
    }

    /// Adds the row of a strip, by convolving its pressure with the base kernel.
    pub(crate) fn push(
        &mut self,
        kernel: &BaseKernel,
        strip: &StripPressure<'_>,
        thickness_mm: f64,
    ) {
        let reach = strip.half_width + MARGIN_THICKNESSES;
        let width = reach / COLUMN_COUNT as f64;
        self.reach_mm.push(reach * thickness_mm);
        let mut row = [[1.0, 0.0]; COLUMN_COUNT + 1];
        for (column, filled) in row.iter_mut().take(COLUMN_COUNT).enumerate() {
            let u = column as f64 * width;
            let mut entry = [0.0, 0.0];
            for (place, weight) in strip.places.iter().zip(strip.weights) {
                let [near, far] = [u - place, u + place].map(|u| kernel.share_and_density(u));
                entry[0] += 0.5 * weight * (near[0] + far[0]);
                entry[1] += 0.5 * weight * (near[1] + far[1]);
            }
            *filled = [entry[0], entry[1] * width];
        }
        self.rows.push(row);
    }

    /// The shares at a row index that need not be whole; indices outside are taken at the nearest
    /// row.
    pub(crate) fn row(&self, index: f64) -> BaseShares<'_> {
        let last = self.reach_mm.len().saturating_sub(2);
        let row = (index as usize).min(last);
        let part = (index - row as f64).clamp(0.0, 1.0);
        let reach = self.reach_mm[row] + part * (self.reach_mm[row + 1] - self.reach_mm[row]);
        let (low, high) = (&self.rows[row], &self.rows[row + 1]);
        BaseShares { low, high, part, columns_per_mm: COLUMN_COUNT as f64 / reach }
    }
}

/// How the base carries the load of a contact line at one penetration.
#[derive(Clone, Copy, Debug)]
pub struct BaseShares<'a> {
    low: &'a ShareRow,
    high: &'a ShareRow,
    part: f64,
    columns_per_mm: f64,
}

impl BaseShares<'_> {
    /// Part of the line load that the base carries left of `u_mm` from the contact line; NaN for
    /// NaN.
    #[must_use]
    #[inline]
    pub fn left_of(&self, u_mm: f64) -> f64 {
        let place = u_mm.abs() * self.columns_per_mm;
        if place >= COLUMN_COUNT as f64 {
            return if u_mm > 0.0 { 1.0 } else { 0.0 };
        }
        let column = (place as u32 as usize).min(COLUMN_COUNT - 1);
        let entry = |column: usize| {
            let (low, high) = (self.low[column], self.high[column]);
            [low[0] + self.part * (high[0] - low[0]), low[1] + self.part * (high[1] - low[1])]
        };
        let share = hermite(entry(column), entry(column + 1), place - column as f64);
        if u_mm < 0.0 { 1.0 - share } else { share }
    }
}
