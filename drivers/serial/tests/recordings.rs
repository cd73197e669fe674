//! Every recording in the folder `recordings` is decoded: a stream of bytes, and what is expected
//! of it.

mod bench;

use std::path::{Path, PathBuf};

use bench::{Bench, Shelf};
use serde::Deserialize;
use taktil_drivers_serial::{BoardKind, Config, Session};
use taktil_drivers_serial_emulator::{Board, FlexiTac, Myrmex, WeissDsa, WeissWts};
use taktil_hal::Nanos;

/// What stands beside a recording.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Expectation {
    board: BoardKind,
    #[serde(default = "sixteen")]
    rows: u16,
    #[serde(default = "sixteen")]
    cols: u16,
    #[serde(default)]
    sensor: u8,
    /// Scans that must come out, at least.
    scans_min: usize,
    /// Bytes that may belong to no message, at most.
    #[serde(default = "usize::max_value")]
    skipped_max: usize,
    /// Sum of all counts of all scans, where it is known.
    sum: Option<u64>,
}

fn sixteen() -> u16 {
    16
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings")
}

/// Decodes a stream; the dialogue runs against it as if the answers came when they are asked for.
fn decode(config: &Config, bytes: &[u8]) -> (Vec<taktil_drivers_serial::Scan>, u64) {
    let mut session = Session::new(config).unwrap();
    session.restart(Nanos::ZERO);
    let mut shelf = Shelf::new(&session);
    // Past the silence that Myrmex needs after its stop.
    session.poll(Nanos::ZERO);
    session.poll(Nanos::from_millis(150));
    let mut now = Nanos::from_millis(160);
    for piece in bytes.chunks(64) {
        session.push(now, piece, &mut shelf);
        session.poll(now);
        now += Nanos::from_micros(640);
    }
    (shelf.0, session.health().skipped_bytes)
}

#[test]
fn every_recording_is_decoded() {
    let mut seen = 0;
    for entry in std::fs::read_dir(folder()).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "toml") {
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap();
        let expected: Expectation =
            toml::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let bytes = std::fs::read(path.with_extension("bin")).unwrap();
        let (board, rows, cols, sensor) =
            (expected.board, expected.rows, expected.cols, expected.sensor);
        let config = Config { board, rows, cols, sensor, ..Config::default() };
        let (scans, skipped) = decode(&config, &bytes);
        let name = path.display();
        assert!(scans.len() >= expected.scans_min, "{name}: {} scans", scans.len());
        assert!(skipped as usize <= expected.skipped_max, "{name}: {skipped} bytes skipped");
        let sum: u64 = scans.iter().flat_map(|scan| &scan.values).map(|v| u64::from(*v)).sum();
        assert_eq!(sum, expected.sum.unwrap_or(sum), "{name}");
        seen += 1;
    }
    assert!(seen >= 4, "only {seen} recordings");
}

#[test]
#[ignore = "writes the recordings of the emulators anew"]
fn record_the_emulators() {
    let boards: [(&str, BoardKind, Box<dyn Board>); 4] = [
        ("myrmex", BoardKind::Myrmex, Box::new(Myrmex::new(100.0))),
        ("flexitac", BoardKind::Flexitac, Box::new(FlexiTac::new(16, 16, 100.0))),
        ("weiss-wts", BoardKind::WeissWts, Box::new(WeissWts::new(16, 16, 100.0))),
        ("weiss-dsa", BoardKind::WeissDsa, Box::new(WeissDsa::new(16, 16, 100.0))),
    ];
    for (name, board, emulator) in boards {
        let config = Config { board, ..Config::default() };
        let faults = "kind=corruption at=0.45 for=0.1 value=0.5";
        let mut bench = Bench::new(&config, emulator, faults);
        bench.run(Nanos::from_millis(650));
        std::fs::write(folder().join(format!("emulator-{name}.bin")), &bench.stream).unwrap();
        let (scans, skipped) = decode(&config, &bench.stream);
        let sum: u64 = scans.iter().flat_map(|scan| &scan.values).map(|v| u64::from(*v)).sum();
        let text = format!(
            "board = \"{name}\"\nscans_min = {}\nskipped_max = {skipped}\nsum = {sum}\n",
            scans.len()
        );
        std::fs::write(folder().join(format!("emulator-{name}.toml")), text).unwrap();
    }
}
