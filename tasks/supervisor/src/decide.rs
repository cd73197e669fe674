//! One decision per job: first the faults, then what the lines and time have changed, then the
//! automatic transitions, then the operator's request. Everything that the decision depends on is
//! in [`Inputs`].

use taktil_rtcore::fault::Class;
use taktil_rtcore::mode::{Action, Event, after, after_stop, next as next_mode, react};
use taktil_rtcore::status::ModeStatus;
use taktil_rtcore::{FaultCode, FaultSet, Fold, Mode, Nanos, StateHash};
use taktil_signal::{ControlState, JointState, Lines, Request, State, Verb};

use crate::law::{Guard, mode_event, next};
use crate::watch::{FaultLatch, PersistenceTimer, Standstill, StopMonitor, faults_of_class};

/// Times and tolerances of the decisions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Timing {
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
    /// Shortest silence after which a board lets its outputs go by itself.
    pub silence: Nanos,
}

/// The last report of a source of motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SourceReport {
    /// Time of the report.
    pub stamp: Nanos,
    /// It has nothing left to do.
    pub done: bool,
}

/// The inputs of one decision.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<const N: usize = 6> {
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
    /// Whether the machine has a tactile sensor.
    pub touch: bool,
    /// The touch lane's health has stopped coming.
    pub touch_silent: bool,
    /// A task of a lane has been taken out of it after a panic, and is not there any more.
    pub disabled: bool,
    /// The last report of the trajectory.
    pub trajectory: SourceReport,
    /// The last report of the tactile servo.
    pub tactile: SourceReport,
    /// The newest request.
    pub request: Option<Request>,
}

/// State, mode and what has to be remembered between decisions.
#[derive(Clone, Debug)]
pub struct DecisionState<const N: usize = 6> {
    times: Timing,
    state: State,
    mode: Mode,
    state_since: Option<Nanos>,
    mode_since: Nanos,
    /// Release of the job before.
    decided: Option<Nanos>,
    latch: FaultLatch,
    standstill: Standstill<N>,
    stop: StopMonitor<N>,
    disagreement: PersistenceTimer,
    blindness: PersistenceTimer,
    blind: bool,
    request: Option<u32>,
    refused: u32,
    calibrate: bool,
    datum: Option<u32>,
    settling: u8,
    /// A calibration was asked for and the zero of the joints has not moved since.
    calibration_pending: bool,
}

/// Number of jobs after a calibration, or after the zero of the joints moved, in which requests
/// wait: until the feedback of all tasks, which is one job old, counts from the new zero.
const SETTLING_JOBS: u8 = 4;

/// The longest stop has so many spans in which the way of the joints has to shrink.
const STOP_SPANS: i64 = 10;
/// Way of a joint in such a span that matters, over the band of standing still.
const STOP_BANDS: f64 = 4.0;

/// The lines as the decisions need them. Lines that do not arrive count as unsafe.
#[derive(Clone, Copy, Debug)]
struct SafetyLines {
    power: bool,
    estop_a: bool,
    estop_b: bool,
}

impl<const N: usize> Fold for DecisionState<N> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.state).add(&self.mode).add(&self.state_since).add(&self.mode_since);
        hash.add(&self.latch).add(&self.standstill).add(&self.disagreement).add(&self.blindness);
        hash.add(&self.stop);
        hash.add(&self.blind).add(&self.request).add(&self.refused).add(&self.calibrate);
        hash.add(&self.datum).add(&self.settling).add(&self.calibration_pending);
    }
}

impl<const N: usize> DecisionState<N> {
    /// In START, mode OFF.
    #[must_use]
    pub fn new(times: Timing) -> DecisionState<N> {
        DecisionState {
            times,
            state: State::Start,
            mode: Mode::Off,
            state_since: None,
            mode_since: Nanos::ZERO,
            decided: None,
            latch: FaultLatch::default(),
            standstill: Standstill::new(times.still_rad, times.still),
            stop: StopMonitor::new(
                Nanos(times.stop_max.0 / STOP_SPANS),
                STOP_BANDS * times.still_rad,
            ),
            disagreement: PersistenceTimer::new(times.estop_disagree),
            blindness: PersistenceTimer::new(times.tactile_hold),
            blind: false,
            request: None,
            refused: 0,
            calibrate: false,
            datum: None,
            settling: 0,
            calibration_pending: false,
        }
    }

    /// Boards let their outputs go after this silence.
    pub fn limit_silence(&mut self, silence: Nanos) {
        self.times.silence = silence;
    }

    /// Decides on the inputs of one job and returns the outputs for all tasks.
    pub fn decide(&mut self, inputs: &Inputs<N>) -> (ControlState, ModeStatus) {
        let now = inputs.release;
        let gap = now - self.decided.replace(now).unwrap_or(now);
        self.state_since.get_or_insert(now);
        self.settling = self.settling.saturating_sub(1);
        let datum = inputs.joints.map(|joints| joints.datum);
        let moved = datum.is_some() && datum != self.datum && self.datum.is_some();
        if self.calibrate || moved {
            self.settling = SETTLING_JOBS;
        }
        self.calibration_pending &= !moved;
        self.datum = datum.or(self.datum);
        self.calibrate = false;
        let still = self.standstill.update(now, inputs.joints.map(|joints| joints.q_rad));
        let lines = inputs.lines.unwrap_or_default();
        let safety = SafetyLines {
            power: lines.drive_power == 1,
            estop_a: lines.estop_a_closed == 1,
            estop_b: lines.estop_b_closed == 1,
        };
        let mut found = self.supervision_faults(inputs, safety);
        // For so long nobody wrote to the boards, which have let the drives go: they do not come
        // back by the next word.
        if gap > self.times.silence && self.mode.torque_allowed() {
            found.insert(FaultCode::LaneSilent);
        }
        let known = self.latch.faults();
        self.latch.add(inputs.raised.union(found));
        let unseen = self.latch.faults() != known;
        let present = faults_of_class(inputs.present, |class| class == Class::Degrade);
        self.blind = self.blindness.update(now, !present.is_empty());
        let action = react(self.mode, self.latch.stopping().union(present));
        self.set_mode(after(self.mode, action), now);
        self.advance(inputs, safety, still);
        if let Some(to) = next(self.state, Verb::None, &self.guard(inputs)) {
            self.set_state(to, now);
        }
        // Nor has anybody seen a mode FAULT that begins in this job, with the end of a stop.
        let unseen = unseen || self.mode == Mode::Fault && self.mode_since == now;
        self.handle_request(inputs, unseen);
        self.outputs(action)
    }

