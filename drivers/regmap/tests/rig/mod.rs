//! A board in a file with its emulator, which the test advances in virtual time.
#![allow(dead_code, reason = "each test takes what it needs")]
#![expect(clippy::disallowed_types, reason = "plant, bench and observer of a test share a board")]

use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use taktil_drivers_regmap::{AcquisitionStart, Board, Config, Halves, OpenError, SHIPPED_BOARDS};
use taktil_drivers_regmap_emulator::{Emulator, Inputs, Outputs};
use taktil_hal::conformance::CycleDriver;
use taktil_hal::fault::FaultPlan;
use taktil_hal::{LinesIn, Nanos};

/// Period of the tests' cycles.
pub(crate) const CYCLE_PERIOD: Nanos = Nanos::from_micros(2_500);
/// Names of the descriptions that come with the driver.
pub(crate) const BOARDS: [&str; 5] = ["taktil", "dvme-628", "lxvme-s01", "vme-8605", "vme-arm"];

/// The text of a shipped description.
pub(crate) fn text(board: &str) -> &'static str {
    SHIPPED_BOARDS.iter().find(|(name, _)| *name == board).expect("it is shipped").1
}

/// A place for a test's file.
pub(crate) fn place(name: &str) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("rig-{name}"));
    let _ = std::fs::remove_file(&path);
    path
}

/// The configuration of a described board whose outputs a relay takes off after 10 ms.
pub(crate) fn config(name: &str, board: &str) -> Config {
    Config { relay_ms: Some(10), ..Config::described(place(name), board) }
}

/// An emulated board and what its inputs read.
#[derive(Clone)]
pub(crate) struct Rig {
    pub(crate) emulator: Arc<Mutex<Emulator>>,
    pub(crate) inputs: Arc<Mutex<Inputs>>,
    pub(crate) now: Arc<Mutex<Nanos>>,
    start: Arc<Mutex<Option<AcquisitionStart>>>,
}

impl Rig {
    /// Switches a board on, by the text of its description, in the file of the configuration.
    pub(crate) fn new(config: &Config, text: &str) -> Rig {
        let lines = LinesIn { drive_power: true, estop_a_closed: true, estop_b_closed: true };
        let inputs = Arc::new(Mutex::new(Inputs { lines, ..Inputs::default() }));
        let read = inputs.clone();
        let plant = Box::new(move |_: Nanos, _: &Outputs| {
            let mut read = read.lock().unwrap();
            let frame = read.frame.take();
            Inputs { frame, ..read.clone() }
        });
        let emulator =
            Emulator::new("board", text, &config.path, config.offset_bytes as u64, plant).unwrap();
        Rig {
            emulator: Arc::new(Mutex::new(emulator)),
            inputs,
            now: Arc::new(Mutex::new(Nanos::ZERO)),
            start: Arc::default(),
        }
    }

    /// Opens the board, which no other halves may have open.
    pub(crate) fn open(&self, config: &Config) -> Result<Halves, OpenError> {
        *self.start.lock().unwrap() = None;
        let halves = Board::open_halves(config)?;
        *self.start.lock().unwrap() = Some(halves.start.clone());
        Ok(halves)
    }

    /// A shipped board, opened.
    pub(crate) fn shipped(name: &str, board: &str) -> (Rig, Halves) {
        let config = config(name, board);
        let rig = Rig::new(&config, text(board));
        let halves = rig.open(&config).unwrap();
        (rig, halves)
    }

    /// Executes faults, one a text.
    pub(crate) fn plan(&self, faults: &[&str]) {
        let faults = faults.iter().map(|text| text.parse().unwrap()).collect();
        self.emulator.lock().unwrap().set_faults(FaultPlan::new(faults), 1).unwrap();
    }

    /// The board moves on to an instant.
    pub(crate) fn step(&self, now: Nanos) {
        self.emulator.lock().unwrap().step(now).unwrap();
        *self.now.lock().unwrap() = now;
    }

    /// A job begins: whatever can be started early is, and the board has the time it needs.
    pub(crate) fn job(&self, release: Nanos) {
        if let Some(start) = &*self.start.lock().unwrap() {
            start.start(release);
        }
        self.step(release);
        self.step(release + Nanos::from_micros(30));
    }

    /// What the board puts out when it looks at its registers now.
    pub(crate) fn look(&self) -> Outputs {
        let now = *self.now.lock().unwrap();
        self.step(now);
        self.emulator.lock().unwrap().outputs().clone()
    }

    /// Cycles in which everything moves.
    pub(crate) fn bench(&self) -> CycleDriver<'static> {
        let rig = self.clone();
        CycleDriver::new(Nanos::ZERO, CYCLE_PERIOD, move |now| {
            let step = now.0 / CYCLE_PERIOD.0;
            {
                let mut inputs = rig.inputs.lock().unwrap();
                inputs.counts = (0..32).map(|joint| (step - 20) * (900 + joint)).collect();
                inputs.codes = (0..32).map(|channel| (step as i32 - 20) * 50 + channel).collect();
                inputs.gauges = (0..6).map(|gauge| step as i32 * 3 - gauge).collect();
                inputs.frame = (step % 2 == 0).then(|| vec![step as u16; 256]);
            }
            rig.job(now);
        })
    }
}
