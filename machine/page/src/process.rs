//! The page as a process of its own, for a machine that runs elsewhere on this host: arguments and
//! exit codes.

use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::{Args, CommandFactory, Parser};
use taktil_machine_client::SERVICE_SOCKET;
use taktil_machine_console::option::BadOption;
use taktil_machine_console::{out, signals};

use crate::{PageConfig, PageServer};

/// How long one wait for a signal lasts.
const WAIT_STEP: Duration = Duration::from_millis(100);

/// Where the page is served, and for which machine.
#[derive(Args, Clone, Debug)]
pub struct DashboardArgs {
    /// Socket of the run or the service
    #[arg(long, value_name = "SOCKET", default_value = SERVICE_SOCKET)]
    pub at: PathBuf,
    /// Port; 8260 when that is free, else any
    #[arg(long, value_name = "PORT")]
    pub port: Option<u16>,
    /// Address to listen at. Anything but the loopback needs --token-file, and is not encrypted
    #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    pub listen: IpAddr,
    /// File with the control token, mode 0600, 32 characters or more; made at start when absent
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Serve Foxglove and Lichtblick too, at the path /foxglove; they may only watch
    #[cfg(feature = "foxglove")]
    #[arg(long)]
    pub foxglove: bool,
    /// Serve viewers whose pages come from this origin, such as `https://app.foxglove.dev`; may be
    /// repeated. Programs and pages of own files are served anyway
    #[cfg(feature = "foxglove")]
    #[arg(long, value_name = "ORIGIN", requires = "foxglove")]
    pub foxglove_origin: Vec<String>,
}

/// The page of a running machine, for browsers on this host.
///
/// An ordinary client of the operator's socket: run it as a user who may use that. A page may watch
/// and stop; to command it has to be given the control token. The token lies in a file, and is
/// neither printed nor part of an address.
#[derive(Parser, Debug)]
#[command(
    name = "taktil-dashboard",
    version,
    after_help = "\
Exit codes: 0 ended by SIGTERM or SIGINT, 1 failed, 2 an option that cannot be used."
)]
struct Arguments {
    #[command(flatten)]
    dashboard: DashboardArgs,
}

/// The definition of the command line: options and their help.
#[must_use]
pub fn definition() -> clap::Command {
    Arguments::command()
}

/// Runs the command line of this process.
#[must_use]
pub fn main() -> ExitCode {
    match run(&Arguments::parse().dashboard) {
        Ok(code) => code,
        Err(error) => {
            out::warn(format_args!("error: {error:#}"));
            ExitCode::from(if error.is::<BadOption>() { 2 } else { 1 })
        }
    }
}

/// Serves the page until a signal comes.
///
/// # Errors
/// [`BadOption`] for an address or a token file that cannot be used.
pub fn run(arguments: &DashboardArgs) -> anyhow::Result<ExitCode> {
    let stop = signals::stop_request()?;
    let server = PageServer::start(&PageConfig {
        socket: arguments.at.clone(),
        address: arguments.listen,
        port: arguments.port,
        token_file: arguments.token_file.clone(),
        #[cfg(feature = "foxglove")]
        viewer_origins: arguments.foxglove.then(|| arguments.foxglove_origin.clone()),
    });
    let server =
        server.map_err(|bad| BadOption(format!("{}: {}; {}", bad.place, bad.what, bad.remedy)))?;
    if nix::unistd::geteuid().is_root() {
        out::warn("the page is served as root; an ordinary user who may use the socket is enough");
    }
    out::warn(format_args!("the page of {} is at {}", arguments.at.display(), server.url()));
    #[cfg(feature = "foxglove")]
    if arguments.foxglove {
        let (viewers, layout) = (server.viewer_url(), server.url());
        out::warn(format_args!(
            "viewers connect to {viewers}; their layout is {layout}foxglove-layout.json"
        ));
    }
    let token = server.token_path().display();
    out::warn(format_args!("to command from it, give it the token in {token}"));
    while !stop.is_set() {
        std::thread::sleep(WAIT_STEP);
    }
    Ok(ExitCode::SUCCESS)
}
