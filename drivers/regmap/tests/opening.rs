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
