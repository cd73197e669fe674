//! The mode machine, which decides whether the machine may move. The table of the supervisor
//! decides what it does while it may. This module knows drives, stops and faults, but neither
//! joints nor touch.
//!
//! ```text
//!            PowerOn         ChecksPassed       Enable         Enabled
//!   OFF ──────────────> CHECKING ───────> READY ───────> ENABLING ───────> HOLD
//!    ^                    │  ^              ^ ^             │  Stop        │  ^
//!    │ ChecksFailed       │  │ Reset        │ └─────────────┘         Move │  │ Settle
//!    ├────────────────────┘  │              │                              v  │
//!    │ PowerOff (from        │              │ Stopped, no fault          MOVING
//!    │ any mode but FAULT)   │              │                  Stop        │
//!                          FAULT <──── STOPPING <──────────────────────────┤
//!                            ^   Stopped, fault latched        (also HOLD) │
//!                            └─── any mode: a fault of class DriveOff ─────┘
//! ```
//! FAULT is latched: it ends only by `Reset`, which leads to CHECKING and never to motion; moving
//! again takes a second, separate act.

use crate::fault::{Class, FaultSet};

/// Whether torque is allowed, and on the way to what.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Mode {
    /// Drive power off; outputs safe.
    #[default]
    Off = 0,
    /// Power is there; devices and the contract with the kernel are being checked.
    Checking = 1,
    /// All checks hold; drives off.
    Ready = 2,
    /// Drives on, servo holding, brakes still on.
    Enabling = 3,
    /// Brakes off, standing still under servo.
    Hold = 4,
    /// A source of motion is at work.
    Moving = 5,
    /// Decelerating to a stop, then drives off.
    Stopping = 6,
    /// A fault is latched; outputs safe.
    Fault = 7,
}

/// The events of the mode machine: requests and reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Event {
    /// Drive power came on.
    PowerOn,
    /// Drive power went off by intent.
    PowerOff,
    /// Every check holds.
    ChecksPassed,
    /// A check failed.
    ChecksFailed,
    /// A request to switch the drives on.
    Enable,
    /// The servo holds and the brakes are released.
    Enabled,
    /// A source of motion takes over.
    Move,
    /// The source of motion has finished.
    Settle,
    /// A request to stop.
    Stop,
    /// The arm stands still after a stop.
    Stopped,
    /// The latched fault is acknowledged.
    Reset,
}

/// The reaction of the machine to the present faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Action {
    /// Go on.
    None,
    /// Continue with reduced function: hold the last good value or stand still.
    Degrade,
    /// Decelerate and stop.
    ControlledStop,
    /// Take the torque away now.
    DriveOff,
}

impl Mode {
    /// Every mode.
    pub const ALL: [Mode; 8] = [
        Mode::Off,
        Mode::Checking,
        Mode::Ready,
        Mode::Enabling,
        Mode::Hold,
        Mode::Moving,
        Mode::Stopping,
        Mode::Fault,
    ];

    /// The number that stands for the mode in payloads.
    #[must_use]
    pub const fn code(self) -> u32 {
        self as u32
    }

    /// The mode with this number; `None` when no mode has it. For displays, which show an unknown
    /// number as such.
    #[must_use]
    pub fn from_code(code: u32) -> Option<Mode> {
        Mode::ALL.get(code as usize).copied()
    }

    /// The mode with this number, and [`Mode::Fault`] when no mode has it: a decision by an unknown
    /// number must not allow torque.
    #[must_use]
    pub fn from_code_or_fault(code: u32) -> Mode {
        Mode::from_code(code).unwrap_or(Mode::Fault)
    }

    /// Whether D/A words other than the safe value may leave.
    #[must_use]
    pub const fn torque_allowed(self) -> bool {
        matches!(self, Mode::Enabling | Mode::Hold | Mode::Moving | Mode::Stopping)
    }

    /// Whether the brakes may be released.
    #[must_use]
    pub const fn brakes_released(self) -> bool {
        matches!(self, Mode::Hold | Mode::Moving | Mode::Stopping)
    }
}

impl Event {
    /// Every event.
    pub const ALL: [Event; 11] = [
        Event::PowerOn,
        Event::PowerOff,
        Event::ChecksPassed,
        Event::ChecksFailed,
        Event::Enable,
        Event::Enabled,
        Event::Move,
        Event::Settle,
        Event::Stop,
        Event::Stopped,
        Event::Reset,
    ];
}

