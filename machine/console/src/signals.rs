//! Turns Ctrl-C and SIGTERM into a request to end: the run then makes its outputs safe, closes its
//! log and prints its table. Nothing is done inside a signal handler: a thread waits for the
//! signals.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use nix::sys::signal::{SigSet, Signal};
use taktil_rtcore::{Nanos, linux};

/// Exit code of a process that a second signal ended, as a shell would report SIGINT.
const EXIT_SECOND_SIGNAL: i32 = 130;

/// Signals closer together than this count as one: `timeout` sends its signal to the process and
/// then to its group.
const REPEAT_INTERVAL: Nanos = Nanos::from_millis(100);

/// The effect of a second signal while the process is ending after the first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SecondSignal {
    /// The process continues its orderly end.
    Ignored,
    /// The process exits at once, with exit code 130, as a person at the terminal expects.
    Exits,
}

/// A request to end the process, which a signal sets.
pub struct StopRequest(Arc<AtomicBool>);

impl StopRequest {
    /// True once a signal has arrived.
    #[must_use]
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// Like [`watch`], for a caller that only reads the flag; a second signal exits.
///
/// # Errors
/// As [`watch`].
pub fn stop_request() -> anyhow::Result<StopRequest> {
    watch(SecondSignal::Exits).map(StopRequest)
}

/// Blocks both signals for this thread and all threads that it starts. A process that starts
/// threads before it calls [`watch`] blocks them first: a thread that does not would be ended by
/// them, and with it the process.
///
/// # Errors
/// The kernel rejects the signal mask.
pub fn block() -> anyhow::Result<SigSet> {
    let mut signals = SigSet::empty();
    signals.add(Signal::SIGINT);
    signals.add(Signal::SIGTERM);
    signals.thread_block()?;
    Ok(signals)
}

/// Blocks both signals for this thread and all threads that it starts, and sets the returned flag
/// when one arrives.
///
/// # Errors
/// The kernel rejects the signal mask or the thread.
pub fn watch(second: SecondSignal) -> anyhow::Result<Arc<AtomicBool>> {
    let signals = block()?;
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        let mut first = None;
        while signals.wait().is_ok() {
            flag.store(true, Ordering::SeqCst);
            let now = linux::monotonic();
            let first_at = *first.get_or_insert(now);
            if second == SecondSignal::Exits && now - first_at > REPEAT_INTERVAL {
                std::process::exit(EXIT_SECOND_SIGNAL);
            }
        }
    })?;
    Ok(stop)
}
