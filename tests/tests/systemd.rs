//! Checks the service's unit file with systemd's own tools, without installing anything. That the
//! service starts under these restrictions is not shown here.

use std::fs;
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use taktil_tests::root;

const UNIT: &str = "taktild.service";
/// The unit of the emulated boards, and the one that prepares the computer.
const OTHER_UNITS: [&str; 2] = ["taktil-emulate.service", "taktil-tune.service"];
/// Everything a unit is ordered against by name or by default.
const STAND_INS: &[&str] = &[
    "sysinit.target",
    "basic.target",
    "shutdown.target",
    "local-fs.target",
    "multi-user.target",
    "system.slice",
    "-.mount",
    "systemd-udevd.service",
    "systemd-journald.socket",
    "systemd-tmpfiles-setup.service",
];
/// Tenths of a point of exposure that `systemd-analyze security` may find: in the unit as it is,
/// and with every drop-in that opens it to some kind of board.
const EXPOSURE_MAX: &str = "10";
const EXPOSURE_OPENED_MAX: &str = "20";

/// Runs a tool; `None`, said aloud, when this machine does not have it.
fn run(tool: &str, arguments: &[&str]) -> Option<Output> {
    let output = Command::new(tool).args(arguments).env("SYSTEMD_COLORS", "0").output();
    match output {
        Ok(output) => Some(output),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            // Past the harness, which would swallow it.
            let _ = writeln!(std::io::stderr(), "SKIPPED: {tool} is not on this machine");
            None
        }
        Err(error) => panic!("{tool}: {error}"),
    }
}

fn shipped(name: &str) -> String {
    let path = root().join("systemd").join(name);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn unit() -> String {
    shipped(UNIT)
}

/// Names and texts of the drop-ins in a folder that is shipped, without those in folders below it.
fn drop_ins_in(folder: &str) -> Vec<(String, String)> {
    let entries = fs::read_dir(root().join("systemd").join(folder)).expect("drop-ins are there");
    let mut names: Vec<String> = entries
        .map(|entry| entry.expect("it can be listed"))
        .filter(|entry| entry.path().is_file())
        .map(|entry| entry.file_name().into_string().expect("text"))
        .collect();
    names.sort();
    let text = |name: String| (name.clone(), shipped(&format!("{folder}/{name}")));
    names.into_iter().map(text).collect()
}

/// The drop-ins that may all be used together.
fn drop_ins() -> Vec<(String, String)> {
    drop_ins_in("drop-ins")
}

/// The same with those of another bus of drives in place of the raw frames.
fn drop_ins_of_another_bus() -> Vec<(String, String)> {
    let others = drop_ins_in("drop-ins/instead-of-raw-sockets");
    assert!(!others.is_empty(), "a bus of drives");
    let kept = drop_ins().into_iter().filter(|(name, _)| name != "raw-sockets.conf");
    kept.chain(others).collect()
}

fn write(path: &Path, text: &str) {
    fs::create_dir_all(path.parent().expect("a file has a folder")).expect("folders can be made");
    fs::write(path, text).expect("the build folder can be written");
}

/// A root of a file system that holds the unit, stand-ins and nothing else.
fn stage(name: &str, unit: &str) -> PathBuf {
    let stage = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    if stage.exists() {
        fs::remove_dir_all(&stage).expect("an old stage can be removed");
    }
    let units = stage.join("usr/lib/systemd/system");
    for stand_in in STAND_INS {
        let text = match stand_in.rsplit_once('.').map(|(_, kind)| kind) {
            Some("service") => "[Service]\nExecStart=/usr/bin/taktild\n",
            Some("socket") => "[Socket]\nListenStream=/run/x\n",
            Some("mount") => "[Mount]\nWhat=/dev/x\nWhere=/\n",
            _ => "[Unit]\nDescription=stand-in\n",
        };
        write(&units.join(stand_in), text);
    }
    write(&units.join("systemd-journald.service"), "[Service]\nExecStart=/usr/bin/taktild\n");
    write(&units.join(UNIT), unit);
    for other in OTHER_UNITS {
        write(&units.join(other), &shipped(other));
    }
    write(&stage.join("etc/default/taktil-tune"), &shipped("taktil-tune.default"));
    for program in [
        "bin/taktild",
        "bin/taktil-safe",
        "bin/taktil",
        "bin/rm",
        "bin/sh",
        "lib/taktil/taktil-tune",
    ] {
        let binary = stage.join("usr").join(program);
        write(&binary, "#!/bin/sh\n");
        let executable = fs::Permissions::from_mode(0o755);
        fs::set_permissions(&binary, executable).expect("it can be executable");
    }
    std::os::unix::fs::symlink("usr/bin", stage.join("bin")).expect("a link can be made");
    stage
}

/// Puts drop-ins of the service into a root.
fn add_drop_ins<'a>(stage: &Path, drop_ins: impl IntoIterator<Item = &'a (String, String)>) {
    let folder = stage.join("etc/systemd/system").join(format!("{UNIT}.d"));
    for (name, text) in drop_ins {
        write(&folder.join(name), text);
    }
}

