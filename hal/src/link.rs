//! A bounded, lock-free exchange between two threads in which a value becomes visible at a declared
//! instant, never earlier.
//!
//! One producer, one consumer, no waiting on either side. It carries values between lanes, and
//! between device halves and whatever serves them (a simulated world, a thread that talks to a slow
//! bus). Nothing is overwritten: when the ring is full the newest value is dropped and counted, so
//! that nothing already promised to the consumer can vanish.

use crate::time::Nanos;

/// A value with the instant it belongs to and the instant from which it may be seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stamped<T> {
    /// What was sent.
    pub value: T,
    /// When it was acquired or produced, in logical time.
    pub stamp: Nanos,
    /// From when on a receiver may see it, in logical time.
    pub visible: Nanos,
}

/// The ring had no room; the value was dropped and counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Full;

/// The producing end.
#[derive(Debug)]
pub struct Sender<T> {
    ring: rtrb::Producer<Stamped<T>>,
    dropped: u64,
}

/// The consuming end.
#[derive(Debug)]
pub struct Receiver<T> {
    ring: rtrb::Consumer<Stamped<T>>,
}

/// Makes a link that holds up to `capacity` values that nobody has taken yet.
#[must_use]
pub fn link<T: Copy + Send>(capacity: usize) -> (Sender<T>, Receiver<T>) {
    let (producer, consumer) = rtrb::RingBuffer::new(capacity);
    (Sender { ring: producer, dropped: 0 }, Receiver { ring: consumer })
}

impl<T: Copy> Sender<T> {
    /// Sends a value; `visible` must not run backwards from one call to the next.
    ///
    /// # Errors
    /// [`Full`] when the receiver has fallen a whole ring behind; the value is lost and counted.
    pub fn send(&mut self, value: T, stamp: Nanos, visible: Nanos) -> Result<(), Full> {
        self.ring.push(Stamped { value, stamp, visible }).map_err(|_| {
            self.dropped += 1;
            Full
        })
    }

    /// How many values were lost to a full ring.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped
    }
}

impl<T: Copy> Receiver<T> {
    /// The oldest value not yet taken that is visible at `now`.
    pub fn next(&mut self, now: Nanos) -> Option<Stamped<T>> {
        match self.ring.peek() {
            Ok(entry) if entry.visible <= now => self.ring.pop().ok(),
            _ => None,
        }
    }

    /// The newest value visible at `now`; older ones are passed over. Bounded by the ring's
    /// capacity.
    pub fn newest(&mut self, now: Nanos) -> Option<Stamped<T>> {
        let mut found = None;
        while let Some(entry) = self.next(now) {
            found = Some(entry);
        }
        found
    }

    /// Calls `see` with every value that was not taken yet, oldest first, visible or not; all of
    /// them stay.
    pub fn for_each_pending(&mut self, mut see: impl FnMut(&Stamped<T>)) {
        let slots = self.ring.slots();
        if let Ok(chunk) = self.ring.read_chunk(slots) {
            let (first, second) = chunk.as_slices();
            first.iter().chain(second).for_each(&mut see);
        }
    }

    /// When the next value becomes visible, if one is in the ring.
    #[must_use]
    pub fn next_visible(&self) -> Option<Nanos> {
        self.ring.peek().ok().map(|entry| entry.visible)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_seen_at_its_instant_and_not_before() {
        let (mut tx, mut rx) = link(4);
        tx.send(7, Nanos(0), Nanos(10)).unwrap();
        tx.send(8, Nanos(5), Nanos(20)).unwrap();
        assert_eq!(rx.newest(Nanos(9)), None);
        assert_eq!(rx.newest(Nanos(10)).map(|s| s.value), Some(7));
        assert_eq!(rx.newest(Nanos(19)), None);
        assert_eq!(rx.newest(Nanos(25)).map(|s| s.value), Some(8));
    }

    #[test]
    fn a_full_ring_drops_the_newest_and_counts_it() {
        let (mut tx, mut rx) = link(2);
        for v in 0..4 {
            let _ = tx.send(v, Nanos(0), Nanos(0));
        }
        assert_eq!(tx.dropped(), 2);
        assert_eq!(rx.newest(Nanos(0)).map(|s| s.value), Some(1));
    }

    #[test]
    fn peeking_removes_nothing() {
        let (mut tx, mut rx) = link(3);
        for v in 0..5 {
            let _ = tx.send(v, Nanos(v), Nanos(v));
            if v == 1 {
                // The ring wraps.
                assert_eq!(rx.next(Nanos(9)).map(|s| s.value), Some(0));
            }
        }
        for _ in 0..2 {
            let mut seen = Vec::new();
            rx.for_each_pending(|stamped| seen.push(stamped.value));
            assert_eq!(seen, [1, 2, 3]);
        }
        assert_eq!(rx.newest(Nanos(9)).map(|s| s.value), Some(3));
        rx.for_each_pending(|_| panic!("nothing is left"));
    }

    #[test]
    fn next_hands_out_every_value_in_order() {
        let (mut tx, mut rx) = link(4);
        for v in 0..3 {
            tx.send(v, Nanos(v), Nanos(v)).unwrap();
        }
        assert_eq!(rx.next_visible(), Some(Nanos(0)));
        let seen: Vec<i64> = std::iter::from_fn(|| rx.next(Nanos(1))).map(|s| s.value).collect();
        assert_eq!(seen, [0, 1]);
    }
}
