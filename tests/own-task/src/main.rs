//! `taktil` with the task `sway`: `own-task run scene.toml --fast`, and every other command.

mod law;
mod task;

use std::process::ExitCode;

use taktil_machine::own::OwnTask;
use taktil_rtcore::guard::CountingAllocator;

// As in the house's programs: heap calls inside jobs are counted.
#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// The tasks of this program, besides the house's.
static TASKS: [OwnTask; 1] = [OwnTask { name: "sway", make: task::make }];

fn main() -> ExitCode {
    taktil_lab_command::main(&TASKS, &[])
}