/// Every complaint of `systemd-analyze verify`: some keep its exit code at 0.
fn verify_in(stage: &Path, unit: &str) -> Option<String> {
    let root = format!("--root={}", stage.display());
    let output = run("systemd-analyze", &["verify", "--man=no", &root, unit])?;
    let mut said = String::from_utf8_lossy(&output.stderr).into_owned();
    if !output.status.success() {
        said.push_str(&output.status.to_string());
    }
    Some(said)
}

fn verify(name: &str, unit: &str) -> Option<String> {
    verify_in(&stage(name, unit), UNIT)
}

fn exposure_is_at_most(stage: &Path, tenths: &str) -> Option<bool> {
    let (root, threshold) =
        (format!("--root={}", stage.display()), format!("--threshold={tenths}"));
    let arguments = ["security", "--offline=true", &root, &threshold, UNIT];
    let output = run("systemd-analyze", &arguments)?;
    assert!(!output.stdout.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(output.status.success())
}

#[test]
fn systemd_finds_nothing_wrong_with_the_units() {
    let stage = stage("good", &unit());
    for unit in [UNIT].iter().chain(&OTHER_UNITS) {
        if let Some(said) = verify_in(&stage, unit) {
            assert!(said.is_empty(), "systemd-analyze verify says of {unit}:\n{said}");
        }
    }
}

#[test]
fn systemd_finds_nothing_wrong_with_the_drop_ins() {
    let drop_ins = drop_ins();
    assert!(drop_ins.len() >= 6, "{drop_ins:?}");
    for drop_in in &drop_ins {
        let stage = stage(&format!("drop-in-{}", drop_in.0), &unit());
        add_drop_ins(&stage, [drop_in]);
        if let Some(said) = verify_in(&stage, UNIT) {
            assert!(said.is_empty(), "systemd-analyze verify says of {}:\n{said}", drop_in.0);
        }
        let spoiled = (drop_in.0.clone(), drop_in.1.replacen("[Service]\n", "[Service]\nX=\n", 1));
        add_drop_ins(&stage, [&spoiled]);
        if let Some(said) = verify_in(&stage, UNIT) {
            assert!(!said.is_empty(), "a spoiled {} goes unseen", drop_in.0);
        }
    }
}

#[test]
fn every_key_that_a_drop_in_loosens_has_its_reason_above_it() {
    for (name, text) in drop_ins().into_iter().chain(drop_ins_of_another_bus()) {
        let mut explained = false;
        for line in text.lines() {
            match line {
                "" => explained = false,
                line if line.starts_with('#') => explained = true,
                line if line.starts_with('[') => {}
                line => assert!(explained, "{name}: no comment above `{line}`"),
            }
        }
    }
}

#[test]
fn systemd_would_find_a_spoiled_line() {
    for (name, good, bad) in [
        ("key", "WatchdogSec=1", "WatchdogSecs=1"),
        ("value", "Restart=on-failure", "Restart=on-mondays"),
        ("binary", "ExecStart=/usr/bin/taktild", "ExecStart=/usr/bin/taktile"),
    ] {
        let spoiled = unit().replace(good, bad);
        assert_ne!(spoiled, unit(), "`{good}` is not in the unit");
        if let Some(said) = verify(name, &spoiled) {
            assert!(!said.is_empty(), "{bad} goes unseen");
        }
    }
}

#[test]
fn little_is_exposed() {
    let plain = stage("exposed", &unit());
    if let Some(small) = exposure_is_at_most(&plain, EXPOSURE_MAX) {
        assert!(small, "more than {EXPOSURE_MAX} tenths: systemd-analyze security --offline=true");
    }
    add_drop_ins(&plain, &drop_ins());
    if let Some(small) = exposure_is_at_most(&plain, EXPOSURE_OPENED_MAX) {
        assert!(small, "more than {EXPOSURE_OPENED_MAX} tenths with all drop-ins");
    }
    if let Some(small) = exposure_is_at_most(&plain, EXPOSURE_MAX) {
        assert!(!small, "drop-ins that open the unit change nothing: they were not read");
    }
    let other = stage("exposed-other", &unit());
    add_drop_ins(&other, &drop_ins_of_another_bus());
    if let Some(small) = exposure_is_at_most(&other, EXPOSURE_OPENED_MAX) {
        assert!(small, "more than {EXPOSURE_OPENED_MAX} tenths with another bus of drives");
    }
    let open = stage("open", "[Service]\nExecStart=/usr/bin/taktild\n");
    if let Some(small) = exposure_is_at_most(&open, EXPOSURE_OPENED_MAX) {
        assert!(!small, "a unit without any restriction passes: the threshold means nothing");
    }
}

#[test]
fn the_unit_requests_real_time_limits_and_no_capability() {
    let unit = unit();
    let has = |line: &str| unit.lines().any(|found| found == line);
    for line in [
        "Type=notify",
        "User=taktil",
        "LimitRTPRIO=90",
        "LimitMEMLOCK=infinity",
        "CapabilityBoundingSet=",
        "AmbientCapabilities=",
        "PrivateNetwork=yes",
        "DevicePolicy=closed",
        "MemoryDenyWriteExecute=yes",
        "ProtectSystem=strict",
    ] {
        assert!(has(line), "the unit has no line `{line}`");
    }
}

#[test]
fn every_block_of_the_units_gives_its_reason() {
    for name in [UNIT].iter().chain(&OTHER_UNITS) {
        let unit = shipped(name);
        let silent: Vec<&str> = unit
            .split("\n\n")
            .filter(|block| {
                block.contains('=') && !block.contains("# ") && !block.contains("[Install]")
            })
            .filter(|block| block.contains("[Service]") || *name == UNIT)
            .collect();
        assert!(silent.is_empty(), "{name}: no comment in: {silent:?}");
    }
}

/// Complaints of `systemd-sysusers` about a file of users.
fn sysusers(name: &str, text: &str) -> Option<String> {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    write(&path, text);
    let file = path.to_str().expect("the build folder has a plain name");
    let output = run("systemd-sysusers", &["--dry-run", file])?;
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let noise = |line: &&str| !line.starts_with("Would ") && !line.starts_with("Creating ");
    let bad: Vec<&str> = said.lines().filter(noise).collect();
    Some(if output.status.success() { bad.join("\n") } else { format!("refused: {said}") })
}

#[test]
fn the_user_can_be_made() {
    let good = fs::read_to_string(root().join("systemd/taktil.sysusers")).expect("it is there");
    if let Some(said) = sysusers("good.sysusers", &good) {
        assert!(said.is_empty(), "{said}");
    }
    if let Some(said) = sysusers("bad.sysusers", &good.replace("\nu ", "\nusr ")) {
        assert!(!said.is_empty(), "a line of an unknown kind goes unseen");
    }
}
