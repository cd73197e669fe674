//! Tests which paths cannot be opened, and the texts of their errors.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use taktil_drivers_regmap::registers::{BLOCK_BYTES, ID, ID_VALUE, VERSION};
use taktil_drivers_regmap::{Board, Config, Loopback, OpenError, RegisterFile};

fn place(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("opening-{name}"))
}

fn at(path: &Path) -> Config {
    Config { path: path.to_owned(), ..Config::default() }
}

/// A file of zeros, powered up by the model.
fn powered(name: &str, bytes: usize, config: impl FnOnce(Config) -> Config) -> (Config, Loopback) {
    let path = place(name);
    fs::write(&path, vec![0; bytes]).unwrap();
    let config = config(at(&path));
    let registers = std::sync::Arc::new(RegisterFile::open(&config).unwrap());
    let model = Loopback::new(registers, &config).unwrap();
    (config, model)
}

/// The message must name the path, say `what` and offer a remedy.
fn refused(config: &Config, what: &str) {
    let error = Board::open(config).expect_err("must be refused");
    let text = error.to_string();
    assert_eq!(error.place(), "path");
    assert!(text.starts_with(&format!("{}: ", config.path.display())), "{text}");
    assert!(text.contains(what), "{text}");
    assert!(text.split("; ").nth(1).is_some_and(|remedy| remedy.len() > 10), "{text}");
}

#[test]
fn a_missing_path_a_directory_and_a_pipe_are_refused() {
    refused(&at(&place("nowhere")), "does not exist");
    refused(&at(Path::new(env!("CARGO_TARGET_TMPDIR"))), "is a directory");
    let pipe = place("pipe");
    let _ = fs::remove_file(&pipe);
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    refused(&at(&pipe), "is no file and no device");
    refused(&at(Path::new("/dev/null")), "has no UIO memory map 0");
}

#[test]
fn a_file_that_is_too_short_is_refused_by_its_length() {
    let path = place("short");
    for (bytes, offset_bytes) in [(0, 0), (BLOCK_BYTES - 1, 0), (BLOCK_BYTES + 4095, 4096)] {
        fs::write(&path, vec![0; bytes]).unwrap();
        let config = Config { offset_bytes, ..at(&path) };
        refused(&config, &format!("holds {bytes} bytes"));
    }
    fs::write(&path, vec![0; BLOCK_BYTES]).unwrap();
    assert!(RegisterFile::open(&at(&path)).is_ok());
}

#[test]
fn another_board_is_refused_and_not_driven() {
    let path = place("stranger");
    fs::write(&path, vec![0xff; BLOCK_BYTES]).unwrap();
    refused(&at(&path), "register ID reads 0xffff");
    assert_eq!(fs::read(&path).unwrap(), vec![0xff; BLOCK_BYTES]);
    let registers = RegisterFile::open(&at(&path)).unwrap();
    registers.write(ID, ID_VALUE);
    registers.write(VERSION, 2);
    refused(&at(&path), "register VERSION reads 0x0002");
}

#[test]
fn the_block_is_found_at_its_offset() {
    let offset = |config| Config { offset_bytes: 4098, length_bytes: BLOCK_BYTES + 10, ..config };
    let (config, _model) = powered("offset", 4098 + BLOCK_BYTES + 10, offset);
    let _devices = Board::open(&config).unwrap();
    assert_eq!(fs::read(&config.path).unwrap()[4098..4100], [0x54, 0x4b]);
}

#[test]
fn a_second_driver_is_refused_until_the_first_has_dropped_every_half() {
    let (config, _model) = powered("twice", BLOCK_BYTES, |config| config);
    let first = Board::open(&config).unwrap();
    refused(&config, "another process drives this board");
    let last_half = first.tactile;
    drop((first.encoders, first.analog_out, first.analog_in, first.force_torque));
    drop((first.digital_in, first.digital_out));
    refused(&config, "another process drives this board");
    drop(last_half);
    assert!(Board::open(&config).is_ok());
}

#[test]
fn a_config_out_of_bounds_is_refused_by_its_place() {
    let good = at(&place("never-opened"));
    let bad = [
        ("path", Config::default()),
        ("length_bytes", Config { length_bytes: BLOCK_BYTES - 1, ..good.clone() }),
        ("length_bytes", Config { length_bytes: usize::MAX, ..good.clone() }),
        ("offset_bytes", Config { offset_bytes: 1, ..good.clone() }),
        ("offset_bytes", Config { offset_bytes: usize::MAX - 1, ..good.clone() }),
        ("joints", Config { joints: 0, ..good.clone() }),
        ("joints", Config { joints: 9, ..good.clone() }),
        ("dac_channels", Config { dac_channels: 9, ..good.clone() }),
        ("adc_channels", Config { adc_channels: 0, ..good.clone() }),
        ("dac_bits", Config { dac_bits: 17, ..good.clone() }),
        ("adc_bits", Config { adc_bits: 0, ..good.clone() }),
        ("gauge_bits", Config { gauge_bits: u32::MAX, ..good.clone() }),
        ("tactile_bits", Config { tactile_bits: 1, ..good.clone() }),
        ("counter_bits", Config { counter_bits: 33, ..good.clone() }),
        ("tactile_scan_us", Config { tactile_scan_us: 0, ..good.clone() }),
        ("watchdog_ms", Config { watchdog_ms: 0, ..good.clone() }),
        ("stale_ms", Config { stale_ms: 10_001, ..good.clone() }),
    ];
    for (place, config) in bad {
        let error = Board::open(&config).expect_err(place);
        assert_eq!(error.place(), place);
        assert!(matches!(error, OpenError::Invalid(_)), "{place}");
    }
}

