//! Ctrl-C and SIGTERM as a request to end the run: outputs safe, log closed, table printed. A
//! second one ends the process at once. Refuses to do anything inside a signal handler: a thread
//! waits for the signals instead.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use nix::sys::signal::{SigSet, Signal};

/// Exit code of a process ended by the second Ctrl-C, as a shell would report SIGINT.
const KILLED: i32 = 130;

/// Blocks both signals for this thread and all it starts, and sets the returned flag when one
/// arrives.
///
/// # Errors
/// The kernel's refusal.
pub(crate) fn watch() -> anyhow::Result<Arc<AtomicBool>> {
    let mut signals = SigSet::empty();
    signals.add(Signal::SIGINT);
    signals.add(Signal::SIGTERM);
    signals.thread_block()?;
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        while signals.wait().is_ok() {
            if flag.swap(true, Ordering::SeqCst) {
                std::process::exit(KILLED);
            }
        }
    })?;
    Ok(stop)
}
