//! A pin beside one that was pressed, a little longer or shorter: cut into as many slices, so that
//! what the two differ by is the length's doing and not that of slices which come and go. It
//! allocates, and refuses what a row refuses.

use super::super::super::Invalid;
use super::super::super::kernel::SurfaceKernel;
use super::fineness::{Fineness, Laid};
use super::newton::Newton;
use super::row::Row;
use super::{Pin, PinState};

/// Slices are given by their number: no length asks for so many.
const COUNTED: f64 = 1e-9;
/// At least so exact is the contact of a pin that is there for a difference, and its most steps.
const EXACT: f64 = 1e-4;
const STEPS: usize = 60;

/// What ends of a pin have to do with the contact last pressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reach {
    /// The whole pin is looked at.
    Whole,
    /// Only what is at its first or second end.
    End(usize),
}

impl Pin {
    /// Which ends the contact last pressed may touch.
    pub(crate) fn reach(&self) -> Reach {
        match (self.at, self.turned) {
            (0, _) => Reach::Whole,
            (_, false) => Reach::End(1),
            (_, true) => Reach::End(0),
        }
    }

    /// The pin with both ends so much (mm) further out, without contact, for pressing what touches
    /// the whole of it.
    ///
    /// # Errors
    /// What rows refuse; none is expected of what is about as long.
    pub(crate) fn lengthened(&self, by_mm: f64) -> Result<Self, Invalid> {
        let whole = &self.rows[0];
        let [from, to] = self.ends;
        let by = by_mm / self.layer.thickness_mm;
        let ends = [from - by, to + by];
        let count = whole.along.len() as f64;
        let laid = Laid { fewest: count, slice: COUNTED, enough: count, longest: f64::INFINITY };
        let fineness = Fineness::of(self.level);
        let fineness = Fineness {
            whole: laid,
            end: laid,
            tolerance: fineness.tolerance.min(EXACT),
            steps: fineness.steps.max(STEPS),
            nested: fineness.nested.map(|tabled| super::fineness::Tabled { whole: laid, ..tabled }),
            ..fineness
        };
        let transfer = self.layer.transfer();
        let kernel = SurfaceKernel::new(|a| transfer.normal_compliance(a));
        let over = (whole.strips.clone(), true);
        let row = Row::new((&self.layer, &kernel), over, ends, fineness)?;
        let rows = vec![Row { leftover: whole.leftover.clone(), ..row }];
        let newton = self.newton.is_some();
        let newton = newton.then(|| Box::new(Newton::new(&rows, fineness.together)));
        let (layer, level, state) = (self.layer, self.level, PinState::default());
        let (corner, at, turned) = (None, 0, false);
        Ok(Self { layer, level, ends, rows, corner, newton, at, turned, state })
    }
}
