//! What more than one test of the whole repository needs. The tests themselves stand in
//! `tests/tests`. No product crate depends on this library.

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