#[test]
fn a_machine_file_needs_the_path_alone_and_no_unknown_key() {
    let config: Config = toml::from_str("path = \"/dev/uio0\"").unwrap();
    assert_eq!(config, at(Path::new("/dev/uio0")));
    config.check().unwrap();
    for text in ["path = \"x\"\nsign = -1", "path = 3", "path = \"x\"\njoints = -1"] {
        assert!(toml::from_str::<Config>(text).is_err(), "{text}");
    }
    let config: Config = toml::from_str("").unwrap();
    assert_eq!(config.check().unwrap_err().place, "path");
}

/// A folder as sysfs shows a PCI device, with a resource of so many bytes.
fn pci_device(name: &str, bytes: usize) -> PathBuf {
    let folder = place(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("vendor"), "0x10b5\n").unwrap();
    fs::write(folder.join("device"), "0x9050\n").unwrap();
    fs::write(folder.join("resource0"), vec![0; bytes]).unwrap();
    folder.join("resource0")
}

fn described(path: PathBuf) -> Config {
    Config { relay_ms: Some(10), ..Config::described(path, "dvme-628") }
}

/// Refused with the path, the cause and a remedy.
fn halves_refused(config: &Config, what: &str) {
    let text = Board::open_halves(config).expect_err(what).to_string();
    assert!(text.starts_with(&format!("{}: ", config.path.display())), "{text}");
    assert!(text.contains(what), "{text}");
    assert!(text.split("; ").nth(1).is_some_and(|remedy| remedy.len() > 10), "{text}");
}

#[test]
fn the_memory_of_a_pci_device_is_opened_when_it_is_that_device() {
    let path = pci_device("pci", 0x200);
    let good = Config { pci_id: Some("10B5:9050".to_owned()), ..described(path.clone()) };
    let halves = Board::open_halves(&good).unwrap();
    // Eight channels at zero volts, big-endian, at the left of their words.
    assert_eq!(fs::read(&path).unwrap()[0xa0..0xb0], [0x80, 0].repeat(8)[..]);
    halves_refused(&good, "another process drives this board");
    drop(halves);
    let other = Config { pci_id: Some("8086:1533".to_owned()), ..good.clone() };
    halves_refused(&other, "is the PCI device 10b5:9050, not 8086:1533");
    assert_eq!(fs::read(&path).unwrap()[0x100..], [0; 0x100]);
    fs::remove_file(path.with_file_name("device")).unwrap();
    halves_refused(&good, "cannot be identified");
    let plain = Config { pci_id: None, ..good };
    assert!(Board::open_halves(&plain).is_ok(), "it is not asked for");
    let uio = Config { uio_name: Some("board".to_owned()), ..plain };
    halves_refused(&uio, "cannot be identified");
}

#[test]
fn a_window_that_does_not_hold_the_described_registers_is_refused() {
    let path = pci_device("pci-window", 0x180);
    let at = |offset_bytes| Config { offset_bytes, ..described(path.clone()) };
    assert!(Board::open_halves(&at(0x80)).is_ok());
    halves_refused(&at(0x82), "holds 384 bytes, 256 from offset 130 are needed");
    halves_refused(&at(0x7f), "has no register at 0x7f");
    halves_refused(&at(usize::MAX / 4 - 1), "are needed");
    halves_refused(&described(path.with_file_name("resource1")), "does not exist");
    halves_refused(&described(path.parent().unwrap().to_owned()), "is a directory");
    halves_refused(&described(PathBuf::from("/dev/null")), "has no UIO memory map 0");
}

#[test]
fn boards_behind_one_bridge_are_opened_side_by_side_and_never_twice() {
    let path = pci_device("pci-bridge", 0x400);
    let at = |offset_bytes| Config { offset_bytes, ..described(path.clone()) };
    let first = Board::open_halves(&at(0x100)).unwrap();
    let second = Board::open_halves(&at(0x200)).unwrap();
    halves_refused(&at(0x180), "another device of this one");
    halves_refused(&at(0x0fe + 0x100), "another device of this one");
    drop(first);
    halves_refused(&at(0x180), "another device of this one");
    assert!(Board::open_halves(&at(0)).is_ok());
    drop(second);
    assert!(Board::open_halves(&at(0x180)).is_ok());
}

#[test]
fn a_described_board_is_known_by_its_registers() {
    let path = place("identity");
    fs::write(&path, vec![0; 0x40]).unwrap();
    let config = Config::described(&path, "vme-8605");
    halves_refused(&config, "register ID reads 0x0000, not 0x8605: no VME-8605 class A/D board");
    assert_eq!(fs::read(&path).unwrap(), vec![0; 0x40], "nothing was written");
    let mut bytes = vec![0; 0x40];
    bytes[2..4].copy_from_slice(&[0x86, 0x05]);
    fs::write(&path, &bytes).unwrap();
    let halves = Board::open_halves(&config).unwrap();
    assert_eq!(halves.analog_in_volts_per_code, [20.0 / 4096.0; 8]);
    assert!(halves.analog_out.is_none() && halves.analog_out_volts_per_code.is_empty());
    assert!(Board::open(&config).is_err(), "it is no whole cell, and driven already");
    drop(halves);
    let bad = Board::open(&config).expect_err("no whole cell");
    assert!(bad.to_string().contains("has no `encoders`"), "{bad}");
}
