//! Makes a pin a little longer or shorter than one that was pressed. It is cut into the same number
//! of slices, so that the difference between the two contacts comes from their length and not from
//! slices that are added or left out.

use super::super::super::Invalid;
use super::super::super::kernel::SurfaceKernel;
use super::contact::RowContact;
use super::resolution::{BarResolution, Resolution, SliceSpacing};
use super::row::RowPlan;
use super::solver::Pin;

/// Slice length (thicknesses) so small that it never limits a row whose number of slices is given.
const SLICE_LENGTH_UNUSED: f64 = 1e-9;
/// Loosest tolerance of a contact from which a difference is taken, and its least number of steps.
const DIFFERENCE_TOLERANCE: f64 = 1e-4;
const DIFFERENCE_STEPS: usize = 60;

/// The ends of a pin that the contact last pressed may touch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ContactedEnds {
    /// Both ends.
    Both,
    /// Only the first or the second end.
    One(usize),
}

impl Pin {
    /// The ends that the contact last pressed may touch.
    pub(crate) fn contacted_ends(&self) -> ContactedEnds {
        match (self.rows().used, self.rows().is_turned) {
            (0, _) => ContactedEnds::Both,
            (_, false) => ContactedEnds::One(1),
            (_, true) => ContactedEnds::One(0),
        }
    }

    /// The pin with both ends moved outwards by `by_mm`, without contact, for contacts along its
    /// whole length; allocates.
    ///
    /// # Errors
    /// None is expected for a pin of about the same length.
    pub(crate) fn lengthened(&self, by_mm: f64) -> Result<Self, Invalid> {
        let whole = &self.rows().rows[0];
        let [from, to] = self.ends();
        let by = by_mm / self.layer().thickness_mm;
        let ends = [from - by, to + by];
        let count = whole.row.along.len() as f64;
        let spacing = SliceSpacing {
            fewest: count,
            slice: SLICE_LENGTH_UNUSED,
            enough: count,
            longest: f64::INFINITY,
        };
        let resolution = Resolution::for_accuracy(self.level());
        let resolution = Resolution {
            whole: spacing,
            end: spacing,
            tolerance: resolution.tolerance.min(DIFFERENCE_TOLERANCE),
            steps: resolution.steps.max(DIFFERENCE_STEPS),
            bar: resolution.bar.map(|bar| BarResolution { whole: spacing, ..bar }),
            ..resolution
        };
        let transfer = self.layer().transfer();
        let kernel = SurfaceKernel::new(|a| transfer.normal_compliance(a));
        let mut contact = RowContact::new(RowPlan {
            layer: self.layer(),
            kernel: &kernel,
            strips: whole.row.strips.clone(),
            is_whole: true,
            ends,
            resolution,
        })?;
        contact.tables.end_correction = whole.tables.end_correction.clone();
        Ok(self.with_row(ends, contact, resolution.newton_unknowns))
    }
}
