//! Shows the accuracy of the closed-form inverse kinematics over many poses:
//! `cargo run --profile dist -p taktil-mechanics --example inverse_accuracy`. It ends with
//! 1 where a bound is exceeded.

#[path = "../tests/inverse_accuracy/statistics.rs"]
mod statistics;

use statistics::{Statistics, near_singular, random, through_the_wrist};
use std::process::ExitCode;

/// Prints one line. Returns whether the errors are within the bounds.
fn report(name: &str, statistics: &Statistics, bar_m: f64, bar_rad: f64) -> bool {
    println!(
        "{name:<22} {:>8} poses: {} short of 8, {} doubled, {} lost, {} not finite; worst {:.1e} m \
         (bar {bar_m:.0e}), {:.1e} rad (bar {bar_rad:.0e}); own joints at {:.2} of their tolerance",
        statistics.poses,
        statistics.missing,
        statistics.duplicates,
        statistics.not_found,
        statistics.not_finite,
        statistics.position_error_m,
        statistics.orientation_error_rad,
        statistics.ratio,
    );
    let is_complete =
        (statistics.missing, statistics.duplicates, statistics.not_found, statistics.not_finite)
            == (0, 0, 0, 0);
    is_complete
        && statistics.position_error_m <= bar_m
        && statistics.orientation_error_rad <= bar_rad
}

fn main() -> ExitCode {
    let passed = [
        report("random", &random(1_000_000, 1), 1e-14, 1e-14),
        report("beside singularities", &near_singular(100_000, 2), 1e-12, 1e-9),
        report("joint 5 to 0", &through_the_wrist(1_000, 300, 3), 1e-12, 1e-9),
    ];
    if passed.iter().all(|passed| *passed) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
