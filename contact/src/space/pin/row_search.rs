//! The rows of a pin, and the search for the row of a contact: one that holds it, and no longer
//! than it must be.

use super::contact::{ROW_FILL_MIN, RowContact, shortest_row_for};
use super::end_contact::{look_up_end, warm_start};
use super::failure::SolveFailure;
use super::lookup::look_up_full_length;
use super::newton_system::NewtonSystem;
use super::pose::PinState;
use super::solve::solve;
use super::tables::end::EndTable;
use super::target::Target;

/// A contact whose estimated length is this many times longer or shorter than the row in use leaves
/// it at once.
const LENGTH_RATIO_MAX: f64 = 3.0;
/// A contact that fills a row is next solved on a row at most so many rows longer.
const ROWS_UP_MAX: usize = 2;
/// Factor of the contact's length that the plane problem gives for a force, where the pin leans on
/// rubber that keeps its volume. Elsewhere it overestimates the length, which costs less than a row
/// that is too short.
const LENGTH_FACTOR: f64 = 1.12;
/// Most rows on which a contact is searched for from widths that were read.
const WARM_START_ROWS: usize = 3;

/// Slope of a pin, along its rows.
#[derive(Clone, Copy, Debug)]
pub(super) struct PinSlope {
    /// Slope of the axis, at least 0.
    pub(super) slope: f64,
    /// Whether the rows' axis runs against the pin's.
    pub(super) is_turned: bool,
}

/// The rows of a pin. The penetration of a target is that of the deeper end, at `to`.
#[derive(Clone, Debug)]
pub(super) struct PinRows {
    /// The whole pin, then shorter and shorter rows over the end at `to`.
    pub(super) rows: Vec<RowContact>,
    /// End of all rows along the axis, thicknesses from the origin.
    pub(super) to: f64,
    /// Table of contacts of a cylinder on its end.
    pub(super) end_table: Option<EndTable>,
    /// Memory of Newton's method, where the level uses it.
    pub(super) newton: Option<Box<NewtonSystem>>,
    /// Index of the row of the last contact, and whether its axis runs against the pin's.
    pub(super) used: usize,
    pub(super) is_turned: bool,
}

impl PinRows {
    /// The row of the last contact.
    pub(super) fn used_row(&self) -> &RowContact {
        &self.rows[self.used]
    }

    /// Lifts off and forgets the contact.
    pub(super) fn release(&mut self) {
        self.rows[self.used].release();
    }

    /// Solves the contact of a pin: from a table where that has it, otherwise on the rows, from
    /// the last contact.
    pub(super) fn solve(
        &mut self,
        target: Target,
        slope: PinSlope,
        last: &PinState,
    ) -> Result<PinState, SolveFailure> {
        let tabulated = self
            .look_up_end(target, slope)
            .or_else(|| self.look_up_full_length(target, slope))
            .or_else(|| self.solve_from_table(target, slope));
        match tabulated {
            Some(state) => Ok(state),
            None => self.solve_on_rows(target, slope, last),
        }
    }

    /// The contact on an end by its table.
    fn look_up_end(&mut self, target: Target, slope: PinSlope) -> Option<PinState> {
        if self.newton.is_some() {
            return None;
        }
        let table = self.end_table.as_ref()?;
        let (at, state) = look_up_end(table, &mut self.rows, target, slope.slope, self.to)?;
        (self.used, self.is_turned) = (at, slope.is_turned);
        Some(state)
    }

    /// The contact on a good part of the pin by the table of the shortest row that has it.
    fn look_up_full_length(&mut self, target: Target, slope: PinSlope) -> Option<PinState> {
        let to = self.to;
        let rows = self.rows.iter_mut().enumerate().rev();
        let mut found = rows.filter_map(|(at, contact)| {
            Some((at, look_up_full_length(contact, target, slope.slope, to)?))
        });
        let (at, state) = found.next()?;
        (self.used, self.is_turned) = (at, slope.is_turned);
        Some(state)
    }

