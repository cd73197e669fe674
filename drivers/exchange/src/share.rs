//! Gives the halves of a board or a bus what they share, one at a time, without a lock: who finds
//! it taken is told so at once and never waits. Going safe is then done by whoever is in it.
#![allow(unsafe_code)]

use core::cell::UnsafeCell;
use core::fmt;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};

use crate::answer::Failure;

/// How often whoever leaves looks for halves that asked for their safe values meanwhile.
const SAFE_LOOKS_MAX: usize = 4;

/// The output halves: what moves the motors, and the lines to the cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Half {
    /// Torques, targets or volts, by whichever half has them.
    Motors,
    /// The lines to the cell.
    Lines,
}

impl Half {
    const fn bit(self) -> u8 {
        match self {
            Half::Motors => 1,
            Half::Lines => 2,
        }
    }
}

/// What halves share: a board or a bus with which one exchange is made a cycle.
pub trait Exchange: Send {
    /// Numbers that any thread may read while somebody else is in it.
    type Shown: Send + Sync;

    /// Copies the numbers to where they are read, with the calls that found it taken so far;
    /// whoever leaves does it.
    fn publish(&self, shown: &Self::Shown, collisions: u64);

    /// Puts a half's safe values out, at once.
    ///
    /// # Errors
    /// They could not be handed over.
    fn safe(&mut self, half: Half) -> Result<(), Failure>;

    /// Puts a half's safe values out for the last time: the half is dropped.
    fn end(&mut self, half: Half) {
        let _ = self.safe(half);
    }
}

/// What halves share, and the way into it.
pub struct Shared<E: Exchange> {
    /// Whether somebody is in it.
    taken: AtomicBool,
    /// A bit for each half that is to go safe and found it taken.
    safe: AtomicU8,
    /// Calls that found it taken.
    collisions: AtomicU64,
    shown: E::Shown,
    exchange: UnsafeCell<E>,
}

// SAFETY: `exchange` is reached only between a successful `Entry::new` and the drop of that entry,
// and the exchange of `taken` lets one thread at a time through; what it does is seen by the next
// one. `Exchange` asks for `Send`, so it may be used from one thread after another; `shown` is
// `Sync` by itself.
unsafe impl<E: Exchange> Sync for Shared<E> {}

impl<E: Exchange> fmt::Debug for Shared<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Shared").finish_non_exhaustive()
    }
}

/// Somebody is in what is shared, and leaves when this goes, also by a panic.
struct Entry<'a>(&'a AtomicBool);

impl<'a> Entry<'a> {
    fn new(taken: &'a AtomicBool) -> Option<Entry<'a>> {
        // Sequentially consistent, with the bits in `safe`: see `Shared::asked`.
        let outcome = taken.compare_exchange(false, true, Ordering::SeqCst, Ordering::SeqCst);
        // Made only by who has taken it: an entry that goes lets the next one in.
        outcome.is_ok().then(|| Entry(taken))
    }
}

impl Drop for Entry<'_> {
    fn drop(&mut self) {
        // The next one sees all that was done here.
        self.0.store(false, Ordering::SeqCst);
    }
}

impl<E: Exchange> Shared<E> {
    /// What is shared from now on; `shown` gets its numbers at once.
    #[must_use]
    pub fn new(exchange: E, shown: E::Shown) -> Shared<E> {
        exchange.publish(&shown, 0);
        Shared {
            taken: AtomicBool::new(false),
            safe: AtomicU8::new(0),
            collisions: AtomicU64::new(0),
            shown,
            exchange: UnsafeCell::new(exchange),
        }
    }

    /// The numbers as they were when it was left last.
    pub fn shown(&self) -> &E::Shown {
        &self.shown
    }

    /// Acts on what is shared; `None` if somebody else is in it.
    pub fn with<R>(&self, act: impl FnOnce(&mut E) -> R) -> Option<R> {
        let Some(entry) = Entry::new(&self.taken) else {
            // Relaxed: a count, which orders nothing.
            self.collisions.fetch_add(1, Ordering::Relaxed);
            return None;
        };
        let answer = self.act_and_leave(entry, act);
        // Who asked between the last look and the leaving was not heard: look again from outside.
        for _ in 0..SAFE_LOOKS_MAX {
            if self.safe.load(Ordering::SeqCst) == 0 {
                break;
            }
            let Some(entry) = Entry::new(&self.taken) else { break };
            self.act_and_leave(entry, |_| ());
        }
        Some(answer)
    }

    /// Acts, does what halves asked for meanwhile, then lets the next one in.
    fn act_and_leave<R>(&self, entry: Entry<'_>, act: impl FnOnce(&mut E) -> R) -> R {
        // SAFETY: the entry says that the caller has taken it, and nobody else does until the entry
        // is dropped below; the reference ends before that, because neither `act` nor its answer
        // can keep it.
        let exchange = unsafe { &mut *self.exchange.get() };
        let answer = act(exchange);
        for half in self.asked() {
            let _ = exchange.safe(half);
        }
        // Relaxed: a count, which orders nothing.
        exchange.publish(&self.shown, self.collisions.load(Ordering::Relaxed));
        drop(entry);
        answer
    }

