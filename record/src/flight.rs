//! The flight recorder of an application: the place of its file, the text that explains it, and
//! what the kernel granted. A recording that is already there is renamed, never overwritten.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::{Value, json};
use taktil_rtcore::flight::{GrantWriter, record};
use taktil_rtcore::linux::wall_clock;
use taktil_rtcore::live::Attestation;
use taktil_rtcore::{Invalid, Machine, Nanos};

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
    attestation: Value,
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
        let description = machine_description(machine, texts).to_string();
        let mut previous = path.as_os_str().to_owned();
        previous.push(".previous");
        set_aside(path, Path::new(&previous))?;
        let (recorder, notebook) = record(path, machine.catalog(), seconds, &description)?;
        machine.attach_flight_recorder(recorder);
        Ok(FlightRecorderWriter { notebook, attestation: Value::Null, wall_time_written: false })
    }

    /// Writes what the kernel granted.
    pub fn write_attestation(&mut self, attestation: &Attestation) {
        let words = |short: &taktil_rtcore::contract::Shortfall| short.to_string();
        self.attestation = json!({
            "granted": attestation.is_granted(),
            "shortfalls": attestation.shortfalls.iter().map(words).collect::<Vec<_>>(),
            "notes": attestation.notes,
            "preempt_rt": attestation.preempt_rt,
            "virtual_machine": attestation.virtual_machine,
        });
        self.notebook.write_granted(&self.attestation.to_string());
    }

    /// Writes, once, the wall time of logical time zero.
    pub fn write_wall_time(&mut self, now: Nanos) {
        if !core::mem::replace(&mut self.wall_time_written, true) && self.attestation.is_object() {
            self.attestation["zero_unix_ns"] = json!((wall_clock() - now).0);
            self.notebook.write_granted(&self.attestation.to_string());
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

/// Describes the machine for a reader that does not have the program that ran it.
fn machine_description(machine: &Machine, texts: &[(&str, &str)]) -> Value {
    let catalog = machine.catalog();
    let lanes = catalog.lanes.iter().zip(machine.task_names()).map(|(lane, tasks)| {
        json!({
            "name": lane.name,
            "period_ns": lane.period.0,
            "phase_ns": lane.phase.0,
            "tasks": tasks,
        })
    });
    let signals = catalog.signals.iter().map(|signal| {
        let fields = signal.fields.iter().map(|field| {
            let (kind, count) = (field.kind.ros_name(), field.count);
            json!({ "name": field.name, "kind": kind, "count": count, "array": field.array })
        });
        json!({
            "name": signal.name,
            "lane": signal.lane,
            "type": signal.type_name,
            "size": signal.size,
            "fields": fields.collect::<Vec<_>>(),
        })
    });
    let texts = texts.iter().map(|(name, text)| ((*name).to_owned(), json!(text)));
    json!({
        "taktil": env!("CARGO_PKG_VERSION"),
        "process": std::process::id(),
        "lanes": lanes.collect::<Vec<_>>(),
        "signals": signals.collect::<Vec<_>>(),
        "texts": texts.collect::<serde_json::Map<_, _>>(),
    })
}
