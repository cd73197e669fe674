//! `taktil bench`: what the executor costs a cycle and a hop, in time and in instructions; the
//! contact models against each other; the simulator against its finest level. Refuses to time
//! tasks: those of the chain do nothing.

pub mod chain;
pub mod contact;
pub mod measure;
pub mod readers;
pub mod space;

use std::process::ExitCode;

use taktil_machine_console::out;
use taktil_rtcore::Recording;

use chain::{Chain, Flow, Shape};
use measure::{Contest, Contestant, Plan};
use taktil_machine_console::option::BadOption;

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
