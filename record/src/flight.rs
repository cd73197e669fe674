//! The flight recorder of an application: the place of its file, the text that explains it, and
//! what the kernel granted.
//!
//! A recording is made as `FILE.starting` and gets its name when the first job has run: a start
//! that fails leaves no trace. What was at `FILE` becomes `FILE.previous` then. One that its
//! process ended itself does not displace one of a process that was killed: of these the newest is
//! kept.

mod description;

use std::fs::File;
use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use nix::unistd::geteuid;
use serde::Deserialize;
use taktil_rtcore::flight::{GrantWriter, record};
use taktil_rtcore::linux::wall_clock;
use taktil_rtcore::live::Attestation;
use taktil_rtcore::{Invalid, Machine, Nanos};

use crate::file::own_contents;

pub use self::description::{
    FieldDescription, FlightGrants, LaneDescription, MachineDescription, SignalDescription,
};

/// The service's folder in memory.
const SERVICE_FOLDER: &str = "/run/taktil";
/// The folder where that one does not exist; everybody may put files there.
const FALLBACK_FOLDER: &str = "/dev/shm";
/// Names that are tried in the folder of everybody.
const FALLBACK_NAMES_MAX: u32 = 64;

/// `[flight]` of the service's configuration.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlightConfig {
    /// Whether anything is recorded. Default true.
    pub enabled: bool,
    /// A file in memory. Default `/run/taktil/flight`, or `/dev/shm/taktild.flight` where there is
    /// no `/run/taktil`; with a number when another user has put a file there.
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
        let own = || match folder.is_dir() {
            true => folder.join("flight"),
            false => free_place(Path::new(FALLBACK_FOLDER)),
        };
        self.path.clone().unwrap_or_else(own)
    }
}

/// The first place in a folder of everybody that no other user occupies: nobody keeps the service
/// from starting by a file of that name. The first one of all when each is occupied.
fn free_place(folder: &Path) -> PathBuf {
    let user = geteuid().as_raw();
    let is_free = |place: &PathBuf| {
        ["", ".starting", ".previous"].iter().all(|ending| {
            match std::fs::symlink_metadata(with_ending(place, ending)) {
                Ok(about) => about.uid() == user && about.is_file(),
                Err(error) => error.kind() == ErrorKind::NotFound,
            }
        })
    };
    let name = |number: u32| match number {
        0 => folder.join("taktild.flight"),
        number => folder.join(format!("taktild-{number}.flight")),
    };
    (0..FALLBACK_NAMES_MAX).map(name).find(is_free).unwrap_or_else(|| name(0))
}

/// Writes what a flight recorder's file says about the run beside the records. Dropping it says
/// that the process ended the recording itself.
pub struct FlightRecorderWriter {
    notebook: GrantWriter,
    grants: Option<FlightGrants>,
    wall_time_written: bool,
    starting: Option<StartingFile>,
    failure: Option<String>,
}

/// A file that has not got its name yet, and the one that has it.
struct StartingFile {
    place: PathBuf,
    path: PathBuf,
    current: Option<OldFile>,
}

/// A recording of an earlier process, locked.
struct OldFile {
    _lock: File,
    has_jobs: bool,
    /// Its process was killed.
    is_evidence: bool,
}

impl FlightRecorderWriter {
    /// Starts recording a machine, with `texts` (configuration files, seed ...) for whoever reads
    /// it. The file gets its name with the first job.
    ///
    /// # Errors
    /// A file that cannot be had in memory, that another process writes, that belongs to another
    /// user or is none; seconds out of range; the place is `path` or `seconds`.
    pub fn start(
        machine: &mut Machine,
        path: &Path,
        seconds: f64,
        texts: &[(&str, &str)],
    ) -> Result<FlightRecorderWriter, Invalid> {
        let description = description::sorted_json(&MachineDescription::new(machine, texts));
        let place = with_ending(path, ".starting");
        let mut current = OldFile::at(path)?;
        OldFile::at(&with_ending(path, ".previous"))?;
        // A process that was killed before its file got its name.
        if OldFile::at(&place)?.is_some_and(|old| old.has_jobs) {
            give_name(&place, path, current.as_ref())
                .map_err(|what| Invalid::new("path", what, ANOTHER_FILE))?;
            current = OldFile::at(path)?;
        }
        let (recorder, notebook) = record(&place, machine.catalog(), seconds, &description)?;
        machine.attach_flight_recorder(recorder);
        let starting = Some(StartingFile { place, path: path.to_owned(), current });
        Ok(FlightRecorderWriter {
            notebook,
            grants: None,
            wall_time_written: false,
            starting,
            failure: None,
        })
    }

