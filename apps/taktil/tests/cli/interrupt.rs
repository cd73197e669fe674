//! Ctrl-C and SIGTERM: the run ends, the log is closed, the table is printed, and the exit code is
//! 0. The signal is sent when the program reports its progress, not after a fixed time.

use std::io::{BufRead, BufReader, Read};
use std::process::{Command, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use taktil_record::{Log, METADATA_RESULT};

use crate::process::{Folder, Running, TAKTIL, scenes};

/// Starts a long run, sends the signals one after the other after a second of logical time, and
/// returns the exit code, the standard output and the log.
fn interrupted(
    folder: &Folder,
    options: &[&str],
    signals: &[Signal],
) -> (Option<i32>, String, Log) {
    let mut command = Command::new(TAKTIL);
    command.arg("run").arg(scenes().join("roll-pin.toml")).args(options);
    command.args(["--log", "run.mcap"]).current_dir(folder.path());
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut running = Running(child);
    let mut lines = BufReader::new(running.0.stderr.take().unwrap()).lines();
    let second = lines.find(|line| line.as_ref().is_ok_and(|line| line.contains(" 1.00 s ")));
    assert!(second.is_some(), "it ended before it was asked to");
    let id = i32::try_from(running.0.id()).unwrap();
    for signal in signals {
        // The process may already be gone at the second signal.
        let _ = kill(Pid::from_raw(id), *signal);
    }
    // Later output must not block the program.
    let rest = std::thread::spawn(move || lines.map_while(Result::ok).collect::<Vec<_>>());
    let mut out = String::new();
    running.0.stdout.take().unwrap().read_to_string(&mut out).unwrap();
    let code = running.wait().code();
    let rest = rest.join().unwrap();
    assert!(rest.iter().all(|line| !line.contains("panicked")), "{rest:?}");
    (code, out, Log::open(&folder.join("run.mcap")).unwrap())
}

#[test]
fn a_live_run_ends_cleanly_on_either_signal() {
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        let folder = Folder::new();
        let (code, out, log) = interrupted(&folder, &["--for", "60"], &[signal]);
        assert_eq!(code, Some(0), "{signal}\n{out}");
        assert!(out.contains("ended by                   Ctrl-C"), "{signal}\n{out}");
        assert!(out.contains("faults                     none"), "{signal}\n{out}");
        assert!(log.damage().is_none(), "{signal}: {:?}", log.damage());
        assert!(log.end_s() >= 1.0 && log.end_s() < 60.0, "{signal}: ended at {}", log.end_s());
        let result = &log.metadata()[METADATA_RESULT]["summary"];
        let summary: serde_json::Value = serde_json::from_str(result).unwrap();
        assert_eq!(summary["interrupted"], true, "{signal}");
        for signal in ["sense.joints", "actuate.applied", "world.truth"] {
            assert!(log.find(signal).is_some_and(|id| log.messages().any(|m| m.channel == id)));
        }
    }
}

#[test]
fn a_run_in_virtual_time_ends_cleanly_too() {
    let folder = Folder::new();
    let (code, out, log) = interrupted(&folder, &["--fast", "--for", "86400"], &[Signal::SIGINT]);
    assert_eq!(code, Some(0), "{out}");
    assert!(out.contains("ended by                   Ctrl-C"), "{out}");
    assert!(log.damage().is_none(), "{:?}", log.damage());
}

#[test]
fn a_signal_that_arrives_twice_counts_once() {
    // `timeout` signals the process and then its group.
    let folder = Folder::new();
    let twice = [Signal::SIGTERM, Signal::SIGINT];
    let (code, out, log) = interrupted(&folder, &["--for", "60"], &twice);
    assert_eq!(code, Some(0), "{out}");
    assert!(out.contains("ended by                   Ctrl-C"), "{out}");
    assert!(log.damage().is_none(), "{:?}", log.damage());
}

#[test]
fn a_run_that_ends_by_itself_does_not_claim_to_be_interrupted() {
    let folder = Folder::new();
    let scene = scenes().join("roll-pin.toml");
    let arguments = ["run", scene.to_str().unwrap(), "--fast", "--for", "0.1"];
    let said = crate::process::taktil(folder.path(), &arguments).expect_code(0);
    assert!(!said.out.contains("ended by"), "{}", said.out);
}
