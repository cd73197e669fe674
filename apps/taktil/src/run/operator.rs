//! The scripted operator: asks for one thing after the other, each when the machine stands idle.
//! Refuses to hurry: a request is made once, and the next one only after the supervisor has looked
//! at it. Keys of a jog are held while the machine is in a MANUAL state, for as long as the script
//! says.

use taktil_rtcore::{
    Cycle, FaultCode, Input, Invalid, Io, Mode, Nanos, Output, Ports, StateHash, Task,
};
use taktil_signal::{ControlState, JogCommand, Request, State, Verb};

use super::scene::{Act, Step};

/// A task that reads `control` (delayed) and writes `request`.
pub struct Operator {
    script: Vec<Step>,
    next: usize,
    last: Request,
    control: Input<ControlState>,
    request: Output<Request>,
    jog: Output<JogCommand>,
    keys: JogCommand,
    /// When the keys of the present step were first held.
    held_since: Option<Nanos>,
}

impl Operator {
    /// Declares its ports.
    ///
    /// # Errors
    /// None; the signature is that of every task.
    pub fn new(script: Vec<Step>, ports: &mut Ports) -> Result<Operator, Invalid> {
        let control = ports.input_delayed("control");
        Ok(Operator {
            script,
            next: 0,
            last: Request::default(),
            control,
            request: ports.output("request"),
            jog: ports.output("jog"),
            keys: JogCommand::default(),
            held_since: None,
        })
    }

    /// Holds keys in this job, or lets them go and turns to the next step.
    fn hold(&mut self, axes: [f64; 6], frame: u32, span: Nanos, now: Nanos) {
        let since = *self.held_since.get_or_insert(now);
        if now - since < span {
            self.keys = JogCommand { axes, frame, sequence: self.keys.sequence + 1 };
        } else {
            self.release();
            self.next += 1;
        }
    }

    fn release(&mut self) {
        self.keys.axes = [0.0; 6];
        self.held_since = None;
    }
}

/// Nobody asks sooner than this after a state was entered.
const REACTION: Nanos = Nanos::from_millis(20);

/// Whether the machine waits for someone to ask.
fn idle(control: &ControlState, now: Nanos) -> bool {
    if now < Nanos(control.entered_ns) + REACTION {
        return false;
    }
    match State::from_code(control.state) {
        Some(State::Start) => control.mode == Mode::Ready as u32,
        Some(State::IdleUncalibrated | State::IdleCalibrated) => control.mode == Mode::Hold as u32,
        _ => false,
    }
}

/// Whether keys mean anything.
fn manual(control: &ControlState) -> bool {
    let state = State::from_code(control.state);
    matches!(state, Some(State::ManualUncalibrated | State::ManualJoint | State::ManualCartesian))
        && control.mode == Mode::Moving as u32
}

/// Verbs that make sense while something is going on.
fn interrupts(verb: Verb) -> bool {
    matches!(verb, Verb::Stop | Verb::Idle | Verb::Reset)
}

impl Task for Operator {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let control = io.read(&self.control).value;
        let answered = control.request == self.last.sequence;
        if let Some(step) = self.script.get(self.next).copied()
            && answered
            && cycle.release >= step.at
        {
            match step.act {
                Act::Ask(verb) if interrupts(verb) || idle(&control, cycle.release) => {
                    self.next += 1;
                    self.last = Request { verb: verb as u32, sequence: self.last.sequence + 1 };
                }
                Act::Hold { axes, frame, span } if manual(&control) => {
                    self.hold(axes, frame as u32, span, cycle.release);
                }
                Act::Ask(_) => {}
                Act::Hold { .. } => self.release(),
            }
        }
        io.write(&self.jog, self.keys);
        io.write(&self.request, self.last);
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.next).add(&self.last).add(&self.keys).add(&self.held_since);
    }
}
