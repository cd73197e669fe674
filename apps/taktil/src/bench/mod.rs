//! `taktil bench`: what the executor costs a cycle and a hop, in time and in instructions; the
//! contact models against each other; the simulator against its finest level. Refuses to time
//! tasks: those of the chain do nothing.

pub mod chain;
pub mod contact;
mod fall;
pub mod measure;
pub mod readers;
pub mod scenes;
pub mod servo;
pub mod sim;
pub mod space;
mod tables;
pub mod touch;

use std::process::ExitCode;

use taktil_machine_console::out;
use taktil_rtcore::Recording;

use chain::{Chain, Flow, Shape};
use measure::{Contest, Contestant, Plan};
use taktil_machine_console::option::BadOption;

/// What can be measured.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum Bench {
    /// The executor: a chain of tasks that do nothing, time and instructions a cycle and a hop.
    ///
    /// The same program beside cu29 (copper-rs): `cargo run --release` in tests/bench-executor.
    Executor(Plan),
    /// Whether a lane does the same work whoever reads its records: instructions of a job with no
    /// reader and with eight, counted by callgrind (package valgrind).
    ///
    /// Exit code 0: the same within 1 %; 1: not, or nothing could be counted.
    Readers(readers::Plan),
    /// Contact in three dimensions: time against error of every solver, and the images of a pin
    /// under each of its motions.
    Contact3d(space::Plan),
    /// Plane contact: the thesis's statements beside the exact layer, work against precision of
    /// every method, and the figures.
    Contact(contact::Plan),
    /// The modes of the joint servo: rest and tracking error, torque noise, stability margins.
    Servo(servo::Plan),
    /// The simulator: wall time of a simulated second against error, by integrator, step and
    /// contact model, of the arm alone, of a pin on rails, and of scenes run by the whole stack.
    Sim(sim::Plan),
    /// The laws of touch: time from an image to the joint step.
    Touch(touch::Plan),
}

/// Measures and prints.
///
/// # Errors
/// [`BadOption`] for what cannot be used.
pub fn run(bench: &Bench) -> anyhow::Result<ExitCode> {
    match bench {
        Bench::Executor(plan) => executor(plan, Vec::new()),
        Bench::Readers(plan) => readers::run(plan),
        Bench::Contact3d(plan) => space::run(plan),
        Bench::Contact(plan) => contact::run(plan),
        Bench::Servo(plan) => servo::run(plan),
        Bench::Sim(plan) => sim::run(plan),
        Bench::Touch(plan) => touch::run(plan),
    }
}

/// Our chains and, beside them, those of others.
///
/// # Errors
/// [`BadOption`] for what cannot be used.
pub fn executor(plan: &Plan, others: Vec<Contestant>) -> anyhow::Result<ExitCode> {
    plan.check().map_err(BadOption)?;
    let mut contestants = ours()?;
    contestants.extend(others);
    if let Some([place, cycles]) = plan.only.as_deref() {
        // A child under the instruction counter: one contestant, no answer.
        let one = usize::try_from(*place).ok().and_then(|place| contestants.get_mut(place));
        let one = one.ok_or_else(|| BadOption(format!("--only {place}: no such chain")))?;
        (one.run)(*cycles);
        return Ok(ExitCode::SUCCESS);
    }
    let mut contest = Contest::new(contestants);
    contest.time(plan);
    if plan.instructions {
        contest.count()?;
    }
    if plan.json {
        out::line(contest.json())?;
    } else {
        out::text(contest.table())?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Hops of the long chain.
pub const HOPS: usize = 6;

fn ours() -> anyhow::Result<Vec<Contestant>> {
    let mut all = Vec::new();
    let ways = [
        ("recording off", Recording::Off, false),
        ("each task timed", Recording::Off, true),
        ("every value recorded", Recording::Values, false),
    ];
    for flow in [Flow::I32, Flow::F64x6] {
        for (way, recording, time_tasks) in ways {
            for hops in [0, HOPS] {
                let mut chain = Chain::new(Shape { hops, flow, recording, time_tasks })?;
                all.push(Contestant {
                    who: "taktil",
                    flow: flow.name(),
                    way,
                    hops,
                    run: Box::new(move |cycles| {
                        let mut watch = measure::Watch::default();
                        chain.run(cycles, |begin| watch.lap(begin));
                        watch.total()
                    }),
                });
            }
        }
    }
    Ok(all)
}
