//! Starts the program waits for it, in and removes the folders of the tests. No process is left
//! behind.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// The program under test.
pub(crate) const TAKTIL: &str = env!("CARGO_BIN_EXE_taktil");

/// The scenes of the repository.
pub(crate) fn scenes() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes").canonicalize().unwrap()
}

/// A folder of one test, removed at its end.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new() -> Folder {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("taktil-cli-{}-{number}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).unwrap();
        Folder(path.canonicalize().unwrap())
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    pub(crate) fn join(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Writes a file and gives its path.
    pub(crate) fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    /// All files in it with their sizes, in order.
    pub(crate) fn listing(&self) -> Vec<(String, u64)> {
        let entries = std::fs::read_dir(&self.0).unwrap().map(|entry| {
            let entry = entry.unwrap();
            (entry.file_name().to_string_lossy().into_owned(), entry.metadata().unwrap().len())
        });
        let mut entries: Vec<_> = entries.collect();
        entries.sort();
        entries
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Exit code and output of a finished process.
pub(crate) struct ProcessOutput {
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

impl ProcessOutput {
    pub(crate) fn of(output: &Output) -> ProcessOutput {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let said = ProcessOutput {
            code: output.status.code(),
            out: text(&output.stdout),
            err: text(&output.stderr),
        };
        for word in ["panicked at", "RUST_BACKTRACE", ".rs:"] {
            assert!(!said.err.contains(word), "a panic or a place in the program:\n{}", said.err);
        }
        said
    }

    /// Panics with the output unless the exit code is this one.
    pub(crate) fn expect_code(self, code: i32) -> ProcessOutput {
        assert_eq!(self.code, Some(code), "stdout:\n{}\nstderr:\n{}", self.out, self.err);
        self
    }
}

/// Runs the program to its end with arguments, in a folder.
pub(crate) fn taktil(folder: &Path, arguments: &[&str]) -> ProcessOutput {
    let mut command = Command::new(TAKTIL);
    command.args(arguments).current_dir(folder).stdin(Stdio::null());
    ProcessOutput::of(&command.output().unwrap())
}

/// A process that is killed when its test ends.
pub(crate) struct Running(pub(crate) Child);

impl Running {
    /// Waits for the end of the process with a time limit.
    pub(crate) fn wait(&mut self) -> ExitStatus {
        for _ in 0..3_000 {
            if let Some(status) = self.0.try_wait().unwrap() {
                return status;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("the process does not end");
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
