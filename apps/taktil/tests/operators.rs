//! Several operators at once at the socket of a rehearsal, in processes of their own: whatever they
//! ask for, each answer is the answer to its own request. A few seconds here; for a minute:
//! `TAKTIL_OPERATORS_S=60 cargo test --release -p taktil --test operators`.

use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use taktil_rtcore::{Nanos, linux};

/// A rehearsal that is ended with its test.
struct Rehearsal {
    child: Child,
    socket: PathBuf,
}

impl Rehearsal {
    fn start(name: &str) -> Rehearsal {
        let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes/hold.toml");
        let name = format!("taktil-operators-{}-{name}", std::process::id());
        let socket = std::env::temp_dir().join(name);
        let mut command = Command::new(env!("CARGO_BIN_EXE_taktil"));
        command.arg("rehearse").arg(scene).arg("--no-script").arg("--at").arg(&socket);
        let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let rehearsal = Rehearsal { child, socket };
        for _ in 0..1500 {
            let state = UnixStream::connect(&rehearsal.socket).ok().map(|stream| {
                let mut caller = BufReader::new(stream);
                ask(&mut caller, 0, "state")
            });
            if state.is_some_and(|state| state.contains("mode READY")) {
                return rehearsal;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("the rehearsal does not get ready");
    }
}

impl Drop for Rehearsal {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = std::fs::remove_file(&self.socket);
    }
}

fn ask(caller: &mut BufReader<UnixStream>, id: u64, words: &str) -> String {
    let line = format!("{{\"id\":{id},\"say\":\"{words}\"}}\n");
    caller.get_mut().write_all(line.as_bytes()).unwrap();
    let mut answer = String::new();
    caller.read_line(&mut answer).unwrap();
    answer
}

/// What one operator counted: answers that granted, refused by the table, refused for the lease.
#[derive(Debug, Default)]
struct Tally {
    granted: u64,
    refused: u64,
    elsewhere: u64,
}

/// Asks for one thing after the other for a while; each answer has to fit its own request.
fn operate(socket: &Path, number: u64, seconds: f64) -> Tally {
    let words = ["idle", "enable", "reset", "stop", "calibrate", "manual_uncalibrated", "state"];
    let mut caller = BufReader::new(UnixStream::connect(socket).unwrap());
    let mut tally = Tally::default();
    let end = linux::monotonic() + Nanos::from_millis((seconds * 1e3) as i64);
    let mut id = number * 1_000_000;
    while linux::monotonic() < end {
        id += 1;
        let word = words[(id.wrapping_mul(7919) % 7) as usize];
        let answer = ask(&mut caller, id, word);
        assert!(answer.contains(&format!("\"id\":{id},")), "{word}: {answer}");
        assert!(!answer.contains("does not answer"), "{word}: {answer}");
        if answer.contains("has control") {
            tally.elsewhere += 1;
            assert!(word != "stop" && word != "state", "{word}: {answer}");
        } else if answer.contains("\"outcome\":\"refused\"") {
            tally.refused += 1;
            let own = answer.contains(&format!("\"{word} is not possible"));
            assert!(own || answer.contains("a stop came first"), "{word}: {answer}");
        } else {
            tally.granted += 1;
            assert!(answer.contains("\"outcome\":\"ok\""), "{word}: {answer}");
        }
        if id.is_multiple_of(11) {
            ask(&mut caller, id, "control release");
        }
    }
    tally
}

fn operators_in_conflict(count: u64) {
    let seconds = std::env::var("TAKTIL_OPERATORS_S").ok().and_then(|s| s.parse().ok());
    let seconds = seconds.unwrap_or(3.0);
    let rehearsal = Rehearsal::start(&count.to_string());
    let socket = rehearsal.socket.as_path();
    let tallies: Vec<Tally> = std::thread::scope(|scope| {
        let operators: Vec<_> =
            (1..=count).map(|n| scope.spawn(move || operate(socket, n, seconds))).collect();
        operators.into_iter().map(|operator| operator.join().unwrap()).collect()
    });
    println!("{count} operators for {seconds} s: {tallies:?}");
    assert!(tallies.iter().all(|tally| tally.granted > 0), "{tallies:?}");
    assert!(tallies.iter().map(|tally| tally.refused).sum::<u64>() > 0, "{tallies:?}");
    assert!(tallies.iter().map(|tally| tally.elsewhere).sum::<u64>() > 0, "{tallies:?}");
}

#[test]
fn two_operators_in_conflict_get_their_own_answers() {
    operators_in_conflict(2);
}

#[test]
fn eight_operators_in_conflict_get_their_own_answers() {
    operators_in_conflict(8);
}

/// Runs a scene for two seconds, with a log or without, says `stop` in it, and returns the command
/// that repeats it.
fn repeat_of_a_stopped_run(name: &str, log: Option<&Path>) -> String {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes/hold.toml");
    let socket = std::env::temp_dir().join(format!("taktil-{}-{name}", std::process::id()));
    let mut command = Command::new(env!("CARGO_BIN_EXE_taktil"));
    command.arg("run").arg(scene).args(["--for", "2", "--json", "--operator"]).arg(&socket);
    command.args(log.map(|log| ["--log".as_ref(), log.as_os_str()]).into_iter().flatten());
    let child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let rehearsal = Rehearsal { child, socket };
    let connected = (0..1500).find_map(|_| {
        std::thread::sleep(Duration::from_millis(10));
        UnixStream::connect(&rehearsal.socket).ok()
    });
    let mut caller = BufReader::new(connected.expect("the run listens"));
    let answer = ask(&mut caller, 1, "stop");
    assert!(answer.contains("\"ok\""), "{answer}");
    let mut rehearsal = rehearsal;
    let mut text = String::new();
    rehearsal.child.stdout.take().unwrap().read_to_string(&mut text).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    summary["repeat"].as_str().unwrap().to_owned()
}

#[test]
fn what_an_operator_said_is_repeated_from_the_log_and_only_from_there() {
    let log = std::env::temp_dir().join(format!("taktil-{}-stopped.mcap", std::process::id()));
    let repeat = repeat_of_a_stopped_run("logged", Some(&log));
    let words: Vec<&str> = repeat.split(' ').collect();
    assert_eq!((words[0], words[1]), ("taktil", "replay"), "{repeat}");
    let replayed = Command::new(env!("CARGO_BIN_EXE_taktil")).args(&words[1..]).output().unwrap();
    let text = String::from_utf8_lossy(&replayed.stdout);
    assert_eq!(replayed.status.code(), Some(0), "{text}");
    std::fs::remove_file(&log).unwrap();
    assert_eq!(
        repeat_of_a_stopped_run("unlogged", None),
        "no command: an operator intervened, and there is no log (--log)"
    );
}
