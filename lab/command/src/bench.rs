//! `taktil bench`: measures the time, the instructions and the errors of parts of this program.

use std::process::ExitCode;

use taktil_lab_bench::{contact, measure, readers, run_executor, space};
use taktil_lab_experiment::{servo, sim, touch};

/// What can be measured.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum Bench {
    /// The executor: a chain of tasks that do nothing, time and instructions a cycle and a hop.
    ///
    /// The same program beside cu29 (copper-rs): `cargo run --release` in tests/bench-executor.
    Executor(measure::Options),
    /// Whether a lane does the same work whoever reads its records: instructions of a job with no
    /// reader and with eight, counted by callgrind (package valgrind).
    ///
    /// Exit code 0: the same within 1 %; 1: not, or nothing could be counted.
    Readers(readers::Options),
    /// Contact in three dimensions: time against error of every solver, and the images of a pin
    /// under each of its motions.
    Contact3d(space::Options),
    /// Plane contact: the thesis's statements beside the exact layer, work against precision of
    /// every method, and the figures.
    Contact(contact::Options),
    /// The modes of the joint servo: rest and tracking error, torque noise, stability margins.
    Servo(servo::Options),
    /// The simulator: wall time of a simulated second against error, by integrator, step and
    /// contact model, of the arm alone, of a pin on rails, and of scenes run by the whole stack.
    Sim(sim::Options),
    /// The laws of touch: time from an image to the joint step.
    Touch(touch::Options),
}

/// Measures and prints the result.
///
/// # Errors
/// [`BadOption`](taktil_machine_console::option::BadOption) for an option that cannot be used.
pub fn run(bench: &Bench) -> anyhow::Result<ExitCode> {
    match bench {
        Bench::Executor(plan) => run_executor(plan, Vec::new()),
        Bench::Readers(plan) => readers::run(plan),
        Bench::Contact3d(plan) => space::run(plan),
        Bench::Contact(plan) => contact::run(plan),
        Bench::Servo(plan) => servo::run(plan),
        Bench::Sim(plan) => sim::run(plan),
        Bench::Touch(plan) => touch::run(plan),
    }
}
