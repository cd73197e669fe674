//! The `taktild` process: the counting allocator and the service, nothing else.

use std::process::ExitCode;

use taktil_rtcore::guard::CountingAllocator;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

fn main() -> ExitCode {
    taktil_machine_service::process::main(&[], &[])
}
