//! The command `taktil storm` alone, for whoever builds it often: `cargo run --release -p
//! taktil-lab-storm --example storm -- --seeds 0..200`.

use std::process::ExitCode;

use clap::Parser;
use taktil_lab_storm::command::{StormArgs, run};
use taktil_machine_console::out;
use taktil_rtcore::guard::CountingAllocator;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Storms of seeded faults.
#[derive(Parser)]
struct Arguments {
    #[command(flatten)]
    storm: StormArgs,
}

fn main() -> ExitCode {
    match run(&Arguments::parse().storm) {
        Ok(code) => code,
        Err(error) => {
            out::warn(format_args!("error: {error:#}"));
            ExitCode::from(2)
        }
    }
}
