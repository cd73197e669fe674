//! Targets of the cyclic modes that never jump: before the drive follows, a target is the place
//! where the drive is, or zero; afterwards it moves by a bounded step at most.

use crate::status::Statusword;

/// The target of cyclic position mode (607A).
#[derive(Clone, Copy, Debug)]
pub struct PositionTarget {
    step_max_counts: u32,
    last: i32,
    refused: u32,
}

impl PositionTarget {
    /// Targets that move at most `step_max_counts` from one cycle to the next.
    #[must_use]
    pub const fn new(step_max_counts: u32) -> PositionTarget {
        PositionTarget { step_max_counts, last: 0, refused: 0 }
    }

    /// The target of this cycle. It is `actual` (6064) until operation is enabled and bit 12 is
    /// set. Afterwards it is `desired`, unless that lies too far from the target before: the old
    /// target stays then, and the refusal is counted. Positions wrap at the ends of `i32`.
    pub fn step(&mut self, status: Statusword, actual: i32, desired: i32) -> i32 {
        if !status.is_following() {
            self.last = actual;
        } else if desired.wrapping_sub(self.last).unsigned_abs() <= self.step_max_counts {
            self.last = desired;
        } else {
            self.refused = self.refused.saturating_add(1);
        }
        self.last
    }

    /// How many desired positions were refused.
    #[must_use]
    pub const fn refused(&self) -> u32 {
        self.refused
    }
}

/// The target of cyclic torque or velocity mode (6071 or 60FF).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CyclicTarget;

impl CyclicTarget {
    /// `desired` while operation is enabled and bit 12 is set, 0 otherwise.
    #[must_use]
    pub const fn torque(status: Statusword, desired: i16) -> i16 {
        if status.is_following() { desired } else { 0 }
    }

    /// `desired` while operation is enabled and bit 12 is set, 0 otherwise.
    #[must_use]
    pub const fn velocity(status: Statusword, desired: i32) -> i32 {
        if status.is_following() { desired } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Operation enabled, without and with bit 12.
    const ENABLED: [Statusword; 2] = [Statusword(0x0237), Statusword(0x1237)];

    #[test]
    fn the_target_is_the_actual_position_until_the_drive_follows() {
        let mut target = PositionTarget::new(100);
        for status in [0x0250, 0x0231, 0x0233, 0x1233, 0x0237, 0x0217, 0x1217, 0x0218] {
            assert_eq!(target.step(Statusword(status), 5000, -7), 5000, "{status:04x}");
        }
        assert_eq!(target.step(ENABLED[1], 5001, 5050), 5050);
        assert_eq!(target.step(ENABLED[1], 5001, 5151), 5050, "a jump is refused");
        assert_eq!((target.step(ENABLED[1], 5001, 5150), target.refused()), (5150, 1));
        assert_eq!(target.step(ENABLED[0], 5100, 5150), 5100, "the drive stopped following");
    }

    #[test]
    fn a_step_is_measured_across_the_end_of_the_range() {
        let mut target = PositionTarget::new(10);
        target.step(ENABLED[0], i32::MAX - 2, 0);
        assert_eq!(target.step(ENABLED[1], 0, i32::MIN + 5), i32::MIN + 5);
        assert_eq!(target.step(ENABLED[1], 0, i32::MAX - 20), i32::MIN + 5);
        let mut wide = PositionTarget::new(u32::MAX);
        assert_eq!(wide.step(ENABLED[1], 0, i32::MIN), i32::MIN);
    }

    #[test]
    fn torque_and_velocity_are_zero_until_the_drive_follows() {
        assert_eq!(ENABLED.map(|status| CyclicTarget::torque(status, -300)), [0, -300]);
        assert_eq!(ENABLED.map(|status| CyclicTarget::velocity(status, 70_000)), [0, 70_000]);
    }
}
