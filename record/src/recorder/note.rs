//! The note beside a recording: who records there, and how the recording ended. Its writer keeps it
//! locked. It takes its room when the recording begins and is overwritten in place later, so that
//! it can be written on a disk that is full.

use std::fmt;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use taktil_rtcore::Invalid;
use taktil_rtcore::linux::wall_clock;

use crate::file::{lock, open_regular};

/// Bytes of the file: a block, filled up with spaces.
const NOTE_BYTES: usize = 4096;
/// Bytes of the longest text in it.
const TEXT_BYTES_MAX: usize = 1024;

/// How a recording ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    /// It was closed.
    Finished,
    /// Nobody closed it: its process was killed, or the power went.
    Recording,
    /// The disk had no room any more.
    DiskFull,
    /// The disk refused a write.
    Failed,
}

/// What is known of the recording before this one at the same path.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PreviousRecording {
    /// How it ended.
    pub ending: Ending,
    /// Its newest file, as it was named then.
    pub file: PathBuf,
    /// Number of its process.
    pub process: u32,
    /// When this was noted (s since 1970).
    pub unix_s: i64,
    /// The cause in words; empty when there is nothing to say.
    pub text: String,
}

impl fmt::Display for PreviousRecording {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let file = self.file.display();
        match self.ending {
            Ending::Finished => write!(f, "the recording before this one, {file}, was closed"),
            Ending::Recording => write!(
                f,
                "the recording before this one, {file}, was not closed: process {} was killed, or \
                 the power went; `taktil postmortem` joins it with the flight recorder",
                self.process
            ),
            Ending::DiskFull => write!(
                f,
                "the recording before this one, {file}, ended by a full disk: {}",
                self.text
            ),
            Ending::Failed => {
                write!(
                    f,
                    "the recording before this one, {file}, ended by a failure: {}",
                    self.text
                )
            }
        }
    }
}

/// The file, locked for this process.
pub(super) struct Note {
    file: File,
}

impl Note {
    /// Locks the note of the log at `path` and reads it. It is made where there is none.
    ///
    /// # Errors
    /// Another process records there, or the folder takes no file; the place is `path`.
    pub(super) fn take(path: &Path) -> Result<(Note, Option<PreviousRecording>), Invalid> {
        let mut name = path.as_os_str().to_owned();
        name.push(".state");
        let place = PathBuf::from(name);
        let shown = place.display();
        let file = open_regular(&place).map_err(|error| {
            let what = format!("{shown} cannot be written: {error:#}");
            Invalid::new("path", what, "name a file in a folder of this user")
        })?;
        if lock(&file).is_err() {
            let what = format!("another process records to {}", path.display());
            return Err(Invalid::new("path", what, "name another file, or end that process"));
        }
        let mut bytes = vec![0; NOTE_BYTES];
        let length = file.read_at(&mut bytes, 0).unwrap_or(0);
        let previous = serde_json::from_slice(bytes[..length].trim_ascii()).ok();
        Ok((Note { file }, previous))
    }

    /// Writes down how the recording stands. What fails is not reported: the log says it as well.
    pub(super) fn write(&mut self, ending: Ending, file: &Path, text: &str) {
        let cut = text.floor_char_boundary(TEXT_BYTES_MAX);
        let note = PreviousRecording {
            ending,
            file: file.to_owned(),
            process: std::process::id(),
            unix_s: wall_clock().0 / 1_000_000_000,
            text: text[..cut].to_owned(),
        };
        let mut bytes = serde_json::to_vec(&note).unwrap_or_default();
        if bytes.len() >= NOTE_BYTES {
            return;
        }
        bytes.resize(NOTE_BYTES - 1, b' ');
        bytes.push(b'\n');
        let _ = self.file.write_all_at(&bytes, 0);
    }
}
