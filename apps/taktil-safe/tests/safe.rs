//! The program over a register board that a killed process left driving, and over one that is still
//! driven.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use taktil_drivers_regmap::registers::{
    BLOCK_BYTES, DAC, DIGITAL_OUT, OUT_BRAKE_RELEASE, OUT_ENABLE,
};
use taktil_drivers_regmap::{Board, Config, Loopback, RegisterFile};
use taktil_hal::Nanos;

/// 12 bits, offset binary, all the way up; and no current.
const DRIVING_CODE: u16 = 0x0fff;
const ZERO_VOLTS_CODE: u16 = 0x0800;

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("taktil-safe-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn service_file(folder: &Path, boards: &str) -> PathBuf {
    let machine =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes/machine/puma260.toml");
    let path = folder.join("taktild.toml");
    std::fs::write(&path, format!("machine = {machine:?}\n{boards}")).unwrap();
    path
}

fn run(config: &Path) -> (Option<i32>, String) {
    let output: Output = Command::new(env!("CARGO_BIN_EXE_taktil-safe"))
        .arg("--config")
        .arg(config)
        .output()
        .unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

/// A board that answers, with its outputs as a killed process left them.
struct LeftDriving {
    registers: Arc<RegisterFile>,
    config: Config,
    stop: Arc<AtomicBool>,
    model: Option<std::thread::JoinHandle<()>>,
}

impl LeftDriving {
    fn new(folder: &Path) -> LeftDriving {
        let config = Config { path: folder.join("board.bin"), ..Config::default() };
        std::fs::write(&config.path, vec![0; BLOCK_BYTES]).unwrap();
        let registers = Arc::new(RegisterFile::open(&config).unwrap());
        let mut model = Loopback::new(registers.clone(), &config).unwrap();
        for register in DAC.iter() {
            registers.write(register, DRIVING_CODE);
        }
        registers.write(DIGITAL_OUT, OUT_ENABLE | OUT_BRAKE_RELEASE);
        let stop = Arc::new(AtomicBool::new(false));
        let flag = stop.clone();
        let model = std::thread::spawn(move || {
            for ms in 0.. {
                if flag.load(Ordering::SeqCst) {
                    break;
                }
                model.tick(Nanos::from_millis(ms));
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        LeftDriving { registers, config, stop, model: Some(model) }
    }

    fn is_safe(&self) -> bool {
        let lines = self.registers.read(DIGITAL_OUT);
        DAC.iter().all(|register| self.registers.read(register) == ZERO_VOLTS_CODE)
            && lines & (OUT_ENABLE | OUT_BRAKE_RELEASE) == 0
    }
}

impl Drop for LeftDriving {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
        let _ = self.model.take().map(std::thread::JoinHandle::join);
    }
}

#[test]
fn a_board_that_was_left_driving_is_made_safe_and_one_that_fails_does_not_keep_it() {
    let folder = folder("left");
    let board = LeftDriving::new(&folder);
    assert!(!board.is_safe());
    let boards = format!(
        "[robot.device.absent]\ndriver = \"regmap\"\nserves = [\"analog_in\"]\n\
         path = \"/no/such/board\"\n\
         [robot.device.cell]\ndriver = \"regmap\"\npath = {:?}\n\
         [robot.device.pad]\ndriver = \"serial\"\npath = \"/no/such/tty\"\n",
        board.config.path
    );
    let (code, text) = run(&service_file(&folder, &boards));
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("cell: safe") && text.contains("absent: not safe"), "{text}");
    assert!(!text.contains("pad"), "a device without outputs is left alone: {text}");
    assert!(board.is_safe());
}

#[test]
fn a_board_that_somebody_drives_is_left_to_them() {
    let folder = folder("driven");
    let board = LeftDriving::new(&folder);
    let driver = Board::open(&board.config).unwrap();
    let boards =
        format!("[robot.device.cell]\ndriver = \"regmap\"\npath = {:?}\n", board.config.path);
    let config = service_file(&folder, &boards);
    let (code, text) = run(&config);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("another process drives this board"), "{text}");
    drop(driver);
    assert_eq!(run(&config).0, Some(0));
}

#[test]
fn a_configuration_that_cannot_be_used_ends_with_2() {
    let folder = folder("bad");
    assert_eq!(run(&folder.join("nothing.toml")).0, Some(2));
    let bad_sections = [
        ("drivre = \"regmap\"\n", "has no `driver`"),
        ("driver = \"regmpa\"\n", "there is no driver `regmpa`"),
        ("driver = \"regmap\"\npath = \"/no/such/board\"\nstale = 1\n", "stale"),
    ];
    for (section, says) in bad_sections {
        // The board that can be told from the rest is made safe, and does not hide the other one.
        let board = LeftDriving::new(&folder);
        let cell =
            format!("[robot.device.cell]\ndriver = \"regmap\"\npath = {:?}\n", board.config.path);
        let config = service_file(&folder, &format!("[robot.device.a]\n{section}{cell}"));
        let (code, text) = run(&config);
        assert_eq!(code, Some(2), "{text}");
        assert!(text.contains("a: not safe") && text.contains(says), "{text}");
        assert!(text.contains("cell: safe") && board.is_safe(), "{text}");
    }
}

#[test]
fn a_description_that_is_named_relative_is_taken_from_the_folder_of_the_file() {
    let folder = folder("relative");
    let board = LeftDriving::new(&folder);
    let description = include_str!("../../../drivers/regmap/boards/taktil.toml");
    std::fs::write(folder.join("cell.toml"), description).unwrap();
    let boards = format!(
        "[robot.device.cell]\ndriver = \"regmap\"\npath = {:?}\nboard = \"cell.toml\"\n",
        board.config.path
    );
    let (code, text) = run(&service_file(&folder, &boards));
    assert_eq!(code, Some(0), "{text}");
    assert!(board.is_safe());
}
