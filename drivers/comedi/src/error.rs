//! Says why a board could not be opened, with the place in the configuration and a remedy. Once a
//! board is open its halves answer with [`taktil_hal::Error`] instead.

use std::fmt;

use nix::errno::Errno;
use taktil_hal::Invalid;

/// Why a board could not be opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OpenError {
    /// The configuration is refused, by itself or because the board does not have what it asks for.
    Invalid(Invalid),
    /// The node cannot be used.
    Device {
        /// The path as configured.
        path: String,
        /// What is wrong.
        what: String,
        /// What to do about it.
        remedy: String,
    },
}

impl OpenError {
    pub(crate) fn device(path: &str, what: impl Into<String>, remedy: &str) -> OpenError {
        OpenError::Device { path: path.to_owned(), what: what.into(), remedy: remedy.to_owned() }
    }

    /// The error of a call of the system while `action` was done.
    pub(crate) fn from_errno(path: &str, action: &str, errno: Errno) -> OpenError {
        let remedy = match errno {
            Errno::EACCES | Errno::EPERM if action == "opening" => {
                "give the service's group the node with a udev rule such as \
                 `KERNEL==\"comedi[0-9]*\", GROUP=\"taktil\", MODE=\"0660\"`, or run as that group"
            }
            Errno::EPERM => "the call needs a right that this user does not have: run as root once",
            Errno::EACCES | Errno::EBUSY => {
                "another process has locked or uses it: stop that process first"
            }
            Errno::ENODEV | Errno::ENXIO => {
                "no board is attached to this node: load its kernel driver, or configure a legacy \
                 board with `comedi_config`; after unplugging, open the node again"
            }
            Errno::EINVAL => "the board's kernel driver does not support it: correct the section",
            _ => "check board, cable and the kernel's messages (`dmesg`)",
        };
        OpenError::device(path, format!("{action} failed ({errno})"), remedy)
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
            OpenError::Device { path, what, remedy } => write!(f, "{path}: {what}; {remedy}"),
        }
    }
}

impl std::error::Error for OpenError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_error_of_the_system_has_its_remedy() {
        let text = |action, errno| OpenError::from_errno("/dev/comedi0", action, errno).to_string();
        assert!(text("opening", Errno::EACCES).contains("udev rule"));
        assert!(text("opening", Errno::EPERM).contains("GROUP="));
        assert!(text("locking subdevice 1", Errno::EBUSY).contains("another process"));
        assert!(text("setting up", Errno::EACCES).contains("another process"));
        assert!(text("opening", Errno::ENODEV).contains("no board is attached"));
        assert!(text("setting up", Errno::EINVAL).contains("does not support it"));
        assert!(text("setting up", Errno::EIO).contains("dmesg"));
    }
}
