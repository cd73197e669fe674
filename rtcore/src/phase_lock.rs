//! Locks the releases of a machine to the clock of a board or bus. The instant of a release on the
//! host's clock is that of logical time plus a correction, which this law moves so that the jobs
//! keep their place in the board's cycle. Logical time stays what it is: the period times the
//! number of the job.
//!
//! Everything is an integer, and the law knows no clock: the same phases give the same corrections,
//! so that a replay repeats them from the recorded phases, bit for bit.
//!
//! The law is a discrete loop of second order. With the phase `e` of a job (how much later than its
//! place it was), the drift `d` in each period and the correction `c`:
//!
//! ```text
//! d = d - e / 2^16          c = c + clamp(d - e / 2^7)
//! ```
//!
//! Its damping is half the proportional part over the root of the integral one, `0.5 2^-7 2^8 = 1`
//! (Franklin, Powell and Workman, Digital Control of Dynamic Systems, 1998, chapter 4), its time
//! constant 256 periods. A steady drift leaves no phase. The largest step in a period is stated by
//! the caller. Once the loop is locked a phase counts as no farther away than the window: a job
//! that a busy host released late says nothing of the clocks.
//!
//! Phases lie within half a cycle of the board. Jobs that move on beyond the end of the cycle,
//! after the loop was locked once, have slipped: they keep the place of a neighbouring cycle from
//! there on.

use taktil_hal::Nanos;

use crate::state::{Fold, StateHash};

/// Binary digits below a nanosecond in which corrections are kept.
const FRACTION_BITS: u32 = 20;
/// The proportional part of the phase, as a power of two below 1.
const PROPORTIONAL_SHIFT: u32 = 7;
/// The integral part of the phase, as a power of two below 1.
const INTEGRAL_SHIFT: u32 = 16;
/// Phases within the window in a row after which the loop is locked.
const LOCK_JOBS: u32 = 100;
/// Phases outside the window in a row after which it is not locked any more.
const UNLOCK_JOBS: u32 = 20;
/// The longest cycle, so that nothing overflows: as long as the longest period of a lane.
const CYCLE_MAX: Nanos = crate::schedule::PERIOD_MAX;

/// What the law did in a job.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PhaseStep {
    /// What is added to logical time for the releases from the next one on.
    pub correction: Nanos,
    /// The phases of the last jobs were within the window.
    pub is_locked: bool,
    /// The largest step acted.
    pub is_clamped: bool,
    /// Slips since the loop was locked first.
    pub slips: u32,
}

/// The loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PhaseLock {
    half_cycle: i64,
    step_max: i64,
    window: i64,
    /// Correction, and its change in a period, in 2^-20 ns.
    correction: i64,
    drift: i64,
    is_locked: bool,
    /// Phases in a row that speak for the other state of the lock.
    contrary: u32,
    /// How far the jobs are from the place of the newest lock, beyond the ends of the cycle too;
    /// none before the loop is locked first.
    way: Option<i64>,
    slips: u32,
}

impl Fold for PhaseLock {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.correction).add(&self.drift).add(&self.is_locked).add(&self.contrary);
        hash.add(&self.way).add(&self.slips);
    }
}

impl PhaseLock {
    /// A loop for a board of this cycle, whose correction moves by `step_max` in a period at most;
    /// a job within `window` of its place is where it belongs. All of them positive; what is larger
    /// than a lane's longest period counts as that.
    #[must_use]
    pub fn new(cycle: Nanos, step_max: Nanos, window: Nanos) -> PhaseLock {
        let half_cycle = cycle.0.clamp(2, CYCLE_MAX.0) / 2;
        PhaseLock {
            half_cycle,
            step_max: step_max.0.clamp(0, half_cycle / 2) << FRACTION_BITS,
            window: window.0.clamp(1, half_cycle),
            correction: 0,
            drift: 0,
            is_locked: false,
            contrary: 0,
            way: None,
            slips: 0,
        }
    }

    /// Takes the phase of a job, `None` where it could not be read: the drift goes on then.
    pub fn step(&mut self, phase: Option<Nanos>) -> PhaseStep {
        let mut step = self.drift;
        if let Some(phase) = phase {
            let phase = phase.0.clamp(-self.half_cycle, self.half_cycle);
            self.watch(phase);
            let bound = if self.is_locked { self.window } else { self.half_cycle };
            let error = phase.clamp(-bound, bound) << FRACTION_BITS;
            let wanted = self.drift - (error >> INTEGRAL_SHIFT);
            step = wanted - (error >> PROPORTIONAL_SHIFT);
            // A loop at its limit must not wind up.
            if step.abs() <= self.step_max || wanted.abs() < self.drift.abs() {
                self.drift = wanted.clamp(-self.step_max, self.step_max);
            }
        }
        let limited = step.clamp(-self.step_max, self.step_max);
        self.correction = self.correction.saturating_add(limited);
        PhaseStep {
            correction: Nanos(self.correction >> FRACTION_BITS),
            is_locked: self.is_locked,
            is_clamped: limited != step,
            slips: self.slips,
        }
    }

    /// Judges whether the loop is locked, and counts slips.
    fn watch(&mut self, phase: i64) {
        let is_contrary = (phase.abs() <= self.window) != self.is_locked;
        self.contrary = if is_contrary { self.contrary + 1 } else { 0 };
        let limit = if self.is_locked { UNLOCK_JOBS } else { LOCK_JOBS };
        if self.contrary >= limit {
            (self.is_locked, self.contrary) = (!self.is_locked, 0);
        }
        let cycle = 2 * self.half_cycle;
        let way = match self.way {
            None if self.is_locked => phase,
            None => return,
            // A job that was late by much, which says nothing of the way.
            Some(_) if self.is_locked && phase.abs() > self.window => return,
            Some(way) => {
                // By the shorter way round.
                let step = (phase - way).rem_euclid(cycle);
                way + if step > self.half_cycle { step - cycle } else { step }
            }
        };
        // Jitter at the edge between two cycles is no slip: what is well beyond it is one.
        let has_slipped = way.abs() > cycle / 4 * 3;
        self.slips = self.slips.saturating_add(u32::from(has_slipped));
        self.way = Some(if has_slipped { way - way.signum() * cycle } else { way });
    }
}

#[cfg(test)]
mod tests;
