//! Why a board could not be opened. Once a board is open its halves answer with
//! [`taktil_hal::Error`] instead.

use std::path::Path;

use taktil_hal::OpenError;

/// An error of the file or device behind a path.
pub(crate) fn device(path: &Path, what: impl Into<String>, remedy: &str) -> OpenError {
    OpenError::device(path.display().to_string(), "path", what, remedy)
}
