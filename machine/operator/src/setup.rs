//! What the server's thread is given, and what it shares with the thread of the machine's records.

use std::sync::atomic::{AtomicBool, AtomicI64};
use std::sync::{Arc, OnceLock};

use serde_json::Value;
use taktil_machine::operator::OperatorSender;
use taktil_machine::operator::command::CommandContext;
use taktil_rtcore::Invalid;
use taktil_rtcore::lateness::LatenessCounts;

/// What an operator may do to the recording of a run. None of it waits for the disk.
pub trait RecordingControl: Send + Sync {
    /// Begins or ends the recording.
    ///
    /// # Errors
    /// Why it cannot be.
    fn set_recording(&self, on: bool) -> Result<(), Invalid>;

    /// What is recorded, how much, and what was lost.
    fn report(&self) -> Value;
}

/// What the server needs besides the machine.
pub struct ServerSetup {
    /// The end of the channel into the lane.
    pub sender: OperatorSender,
    /// The arm and the speed of typed moves.
    pub context: CommandContext,
    /// What kind of machine this is, for `status`: an object.
    pub about: Value,
    /// The recording, if there can be one.
    pub recording: Option<Arc<dyn RecordingControl>>,
}

/// What both threads see.
#[derive(Debug, Default)]
pub(crate) struct SharedState {
    pub(crate) is_ended: AtomicBool,
    /// Logical time.
    pub(crate) now_ns: AtomicI64,
    /// The kernel's monotonic clock at logical time zero.
    pub(crate) origin_ns: AtomicI64,
    /// Records that did not fit into the queue.
    pub(crate) lost: AtomicI64,
    /// Whether a client's word has reached the machine.
    pub(crate) has_intervened: AtomicBool,
    /// What the kernel granted.
    pub(crate) attestation: OnceLock<Value>,
    /// How late the jobs of each lane began, in the order of the catalog's lanes.
    pub(crate) lateness: Vec<Arc<LatenessCounts>>,
}
