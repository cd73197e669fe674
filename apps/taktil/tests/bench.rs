//! `taktil bench` on the command line. Instructions are counted and checked, times are not. Without
//! callgrind a test prints that it was skipped.

use std::process::{Command, Output};

use serde_json::Value;

fn bench(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_taktil")).arg("bench").args(arguments).output().unwrap()
}

fn parsed(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout);
    serde_json::from_str(&text).unwrap_or_else(|error| {
        panic!("{error}: {text}\n{}", String::from_utf8_lossy(&output.stderr))
    })
}

fn counter() -> bool {
    let there = Command::new("valgrind").arg("--version").output().is_ok();
    if !there {
        taktil_tests_script::report_skip("instructions of a job: no valgrind here");
    }
    there
}

#[test]
fn a_job_does_the_same_work_for_no_reader_and_for_eight() {
    if !counter() {
        return;
    }
    let output = bench(&["readers", "--json"]);
    assert!(output.status.success(), "{output:?}");
    let found = parsed(&output);
    let count = |name: &str| found["instructions_a_job"][name].as_f64().unwrap();
    assert!(count("none") > 100.0, "{found}");
    assert!((count("eight") - count("none")).abs() <= 0.01 * count("none"), "{found}");
    // The count can differ: a ring that is never emptied changes it.
    assert!((count("abandoned") - count("none")).abs() > 0.01 * count("none"), "{found}");
}

#[test]
fn every_chain_is_timed_and_a_hop_costs_something() {
    let output = bench(&["executor", "--cycles", "500", "--slices", "3", "--json"]);
    assert!(output.status.success(), "{output:?}");
    let found = parsed(&output);
    let chains = found["chains"].as_array().unwrap();
    assert_eq!(chains.len(), 12);
    for chain in chains {
        assert_eq!(chain["slices"], 3);
        assert!(chain["cycle_ns"]["p50"].as_f64().unwrap() > 0.0, "{chain}");
        assert_eq!(chain["hop_ns"].is_null(), chain["hops"] == 0, "{chain}");
        assert!(chain["cycle_instructions"].is_null(), "nobody asked");
    }
}

#[test]
fn tables_of_contact_are_also_printed_as_json() {
    let output = bench(&["contact", "--no-timing", "--json"]);
    assert!(output.status.success(), "{output:?}");
    let rows = parsed(&output)["tables"][0]["rows"].as_array().unwrap().clone();
    assert!(rows.len() > 20, "{rows:?}");
    assert!(rows.iter().all(|row| row["statement"].is_string() && !row["exact layer"].is_null()));
    let text = format!("{rows:?}");
    for id in 1..=12 {
        assert!(text.contains(&format!("C{id} ")), "C{id} has a row: {text}");
    }
    // The half plane has its name in the table, and an absent value is empty.
    assert!(text.contains("half plane: largest p"), "{text}");
    assert!(!text.contains("0.0e0") && !text.contains("1000000000"), "{text}");
}

#[test]
fn impossible_measurements_are_rejected() {
    for arguments in [
        ["executor", "--cycles", "0"],
        ["executor", "--slices", "0"],
        ["executor", "--cycles", "99999999"],
        ["executor", "--cycles", "many"],
        ["executor", "--cycles", "-1"],
    ] {
        assert_eq!(bench(&arguments).status.code(), Some(2), "{arguments:?}");
    }
}

/// Scenes without contact are errors before anything long is measured.
#[test]
fn scenes_without_touch_are_refused_by_name() {
    let scenes = concat!(env!("CARGO_MANIFEST_DIR"), "/../../sim/scenes");
    for (scene, span, said) in
        [("ur5e-lines", "0.1", "this arm touches nothing"), ("hold", "0.1", "never presses")]
    {
        let path = format!("{scenes}/{scene}.toml");
        let output =
            bench(&["sim", "--only", "scenes", "--rounds", "1", "--for", span, "--scenes", &path]);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(text.contains(&format!("{scene}: ")) && text.contains(said), "{text}");
    }
}