/// The table of the diagram. `None`: the event has no meaning in this mode and is refused.
#[must_use]
pub const fn next(mode: Mode, event: Event) -> Option<Mode> {
    match (mode, event) {
        (Mode::Fault, Event::Reset) | (Mode::Off, Event::PowerOn) => Some(Mode::Checking),
        (Mode::Fault, _) => None,
        (_, Event::PowerOff) | (Mode::Checking, Event::ChecksFailed) => Some(Mode::Off),
        (Mode::Checking, Event::ChecksPassed)
        | (Mode::Stopping, Event::Stopped)
        | (Mode::Enabling, Event::Stop) => Some(Mode::Ready),
        (Mode::Ready, Event::Enable) => Some(Mode::Enabling),
        (Mode::Enabling, Event::Enabled) | (Mode::Moving, Event::Settle) => Some(Mode::Hold),
        (Mode::Hold, Event::Move) => Some(Mode::Moving),
        (Mode::Hold | Mode::Moving, Event::Stop) => Some(Mode::Stopping),
        _ => None,
    }
}

/// What the faults call for in this mode. A pure function of both.
#[must_use]
pub fn react(mode: Mode, faults: FaultSet) -> Action {
    match faults.worst() {
        None | Some(Class::Note) => Action::None,
        Some(Class::DriveOff) => Action::DriveOff,
        Some(Class::Degrade) if matches!(mode, Mode::Hold | Mode::Moving) => Action::Degrade,
        Some(Class::Degrade) => Action::None,
        Some(Class::ControlledStop) => match mode {
            Mode::Hold | Mode::Moving | Mode::Stopping => Action::ControlledStop,
            Mode::Enabling => Action::DriveOff,
            Mode::Off | Mode::Checking | Mode::Ready | Mode::Fault => Action::None,
        },
    }
}

/// The mode after an action, before any event is looked at.
#[must_use]
pub const fn after(mode: Mode, action: Action) -> Mode {
    match (mode, action) {
        (Mode::Off, _) => Mode::Off,
        (_, Action::DriveOff) => Mode::Fault,
        (Mode::Hold | Mode::Moving, Action::ControlledStop) => Mode::Stopping,
        _ => mode,
    }
}

