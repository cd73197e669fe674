//! The service with the driver `iio`: `own-driver --config FILE`, as `taktild` is used.

use std::process::ExitCode;

use taktil_machine_boards::Driver;
use taktil_rtcore::guard::CountingAllocator;

// As in the house's programs: heap calls inside jobs are counted.
#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// The drivers of this program, besides the house's.
static DRIVERS: [Driver; 1] = [own_driver::DRIVER];

fn main() -> ExitCode {
    taktil_machine_service::process::main(&[], &DRIVERS)
}