    fn asked(&self) -> impl Iterator<Item = Half> + use<E> {
        // Sequentially consistent, as `taken` is: a half sets its bit and then tries to take what
        // is shared, whoever leaves gives it back and then looks at the bits. In any one order of
        // these four at least one of the two sees the other.
        let bits = self.safe.swap(0, Ordering::SeqCst);
        [Half::Motors, Half::Lines].into_iter().filter(move |half| bits & half.bit() != 0)
    }

    /// Lets a half go safe: now, or by whoever is in it as soon as it leaves; `None` then.
    pub fn safe(&self, half: Half) -> Option<Result<(), Failure>> {
        self.clear_asked(half, |exchange| exchange.safe(half))
    }

    /// Ends a half: now, or by whoever is in it as soon as it leaves, which makes it safe then.
    pub fn end(&self, half: Half) {
        let _ = self.clear_asked(half, |exchange| exchange.end(half));
    }

    fn clear_asked<R>(&self, half: Half, act: impl FnOnce(&mut E) -> R) -> Option<R> {
        self.safe.fetch_or(half.bit(), Ordering::SeqCst);
        self.with(|exchange| {
            self.safe.fetch_and(!half.bit(), Ordering::SeqCst);
            act(exchange)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts what it was told.
    #[derive(Default)]
    struct Counter {
        calls: u64,
        safes: Vec<Half>,
    }

    impl Exchange for Counter {
        type Shown = [AtomicU64; 2];

        fn publish(&self, shown: &[AtomicU64; 2], collisions: u64) {
            shown[0].store(self.calls, Ordering::Relaxed);
            shown[1].store(collisions, Ordering::Relaxed);
        }

        fn safe(&mut self, half: Half) -> Result<(), Failure> {
            self.safes.push(half);
            Ok(())
        }
    }

    fn shared() -> Shared<Counter> {
        Shared::new(Counter::default(), [AtomicU64::new(9), AtomicU64::new(9)])
    }

    /// Calls and collisions as they are shown.
    fn shown(shared: &Shared<Counter>) -> (u64, u64) {
        let [calls, collisions] = shared.shown().each_ref().map(|one| one.load(Ordering::Relaxed));
        (calls, collisions)
    }

    #[test]
    fn whoever_finds_it_taken_is_told_so_and_made_safe_by_who_leaves() {
        let shared = shared();
        assert_eq!(shown(&shared), (0, 0));
        let inside = shared.with(|counter| {
            counter.calls += 1;
            let others = (shared.with(|_| ()), shared.safe(Half::Lines));
            (others, counter.safes.len())
        });
        assert_eq!(inside, Some(((None, None), 0)));
        assert_eq!(shared.with(|counter| counter.safes.clone()), Some(vec![Half::Lines]));
        assert_eq!(shown(&shared), (1, 2));
        assert_eq!(shared.safe(Half::Motors), Some(Ok(())));
        shared.end(Half::Lines);
        let all = shared.with(|counter| counter.safes.clone()).unwrap();
        assert_eq!(all, [Half::Lines, Half::Motors, Half::Lines]);
    }

    #[test]
    fn a_panic_inside_leaves_the_way_free_for_safe_values() {
        let shared = shared();
        let panicked = std::panic::catch_unwind(core::panic::AssertUnwindSafe(|| {
            shared.with(|_| panic!("a defect"))
        }));
        assert!(panicked.is_err());
        assert_eq!(shared.safe(Half::Motors), Some(Ok(())));
    }

    #[test]
    fn threads_that_meet_never_lose_a_call_or_a_safe_value() {
        const CALLS_COUNT: u64 = 20_000;
        let shared = shared();
        let done: u64 = std::thread::scope(|scope| {
            let threads = [Half::Motors, Half::Lines].map(|half| {
                let shared = &shared;
                scope.spawn(move || {
                    let mut done = 0;
                    for call in 0..CALLS_COUNT {
                        let outcome = shared.with(|counter| {
                            let before = counter.calls;
                            if call % 100 == 0 {
                                std::thread::yield_now();
                            }
                            counter.calls = before + 1;
                        });
                        done += u64::from(outcome.is_some());
                        if call == CALLS_COUNT / 2 {
                            let _ = shared.safe(half);
                        }
                    }
                    done
                })
            });
            threads.into_iter().map(|thread| thread.join().unwrap()).sum()
        });
        let (calls, safes) = shared.with(|counter| (counter.calls, counter.safes.clone())).unwrap();
        assert_eq!((calls, calls + shown(&shared).1 >= 2 * CALLS_COUNT), (done, true));
        assert!(safes.contains(&Half::Motors) && safes.contains(&Half::Lines), "{safes:?}");
    }
}
