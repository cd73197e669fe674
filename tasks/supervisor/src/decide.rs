//! One decision a job: faults first, then what the lines and time have changed, then what happens
//! by itself, then the operator's request. Refuses ports; everything it goes by is in [`Facts`].

use taktil_rtcore::fault::Class;
use taktil_rtcore::mode::{Action, Event, after, after_stop, next as next_mode, react};
use taktil_rtcore::status::ModeStatus;
use taktil_rtcore::{FaultCode, FaultSet, Fold, Mode, Nanos, StateHash};
use taktil_signal::{ControlState, JointState, Lines, Request, State, Verb};

use crate::law::{Guard, event, next};
use crate::watch::{Lasting, Latch, Standstill, of_class};

/// Times and bands of the decisions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Times {
    /// Shortest time in ENABLING.
    pub enable: Nanos,
    /// How long the arm has to stand within `still_rad` to count as standing still.
    pub still: Nanos,
    /// See `still`.
    pub still_rad: f64,
    /// Longest time in STOPPING.
    pub stop_max: Nanos,
    /// How long the two channels of the emergency stop may disagree.
    pub estop_disagree: Nanos,
    /// How long touch may be missing before TACTILE-SERVO is left.
    pub tactile_hold: Nanos,
}

/// What a source of motion said last.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Word {
    /// When it said so.
    pub stamp: Nanos,
    /// It has nothing left to do.
    pub done: bool,
}

/// What one decision goes by.
#[derive(Clone, Copy, Debug)]
pub struct Facts<const N: usize = 6> {
    /// Release of the job.
    pub release: Nanos,
    /// Digital inputs, unless they have stopped coming.
    pub lines: Option<Lines>,
    /// Measured joints, unless they have stopped coming.
    pub joints: Option<JointState<N>>,
    /// Faults that lanes have raised since the last decision.
    pub raised: FaultSet,
    /// Faults in the lanes' newest words, old or new.
    pub present: FaultSet,
    /// The machine can feel.
    pub touch: bool,
    /// The touch lane's health has stopped coming.
    pub touch_silent: bool,
    /// The trajectory's word.
    pub trajectory: Word,
    /// The tactile servo's word.
    pub tactile: Word,
    /// The newest request.
    pub request: Option<Request>,
}

/// State, mode and what has to be remembered between decisions.
#[derive(Clone, Debug)]
pub struct Core<const N: usize = 6> {
    times: Times,
    state: State,
    mode: Mode,
    state_since: Option<Nanos>,
    mode_since: Nanos,
    latch: Latch,
    standstill: Standstill<N>,
    disagreement: Lasting,
    blindness: Lasting,
    blind: bool,
    request: Option<u32>,
    refused: u32,
    calibrate: bool,
    datum: Option<u32>,
    settling: u8,
    /// A calibration was asked for and the zero of the joints has not moved since.
    unanswered: bool,
}

/// Jobs after a calibration, or after the zero of the joints moved, in which requests wait: until
/// everybody's feedback, one job old, counts from the new zero.
const SETTLING_JOBS: u8 = 4;

/// The lines as the decisions need them; what does not come is the unsafe side.
#[derive(Clone, Copy, Debug)]
struct Cell {
    power: bool,
    a: bool,
    b: bool,
}

impl<const N: usize> Fold for Core<N> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.state).add(&self.mode).add(&self.state_since).add(&self.mode_since);
        hash.add(&self.latch).add(&self.standstill).add(&self.disagreement).add(&self.blindness);
        hash.add(&self.blind).add(&self.request).add(&self.refused).add(&self.calibrate);
        hash.add(&self.datum).add(&self.settling).add(&self.unanswered);
    }
}

impl<const N: usize> Core<N> {
    /// In START, mode OFF.
    #[must_use]
    pub fn new(times: Times) -> Core<N> {
        Core {
            times,
            state: State::Start,
            mode: Mode::Off,
            state_since: None,
            mode_since: Nanos::ZERO,
            latch: Latch::default(),
            standstill: Standstill::new(times.still_rad, times.still),
            disagreement: Lasting::new(times.estop_disagree),
            blindness: Lasting::new(times.tactile_hold),
            blind: false,
            request: None,
            refused: 0,
            calibrate: false,
            datum: None,
            settling: 0,
            unanswered: false,
        }
    }

    /// Takes the facts of one job; returns what everybody is told.
    pub fn decide(&mut self, facts: &Facts<N>) -> (ControlState, ModeStatus) {
        let now = facts.release;
        self.state_since.get_or_insert(now);
        self.settling = self.settling.saturating_sub(1);
        let datum = facts.joints.map(|joints| joints.datum);
        let moved = datum.is_some() && datum != self.datum && self.datum.is_some();
        if self.calibrate || moved {
            self.settling = SETTLING_JOBS;
        }
        self.unanswered &= !moved;
        self.datum = datum.or(self.datum);
        self.calibrate = false;
        let still = self.standstill.watch(now, facts.joints.map(|joints| joints.q_rad));
        let lines = facts.lines.unwrap_or_default();
        let cell = Cell {
            power: lines.drive_power == 1,
            a: lines.estop_a_closed == 1,
            b: lines.estop_b_closed == 1,
        };
        let found = self.watch(facts, cell);
        self.latch.add(facts.raised.union(found));
        let present = of_class(facts.present, |class| class == Class::Degrade);
        self.blind = self.blindness.watch(now, !present.is_empty());
        let action = react(self.mode, self.latch.stopping().union(present));
        self.set_mode(after(self.mode, action), now);
        self.advance(facts, cell, still);
        if let Some(to) = next(self.state, Verb::None, &self.guard(facts)) {
            self.set_state(to, now);
        }
        self.hear(facts);
        self.words(action)
    }

