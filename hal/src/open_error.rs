//! Why a device could not be opened, with the place in the configuration, the cause and the remedy.
//! Every driver answers with it, so that whoever opens devices by name treats all alike. Once a
//! device is open its halves answer with [`Error`](crate::Error) instead.

use core::fmt;

use crate::invalid::Invalid;

/// Why a device could not be opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OpenError {
    /// The configuration is refused, by itself or because the device lacks what it asks for.
    Invalid(Invalid),
    /// What is behind the path or address cannot be used, or is another device.
    Device {
        /// The path or address as configured.
        device: String,
        /// The key of the driver's section that a message should point at.
        place: &'static str,
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
}

impl OpenError {
    /// An error of the device behind a path or address.
    #[must_use]
    pub fn device(
        device: impl Into<String>,
        place: &'static str,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> OpenError {
        let (device, what, remedy) = (device.into(), what.into(), remedy.into());
        OpenError::Device { device, place, what, remedy }
    }

    /// The dotted path inside the driver's section that a message should point at.
    #[must_use]
    pub fn place(&self) -> &str {
        match self {
            OpenError::Invalid(invalid) => &invalid.place,
            OpenError::Device { place, .. } => place,
        }
    }

    /// The same as a complaint about the configuration. It does not name the device: the line that
    /// the place marks does.
    #[must_use]
    pub fn into_invalid(self) -> Invalid {
        match self {
            OpenError::Invalid(invalid) => invalid,
            OpenError::Device { place, what, remedy, .. } => Invalid::new(place, what, remedy),
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
            OpenError::Device { device, what, remedy, .. } => {
                write!(f, "{device}: {what}; {remedy}")
            }
        }
    }
}

impl std::error::Error for OpenError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_kinds_name_the_place_the_cause_and_the_remedy() {
        let device = OpenError::device("/dev/uio0", "path", "is in use", "end that process");
        assert_eq!(device.to_string(), "/dev/uio0: is in use; end that process");
        assert_eq!(device.place(), "path");
        let bad = Invalid::new("path", "is in use", "end that process");
        assert_eq!(device.into_invalid(), bad);
        let section = OpenError::from(bad.clone());
        assert_eq!((section.place(), section.to_string()), ("path", bad.to_string()));
        assert_eq!(section.into_invalid(), bad);
    }
}
