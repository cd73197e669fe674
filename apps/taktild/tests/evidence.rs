//! What a killed service leaves behind: its log up to the last fifth of a second, and its flight
//! recording. Starts that fail and a second service change neither.

mod process;

use std::path::{Path, PathBuf};

use nix::sys::signal::Signal;
use process::{Folder, NO_FLIGHT, Rig, Service, command};

/// Every recording in a folder, by name, with its bytes.
fn recordings(folder: &Folder) -> Vec<(PathBuf, Vec<u8>)> {
    let entries = std::fs::read_dir(folder.join("logs")).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    let is_log = |path: &PathBuf| path.extension().is_some_and(|ending| ending == "mcap");
    let mut found: Vec<_> = paths.filter(is_log).collect();
    found.sort();
    found.into_iter().map(|path| (path.clone(), std::fs::read(&path).unwrap())).collect()
}

/// A folder `logs`, and the sections that record there and in memory.
fn sections(folder: &Folder, memory: &Path) -> String {
    std::fs::create_dir_all(folder.join("logs")).unwrap();
    let log = folder.join("logs/run.mcap");
    format!("\n[flight]\npath = \"{}\"\n\n[log]\npath = \"{}\"\n", memory.display(), log.display())
}

/// A flight file of one test, removed at its end with those beside it.
struct FlightFile(PathBuf);

impl FlightFile {
    fn new(name: &str) -> FlightFile {
        let name = format!("taktild-evidence-{}-{name}.flight", std::process::id());
        FlightFile(Path::new("/dev/shm").join(name))
    }

    /// The recording of a process that was killed: at its name, or aside.
    fn bytes(&self) -> Vec<u8> {
        std::fs::read(&self.0).unwrap()
    }
}

impl Drop for FlightFile {
    fn drop(&mut self) {
        for ending in ["", ".previous", ".starting"] {
            let mut name = self.0.as_os_str().to_owned();
            name.push(ending);
            let _ = std::fs::remove_file(PathBuf::from(name));
        }
    }
}

fn run_and_kill(config: &Path) {
    let sockets = Folder::new();
    let service = Service::start(&sockets, config);
    for _ in 0..8 {
        service.wait_for_message("WATCHDOG=1");
    }
    service.signal(Signal::SIGKILL);
    service.end();
}

#[test]
fn failed_starts_and_a_second_service_leave_a_crash_as_it_is() {
    let folder = Folder::new();
    let _rig = Rig::new(&folder);
    let memory = FlightFile::new("crash");
    let sections = sections(&folder, &memory.0);
    let config = folder.config_with("contract = \"soft\"", &sections);
    run_and_kill(&config);
    let (log, flight) = (recordings(&folder), memory.bytes());
    assert_eq!(log.len(), 1);
    assert!(log[0].1.len() > 10_000, "half a second and more: {}", log[0].1.len());
    let unchanged = |after: &str| {
        assert!(recordings(&folder) == log, "{after}");
        assert!(memory.bytes() == flight, "{after}");
    };
    // A configuration with a mistake, a board that is not there, and a contract that cannot hold.
    for round in 0..2 {
        let bad = folder.config_with("contract = \"soft\"", &format!("{sections}colour = 1\n"));
        assert_eq!(command(&bad).output().unwrap().status.code(), Some(2));
        unchanged(&format!("a key that does not exist, round {round}"));
        let gone = folder.join("board.bin");
        std::fs::rename(&gone, folder.join("away")).unwrap();
        let config = folder.config_with("contract = \"soft\"", &sections);
        assert_ne!(command(&config).output().unwrap().status.code(), Some(0));
        std::fs::rename(folder.join("away"), &gone).unwrap();
        unchanged(&format!("no board, round {round}"));
    }
    let items = "contract = { isolation = \"hard\", clock = \"hard\", idle = \"hard\" }";
    let strict = folder.config_with(items, &sections);
    let refused = command(&strict).output().unwrap();
    if refused.status.code() == Some(0) {
        taktil_tests_script::report_skip("this machine grants even isolated processors");
    }
    unchanged("a contract that cannot hold");
}

