//! A fault stays latched until a deliberate reset: the set only grows, the first one stays the
//! first, FAULT is left for nothing but CHECKING, and the drives come on by a second act.

use taktil_rtcore::Mode;
use taktil_signal::Verb;

use super::{Findings, Weather, mode_of};
use crate::evidence::Tick;

/// For how many jobs after a request to reset the latch may be cleared.
const RESET_JOBS: u64 = 6;

/// What the rules about the latch remember.
#[derive(Debug, Default)]
pub(super) struct History {
    sequence: Option<u32>,
    /// The job of the newest request to reset.
    reset: Option<u64>,
    /// A request to enable has come since the machine was last without drives and asked for
    /// nothing.
    enable: Option<u64>,
}

impl History {
    pub(super) fn tick(
        &mut self,
        before: &Tick,
        tick: &Tick,
        _weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        if let Some(request) = tick.request.filter(|new| self.sequence != Some(new.sequence)) {
            self.sequence = Some(request.sequence);
            if request.verb == Verb::Reset as u32 {
                self.reset = Some(tick.tick);
            }
            if request.verb == Verb::Enable as u32 {
                self.enable = Some(tick.tick);
            }
        }
        let (Some(old), Some(new)) = (before.control, tick.control) else { return };
        let reset = self.reset.is_some_and(|at| tick.tick <= at + RESET_JOBS);
        let cleared = old.faults & !new.faults;
        if cleared != 0 && !reset {
            findings.report("latched until a reset", now, || format!("{cleared:#x} went away"));
        }
        if old.first_fault != 0 && new.first_fault != old.first_fault && !reset {
            findings.report("the first fault stays the first", now, || {
                format!("{} became {}", old.first_fault, new.first_fault)
            });
        }
        if new.first_fault != 0 && new.faults & (1 << new.first_fault) == 0 {
            findings.report("the first fault is a latched one", now, || {
                format!("{} is not in {:#x}", new.first_fault, new.faults)
            });
        }
        if (new.first_fault == 0) != (new.faults == 0) {
            findings.report("faults have a first one", now, || {
                format!("{} in {:#x}", new.first_fault, new.faults)
            });
        }
        if mode_of(tick) == Some(Mode::Enabling) && mode_of(before) != Some(Mode::Enabling) {
            let later = match (self.enable, self.reset) {
                (Some(enable), Some(reset)) => enable > reset,
                (enable, _) => enable.is_some(),
            };
            if !later {
                findings.report("drives come on by a second act", now, || {
                    format!("reset in job {:?}, enable in {:?}", self.reset, self.enable)
                });
            }
        }
    }
}
