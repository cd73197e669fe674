//! The task that reads a board's clock and decides by how much the releases of the machine are
//! moved, so that its jobs keep their place in the board's cycle. A live run at a fixed pace obeys
//! the decision; logical time, a run in virtual time and a replay do not know it.
//!
//! - In: no port; the board's clock.
//! - Out: `pace`.
//! - Rate: every job of its lane, whose period is a whole number of the board's cycles.
//! - Source: [`taktil_rtcore::phase_lock`].
//!
//! A clock that cannot be read leaves the drift of the newest phases in force. The task raises no
//! fault: whether the machine may move without the lock is told by who waits for it, and drives
//! that miss their cycle say so themselves.

use serde::Deserialize;
use taktil_hal::BoardClock;
use taktil_rtcore::status::PaceStatus;
use taktil_rtcore::{
    Cycle, FaultCode, Fold, Invalid, Io, Nanos, Output, PhaseLock, Ports, StateHash, Task,
};

taktil_rtcore::explained! {
    /// `[clock_lock]`. Every key has a default.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// By how much the releases are moved in a period at most, in millionths of the period.
        /// More than clocks differ, which is some 100. Default 2000.
        pub slew_max_ppm: i64 [200.0, 20000.0],
        /// A job that is within this of its place in the board's cycle is where it belongs (us).
        /// Default 25.
        pub window_us: i64 [1.0, 1000.0],
    }
}

impl Default for Config {
    fn default() -> Config {
        Config { slew_max_ppm: 2_000, window_us: 25 }
    }
}

impl Config {
    /// The loop for jobs `period` apart and a board of this cycle.
    ///
    /// # Errors
    /// A number out of its bounds; a window that is not well within the cycle; a period that is no
    /// whole number of cycles. The place is the key, or nothing for the last one.
    pub fn lock(&self, period: Nanos, cycle: Nanos) -> Result<PhaseLock, Invalid> {
        let Config { slew_max_ppm, window_us } = *self;
        if !(200..=20_000).contains(&slew_max_ppm) {
            let what = format!("{slew_max_ppm} ppm are out of bounds");
            return Err(Invalid::new("slew_max_ppm", what, "give 200 to 20000"));
        }
        if !(1..=1_000).contains(&window_us) {
            let what = format!("{window_us} us are out of bounds");
            return Err(Invalid::new("window_us", what, "give 1 to 1000"));
        }
        if cycle.0 <= 0 || period.0 % cycle.0 != 0 {
            let what = format!("the lane's period is {period}, a cycle of the board {cycle}");
            let remedy = "put `clock_lock` into a lane whose period is a whole number of cycles";
            return Err(Invalid::new("", what, remedy));
        }
        let window = Nanos::from_micros(window_us);
        if window * 4 > cycle {
            let what = format!("{window} on either side is half of the board's cycle of {cycle}");
            return Err(Invalid::new("window_us", what, "give less than a quarter of the cycle"));
        }
        let step_max = Nanos(period.0 / 1_000 * slew_max_ppm / 1_000);
        Ok(PhaseLock::new(cycle, step_max, window))
    }
}

/// The task.
pub struct ClockLock {
    pace: Output<PaceStatus>,
    clock: Box<dyn BoardClock>,
    lock: PhaseLock,
    /// The newest phase, and how many could not be read.
    phase: Nanos,
    missing: u32,
}

impl ClockLock {
    /// Declares `pace`; `period` is that of the lane.
    ///
    /// # Errors
    /// What [`Config::lock`] refuses.
    pub fn new(
        config: Config,
        clock: Box<dyn BoardClock>,
        period: Nanos,
        ports: &mut Ports,
    ) -> Result<ClockLock, Invalid> {
        let lock = config.lock(period, clock.cycle())?;
        Ok(ClockLock { pace: ports.output("pace"), clock, lock, phase: Nanos::ZERO, missing: 0 })
    }
}

impl Task for ClockLock {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let phase = self.clock.sample(cycle.release).ok().map(|reading| reading.value);
        self.missing = self.missing.saturating_add(u32::from(phase.is_none()));
        self.phase = phase.unwrap_or(self.phase);
        let step = self.lock.step(phase);
        let pace = PaceStatus {
            correction_ns: step.correction.0,
            phase_ns: self.phase.0,
            locked: step.is_locked.into(),
            slips: step.slips,
            clamped: step.is_clamped.into(),
            missing: self.missing,
        };
        io.write(&self.pace, pace);
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        self.lock.fold(hash);
        hash.add(&self.phase.0).add(&self.missing);
    }
}

#[cfg(test)]
mod tests;
