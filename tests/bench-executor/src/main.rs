//! `taktil bench executor` with cu29 beside it: the same chains, the same slices, the same counter.

mod copper;
mod tasks;

use std::process::ExitCode;

use clap::Parser;
use taktil_lab_bench::measure::Options;
use taktil_rtcore::guard::CountingAllocator;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// The executor beside cu29: a chain of tasks that do nothing.
#[derive(Parser)]
struct Arguments {
    #[command(flatten)]
    plan: Options,
}

fn main() -> anyhow::Result<ExitCode> {
    let arguments = Arguments::parse();
    let folder = copper::Folder::new()?;
    taktil_lab_bench::run_executor(&arguments.plan, copper::all(folder.path())?)
}
