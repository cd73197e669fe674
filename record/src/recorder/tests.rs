//! A recorder over a disk that fails, fills up, freezes and thaws when it is told to; and over the
//! kernel's, where files have to be locked, kept and rotated.

use std::io::{Error, ErrorKind, Seek, SeekFrom, Write};
use std::os::unix::fs::symlink;
use std::path::Path;
use std::sync::MutexGuard;

use taktil_rtcore::record::{LaneInfo, Signal};
use taktil_rtcore::{Payload, payload};

use super::*;
use crate::{Log, LogFile, METADATA_END, METADATA_RESULT, METADATA_RUN};

payload! {
    /// A body of a kilobyte.
    pub struct Block {
        /// Numbers that nobody reads.
        pub words: [u64; 128],
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

/// A folder of one test, removed at its end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Folder {
        let path =
            std::env::temp_dir().join(format!("taktil-recorder-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }

    fn log(&self) -> PathBuf {
        self.0.join("run.mcap")
    }

    /// Names in order, without the note.
    fn names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(&self.0).unwrap().flatten();
        let names = entries.map(|entry| entry.file_name().into_string().unwrap());
        let mut names: Vec<String> = names.filter(|name| !name.ends_with(".state")).collect();
        names.sort();
        names
    }

    fn options(&self) -> RecordingOptions {
        RecordingOptions {
            path: self.log(),
            rotate_bytes: 1 << 30,
            rotate_after: None,
            budget_bytes: 1 << 32,
            free_bytes: 1000,
            queue_bytes: 1 << 20,
        }
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[derive(Clone, Copy, Debug)]
struct Faults {
    frozen: bool,
    refuses: Option<ErrorKind>,
    free_bytes: u64,
}

/// The kernel's disk, with faults in front of each write.
#[derive(Clone)]
struct FaultyDisk(Arc<Mutex<Faults>>);

impl FaultyDisk {
    fn new() -> FaultyDisk {
        let faults = Faults { frozen: false, refuses: None, free_bytes: 1 << 40 };
        FaultyDisk(Arc::new(Mutex::new(faults)))
    }

    fn faults(&self) -> MutexGuard<'_, Faults> {
        self.0.lock().unwrap()
    }
}

impl Disk for FaultyDisk {
    type File = FaultyFile;
    fn open(&self, path: &Path) -> anyhow::Result<FaultyFile> {
        Ok(FaultyFile { file: LogFile::open(path)?, disk: self.clone() })
    }
    fn set_aside(&self, path: &Path) -> anyhow::Result<Option<PathBuf>> {
        segments::KernelDisk.set_aside(path)
    }
    fn remove(&self, path: &Path) -> std::io::Result<()> {
        segments::KernelDisk.remove(path)
    }
    fn free_bytes(&self, _: &Path) -> Option<u64> {
        Some(self.faults().free_bytes)
    }
}

struct FaultyFile {
    file: LogFile,
    disk: FaultyDisk,
}

impl Write for FaultyFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.file.write(bytes)
    }
    fn flush(&mut self) -> std::io::Result<()> {
        while self.disk.faults().frozen {
            std::thread::sleep(Duration::from_millis(1));
        }
        match self.disk.faults().refuses {
            Some(kind) => Err(Error::from(kind)),
            None => self.file.flush(),
        }
    }
}

impl Seek for FaultyFile {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.file.seek(to)
    }
}

impl segments::LogOutput for FaultyFile {
    fn close_short(&mut self, why: &str) -> std::io::Result<()> {
        self.file.close_short(why)
    }
}

fn about() -> BTreeMap<String, String> {
    BTreeMap::from([("seed".to_owned(), "7".to_owned())])
}

fn start(folder: &Folder) -> Recorder {
    Recorder::start(folder.options(), &catalog(), about()).unwrap()
}

/// Records of the milliseconds `ticks`.
fn record(recorder: &mut Recorder, ticks: std::ops::Range<u64>) {
    for tick in ticks {
        let release = Nanos::from_millis(tick.cast_signed());
        recorder.record(&Record { signal: 0, tick, release, body: &[tick as u8; Block::SIZE] });
    }
}

/// As [`record`], waiting for room as no lane does.
fn record_all(recorder: &mut Recorder, ticks: std::ops::Range<u64>) {
    for tick in ticks {
        wait_until(|| recorder.sender.queued_bytes() < recorder.sender.capacity_bytes() / 2);
        record(recorder, tick..tick + 1);
    }
}

