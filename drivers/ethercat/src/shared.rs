//! Gives the halves of a segment the segment, one at a time, without a lock: who finds it taken is
//! told so at once and never waits.
#![allow(unsafe_code)]

use core::cell::UnsafeCell;
use core::fmt;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};

use taktil_hal::ErrorKind;

use crate::bus::{Bus, Half};
use crate::health::Diagnostics;

/// How often whoever leaves the segment looks for halves that asked for their safe values
/// meanwhile.
const SAFE_LOOKS_MAX: usize = 4;

/// A segment that several halves use.
pub(crate) struct Shared {
    /// Whether somebody is on the segment.
    taken: AtomicBool,
    /// A bit for each half that is to go safe and found the segment taken.
    safe: AtomicU8,
    /// Calls that found the segment taken.
    collisions: AtomicU64,
    /// Whether the half of the lines is there, which commits last.
    has_lines: AtomicBool,
    /// What was counted, for whoever looks from outside.
    counts: [AtomicU64; Diagnostics::WORDS_COUNT],
    bus: UnsafeCell<Bus>,
}

// SAFETY: `bus` is reached only between a successful `try_take` and the store that gives it back,
// and the exchange of `taken` lets one thread at a time through; what it does is seen by the next
// one. `Bus` is `Send`, so it may be used from one thread after another.
unsafe impl Sync for Shared {}

/// The argument above rests on it.
const fn require_send<T: Send>() {}
const _: () = require_send::<Bus>();

impl fmt::Debug for Shared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Shared").finish_non_exhaustive()
    }
}

const fn bit(half: Half) -> u8 {
    match half {
        Half::Analog => 1,
        Half::Lines => 2,
    }
}

impl Shared {
    pub(crate) fn new(bus: Bus) -> Shared {
        Shared {
            taken: AtomicBool::new(false),
            safe: AtomicU8::new(0),
            collisions: AtomicU64::new(0),
            has_lines: AtomicBool::new(false),
            counts: bus.seen().words().map(AtomicU64::new),
            bus: UnsafeCell::new(bus),
        }
    }

    /// Whether the half of the lines is there.
    pub(crate) fn has_lines(&self) -> bool {
        // Relaxed: halves are made and dropped before the lane begins, or as it ends.
        self.has_lines.load(Ordering::Relaxed)
    }

    /// The half of the lines is there.
    pub(crate) fn open_lines(&self) {
        self.has_lines.store(true, Ordering::Relaxed);
        self.with(|bus| bus.set_closer(Some(Half::Lines)));
    }

    /// The half of the lines is gone.
    pub(crate) fn close_lines(&self) {
        self.has_lines.store(false, Ordering::Relaxed);
        self.with(|bus| bus.set_closer(None));
    }

    /// What had been counted when the segment was left last.
    pub(crate) fn diagnostics(&self) -> Diagnostics {
        // Relaxed: each number is whole and only grows; two of them may be of different cycles.
        let words = self.counts.each_ref().map(|word| word.load(Ordering::Relaxed));
        // Nobody may have been on the segment since the newest collision.
        let collisions = self.collisions.load(Ordering::Relaxed);
        Diagnostics { collisions, ..Diagnostics::from_words(words) }
    }

    fn publish(&self, bus: &Bus) {
        // Relaxed: the numbers order nothing.
        for (shown, word) in self.counts.iter().zip(bus.seen().words()) {
            shown.store(word, Ordering::Relaxed);
        }
    }

    fn try_take(&self) -> bool {
        // Sequentially consistent, with the bits in `safe`: see `asked`.
        self.taken.compare_exchange(false, true, Ordering::SeqCst, Ordering::SeqCst).is_ok()
    }

    /// Acts on the segment; `None` if somebody else is on it.
    pub(crate) fn with<R>(&self, act: impl FnOnce(&mut Bus) -> R) -> Option<R> {
        if !self.try_take() {
            // Relaxed: a count, which orders nothing.
            self.collisions.fetch_add(1, Ordering::Relaxed);
            return None;
        }
        let answer = self.act_and_leave(act);
        // Who asked between the last look and the leaving was not heard: look again from outside.
        for _ in 0..SAFE_LOOKS_MAX {
            if self.safe.load(Ordering::SeqCst) == 0 || !self.try_take() {
                break;
            }
            self.act_and_leave(|_| ());
        }
        Some(answer)
    }

    /// Acts on the segment, does what halves asked for meanwhile, then lets the next one in. Only
    /// for whoever has taken it.
    fn act_and_leave<R>(&self, act: impl FnOnce(&mut Bus) -> R) -> R {
        let answer = {
            // SAFETY: both callers have taken the segment, and nobody else does until the store
            // below; the reference ends with this block, because neither `act` nor its answer can
            // keep it.
            let bus = unsafe { &mut *self.bus.get() };
            let answer = act(bus);
            for half in self.asked() {
                let _ = bus.safe(half);
            }
            self.publish(bus);
            answer
        };
        // The next one sees all that was done here.
        self.taken.store(false, Ordering::SeqCst);
        answer
    }

    fn asked(&self) -> impl Iterator<Item = Half> {
        // Sequentially consistent, as `taken` is: a half sets its bit and then tries to take the
        // segment, whoever leaves gives the segment back and then looks at the bits. In any one
        // order of these four at least one of the two sees the other.
        let bits = self.safe.swap(0, Ordering::SeqCst);
        [Half::Analog, Half::Lines].into_iter().filter(move |half| bits & bit(*half) != 0)
    }

    /// Lets a half go safe: now, or by whoever is on the segment as soon as it leaves; `None` then.
    pub(crate) fn safe(&self, half: Half) -> Option<Result<(), ErrorKind>> {
        self.safe.fetch_or(bit(half), Ordering::SeqCst);
        self.with(|bus| {
            self.safe.fetch_and(!bit(half), Ordering::SeqCst);
            bus.safe(half)
        })
    }
}
