//! The closing table of a live run and that of a run in virtual time: one seed gives one digest,
//! and with it the same rows but for those that are about time.
//!
//! `TAKTIL_TABLE_REPEATS=20 cargo test -p taktil --test cli closing_table` compares twenty of each.

use crate::process::{Folder, scenes, taktil};

/// How often each kind of run is repeated where nothing else is said.
const REPEATS_DEFAULT: usize = 2;
/// The variable that says otherwise.
const REPEATS_VARIABLE: &str = "TAKTIL_TABLE_REPEATS";

/// How rows begin that are about time: how long the run took and stood still, the lateness and the
/// budgets of the lanes, and the command that repeats the run, which says in which mode.
const ROWS_ABOUT_TIME: [&str; 7] = [
    "run  ",
    "the machine stalled",
    "p99 of budget",
    "over budget",
    "* not representative",
    "repeat  ",
    "next  ",
];

fn is_about_time(line: &str) -> bool {
    ROWS_ABOUT_TIME.iter().any(|begin| line.trim_start().starts_with(begin))
}

/// The rows that have to be equal. Of a lane these are its jobs, its allocations and page faults;
/// below it stand budgets and misses, which are about time, and what was lost, which is not.
fn rows(table: &str) -> Vec<String> {
    let mut rows = Vec::new();
    let mut is_in_lanes = false;
    for line in table.lines().filter(|line| !line.trim().is_empty()) {
        if line.starts_with("lanes ") {
            is_in_lanes = true;
            continue;
        }
        let indentation = line.len() - line.trim_start().len();
        let is_below_lane = is_in_lanes && indentation >= 4 && !line.contains(" lost");
        if is_about_time(line) || is_below_lane {
            continue;
        }
        let words: Vec<&str> = line.split_whitespace().collect();
        if is_in_lanes && indentation == 2 && words.iter().filter(|word| **word == "/").count() == 4
        {
            let [.., alloc, fault] = words[..] else { unreachable!("a lane has many words") };
            rows.push(format!("{} {} jobs, {alloc} alloc {fault} fault", words[0], words[1]));
            continue;
        }
        is_in_lanes &= indentation != 2;
        rows.push(line.to_owned());
    }
    rows
}

fn table(folder: &Folder, options: &[&str]) -> String {
    let scene = scenes().join("roll-pin.toml");
    let mut arguments = vec!["run", scene.to_str().unwrap(), "--for", "2"];
    arguments.extend(options);
    taktil(folder.path(), &arguments).expect_code(0).out
}

#[test]
fn live_and_fast_runs_of_one_digest_close_with_the_same_table_but_for_time() {
    let folder = Folder::new();
    let repeats = std::env::var(REPEATS_VARIABLE).ok().and_then(|text| text.parse().ok());
    let repeats = repeats.unwrap_or(REPEATS_DEFAULT).max(1);
    let first = rows(&table(&folder, &["--fast"]));
    assert!(first.len() >= 28, "{first:#?}");
    let has = |begin: &str| first.iter().any(|row| row.trim_start().starts_with(begin));
    for begin in ["state at", "M0, counts", "seed", "servo 800 jobs", "faults", "moves"] {
        assert!(has(begin), "{begin}: {first:#?}");
    }
    for repeat in 0..repeats {
        assert_eq!(rows(&table(&folder, &[])), first, "live, repeat {repeat}");
        assert_eq!(rows(&table(&folder, &["--fast"])), first, "fast, repeat {repeat}");
    }
    // The comparison can fail: another seed has another table.
    assert_ne!(rows(&table(&folder, &["--fast", "--seed", "2"])), first);
}
