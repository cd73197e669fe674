//! The suite that every implementor of the device traits passes: it drives a half through its trait
//! and lists the promises that it broke. It allocates text, so it must not run on a lane; and it
//! cannot see what is wired behind an output except through an observer that the caller lends it.
//!
//! **Never on a powered robot**: the output checks drive every channel over its whole range.
//!
//! ```
//! # use taktil_hal::{Error, ForceTorque, GaugeCodes, Nanos, Reading};
//! use taktil_hal::conformance::{CycleDriver, check_force_torque};
//!
//! struct Idle;
//! impl ForceTorque for Idle {
//!     fn sample(&mut self, release: Nanos) -> Result<Reading<GaugeCodes>, Error> {
//!         Ok(Reading { value: GaugeCodes::default(), acquired: release })
//!     }
//! }
//! assert_eq!(check_force_torque(&mut Idle, &mut CycleDriver::stationary()), []);
//! ```

use std::fmt;

use crate::devices::Devices;
use crate::error::{Error, ErrorKind};
use crate::time::Nanos;

mod drives;
mod inputs;
mod outputs;
#[cfg(test)]
mod tests;

pub use drives::{check_drive_out, check_drive_out_drop, check_drive_out_observed};
pub use inputs::{
    check_analog_in, check_board_clock, check_digital_in, check_drive_in, check_encoders,
    check_force_torque, check_tactile,
};
pub use outputs::{
    check_analog_out, check_analog_out_drop, check_analog_out_observed, check_digital_out,
    check_digital_out_drop, check_digital_out_observed,
};

/// A promise that a half broke.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// The promise, by a fixed name such as `"range-refused"`.
    pub rule: &'static str,
    /// What was seen and what was due.
    pub text: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.rule, self.text)
    }
}

/// The cycle in which a half is exercised: releases one period apart, and whatever must move on
/// before each of them. Releases never run backwards, also from one check to the next.
pub struct CycleDriver<'a> {
    next: Nanos,
    period: Nanos,
    cycles: usize,
    advance: Box<dyn FnMut(Nanos) + 'a>,
}

impl<'a> CycleDriver<'a> {
    /// Cycles of a check by default.
    pub const DEFAULT_CYCLES: usize = 40;

    /// A driver for a device that nothing has to advance: cycles of 2.5 ms from time zero.
    #[must_use]
    pub fn stationary() -> CycleDriver<'a> {
        CycleDriver::new(Nanos::ZERO, Nanos::from_micros(2_500), |_| {})
    }

    /// A driver whose first release is `first`. `advance` is called with each release before the
    /// half is, and moves a simulated world or a model of the board up to that instant.
    ///
    /// # Panics
    /// When `period` is not positive.
    #[must_use]
    pub fn new(first: Nanos, period: Nanos, advance: impl FnMut(Nanos) + 'a) -> CycleDriver<'a> {
        assert!(period > Nanos::ZERO, "a bench needs a positive period, not {period}");
        CycleDriver {
            next: first,
            period,
            cycles: CycleDriver::DEFAULT_CYCLES,
            advance: Box::new(advance),
        }
    }

    /// The same driver with `cycles` cycles a check, at least 2.
    #[must_use]
    pub fn with_cycles(mut self, cycles: usize) -> CycleDriver<'a> {
        self.cycles = cycles.max(2);
        self
    }

    /// How many cycles an input check takes.
    #[must_use]
    pub fn cycles(&self) -> usize {
        self.cycles
    }

    /// Moves everything to the next release and returns it.
    pub fn release(&mut self) -> Nanos {
        let release = self.next;
        self.next += self.period;
        (self.advance)(release);
        release
    }
}

impl fmt::Debug for CycleDriver<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Bench")
            .field("next", &self.next)
            .field("period", &self.period)
            .field("cycles", &self.cycles)
            .finish_non_exhaustive()
    }
}

/// Exercises all halves that there are: the inputs side by side in the same cycles, then each
/// output, which is left at its safe value.
pub fn check_devices(devices: &mut Devices, bench: &mut CycleDriver<'_>) -> Vec<Violation> {
    let mut found = inputs::check_together(devices, bench);
    if let Some(half) = &mut devices.analog_out {
        found.extend(check_analog_out(half.as_mut(), bench));
    }
    if let Some(half) = &mut devices.drive_out {
        found.extend(check_drive_out(half.as_mut(), bench));
    }
    if let Some(half) = &mut devices.digital_out {
        found.extend(check_digital_out(half.as_mut(), bench));
    }
    found
}

/// Collects violations, the first one of each rule.
#[derive(Debug, Default)]
struct Report {
    found: Vec<Violation>,
}

impl Report {
    fn add(&mut self, rule: &'static str, text: String) {
        if self.found.iter().all(|known| known.rule != rule) {
            self.found.push(Violation { rule, text });
        }
    }

    fn require(&mut self, kept: bool, rule: &'static str, text: impl FnOnce() -> String) {
        if !kept {
            self.add(rule, text());
        }
    }

    fn error(&mut self, error: &Error) {
        self.require(!error.device.is_empty(), "error-names-device", || {
            format!("an error ({error}) does not name its device")
        });
    }

    /// A word outside the range of its channel is refused, and the refusal names the channel.
    fn refusal(&mut self, channel: usize, word: impl fmt::Display, answer: Result<(), Error>) {
        match answer {
            Err(error) if error.kind == ErrorKind::OutOfRange => {
                self.error(&error);
                let named = usize::from(error.channel) == channel;
                self.require(named, "refusal-names-channel", || {
                    format!("channel {channel} was out of range, \"{error}\" came back")
                });
            }
            other => self.add(
                "range-refused",
                format!("{word} on channel {channel}: OutOfRange is due, not {other:?}"),
            ),
        }
    }
}
