//! Outputs that fail before the program has written everything: a reader that has closed its pipe,
//! and a full disk. The program does not panic, and the failure of one output does not lose
//! another.

use std::fs::File;
use std::process::{Command, Output, Stdio};

use taktil_record::Log;

use crate::process::{Folder, ProcessOutput, TAKTIL, scenes};

/// Commands that print something, on the rolling scene where they need one.
fn printing_commands() -> Vec<Vec<String>> {
    let scene = scenes().join("roll-pin.toml").display().to_string();
    let arm = scenes().join("../arms/ur5e-like.urdf").display().to_string();
    let words = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect();
    vec![
        words(&["calc", "--list"]),
        words(&["keys", "--list"]),
        words(&["scene", "--schema"]),
        words(&["scene", "check", &scene]),
        words(&["arm", &arm, "--poses", "1"]),
        words(&["run", &scene, "--plan"]),
        words(&["run", &scene, "--fast", "--for", "0.1"]),
        words(&["run", &scene, "--fast", "--for", "0.1", "--json"]),
        words(&["sim", "hash", &scene, "--for", "0.01", "--seeds", "3"]),
        words(&["run", "--help"]),
    ]
}

fn run(folder: &Folder, words: &[String], out: Stdio, err: Stdio) -> Output {
    let mut command = Command::new(TAKTIL);
    command.args(words).current_dir(folder.path()).stdin(Stdio::null()).stdout(out).stderr(err);
    command.spawn().unwrap().wait_with_output().unwrap()
}

/// A pipe whose reader is gone.
fn closed_pipe() -> Stdio {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    writer.into()
}

#[test]
fn a_closed_pipe_is_no_error() {
    let folder = Folder::new();
    for words in printing_commands() {
        let said = ProcessOutput::of(&run(&folder, &words, closed_pipe(), Stdio::piped()));
        assert_eq!(said.code, Some(0), "{words:?}: {}", said.err);
        let silent = run(&folder, &words, Stdio::piped(), closed_pipe());
        assert_eq!(silent.status.code(), Some(0), "{words:?} with nobody at standard error");
        assert!(!silent.stdout.is_empty(), "{words:?}");
    }
}

#[test]
fn a_full_disk_is_one_error_in_words() {
    let folder = Folder::new();
    for words in printing_commands().into_iter().filter(|words| words[1] != "--help") {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let said =
            ProcessOutput::of(&run(&folder, &words, full.into(), Stdio::piped())).expect_code(1);
        let last = said.err.lines().last().unwrap_or_default();
        assert!(last.starts_with("error: the output cannot be written: "), "{words:?}: {last}");
    }
}

#[test]
fn a_log_that_grows_too_big_costs_neither_the_table_nor_what_was_written() {
    let folder = Folder::new();
    let scene = scenes().join("roll-pin.toml").display().to_string();
    // After half a megabyte the kernel rejects further writes.
    let shell = "trap '' XFSZ; ulimit -f 1000; exec \"$0\" run \"$1\" --fast --for 1 --log a.mcap";
    let mut command = Command::new("sh");
    command.args(["-c", shell, TAKTIL, &scene]).current_dir(folder.path()).stdin(Stdio::null());
    let said = ProcessOutput::of(&command.output().unwrap()).expect_code(1);
    assert!(said.err.contains("error: the log a.mcap is incomplete: "), "{}", said.err);
    assert!(said.err.contains("what was written can be read"), "{}", said.err);
    assert!(said.out.contains("digest"), "{}", said.out);
    let log = Log::open(&folder.join("a.mcap")).unwrap();
    assert!(log.damage().is_some() && log.messages().count() > 100);
}

#[test]
fn a_device_that_never_ends_is_no_log() {
    let folder = Folder::new();
    for words in [&["plot", "/dev/zero"][..], &["diff", "/dev/zero", "/dev/zero"]] {
        let said = crate::process::taktil(folder.path(), words).expect_code(2);
        assert!(said.err.contains("it is a device"), "{}", said.err);
    }
    let said = crate::process::taktil(folder.path(), &["postmortem", "/dev/zero"]).expect_code(2);
    assert!(said.err.contains("it is a device"), "{}", said.err);
}