/// The mode after a finished stop: FAULT when a latched fault called for the stop, else READY.
#[must_use]
pub fn after_stop(latched: FaultSet) -> Mode {
    match latched.worst() {
        Some(Class::ControlledStop | Class::DriveOff) => Mode::Fault,
        _ => Mode::Ready,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::FaultCode;

    #[test]
    fn every_pair_of_mode_and_event_is_as_drawn() {
        use Event as E;
        use Mode as M;
        let drawn = [
            (M::Off, E::PowerOn, M::Checking),
            (M::Checking, E::ChecksPassed, M::Ready),
            (M::Checking, E::ChecksFailed, M::Off),
            (M::Ready, E::Enable, M::Enabling),
            (M::Enabling, E::Enabled, M::Hold),
            (M::Enabling, E::Stop, M::Ready),
            (M::Hold, E::Move, M::Moving),
            (M::Moving, E::Settle, M::Hold),
            (M::Hold, E::Stop, M::Stopping),
            (M::Moving, E::Stop, M::Stopping),
            (M::Stopping, E::Stopped, M::Ready),
            (M::Fault, E::Reset, M::Checking),
        ];
        for mode in Mode::ALL {
            for event in Event::ALL {
                let expected = if event == E::PowerOff && mode != M::Fault {
                    Some(M::Off)
                } else {
                    drawn.iter().find(|(m, e, _)| (*m, *e) == (mode, event)).map(|row| row.2)
                };
                assert_eq!(next(mode, event), expected, "{mode:?} on {event:?}");
            }
        }
    }

    #[test]
    fn motion_is_never_one_event_away_from_a_fault_or_from_no_power() {
        for mode in [Mode::Off, Mode::Checking, Mode::Ready, Mode::Fault] {
            for event in Event::ALL {
                assert!(!matches!(next(mode, event), Some(Mode::Moving | Mode::Hold)));
            }
        }
        assert!(!Mode::Fault.torque_allowed() && !Mode::Off.torque_allowed());
        assert!(!Mode::Enabling.brakes_released());
    }

    /// A fault of each class, weakest first.
    const OF_EACH_CLASS: [FaultCode; 4] = [
        FaultCode::Overrun,
        FaultCode::TactileStale,
        FaultCode::FollowingError,
        FaultCode::EmergencyStop,
    ];

    /// The whole policy: for each mode what the strongest class among the faults calls for, none
    /// first.
    const POLICY: [(Mode, [Action; 5]); 8] = {
        use Action::{ControlledStop as Stop, Degrade, DriveOff, None};
        [
            (Mode::Off, [None, None, None, None, DriveOff]),
            (Mode::Checking, [None, None, None, None, DriveOff]),
            (Mode::Ready, [None, None, None, None, DriveOff]),
            (Mode::Enabling, [None, None, None, DriveOff, DriveOff]),
            (Mode::Hold, [None, None, Degrade, Stop, DriveOff]),
            (Mode::Moving, [None, None, Degrade, Stop, DriveOff]),
            (Mode::Stopping, [None, None, None, Stop, DriveOff]),
            (Mode::Fault, [None, None, None, None, DriveOff]),
        ]
    };

    #[test]
    fn every_mode_under_every_set_of_classes_reacts_as_the_policy_says() {
        for (index, (mode, actions)) in POLICY.into_iter().enumerate() {
            assert_eq!(mode, Mode::ALL[index]);
            for members in 0..16u32 {
                let mut set = FaultSet::NONE;
                for (bit, fault) in OF_EACH_CLASS.into_iter().enumerate() {
                    if members & 1 << bit != 0 {
                        set.insert(fault);
                    }
                }
                let strongest = (u32::BITS - members.leading_zeros()) as usize;
                assert_eq!(react(mode, set), actions[strongest], "{mode:?} with {members:04b}");
            }
        }
    }

    #[test]
    fn only_the_class_of_a_fault_counts() {
        let single = |fault: FaultCode| {
            let mut set = FaultSet::NONE;
            set.insert(fault);
            set
        };
        for (mode, actions) in POLICY {
            for one in FaultCode::ALL {
                assert_eq!(react(mode, single(*one)), actions[1 + one.class() as usize]);
                for other in FaultCode::ALL {
                    let both = react(mode, single(*one).union(single(*other)));
                    let apart = react(mode, single(*one)).max(react(mode, single(*other)));
                    assert_eq!(both, apart, "{mode:?} with {one:?} and {other:?}");
                }
            }
        }
    }

    #[test]
    fn every_pair_of_mode_and_single_fault_reacts_safely() {
        for mode in Mode::ALL {
            assert_eq!(react(mode, FaultSet::NONE), Action::None);
            for fault in FaultCode::ALL {
                let mut set = FaultSet::NONE;
                set.insert(*fault);
                let action = react(mode, set);
                let mode_after = after(mode, action);
                match fault.class() {
                    Class::DriveOff => {
                        assert_eq!(action, Action::DriveOff);
                        assert!(!mode_after.torque_allowed(), "{mode:?} with {fault:?}");
                    }
                    Class::ControlledStop => assert!(
                        !matches!(mode_after, Mode::Moving | Mode::Hold | Mode::Enabling),
                        "{mode:?} with {fault:?}"
                    ),
                    Class::Degrade | Class::Note => assert_eq!(mode_after, mode),
                }
                if mode == Mode::Fault {
                    assert_eq!(mode_after, Mode::Fault, "a fault is latched");
                }
            }
        }
    }

    #[test]
    fn a_stop_ends_in_fault_only_when_a_fault_called_for_it() {
        let mut latched = FaultSet::NONE;
        assert_eq!(after_stop(latched), Mode::Ready);
        latched.insert(FaultCode::Overrun);
        assert_eq!(after_stop(latched), Mode::Ready);
        latched.insert(FaultCode::FollowingError);
        assert_eq!(after_stop(latched), Mode::Fault);
    }

    #[test]
    fn codes_read_back() {
        for mode in Mode::ALL {
            assert_eq!(Mode::from_code(mode.code()), Some(mode));
            assert_eq!(Mode::from_code_or_fault(mode.code()), mode);
        }
    }

    #[test]
    fn a_number_that_no_mode_has_allows_no_torque() {
        for code in [8, 9, 255, 256, u32::MAX] {
            assert_eq!(Mode::from_code(code), None);
            assert_eq!(Mode::from_code_or_fault(code), Mode::Fault);
        }
    }
}
