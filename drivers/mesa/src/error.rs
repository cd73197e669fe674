//! Why a card could not be opened, with the card, the cause and a remedy. Once a card is open its
//! halves answer with [`taktil_hal::Error`] instead.

use std::fmt;

use taktil_hal::Invalid;

/// Why a card could not be opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OpenError {
    /// The config is refused.
    Invalid(Invalid),
    /// What answers at the address is not a card that can be used, or nothing answers.
    Device {
        /// The address as configured.
        address: String,
        /// The place in the config that a message should point at.
        place: &'static str,
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
}

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
        OpenError::Device { address: address.to_owned(), place, what, remedy }
    }
}

impl OpenError {
    /// The dotted path inside [`Config`](crate::Config) that a message should point at.
    #[must_use]
    pub fn place(&self) -> &str {
        match self {
            OpenError::Invalid(invalid) => &invalid.place,
            OpenError::Device { place, .. } => place,
        }
    }
}

impl From<Invalid> for OpenError {
    fn from(invalid: Invalid) -> OpenError {
        OpenError::Invalid(invalid)
    }
}

impl fmt::Display for OpenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            OpenError::Invalid(invalid) => invalid.fmt(f),
            OpenError::Device { address, what, remedy, .. } => {
                write!(f, "{address}: {what}; {remedy}")
            }
        }
    }
}

impl std::error::Error for OpenError {}
