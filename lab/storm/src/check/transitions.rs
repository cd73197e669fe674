//! Legal transitions only, each with its reason in the records: a request of the operator, a
//! latched fault, a line that changed, or the end of what the mode waits for. The tables are this
//! crate's own.

use taktil_hal::Nanos;
use taktil_rtcore::Mode;
use taktil_signal::{Lines, State, Verb};

use super::{Findings, Weather, mode_of, state_of};
use crate::evidence::Tick;

/// Shortest time in ENABLING, as the machine file says.
const ENABLE_TIME: Nanos = Nanos::from_millis(50);
/// For how many jobs a request may wait until it is answered.
const REQUEST_JOBS: u64 = 6;

/// What the rules about transitions remember.
#[derive(Debug, Default)]
pub(super) struct Transitions {
    /// The newest request that was new, with its job.
    request: Option<(u32, u32, u64)>,
    /// The job of a request to stop that has not been answered.
    stop: Option<u64>,
    mode_since: Nanos,
    /// The lines as they were told last.
    lines: Option<Lines>,
}

/// Codes of faults of which the arm is de-energised at once; this crate's own list.
const DRIVE_OFF_CODES: [u32; 15] = [1, 2, 3, 4, 12, 15, 16, 17, 22, 26, 36, 37, 39, 40, 41];
/// Codes of faults that stop the arm on the servo.
const STOP_CODES: [u32; 13] = [8, 9, 10, 11, 14, 18, 19, 20, 23, 24, 31, 35, 38];

/// Whether a set of faults holds one that takes the drives away.
pub(super) fn takes_drives_off(faults: u64) -> bool {
    DRIVE_OFF_CODES.iter().any(|code| faults & (1 << code) != 0)
}

/// Whether a set of faults holds one that stops the arm.
pub(super) fn stops(faults: u64) -> bool {
    takes_drives_off(faults) || STOP_CODES.iter().any(|code| faults & (1 << code) != 0)
}

/// Whether a mode may follow another one in one job.
const fn is_legal(from: Mode, to: Mode) -> bool {
    match (from, to) {
        (_, Mode::Off) => !matches!(from, Mode::Fault),
        (Mode::Off, Mode::Checking | Mode::Ready) => true,
        (Mode::Off, _) => false,
        (_, Mode::Fault) => true,
        (Mode::Fault, Mode::Checking) | (Mode::Checking, Mode::Ready) => true,
        (Mode::Ready, Mode::Enabling) | (Mode::Enabling, Mode::Hold | Mode::Ready) => true,
        (Mode::Hold, Mode::Moving | Mode::Stopping) => true,
        (Mode::Moving, Mode::Hold | Mode::Stopping) | (Mode::Stopping, Mode::Ready) => true,
        _ => false,
    }
}

/// Whether a state may follow another one in one job.
const fn is_legal_state(from: State, to: State) -> bool {
    use State as S;
    matches!(
        (from, to),
        (_, S::Start)
            | (S::Start | S::ManualUncalibrated, S::IdleUncalibrated)
            | (S::IdleUncalibrated, S::ManualUncalibrated | S::IdleCalibrated)
            | (
                S::IdleCalibrated,
                S::IdleUncalibrated
                    | S::ManualJoint
                    | S::ManualCartesian
                    | S::Trajectory
                    | S::TrajectoryUser
                    | S::TactileServo
            )
            | (
                S::ManualJoint
                    | S::ManualCartesian
                    | S::Trajectory
                    | S::TrajectoryUser
                    | S::TactileServo,
                S::IdleCalibrated
            )
    )
}

