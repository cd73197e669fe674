//! The flight recorder as applications use it: where its file goes, the text that explains it, and
//! what the kernel granted. Refuses to throw away the recording before: it is kept beside the new
//! one.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::{Value, json};
use taktil_rtcore::flight::{GrantWriter, record};
use taktil_rtcore::linux::wall_clock;
use taktil_rtcore::live::Attestation;
use taktil_rtcore::{Invalid, Machine, Nanos};

/// The service's own folder in memory.
const FOLDER: &str = "/run/taktil";
/// Where its file goes when that folder is not there.
const ELSEWHERE: &str = "/dev/shm/taktild.flight";

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

/// Seconds that are kept unless the configuration says otherwise.
pub const SECONDS: f64 = 10.0;

impl Default for FlightConfig {
    fn default() -> FlightConfig {
        FlightConfig { enabled: true, path: None, seconds: SECONDS }
    }
}

impl FlightConfig {
    /// Where the file goes.
    #[must_use]
    pub fn place(&self) -> PathBuf {
        let folder = Path::new(FOLDER);
        let own = || if folder.is_dir() { folder.join("flight") } else { ELSEWHERE.into() };
        self.path.clone().unwrap_or_else(own)
    }
}

/// A flight recorder at work.
pub struct Keeper {
    notebook: GrantWriter,
    granted: Value,
    zero_known: bool,
}

impl Keeper {
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
    ) -> Result<Keeper, Invalid> {
        let about = about(machine, texts).to_string();
        let mut previous = path.as_os_str().to_owned();
        previous.push(".previous");
        keep(path, Path::new(&previous))?;
        let (recorder, notebook) = record(path, machine.catalog(), seconds, &about)?;
        machine.attach_flight_recorder(recorder);
        Ok(Keeper { notebook, granted: Value::Null, zero_known: false })
    }

    /// Notes what the kernel granted.
    pub fn attested(&mut self, attestation: &Attestation) {
        let words = |short: &taktil_rtcore::contract::Shortfall| short.to_string();
        self.granted = json!({
            "granted": attestation.is_granted(),
            "shortfalls": attestation.shortfalls.iter().map(words).collect::<Vec<_>>(),
            "notes": attestation.notes,
            "preempt_rt": attestation.preempt_rt,
            "virtual_machine": attestation.virtual_machine,
        });
        self.notebook.write_granted(&self.granted.to_string());
    }

    /// Notes, once, which wall time logical zero was.
    pub fn passed(&mut self, now: Nanos) {
        if !core::mem::replace(&mut self.zero_known, true) && self.granted.is_object() {
            self.granted["zero_unix_ns"] = json!((wall_clock() - now).0);
            self.notebook.write_granted(&self.granted.to_string());
        }
    }
}

/// Puts a recording that is there under another name. Nothing else is moved or written over.
fn keep(path: &Path, previous: &Path) -> Result<(), Invalid> {
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

/// The machine as a reader needs it, without the program that ran it.
fn about(machine: &Machine, texts: &[(&str, &str)]) -> Value {
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
