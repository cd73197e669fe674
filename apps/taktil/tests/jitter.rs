//! `taktil jitter` on the command line: its output, its errors and its files. The lateness of this
//! machine is not tested.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

/// A folder of its own for each test.
fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("jitter-{name}"));
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).unwrap();
    path
}

fn jitter(path: &str, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_taktil"))
        .arg("jitter")
        .args(arguments)
        .env("PATH", path)
        .output()
        .unwrap()
}

fn parsed(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout);
    serde_json::from_str(&text).unwrap_or_else(|error| {
        panic!("{error}: {text}\n{}", String::from_utf8_lossy(&output.stderr))
    })
}

#[test]
fn two_lanes_are_measured_and_nothing_is_left_out_of_the_account() {
    let svg = folder("lanes").join("late.svg");
    let arguments = [
        "--rate-hz",
        "400,200",
        "--for",
        "0.5",
        "--guard",
        "--json",
        "--svg",
        svg.to_str().unwrap(),
    ];
    let output = jitter("", &arguments);
    assert!(output.status.success(), "{output:?}");
    let found = parsed(&output);
    let lanes = found["lanes"].as_array().unwrap();
    assert_eq!(lanes.len(), 2);
    for (lane, due) in lanes.iter().zip([200, 100]) {
        let (jobs, skipped) = (lane["jobs"].as_u64().unwrap(), lane["skipped"].as_u64().unwrap());
        assert_eq!(jobs + skipped, due, "{lane}");
        assert_eq!(lane["release_late_us"]["count"], jobs);
        assert_eq!(lane["guard"]["early"], 0);
        assert_eq!(lane["allocations"], 0);
    }
    assert_eq!(found["cyclictest"], Value::Null);
    let grants = found["attested"]["lanes"].as_array().unwrap();
    assert_eq!(grants.len(), 2);
    assert!(grants.iter().all(|lane| lane["policy"].is_string()));
    assert!(found["attested"]["facts"]["VmRSS KiB"].is_string());
    let trusted = found["representative_timing"].as_bool().unwrap();
    let banner = found["banner"].as_array().unwrap();
    assert_eq!(trusted, banner.is_empty(), "figures are either representative or marked");
    let picture = fs::read_to_string(svg).unwrap();
    assert_eq!(trusted, !picture.contains("NOT A ROBOT"));
    assert!(picture.contains("200 Hz: release lateness"));
}

#[test]
fn the_table_names_what_it_cannot_show() {
    let output = jitter("", &["--for", "0.3", "--load"]);
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8_lossy(&output.stdout);
    for words in [
        "400 Hz: release late",
        "executor, a cycle",
        "with evidence read",
        "p99.99",
        "grade: ",
        "under load",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
    let json = parsed(&jitter("", &["--for", "0.1", "--json"]));
    let marked = text.contains("NOT A ROBOT'S FIGURES");
    assert_eq!(marked, !json["banner"].as_array().unwrap().is_empty());
    // The output is not a terminal, so it has no colours.
    assert!(!text.contains('\x1b'));
}

#[test]
fn invalid_options_end_with_exit_code_2() {
    for (line, word) in [
        ("--rate-hz=0", "--rate-hz"),
        ("--rate-hz=nan", "--rate-hz"),
        ("--for=-3", "--for"),
        ("--for=nan", "--for"),
        ("--for=1e12", "--for"),
        ("--priority=0", "--priority"),
        ("--priority=100", "--priority"),
        ("--cpu=99999", "--cpu"),
        ("--guard=0.7", "--guard"),
        ("--cyclictest --for=3", "--for"),
        ("--cyclictest --rate-hz=400,200 --for=20", "--rate-hz"),
    ] {
        let words: Vec<&str> = line.split(' ').collect();
        let output = jitter("", &words);
        assert_eq!(output.status.code(), Some(2), "{words:?}");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(stderr.contains(word), "{words:?}: {stderr}");
    }
}

#[test]
fn without_the_binary_there_is_a_word_and_exit_2() {
    let empty = folder("empty");
    let output = jitter(empty.to_str().unwrap(), &["--cyclictest", "--for", "20"]);
    assert_eq!(output.status.code(), Some(2));
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(stderr.contains("rt-tests"), "{stderr}");
    assert!(output.stdout.is_empty());
}

/// A substitute for cyclictest that runs this script and records its arguments.
fn stand_in(name: &str, script: &str) -> PathBuf {
    let folder = folder(name);
    let path = folder.join("cyclictest");
    fs::write(&path, format!("#!/bin/sh\n[ \"$1\" = --help ] && exit 0\n{script}\n")).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    folder
}

#[test]
fn slices_alternate_and_controls_stand_side_by_side() {
    let folder = stand_in(
        "pairs",
        "echo \"$@\" >> \"$(dirname \"$0\")/calls\"\n\
         echo '# Histogram'; echo '000040 000100'; echo '# Max Latencies: 00040'\n\
         echo '# Histogram Overflows: 00000'",
    );
    let path = format!("{}:/usr/bin:/bin", folder.display());
    let arguments = [
        "--cyclictest",
        "--for",
        "1.2",
        "--slice",
        "0.2",
        "--priority",
        "70",
        "--cpu",
        "0",
        "--json",
    ];
    let output = jitter(&path, &arguments);
    assert!(output.status.success(), "{output:?}");
    let found = parsed(&output);
    let theirs = &found["cyclictest"];
    assert_eq!(theirs["ours_over_theirs"]["pairs"], 3);
    assert_eq!(theirs["theirs_over_itself"]["pairs"], 1);
    assert_eq!(theirs["late_us"]["count"], 300);
    let control = theirs["theirs_over_itself"]["of"]["p99"]["median"].as_f64().unwrap();
    assert!((control - 1.0).abs() < 1e-9, "the same script beside itself: {control}");
    let calls = fs::read_to_string(folder.join("calls")).unwrap();
    assert_eq!(calls.lines().count(), 3);
    for words in ["-p 70", "-i 2500", "-a 0", "-l 80", "-m"] {
        assert!(calls.contains(words), "{words}: {calls}");
    }
}

#[test]
fn a_cyclictest_that_fails_is_a_failure_with_its_words() {
    let folder = stand_in("broken", "echo 'no rights' >&2; exit 3");
    let path = format!("{}:/usr/bin:/bin", folder.display());
    let output = jitter(&path, &["--cyclictest", "--for", "0.4", "--slice", "0.2"]);
    assert_eq!(output.status.code(), Some(1));
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(stderr.contains("no rights"), "{stderr}");
    let folder = stand_in("mute", "exit 0");
    let path = format!("{}:/usr/bin:/bin", folder.display());
    let output = jitter(&path, &["--cyclictest", "--for", "0.4", "--slice", "0.2"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("no histogram"));
}
