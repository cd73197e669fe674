//! Shows what the closed-form inverse holds over many poses: `cargo run --release -p
//! taktil-mechanics --example inverse_bars`. Ends with 1 when a bar is missed.

#[path = "../tests/bars/checks.rs"]
mod checks;

use checks::{Tally, near_singular, random, through_the_wrist};
use std::process::ExitCode;

/// Prints a line; whether the bars hold.
fn told(name: &str, tally: &Tally, bar_m: f64, bar_rad: f64) -> bool {
    println!(
        "{name:<22} {:>8} poses: {} short of 8, {} doubled, {} lost, {} not finite; worst {:.1e} m \
         (bar {bar_m:.0e}), {:.1e} rad (bar {bar_rad:.0e}); own joints at {:.2} of their tolerance",
        tally.poses,
        tally.short,
        tally.doubles,
        tally.lost,
        tally.not_finite,
        tally.off_m,
        tally.off_rad,
        tally.ratio,
    );
    let whole = (tally.short, tally.doubles, tally.lost, tally.not_finite) == (0, 0, 0, 0);
    whole && tally.off_m <= bar_m && tally.off_rad <= bar_rad
}

fn main() -> ExitCode {
    let held = [
        told("random", &random(1_000_000, 1), 1e-14, 1e-14),
        told("beside singularities", &near_singular(100_000, 2), 1e-12, 1e-9),
        told("joint 5 to 0", &through_the_wrist(1_000, 300, 3), 1e-12, 1e-9),
    ];
    if held.iter().all(|held| *held) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
