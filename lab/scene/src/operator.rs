//! The scripted operator: asks for one thing after the other, each when the machine stands idle. A
//! request is made once, and the next one only after the supervisor has processed it. Keys of a jog
//! are held while the machine is in a MANUAL state, for as long as the script says; moves are typed
//! while it is in TRAJECTORY/USER. Somebody at a socket may ask besides.

use taktil_machine::operator::status::is_accepted;
use taktil_machine::operator::{OperatorInput, OperatorReceiver};
use taktil_rtcore::{
    Cycle, FaultCode, Input, Invalid, Io, Mode, Nanos, Output, Ports, StateHash, Task,
};
use taktil_signal::{ControlState, JogCommand, MoveQueue, OperatorMove, Request, State, Verb};

use super::scene::{Act, Step};

/// A task that reads `control` and `queue` (delayed) and writes `request`, `jog` and `moves`.
pub struct Operator {
    script: Vec<Step>,
    next: usize,
    receiver: Option<OperatorReceiver>,
    input: OperatorInput,
    /// Requests and moves of the script so far.
    asked: u32,
    typed_moves: u32,
    control: Input<ControlState>,
    typed: Input<MoveQueue>,
    request: Output<Request>,
    jog: Output<JogCommand>,
    moves: Output<OperatorMove>,
    /// When the keys of the present step were first held.
    held_since: Option<Nanos>,
}

impl Operator {
    /// Declares its ports.
    ///
    /// # Errors
    /// None; the signature is that of every task.
    pub fn new(script: Vec<Step>, ports: &mut Ports) -> Result<Operator, Invalid> {
        Operator::with(script, None, ports)
    }

    /// As [`Operator::new`], and does what `receiver` is told besides.
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

    /// Holds keys in this job, or lets them go and turns to the next step.
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

    /// Whether the trajectory task has taken the newest typed word, by its number. Before the first
    /// word both numbers are 0.
    fn is_last_move_accepted(&self, typed: &MoveQueue) -> bool {
        typed.received == self.input.typed.sequence
    }

    fn release(&mut self) {
        if self.held_since.take().is_some() {
            self.input.jog.axes = [0.0; 6];
        }
    }

    /// The next step of the script, if it is time for it.
    fn proceed(&mut self, control: &ControlState, typed: &MoveQueue, now: Nanos) {
        let Some(step) = self.script.get(self.next).copied() else { return };
        if control.request != self.input.request.sequence || now < step.at {
            return;
        }
        match step.act {
            Act::Ask(verb) if interrupts(verb) || idle(control, now) => {
                self.next += 1;
                self.asked += 1;
                self.input.request = Request { verb: verb as u32, sequence: self.asked };
            }
            Act::Hold { axes, frame, span } if manual(control) => {
                self.hold(axes, frame as u32, span, now);
            }
            Act::Type(word) if is_accepted(control, &word) && self.is_last_move_accepted(typed) => {
                self.next += 1;
                self.typed_moves += 1;
                self.input.typed = OperatorMove { sequence: self.typed_moves, ..word };
            }
            Act::Rest if typing(control) => {
                let over = typed.queued == 0 && typed.moving == 0;
                self.next += usize::from(over && typed.received == self.input.typed.sequence);
            }
            Act::Hold { .. } => self.release(),
            Act::Ask(_) | Act::Type(_) | Act::Rest => {}
        }
    }
}

/// Nobody asks sooner than this after a state was entered.
const REACTION_TIME: Nanos = Nanos::from_millis(20);

/// Whether the machine waits for someone to ask.
fn idle(control: &ControlState, now: Nanos) -> bool {
    if now < Nanos(control.entered_ns) + REACTION_TIME {
        return false;
    }
    match State::from_code(control.state) {
        Some(State::Start) => control.mode() == Mode::Ready,
        Some(State::IdleUncalibrated | State::IdleCalibrated) => control.mode() == Mode::Hold,
        _ => false,
    }
}

/// Whether keys mean anything.
fn manual(control: &ControlState) -> bool {
    let state = State::from_code(control.state);
    matches!(state, Some(State::ManualUncalibrated | State::ManualJoint | State::ManualCartesian))
        && control.mode() == Mode::Moving
}

/// Whether moves are taken.
fn typing(control: &ControlState) -> bool {
    control.state == State::TrajectoryUser as u32 && control.mode() == Mode::Moving
}

/// Verbs that make sense while something is going on.
fn interrupts(verb: Verb) -> bool {
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