#[test]
fn a_second_service_with_a_copied_configuration_changes_nothing() {
    let folder = Folder::new();
    let _rig = Rig::new(&folder);
    let memory = FlightFile::new("copied");
    let sections = sections(&folder, &memory.0);
    let config = folder.config_with("contract = \"soft\"", &sections);
    let sockets = Folder::new();
    let first = Service::start(&sockets, &config);
    first.wait_for_message("WATCHDOG=1");
    // The copy has a board of its own, and the paths of the first.
    let other = Folder::new();
    let _other_rig = Rig::new(&other);
    for sections in [sections.clone(), sections.replace("[flight]", "[flight]\nenabled = false")] {
        let copy = other.config_with("contract = \"soft\"", &sections);
        let refused = command(&copy).output().unwrap();
        let text = String::from_utf8_lossy(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{text}");
        assert!(text.contains("log.path") || text.contains("flight.path"), "{text}");
    }
    first.wait_for_message("WATCHDOG=1");
    first.signal(Signal::SIGTERM);
    let (code, lines) = first.end();
    assert_eq!(code, Some(0), "{lines:?}");
    assert_eq!(recordings(&folder).len(), 1);
}

#[test]
fn each_run_keeps_the_logs_of_those_before_it() {
    let folder = Folder::new();
    let _rig = Rig::new(&folder);
    std::fs::create_dir_all(folder.join("logs")).unwrap();
    let log = format!("{NO_FLIGHT}[log]\npath = \"logs/run.mcap\"\n");
    let config = folder.config_with("contract = \"soft\"", &log);
    let mut before = Vec::new();
    for round in 0..3 {
        let sockets = Folder::new();
        let service = Service::start(&sockets, &config);
        service.wait_for_message("WATCHDOG=1");
        service.signal(Signal::SIGTERM);
        let (code, lines) = service.end();
        assert_eq!(code, Some(0), "{lines:?}");
        let now = recordings(&folder);
        assert_eq!(now.len(), round + 1);
        let is_kept = |old: &(PathBuf, Vec<u8>)| now.iter().any(|new| new.1 == old.1);
        assert!(before.iter().all(is_kept), "round {round}");
        before = now;
    }
}

#[test]
fn a_recording_for_viewers_holds_joints_frames_and_the_robot_beside_the_signals() {
    let folder = Folder::new();
    let _rig = Rig::new(&folder);
    std::fs::create_dir_all(folder.join("logs")).unwrap();
    let log = format!("{NO_FLIGHT}[log]\npath = \"logs/run.mcap\"\nviewer = true\n");
    let config = folder.config_with("contract = \"soft\"", &log);
    let sockets = Folder::new();
    let service = Service::start(&sockets, &config);
    for _ in 0..3 {
        service.wait_for_message("WATCHDOG=1");
    }
    service.signal(Signal::SIGTERM);
    let (code, lines) = service.end();
    assert_eq!(code, Some(0), "{lines:?}");
    let recordings = recordings(&folder);
    let bytes = &recordings[0].1;
    for text in
        ["/sense/joints", "/viewer/joints", "foxglove.FrameTransforms", "robot.urdf", "<robot "]
    {
        let has = bytes.windows(text.len()).any(|at| at == text.as_bytes());
        assert!(has, "{text} in {} bytes", bytes.len());
    }
    // Viewers take the first chunk for the begin.
    let summary = mcap::Summary::read(bytes).unwrap().unwrap();
    let begin = summary.chunk_indexes.iter().map(|chunk| chunk.message_start_time).min();
    assert_eq!(begin, summary.stats.map(|stats| stats.message_start_time));
    assert!(begin > Some(0), "{begin:?}");
}

#[test]
fn a_path_that_is_no_place_for_a_log_is_refused_at_once() {
    let folder = Folder::new();
    let _rig = Rig::new(&folder);
    let pipe = folder.join("pipe");
    nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
    for path in [pipe.clone(), PathBuf::from("/dev/null"), folder.join("")] {
        let log = format!("{NO_FLIGHT}[log]\npath = \"{}\"\n", path.display());
        let config = folder.config_with("contract = \"soft\"", &log);
        let refused = command(&config).output().unwrap();
        let text = String::from_utf8_lossy(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{}: {text}", path.display());
        assert!(text.contains("log.path"), "{}: {text}", path.display());
    }
}
