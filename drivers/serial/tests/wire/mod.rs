//! An emulator in another process: the test binary, run anew with its task in the environment.
#![allow(dead_code, reason = "each test binary uses a part of it")]

use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use taktil_drivers_serial_emulator::{Board, FlexiTac, Line, Myrmex, WeissDsa, WeissWts, serve};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{Clock, Nanos};

const TASK_VARIABLE: &str = "TAKTIL_SERIAL_EMULATOR";

/// The clock of a test.
#[derive(Clone)]
pub(crate) struct Monotonic(Instant);

impl Monotonic {
    #[expect(clippy::disallowed_methods, reason = "a test over a real wire runs in real time")]
    pub(crate) fn start() -> Monotonic {
        Monotonic(Instant::now())
    }
}

impl Clock for Monotonic {
    #[expect(clippy::disallowed_methods, reason = "a test over a real wire runs in real time")]
    fn now(&self) -> Nanos {
        Nanos(self.0.elapsed().as_nanos() as i64)
    }

    fn sleep_until(&self, instant: Nanos) {
        std::thread::sleep(Duration::from_nanos((instant - self.now()).0.max(0) as u64));
    }
}

/// A process that serves a board; it ends with this value.
pub(crate) struct Emulator {
    process: Child,
    link: PathBuf,
}

impl Emulator {
    /// Starts the emulator of `board` behind a link named `name`, and waits for the link.
    pub(crate) fn start(board: &str, name: &str, faults: &str) -> Emulator {
        let link = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("tty-{board}-{name}"));
        let _ = std::fs::remove_file(&link);
        let process = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "emulator_process"])
            .env(TASK_VARIABLE, format!("{board}|{}|{faults}", link.display()))
            .spawn()
            .unwrap();
        let clock = Monotonic::start();
        while !link.exists() {
            assert!(clock.now() < Nanos::from_secs(30), "the emulator does not start");
            clock.sleep_until(clock.now() + Nanos::from_millis(5));
        }
        Emulator { process, link }
    }

    pub(crate) fn link(&self) -> &Path {
        &self.link
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
        let _ = std::fs::remove_file(&self.link);
    }
}

/// What the other process does: 60 s of a board whose image moves, or until it is killed.
pub(crate) fn serve_if_asked() {
    let Ok(task) = std::env::var(TASK_VARIABLE) else { return };
    let mut parts = task.split('|');
    let (board, link) = (parts.next().unwrap(), PathBuf::from(parts.next().unwrap()));
    let faults = parts.next().unwrap();
    let plan = match faults {
        "" => FaultPlan::default(),
        text => FaultPlan::new(vec![text.parse().unwrap()]),
    };
    let device: Box<dyn Board> = match board {
        "myrmex" => Box::new(Myrmex::new(50.0)),
        "flexitac" => Box::new(FlexiTac::new(16, 16, 50.0)),
        "weiss-wts" => Box::new(WeissWts::new(16, 16, 50.0)),
        _ => Box::new(WeissDsa::new(16, 16, 20.0)),
    };
    let mut line = Line::new(device, board, plan, 1).unwrap();
    let mut image =
        |now: Nanos, values: &mut [u16]| values.fill(20 + (now.0 / 10_000_000 % 100) as u16);
    let clock = Monotonic::start();
    let end = Nanos::from_secs(180);
    serve(&mut line, &link, &clock, &mut image, &mut |now| now > end).unwrap();
}
