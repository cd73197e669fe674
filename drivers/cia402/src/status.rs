//! The statusword (6041) and the state that it shows. Each of the 65536 words either shows one
//! state of the standard's diagram or has a named [`Inconsistency`].

use core::fmt;

use taktil_hal::DriveState;

/// The states of the power state machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum State {
    /// The drive initialises itself.
    NotReadyToSwitchOn,
    /// The drive waits; the high voltage may be off.
    SwitchOnDisabled,
    /// The high voltage may be switched on.
    ReadyToSwitchOn,
    /// The high voltage is on, the motor without torque.
    SwitchedOn,
    /// The drive follows its target.
    OperationEnabled,
    /// The drive stops as object 605A says.
    QuickStopActive,
    /// The drive reacts to a fault.
    FaultReactionActive,
    /// The motor is without torque until the fault is reset.
    Fault,
}

impl State {
    /// All states, in the order of the diagram.
    pub const ALL: [State; 8] = [
        State::NotReadyToSwitchOn,
        State::SwitchOnDisabled,
        State::ReadyToSwitchOn,
        State::SwitchedOn,
        State::OperationEnabled,
        State::QuickStopActive,
        State::FaultReactionActive,
        State::Fault,
    ];

    /// The standard's name, for reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            State::NotReadyToSwitchOn => "not ready to switch on",
            State::SwitchOnDisabled => "switch on disabled",
            State::ReadyToSwitchOn => "ready to switch on",
            State::SwitchedOn => "switched on",
            State::OperationEnabled => "operation enabled",
            State::QuickStopActive => "quick stop active",
            State::FaultReactionActive => "fault reaction active",
            State::Fault => "fault",
        }
    }

    /// Whether a fault is under way or waits for its reset.
    #[must_use]
    pub const fn is_fault(self) -> bool {
        matches!(self, State::FaultReactionActive | State::Fault)
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Why a statusword shows no state of the diagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Inconsistency {
    /// Bit 6, switch on disabled, stands beside a bit of another state.
    DisabledAndActive,
    /// Bit 3, fault, stands beside a part of bits 0 to 2, of which a fault has all or none.
    PartOfFault,
    /// One of bits 0 to 2 stands without those below it.
    StepOmitted,
    /// Bit 5 tells of a quick stop in a state that has no operation to stop.
    QuickStopWithoutOperation,
}

impl Inconsistency {
    /// A sentence's end for reports, after "the statusword ...".
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Inconsistency::DisabledAndActive => "says disabled and active at once",
            Inconsistency::PartOfFault => "says fault and a part of operation at once",
            Inconsistency::StepOmitted => "leaves a step of switching on out",
            Inconsistency::QuickStopWithoutOperation => "says quick stop without operation",
        }
    }
}

impl fmt::Display for Inconsistency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Bits 0 to 2: ready to switch on, switched on, operation enabled.
const STEP_BITS: u16 = 0x0007;
/// Bit 3: fault.
const FAULT_BIT: u16 = 0x0008;
/// Bit 4: the high voltage is on.
const VOLTAGE_BIT: u16 = 0x0010;
/// Bit 5: no quick stop; 0 while one is active.
const NO_QUICK_STOP_BIT: u16 = 0x0020;
/// Bit 6: switch on disabled.
const DISABLED_BIT: u16 = 0x0040;
/// Bit 7: warning.
const WARNING_BIT: u16 = 0x0080;
/// Bit 9: the drive obeys the controlword.
const REMOTE_BIT: u16 = 0x0200;
/// Bit 11: an internal limit acts.
const INTERNAL_LIMIT_BIT: u16 = 0x0800;
/// Bit 12: in the cyclic modes, the drive follows the target.
const FOLLOWS_COMMAND_BIT: u16 = 0x1000;
/// Bit 13: in cyclic position mode, following error.
const FOLLOWING_ERROR_BIT: u16 = 0x2000;

/// The word of object 6041.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Statusword(pub u16);

impl Statusword {
    /// The state that the word shows.
    ///
    /// # Errors
    /// The word shows none of them.
    pub const fn state(self) -> Result<State, Inconsistency> {
        let (step, quick_stop) = (self.0 & STEP_BITS, self.0 & NO_QUICK_STOP_BIT == 0);
        if self.0 & DISABLED_BIT != 0 {
            return match self.0 & (STEP_BITS | FAULT_BIT) {
                0 => Ok(State::SwitchOnDisabled),
                _ => Err(Inconsistency::DisabledAndActive),
            };
        }
        if self.0 & FAULT_BIT != 0 {
            return match step {
                0 => Ok(State::Fault),
                STEP_BITS => Ok(State::FaultReactionActive),
                _ => Err(Inconsistency::PartOfFault),
            };
        }
        match (step, quick_stop) {
            (0, _) => Ok(State::NotReadyToSwitchOn),
            (1, false) => Ok(State::ReadyToSwitchOn),
            (3, false) => Ok(State::SwitchedOn),
            (STEP_BITS, false) => Ok(State::OperationEnabled),
            (STEP_BITS, true) => Ok(State::QuickStopActive),
            (1 | 3, true) => Err(Inconsistency::QuickStopWithoutOperation),
            _ => Err(Inconsistency::StepOmitted),
        }
    }

    /// Whether operation is enabled.
    #[must_use]
    pub const fn is_enabled(self) -> bool {
        matches!(self.state(), Ok(State::OperationEnabled))
    }

    /// Whether a fault is under way or waits for its reset.
    #[must_use]
    pub const fn is_fault(self) -> bool {
        matches!(self.state(), Ok(State::FaultReactionActive | State::Fault))
    }

    /// Whether operation is enabled and the drive follows the target of a cyclic mode (bit 12).
    #[must_use]
    pub const fn is_following(self) -> bool {
        self.is_enabled() && self.0 & FOLLOWS_COMMAND_BIT != 0
    }

    /// The state of the power section as halves for drives report it. A word that shows no state is
    /// that of a drive without torque.
    #[must_use]
    pub fn drive_state(self) -> DriveState {
        match self.state() {
            Ok(State::Fault | State::FaultReactionActive) => DriveState::Fault,
            Ok(State::QuickStopActive) => DriveState::Stopping,
            Ok(State::OperationEnabled) if self.is_following() => DriveState::Following,
            Ok(State::OperationEnabled | State::SwitchedOn | State::ReadyToSwitchOn) => {
                DriveState::Enabling
            }
            Ok(State::SwitchOnDisabled | State::NotReadyToSwitchOn) | Err(_) => DriveState::Off,
        }
    }

    /// Whether the high voltage is on (bit 4).
    #[must_use]
    pub const fn has_voltage(self) -> bool {
        self.0 & VOLTAGE_BIT != 0
    }

    /// Whether the drive warns (bit 7).
    #[must_use]
    pub const fn has_warning(self) -> bool {
        self.0 & WARNING_BIT != 0
    }

    /// Whether the drive obeys the controlword (bit 9).
    #[must_use]
    pub const fn is_remote(self) -> bool {
        self.0 & REMOTE_BIT != 0
    }

    /// Whether an internal limit acts (bit 11).
    #[must_use]
    pub const fn has_internal_limit(self) -> bool {
        self.0 & INTERNAL_LIMIT_BIT != 0
    }

    /// Whether the position lies too far from its target (bit 13); in cyclic position mode only.
    #[must_use]
    pub const fn has_following_error(self) -> bool {
        self.0 & FOLLOWING_ERROR_BIT != 0
    }
}
