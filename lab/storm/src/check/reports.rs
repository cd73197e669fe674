//! What the machine says about itself: a request is granted or counted as refused, the first fault
//! is the gravest of those that come together, channels of the emergency stop that disagree are
//! named, jobs that were left out are counted, a gate is open only where current may flow, a state
//! is as old as it is said to be, and the drives do not come on with a fault that stops.

use taktil_hal::Nanos;
use taktil_signal::Verb;

use super::transitions::{stops, takes_drives_off};
use super::{Findings, Weather, allows_torque, mode_of};
use crate::evidence::Tick;
use taktil_rtcore::Mode;

/// Two channels of the emergency stop disagree, among the latched faults.
const DISAGREEMENT_BIT: u64 = 1 << 17;
/// How long the channels may disagree, and what a reaction takes.
const DISAGREEMENT_TIME: Nanos = Nanos::from_millis(30);

/// What the rules about reports remember.
#[derive(Debug, Default)]
pub(super) struct ReportCheck {
    disagree_since: Option<Nanos>,
}

/// How grave a set of faults is.
fn gravity(faults: u64) -> u8 {
    if takes_drives_off(faults) { 2 } else { u8::from(stops(faults)) }
}

impl ReportCheck {
    pub(super) fn tick(
        &mut self,
        before: &Tick,
        tick: &Tick,
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        let gap = (tick.tick - before.tick).saturating_sub(1);
        if let (Some(old), Some(new)) = (before.health, tick.health)
            && u64::from(new.missed.saturating_sub(old.missed)) < gap
        {
            findings.report("jobs that were left out are counted", now, || {
                format!("{gap} left out, {} more counted", new.missed.saturating_sub(old.missed))
            });
        }
        let allowed = mode_of(tick).is_some_and(allows_torque);
        if tick.applied.is_some_and(|applied| applied.gate_open == 1) && !allowed {
            findings.report("no open gate without a mode for it", now, || {
                format!("in {:?}", mode_of(tick))
            });
        }
        self.disagreement(tick, weather, findings);
        let (Some(old), Some(new)) = (before.control, tick.control) else { return };
        if old.faults == 0 && new.faults != 0 && new.first_fault < 64 {
            let first = 1 << new.first_fault;
            if gravity(first) < gravity(new.faults) {
                findings.report("the first fault is the gravest", now, || {
                    format!("{} first in {:#x}", new.first_fault, new.faults)
                });
            }
        }
        if old.state != new.state && new.entered_ns != now.0 {
            findings.report("a new state has a new instant", now, || {
                format!("{} to {} said to be of {}", old.state, new.state, Nanos(new.entered_ns))
            });
        }
        let enables = mode_of(tick) == Some(Mode::Enabling) && old.mode != new.mode;
        if enables && stops(new.faults) {
            findings.report("no drives with a fault that stops", now, || {
                format!("ENABLING with {:#x}", new.faults)
            });
        }
        check_answer(before, tick, findings);
    }

    fn disagreement(&mut self, tick: &Tick, weather: &Weather, findings: &mut Findings) {
        let now = tick.release;
        let works = mode_of(tick).is_some_and(|mode| mode != Mode::Off);
        let differ = tick.lines.is_some_and(|lines| lines.estop_a_closed != lines.estop_b_closed);
        if !works || !differ || weather.is_late(now) || weather.has_panicked(now) {
            self.disagree_since = None;
            return;
        }
        let since = *self.disagree_since.get_or_insert(now);
        let faults = tick.control.map_or(0, |control| control.faults);
        let reset = tick.request.is_some_and(|request| request.verb == Verb::Reset as u32);
        if now - since > DISAGREEMENT_TIME && faults & DISAGREEMENT_BIT == 0 && !reset {
            findings.report("channels that disagree are named", now, || {
                format!("for {}, faults {faults:#x}", now - since)
            });
        }
    }
}

