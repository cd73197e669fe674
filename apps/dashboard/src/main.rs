//! The `taktil-dashboard` process: the page of a running machine, as an ordinary user.

use std::process::ExitCode;

fn main() -> ExitCode {
    taktil_machine_page::process::main()
}
