//! The contact of a row of slices: which slices touch, their widths and pressures, and the tables
//! of the plane problem at those widths.

use super::failure::SolveFailure;
use super::row::SliceRow;
use super::strip::{StripLayout, StripTable};

/// State of a contact. Every vector holds its values slice after slice.
#[derive(Clone, Debug)]
pub(super) struct ContactState {
    /// Layout of a row of the strip table.
    pub(super) layout: StripLayout,
    /// Numbers that the transform of one slice takes.
    pub(super) transform_len: usize,
    /// Penetration in thicknesses that each slice's width belongs to; 0 or less without contact.
    pub(super) effective: Vec<f64>,
    /// Penetration in thicknesses of the rigid pin.
    pub(super) given: Vec<f64>,
    /// Half-widths in thicknesses.
    pub(super) widths: Vec<f64>,
    /// Whether each slice touches.
    pub(super) active: Vec<bool>,
    /// Row of the strip table at each slice's width.
    pub(super) rows: Vec<f64>,
    /// Transforms of the cosines at each slice's width.
    pub(super) transforms: Vec<f64>,
    /// Cosine coefficients of the pressure.
    pub(super) a: Vec<f64>,
    /// Whether a contact is known, from which the next one may start.
    pub(super) is_warm: bool,
    /// Whether the widths were read from a table, so that `rows` and `transforms` are out of date.
    pub(super) has_read_widths: bool,
    /// Whether the search starts at widths that were read from a table, close to its solution.
    pub(super) has_warm_start: bool,
}

impl ContactState {
    /// No contact on `slices` slices; allocates.
    pub(super) fn new(slices: usize, strips: &StripTable, transform_len: usize) -> Self {
        let layout = strips.layout;
        let n = layout.cosines;
        let per_slice = |count: usize| vec![0.0; slices * count];
        Self {
            layout,
            transform_len,
            effective: per_slice(1),
            given: per_slice(1),
            widths: per_slice(1),
            active: vec![false; slices],
            rows: per_slice(layout.len()),
            transforms: per_slice(transform_len),
            a: per_slice(n),
            is_warm: false,
            has_read_widths: false,
            has_warm_start: false,
        }
    }

    /// Forgets the contact.
    pub(super) fn clear(&mut self) {
        self.is_warm = false;
        self.has_read_widths = false;
        self.has_warm_start = false;
        self.active.fill(false);
        self.a.fill(0.0);
    }

    /// Prescribes a displacement on some slices, which touch whatever the pressure is.
    pub(super) fn prescribe(&mut self, displacement: impl Fn(usize) -> Option<f64>) {
        for j in 0..self.active.len() {
            let prescribed = displacement(j);
            self.active[j] = prescribed.is_some();
            self.given[j] = prescribed.unwrap_or(0.0);
            self.effective[j] = self.given[j];
        }
    }

    /// Largest penetration of the rigid pin.
    pub(super) fn deepest(&self) -> f64 {
        self.given.iter().fold(0.0_f64, |most, given| most.max(*given))
    }

    /// The scale of changes: the largest penetration that a slice is given or, where widths are
    /// free, that its width belongs to.
    pub(super) fn penetration_scale(&self, is_free: bool) -> f64 {
        let given = self.deepest().max(f64::MIN_POSITIVE);
        if !is_free {
            return given;
        }
        let slices = self.effective.iter().zip(&self.active);
        slices.filter(|(_, active)| **active).fold(given, |most, (own, _)| most.max(*own))
    }

    /// Whether a slice touches.
    pub(super) fn touches(&self, slice: usize) -> bool {
        self.active[slice]
    }

    /// Half-width in thicknesses and cosine coefficients of a slice.
    pub(super) fn slice(&self, slice: usize) -> (f64, &[f64]) {
        let n = self.layout.cosines;
        (self.widths[slice], &self.a[slice * n..(slice + 1) * n])
    }

    /// Row of the strip table at a slice's width.
    pub(super) fn row(&self, slice: usize) -> &[f64] {
        let width = self.layout.len();
        &self.rows[slice * width..(slice + 1) * width]
    }

    /// The first and the last slice that touches; absent without contact.
    pub(super) fn contact_range(&self) -> Option<[usize; 2]> {
        let mut touching = (0..self.active.len()).filter(|j| self.touches(*j));
        let first = touching.next()?;
        Some([first, touching.next_back().unwrap_or(first)])
    }

    /// Half-width of the last slice.
    pub(super) fn end_width(&self) -> f64 {
        self.widths[self.widths.len() - 1]
    }

    /// Computes widths, table rows and transforms of all slices that touch; `from_plane` starts
    /// the pressures from the plane contacts.
    ///
    /// # Errors
    /// A width beyond the row's tables.
    pub(super) fn update_slices(
        &mut self,
        row: &SliceRow,
        from_plane: bool,
    ) -> Result<(), SolveFailure> {
        let (layout, n) = (self.layout, self.layout.cosines);
        for j in 0..row.along.len() {
            if !self.active[j] || self.effective[j] <= 0.0 {
                self.active[j] = false;
                self.a[j * n..(j + 1) * n].fill(0.0);
                continue;
            }
            let b = row.strips.half_width(self.effective[j]);
            if !row.strips.contains(self.effective[j]) || b > row.widest {
                return Err(SolveFailure::BeyondTable);
            }
            let starts = from_plane || self.a[j * n] == 0.0;
            let table = &mut self.rows[j * layout.len()..(j + 1) * layout.len()];
            let per = self.transform_len;
            let transform = &mut self.transforms[j * per..(j + 1) * per];
            // A slice of unchanged width keeps its table row and its transform.
            if b != self.widths[j] || starts || self.has_read_widths {
                self.widths[j] = b;
                row.strips.row(b, table);
                row.coupling.transform(b, transform);
            }
            if starts {
                let rest = self.effective[j] - table[layout.penetration()];
                for k in 0..n {
                    self.a[j * n + k] = table[layout.contact(k)] + rest * table[layout.punch(k)];
                }
            }
        }
        self.has_read_widths = false;
        Ok(())
    }
}
