//! The cyclic modes of operation (6060 and 6061).

use taktil_hal::DriveLoop;

use crate::object::Object;

/// The cyclic synchronous modes, in which the host sends one target a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Mode {
    /// Targets are positions (607A).
    CyclicPosition,
    /// Targets are velocities (60FF).
    CyclicVelocity,
    /// Targets are torques (6071).
    CyclicTorque,
}

impl Mode {
    /// All cyclic modes.
    pub const ALL: [Mode; 3] = [Mode::CyclicPosition, Mode::CyclicVelocity, Mode::CyclicTorque];

    /// The cyclic mode in which a drive closes this loop.
    #[must_use]
    pub const fn cyclic(control_loop: DriveLoop) -> Mode {
        match control_loop {
            DriveLoop::Torque => Mode::CyclicTorque,
            DriveLoop::Velocity => Mode::CyclicVelocity,
            DriveLoop::Position => Mode::CyclicPosition,
        }
    }

    /// The object that a drive follows in this mode.
    #[must_use]
    pub const fn target(self) -> Object {
        match self {
            Mode::CyclicTorque => Object::TARGET_TORQUE,
            Mode::CyclicVelocity => Object::TARGET_VELOCITY,
            Mode::CyclicPosition => Object::TARGET_POSITION,
        }
    }

    /// What object 6060 takes and 6061 shows.
    #[must_use]
    pub const fn code(self) -> i8 {
        match self {
            Mode::CyclicPosition => 8,
            Mode::CyclicVelocity => 9,
            Mode::CyclicTorque => 10,
        }
    }

    /// The mode of this code; `None` for a mode that is not cyclic.
    #[must_use]
    pub const fn from_code(code: i8) -> Option<Mode> {
        match code {
            8 => Some(Mode::CyclicPosition),
            9 => Some(Mode::CyclicVelocity),
            10 => Some(Mode::CyclicTorque),
            _ => None,
        }
    }

    /// The standard's name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Mode::CyclicPosition => "cyclic synchronous position",
            Mode::CyclicVelocity => "cyclic synchronous velocity",
            Mode::CyclicTorque => "cyclic synchronous torque",
        }
    }

    /// Whether a drive whose object 6502 has this value knows the mode: bit 7 stands for position,
    /// 8 for velocity, 9 for torque.
    #[must_use]
    pub const fn is_supported(self, supported_modes: u32) -> bool {
        supported_modes & (1 << (self.code() as u32 - 1)) != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_of_a_byte_is_one_mode_or_none() {
        for code in i8::MIN..=i8::MAX {
            let mode = Mode::from_code(code);
            assert_eq!(mode.is_some(), (8..=10).contains(&code), "{code}");
            assert!(mode.is_none_or(|mode| mode.code() == code));
        }
    }

    #[test]
    fn supported_modes_are_bits_seven_to_nine() {
        for (index, mode) in Mode::ALL.into_iter().enumerate() {
            let bits: Vec<usize> = (0..32).filter(|bit| mode.is_supported(1 << bit)).collect();
            assert_eq!(bits, [index + 7], "{mode:?}");
        }
    }
}
