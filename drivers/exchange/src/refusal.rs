//! What is wrong with a board that could not be opened. Once it is open its halves answer with
//! [`taktil_hal::Error`] instead.

use taktil_hal::OpenError;

/// A complaint about a board of which it is not known yet where it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// The key of the section.
    pub place: &'static str,
    /// What is wrong there.
    pub what: String,
    /// What to do about it.
    pub remedy: String,
}

impl Refusal {
    /// A complaint about the key `place`.
    #[must_use]
    pub fn new(place: &'static str, what: impl Into<String>, remedy: impl Into<String>) -> Refusal {
        Refusal { place, what: what.into(), remedy: remedy.into() }
    }

    /// The same about the board at `address`: an interface, or a network address.
    #[must_use]
    pub fn at(self, address: &str) -> OpenError {
        let Refusal { place, what, remedy } = self;
        OpenError::device(address, place, what, remedy)
    }
}
