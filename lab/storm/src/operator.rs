//! The operator of a storm: asks for whatever the state allows, as a seed says, and brings the
//! machine back when it has stopped: resets, enables, jogs the arm home and calibrates it. From the
//! calm on it only resets, enables and jogs.
//! Faults of the plan make it flood the machine with requests, fall silent or vanish with keys
//! held.

use taktil_hal::fault::{FaultKind, FaultPlan, SplitMix};
use taktil_lab_world::WorldTruth;
use taktil_machine_fault::TargetFaults;
use taktil_rtcore::{Cycle, FaultCode, Input, Io, Mode, Nanos, Output, Ports, StateHash, Task};
use taktil_signal::{
    ControlState, JogCommand, JogFrame, MoveKind, MoveQueue, OperatorMove, Request, State, Verb,
};

/// Time from the entry of a state to the next request at least.
const REACTION_TIME: Nanos = Nanos::from_millis(20);
/// Share of requests that are drawn without regard to the state, at rest; and of the jobs of a
/// motion in which such a request is made, one a second or so.
const RANDOM_REQUEST_SHARE: f64 = 0.08;
const RANDOM_REQUEST_JOB_SHARE: f64 = 0.0025;
/// How far a joint may be from the marks of the home pose when the operator calibrates (rad).
const AT_HOME_RAD: f64 = 1.5e-3;
/// Distance from home at which the keys are pressed fully (rad).
const FULL_PRESS_RAD: f64 = 0.035;
/// Share of jogs without calibration that lead the arm home.
const HOMING_SHARE: f64 = 0.75;
/// After which time the operator gives up to lead the arm home.
const HOMING_TIME_MAX: Nanos = Nanos::from_secs(15);

/// What it does while the machine moves.
#[derive(Clone, Copy, Debug, Default)]
struct Motion {
    /// When it ends or changes.
    until: Nanos,
    /// Parts that are still to come.
    left: u32,
    /// Whether it leads the arm home.
    is_homing: bool,
}

/// The task, with the ports of the scripted operator.
pub(crate) struct StormOperator {
    random: SplitMix,
    faults: TargetFaults,
    calm_from: Nanos,
    touch: bool,
    /// Mode and state when they changed last, and until when it waits there.
    seen: (u32, u32),
    wait_until: Nanos,
    motion: Motion,
    /// The home pose: that in which the arm stood at first (rad).
    home_rad: Option<[f64; 6]>,
    /// How far each joint is from there, by the marks on the arm and not by its encoders (rad).
    to_home_rad: [f64; 6],
    request: Request,
    jog: JogCommand,
    typed: OperatorMove,
    control: Input<ControlState>,
    queue: Input<MoveQueue>,
    truth: Input<WorldTruth>,
    requests: Output<Request>,
    jogs: Output<JogCommand>,
    moves: Output<OperatorMove>,
}

impl StormOperator {
    pub(crate) fn new(
        seed: u64,
        plan: &FaultPlan,
        calm_from: Nanos,
        touch: bool,
        ports: &mut Ports,
    ) -> StormOperator {
        StormOperator {
            random: SplitMix::new(seed ^ 0x4f50_4552_4154_4f52),
            faults: TargetFaults::of(plan, "operator", seed),
            calm_from,
            touch,
            seen: (u32::MAX, u32::MAX),
            wait_until: Nanos::ZERO,
            motion: Motion::default(),
            home_rad: None,
            to_home_rad: [0.0; 6],
            request: Request::default(),
            jog: JogCommand::default(),
            typed: OperatorMove::default(),
            control: ports.input_delayed("control"),
            queue: ports.input_delayed("queue"),
            truth: ports.input("truth"),
            requests: ports.output("request"),
            jogs: ports.output("jog"),
            moves: ports.output("moves"),
        }
    }

    fn ask(&mut self, verb: Verb) {
        self.request =
            Request { verb: verb as u32, sequence: self.request.sequence.wrapping_add(1) };
    }

    /// A wait of up to so many milliseconds from now on; a short one in the calm.
    fn wait(&mut self, now: Nanos, most_ms: f64) {
        let drawn = self.random.unit() * most_ms;
        let ms = if now >= self.calm_from { drawn.min(50.0) } else { drawn };
        self.wait_until = now + REACTION_TIME + Nanos((ms * 1e6) as i64);
    }

