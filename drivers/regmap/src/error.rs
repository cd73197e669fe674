//! The error of a board that could not be opened, with the place in the config and a remedy. Once a
//! board is open, its halves return [`taktil_hal::Error`] instead.

use std::fmt;
use std::path::{Path, PathBuf};

use taktil_hal::Invalid;

/// Why a board could not be opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OpenError {
    /// The config is refused.
    Invalid(Invalid),
    /// The file or device behind the path is not a board that can be used.
    Device {
        /// The path as configured.
        path: PathBuf,
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
}

impl OpenError {
    pub(crate) fn device(path: &Path, what: impl Into<String>, remedy: &str) -> OpenError {
        OpenError::Device { path: path.to_owned(), what: what.into(), remedy: remedy.to_owned() }
    }

    /// The dotted path inside [`Config`](crate::Config) that a message should point at.
    #[must_use]
    pub fn place(&self) -> &str {
        match self {
            OpenError::Invalid(invalid) => &invalid.place,
            OpenError::Device { .. } => "path",
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
            OpenError::Device { path, what, remedy } => {
                write!(f, "{}: {what}; {remedy}", path.display())
            }
        }
    }
}

impl std::error::Error for OpenError {}