impl Transitions {
    pub(super) fn tick(
        &mut self,
        before: &Tick,
        tick: &Tick,
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        let told = tick.lines.is_some();
        self.lines = tick.lines.or(self.lines).or(before.lines);
        if let Some(request) = tick.request {
            let known = self.request.map(|(_, sequence, _)| sequence);
            if known != Some(request.sequence) {
                self.request = Some((request.verb, request.sequence, tick.tick));
                self.stop = (request.verb == Verb::Stop as u32).then_some(tick.tick);
            }
        }
        let (Some(from), Some(to)) = (mode_of(before), mode_of(tick)) else { return };
        if !matches!(to, Mode::Enabling | Mode::Hold | Mode::Moving) || from != to {
            self.stop = None;
        } else if self.stop.is_some_and(|at| tick.tick > at + REQUEST_JOBS) {
            findings.report("a stop is obeyed", now, || format!("still {to:?}"));
        }
        if from != to {
            // A request that comes with the end of a stop or of ENABLING is answered in the same
            // job.
            let by_way = |way: Mode| is_legal(from, way) && is_legal(way, to);
            if !is_legal(from, to) && !by_way(Mode::Ready) && !by_way(Mode::Hold) {
                findings.report("legal modes only", now, || format!("{from:?} to {to:?}"));
            }
            if let Some(lack) = self.unexplained(from, to, tick, told) {
                findings.report("each change has its reason", now, || {
                    format!("{from:?} to {to:?} without {lack}")
                });
            }
            self.mode_since = now;
        }
        let (Some(old), Some(new)) = (state_of(before), state_of(tick)) else { return };
        // A state that ends by itself and a request may come in one job.
        let by_itself = match old {
            State::Start | State::IdleCalibrated => Some(State::IdleUncalibrated),
            State::Trajectory | State::TactileServo => Some(State::IdleCalibrated),
            _ => None,
        };
        let legal =
            is_legal_state(old, new) || by_itself.is_some_and(|way| is_legal_state(way, new));
        if old != new && !legal {
            findings
                .report("legal states only", now, || format!("{} to {}", old.name(), new.name()));
        }
        let moves = !matches!(new, State::Start | State::IdleUncalibrated | State::IdleCalibrated);
        if moves && !matches!(to, Mode::Moving | Mode::Stopping) && !weather.has_panicked(now) {
            findings.report("a state that moves has a mode that does", now, || {
                format!("{} in {to:?}", new.name())
            });
        }
        if to == Mode::Moving && !moves {
            findings.report("a mode that moves has a state that does", now, || {
                format!("{} in {to:?}", new.name())
            });
        }
        if old != new && moves && !self.was_asked(tick, verb_of(new)) {
            findings.report("motion is asked for", now, || format!("{} by itself", new.name()));
        }
    }

    /// Whether the newest request is this one, and newer than a few jobs.
    fn was_asked(&self, tick: &Tick, verb: Verb) -> bool {
        self.request
            .is_some_and(|(code, _, at)| code == verb as u32 && tick.tick <= at + REQUEST_JOBS)
    }

    /// What a change of the mode lacks as its reason.
    fn unexplained(&self, from: Mode, to: Mode, tick: &Tick, told: bool) -> Option<&'static str> {
        let faults = tick.control.map_or(0, |control| control.faults);
        let lines = self.lines.unwrap_or_default();
        let spent = tick.release - self.mode_since;
        let (has, what) = match (from, to) {
            // Without a new word of the lines power counts as gone when they have been silent.
            (_, Mode::Off) => (!told || lines.drive_power == 0, "power off"),
            (Mode::Off, _) => (lines.drive_power == 1, "drive power"),
            (Mode::Fault, _) => (self.was_asked(tick, Verb::Reset), "a reset"),
            (_, Mode::Fault) => (stops(faults), "a fault that stops"),
            (Mode::Checking, _) => {
                (lines.estop_a_closed == 1 && lines.estop_b_closed == 1, "closed lines")
            }
            (Mode::Ready, _) => (self.was_asked(tick, Verb::Enable), "a request to enable"),
            (Mode::Enabling, Mode::Hold | Mode::Moving) => {
                (spent >= ENABLE_TIME, "the time to enable")
            }
            (Mode::Enabling, _) => (self.was_asked(tick, Verb::Stop), "a request to stop"),
            (_, Mode::Stopping) => {
                (stops(faults) || self.was_asked(tick, Verb::Stop), "a fault or a request to stop")
            }
            (Mode::Stopping, _) => (!stops(faults), "a clear latch"),
            _ => (true, ""),
        };
        (!has).then_some(what)
    }
}

/// The verb that begins a state.
const fn verb_of(state: State) -> Verb {
    match state {
        State::ManualUncalibrated => Verb::ManualUncalibrated,
        State::ManualJoint => Verb::ManualJoint,
        State::ManualCartesian => Verb::ManualCartesian,
        State::Trajectory => Verb::Trajectory,
        State::TrajectoryUser => Verb::TrajectoryUser,
        State::TactileServo => Verb::TactileServo,
        State::Start | State::IdleUncalibrated | State::IdleCalibrated => Verb::None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_rtcore::FaultCode;
    use taktil_rtcore::fault::Class;

    #[test]
    fn the_lists_of_faults_are_the_catalogues() {
        for fault in FaultCode::ALL {
            let set = 1 << (*fault as u32);
            let found = (takes_drives_off(set), stops(set));
            let class = fault.class();
            let wanted = (class == Class::DriveOff, class >= Class::ControlledStop);
            assert_eq!(found, wanted, "{fault:?}");
        }
    }
}