    /// Begins to wait when mode or state has changed.
    fn notice_change(&mut self, control: &ControlState, now: Nanos) {
        let seen = (control.mode, control.state);
        if seen == self.seen {
            return;
        }
        self.seen = seen;
        self.jog.axes = [0.0; 6];
        let mode = control.mode();
        let most_ms = match mode {
            Mode::Fault => 300.0,
            Mode::Hold => 400.0,
            _ => 100.0,
        };
        self.wait(now, most_ms);
        if mode == Mode::Moving {
            self.motion = Motion { left: 1 + self.random.below(4) as u32, ..Motion::default() };
            let state = State::from_code(control.state).unwrap_or_default();
            if state == State::ManualUncalibrated && self.random.unit() < HOMING_SHARE {
                self.motion = Motion { until: now + HOMING_TIME_MAX, left: 0, is_homing: true };
            }
        }
    }

    /// Looks where the arm stands.
    fn look(&mut self, truth: &WorldTruth) {
        let home = *self.home_rad.get_or_insert(truth.q_rad);
        self.to_home_rad = core::array::from_fn(|joint| home[joint] - truth.q_rad[joint]);
    }

    /// Whether the arm stands in its home pose. Elsewhere a calibration would be a mistake.
    fn is_at_home(&self) -> bool {
        self.to_home_rad.iter().all(|left| left.abs() < AT_HOME_RAD)
    }

    fn act(&mut self, control: &ControlState, queue: &MoveQueue, now: Nanos) {
        let calm = now >= self.calm_from;
        let state = State::from_code(control.state).unwrap_or_default();
        let share = match control.mode() {
            Mode::Moving => RANDOM_REQUEST_JOB_SHARE,
            _ => RANDOM_REQUEST_SHARE,
        };
        if !calm && self.random.unit() < share {
            let verb = Verb::ALL[self.random.below(Verb::ALL.len())];
            if verb != Verb::Calibrate || self.is_at_home() {
                self.ask(verb);
            }
            self.wait(now, 100.0);
            return;
        }
        match control.mode() {
            Mode::Off | Mode::Checking | Mode::Stopping => {}
            Mode::Fault => {
                self.ask(Verb::Reset);
                self.wait(now, 50.0);
            }
            // A latched fault that stops the machine keeps the drives off.
            Mode::Ready if control.faults != 0 && self.random.below(2) == 0 => {
                self.ask(Verb::Reset);
                self.wait(now, 20.0);
            }
            Mode::Ready => {
                self.ask(Verb::Enable);
                self.wait(now, 50.0);
            }
            Mode::Enabling => {
                if !calm && self.random.below(20) == 0 {
                    self.ask(Verb::Stop);
                }
                self.wait(now, 100.0);
            }
            Mode::Hold => self.begin(state, calm, now),
            Mode::Moving => self.go_on(state, queue, calm, now),
        }
    }

    /// Chooses what to do from a state of rest.
    fn begin(&mut self, state: State, calm: bool, now: Nanos) {
        let calibrated = state == State::IdleCalibrated;
        let verb = match (calibrated, calm) {
            (false, true) => Verb::ManualUncalibrated,
            (true, true) => Verb::ManualJoint,
            (false, false) if self.is_at_home() && self.random.below(8) > 0 => Verb::Calibrate,
            (false, false) if self.random.below(8) == 0 => Verb::Stop,
            (false, false) => Verb::ManualUncalibrated,
            (true, false) => {
                let all = [
                    Verb::ManualJoint,
                    Verb::ManualCartesian,
                    Verb::Trajectory,
                    Verb::Trajectory,
                    Verb::TrajectoryUser,
                    Verb::TactileServo,
                    Verb::TactileServo,
                    Verb::Stop,
                ];
                let verb = all[self.random.below(all.len())];
                if verb == Verb::TactileServo && !self.touch { Verb::ManualJoint } else { verb }
            }
        };
        self.ask(verb);
        self.wait(now, if calm { 20.0 } else { 300.0 });
    }

