//! Each operation of the disk fails in turn: the first one, the second one, until a recording has
//! no more of them. What was recorded before stays readable, every record is in a file or counted
//! as lost, and the recorder says that something is wrong.

use std::io::{Error, ErrorKind, Seek, SeekFrom, Write};
use std::path::Path;

use taktil_rtcore::Payload;
use taktil_rtcore::record::{LaneInfo, Signal};

use super::segments::LogOutput;
use super::*;
use crate::{Log, LogFile};

/// Records of a run, one a millisecond.
const RECORDS_COUNT: u64 = 120;
/// Records between two passes of the thread.
const RECORDS_PER_PASS: u64 = 10;
/// More operations than any such run has.
const OPERATIONS_MAX: u64 = 10_000;

taktil_rtcore::payload! {
    /// A body of half a kilobyte.
    pub struct Block {
        /// Numbers that nobody reads.
        pub words: [u64; 64],
    }
}

/// What fails.
#[derive(Clone, Copy, Debug)]
struct Failure {
    /// Number of the operation, from 1.
    operation: u64,
    kind: ErrorKind,
    /// Whether all operations behind it fail as well.
    is_lasting: bool,
}

/// The kernel's disk, of which operations fail.
#[derive(Clone)]
struct CountingDisk {
    failure: Failure,
    operations: Arc<Mutex<u64>>,
}

impl CountingDisk {
    fn new(failure: Failure) -> CountingDisk {
        CountingDisk { failure, operations: Arc::new(Mutex::new(0)) }
    }

    fn operations(&self) -> u64 {
        *self.operations.lock().unwrap()
    }

    fn operation(&self) -> std::io::Result<()> {
        let mut count = self.operations.lock().unwrap();
        *count += 1;
        let Failure { operation, kind, is_lasting } = self.failure;
        match *count == operation || (is_lasting && *count > operation) {
            true => Err(Error::from(kind)),
            false => Ok(()),
        }
    }
}

impl Disk for CountingDisk {
    type File = CountingFile;

    fn open(&self, path: &Path) -> anyhow::Result<CountingFile> {
        self.operation()?;
        Ok(CountingFile { file: LogFile::open(path)?, disk: self.clone() })
    }

    fn set_aside(&self, path: &Path) -> anyhow::Result<Option<PathBuf>> {
        self.operation()?;
        KernelDisk.set_aside(path)
    }

    fn remove(&self, path: &Path) -> std::io::Result<()> {
        self.operation()?;
        KernelDisk.remove(path)
    }

    fn free_bytes(&self, _: &Path) -> Option<u64> {
        self.operation().ok()?;
        Some(1 << 40)
    }
}

struct CountingFile {
    file: LogFile,
    disk: CountingDisk,
}

impl Write for CountingFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.disk.operation()?;
        self.file.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.disk.operation()?;
        self.file.flush()
    }
}

impl Seek for CountingFile {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.disk.operation()?;
        self.file.seek(to)
    }
}

impl LogOutput for CountingFile {
    fn close_short(&mut self, why: &str) -> std::io::Result<()> {
        self.disk.operation()?;
        self.file.close_short(why)
    }
}

