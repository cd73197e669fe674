//! Measures the driver's own time in a cycle: six encoders read and six D/A channels written, on
//! registers that are memory, so that what is measured is the driver's. Prints the median and the
//! largest of slices for each board, and with valgrind installed the instructions of a cycle.
//!
//! ```sh
//! cargo run --release -p taktil-drivers-regmap --example regmap_own_time
//! ```
#![expect(clippy::disallowed_methods, reason = "an instrument measures time")]

use std::hint::black_box;
use std::io::Write;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use taktil_drivers_regmap::{Board, Config, Description, Halves, SHIPPED_BOARDS};
use taktil_drivers_regmap_emulator::{Emulator, Inputs, Outputs};
use taktil_hal::{AnalogOut, CHANNELS, DacCode, Encoders, Nanos};

/// Cycles of one slice.
const SLICE_CYCLES: i64 = 1_000;
/// Slices of each board.
const SLICES_COUNT: usize = 201;
/// Cycles of the two runs of which the difference is counted.
const COUNTED_CYCLES: [i64; 2] = [1_000, 11_000];
/// Boards with six encoders and six D/A channels.
const MEASURED_BOARDS: [&str; 2] = ["taktil", "vme-arm"];

type Fault = Box<dyn std::error::Error>;

/// A board in a file that shows itself and is never busy.
fn open(name: &str, path: &Path) -> Result<Halves, Fault> {
    let text = SHIPPED_BOARDS.iter().find(|(known, _)| *known == name).ok_or("no such board")?.1;
    let plant = Box::new(|_: Nanos, _: &Outputs| Inputs::default());
    Emulator::new("board", text, path, 0, plant)?.step(Nanos::ZERO)?;
    let mut config = Config { path: path.to_owned(), stale_ms: 10_000, ..Config::default() };
    if name != "taktil" {
        let mut description = Description::from_toml(text)?;
        if let Some(encoders) = &mut description.encoders {
            // Nobody clears the busy bit here: a latch that acts at once is measured.
            (encoders.busy_offset, encoders.busy_mask) = (None, None);
        }
        config.registers = Some(description);
        config.relay_ms = Some(10);
        config.encoder_channels = (0..6).collect();
        config.analog_out_channels = (0..6).collect();
    } else {
        config.dac_channels = 6;
    }
    Ok(Board::open_halves(&config)?)
}

fn cycle(encoders: &mut dyn Encoders, out: &mut dyn AnalogOut, release: Nanos) {
    let codes = [DacCode((release.0 & 0x7ff) as i32); CHANNELS];
    let counts = black_box(encoders.sample(release));
    let done = out.commit(release, black_box(&codes));
    assert!(counts.is_ok() && done.is_ok(), "{counts:?} {done:?}");
}

/// Runs cycles; the times of whole slices (ns a cycle), sorted.
fn run(name: &str, cycles: i64) -> Result<Vec<f64>, Fault> {
    let path = std::env::temp_dir().join(format!("taktil-own-time-{}-{name}", std::process::id()));
    let mut halves = open(name, &path)?;
    let mut encoders = halves.encoders.take().ok_or("no encoders")?;
    let mut out = halves.analog_out.take().ok_or("no outputs")?;
    std::fs::remove_file(&path)?;
    let mut times = Vec::new();
    for slice in 0..cycles / SLICE_CYCLES {
        let begin = Instant::now();
        for at in 0..SLICE_CYCLES {
            // Microseconds, so that no number of the board becomes stale.
            let release = Nanos((slice * SLICE_CYCLES + at + 1) * 1_000);
            cycle(encoders.as_mut(), out.as_mut(), release);
        }
        times.push(begin.elapsed().as_nanos() as f64 / SLICE_CYCLES as f64);
    }
    times.sort_by(f64::total_cmp);
    Ok(times)
}

/// The instructions that a cycle takes, if there is a tool that counts them.
fn instructions(name: &str) -> Option<f64> {
    let count = |cycles: i64| {
        let output = Command::new("valgrind")
            .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
            .arg(std::env::current_exe().ok()?)
            .args([name, &cycles.to_string()])
            .output()
            .ok()?;
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        let line = text.lines().find(|line| line.contains("Collected"))?;
        line.rsplit(' ').next()?.parse::<f64>().ok()
    };
    let [few, many] = COUNTED_CYCLES;
    Some((count(many)? - count(few)?) / (many - few) as f64)
}

fn main() -> Result<(), Fault> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [name, cycles] = arguments.as_slice() {
        run(name, cycles.parse()?)?;
        return Ok(());
    }
    for name in MEASURED_BOARDS {
        let times = run(name, SLICE_CYCLES * SLICES_COUNT as i64)?;
        let (median, largest) = (times[SLICES_COUNT / 2], times[SLICES_COUNT - 1]);
        let counted = instructions(name)
            .map_or("not counted: no valgrind".to_owned(), |count| format!("{count:.0}"));
        writeln!(
            std::io::stdout(),
            "{name}: median {median:.0} ns a cycle, largest slice {largest:.0} ns; \
             instructions {counted}"
        )?;
    }
    Ok(())
}
