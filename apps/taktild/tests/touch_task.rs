//! A touch task in a file of its own, named by the service's configuration or by its machine file.

mod process;

use std::path::{Path, PathBuf};

use process::{Folder, Rig, check};

const TASK: &str = "[[phase]]\nname = \"seek\"\ndoes = \"approach\"\n\
                    velocity_per_s = [0.0, 0.0, 6.0, 0.0, 0.0, 0.0]\n\
                    until = [{ quantity = \"contact\" }]\nwithin_mm = 60.0\nthen = \"end\"\n\
                    else = \"end\"\n";

/// A configuration whose `[robot.tactile_servo]` names `task.toml`, which says `task`.
fn config(folder: &Folder, task: &str) -> PathBuf {
    std::fs::write(folder.join("task.toml"), task).unwrap();
    let path = folder.config("soft");
    let mut text = std::fs::read_to_string(&path).unwrap();
    text.push_str("\n[robot.tactile_servo]\nlaw = \"phases\"\ntask_file = \"task.toml\"\n");
    std::fs::write(&path, text).unwrap();
    path
}

/// What `--check` says, and its exit code.
fn checked(path: &Path) -> (Option<i32>, String) {
    let output = check(path);
    let text = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8_lossy(&text).into_owned())
}

#[test]
fn a_task_beside_the_configuration_is_read_and_refused_at_its_own_place() {
    let folder = Folder::new();
    let _rig = Rig::new(&folder);
    let (code, text) = checked(&config(&folder, TASK));
    assert_eq!(code, Some(0), "{text}");

    let wrong = TASK.replace("\"approach\"", "\"aproach\"");
    let (code, text) = checked(&config(&folder, &wrong));
    assert_eq!(code, Some(2), "{text}");
    assert!(text.contains("task.toml:3:"), "{text}");

    let path = config(&folder, TASK);
    std::fs::remove_file(folder.join("task.toml")).unwrap();
    let (code, text) = checked(&path);
    assert_eq!(code, Some(2), "{text}");
    assert!(text.contains("tactile_servo.task_file"), "{text}");
}
