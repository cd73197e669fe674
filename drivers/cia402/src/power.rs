//! The way through the power state machine: which controlword leads from the state that the drive
//! shows towards the state that is wanted. Nothing restarts by itself. After a fault it takes two
//! deliberate acts to move again, a reset and, once it has been given up, the wish to enable; after
//! a drive has left operation by itself it takes the second one.

use taktil_hal::DriveRequest;

use crate::control::Controlword;
use crate::status::{State, Statusword};

/// What is wanted of a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Goal {
    /// Torque off.
    #[default]
    Disabled,
    /// A stop as object 605A says, then torque off.
    QuickStop,
    /// Operation.
    Enabled,
}

impl From<DriveRequest> for Goal {
    fn from(request: DriveRequest) -> Goal {
        match request {
            DriveRequest::Off => Goal::Disabled,
            DriveRequest::QuickStop => Goal::QuickStop,
            DriveRequest::Follow => Goal::Enabled,
        }
    }
}

/// What is asked of the machine in one cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Command {
    /// The state that is wanted.
    pub goal: Goal,
    /// Becomes true to ask for the reset of a fault. Only the change counts, and only in the state
    /// fault or after it: a person has to have had the chance to see what is reset.
    pub fault_reset: bool,
}

/// Object 605A, as far as it decides whether a quick stop may end in operation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum QuickStopOption {
    /// 0 to 4: a stop ends in switch on disabled.
    #[default]
    Leaves,
    /// 5 to 8: a stop ends in quick stop active, from which operation may be enabled again.
    Stays,
}

impl QuickStopOption {
    /// Reads the value of object 605A. Values of makers, which are negative, count as 0.
    #[must_use]
    pub const fn from_code(code: i16) -> QuickStopOption {
        match code {
            5..=8 => QuickStopOption::Stays,
            _ => QuickStopOption::Leaves,
        }
    }
}

/// What keeps a drive from being enabled, whatever is wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Inhibition {
    /// Nothing.
    #[default]
    None,
    /// A fault, until its reset has been asked for.
    Reset,
    /// The wish to enable has to be given up and made again.
    NewWish,
}

/// Most cycles for which bit 7 stays set, so that a drive that misses frames sees its edge.
pub const RESET_CYCLES_MAX: u32 = 100;

/// Where a request for a reset stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reset {
    /// None is under way.
    Idle,
    /// One cycle with bit 7 at 0 comes before the edge.
    Low,
    /// Bit 7 is set, for so many more cycles.
    High(u32),
}

/// The power state machine of one drive as its master sees it.
#[derive(Clone, Debug)]
pub struct PowerStateMachine {
    quick_stop: QuickStopOption,
    inhibition: Inhibition,
    reset: Reset,
    was_enabled: bool,
    was_asked: bool,
    /// The drive reacts to a fault, which cannot be reset yet.
    reacts: bool,
    last: Controlword,
}

impl Default for PowerStateMachine {
    fn default() -> PowerStateMachine {
        PowerStateMachine::new()
    }
}

impl PowerStateMachine {
    /// The machine of a drive of which nothing is known; its quick stop leaves operation.
    #[must_use]
    pub const fn new() -> PowerStateMachine {
        PowerStateMachine::with_quick_stop(QuickStopOption::Leaves)
    }

    /// The machine of a drive with this setting of object 605A.
    #[must_use]
    pub const fn with_quick_stop(quick_stop: QuickStopOption) -> PowerStateMachine {
        PowerStateMachine {
            quick_stop,
            inhibition: Inhibition::None,
            reset: Reset::Idle,
            was_enabled: false,
            was_asked: false,
            reacts: false,
            // Whoever drove it before may have left bit 7 set.
            last: Controlword::FAULT_RESET,
        }
    }

    /// The controlword for a drive that shows `status`, towards what is asked.
    pub fn step(&mut self, status: Statusword, command: Command) -> Controlword {
        let state = status.state().ok();
        self.inhibit(state, command);
        let word = match state {
            Some(State::Fault) => self.reset_word(),
            Some(state) => self.way(state, command.goal),
            None => Controlword::DISABLE_VOLTAGE,
        };
        if state != Some(State::Fault) {
            self.reset = Reset::Idle;
        }
        let is_wanted = command.goal == Goal::Enabled && self.inhibition == Inhibition::None;
        self.was_enabled = state == Some(State::OperationEnabled) && is_wanted;
        self.was_asked = command.fault_reset;
        self.reacts = state == Some(State::FaultReactionActive);
        self.last = word;
        word
    }

    /// What keeps the drive from being enabled.
    #[must_use]
    pub const fn inhibition(&self) -> Inhibition {
        self.inhibition
    }

    /// Whether a fault waits for the request of its reset.
    #[must_use]
    pub const fn needs_reset(&self) -> bool {
        matches!(self.inhibition, Inhibition::Reset)
    }

