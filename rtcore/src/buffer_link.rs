//! A stamped link whose values are too long to be moved: they travel in buffers that are made at
//! load and go round over two rings.

use taktil_hal::Nanos;
use taktil_hal::link::Stamped;

use crate::array_payload::ArrayPayload;

/// A buffer on its way, with the number of values that were sent or dropped before it.
struct Numbered<T> {
    number: u64,
    buffer: Stamped<Box<T>>,
}

/// The producing end of a link whose buffers come back from the consumer.
pub(crate) struct BufferSender<T> {
    full: rtrb::Producer<Numbered<T>>,
    empty: rtrb::Consumer<Box<T>>,
    next: u64,
    dropped: u64,
}

/// The consuming end.
pub(crate) struct BufferReceiver<T> {
    full: rtrb::Consumer<Numbered<T>>,
    empty: rtrb::Producer<Box<T>>,
    expected: u64,
}

/// What came with a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Arrived {
    pub(crate) stamp: Nanos,
    /// Values that were dropped since the one before.
    pub(crate) lost: u64,
}

/// A link with `capacity` buffers like `value`; allocates.
pub(crate) fn buffer_link<T: ArrayPayload>(
    value: &T,
    capacity: usize,
) -> (BufferSender<T>, BufferReceiver<T>) {
    let (full, taken) = rtrb::RingBuffer::new(capacity);
    let (mut given, empty) = rtrb::RingBuffer::new(capacity);
    for _ in 0..capacity {
        // The ring has room for all of its buffers.
        let _ = given.push(Box::new(value.zeroed()));
    }
    (
        BufferSender { full, empty, next: 0, dropped: 0 },
        BufferReceiver { full: taken, empty: given, expected: 0 },
    )
}

impl<T: ArrayPayload> BufferSender<T> {
    /// Values lost for want of a free buffer.
    pub(crate) fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Sends a copy of `value`; without a free buffer it is dropped and counted.
    pub(crate) fn send(&mut self, value: &T, stamp: Nanos, visible: Nanos) {
        let number = self.next;
        self.next += 1;
        let Ok(mut buffer) = self.empty.pop() else {
            self.dropped += 1;
            return;
        };
        buffer.copy_from(value);
        // The ring of full buffers has room for every buffer there is.
        let _ =
            self.full.push(Numbered { number, buffer: Stamped { value: buffer, stamp, visible } });
    }
}

impl<T: ArrayPayload> BufferReceiver<T> {
    /// Exchanges `value` for the oldest one that is visible at `now`.
    pub(crate) fn next(&mut self, now: Nanos, value: &mut Box<T>) -> Option<Arrived> {
        if self.full.peek().ok()?.buffer.visible > now {
            return None;
        }
        let Numbered { number, buffer } = self.full.pop().ok()?;
        let lost = number - self.expected;
        self.expected = number + 1;
        // The ring of empty buffers has room for every buffer there is.
        let _ = self.empty.push(core::mem::replace(value, buffer.value));
        Some(Arrived { stamp: buffer.stamp, lost })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    crate::array_payload! {
        /// Numbers.
        pub struct Numbers {
            /// values
            pub values: Box<[u16]>,
        }
        usual [4]
    }

    fn numbers(first: u16) -> Numbers {
        Numbers { values: (first..first + 6).collect() }
    }

    #[test]
    fn buffers_go_round_and_a_value_that_found_none_is_counted() {
        let (mut tx, mut rx) = buffer_link(&numbers(0), 2);
        let mut value = Box::new(numbers(0).zeroed());
        let place = value.values.as_ptr();
        for first in 1..=3 {
            tx.send(&numbers(first), Nanos(i64::from(first)), Nanos(10));
        }
        assert_eq!((tx.dropped, rx.next(Nanos(9), &mut value)), (1, None));
        for first in 1..=2u16 {
            let stamp = Nanos(i64::from(first));
            assert_eq!(rx.next(Nanos(10), &mut value), Some(Arrived { stamp, lost: 0 }));
            assert_eq!(*value, numbers(first));
        }
        assert_eq!(rx.next(Nanos(10), &mut value), None);
        tx.send(&numbers(4), Nanos(4), Nanos(10));
        assert_eq!(rx.next(Nanos(10), &mut value), Some(Arrived { stamp: Nanos(4), lost: 1 }));
        // The first buffer of the reader carries the next value.
        assert_eq!((value.values.as_ptr(), &*value), (place, &numbers(4)));
    }
}