/// A minute is more than any machine needs; nothing is asserted of the time.
fn wait_until(mut condition: impl FnMut() -> bool) {
    for _ in 0..60_000 {
        if condition() {
            return;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    panic!("waited for a minute");
}

fn finish(recorder: Recorder) -> anyhow::Result<()> {
    recorder.finish(BTreeMap::new(), Duration::from_secs(60))
}

fn ticks(path: &Path) -> Vec<u64> {
    Log::open(path).unwrap().messages().map(|message| message.tick).collect()
}

#[test]
fn what_is_handed_in_stands_in_the_log() {
    let folder = Folder::new("plain");
    let mut recorder = start(&folder);
    assert_eq!(recorder.previous(), None);
    assert!(recorder.write_metadata("taktil.attestation", "{}"));
    record_all(&mut recorder, 0..3000);
    let result = BTreeMap::from([("hung".to_owned(), "task".to_owned())]);
    recorder.finish(result, Duration::from_secs(60)).unwrap();
    let log = Log::open(&folder.log()).unwrap();
    assert_eq!((log.damage(), log.gaps()), (None, &[][..]));
    assert!(log.messages().map(|message| message.tick).eq(0..3000));
    assert_eq!(log.metadata()[METADATA_RUN]["seed"], "7");
    assert_eq!(log.metadata()["taktil.attestation"]["json"], "{}");
    assert_eq!(log.metadata()[METADATA_RESULT]["hung"], "task");
    assert_eq!(start(&folder).previous().unwrap().ending, Ending::Finished);
}

#[test]
fn starts_that_come_to_no_record_leave_the_log_of_a_crash_as_it_is() {
    let folder = Folder::new("crash");
    let mut recorder = start(&folder);
    record_all(&mut recorder, 0..500);
    wait_until(|| recorder.health().bytes > 0 && recorder.sender.queued_bytes() == 0);
    // A process that is killed gives its locks back and closes nothing.
    let kept = std::fs::read(folder.log()).unwrap();
    let state = folder.0.join("run.mcap.state");
    let note = std::fs::read(&state).unwrap();
    recorder.finish(BTreeMap::new(), Duration::from_secs(60)).unwrap();
    std::fs::write(folder.log(), &kept).unwrap();
    std::fs::write(&state, &note).unwrap();
    for _ in 0..5 {
        let recorder = start(&folder);
        let previous = recorder.previous().unwrap();
        assert_eq!(previous.ending, Ending::Recording);
        assert!(previous.to_string().contains("was not closed"), "{previous}");
        finish(recorder).unwrap();
        assert_eq!(std::fs::read(folder.log()).unwrap(), kept);
        assert_eq!(std::fs::read(&state).unwrap(), note);
    }
    // One that has jobs keeps it under another name.
    let mut recorder = start(&folder);
    record(&mut recorder, 0..1);
    finish(recorder).unwrap();
    let names = folder.names();
    assert_eq!(names.len(), 2, "{names:?}");
    assert_eq!(std::fs::read(folder.0.join(&names[0])).unwrap(), kept);
    assert_eq!(ticks(&folder.log()), [0]);
}

#[test]
fn a_second_recorder_at_the_same_path_is_refused_and_changes_nothing() {
    let folder = Folder::new("second");
    let mut first = start(&folder);
    for round in 0..2 {
        let refused = Recorder::start(folder.options(), &catalog(), about()).err().unwrap();
        assert_eq!(refused.place, "path");
        assert!(refused.what.contains("another process records"), "{refused}");
        record_all(&mut first, 100 * round..100 * round + 100);
    }
    finish(first).unwrap();
    assert!(ticks(&folder.log()).into_iter().eq(0..200));
    assert_eq!(folder.names(), ["run.mcap"]);
}

#[test]
fn places_that_are_no_files_are_refused_at_once() {
    let folder = Folder::new("places");
    let pipe = folder.0.join("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    symlink("/dev/null", folder.0.join("null")).unwrap();
    for (name, says) in [
        ("pipe", "is a pipe"),
        ("null", "or a device"),
        (".", "is a directory"),
        ("no/such/folder.mcap", "there is no folder"),
        ("..", "names no file"),
    ] {
        let options = RecordingOptions { path: folder.0.join(name), ..folder.options() };
        let refused = Recorder::start(options, &catalog(), about()).err().unwrap();
        assert!(refused.to_string().contains(says), "{name}: {refused}");
    }
    assert_eq!(folder.names(), ["null", "pipe"]);
}

#[test]
fn files_are_ended_by_size_and_time_and_the_oldest_go() {
    let folder = Folder::new("rotate");
    let options = RecordingOptions {
        rotate_bytes: 300_000,
        rotate_after: Some(Nanos::from_millis(200)),
        budget_bytes: 1_300_000,
        ..folder.options()
    };
    let mut recorder = Recorder::start(options, &catalog(), about()).unwrap();
    record_all(&mut recorder, 0..2000);
    wait_until(|| recorder.health().segments == 10);
    finish(recorder).unwrap();
    let names = folder.names();
    // Ten files of 200 ms; five of 215 kB with their index fit 1.3 MB, the newest among them.
    assert!((4..=6).contains(&names.len()), "{names:?}");
    let logs: Vec<Log> =
        names.iter().map(|name| Log::open(&folder.0.join(name)).unwrap()).collect();
    let newest = logs.iter().find(|log| log.metadata()[METADATA_RUN]["segment"] == "10").unwrap();
    assert!(newest.messages().map(|message| message.tick).eq(1809..2000));
    assert!(logs.iter().all(|log| log.damage().is_none()));
    let size: u64 = names.iter().map(|name| folder.0.join(name).metadata().unwrap().len()).sum();
    assert!(size <= 1_300_000, "{size}");
}

#[test]
fn a_frozen_disk_costs_records_that_are_counted_and_stand_in_the_log() {
    let (folder, disk) = (Folder::new("frozen"), FaultyDisk::new());
    let options = RecordingOptions { queue_bytes: 400_000, ..folder.options() };
    let mut recorder = Recorder::start_on(disk.clone(), options, &catalog(), about()).unwrap();
    record_all(&mut recorder, 0..500);
    wait_until(|| recorder.sender.queued_bytes() == 0);
    disk.faults().frozen = true;
    record(&mut recorder, 500..2000);
    let health = recorder.health();
    assert!(health.lost > 1000 && health.queue_fill > 0.9, "{health:?}");
    wait_until(|| recorder.health().failure.is_some());
    let health = recorder.health();
    assert!(!health.recording && health.failure.unwrap().contains("has not answered"));
    disk.faults().frozen = false;
    wait_until(|| recorder.health().stalled_s < 0.5 && recorder.sender.queued_bytes() == 0);
    record_all(&mut recorder, 2000..2100);
    let lost = recorder.health().lost;
    let said = finish(recorder).unwrap_err().to_string();
    assert!(said.contains(&format!("{lost} records are not in the log")), "{said}");
    let log = Log::open(&folder.log()).unwrap();
    let [gap] = log.gaps() else { panic!("{:?}", log.gaps()) };
    let kept: Vec<u64> = log.messages().map(|message| message.tick).collect();
    let missing: Vec<u64> = (0..2100).filter(|tick| !kept.contains(tick)).collect();
    let millis = |tick: u64| Nanos::from_millis(tick.cast_signed());
    assert_eq!((gap.records, lost), (missing.len() as u64, missing.len() as u64));
    assert_eq!((gap.from, gap.to), (millis(missing[0]), millis(*missing.last().unwrap())));
    assert!(gap.cause.contains("disk is slow"), "{gap:?}");
}

#[test]
fn the_end_does_not_wait_for_a_frozen_disk() {
    let (folder, disk) = (Folder::new("end"), FaultyDisk::new());
    let mut recorder =
        Recorder::start_on(disk.clone(), folder.options(), &catalog(), about()).unwrap();
    record_all(&mut recorder, 0..200);
    disk.faults().frozen = true;
    record(&mut recorder, 200..400);
    let said = recorder.finish(BTreeMap::new(), Duration::from_millis(50)).unwrap_err();
    assert!(said.to_string().contains("does not answer"), "{said}");
    disk.faults().frozen = false;
}

#[test]
fn a_write_that_fails_ends_the_file_whole_and_recording_goes_on_later() {
    for (kind, ending) in
        [(ErrorKind::StorageFull, Ending::DiskFull), (ErrorKind::PermissionDenied, Ending::Failed)]
    {
        let (folder, disk) = (Folder::new(&format!("{ending:?}")), FaultyDisk::new());
        let mut recorder =
            Recorder::start_on(disk.clone(), folder.options(), &catalog(), about()).unwrap();
        record_all(&mut recorder, 0..1000);
        wait_until(|| recorder.sender.queued_bytes() == 0);
        disk.faults().refuses = Some(kind);
        record_all(&mut recorder, 1000..1500);
        wait_until(|| recorder.health().failure.is_some());
        let health = recorder.health();
        assert!(!health.recording && health.file.is_none(), "{health:?}");
        let log = Log::open(&folder.log()).unwrap();
        assert_eq!(log.damage(), None);
        assert!(log.metadata()[METADATA_END]["json"].contains("cause"));
        let first: Vec<u64> = log.messages().map(|message| message.tick).collect();
        disk.faults().refuses = None;
        // It is tried again a second later, when a record comes.
        let mut tick = 1500;
        wait_until(|| {
            record_all(&mut recorder, tick..tick + 1);
            tick += 1;
            recorder.health().recording
        });
        let lost = recorder.health().lost;
        assert!(finish(recorder).is_err(), "records are missing");
        let log = Log::open(&folder.log()).unwrap();
        let second: Vec<u64> = log.messages().map(|message| message.tick).collect();
        assert!(first.iter().copied().eq(0..first.len() as u64) && first.len() >= 900);
        assert!(second.iter().copied().eq(second[0]..tick), "{:?}", second.first());
        let [gap] = log.gaps() else { panic!("{:?}", log.gaps()) };
        assert_eq!((gap.records, lost), (second[0] - first.len() as u64, gap.records));
        assert_eq!(folder.names().len(), 2);
    }
}

#[test]
fn a_disk_at_its_floor_ends_the_file_and_the_next_start_says_so() {
    let (folder, disk) = (Folder::new("floor"), FaultyDisk::new());
    let mut recorder =
        Recorder::start_on(disk.clone(), folder.options(), &catalog(), about()).unwrap();
    record_all(&mut recorder, 0..10);
    wait_until(|| recorder.health().bytes > 0 && recorder.sender.queued_bytes() == 0);
    disk.faults().free_bytes = 999;
    wait_until(|| recorder.health().failure.is_some());
    record_all(&mut recorder, 10..20);
    wait_until(|| recorder.health().lost == 10);
    assert!(finish(recorder).is_err());
    let log = Log::open(&folder.log()).unwrap();
    assert!(log.metadata()[METADATA_END]["json"].contains("disk full"));
    assert!(log.messages().map(|message| message.tick).eq(0..10));
    let next = start(&folder);
    let previous = next.previous().unwrap();
    assert_eq!(previous.ending, Ending::DiskFull);
    assert!(previous.to_string().contains("ended by a full disk"), "{previous}");
}

#[test]
fn recording_is_stopped_and_begun_on_request() {
    let folder = Folder::new("request");
    let mut recorder = start(&folder);
    record_all(&mut recorder, 0..10);
    wait_until(|| recorder.health().file.is_some());
    assert!(recorder.set_recording(false));
    record_all(&mut recorder, 10..20);
    wait_until(|| recorder.health().file.is_none());
    let health = recorder.health();
    assert!(!health.recording && !health.wanted && health.failure.is_none(), "{health:?}");
    assert!(recorder.set_recording(true));
    record_all(&mut recorder, 20..30);
    wait_until(|| recorder.health().file == Some(folder.log()));
    assert!(recorder.health().recording);
    finish(recorder).unwrap();
    assert!(ticks(&folder.log()).into_iter().eq(20..30));
    assert!(ticks(&folder.0.join(&folder.names()[0])).into_iter().eq(0..10));
}

#[test]
fn numbers_out_of_range_are_refused_with_their_key() {
    let sound = LogConfig::at("run.mcap".into());
    let options = sound.options(Path::new("/etc/taktil")).unwrap();
    assert_eq!(options.path, Path::new("/etc/taktil/run.mcap"));
    let place = |config: LogConfig| config.options(Path::new("")).unwrap_err().place;
    assert_eq!(place(LogConfig { rotate_mb: 0, ..sound.clone() }), "rotate_mb");
    assert_eq!(place(LogConfig { budget_mb: 511, ..sound.clone() }), "budget_mb");
    assert_eq!(place(LogConfig { queue_mb: 0, ..sound.clone() }), "queue_mb");
    for seconds in [0.5, f64::NAN, f64::INFINITY] {
        assert_eq!(place(LogConfig { rotate_s: Some(seconds), ..sound.clone() }), "rotate_s");
    }
}