    fn inhibit(&mut self, state: Option<State>, command: Command) {
        let is_new = command.fault_reset && !self.was_asked;
        match state {
            Some(State::FaultReactionActive) => self.inhibition = Inhibition::Reset,
            Some(State::Fault) => {
                // A fault that stands behind a reset that was asked for already is a new one only
                // when the drive does not leave it in time.
                if self.reset == Reset::Idle {
                    self.inhibition = Inhibition::Reset;
                    if is_new {
                        let is_high = self.last.has_fault_reset();
                        self.reset =
                            if is_high { Reset::Low } else { Reset::High(RESET_CYCLES_MAX) };
                    }
                }
            }
            _ => self.release(state, is_new, command.goal),
        }
    }

    /// Lifts what keeps the drive from being enabled by the acts that this takes, and inhibits a
    /// drive that left operation by itself.
    fn release(&mut self, state: Option<State>, is_new_reset: bool, goal: Goal) {
        let has_left = self.was_enabled && state != Some(State::OperationEnabled);
        if self.inhibition == Inhibition::None && (has_left || state.is_none()) {
            self.inhibition = Inhibition::NewWish;
        }
        // A drive that left its fault by itself, for example because it was switched off and on,
        // has one to be acknowledged all the same.
        if self.inhibition == Inhibition::Reset && (is_new_reset || self.reset != Reset::Idle) {
            self.inhibition = Inhibition::NewWish;
        }
        if self.inhibition == Inhibition::NewWish && goal != Goal::Enabled && state.is_some() {
            self.inhibition = Inhibition::None;
        }
    }

    fn reset_word(&mut self) -> Controlword {
        match self.reset {
            Reset::Idle => Controlword::DISABLE_VOLTAGE,
            Reset::Low => {
                self.reset = Reset::High(RESET_CYCLES_MAX);
                Controlword::DISABLE_VOLTAGE
            }
            Reset::High(0) => {
                self.reset = Reset::Idle;
                Controlword::DISABLE_VOLTAGE
            }
            Reset::High(cycles) => {
                self.reset = Reset::High(cycles - 1);
                Controlword::FAULT_RESET
            }
        }
    }

    /// The way from a state that is no fault.
    const fn way(&self, state: State, goal: Goal) -> Controlword {
        let is_free = matches!(self.inhibition, Inhibition::None);
        match goal {
            _ if state.is_fault() => Controlword::DISABLE_VOLTAGE,
            Goal::Disabled => Controlword::DISABLE_VOLTAGE,
            Goal::QuickStop => Controlword::QUICK_STOP,
            Goal::Enabled if !is_free => Controlword::DISABLE_VOLTAGE,
            Goal::Enabled => match (state, self.quick_stop) {
                (State::SwitchOnDisabled, _) => Controlword::SHUT_DOWN,
                (State::ReadyToSwitchOn, _) => Controlword::SWITCH_ON,
                (State::SwitchedOn | State::OperationEnabled, _)
                | (State::QuickStopActive, QuickStopOption::Stays) => Controlword::ENABLE_OPERATION,
                _ => Controlword::DISABLE_VOLTAGE,
            },
        }
    }
}

/// What a rising edge of the enable line leads to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Edge {
    /// Operation.
    #[default]
    Enables,
    /// The reset of a fault that nobody was told of, and no more.
    Resets,
    /// The reset of a fault that was told, and then operation.
    ResetsAndEnables,
}

/// The two acts by one line, where a cell has no other. A fault that was told has had its first act
/// from whoever took the line away and gave it back: its rising edge resets and enables. A fault
/// that nobody was told of is reset by the first rising edge, and only the next one enables.
#[derive(Clone, Copy, Debug, Default)]
pub struct EnableLine {
    is_on: bool,
    edge: Edge,
}

impl EnableLine {
    /// What the line asks of `machine`; `is_told`: whoever owns the line was told of the fault that
    /// waits for its reset, and has to acknowledge what it was told before the line rises.
    pub fn command(&mut self, enable: bool, machine: &PowerStateMachine, is_told: bool) -> Command {
        if enable && !self.is_on {
            self.edge = match (machine.needs_reset(), is_told) {
                (false, _) => Edge::Enables,
                (true, false) => Edge::Resets,
                (true, true) => Edge::ResetsAndEnables,
            };
        }
        self.is_on = enable;
        if self.edge == Edge::ResetsAndEnables && machine.inhibition() == Inhibition::None {
            self.edge = Edge::Enables;
        }
        let enables = self.edge == Edge::Enables;
        let goal = if enable && enables { Goal::Enabled } else { Goal::Disabled };
        // A request counts by its change, and only once the drive has done with its reaction.
        Command { goal, fault_reset: enable && !enables && !machine.reacts }
    }
}
