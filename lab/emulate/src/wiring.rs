//! How the emulated cabinet is wired: which terminal of the 7I77 carries which line, and what volts
//! at an amplifier's input mean. A machine file that is to drive it says the same.

use taktil_hal::{LinesIn, LinesOut};

/// Volts at which an amplifier gives its full-scale current.
const FULL_SCALE_V: f64 = 10.0;

/// Which field terminals of the 7I77 carry which lines. Motor n and its encoder are at channel n,
/// from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CardWiring {
    /// Output: the drives may put current into the motors.
    pub enable: u32,
    /// Output: the brakes are lifted.
    pub brake_release: u32,
    /// Output: the line that a relay watches; `None` where no relay does.
    pub watchdog_feed: Option<u32>,
    /// Input: the drives' supply is on.
    pub drive_power: u32,
    /// Input: channel A of the emergency-stop chain is closed.
    pub estop_a: u32,
    /// Input: channel B of the emergency-stop chain is closed.
    pub estop_b: u32,
}

impl CardWiring {
    /// The cabinet that is emulated: outputs 0, 1 and 2, inputs 0, 1 and 2, none inverted.
    pub const STANDARD: CardWiring = CardWiring {
        enable: 0,
        brake_release: 1,
        watchdog_feed: Some(2),
        drive_power: 0,
        estop_a: 1,
        estop_b: 2,
    };

    /// The lines at the output terminals `field`; the feed line stays where no relay watches it.
    pub(crate) fn lines_out(&self, field: u16, feed: bool) -> LinesOut {
        let is_on = |terminal: u32| u32::from(field).checked_shr(terminal).unwrap_or(0) & 1 == 1;
        LinesOut {
            enable: is_on(self.enable),
            brake_release: is_on(self.brake_release),
            watchdog_feed: self.watchdog_feed.map_or(feed, is_on),
        }
    }

    /// The word of the input terminals for these lines.
    pub(crate) fn field_inputs(&self, lines: LinesIn) -> u32 {
        let bit = |on: bool, terminal: u32| u32::from(on).checked_shl(terminal).unwrap_or(0);
        bit(lines.drive_power, self.drive_power)
            | bit(lines.estop_a_closed, self.estop_a)
            | bit(lines.estop_b_closed, self.estop_b)
    }
}

/// The code of the simulated converters for these volts: `full_codes` of them are the full-scale
/// current. 0 for NaN.
pub(crate) fn code_of_volts(volts: f64, full_codes: f64) -> i32 {
    #[expect(clippy::cast_possible_truncation, reason = "saturation is intended")]
    let code = (volts / FULL_SCALE_V * full_codes).round() as i32;
    code
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_of_twelve_bits_passes_through_the_thirteen_of_the_card() {
        for code in -2_048..=2_047 {
            let wire = 2 * code;
            let scale = if wire < 0 { 4_096.0 } else { 4_095.0 };
            let volts = 10.0 * f64::from(wire) / scale;
            assert_eq!(code_of_volts(volts, 2_048.0), code);
        }
        assert_eq!(code_of_volts(f64::NAN, 2_048.0), 0);
    }

    #[test]
    fn lines_stand_at_their_terminals() {
        let wiring = CardWiring::STANDARD;
        let lines = wiring.lines_out(0b101, false);
        assert_eq!((lines.enable, lines.brake_release, lines.watchdog_feed), (true, false, true));
        let without = CardWiring { watchdog_feed: None, ..wiring };
        assert!(without.lines_out(0, true).watchdog_feed);
        let lines = LinesIn { drive_power: true, estop_a_closed: false, estop_b_closed: true };
        assert_eq!(wiring.field_inputs(lines), 0b101);
    }
}
