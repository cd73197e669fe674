//! Serves a described board in a file, for a driver in another process, until it is interrupted.
//! A/D channel n reads what D/A channel n puts out, encoder n turns at a speed given by that code,
//! power is on and the emergency stop is closed. Prints what the board puts out once a second.
//!
//! ```sh
//! cargo run -p taktil-drivers-regmap-emulator --example registers -- mine.toml /dev/shm/board
//! ```

use std::io::Write;
use std::path::Path;

use taktil_drivers_regmap_emulator::{Emulator, Inputs, Outputs, serve};
use taktil_hal::{Clock, LinesIn, Nanos};
use taktil_rtcore::linux::MonotonicClock;

/// Counts a second for each step of a D/A code.
const SPEED_PER_CODE: f64 = 1.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [description, path] = arguments.as_slice() else {
        return Err("usage: serve DESCRIPTION.toml FILE".into());
    };
    let text = std::fs::read_to_string(description)?;
    let (mut before, mut counts, mut told) = (Nanos::ZERO, Vec::new(), Nanos::ZERO);
    let plant = Box::new(move |now: Nanos, outputs: &Outputs| {
        let passed_s = (now - before).0 as f64 * 1e-9;
        before = now;
        counts.resize(outputs.codes.len(), 0.0);
        for (count, code) in counts.iter_mut().zip(&outputs.codes) {
            *count += f64::from(*code) * SPEED_PER_CODE * passed_s;
        }
        if now - told >= Nanos::from_secs(1) {
            told = now;
            let _ = writeln!(std::io::stdout(), "{outputs:?}");
        }
        Inputs {
            counts: counts.iter().map(|count| *count as i64).collect(),
            codes: outputs.codes.clone(),
            gauges: outputs.codes.clone(),
            lines: LinesIn { drive_power: true, estop_a_closed: true, estop_b_closed: true },
            ..Inputs::default()
        }
    });
    let mut emulator = Emulator::new("board", &text, Path::new(path), 0, plant)?;
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    serve(&mut emulator, &clock, &mut || clock.now() < Nanos::MAX)?;
    Ok(())
}
