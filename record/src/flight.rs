//! The flight recorder of an application: the place of its file, the text that explains it, and
//! what the kernel granted. A recording that is already there is renamed, never overwritten.

mod description;

use std::path::{Path, PathBuf};

use serde::Deserialize;
use taktil_rtcore::flight::{GrantWriter, record};
use taktil_rtcore::linux::wall_clock;
use taktil_rtcore::live::Attestation;
use taktil_rtcore::{Invalid, Machine, Nanos};

pub use self::description::{
    FieldDescription, FlightGrants, LaneDescription, MachineDescription, SignalDescription,
};

/// The service's folder in memory.
const SERVICE_FOLDER: &str = "/run/taktil";
/// The file where that folder does not exist.
const FALLBACK_PATH: &str = "/dev/shm/taktild.flight";

/// `[flight]` of the service's configuration.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlightConfig {
    /// Whether anything is recorded. Default true.
    pub enabled: bool,
    /// A file in memory. Default `/run/taktil/flight`, or `/dev/shm/taktild.flight` where there is
    /// no `/run/taktil`.
    pub path: Option<PathBuf>,
    /// How much of the past is kept, s. Default 10.
    pub seconds: f64,
}

/// Duration that is kept unless the configuration gives another (s).
pub const DURATION_DEFAULT_S: f64 = 10.0;

impl Default for FlightConfig {
    fn default() -> FlightConfig {
        FlightConfig { enabled: true, path: None, seconds: DURATION_DEFAULT_S }
    }
}

impl FlightConfig {
    /// Where the file goes.
    #[must_use]
    pub fn place(&self) -> PathBuf {
        let folder = Path::new(SERVICE_FOLDER);
        let own = || if folder.is_dir() { folder.join("flight") } else { FALLBACK_PATH.into() };
        self.path.clone().unwrap_or_else(own)
    }
}

/// Writes what a flight recorder's file says about the run beside the records.
pub struct FlightRecorderWriter {
    notebook: GrantWriter,
    grants: Option<FlightGrants>,
    wall_time_written: bool,
}

impl FlightRecorderWriter {
    /// Starts recording a machine, with `texts` (configuration files, seed ...) for whoever reads
    /// it. A recording that is there already becomes `FILE.previous`.
    ///
    /// # Errors
    /// A file that cannot be had in memory, seconds out of range; the place is `path` or `seconds`.
    pub fn start(
        machine: &mut Machine,
        path: &Path,
        seconds: f64,
        texts: &[(&str, &str)],
    ) -> Result<FlightRecorderWriter, Invalid> {
        let description = description::sorted_json(&MachineDescription::new(machine, texts));
        let mut previous = path.as_os_str().to_owned();
        previous.push(".previous");
        set_aside(path, Path::new(&previous))?;
        let (recorder, notebook) = record(path, machine.catalog(), seconds, &description)?;
        machine.attach_flight_recorder(recorder);
        Ok(FlightRecorderWriter { notebook, grants: None, wall_time_written: false })
    }

    /// Writes what the kernel granted.
    pub fn write_attestation(&mut self, attestation: &Attestation) {
        self.grants = Some(FlightGrants::new(attestation));
        self.write_grants();
    }

    /// Writes, once, the wall time of logical time zero.
    pub fn write_wall_time(&mut self, now: Nanos) {
        if core::mem::replace(&mut self.wall_time_written, true) {
            return;
        }
        if let Some(grants) = &mut self.grants {
            grants.zero_unix_ns = Some((wall_clock() - now).0);
        }
        self.write_grants();
    }

    fn write_grants(&mut self) {
        if let Some(grants) = &self.grants {
            self.notebook.write_granted(&description::sorted_json(grants));
        }
    }
}

/// Renames an existing recording. A file that is no recording is an error and stays untouched.
fn set_aside(path: &Path, previous: &Path) -> Result<(), Invalid> {
    let another = "name another file, or take that one away";
    let refuse = |what: String| Err(Invalid::new("path", what, another));
    let bytes = match std::fs::read(path) {
        Ok(bytes) if bytes.is_empty() => return Ok(()),
        Ok(bytes) => bytes,
        Err(why) if why.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(why) => return refuse(format!("{} cannot be read: {why}", path.display())),
    };
    if taktil_rtcore::flight::read(&bytes).is_err() {
        return refuse(format!("{} is there and is no flight recording", path.display()));
    }
    std::fs::rename(path, previous).or_else(|why| {
        refuse(format!("{} cannot become {}: {why}", path.display(), previous.display()))
    })
}
