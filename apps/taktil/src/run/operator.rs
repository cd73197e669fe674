//! The scripted operator: asks for one thing after the other, each when the machine stands idle.
//! Refuses to hurry: a request is made once, and the next one only after the supervisor has looked
//! at it.

use taktil_rtcore::{Cycle, FaultCode, Input, Invalid, Io, Mode, Nanos, Output, Ports, Task};
use taktil_signal::{ControlState, Request, State, Verb};

use super::scene::Step;

/// A task that reads `control` (delayed) and writes `request`.
pub struct Operator {
    script: Vec<Step>,
    next: usize,
    last: Request,
    control: Input<ControlState>,
    request: Output<Request>,
}

impl Operator {
    /// Declares its ports.
    ///
    /// # Errors
    /// None; the signature is that of every task.
    pub fn new(script: Vec<Step>, ports: &mut Ports) -> Result<Operator, Invalid> {
        let control = ports.input_delayed("control");
        let request = ports.output("request");
        Ok(Operator { script, next: 0, last: Request::default(), control, request })
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

/// Verbs that make sense while something is going on.
fn interrupts(verb: Verb) -> bool {
    matches!(verb, Verb::Stop | Verb::Idle | Verb::Reset)
}

impl Task for Operator {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let control = io.read(&self.control).value;
        let answered = control.request == self.last.sequence;
        if let Some(step) = self.script.get(self.next)
            && answered
            && cycle.release >= step.at
            && (interrupts(step.verb) || idle(&control, cycle.release))
        {
            self.next += 1;
            self.last = Request { verb: step.verb as u32, sequence: self.last.sequence + 1 };
        }
        io.write(&self.request, self.last);
        Ok(())
    }
}
