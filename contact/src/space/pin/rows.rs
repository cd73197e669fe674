//! The row of slices that a contact is looked for on: one that holds it, and no longer than it must
//! be. It refuses what the whole pin refuses.

use super::row::holding;
use super::work::Trouble;
use super::{Pin, PinState};

/// Part of a row below which a shorter one takes its contact over.
pub(super) const KEPT: f64 = 0.45;
/// A contact guessed so many times longer or shorter than the row in use leaves it at once.
const FAR: f64 = 3.0;
/// So many rows on at most a contact is looked for that fills a row.
const UP: usize = 2;
/// So many times what the plane tells of a force a contact is long where it leans on rubber that
/// keeps its volume. Elsewhere that is too long, which costs less than a row that is too short.
const GUESSED: f64 = 1.12;

impl Pin {
    /// The contact on the first row that holds it, by a force or at the depth guessed, under a
    /// slope; the state of that row.
    pub(super) fn on_rows(
        &mut self,
        (wanted, guess): (Option<f64>, f64),
        slope: f64,
        turned: bool,
    ) -> Result<PinState, Trouble> {
        let (t, to) = (self.layer.thickness_mm, self.ends[1]);
        let mut at = self.row_for(self.guessed(wanted, guess, slope), turned);
        let mut start = guess - slope * to;
        let mut shortened = false;
        // Each row tried is longer than the one before it, up to the whole pin; once a shorter one.
        loop {
            if (at, turned) != (self.at, self.turned) {
                self.rows[at].release();
            }
            (self.at, self.turned) = (at, turned);
            let outcome = self.press_on(at, (wanted, start), slope);
            let row = &self.rows[at];
            let known = match &outcome {
                Ok(state) => Some(state.penetration_mm / t),
                Err(Trouble::Filled(reached)) => Some(*reached),
                Err(_) => None,
            };
            start = known.unwrap_or(start);
            if at > 0 && (outcome.is_err() || row.work.touches(0)) {
                // By force it is known by now how far the pin reaches in.
                let reach = known.filter(|_| wanted.is_some()).map(|start| start / slope + to);
                let holding = reach.map_or(0, |reach| holding(&self.rows, reach));
                at = holding.clamp(at.saturating_sub(UP), at - 1);
                continue;
            }
            let state = outcome?;
            let touched = state.length_mm / t;
            if !shortened && touched > 0.0 && touched < KEPT * row.length {
                shortened = true;
                let shorter = holding(&self.rows, touched);
                if shorter > at {
                    at = shorter;
                    continue;
                }
            }
            return Ok(state);
        }
    }

    /// Presses a row, which has the memory to settle all its widths meanwhile.
    pub(super) fn press_on(
        &mut self,
        at: usize,
        (wanted, start): (Option<f64>, f64),
        slope: f64,
    ) -> Result<PinState, Trouble> {
        let row = &mut self.rows[at];
        row.newton = self.newton.take();
        let outcome = row.press((wanted, start), slope);
        self.newton = row.newton.take();
        outcome
    }

    /// Length of a contact to come: by penetration from its depth; by force like the root of the
    /// force over the slope from the last one's, or without one from a guess of its depth.
    fn guessed(&self, wanted: Option<f64>, depth: f64, slope: f64) -> f64 {
        let last = self.state;
        let (t, used) = (self.layer.thickness_mm, &self.rows[self.at]);
        match wanted {
            Some(force) if used.work.is_warm() && last.tilt_rad != 0.0 => {
                let more = force * used.modulus_mpa() * t * t / last.force_n;
                let steeper = slope / libm::tan(last.tilt_rad).abs();
                last.length_mm / t * (more / steeper).sqrt()
            }
            Some(_) => GUESSED * depth / slope,
            None => depth / slope,
        }
    }

    /// The row to begin with for a contact guessed so long: the one in use when that may do.
    fn row_for(&self, touched: f64, turned: bool) -> usize {
        let used = &self.rows[self.at];
        if used.work.is_warm() && turned == self.turned {
            let part = touched / used.length;
            if (part < FAR || self.at == 0) && part > 1.0 / FAR {
                return self.at;
            }
        }
        holding(&self.rows, touched)
    }
}