/// A folder of one recording, removed at its end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Folder {
        let path = std::env::temp_dir().join(format!("taktil-nth-{}-{name}", std::process::id()));
        std::fs::create_dir(&path).unwrap();
        Folder(path)
    }

    /// Ticks of all logs in it, in order.
    fn ticks(&self) -> Vec<u64> {
        let mut ticks = Vec::new();
        for entry in std::fs::read_dir(&self.0).unwrap() {
            let path = entry.unwrap().path();
            let is_log = path.extension().is_some_and(|ending| ending == "mcap");
            if is_log && path.metadata().unwrap().len() > 0 {
                ticks.extend(Log::open(&path).unwrap().messages().map(|message| message.tick));
            }
        }
        ticks.sort_unstable();
        ticks
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn catalog() -> Catalog {
    let signal = Signal {
        name: "a.block".into(),
        lane: 0,
        type_name: Block::NAME.into(),
        fields: Block::FIELDS.into(),
        size: Block::SIZE,
    };
    Catalog { signals: vec![signal], lanes: vec![LaneInfo::default()] }
}

/// What came of a recording.
struct Outcome {
    /// Ticks in the files, in order.
    ticks: Vec<u64>,
    lost: u64,
    /// Whether the status said in between that nothing is written.
    has_reported: bool,
    finished: Result<(), String>,
    operations: u64,
}

/// Records a run over a disk of which an operation fails. Time is an argument: nobody waits.
fn recording(failure: Failure, budget_bytes: u64) -> Outcome {
    let name = format!("{}-{}-{}", failure.operation, failure.is_lasting, budget_bytes);
    let folder = Folder::new(&name);
    let path = folder.0.join("run.mcap");
    let options = RecordingOptions {
        path: path.clone(),
        rotate_bytes: 15_000,
        rotate_after: None,
        budget_bytes,
        free_bytes: 1000,
        queue_bytes: 1 << 20,
    };
    let disk = CountingDisk::new(failure);
    let shared = Arc::new(Mutex::new(Progress::default()));
    let (note, _) = Note::take(&path).unwrap();
    let about = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
    let mut segments =
        Segments::new(disk.clone(), options, &catalog(), about, note, Arc::clone(&shared));
    let mut has_reported = false;
    for pass in 0..RECORDS_COUNT / RECORDS_PER_PASS {
        // Two seconds: the recorder tries again in each pass.
        segments.begin_pass(Nanos::from_secs(2 * pass.cast_signed()));
        let first = pass * RECORDS_PER_PASS;
        for tick in first..first + RECORDS_PER_PASS {
            let release = Nanos::from_millis(tick.cast_signed());
            let body = [tick.to_le_bytes()[0]; Block::SIZE];
            segments.record(&Record { signal: 0, tick, release, body: &body });
        }
        segments.end_pass(usize::from(pass % 3 != 2));
        has_reported |= shared.lock().unwrap().failure.is_some();
    }
    let finished = segments.finish(&BTreeMap::new());
    let lost = shared.lock().unwrap().lost;
    drop(segments);
    Outcome { ticks: folder.ticks(), lost, has_reported, finished, operations: disk.operations() }
}

/// Every operation of a run fails once, in each of these ways.
fn for_every_operation(is_lasting: bool, budget_bytes: u64, check: impl Fn(&Failure, &Outcome)) {
    for kind in [ErrorKind::StorageFull, ErrorKind::Other] {
        for operation in 1..OPERATIONS_MAX {
            let failure = Failure { operation, kind, is_lasting };
            let outcome = recording(failure, budget_bytes);
            check(&failure, &outcome);
            if outcome.operations < operation {
                assert!(operation > 50, "few operations fail: {operation}");
                assert!(outcome.finished.is_ok() && outcome.lost == 0 && !outcome.has_reported);
                break;
            }
            assert!(operation < OPERATIONS_MAX - 1, "the operations never end");
        }
    }
}

fn is_ascending(ticks: &[u64]) -> bool {
    ticks.windows(2).all(|pair| pair[0] < pair[1])
}

#[test]
fn one_failed_operation_costs_records_that_are_counted_and_said() {
    for_every_operation(false, 1 << 32, |failure, outcome| {
        let Outcome { ticks, lost, has_reported, finished, .. } = outcome;
        assert!(is_ascending(ticks), "{failure:?}: {ticks:?}");
        assert_eq!(ticks.len() as u64 + lost, RECORDS_COUNT, "{failure:?}: {ticks:?}");
        assert!(*lost == 0 || *has_reported || finished.is_err(), "{failure:?}: {lost} lost");
        assert!(*lost <= 5 * RECORDS_PER_PASS, "{failure:?}: {lost} lost");
    });
}

#[test]
fn a_disk_that_fails_for_good_keeps_what_it_has() {
    for_every_operation(true, 1 << 32, |failure, outcome| {
        let Outcome { ticks, lost, finished, has_reported, .. } = outcome;
        assert!(ticks.iter().copied().eq(0..ticks.len() as u64), "{failure:?}: {ticks:?}");
        assert_eq!(ticks.len() as u64 + lost, RECORDS_COUNT, "{failure:?}");
        assert!(*lost == 0 || (finished.is_err() && *has_reported), "{failure:?}: {lost} lost");
    });
}

#[test]
fn files_that_cannot_be_made_room_for_are_no_reason_to_stop() {
    for_every_operation(false, 60_000, |failure, outcome| {
        assert!(is_ascending(&outcome.ticks), "{failure:?}");
        assert!(outcome.ticks.len() as u64 + outcome.lost <= RECORDS_COUNT, "{failure:?}");
        assert!(outcome.ticks.contains(&(RECORDS_COUNT - 1)) || outcome.lost > 0, "{failure:?}");
    });
}
