//! Ctrl-C and SIGTERM as a request to end: outputs safe, log closed, table printed. Refuses to do
//! anything inside a signal handler: a thread waits for the signals instead.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use nix::sys::signal::{SigSet, Signal};
use taktil_rtcore::{Nanos, linux};

/// Exit code of a process that a second signal ended, as a shell would report SIGINT.
const KILLED: i32 = 130;

/// Signals closer together than this are one: `timeout` sends its own to the process and to its
/// group.
const ONE: Nanos = Nanos::from_millis(100);

/// What a second signal does while the first is being obeyed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Second {
    /// Nothing: whoever sent it waits, or kills.
    Waits,
    /// Ends the process at once, with exit code 130: somebody sits at the terminal.
    Kills,
}

/// Whether somebody wants the process to end.
pub struct Ended(Arc<AtomicBool>);

impl Ended {
    /// True once a signal came.
    #[must_use]
    pub fn yet(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// As [`watch`], for whoever only asks; a second signal kills.
///
/// # Errors
/// As [`watch`].
pub fn ended() -> anyhow::Result<Ended> {
    watch(Second::Kills).map(Ended)
}

/// Blocks both signals for this thread and all it starts, and sets the returned flag when one
/// arrives.
///
/// # Errors
/// The kernel's refusal.
pub fn watch(second: Second) -> anyhow::Result<Arc<AtomicBool>> {
    let mut signals = SigSet::empty();
    signals.add(Signal::SIGINT);
    signals.add(Signal::SIGTERM);
    signals.thread_block()?;
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        let mut first = None;
        while signals.wait().is_ok() {
            flag.store(true, Ordering::SeqCst);
            let now = linux::monotonic();
            let begun = *first.get_or_insert(now);
            if second == Second::Kills && now - begun > ONE {
                std::process::exit(KILLED);
            }
        }
    })?;
    Ok(stop)
}
