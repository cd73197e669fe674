//! Says why a board could not be opened, with the place in the configuration and a remedy. Once a
//! board is open its halves answer with [`taktil_hal::Error`] instead.

use nix::errno::Errno;
use taktil_hal::OpenError;

/// An error of the node behind a path.
pub(crate) fn device(path: &str, what: impl Into<String>, remedy: &str) -> OpenError {
    OpenError::device(path, "path", what, remedy)
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
    device(path, format!("{action} failed ({errno})"), remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_error_of_the_system_has_its_remedy() {
        let text = |action, errno| from_errno("/dev/comedi0", action, errno).to_string();
        assert!(text("opening", Errno::EACCES).contains("udev rule"));
        assert!(text("opening", Errno::EPERM).contains("GROUP="));
        assert!(text("locking subdevice 1", Errno::EBUSY).contains("another process"));
        assert!(text("setting up", Errno::EACCES).contains("another process"));
        assert!(text("opening", Errno::ENODEV).contains("no board is attached"));
        assert!(text("setting up", Errno::EINVAL).contains("does not support it"));
        assert!(text("setting up", Errno::EIO).contains("dmesg"));
    }
}
