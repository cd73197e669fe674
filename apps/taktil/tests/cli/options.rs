//! Invalid options: exit code 2, a message with the option and the reason, and no files left. No
//! option is silently ignored.

use crate::process::{Folder, ProcessOutput, scenes, taktil};

fn run(folder: &Folder, options: &[&str]) -> ProcessOutput {
    let scene = scenes().join("roll-pin.toml");
    let mut arguments = vec!["run", scene.to_str().unwrap(), "--fast"];
    arguments.extend(options);
    taktil(folder.path(), &arguments)
}

#[test]
fn numbers_that_cannot_be_meant_are_refused() {
    let folder = Folder::new();
    for options in [
        &["--for", "0"][..],
        &["--for", "-1"],
        &["--for", "nan"],
        &["--for", "inf"],
        &["--for", "1e300"],
        &["--for", "soon"],
        &["--for", ""],
        &["--for"],
        &["--seed", "-1"],
        &["--seed", "abc"],
        &["--seed", "1.5"],
        &["--seed", "18446744073709551616"],
        &["--fasst"],
    ] {
        let said = run(&folder, options).expect_code(2);
        assert!(said.err.starts_with("error: "), "{options:?}: {}", said.err);
        assert!(said.err.contains(options[0]) || said.err.contains("'-1'"), "{}", said.err);
        assert_eq!(said.out, "", "{options:?}");
    }
    assert_eq!(folder.listing(), []);
}

#[test]
fn a_report_onto_a_file_is_refused_and_the_file_stays() {
    let folder = Folder::new();
    let file = folder.write("out", "precious");
    let said = run(&folder, &["--for", "0.05", "--report", "out"]).expect_code(2);
    assert!(said.err.contains("--report out: is a file"), "{}", said.err);
    assert_eq!(std::fs::read_to_string(file).unwrap(), "precious");
}

#[test]
fn places_that_cannot_be_written_end_the_run_before_it_starts() {
    let folder = Folder::new();
    folder.write("file", "");
    for options in
        [&["--log", "no/such/folder/run.mcap"][..], &["--log", "."], &["--report", "file/under"]]
    {
        let mut all = vec!["--for", "0.05"];
        all.extend(options);
        let said = run(&folder, &all);
        assert!(said.code.is_some_and(|code| code != 0), "{options:?}: {}", said.err);
        assert!(said.err.starts_with("error: ") && said.err.contains(options[1]), "{}", said.err);
        assert_eq!(said.out, "", "{options:?}: it ran all the same");
    }
}

#[test]
fn places_that_cannot_be_written_are_bad_input() {
    let folder = Folder::new();
    folder.write("file", "");
    for options in [["--log", "no/such/run.mcap"], ["--log", "."], ["--report", "file/under"]] {
        run(&folder, &options).expect_code(2);
    }
}

#[test]
fn a_log_does_not_replace_the_scene() {
    let folder = Folder::new();
    let machine = scenes().join("machine/puma260.toml").display().to_string();
    let text = format!("title = \"precious\"\nmachine = \"{machine}\"\nduration_s = 0.05\n");
    let scene = folder.write("scene.toml", &text);
    let path = scene.to_str().unwrap();
    taktil(folder.path(), &["run", path, "--fast", "--log", path]).expect_code(2);
    assert_eq!(std::fs::read_to_string(&scene).unwrap(), text);
}

#[test]
fn a_bad_wiring_makes_no_folder_for_its_report() {
    let folder = Folder::new();
    let machine = scenes().join("machine/puma260.toml").display().to_string();
    let text = format!(
        "title = \"x\"\nmachine = \"{machine}\"\n[robot.wiring]\n\"setpoint.joints\" = \"a.b\"\n"
    );
    let scene = folder.write("scene.toml", text);
    let arguments = ["run", scene.to_str().unwrap(), "--fast", "--report", "out"];
    taktil(folder.path(), &arguments).expect_code(2);
    assert!(!folder.join("out").exists());
}

#[test]
fn wrong_usage_is_answered_with_the_usage() {
    let folder = Folder::new();
    for arguments in [&[][..], &["run"], &["walk"], &["plot"]] {
        let said = taktil(folder.path(), arguments).expect_code(2);
        assert!(said.err.contains("Usage:"), "{arguments:?}: {}", said.err);
    }
    let help = taktil(folder.path(), &["--help"]).expect_code(0);
    for word in ["run", "plot", "calc", "--fast", "Exit codes: 0 ok"] {
        assert!(help.out.contains(word), "`{word}` is not in the help");
    }
    let version = taktil(folder.path(), &["--version"]).expect_code(0);
    let words: Vec<&str> = version.out.split_whitespace().collect();
    assert_eq!(words[..2], ["taktil", env!("CARGO_PKG_VERSION")], "{}", version.out);
    // In a clone the commit follows.
    let commit = words.get(2).map(|word| word.trim_matches(['(', ')']));
    let is_hex = |commit: &str| commit.len() >= 12 && commit.bytes().all(|b| b.is_ascii_hexdigit());
    assert!(commit.is_none_or(is_hex) && words.len() <= 3, "{}", version.out);
}

#[test]
fn experiments_that_do_not_exist_are_refused_and_nothing_is_written() {
    let folder = Folder::new();
    let scenes = scenes();
    let scenes = scenes.to_str().unwrap();
    for options in [
        &["chapter6", "--law", "wish"][..],
        &["chapter6", "--law", ""],
        &["chapter6", "--seeds", "0"],
        &["chapter6", "--seeds", "1001"],
        &["chapter6", "--only", "E10"],
        &["chapter6", "--threads", "0"],
        &["chapter6", "--scenes", "nowhere"],
        &["robust", "--draws", "0"],
        &["robust", "--law", "wish"],
        &["robust", "--scene", "nowhere.toml"],
    ] {
        let mut arguments = vec!["experiment"];
        arguments.extend(options);
        if !options.contains(&"--scenes") && options[0] == "chapter6" {
            arguments.extend(["--scenes", scenes]);
        }
        let said = taktil(folder.path(), &arguments).expect_code(2);
        assert!(!said.err.is_empty(), "{options:?}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
