//! A live run without rights: it states in one line that it is not real time, marks every timing
//! figure, runs the simulated robot and ends with exit code 0. Where the test cannot change its
//! user, it prints that it was skipped.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::process::{Folder, ProcessOutput, TAKTIL, scenes};

/// The user without rights on every system.
const NOBODY: &str = "65534";

fn open_to_all(path: &Path) {
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn without_rights_it_says_so_once_marks_timing_and_runs() {
    let user = Command::new("id").arg("-u").output().map(|id| id.stdout);
    let tool = Command::new("setpriv").arg("--version").stdout(Stdio::null()).status();
    if user.is_ok_and(|user| user.trim_ascii() != b"0") || !tool.is_ok_and(|tool| tool.success()) {
        taktil_tests_script::report_skip(
            "only root with setpriv can become somebody without rights",
        );
        return;
    }
    // The files are in a folder that every user can read, which a build folder need not be.
    let folder = Folder::new();
    let program = folder.join("taktil");
    std::fs::copy(TAKTIL, &program).unwrap();
    std::fs::create_dir(folder.join("machine")).unwrap();
    for file in ["roll-pin.toml", "machine/puma260.toml"] {
        std::fs::copy(scenes().join(file), folder.join(file)).unwrap();
        open_to_all(&folder.join(file));
    }
    for path in [folder.path(), &program, &folder.join("machine")] {
        open_to_all(path);
    }
    let mut command = Command::new("setpriv");
    command.args(["--reuid", NOBODY, "--regid", NOBODY, "--clear-groups", "--inh-caps=-all"]);
    command.arg(&program).args(["run", "roll-pin.toml", "--for", "0.5"]);
    let said = ProcessOutput::of(&command.current_dir(folder.path()).output().unwrap());
    if !said.err.contains("not real time") && !said.out.contains("not representative") {
        taktil_tests_script::report_skip("here even nobody may have SCHED_FIFO");
        return;
    }
    let said = said.expect_code(0);
    let told: Vec<&str> = said.err.lines().filter(|l| l.starts_with("not real time")).collect();
    assert_eq!(told.len(), 1, "{}", said.err);
    assert!(told[0].contains("SCHED_FIFO"), "{}", told[0]);
    for lane in ["servo", "touch", "world"] {
        let row = said.out.lines().find(|row| row.trim_start().starts_with(lane)).unwrap();
        assert_eq!(row.matches(" *").count(), 2, "both figures are marked: {row}");
    }
    assert!(said.out.contains("* not representative"), "{}", said.out);
    assert!(said.out.contains("faults                     none"), "{}", said.out);
}
