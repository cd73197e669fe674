//! The scripted operator: makes one request after the other, each when the machine is idle. A
//! request is made once, and the next one follows only after the supervisor has processed it. Keys
//! of a jog
//! are held while the machine is in a MANUAL state, for as long as the script says. Moves
//! are typed
//! while it is in TRAJECTORY/USER. An operator at a socket may send commands as well.

use taktil_machine::operator::status::is_accepted;
use taktil_machine::operator::{OperatorInput, OperatorReceiver};
use taktil_rtcore::{
    Cycle, FaultCode, Input, Invalid, Io, Mode, Nanos, Output, Ports, StateHash, Task,
};
use taktil_signal::{ControlState, JogCommand, MoveQueue, OperatorMove, Request, State, Verb};

use super::scene::{OperatorAction, Step};

/// A task that reads `control` and `queue` (delayed) and writes `request`, `jog` and `moves`.
pub struct Operator {
    script: Vec<Step>,
    next: usize,
    receiver: Option<OperatorReceiver>,
    input: OperatorInput,
    /// Number of requests and moves of the script so far.
    asked: u32,
    typed_moves: u32,
    control: Input<ControlState>,
    typed: Input<MoveQueue>,
    request: Output<Request>,
    jog: Output<JogCommand>,
    moves: Output<OperatorMove>,
    /// Instant at which the keys of the present step were first held.
    held_since: Option<Nanos>,
}

impl Operator {
    /// Declares the ports of the task.
    ///
    /// # Errors
    /// This constructor does not fail; it has the signature that all tasks share.
    pub fn new(script: Vec<Step>, ports: &mut Ports) -> Result<Operator, Invalid> {
        Operator::with(script, None, ports)
    }

    /// Like [`Operator::new`], and also executes the commands from `receiver`.
    ///
    /// # Errors
    /// As [`Operator::new`].
    pub fn with(
        script: Vec<Step>,
        receiver: Option<OperatorReceiver>,
        ports: &mut Ports,
    ) -> Result<Operator, Invalid> {
        Ok(Operator {
            script,
            next: 0,
            receiver,
            input: OperatorInput::default(),
            asked: 0,
            typed_moves: 0,
            control: ports.input_delayed("control"),
            typed: ports.input_delayed("queue"),
            request: ports.output("request"),
            jog: ports.output("jog"),
            moves: ports.output("moves"),
            held_since: None,
        })
    }

    /// Holds keys in this job, or releases them and proceeds to the next step.
    fn hold(&mut self, axes: [f64; 6], frame: u32, span: Nanos, now: Nanos) {
        let since = *self.held_since.get_or_insert(now);
        if now - since < span {
            let sequence = self.input.jog.sequence.wrapping_add(1);
            self.input.jog = JogCommand { axes, frame, sequence };
        } else {
            self.release();
            self.next += 1;
        }
    }

    /// Whether the trajectory task has accepted the newest typed command, by its number. Before the
    /// first command both numbers are 0.
    fn is_last_move_accepted(&self, typed: &MoveQueue) -> bool {
        typed.received == self.input.typed.sequence
    }

    fn release(&mut self) {
        if self.held_since.take().is_some() {
            self.input.jog.axes = [0.0; 6];
        }
    }

    /// Executes the next step of the script, if its conditions hold.
    fn proceed(&mut self, control: &ControlState, typed: &MoveQueue, now: Nanos) {
        let Some(step) = self.script.get(self.next).copied() else { return };
        if control.request != self.input.request.sequence || now < step.at {
            return;
        }
        match step.act {
            OperatorAction::Ask(verb) if is_interrupting(verb) || is_idle(control, now) => {
                self.next += 1;
                self.asked += 1;
                self.input.request = Request { verb: verb as u32, sequence: self.asked };
            }
            OperatorAction::Hold { axes, frame, span } if is_manual(control) => {
                self.hold(axes, frame as u32, span, now);
            }
            OperatorAction::Type(word)
                if is_accepted(control, &word) && self.is_last_move_accepted(typed) =>
            {
                self.next += 1;
                self.typed_moves += 1;
                self.input.typed = OperatorMove { sequence: self.typed_moves, ..word };
            }
            OperatorAction::Rest if accepts_typed_moves(control) => {
                let over = typed.queued == 0 && typed.moving == 0;
                self.next += usize::from(over && typed.received == self.input.typed.sequence);
            }
            OperatorAction::Hold { .. } => self.release(),
            OperatorAction::Ask(_) | OperatorAction::Type(_) | OperatorAction::Rest => {}
        }
    }
}

/// Shortest time from the entry of a state to a request.
const REACTION_TIME: Nanos = Nanos::from_millis(20);

/// Whether the machine waits for a request.
fn is_idle(control: &ControlState, now: Nanos) -> bool {
    if now < Nanos(control.entered_ns) + REACTION_TIME {
        return false;
    }
    match State::from_code(control.state) {
        Some(State::Start) => control.mode() == Mode::Ready,
        Some(State::IdleUncalibrated | State::IdleCalibrated) => control.mode() == Mode::Hold,
        _ => false,
    }
}

/// Whether the state accepts keys.
fn is_manual(control: &ControlState) -> bool {
    let state = State::from_code(control.state);
    matches!(state, Some(State::ManualUncalibrated | State::ManualJoint | State::ManualCartesian))
        && control.mode() == Mode::Moving
}

/// Whether the state accepts typed moves.
fn accepts_typed_moves(control: &ControlState) -> bool {
    control.state == State::TrajectoryUser as u32 && control.mode() == Mode::Moving
}

/// Whether a verb is accepted during a motion.
fn is_interrupting(verb: Verb) -> bool {
    matches!(verb, Verb::Stop | Verb::Idle | Verb::Reset)
}

impl Task for Operator {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let control = io.read(&self.control).value;
        let typed = io.read(&self.typed).value;
        if let Some(receiver) = &mut self.receiver {
            receiver.receive_into(&mut self.input);
        }
        self.proceed(&control, &typed, cycle.release);
        io.write(&self.jog, self.input.jog);
        io.write(&self.request, self.input.request);
        io.write(&self.moves, self.input.typed);
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.next).add(&self.input.request).add(&self.input.jog).add(&self.input.typed);
        hash.add(&self.held_since).add(&self.asked).add(&self.typed_moves);
    }
}
