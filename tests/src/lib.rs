//! What is true of the whole house stands in this crate's tests; this library holds only what more
//! than one of them needs. Refuses product code: nothing imports it.

use std::path::{Path, PathBuf};

pub mod bench;

/// The root of the repository.
///
/// # Panics
/// When the crate stands at the root of a file system.
#[must_use]
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests/ has a parent").to_path_buf()
}
