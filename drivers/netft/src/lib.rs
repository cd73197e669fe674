//! ATI Net F/T sensors: the wrench of a wrist as datagrams, by the protocol RDT (raw data
//! transfer). The box sends 36 bytes a record by itself, up to 7000 a second, from the moment at
//! which it is asked to.
//!
//! The half takes what has arrived since the job before and hands out the newest record; it never
//! waits. Counts are the box's: `codes_per_n_nm` of the task that reads the wrist holds its counts
//! per force and torque on the diagonal.
//!
//! # Numbers that a record carries
//!
//! Every record has a number. A gap in the numbers is counted as lost records, an older number is
//! discarded and counted. A record whose status is not 0 is invalid, whatever its numbers are: it
//! is counted and never handed out. A component at or beyond the configured end of the range is
//! marked over range.
//!
//! # Age
//!
//! A record carries no time. It is stamped one period of the records before the release that found
//! it, because the newest one that has arrived is at most that old. When more than
//! [`BACKLOG_RECORDS_MAX`] have piled up, the kernel may have discarded the newest ones: their age
//! is unknown, they are not handed out, and the next job has fresh ones.
//!
//! # A cable that is pulled
//!
//! After `stale_ms` without a valid record the half says stale, and asks the box to start again
//! every `ask_again_ms`. When records come back it goes on. A box that has restarted in between has
//! forgotten its bias: where one was asked for, the half is lost until it is opened anew; elsewhere
//! the restart is counted.

mod config;
mod half;
mod monitor;
mod port;
pub mod rdt;
mod stream;

pub use config::Config;
pub use half::{BACKLOG_RECORDS_MAX, NetFt};
pub use monitor::StreamMonitor;
pub use port::{Arrival, Port, UdpPort};
pub use stream::{StreamCounts, Verdict};

use taktil_hal::{OpenError, SystemCall};

/// What the half asks of the kernel within a job.
pub const SYSTEM_CALLS: &[SystemCall] = &[
    SystemCall {
        name: "recv",
        about: "takes one record; the socket does not block, and the calls of a job are counted",
    },
    SystemCall {
        name: "send",
        about: "asks a silent box to start again; the socket does not block",
    },
];

/// Connects to the box that `config` names, takes its bias where that is asked for, and starts the
/// stream.
///
/// # Errors
/// The config is refused; nobody answers; what answers sends no records.
pub fn open(config: &Config) -> Result<NetFt, OpenError> {
    config.check()?;
    let mut port = UdpPort::connect(&config.address).map_err(|error| {
        let what = format!("no socket can be connected to it ({error})");
        let remedy = "give this host an address in the sensor's network";
        OpenError::device(&config.address, "address", what, remedy)
    })?;
    port.start(config)?;
    Ok(NetFt::new(Box::new(port), config))
}
