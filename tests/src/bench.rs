//! What tests of the whole stack share: scenes whose keys can be changed, runs that are recorded in
//! memory, and temporary folders. Every function panics on what it does not expect.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_rtcore::live::RunObserver;
use taktil_rtcore::parameter::Edit;
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::{FromRecord, Machine, Nanos, Payload, virtual_time};
use taktil_signal::{Contact, ControlState};
use toml::{Table, Value};

/// A folder of one test, removed at its end.
pub struct TemporaryFolder(PathBuf);

impl TemporaryFolder {
    /// A new one under the system's folder for temporary files.
    #[must_use]
    #[expect(clippy::new_without_default, reason = "making it has an effect")]
    pub fn new() -> TemporaryFolder {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("taktil-stack-{}-{number}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).unwrap();
        TemporaryFolder(path)
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A scene of the repository as a table whose keys can be changed.
pub struct SceneDraft(Table);

impl SceneDraft {
    /// `sim/scenes/NAME`, with its machine found from anywhere.
    #[must_use]
    pub fn of(name: &str) -> SceneDraft {
        let path = crate::root().join("sim/scenes").join(name);
        let mut table: Table = std::fs::read_to_string(&path).unwrap().parse().unwrap();
        let machine = path.with_file_name(table["machine"].as_str().unwrap());
        table.insert("machine".into(), machine.display().to_string().into());
        SceneDraft(table)
    }

    /// The rolling experiment.
    #[must_use]
    pub fn roll_pin() -> SceneDraft {
        SceneDraft::of("roll-pin.toml")
    }

    /// Sets the value at a dotted key, making the tables on the way; of a list the first.
    #[must_use]
    pub fn set(mut self, key: &str, value: impl Into<Value>) -> SceneDraft {
        let (tables, last) = key.rsplit_once('.').unwrap_or(("", key));
        let mut table = &mut self.0;
        for name in tables.split('.').filter(|name| !name.is_empty()) {
            let inner = table.entry(name).or_insert_with(|| Value::Table(Table::new()));
            table = match inner {
                Value::Array(all) => all[0].as_table_mut().unwrap(),
                one => one.as_table_mut().unwrap(),
            };
        }
        table.insert(last.to_owned(), value.into());
        self
    }

    /// The value at a key of the outermost table.
    #[must_use]
    pub fn value(&self, key: &str) -> &Value {
        &self.0[key]
    }

    /// Keeps the operator's first `count` requests.
    #[must_use]
    pub fn first_requests(mut self, count: usize) -> SceneDraft {
        let steps = self.0["operator"].as_array_mut().unwrap();
        assert!(steps.len() >= count);
        steps.truncate(count);
        self
    }

    /// The text.
    #[must_use]
    pub fn text(&self) -> String {
        toml::to_string(&self.0).unwrap()
    }

    /// The scene that this text stands for, read as the program reads it.
    #[must_use]
    pub fn scene(&self) -> Scene {
        let folder = TemporaryFolder::new();
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, self.text()).unwrap();
        Scene::load(&path).unwrap_or_else(|bad| panic!("{bad}"))
    }
}

struct Row {
    signal: usize,
    tick: u64,
    release: Nanos,
    body: Vec<u8>,
}

/// Every record of a run.
pub struct RecordedRun {
    catalog: Catalog,
    rows: Vec<Row>,
}

impl Observer for RecordedRun {
    fn record(&mut self, record: &Record<'_>) {
        let (signal, tick, release) = (record.signal, record.tick, record.release);
        self.rows.push(Row { signal, tick, release, body: record.body.to_vec() });
    }
}

impl RunObserver for RecordedRun {}

impl RecordedRun {
    /// Nothing yet.
    #[must_use]
    pub fn new(machine: &Machine) -> RecordedRun {
        RecordedRun { catalog: machine.catalog().clone(), rows: Vec::new() }
    }

    /// All values of a signal with the releases that wrote them.
    #[must_use]
    pub fn of<T: FromRecord>(&self, signal: &str) -> Vec<(Nanos, T)> {
        let id = self.catalog.find(signal).unwrap_or_else(|| panic!("there is no `{signal}`"));
        let rows = self.rows.iter().filter(|row| row.signal == id);
        let fields = &self.catalog.signals[id].fields;
        let value = |body| T::from_record(fields, body).unwrap();
        let values: Vec<_> = rows.map(|row| (row.release, value(&row.body))).collect();
        assert!(!values.is_empty(), "`{signal}` was never written");
        values
    }

    /// The bytes of every value of a signal.
    #[must_use]
    pub fn bodies(&self, signal: &str) -> Vec<&[u8]> {
        let id = self.catalog.find(signal).unwrap_or_else(|| panic!("there is no `{signal}`"));
        self.rows.iter().filter(|row| row.signal == id).map(|row| &*row.body).collect()
    }

    /// The names of the signals.
    pub fn signals(&self) -> impl Iterator<Item = &str> {
        self.catalog.signals.iter().map(|signal| &*signal.name)
    }

    /// What the supervisor said last.
    #[must_use]
    pub fn last_control(&self) -> ControlState {
        self.of::<ControlState>("supervisor.control").pop().unwrap().1
    }

    /// Where two runs differ first among the jobs released before `until`, signal by signal, as a
    /// person wants to read it.
    #[must_use]
    pub fn difference(&self, other: &RecordedRun, until: Nanos) -> Option<String> {
        assert_eq!(self.catalog, other.catalog);
        for (id, signal) in self.catalog.signals.iter().enumerate() {
            let of = |kept: &RecordedRun| -> Vec<(u64, Nanos, Vec<u8>)> {
                let rows = kept.rows.iter();
                let rows = rows.filter(|row| row.signal == id && row.release < until);
                rows.map(|row| (row.tick, row.release, row.body.clone())).collect()
            };
            let (ours, theirs) = (of(self), of(other));
            // Everything speaks in every run, save edits, which somebody has to ask for, and
            // contact, which has to be gained.
            let rare = [Edit::NAME, Contact::NAME].contains(&&*signal.type_name);
            let silent = ours.is_empty() && !rare;
            if silent || ours.len() != theirs.len() {
                let (a, b) = (ours.len(), theirs.len());
                return Some(format!("{}: {a} records and {b}", signal.name));
            }
            if let Some((a, _)) = ours.iter().zip(&theirs).find(|(a, b)| a != b) {
                return Some(format!("{} at tick {}", signal.name, a.0));
            }
        }
        None
    }
}

/// Builds the machine of a scene.
#[must_use]
pub fn machine(scene: &Scene, seed: u64) -> Machine {
    Assembly::new(scene).with_seed(seed).build().unwrap_or_else(|bad| panic!("{bad}"))
}

/// Runs a scene in virtual time to its end and keeps every record.
#[must_use]
pub fn run(scene: &Scene, seed: u64) -> RecordedRun {
    let mut machine = machine(scene, seed);
    let mut kept = RecordedRun::new(&machine);
    let stop = AtomicBool::new(false);
    let reached = virtual_time::run(&mut machine, scene.duration, &stop, &mut kept).unwrap();
    assert_eq!(reached, scene.duration);
    for (spec, figures) in machine.figures() {
        let lost = (figures.records_dropped, figures.values_dropped, figures.skipped);
        assert_eq!(lost, (0, 0, 0), "lane {}", spec.name);
    }
    kept
}