    /// The faults that only the supervisor can see.
    fn watch(&mut self, facts: &Facts<N>, cell: Cell) -> FaultSet {
        let mut found = FaultSet::NONE;
        let disagree = self.disagreement.watch(facts.release, cell.a != cell.b);
        if disagree && self.mode != Mode::Off {
            found.insert(FaultCode::EmergencyStopDisagrees);
        }
        if matches!(self.mode, Mode::Off | Mode::Checking | Mode::Fault) {
            return found;
        }
        // An open emergency stop takes drive power away with it: that is no fault of its own.
        if facts.lines.is_none() {
            found.insert(FaultCode::DigitalLost);
        } else if !(cell.a && cell.b) {
            found.insert(FaultCode::EmergencyStop);
        } else if !cell.power && self.mode.torque_allowed() {
            found.insert(FaultCode::DrivePowerLost);
        }
        if facts.joints.is_none() {
            found.insert(FaultCode::EncoderLost);
        }
        if facts.touch_silent {
            found.insert(FaultCode::LaneSilent);
        }
        found
    }

    /// What lines and time do to the mode.
    fn advance(&mut self, facts: &Facts<N>, cell: Cell, still: bool) {
        let now = facts.release;
        let spent = now - self.mode_since;
        let checked = cell.a && cell.b && facts.joints.is_some() && !facts.touch_silent;
        let event = match self.mode {
            Mode::Off => cell.power.then_some(Event::PowerOn),
            Mode::Checking | Mode::Ready if !cell.power => Some(Event::PowerOff),
            Mode::Checking => checked.then_some(Event::ChecksPassed),
            Mode::Enabling => (still && spent >= self.times.enable).then_some(Event::Enabled),
            Mode::Stopping => {
                if still || spent >= self.times.stop_max {
                    self.set_mode(after_stop(self.latch.faults()), now);
                }
                None
            }
            Mode::Ready | Mode::Hold | Mode::Moving | Mode::Fault => None,
        };
        self.tell(event, now);
    }

    fn guard(&self, facts: &Facts<N>) -> Guard {
        let since = self.state_since.unwrap_or(facts.release);
        let word = match self.state {
            State::Trajectory | State::TrajectoryUser => facts.trajectory,
            State::TactileServo => facts.tactile,
            _ => Word::default(),
        };
        let zero = facts.joints.map(|joints| joints.calibrated == 1);
        Guard {
            mode: self.mode,
            faults: self.latch.faults(),
            calibrated: zero == Some(true),
            denied: self.settling == 0
                && (zero == Some(false) || zero.is_some() && self.unanswered),
            // A word from before this state was entered is about something else.
            done: word.done && word.stamp >= since,
            // Who cannot feel is blind for ever.
            blind: self.blind || !facts.touch,
        }
    }

    /// The operator's request, once. While the zero of the joints settles only stop and reset are
    /// heard; the others wait.
    fn hear(&mut self, facts: &Facts<N>) {
        let Some(request) = facts.request else { return };
        if self.request == Some(request.sequence) {
            return;
        }
        let verb = Verb::from_code(request.verb);
        if self.settling > 0 && !matches!(verb, Some(Verb::Stop | Verb::Reset)) {
            return;
        }
        self.request = Some(request.sequence);
        if verb == Some(Verb::None) {
            return;
        }
        let granted =
            verb.and_then(|verb| next(self.state, verb, &self.guard(facts)).map(|to| (verb, to)));
        match granted {
            Some((verb, to)) => self.obey(verb, to, facts.release),
            None => self.refused = self.refused.saturating_add(1),
        }
    }

    fn obey(&mut self, verb: Verb, to: State, now: Nanos) {
        match verb {
            Verb::Enable => self.tell(Some(Event::Enable), now),
            Verb::Stop => self.tell(Some(Event::Stop), now),
            Verb::Reset => {
                self.latch.reset();
                if self.mode == Mode::Fault {
                    self.tell(Some(Event::Reset), now);
                }
            }
            Verb::Calibrate => {
                self.set_state(to, now);
                (self.calibrate, self.unanswered) = (true, true);
            }
            _ => self.set_state(to, now),
        }
    }

    fn tell(&mut self, event: Option<Event>, now: Nanos) {
        if let Some(mode) = event.and_then(|event| next_mode(self.mode, event)) {
            self.set_mode(mode, now);
        }
    }

    fn set_mode(&mut self, mode: Mode, now: Nanos) {
        if mode != self.mode {
            self.mode = mode;
            self.mode_since = now;
        }
    }

    fn set_state(&mut self, to: State, now: Nanos) {
        self.tell(event(self.state, to), now);
        if to != self.state {
            self.unanswered = false;
            self.state = to;
            self.state_since = Some(now);
        }
    }

    fn words(&self, action: Action) -> (ControlState, ModeStatus) {
        let faults = self.latch.faults().0;
        let mode = self.mode.code();
        let control = ControlState {
            entered_ns: self.state_since.unwrap_or_default().0,
            faults,
            state: self.state as u32,
            mode,
            first_fault: self.latch.first_code(),
            request: self.request.unwrap_or(0),
            refused: self.refused,
            calibrate: u32::from(self.calibrate),
        };
        (control, ModeStatus { faults, mode, action: action as u32 })
    }
}

#[cfg(test)]
mod tests;
