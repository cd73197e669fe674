//! The server's thread, and the end that the thread of the machine's records holds.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;

use serde_json::Value;
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::record_ring::{RecordSender, queue};
use taktil_rtcore::{Invalid, Machine, Nanos, linux};

use crate::OperatorConfig;
use crate::access::AccessPolicy;
use crate::listener::Listener;
use crate::server::Server;
use crate::setup::{ServerSetup, SharedState};

/// Bytes of the queue of records: more than a second of a machine's values.
const QUEUE_BYTES: usize = 4 << 20;
/// How long the server may stand still before the lanes stop the machine.
const SILENCE_MAX: Nanos = Nanos::from_millis(500);
/// Priority of the server's thread, below that of any lane: a processor full of other people's work
/// does not delay a stop.
const THREAD_PRIORITY: u8 = 20;

/// The operator's server, as the thread sees it that carries the machine's records: nothing here
/// waits for the server. Dropping it ends the server and removes its socket.
pub struct OperatorServer {
    records: RecordSender,
    shared: Arc<SharedState>,
    thread: Option<JoinHandle<()>>,
}

impl OperatorServer {
    /// Listens, and serves from now on in a thread that the machine's lanes watch.
    ///
    /// # Errors
    /// A group that does not exist, a socket that cannot be had, no thread; the place is a key of
    /// `[operator]`.
    pub fn start(
        config: &OperatorConfig,
        setup: ServerSetup,
        machine: &mut Machine,
    ) -> Result<OperatorServer, Invalid> {
        let policy = AccessPolicy::new(config)?;
        let listener = Listener::bind(&config.socket, policy.has_groups())?;
        let catalog = machine.catalog().clone();
        let (records, reader) = queue(QUEUE_BYTES, &catalog);
        let lateness = machine.lateness();
        let shared = Arc::new(SharedState { lateness, ..SharedState::default() });
        let heartbeat = machine.heartbeat(SILENCE_MAX);
        let editor = machine.editor();
        let seen = Arc::clone(&shared);
        let thread = std::thread::Builder::new().name("operator".into()).spawn(move || {
            // Without the right to it the thread remains an ordinary one.
            let _ = linux::set_fifo(THREAD_PRIORITY);
            let mut server = Server::new(listener, policy, setup, catalog, editor, seen);
            server.serve(reader, &heartbeat);
        });
        let thread = thread.map_err(|error| {
            let what = format!("no thread for the server: {error}");
            Invalid::new("socket", what, "raise the limit of processes")
        })?;
        Ok(OperatorServer { records, shared, thread: Some(thread) })
    }

    /// Tells the server the logical time.
    pub fn set_time(&self, now: Nanos) {
        let origin = linux::monotonic() - now;
        self.shared.now_ns.store(now.0, Ordering::Relaxed);
        self.shared.origin_ns.store(origin.0, Ordering::Relaxed);
    }

    /// Whether a client's word has reached the machine: a request, a stop, keys, a move, values of
    /// parameters.
    #[must_use]
    pub fn has_intervened(&self) -> bool {
        self.shared.has_intervened.load(Ordering::Relaxed)
    }

    /// Tells the server, once, what the kernel granted.
    pub fn set_attestation(&self, attestation: Value) {
        let _ = self.shared.attestation.set(attestation);
    }
}

impl Observer for OperatorServer {
    fn record(&mut self, record: &Record<'_>) {
        if !self.records.send(record) {
            let lost = i64::try_from(self.records.lost()).unwrap_or(i64::MAX);
            self.shared.lost.store(lost, Ordering::Relaxed);
        }
    }
}

impl Drop for OperatorServer {
    fn drop(&mut self) {
        self.shared.is_ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // It looks at the word between two turns, none of which waits.
            let _ = thread.join();
        }
    }
}
