//! What is wrong with a segment that could not be opened. Once it is open its halves answer with
//! [`taktil_hal::Error`] instead.

use taktil_hal::OpenError;

/// A complaint about a segment whose interface is not known here.
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

    pub(crate) fn at(self, interface: &str) -> OpenError {
        let Unfit { place, what, remedy } = self;
        OpenError::device(interface, place, what, remedy)
    }
}
