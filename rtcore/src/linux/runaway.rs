//! Stops real-time threads that compute and never wait from blocking the processor. Such a thread
//! keeps every ordinary thread off its processor; without another processor and without throttling
//! no thread could detect that it hangs. The kernel counts the processor time that a real-time
//! thread uses without a wait (`RLIMIT_RTTIME`, setrlimit(2)) and sends it `SIGXCPU` at the limit:
//! here the thread then makes itself an ordinary one. Before that it costs nothing. The task is not
//! ended: no thread can be ended from outside, and what it holds is unknown.
//!
//! `SCHED_DEADLINE` lanes do not need this: the kernel takes the processor from them.

use core::cell::Cell;
use core::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::OnceLock;

use nix::sys::resource::{Resource, getrlimit, setrlimit};
use nix::sys::signal::{SaFlags, SigAction, SigHandler, SigSet, SigmaskHow, Signal};
use nix::sys::signal::{raise, sigaction, sigprocmask};
use taktil_hal::{Clock, Nanos};

use super::MonotonicClock;
use crate::activity::LaneActivity;

/// The data of the lane's thread for the signal handler.
#[derive(Clone, Copy)]
struct ThreadBinding {
    activity: *const LaneActivity,
    clock: MonotonicClock,
    /// A job that takes this long counts as hanging.
    limit: Nanos,
}

thread_local! {
    /// It has no destructor and is initialised at compile time, so a signal handler may read it.
    static BINDING: Cell<Option<ThreadBinding>> = const { Cell::new(None) };
}

/// The action on `SIGXCPU` before the first live run.
static PREVIOUS_ACTION: OnceLock<SigAction> = OnceLock::new();
/// Number of live runs of this process. Sequentially consistent, like the next static: it is
/// touched twice a run.
static LIVE_RUNS: AtomicUsize = AtomicUsize::new(0);
/// The soft limit before the first live run (us).
static SOFT_LIMIT_US: AtomicU64 = AtomicU64::new(libc::RLIM_INFINITY);

/// Lowers `RLIMIT_RTTIME` of the process for as long as it lives.
#[derive(Debug)]
pub(crate) struct RealTimeLimit;

impl RealTimeLimit {
    /// Sends a signal to every real-time thread that computes for `limit` without a wait. A lower
    /// limit that is already set stays. The signal is not guaranteed, so the carrying thread
    /// watches too.
    pub(crate) fn hold(limit: Nanos) -> RealTimeLimit {
        PREVIOUS_ACTION.get_or_init(|| {
            let handler = SigHandler::Handler(on_sigxcpu);
            let action = SigAction::new(handler, SaFlags::SA_RESTART, SigSet::empty());
            // SAFETY: the handler touches nothing but atomics, a thread-local without a destructor
            // and system calls that POSIX allows in it or that are bare on Linux.
            let before = unsafe { sigaction(Signal::SIGXCPU, &action) };
            before.unwrap_or_else(|_| {
                SigAction::new(SigHandler::SigDfl, SaFlags::empty(), SigSet::empty())
            })
        });
        let wanted = limit.0.unsigned_abs().div_ceil(1000);
        let first = LIVE_RUNS.fetch_add(1, Ordering::SeqCst) == 0;
        if let (true, Ok((soft, hard))) = (first, getrlimit(Resource::RLIMIT_RTTIME)) {
            SOFT_LIMIT_US.store(soft, Ordering::SeqCst);
            let _ = setrlimit(Resource::RLIMIT_RTTIME, soft.min(wanted), hard);
        }
        RealTimeLimit
    }
}

impl Drop for RealTimeLimit {
    fn drop(&mut self) {
        let last = LIVE_RUNS.fetch_sub(1, Ordering::SeqCst) == 1;
        if let (true, Ok((_, hard))) = (last, getrlimit(Resource::RLIMIT_RTTIME)) {
            let _ = setrlimit(
                Resource::RLIMIT_RTTIME,
                SOFT_LIMIT_US.load(Ordering::SeqCst).min(hard),
                hard,
            );
        }
    }
}

/// Runs a lane's jobs on this thread. A job that takes `limit` by `clock`, and that the kernel says
/// has not waited, makes the thread an ordinary one; the lane's activity then says so.
pub(crate) fn run_bounded<R>(
    activity: &LaneActivity,
    clock: &MonotonicClock,
    limit: Nanos,
    jobs: impl FnOnce() -> R,
) -> R {
    struct ClearBinding;
    impl Drop for ClearBinding {
        fn drop(&mut self) {
            BINDING.set(None);
        }
    }
    let mut wanted = SigSet::empty();
    wanted.add(Signal::SIGXCPU);
    let _ = sigprocmask(SigmaskHow::SIG_UNBLOCK, Some(&wanted), None);
    BINDING.set(Some(ThreadBinding { activity, clock: *clock, limit }));
    let _clear = ClearBinding;
    jobs()
}

extern "C" fn on_sigxcpu(_: libc::c_int) {
    let errno = nix::errno::Errno::last();
    match BINDING.get() {
        Some(binding) => {
            // SAFETY: `run_bounded` borrows the activity for as long as the binding stands on this
            // thread.
            let activity = unsafe { &*binding.activity };
            // Jobs one after the other without a pause are no hang; the kernel asks again in 1 s.
            let busy = activity.busy_since();
            if busy.is_some_and(|since| binding.clock.now() - since >= binding.limit) {
                let none = libc::sched_param { sched_priority: 0 };
                // SAFETY: the kernel reads a struct that lives on this stack; thread 0 is this one.
                let code =
                    unsafe { libc::sched_setscheduler(0, libc::SCHED_OTHER, &raw const none) };
                if code == 0 {
                    activity.mark_runaway();
                }
            }
        }
        // The signal is not meant for a lane: it is about the processor time of the process, or
        // about another thread.
        None => {
            if let Some(before) = PREVIOUS_ACTION.get() {
                // SAFETY: puts back what was there before us.
                let _ = unsafe { sigaction(Signal::SIGXCPU, before) };
                let _ = raise(Signal::SIGXCPU);
            }
        }
    }
    errno.set();
}
