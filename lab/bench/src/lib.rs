//! The measurements of `taktil bench`: what the executor costs in each cycle and hop, in time and
//! in instructions ([`chain`], [`measure`]); what the readers of records cost a lane ([`readers`]);
//! and the contact models in the plane and in space, their work against their precision and the
//! statements and figures of the thesis ([`contact`], [`space`]). The tasks of the chains do
//! nothing, so that only the executor is measured.

pub mod chain;
pub mod contact;
pub mod measure;
pub mod readers;
pub mod space;

use std::process::ExitCode;

use taktil_machine_console::out;
use taktil_rtcore::Recording;

use chain::{Chain, ChainConfig, PayloadKind};
use measure::{Benchmark, BenchmarkCase, Options};
use taktil_machine_console::option::BadOption;

/// Measures our chains and, beside them, the cases of other executors.
///
/// # Errors
/// [`BadOption`] for what cannot be used.
pub fn run_executor(plan: &Options, others: Vec<BenchmarkCase>) -> anyhow::Result<ExitCode> {
    plan.check().map_err(BadOption)?;
    let mut cases = taktil_cases()?;
    cases.extend(others);
    if let Some([place, cycles]) = plan.only.as_deref() {
        // This is a child process under the instruction counter. It runs one case and prints
        // nothing.
        let one = usize::try_from(*place).ok().and_then(|place| cases.get_mut(place));
        let one = one.ok_or_else(|| BadOption(format!("--only {place}: no such chain")))?;
        (one.run)(*cycles);
        return Ok(ExitCode::SUCCESS);
    }
    let mut benchmark = Benchmark::new(cases);
    benchmark.measure_times(plan);
    if plan.instructions {
        benchmark.count_instructions()?;
    }
    if plan.json {
        out::line(benchmark.json())?;
    } else {
        out::text(benchmark.table())?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Number of hops of the long chain; the short one has none.
pub const LONG_CHAIN_HOPS: usize = 6;

fn taktil_cases() -> anyhow::Result<Vec<BenchmarkCase>> {
    let mut all = Vec::new();
    let configurations = [
        ("recording off", Recording::Off, false),
        ("each task timed", Recording::Off, true),
        ("every value recorded", Recording::Values, false),
    ];
    for payload in [PayloadKind::I32, PayloadKind::F64x6] {
        for (configuration, recording, time_tasks) in configurations {
            for hops in [0, LONG_CHAIN_HOPS] {
                let mut chain = Chain::new(ChainConfig { hops, payload, recording, time_tasks })?;
                all.push(BenchmarkCase {
                    executor: "taktil",
                    payload: payload.name(),
                    configuration,
                    hops,
                    run: Box::new(move |cycles| {
                        let mut watch = measure::Stopwatch::default();
                        chain.run(cycles, |begin| watch.lap(begin));
                        watch.total()
                    }),
                });
            }
        }
    }
    Ok(all)
}
