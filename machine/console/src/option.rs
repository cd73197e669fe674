//! The error of a command-line option that cannot be used, and the checks of files and folders that
//! an option names.

use std::fs::OpenOptions;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use nix::fcntl::OFlag;

/// An option of the command line that cannot be used.
#[derive(Debug)]
pub struct BadOption(pub String);

impl std::fmt::Display for BadOption {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for BadOption {}

/// Checks that a file can be written before the work whose result it is to hold. An existing file
/// keeps its content until then.
///
/// # Errors
/// [`BadOption`] with the option's name.
pub fn check_writable(option: &str, path: &Path) -> Result<(), BadOption> {
    // A pipe that nobody reads is refused instead of waited for.
    let mut options = OpenOptions::new();
    let opened = options.create(true).append(true).custom_flags(OFlag::O_NONBLOCK.bits());
    opened.open(path).map(drop).map_err(|error| {
        let shown = path.display();
        BadOption(format!("{option} {shown}: {error}; name a file that can be written"))
    })
}

/// Creates a folder before the work whose results it is to hold.
///
/// # Errors
/// [`BadOption`] with the option's name.
pub fn create_folder(option: &str, path: &Path) -> Result<(), BadOption> {
    std::fs::create_dir_all(path).map_err(|error| {
        let shown = path.display();
        BadOption(format!("{option} {shown}: {error}; name a folder that can be made"))
    })
}
