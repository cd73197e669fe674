//! Whatever stands in the service's configuration and in its machine file: `taktild --check`
//! refuses it in a few words with place and remedy, or takes it.

#[path = "../../taktil/tests/hostile/content.rs"]
mod content;
#[path = "../../taktil/tests/hostile/draws.rs"]
mod draws;
mod process;
#[path = "../../taktil/tests/hostile/texts.rs"]
#[expect(dead_code, reason = "other tests use more of it")]
mod texts;

use std::path::Path;

use content::{Content, Verdict, judge, remove};
use process::{Folder, NO_FLIGHT, Rig};

/// The machine file of the service's own configuration.
const MACHINE: &str = include_str!("../../../sim/scenes/machine/puma260.toml");

/// Checks a configuration whose machine file is `machine.toml`; what is wrong with the answer.
fn complaint(folder: &Folder, name: &str, verdict: Verdict) -> Option<String> {
    let output = process::check(&folder.join("taktild.toml"));
    let found = judge(&output, verdict)?;
    let said = String::from_utf8_lossy(&output.stderr);
    Some(format!("{name}: {found}\n{}", said.chars().take(400).collect::<String>()))
}

fn config(folder: &Folder) -> String {
    let board = folder.join("board.bin").display().to_string();
    let socket = folder.join("operator.sock").display().to_string();
    format!(
        "machine = \"machine.toml\"\ncontract = \"soft\"\n\n[board]\npath = \"{board}\"\n\
         {NO_FLIGHT}\n[log]\npath = \"run.mcap\"\nrotate_mb = 256\nbudget_mb = 4096\n\
         queue_mb = 8\n\n[operator]\nsocket = \"{socket}\"\n"
    )
}

fn survive(complaints: &[String], count: usize) {
    assert!(complaints.is_empty(), "{} of {count}:\n{}", complaints.len(), complaints.join("\n\n"));
}

#[test]
fn configurations_are_taken_or_refused() {
    let folder = Folder::new();
    let rig = Rig::new(&folder);
    let text = config(&folder);
    std::fs::write(folder.join("machine.toml"), MACHINE).unwrap();
    std::fs::write(folder.join("taktild.toml"), &text).unwrap();
    assert_eq!(complaint(&folder, "as it is", Verdict::Any), None);
    assert!(process::check(&folder.join("taktild.toml")).status.success());
    let mut complaints = Vec::new();
    let mut inputs: Vec<(String, Content, Verdict)> = Vec::new();
    for (name, content) in texts::no_files() {
        inputs.push((name.to_owned(), content, Verdict::Refused));
    }
    for (name, bytes, verdict) in texts::toml_kinds(&text) {
        inputs.push((name, Content::Bytes(bytes), verdict));
    }
    for (name, text) in texts::hostile_values(&text, 6, 51) {
        inputs.push((name, Content::Bytes(text.into_bytes()), Verdict::Any));
    }
    let count = inputs.len();
    for (name, content, verdict) in inputs {
        remove(&folder.join("taktild.toml"));
        content.write(&folder.join("taktild.toml"));
        complaints.extend(complaint(&folder, &name, verdict));
    }
    survive(&complaints, count);
    drop(rig);
}

#[test]
fn machine_files_are_taken_or_refused() {
    let folder = Folder::new();
    let rig = Rig::new(&folder);
    std::fs::write(folder.join("taktild.toml"), config(&folder)).unwrap();
    let machine = folder.join("machine.toml");
    let mut complaints = Vec::new();
    let mut count = 0;
    let mut try_it = |name: &str, content: &Content, verdict| {
        remove(&machine);
        content.write(&machine);
        count += 1;
        complaints.extend(complaint(&folder, name, verdict));
    };
    for (name, content) in texts::no_files() {
        try_it(name, &content, Verdict::Refused);
    }
    for (name, text) in texts::hostile_values(MACHINE, 2, 52) {
        try_it(&name, &Content::Bytes(text.into_bytes()), Verdict::Any);
    }
    survive(&complaints, count);
    drop(rig);
}

#[test]
fn the_name_of_the_configuration_may_be_anything() {
    let long = "n".repeat(5_000);
    for name in ["", "\u{1b}[2J", ".", "/", "/proc/self/mem", &long] {
        let output = process::check(Path::new(name));
        assert_eq!(judge(&output, Verdict::Refused), None, "{name}");
    }
}
