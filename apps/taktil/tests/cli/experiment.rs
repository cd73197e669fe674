//! `taktil experiment`: missing scenes are named and change the exit code, and results before
//! Ctrl-C are kept. The figures are tested elsewhere.

use std::process::{Command, Stdio};
use std::time::Duration;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use crate::process::{Folder, Running, TAKTIL, scenes, taktil};

/// A folder `scenes` that holds only E1, a tenth of a second long.
fn only_e1() -> Folder {
    only_e1_of(0.1)
}

/// A folder `scenes` that holds only E1, so long.
fn only_e1_of(duration_s: f64) -> Folder {
    let folder = Folder::new();
    let text = std::fs::read_to_string(scenes().join("roll-pin.toml")).unwrap();
    let machine = std::fs::read_to_string(scenes().join("machine/puma260.toml")).unwrap();
    folder.write("puma260.toml", machine);
    let text = text
        .replace("machine/puma260.toml", "../puma260.toml")
        .replace("duration_s = 10.0", &format!("duration_s = {duration_s:?}"));
    std::fs::create_dir(folder.join("scenes")).unwrap();
    folder.write("scenes/roll-pin.toml", text);
    folder
}

#[test]
fn experiments_without_a_scene_are_named_and_cost_the_exit_code() {
    let folder = only_e1();
    let arguments = ["experiment", "chapter6", "--scenes", "scenes", "--seeds", "2"];
    let said = taktil(folder.path(), &arguments).expect_code(1);
    let lack = "not run: E2, E3, E4, E5, E6, E7, E8, E9: no scene in scenes";
    assert!(said.err.contains(lack), "{}", said.err);
    for report in ["chapter6/report.md", "chapter6/report.html"] {
        assert!(std::fs::read_to_string(folder.join(report)).unwrap().contains(lack), "{report}");
    }
    let rows = std::fs::read_to_string(folder.join("chapter6/runs.csv")).unwrap();
    let mut runs: Vec<&str> = rows.lines().skip(1).map(|row| &row[..row.len().min(12)]).collect();
    runs.sort_unstable();
    assert_eq!(runs.len(), 4, "two laws, two seeds:\n{rows}");
    assert!(runs[0].starts_with("E1,model,1,") && runs[3].starts_with("E1,thesis,2,"), "{runs:?}");
    let columns = rows.lines().map(|row| row.split(',').count());
    assert!(columns.clone().min() == columns.max(), "{rows}");

    let partial = folder.join("chapter6/partial.md");
    std::fs::write(&partial, "of an earlier interruption").unwrap();
    let named = [&arguments[..], &["--only", "e1"]].concat();
    taktil(folder.path(), &named).expect_code(0);
    assert!(!partial.exists(), "a whole report leaves nothing of it");
    let absent = [&arguments[..], &["--only", "E1,E3"]].concat();
    let said = taktil(folder.path(), &absent).expect_code(2);
    assert!(said.err.contains("--only E3: no scene in scenes"), "{}", said.err);
}

#[test]
fn results_before_an_interruption_are_reported() {
    let folder = only_e1();
    let mut command = Command::new(TAKTIL);
    command.args(["experiment", "chapter6", "--scenes", "scenes", "--seeds", "1000", "--only"]);
    command.args(["E1", "--law", "thesis", "--threads", "1"]).current_dir(folder.path());
    let child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut running = Running(child);
    let rows = || {
        let table = std::fs::read_to_string(folder.join("chapter6/partial.csv"));
        table.map_or(0, |text| text.lines().count().saturating_sub(1))
    };
    for _ in 0..3_000 {
        if rows() >= 2 {
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    let id = i32::try_from(running.0.id()).unwrap();
    kill(Pid::from_raw(id), Signal::SIGINT).unwrap();
    assert_eq!(running.wait().code(), Some(1));
    let report = std::fs::read_to_string(folder.join("chapter6/partial.md")).unwrap();
    let told = format!("interrupted: {} of 1000 runs were done", rows());
    assert!(report.contains(&told) && rows() >= 2, "{told}\n{report}");
}

/// Ends what runs in `folder` once its table has two rows.
fn interrupt_after_two_rows(folder: &Folder, arguments: &[&str]) {
    let mut command = Command::new(TAKTIL);
    command.args(arguments).args(["--threads", "1"]).current_dir(folder.path());
    let child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut running = Running(child);
    for _ in 0..3_000 {
        let table = std::fs::read_to_string(folder.join("campaign/partial.csv"));
        if table.is_ok_and(|text| text.lines().count() > 2) {
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    let id = i32::try_from(running.0.id()).unwrap();
    kill(Pid::from_raw(id), Signal::SIGINT).unwrap();
    assert_eq!(running.wait().code(), Some(1));
}

#[test]
fn an_interrupted_campaign_goes_on_and_ends_as_one_that_was_not() {
    let folder = only_e1();
    let arguments = ["experiment", "campaign", "scenes", "--law", "thesis,model", "--seeds", "60"];
    interrupt_after_two_rows(&folder, &arguments);
    let other = [&arguments[..6], &["59"]].concat();
    let said = taktil(folder.path(), &other).expect_code(2);
    assert!(said.err.contains("another campaign that was interrupted"), "{}", said.err);
    let machine = std::fs::read_to_string(folder.join("puma260.toml")).unwrap();
    folder.write("puma260.toml", format!("{machine}\n# Changed between the two.\n"));
    let said = taktil(folder.path(), &arguments).expect_code(2);
    assert!(said.err.contains("another campaign that was interrupted"), "{}", said.err);
    folder.write("puma260.toml", machine);
    let said = taktil(folder.path(), &arguments).expect_code(0);
    assert!(said.err.contains("of 120 runs were done before"), "{}", said.err);
    assert!(!folder.join("campaign/partial.csv").exists());

    let whole = [&arguments[..], &["--out", "whole"]].concat();
    taktil(folder.path(), &whole).expect_code(0);
    for name in ["runs.csv", "runs.json"] {
        let read = |from: &str| std::fs::read_to_string(folder.join(from).join(name)).unwrap();
        assert_eq!(read("campaign"), read("whole"), "{name}");
    }
    let page = std::fs::read_to_string(folder.join("campaign/campaign.md")).unwrap();
    assert!(page.contains("model - thesis: mean [95 %]"), "{page}");
}

#[test]
fn the_worst_seed_comes_with_the_command_that_repeats_it() {
    let folder = only_e1_of(2.5);
    let arguments = ["experiment", "campaign", "scenes", "--law", "model", "--seeds", "2"];
    taktil(folder.path(), &arguments).expect_code(0);
    let page = std::fs::read_to_string(folder.join("campaign/campaign.md")).unwrap();
    let worst = page.lines().find(|line| line.starts_with("Worst seed of `model`"));
    let worst = worst.unwrap_or_else(|| panic!("{page}"));
    let command = worst.split('`').nth(3).unwrap().trim_start_matches("taktil ");
    let repeat: Vec<&str> = command.split(' ').collect();
    assert_eq!(repeat[..4], ["experiment", "held", "scenes/roll-pin.toml", "--law"]);
    let said = taktil(folder.path(), &[&repeat[..], &["--csv", "again.csv"]].concat());
    assert!(said.out.contains("| roll-pin |"), "{}", said.out);
    let row = |name: &str| {
        let text = std::fs::read_to_string(folder.join(name)).unwrap();
        let line = text.lines().find(|line| line.contains(&format!(",{},", repeat[6])));
        line.map(str::to_owned).unwrap()
    };
    assert_eq!(row("again.csv"), row("campaign/runs.csv"));
}