/// A request is granted, which changes something, or counted as refused.
fn check_answer(before: &Tick, tick: &Tick, findings: &mut Findings) {
    let (Some(old), Some(new)) = (before.control, tick.control) else { return };
    let verb = tick.request.filter(|request| request.sequence == new.request);
    let is_answered = old.request != new.request && before.tick + 1 == tick.tick;
    if let (Some(request), true) = (verb, is_answered)
        && request.verb != Verb::None as u32
        && Verb::from_code(request.verb).is_some()
    {
        let same = (old.mode, old.state, old.entered_ns) == (new.mode, new.state, new.entered_ns)
            && old.faults & !new.faults == 0
            && new.calibrate == 0;
        if same && new.refused == old.refused {
            findings.report("a request is granted or refused", tick.release, || {
                format!("{request:?} changed nothing")
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Campaign;
    use taktil_hal::fault::FaultPlan;
    use taktil_rtcore::Payload;
    use taktil_rtcore::status::LaneHealth;
    use taktil_signal::{Applied, ControlState, Lines, Request};

    /// The rules that are broken by a machine in READY which `change` makes out of one that rests,
    /// in each job from number 3 on.
    fn broken(change: impl Fn(u64, &mut Tick, &mut ControlState)) -> Vec<&'static str> {
        let weather = Weather::new(&FaultPlan::default(), Campaign::Anything, Nanos::MAX);
        let mut check = ReportCheck::default();
        let mut findings = Findings::default();
        let mut before = None;
        for job in 1..40 {
            let mut control = ControlState { mode: Mode::Ready.code(), ..ControlState::ZERO };
            let mut tick = Tick {
                tick: job,
                release: Nanos(2_500_000 * job.cast_signed()),
                health: Some(LaneHealth::ZERO),
                lines: Some(Lines { drive_power: 1, estop_a_closed: 1, estop_b_closed: 1 }),
                applied: Some(Applied::ZERO),
                ..Tick::default()
            };
            if job > 2 {
                change(job, &mut tick, &mut control);
            }
            tick.control = Some(control);
            if let Some(before) = before.replace(tick) {
                check.tick(&before, &tick, &weather, &mut findings);
            }
        }
        findings.violations.iter().map(|violation| violation.rule).collect()
    }

    #[test]
    fn a_request_that_changes_nothing_is_counted() {
        let asked = |refused: u32, state: u32| {
            broken(|_, tick, control| {
                tick.request = Some(Request { verb: Verb::Idle as u32, sequence: 5 });
                (control.request, control.refused, control.state) = (5, refused, state);
                control.entered_ns = if state > 0 { 7_500_000 } else { 0 };
            })
        };
        assert!(asked(1, 0).is_empty() && asked(0, 1).is_empty());
        assert_eq!(asked(0, 0), ["a request is granted or refused"]);
    }

    #[test]
    fn the_first_fault_is_the_gravest_of_those_that_come_together() {
        let first = |first_fault| {
            broken(move |_, _, control| {
                (control.faults, control.first_fault) = (1 << 8 | 1 << 16, first_fault);
            })
        };
        assert!(first(16).is_empty());
        assert_eq!(first(8), ["the first fault is the gravest"]);
    }

    #[test]
    fn a_state_has_its_instant_and_drives_wait_for_a_clear_latch() {
        let enter = |entered_ns| {
            broken(move |_, _, control| (control.state, control.entered_ns) = (1, entered_ns))
        };
        assert!(enter(7_500_000).is_empty());
        assert_eq!(enter(0), ["a new state has a new instant"]);
        let enable = |fault: u32| {
            broken(move |_, _, control| {
                control.mode = Mode::Enabling.code();
                (control.faults, control.first_fault) = (1 << fault, fault);
            })
        };
        assert!(enable(6).is_empty());
        assert_eq!(enable(14), ["no drives with a fault that stops"]);
    }

    #[test]
    fn jobs_left_out_open_gates_and_channels_that_disagree_are_told() {
        let gap = |missed| {
            broken(move |job, tick, _| {
                tick.tick += u64::from(job > 9) * 3;
                tick.health = Some(LaneHealth {
                    missed: if job > 9 { missed } else { 0 },
                    ..LaneHealth::ZERO
                });
            })
        };
        assert!(gap(3).is_empty());
        assert_eq!(gap(1), ["jobs that were left out are counted"]);
        let open = broken(|_, tick, _| {
            tick.applied = Some(Applied { gate_open: 1, ..Applied::ZERO });
        });
        assert_eq!(open, ["no open gate without a mode for it"]);
        let differ = |faults: u64| {
            broken(move |job, tick, control| {
                tick.lines = Some(Lines { drive_power: 1, estop_a_closed: 1, estop_b_closed: 0 });
                if job > 11 {
                    (control.faults, control.first_fault) = (faults, 17);
                }
            })
        };
        assert!(differ(1 << 17).is_empty());
        assert!(differ(1 << 16).contains(&"channels that disagree are named"));
    }
}
