//! What an installed program has to do without the repository beside it: find its scenes, machine
//! files and arms, and write its manual pages and completions.

use std::path::Path;

use crate::process::{Folder, scenes, taktil};

/// The digest of a short run of a scene that is named so in this folder.
fn digest(folder: &Path, scene: &str) -> String {
    let said = taktil(folder, &["run", scene, "--fast", "--for", "0.05", "--json"]).expect_code(0);
    let summary: serde_json::Value = serde_json::from_str(&said.out).unwrap();
    summary["digest"].as_str().unwrap().to_owned()
}

#[test]
fn a_scene_is_found_by_name_and_by_path_from_any_folder_and_runs_the_same() {
    let folder = Folder::new();
    let on_disk = digest(folder.path(), scenes().join("roll-pin.toml").to_str().unwrap());
    for name in ["roll-pin", "sim/scenes/roll-pin.toml"] {
        assert_eq!(digest(folder.path(), name), on_disk, "{name}");
    }
    // Scenes with a machine, an arm and a table of motion of their own.
    let checked =
        ["scene", "check", "ur5e-lines", "seven-lines", "held/light", "two-fingers/askew"];
    taktil(folder.path(), &checked).expect_code(0);
    assert!(folder.listing().is_empty(), "{:?}", folder.listing());
}

#[test]
fn every_scene_that_the_program_holds_can_be_run_from_any_folder() {
    let folder = Folder::new();
    for file in std::fs::read_dir(scenes()).unwrap() {
        let path = file.unwrap().path();
        let Some("toml") = path.extension().and_then(|ending| ending.to_str()) else { continue };
        let name = path.file_stem().unwrap().to_str().unwrap();
        taktil(folder.path(), &["scene", "check", name]).expect_code(0);
    }
}

#[test]
fn a_file_on_disk_wins_and_a_scene_of_ones_own_names_machines_of_the_program() {
    let folder = Folder::new();
    let own = "title = \"mine\"\nmachine = \"machine/puma260.toml\"\nduration_s = 0.1\nseed = 1\n";
    folder.write("roll-pin.toml", own);
    let mine = taktil(folder.path(), &["scene", "check", "roll-pin.toml"]).expect_code(0);
    assert_eq!(mine.out, "ok  roll-pin.toml: mine\n");
    std::fs::create_dir(folder.join("machine")).unwrap();
    folder.write("machine/puma260.toml", "[lane.servo]\nperiod_us = 0\n");
    let spoiled = taktil(folder.path(), &["scene", "check", "roll-pin.toml"]).expect_code(2);
    assert!(spoiled.err.contains("machine/puma260.toml:"), "{}", spoiled.err);
    let unknown = taktil(folder.path(), &["scene", "check", "roll-pins"]).expect_code(2);
    assert!(unknown.err.contains("there is no file `roll-pins`"), "{}", unknown.err);
}

#[test]
fn scenes_are_listed_shown_and_copied_with_all_that_they_name() {
    let folder = Folder::new();
    let list = taktil(folder.path(), &["scene", "list"]).expect_code(0).out;
    for name in ["roll-pin ", "held/light ", "seven-lines "] {
        assert!(list.lines().any(|line| line.starts_with(name)), "no `{name}` in\n{list}");
    }
    let shown = taktil(folder.path(), &["scene", "show", "seven-lines"]).expect_code(0).out;
    assert_eq!(shown, std::fs::read_to_string(scenes().join("seven-lines.toml")).unwrap());
    for line in list.lines() {
        let name = line.split(' ').next().unwrap();
        taktil(folder.path(), &["scene", "copy", name, "mine"]).expect_code(0);
        let own = format!("mine/sim/scenes/{name}.toml");
        taktil(folder.path(), &["scene", "check", &own]).expect_code(0);
    }
    folder.write("mine/sim/scenes/machine/puma260.toml", "# Changed by hand.\n");
    let refused = taktil(folder.path(), &["scene", "copy", "roll-pin", "mine"]).expect_code(2);
    assert!(refused.err.contains("puma260.toml exists and differs"), "{}", refused.err);
    taktil(folder.path(), &["scene", "show", "nowhere"]).expect_code(2);
    taktil(folder.path(), &["scene", "copy", "nowhere"]).expect_code(2);
}

#[test]
fn manual_pages_and_completions_hold_every_subcommand() {
    let folder = Folder::new();
    taktil(folder.path(), &["manual", "man"]).expect_code(0);
    for page in ["taktil.1", "taktil-run.1", "taktil-hal-emulate.1", "taktild.8", "taktil-safe.8"] {
        let text = std::fs::read_to_string(folder.join("man").join(page)).unwrap();
        assert!(text.contains(".TH") && text.contains(".SH SYNOPSIS"), "{page}:\n{text}");
    }
    assert!(!folder.join("man/taktil-manual.1").exists(), "hidden commands have no page");
    for (shell, says) in
        [("bash", "complete -F"), ("zsh", "#compdef taktil"), ("fish", "complete -c taktil")]
    {
        let text = taktil(folder.path(), &["completions", shell]).expect_code(0).out;
        for word in [says, "emulate", "postmortem", "fast"] {
            assert!(text.contains(word), "{shell}: no `{word}`");
        }
    }
    taktil(folder.path(), &["completions", "csh"]).expect_code(2);
}
