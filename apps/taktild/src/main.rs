//! The service's process: arguments, exit codes, nothing else.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use taktil_rtcore::guard::CountingAllocator;
use taktild::service::Service;
use taktild::source::Located;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Robot control over real boards, as a systemd service. It comes up with the drives off and waits
/// in READY.
#[derive(Parser, Debug)]
#[command(name = "taktild", version, about)]
struct Arguments {
    /// Configuration file: machine, board, contract with the kernel
    #[arg(long, value_name = "FILE", default_value = "/etc/taktil/taktild.toml")]
    config: PathBuf,
    /// Read the configuration, open the board, print what would run, and end
    #[arg(long)]
    check: bool,
    /// Record the run to this MCAP file, instead of the configuration's `[log] path`
    #[arg(long, value_name = "F.mcap")]
    log: Option<PathBuf>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let mut service = match Service::load(&arguments.config) {
        Ok(service) => service,
        Err(located) => {
            eprintln!("{located}");
            return ExitCode::from(2);
        }
    };
    if let Some(path) = arguments.log {
        service.record_to(path);
    }
    if arguments.check {
        print!("{}", service.describe());
        return ExitCode::SUCCESS;
    }
    match service.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => match error.downcast_ref::<Located>() {
            Some(located) => {
                eprintln!("{located}");
                ExitCode::from(2)
            }
            None => {
                eprintln!("error: {error:#}");
                ExitCode::from(1)
            }
        },
    }
}
