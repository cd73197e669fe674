//! The `taktil` process: the counting allocator and the command line, nothing else.

use std::process::ExitCode;

use taktil_rtcore::guard::CountingAllocator;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

fn main() -> ExitCode {
    taktil_lab_command::main(&[], &[])
}
