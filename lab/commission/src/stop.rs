//! The reason why a commissioning ended early, with what to do about it.

use std::fmt;

use taktil_hal::Error;

/// Why it was stopped; the outputs are safe by then.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stop {
    /// What was asked or seen.
    pub reason: String,
    /// What to do about it.
    pub remedy: String,
}

impl Stop {
    /// A reason with its remedy.
    pub fn new(reason: impl Into<String>, remedy: impl Into<String>) -> Stop {
        Stop { reason: reason.into(), remedy: remedy.into() }
    }

    pub(crate) fn of_device(error: &Error) -> Stop {
        Stop::new(
            error.to_string(),
            "look at the board's supply and cable; `taktil hal check` exercises it alone",
        )
    }
}

impl fmt::Display for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}; {}", self.reason, self.remedy)
    }
}

impl std::error::Error for Stop {}