    /// The faults that only the supervisor can see.
    fn supervision_faults(&mut self, inputs: &Inputs<N>, safety: SafetyLines) -> FaultSet {
        let mut found = FaultSet::NONE;
        let disagree = self.disagreement.update(inputs.release, safety.estop_a != safety.estop_b);
        if disagree && self.mode != Mode::Off {
            found.insert(FaultCode::EmergencyStopDisagrees);
        }
        if matches!(self.mode, Mode::Off | Mode::Checking | Mode::Fault) {
            self.stop.reset();
            return found;
        }
        // An open emergency stop takes drive power away with it: that is no fault of its own.
        if inputs.lines.is_none() {
            found.insert(FaultCode::DigitalLost);
        } else if !(safety.estop_a && safety.estop_b) {
            found.insert(FaultCode::EmergencyStop);
        } else if !safety.power && self.mode.torque_allowed() {
            found.insert(FaultCode::DrivePowerLost);
        }
        if inputs.joints.is_none() {
            found.insert(FaultCode::EncoderLost);
        }
        if inputs.touch_silent {
            found.insert(FaultCode::LaneSilent);
        }
        // A reset brings no task back: until the next start the drives stay off.
        if inputs.disabled {
            found.insert(FaultCode::TaskPanicked);
        }
        if self.mode != Mode::Stopping {
            self.stop.reset();
        } else if self.stop.update(inputs.release, inputs.joints.map(|joints| joints.q_rad)) {
            found.insert(FaultCode::StopFailed);
        }
        found
    }

    /// The changes of the mode due to the digital inputs and to time.
    fn advance(&mut self, inputs: &Inputs<N>, safety: SafetyLines, still: bool) {
        let now = inputs.release;
        let spent = now - self.mode_since;
        let works = inputs.joints.is_some() && !inputs.touch_silent && !inputs.disabled;
        let checked = safety.estop_a && safety.estop_b && works;
        let mode_event = match self.mode {
            Mode::Off => safety.power.then_some(Event::PowerOn),
            Mode::Checking | Mode::Ready if !safety.power => Some(Event::PowerOff),
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
        self.apply_event(mode_event, now);
    }

    fn guard(&self, inputs: &Inputs<N>) -> Guard {
        let since = self.state_since.unwrap_or(inputs.release);
        let word = match self.state {
            State::Trajectory | State::TrajectoryUser => inputs.trajectory,
            State::TactileServo => inputs.tactile,
            _ => SourceReport::default(),
        };
        let zero = inputs.joints.map(|joints| joints.calibrated == 1);
        Guard {
            mode: self.mode,
            faults: self.latch.faults(),
            calibrated: zero == Some(true),
            denied: self.settling == 0
                && (zero == Some(false) || zero.is_some() && self.calibration_pending),
            // A report from before this state was entered belongs to the previous state.
            done: word.done && word.stamp >= since,
            // A machine without a tactile sensor counts as permanently without touch.
            blind: self.blind || !inputs.touch,
        }
    }

    /// Handles a new request of the operator once. While the zero of the joints settles, only stop
    /// and reset are accepted; other requests wait. A reset that comes with an `unseen` fault,
    /// which was latched in this job, was not meant for it and is refused.
    fn handle_request(&mut self, inputs: &Inputs<N>, unseen: bool) {
        let Some(request) = inputs.request else { return };
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
        let meant = verb.filter(|verb| !(unseen && *verb == Verb::Reset));
        let granted =
            meant.and_then(|verb| next(self.state, verb, &self.guard(inputs)).map(|to| (verb, to)));
        match granted {
            Some((verb, to)) => self.execute(verb, to, inputs.release),
            None => self.refused = self.refused.saturating_add(1),
        }
    }

    fn execute(&mut self, verb: Verb, to: State, now: Nanos) {
        match verb {
            Verb::Enable => self.apply_event(Some(Event::Enable), now),
            Verb::Stop => self.apply_event(Some(Event::Stop), now),
            Verb::Reset => {
                self.latch.reset();
                if self.mode == Mode::Fault {
                    self.apply_event(Some(Event::Reset), now);
                }
            }
            Verb::Calibrate => {
                self.set_state(to, now);
                (self.calibrate, self.calibration_pending) = (true, true);
            }
            _ => self.set_state(to, now),
        }
    }

    fn apply_event(&mut self, mode_event: Option<Event>, now: Nanos) {
        if let Some(mode) = mode_event.and_then(|mode_event| next_mode(self.mode, mode_event)) {
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
        self.apply_event(mode_event(self.state, to), now);
        if to != self.state {
            self.calibration_pending = false;
            self.state = to;
            self.state_since = Some(now);
        }
    }

    fn outputs(&self, action: Action) -> (ControlState, ModeStatus) {
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
