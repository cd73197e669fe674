//! `taktil hal emulate` in a process of its own, for tests that drive the boards.
#![allow(dead_code, reason = "each test takes what it needs")]

use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

/// A folder of its own for each test.
pub(crate) fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("hal-{name}"));
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).unwrap();
    path
}

/// A scene whose finger presses the pin by 0.1 mm, with the brakes on.
pub(crate) fn pressed_scene(folder: &Path) -> PathBuf {
    let machine = concat!(env!("CARGO_MANIFEST_DIR"), "/../../sim/scenes/machine/puma260.toml");
    let text = format!(
        "title = \"Pressed\"\nmachine = \"{machine}\"\n[start]\n\
         finger_mm = [310.7, -127.0, -149.15]\n[world.pin]\nradius_mm = 23.0\n"
    );
    let path = folder.join("pressed.toml");
    std::fs::write(&path, text).unwrap();
    path
}

/// The emulator's process, killed at the end.
pub(crate) struct Emulator {
    pub(crate) process: Child,
    pub(crate) output: BufReader<ChildStdout>,
    pub(crate) lines: Vec<String>,
}

impl Emulator {
    /// Starts the boards and waits until they are ready.
    pub(crate) fn start(arguments: &[&str]) -> Emulator {
        let mut process = Command::new(env!("CARGO_BIN_EXE_taktil"))
            .args(["hal", "emulate"])
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let output = BufReader::new(process.stdout.take().unwrap());
        let mut emulator = Emulator { process, output, lines: Vec::new() };
        while !emulator.lines.iter().any(|line| line.starts_with("ready")) {
            let mut line = String::new();
            assert_ne!(emulator.output.read_line(&mut line).unwrap(), 0, "{:?}", emulator.lines);
            emulator.lines.push(line.trim_end().to_owned());
        }
        emulator
    }

    pub(crate) fn place(&self, board: &str) -> String {
        let start = format!("{board} at ");
        let found = self.lines.iter().find_map(|line| line.strip_prefix(&start));
        found.unwrap_or_else(|| panic!("{board}: {:?}", self.lines)).to_owned()
    }

    /// The angles of the robot's joints (deg), as somebody beside it sees them: with `--eyes`.
    pub(crate) fn joints_deg(&mut self) -> Vec<f64> {
        self.process.stdin.as_mut().unwrap().write_all(b"\n").unwrap();
        loop {
            let mut line = String::new();
            assert_ne!(self.output.read_line(&mut line).unwrap(), 0, "it has ended");
            if let Some(angles) = line.strip_prefix("joints ") {
                return angles.split_whitespace().map(|angle| angle.parse().unwrap()).collect();
            }
        }
    }

    /// Ends it as Ctrl-C does; what it says then, and its exit code.
    pub(crate) fn end(mut self) -> (String, Option<i32>) {
        let pid = Pid::from_raw(i32::try_from(self.process.id()).unwrap());
        kill(pid, Signal::SIGINT).unwrap();
        let mut rest = String::new();
        self.output.read_to_string(&mut rest).unwrap();
        let code = self.process.wait().unwrap().code();
        (rest, code)
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
