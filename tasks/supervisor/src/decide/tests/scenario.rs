//! A supervisor in a simple simulated machine that follows its outputs, for the tests to check.

use super::super::*;

pub(super) const TICK_PERIOD: Nanos = Nanos(2_500_000);

pub(super) fn set(faults: &[FaultCode]) -> FaultSet {
    let mut all = FaultSet::NONE;
    faults.iter().for_each(|fault| all.insert(*fault));
    all
}

/// A supervisor with the world that it sees.
pub(super) struct Scenario {
    pub(super) decision: DecisionState,
    pub(super) inputs: Inputs,
    pub(super) sequence: u32,
    pub(super) control: ControlState,
    pub(super) status: ModeStatus,
    /// Whether `sense` carries out what it is asked for.
    pub(super) denies: bool,
}

impl Scenario {
    pub(super) fn new() -> Scenario {
        let times = Timing {
            enable: Nanos::from_millis(50),
            still: Nanos::from_millis(40),
            still_rad: 1e-3,
            stop_max: Nanos::from_secs(1),
            estop_disagree: Nanos::from_millis(20),
            tactile_hold: Nanos::from_millis(20),
            silence: Nanos::from_millis(50),
        };
        let inputs = Inputs {
            release: Nanos::ZERO,
            lines: Some(Lines { drive_power: 1, estop_a_closed: 1, estop_b_closed: 1 }),
            joints: Some(JointState::default()),
            raised: FaultSet::NONE,
            present: FaultSet::NONE,
            touch: true,
            touch_silent: false,
            disabled: false,
            trajectory: SourceReport::default(),
            tactile: SourceReport::default(),
            request: None,
        };
        Scenario {
            decision: DecisionState::new(times),
            inputs,
            sequence: 0,
            control: ControlState::default(),
            status: ModeStatus::default(),
            denies: false,
        }
    }

    /// One job; a calibration is carried out by the next, as `sense` does.
    pub(super) fn tick(&mut self) {
        let carried_out = self.control.calibrate == 1 && !self.denies;
        if let Some(joints) = self.inputs.joints.as_mut().filter(|_| carried_out) {
            joints.calibrated = 1;
            joints.datum += 1;
        }
        (self.control, self.status) = self.decision.decide(&self.inputs);
        self.inputs.release += TICK_PERIOD;
        self.inputs.raised = FaultSet::NONE;
    }

    pub(super) fn ticks(&mut self, count: usize) {
        for _ in 0..count {
            self.tick();
        }
    }

    /// Asks for a verb and waits until it is heard; says whether it was granted.
    pub(super) fn ask(&mut self, verb: Verb) -> bool {
        let refused = self.control.refused;
        self.sequence += 1;
        self.inputs.request = Some(Request { verb: verb as u32, sequence: self.sequence });
        for _ in 0..=2 * SETTLING_JOBS {
            self.tick();
            if self.control.request == self.sequence {
                break;
            }
        }
        assert_eq!(self.control.request, self.sequence);
        self.control.refused == refused
    }

    pub(super) fn raise(&mut self, fault: FaultCode) {
        self.inputs.raised = set(&[fault]);
        self.tick();
    }

    pub(super) fn lines(&mut self) -> &mut Lines {
        self.inputs.lines.as_mut().expect("lines come")
    }

    pub(super) fn at(&self) -> (State, Mode) {
        let state = State::from_code(self.control.state).expect("a state");
        let mode = Mode::from_code(self.control.mode).expect("a mode");
        assert_eq!(self.status.mode, self.control.mode);
        assert_eq!(self.status.faults, self.control.faults);
        (state, mode)
    }

    /// In the given state, straight from START.
    pub(super) fn in_state(state: State) -> Scenario {
        let mut scenario = Scenario::new();
        scenario.ticks(30);
        assert_eq!(scenario.at(), (State::Start, Mode::Ready));
        if state == State::Start {
            return scenario;
        }
        assert!(scenario.ask(Verb::Enable));
        scenario.ticks(30);
        assert_eq!(scenario.at(), (State::IdleUncalibrated, Mode::Hold));
        let verbs: &[Verb] = match state {
            State::Start | State::IdleUncalibrated => &[],
            State::ManualUncalibrated => &[Verb::ManualUncalibrated],
            State::IdleCalibrated => &[Verb::Calibrate],
            State::ManualJoint => &[Verb::Calibrate, Verb::ManualJoint],
            State::ManualCartesian => &[Verb::Calibrate, Verb::ManualCartesian],
            State::Trajectory => &[Verb::Calibrate, Verb::Trajectory],
            State::TrajectoryUser => &[Verb::Calibrate, Verb::TrajectoryUser],
            State::TactileServo => &[Verb::Calibrate, Verb::TactileServo],
        };
        for verb in verbs {
            assert!(scenario.ask(*verb), "{verb:?}");
        }
        scenario.ticks(usize::from(SETTLING_JOBS));
        assert_eq!(scenario.at().0, state);
        scenario
    }
}
