//! The operator's server: a thread of its own behind a Unix-domain socket. It hears people, answers
//! each request under its own number, and never waits for a disk, for systemd or for a slow client.
//! A service over boards and a rehearsal on the simulated robot serve the same socket with the same
//! code; only the machine behind the ring differs.
//!
//! The words, the forms of a line and of its answer, roles, the control lease and all limits are
//! described in `docs/guides/protocol.md`.
//!
//! A stop is heard from everyone who may connect, before anything else that a client has said, also
//! when all places are taken and when somebody else holds the control lease. It reaches the lane by
//! a word of its own, not by a place in a ring.

mod access;
mod answer;
mod client;
mod lease;
mod listener;
mod model;
mod motion;
mod request;
mod scope;
mod server;
mod setup;
mod signals;
mod status;
mod thread;
mod watch;
mod words;

pub use access::Role;
pub use setup::{RecordingControl, ServerSetup};
pub use thread::OperatorServer;

use std::path::PathBuf;

use serde::Deserialize;
use taktil_machine::operator::SERVICE_SOCKET;
use taktil_machine::operator::command::CommandContext;
use taktil_rtcore::Invalid;

/// Version of the protocol: of the lines that a client may send and of those that it receives.
pub const PROTOCOL_VERSION: u32 = 1;

/// `[operator]`: where an operator is listened to, and who may do what.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OperatorConfig {
    /// Unix-domain socket.
    #[serde(default = "socket_path")]
    pub socket: PathBuf,
    /// Members of this group may command. Without it the mode of the socket's file decides, which
    /// is then for the owner and the group of the process.
    pub control_group: Option<String>,
    /// Members of this group may watch and stop.
    pub view_group: Option<String>,
}

impl OperatorConfig {
    /// A socket at `path` for the owner and the group of the process.
    #[must_use]
    pub fn at(path: PathBuf) -> OperatorConfig {
        OperatorConfig { socket: path, control_group: None, view_group: None }
    }
}

/// Reads a line of a client as the server does, without carrying anything out.
///
/// # Errors
/// Why it would be refused: the place in the line, what is wrong there, and the remedy.
pub fn check_line(line: &str, context: &CommandContext) -> Result<(), Invalid> {
    request::read(line, context).map(|_| ()).map_err(|bad| bad.why)
}

fn socket_path() -> PathBuf {
    SERVICE_SOCKET.into()
}
