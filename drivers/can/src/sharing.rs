//! Gives the halves of the drives their bus, one at a time, without ever waiting: a bus that
//! another lane is in is an answer like any other. Going safe is then left to whoever is in it.

use core::sync::atomic::{AtomicU8, Ordering};
#[expect(clippy::disallowed_types, reason = "only `try_lock` is called: nobody ever waits")]
use std::sync::Mutex;
use std::sync::{Arc, TryLockError};

use crate::bus::{Bus, Failure, Half};
use crate::monitor::BusMonitor;

/// How often whoever leaves the bus looks for halves that asked for their safe values meanwhile.
const SAFE_LOOKS_MAX: usize = 4;

/// A bus that several halves use.
#[derive(Clone)]
pub(crate) struct Shared(Arc<Inner>);

struct Inner {
    /// A bit for each half that is to go safe and found the bus taken.
    safe: AtomicU8,
    monitor: BusMonitor,
    #[expect(clippy::disallowed_types, reason = "only `try_lock` is called: nobody ever waits")]
    bus: Mutex<Bus>,
}

impl core::fmt::Debug for Shared {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Shared").finish_non_exhaustive()
    }
}

const fn bit(half: Half) -> u8 {
    match half {
        Half::Torques => 1,
        Half::Lines => 2,
    }
}

impl Shared {
    #[expect(clippy::disallowed_types, reason = "only `try_lock` is called: nobody ever waits")]
    pub(crate) fn new(bus: Bus) -> Shared {
        let (safe, monitor) = (AtomicU8::new(0), BusMonitor::default());
        monitor.publish(&bus);
        Shared(Arc::new(Inner { safe, monitor, bus: Mutex::new(bus) }))
    }

    pub(crate) fn monitor(&self) -> BusMonitor {
        self.0.monitor.clone()
    }

    /// Acts on the bus; `None` if somebody else is in it.
    pub(crate) fn with<R>(&self, act: impl FnOnce(&mut Bus) -> R) -> Option<R> {
        let Some(answer) = self.enter(act) else {
            self.0.monitor.add_collision();
            return None;
        };
        // Who asked between the last look and the leaving was not heard: look again from outside.
        for _ in 0..SAFE_LOOKS_MAX {
            let is_asked = self.0.safe.load(Ordering::SeqCst) != 0;
            if !is_asked || self.enter(|_| ()).is_none() {
                break;
            }
        }
        Some(answer)
    }

    /// Acts on a bus that nobody is in, and does what halves asked for meanwhile.
    fn enter<R>(&self, act: impl FnOnce(&mut Bus) -> R) -> Option<R> {
        let mut bus = match self.0.bus.try_lock() {
            Ok(bus) => bus,
            // A thread that panicked in the bus leaves it usable: every use starts anew.
            Err(TryLockError::Poisoned(bus)) => bus.into_inner(),
            Err(TryLockError::WouldBlock) => return None,
        };
        let answer = act(&mut bus);
        // Sequentially consistent, as the lock's exchange is ordered with it by the looks: a half
        // sets its bit and then tries the lock, whoever leaves frees the lock and then looks.
        let asked = self.0.safe.swap(0, Ordering::SeqCst);
        for half in [Half::Torques, Half::Lines] {
            if asked & bit(half) != 0 {
                let _ = bus.safe(half);
            }
        }
        self.0.monitor.publish(&bus);
        Some(answer)
    }

    /// Ends a half; whoever is in the bus makes it safe when it leaves.
    pub(crate) fn end(&self, half: Half) {
        self.0.safe.fetch_or(bit(half), Ordering::SeqCst);
        let _ = self.with(|bus| {
            self.0.safe.fetch_and(!bit(half), Ordering::SeqCst);
            bus.end(half);
        });
    }

    /// Lets a half go safe: now, or by whoever is in the bus as soon as it leaves; `None` then.
    pub(crate) fn safe(&self, half: Half) -> Option<Result<(), Failure>> {
        self.0.safe.fetch_or(bit(half), Ordering::SeqCst);
        self.with(|bus| {
            self.0.safe.fetch_and(!bit(half), Ordering::SeqCst);
            bus.safe(half)
        })
    }
}