    /// Gives the file its name, once: to be called when the first job has run.
    pub fn publish(&mut self) {
        let Some(StartingFile { place, path, current }) = self.starting.take() else { return };
        self.failure = give_name(&place, &path, current.as_ref()).err();
    }

    /// Why the file could not get its name: then it is `FILE.starting` still.
    #[must_use]
    pub fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// Writes what the kernel granted.
    pub fn write_attestation(&mut self, attestation: &Attestation) {
        self.write_grants(FlightGrants::new(attestation));
    }

    /// Writes what the kernel granted, in short.
    pub fn write_grants(&mut self, grants: FlightGrants) {
        self.grants = Some(grants);
        self.update_grants();
    }

    /// Writes, once, the wall time of logical time zero; the lanes run, so that the file gets its
    /// name.
    pub fn write_wall_time(&mut self, now: Nanos) {
        self.publish();
        if core::mem::replace(&mut self.wall_time_written, true) {
            return;
        }
        if let Some(grants) = &mut self.grants {
            grants.zero_unix_ns = Some((wall_clock() - now).0);
        }
        self.update_grants();
    }

    fn update_grants(&mut self) {
        if let Some(grants) = &self.grants {
            self.notebook.write_granted(&description::sorted_json(grants));
        }
    }
}

impl Drop for FlightRecorderWriter {
    fn drop(&mut self) {
        if let Some(StartingFile { place, .. }) = self.starting.take() {
            let _ = std::fs::remove_file(place);
        }
        if let Some(grants) = &mut self.grants {
            grants.ended = true;
        }
        self.update_grants();
    }
}

/// What to do about a file that is in the way.
const ANOTHER_FILE: &str = "name another file, or take that one away";

impl OldFile {
    /// The recording at a path; `None` where there is nothing, or an empty file.
    fn at(path: &Path) -> Result<Option<OldFile>, Invalid> {
        let refuse = |what: String| Err(Invalid::new("path", what, ANOTHER_FILE));
        let shown = path.display();
        let (lock, bytes) = match own_contents(path) {
            Ok(Some((_, bytes))) if bytes.is_empty() => return Ok(None),
            Ok(Some(found)) => found,
            Ok(None) => return Ok(None),
            Err(why) => return refuse(format!("{shown} is there: {why:#}")),
        };
        let Ok(found) = taktil_rtcore::flight::read(&bytes) else {
            return refuse(format!("{shown} is there and is no flight recording"));
        };
        let has_jobs = found.lanes.iter().any(|lane| lane.records().next().is_some());
        let grants = serde_json::from_str::<FlightGrants>(&found.granted).unwrap_or_default();
        Ok(Some(OldFile { _lock: lock, has_jobs, is_evidence: has_jobs && !grants.ended }))
    }
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

/// Makes `place` the recording at `path`, and what was there the previous one if it is worth it.
fn give_name(place: &Path, path: &Path, current: Option<&OldFile>) -> Result<(), String> {
    let previous = with_ending(path, ".previous");
    let rename = |from: &Path, to: &Path| {
        std::fs::rename(from, to)
            .map_err(|why| format!("{} cannot become {}: {why}", from.display(), to.display()))
    };
    if let Some(current) = current.filter(|current| current.has_jobs) {
        let kept = OldFile::at(&previous).ok().flatten();
        if current.is_evidence || kept.is_none_or(|kept| !kept.is_evidence) {
            rename(path, &previous)?;
        }
    }
    rename(place, path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_somebody_else_has_put_there_keeps_no_service_from_starting() {
        let folder = std::env::temp_dir().join(format!("taktil-flight-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let first = folder.join("taktild.flight");
        assert_eq!(free_place(&folder), first);
        // A file of this user is that of a service before this one.
        std::fs::write(&first, "").unwrap();
        assert_eq!(free_place(&folder), first);
        // A link is nobody's recording, whoever made it, and neither is a folder.
        std::fs::remove_file(&first).unwrap();
        std::os::unix::fs::symlink("/etc/passwd", &first).unwrap();
        std::fs::create_dir(folder.join("taktild-1.flight.previous")).unwrap();
        assert_eq!(free_place(&folder), folder.join("taktild-2.flight"));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