    /// The contact on an end by Newton's method from widths of the end's table, on the shortest of
    /// some rows that holds it.
    fn solve_from_table(&mut self, target: Target, slope: PinSlope) -> Option<PinState> {
        self.newton.as_ref()?;
        let widths = self.end_table.as_ref()?.widths_for(target, slope.slope)?;
        let shortest = shortest_row_for(&self.rows, widths.reach).max(1);
        for at in (1..=shortest).rev().take(WARM_START_ROWS) {
            self.release();
            (self.used, self.is_turned) = (at, slope.is_turned);
            let start = warm_start(&mut self.rows[at], &widths, self.to, slope.slope);
            let Some(penetration) = start else { continue };
            let outcome = self.solve_row(at, Target { penetration, ..target }, slope.slope);
            let contact = &self.rows[at];
            let has_converged =
                |state: &PinState| state.residual <= contact.row.resolution.residual_max;
            match outcome {
                Ok(state) if has_converged(&state) && !contact.state.touches(0) => {
                    return Some(state);
                }
                _ => {}
            }
        }
        None
    }

    /// The contact on the first row that holds it, from the last contact.
    fn solve_on_rows(
        &mut self,
        target: Target,
        slope: PinSlope,
        last: &PinState,
    ) -> Result<PinState, SolveFailure> {
        let PinSlope { slope, is_turned } = slope;
        let (t, to) = (self.rows[0].row.layer.thickness_mm, self.to);
        let mut at = self.first_row(self.estimated_length(target, slope, last), is_turned);
        let mut start = target.penetration - slope * to;
        let mut has_shortened = false;
        // Each row tried is longer than the one before it, up to the whole pin; once a shorter one.
        loop {
            if (at, is_turned) != (self.used, self.is_turned) {
                self.rows[at].release();
            }
            (self.used, self.is_turned) = (at, is_turned);
            let outcome = self.solve_row(at, Target { penetration: start, ..target }, slope);
            let contact = &self.rows[at];
            let known = match &outcome {
                Ok(state) => Some(state.penetration_mm / t),
                Err(SolveFailure::RowFilled(reached)) => Some(*reached),
                Err(_) => None,
            };
            start = known.unwrap_or(start);
            if at > 0 && (outcome.is_err() || contact.state.touches(0)) {
                // By force the penetration, and with it the contact's length, is known by now.
                let length =
                    known.filter(|_| target.force.is_some()).map(|start| start / slope + to);
                let longer = length.map_or(0, |length| shortest_row_for(&self.rows, length));
                at = longer.clamp(at.saturating_sub(ROWS_UP_MAX), at - 1);
                continue;
            }
            let state = outcome?;
            let length = state.length_mm / t;
            if !has_shortened && length > 0.0 && length < ROW_FILL_MIN * contact.row.length {
                has_shortened = true;
                let shorter = shortest_row_for(&self.rows, length);
                if shorter > at {
                    at = shorter;
                    continue;
                }
            }
            return Ok(state);
        }
    }

    /// Solves the contact on a row; the target's penetration is that of the origin.
    fn solve_row(
        &mut self,
        at: usize,
        target: Target,
        slope: f64,
    ) -> Result<PinState, SolveFailure> {
        solve(&mut self.rows[at], self.newton.as_deref_mut(), target, slope)
    }

    /// Estimated length of the next contact: by penetration from its depth; by force in proportion
    /// to the root of force over slope from the last one's, or from the estimated depth.
    fn estimated_length(&self, target: Target, slope: f64, last: &PinState) -> f64 {
        let (depth, used) = (target.penetration, self.used_row());
        let t = used.row.layer.thickness_mm;
        match target.force {
            Some(force) if used.state.is_warm && last.tilt_rad != 0.0 => {
                let more = force * used.row.modulus_mpa() * t * t / last.force_n;
                let steeper = slope / libm::tan(last.tilt_rad).abs();
                last.length_mm / t * (more / steeper).sqrt()
            }
            Some(_) => LENGTH_FACTOR * depth / slope,
            None => depth / slope,
        }
    }

    /// The row to begin with for a contact of an estimated length: the one in use where it fits.
    fn first_row(&self, length: f64, is_turned: bool) -> usize {
        let used = self.used_row();
        if used.state.is_warm && is_turned == self.is_turned {
            let part = length / used.row.length;
            if (part < LENGTH_RATIO_MAX || self.used == 0) && part > 1.0 / LENGTH_RATIO_MAX {
                return self.used;
            }
        }
        shortest_row_for(&self.rows, length)
    }
}