    /// Goes on with a motion, or ends it.
    fn go_on(&mut self, state: State, queue: &MoveQueue, calm: bool, now: Nanos) {
        let manual = matches!(
            state,
            State::ManualUncalibrated | State::ManualJoint | State::ManualCartesian
        );
        if calm && !manual {
            self.ask(Verb::Idle);
            self.wait(now, 20.0);
            return;
        }
        if calm && self.motion.is_homing {
            self.motion = Motion::default();
        }
        if self.motion.is_homing && now < self.motion.until {
            let press = |left: f64| (left / FULL_PRESS_RAD).clamp(-1.0, 1.0);
            self.jog.axes = self.to_home_rad.map(press);
            self.jog.frame = JogFrame::Joints as u32;
            if self.is_at_home() {
                self.jog.axes = [0.0; 6];
                self.ask(Verb::Idle);
                self.wait(now, 200.0);
            }
            return;
        }
        if now < self.motion.until {
            return;
        }
        if self.motion.left == 0 && !calm {
            let verb = if self.random.below(8) == 0 { Verb::Stop } else { Verb::Idle };
            self.jog.axes = [0.0; 6];
            self.ask(verb);
            self.wait(now, 200.0);
            return;
        }
        self.motion.left = self.motion.left.saturating_sub(1);
        if manual {
            let span_ms = if calm { 400.0 } else { 100.0 + 900.0 * self.random.unit() };
            self.motion.until = now + Nanos((span_ms * 1e6) as i64);
            self.hold_keys(state, calm);
        } else {
            let span_ms = 200.0 + 2_500.0 * self.random.unit();
            self.motion.until = now + Nanos((span_ms * 1e6) as i64);
            if state == State::TrajectoryUser && queue.received == self.typed.sequence {
                self.type_move();
            }
        }
    }

    fn hold_keys(&mut self, state: State, calm: bool) {
        let frame = match state {
            State::ManualCartesian if self.random.below(2) == 0 => JogFrame::Base,
            State::ManualCartesian => JogFrame::Tool,
            _ => JogFrame::Joints,
        };
        self.jog.axes = [0.0; 6];
        let axis = self.random.below(6);
        let push = 2.0 * self.random.unit() - 1.0;
        // In the calm the joints go home, and to and fro there, at a speed that leaves no doubt who
        // follows whom.
        self.jog.axes[axis] = if calm { 0.5 * self.to_home_rad[axis].signum() } else { push };
        if !calm && self.random.below(3) == 0 {
            self.jog.axes[self.random.below(6)] = 2.0 * self.random.unit() - 1.0;
        }
        self.jog.frame = frame as u32;
    }

    fn type_move(&mut self) {
        let mut values = [0.0; 12];
        for value in values.iter_mut().take(3) {
            *value = 0.04 * self.random.unit() - 0.02;
        }
        self.typed = OperatorMove {
            values,
            t_s: 0.0,
            kind: MoveKind::By as u32,
            straight: self.random.below(2) as u32,
            now: self.random.below(2) as u32,
            sequence: self.typed.sequence.wrapping_add(1),
        };
    }

    /// Requests without sense, as many as the flood has; the last one counts.
    fn flood(&mut self, requests: f64) {
        for _ in 0..requests as u32 {
            let verb = Verb::ALL[self.random.below(Verb::ALL.len())];
            if verb != Verb::Calibrate || self.is_at_home() {
                self.ask(verb);
            }
        }
        self.jog.axes = self.jog.axes.map(|_| 2.0 * self.random.unit() - 1.0);
        self.jog.sequence = self.jog.sequence.wrapping_add(1);
    }
}

impl Task for StormOperator {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let now = cycle.release;
        let control = io.read(&self.control).value;
        let queue = io.read(&self.queue).value;
        if let Some(truth) = io.read(&self.truth).usable() {
            self.look(&truth);
        }
        let silent = self.faults.is_active(FaultKind::Silence, now);
        let gone = self.faults.is_active(FaultKind::Unplugged, now);
        if !silent && !gone {
            self.notice_change(&control, now);
            // Keys are confirmed for as long as they are held.
            self.jog.sequence = self.jog.sequence.wrapping_add(1);
            if let Some(requests) = self.faults.strength(FaultKind::Flood, 0, now) {
                self.flood(requests);
            } else if now >= self.wait_until && control.request == self.request.sequence {
                self.act(&control, &queue, now);
            } else if control.mode() == Mode::Moving && now < self.wait_until {
                self.jog.axes = [0.0; 6];
            }
        }
        io.write(&self.requests, self.request);
        io.write(&self.jogs, self.jog);
        io.write(&self.moves, self.typed);
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.request).add(&self.jog).add(&self.typed).add(&self.wait_until);
    }
}
