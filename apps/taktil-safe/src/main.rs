//! The program that makes the boards of the service safe after it has died.

use std::process::ExitCode;

fn main() -> ExitCode {
    taktil_machine_service::safe::main(&[])
}
