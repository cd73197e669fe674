//! The section `[log]` of a configuration: where a machine is recorded and how much of it is kept.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use taktil_rtcore::{Invalid, Nanos};

/// Bytes of a megabyte as people and disks count it.
const MEGABYTE_BYTES: u64 = 1_000_000;

/// `[log]` of the service's configuration.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogConfig {
    /// MCAP file, relative to the configuration: the newest recording. Older ones lie beside it,
    /// named after the instant of their end.
    pub path: PathBuf,
    /// A file is closed and the next one begun at this size (MB). Default 256.
    #[serde(default = "rotate_mb")]
    pub rotate_mb: u64,
    /// A file is closed after this time of the machine (s); never for that reason when absent.
    pub rotate_s: Option<f64>,
    /// All recordings of this path together (MB). Default 4096. The oldest are deleted first; those
    /// of the four newest crashes and the file before each of them are kept whatever it says.
    #[serde(default = "budget_mb")]
    pub budget_mb: u64,
    /// Recording stops, and says so, when the disk has less room than this (MB). Default 64.
    #[serde(default = "free_mb")]
    pub free_mb: u64,
    /// Memory in front of the disk (MB). Default 8: some seconds of a slow disk.
    #[serde(default = "queue_mb")]
    pub queue_mb: u64,
    /// Joints, frames, tactile images and bodies stand in the recording a second time, as common
    /// viewers draw them, with a description of the robot; all times are those of the wall clock.
    /// Default false.
    #[serde(default)]
    pub viewer: bool,
}

fn rotate_mb() -> u64 {
    256
}

fn budget_mb() -> u64 {
    4096
}

fn free_mb() -> u64 {
    64
}

fn queue_mb() -> u64 {
    8
}

/// Where a machine is recorded and how much of it is kept, in units of the program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordingOptions {
    /// The newest recording.
    pub path: PathBuf,
    /// Size at which a file is closed.
    pub rotate_bytes: u64,
    /// Logical time after which a file is closed.
    pub rotate_after: Option<Nanos>,
    /// Size of all files together.
    pub budget_bytes: u64,
    /// Room that the disk must have.
    pub free_bytes: u64,
    /// Size of the queue.
    pub queue_bytes: usize,
}

impl LogConfig {
    /// The section that holds a path and nothing else.
    #[must_use]
    pub fn at(path: PathBuf) -> LogConfig {
        LogConfig {
            path,
            rotate_mb: rotate_mb(),
            rotate_s: None,
            budget_mb: budget_mb(),
            free_mb: free_mb(),
            queue_mb: queue_mb(),
            viewer: false,
        }
    }

    /// The options of a recorder; `folder` is that of the configuration.
    ///
    /// # Errors
    /// A number out of its range; the place is its key.
    pub fn options(&self, folder: &Path) -> Result<RecordingOptions, Invalid> {
        let check = |key: &'static str, value: u64, least: u64, most: u64| {
            if (least..=most).contains(&value) {
                return Ok(value);
            }
            let what = format!("{value} MB is out of range");
            Err(Invalid::new(key, what, format!("give {least} to {most}")))
        };
        let rotate_mb = check("rotate_mb", self.rotate_mb, 1, 1_000_000)?;
        // One file is written while the one before it is there still.
        let budget_mb = check("budget_mb", self.budget_mb, 2 * rotate_mb, 1_000_000_000)?;
        let free_mb = check("free_mb", self.free_mb, 0, 1_000_000_000)?;
        let queue_mb = check("queue_mb", self.queue_mb, 1, 1024)?;
        if let Some(seconds) = self.rotate_s
            && !(1.0..=1e9).contains(&seconds)
        {
            let what = format!("{seconds} s is out of range");
            return Err(Invalid::new("rotate_s", what, "give 1 to 1e9, or leave it out"));
        }
        Ok(RecordingOptions {
            path: folder.join(&self.path),
            rotate_bytes: rotate_mb * MEGABYTE_BYTES,
            #[expect(clippy::cast_possible_truncation, reason = "at most 1e9 s")]
            rotate_after: self.rotate_s.map(|seconds| Nanos((seconds * 1e9) as i64)),
            budget_bytes: budget_mb * MEGABYTE_BYTES,
            free_bytes: free_mb * MEGABYTE_BYTES,
            queue_bytes: usize::try_from(queue_mb * MEGABYTE_BYTES).unwrap_or(usize::MAX),
        })
    }
}
