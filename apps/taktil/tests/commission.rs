//! `taktil commission` over emulated boards in another process, before a robot that is wired
//! otherwise than its machine file says: the wiring is found, and the file that is written passes
//! `taktil hal check`.

mod emulator;

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use emulator::{Emulator, folder};

/// How often it is tried: a host with other work may be late in every pulse, which the program says
/// and does not hide.
const ATTEMPTS_MAX: usize = 4;
/// The pose of the scene, in which the arm rests by itself.
const POSE_DEG: &str = "0,90,-90,0,0,0";

/// Lines of the cabinet behind the card.
const CARD_LINES: &str = "\
    [device.card.lines_in]\n\
    drive_power = { at = \"field\", number = 0 }\n\
    estop_a = { at = \"field\", number = 1 }\n\
    estop_b = { at = \"field\", number = 2 }\n\
    [device.card.lines_out]\n\
    enable = { at = \"field\", number = 0 }\n\
    brake_release = { at = \"field\", number = 1 }\n\
    watchdog_feed = { at = \"field\", number = 2 }\n";

/// What the machine file says of the wiring before: nothing but the amplifiers' scale.
const JOINTS: &str = "[joints]\nfull_scale_v = [10, 10, 10, 10, 10, 10]\n";

/// The scene of a first power-up, with its machine file where it is.
fn scene(folder: &Path) -> String {
    let scenes = concat!(env!("CARGO_MANIFEST_DIR"), "/../../sim/scenes");
    let text = std::fs::read_to_string(format!("{scenes}/commission.toml")).unwrap();
    let text = text.replace("\"machine/", &format!("\"{scenes}/machine/"));
    let path = folder.join("scene.toml");
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

/// Answers the questions of the program by what the emulator's robot does, until it ends; its exit
/// code and what it said.
fn answered(emulator: &mut Emulator, machine: &Path, found: &Path) -> (Option<i32>, String) {
    let mut process = Command::new(env!("CARGO_BIN_EXE_taktil"))
        .args(["commission", machine.to_str().unwrap(), "--yes", "--pose", POSE_DEG])
        .args(["--no-stops", "--joint", "6", "--period-us", "5000"])
        .args(["--write", found.to_str().unwrap()])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut answers = process.stdin.take().unwrap();
    let mut said = String::new();
    let mut before = Vec::new();
    for line in BufReader::new(process.stderr.take().unwrap()).lines() {
        let line = line.unwrap();
        // Whoever has stopped hears no answer any more.
        if line.starts_with("A joint is about to move") {
            before = emulator.joints_deg();
            let _ = answers.write_all(b"\n");
        } else if line.starts_with("Which joint moved") {
            let after = emulator.joints_deg();
            let moved = after.iter().zip(&before).map(|(after, before)| after - before);
            let most = moved.enumerate().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
            let (joint, moved) = most.unwrap();
            let sign = if moved > 0.0 { '+' } else { '-' };
            let _ = writeln!(answers, "{}{sign}", joint + 1);
        }
        said += &line;
        said.push('\n');
    }
    (process.wait().unwrap().code(), said)
}

/// Commissions the robot behind a board; the file that was written.
fn commissioned(name: &str, board: &str, section: impl Fn(&str) -> String) -> PathBuf {
    let folder = folder(name);
    let (scene, found) = (scene(&folder), folder.join("found.toml"));
    let mut last = String::new();
    for _ in 0..ATTEMPTS_MAX {
        let mut emulator = Emulator::start(&[board, "--scene", &scene, "--eyes", "--for", "600"]);
        let machine = folder.join("machine.toml");
        std::fs::write(&machine, section(&emulator.place(board)) + JOINTS).unwrap();
        let (code, said) = answered(&mut emulator, &machine, &found);
        assert!(!said.contains("panicked"), "{said}");
        if code != Some(0) {
            last = said;
            continue;
        }
        let check = Command::new(env!("CARGO_BIN_EXE_taktil"))
            .args(["hal", "check", found.to_str().unwrap(), "--for", "1", "--period-us", "20000"])
            .args(["--loss-max", "0.9", "--slack-us", "200000"])
            .args(["--out", folder.join("check").to_str().unwrap()])
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&check.stderr);
        assert_ne!(check.status.code(), Some(2), "the file cannot be used: {said}");
        return found;
    }
    panic!("not in {ATTEMPTS_MAX} attempts: {last}");
}

fn assert_wiring(found: &Path) {
    let text = std::fs::read_to_string(found).unwrap();
    for line in [
        "encoder_channel = [3, 1, 2, 0, 4, 5]",
        "encoder_sign = [1, 1, 1, 1, 1, 1]",
        "motor_channel = [0, 1, 2, 3, 4, 5]",
        "motor_sign = [1, -1, 1, 1, 1, 1]",
        "full_scale_v = [10, 10, 10, 10, 10, 10]",
        "# Found by `taktil commission` on ",
    ] {
        assert!(text.contains(line), "not `{line}` in\n{text}");
    }
}

#[test]
#[ignore = "a minute in real time: cargo test -p taktil --test commission -- --ignored"]
fn a_robot_behind_a_card_that_is_wired_otherwise_is_found_out_over_udp() {
    let found = commissioned("commission-card", "mesa", |address| {
        format!(
            "[device.card]\ndriver = \"mesa\"\naddress = \"{address}\"\nperiod_us = 5000\n\
             lost_ms = 10000\nwatchdog_ms = 50\nopen_wait_ms = 2000\n{CARD_LINES}"
        )
    });
    assert_wiring(&found);
}

#[test]
#[ignore = "needs a host that keeps 5 ms: cargo test -p taktil --test commission -- --ignored"]
fn a_robot_behind_registers_that_is_wired_otherwise_is_found_out_in_a_file() {
    let found = commissioned("commission-registers", "regmap", |path| {
        format!(
            "[device.cell]\ndriver = \"regmap\"\npath = \"{path}\"\nboard = \"taktil\"\n\
             watchdog_ms = 50\nstale_ms = 500\n"
        )
    });
    assert_wiring(&found);
}
