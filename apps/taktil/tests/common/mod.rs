//! Folders that vanish, for tests of the library. Refuses to share one between tests.

use std::path::PathBuf;

/// A folder of one test, removed at its end.
pub(crate) struct Folder(pub(crate) PathBuf);

impl Folder {
    /// The name is the test's own.
    pub(crate) fn new(name: &str) -> Folder {
        let path = std::env::temp_dir().join(format!("taktil-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
