//! What is wrong with a card that could not be opened. Once a card is open its halves answer with
//! [`taktil_hal::Error`] instead.

use taktil_hal::OpenError;

/// A complaint about a card whose address is not known here.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Unfit {
    pub(crate) place: &'static str,
    pub(crate) what: String,
    pub(crate) remedy: String,
}

impl Unfit {
    pub(crate) fn new(
        place: &'static str,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Unfit {
        Unfit { place, what: what.into(), remedy: remedy.into() }
    }

    pub(crate) fn at(self, address: &str) -> OpenError {
        let Unfit { place, what, remedy } = self;
        OpenError::device(address, place, what, remedy)
    }
}
