//! Records what enters a task past its ports: every answer of a device half goes on a tape, a
//! signal of its own beside those of the ports, so that a run can be replayed without its devices.
//! A tape never slows the half down: a job that appends more entries than the tape holds loses the
//! rest, and the loss is counted.

use std::borrow::Cow;

use taktil_hal::Nanos;
use taktil_hal::link::{Receiver, Sender, link};

use crate::array_payload::ArrayPayload;
use crate::buffer_link::{BufferReceiver, BufferSender, buffer_link};
use crate::payload::{Field, Payload};

/// Entries of one job that a tape holds until the job's end.
const ENTRIES_PER_JOB_MAX: usize = 16;

/// The writing end of a tape, kept by whatever wraps a device half. Declared with
/// [`crate::Ports::tape`]; it is read by the lane at the end of each job.
#[derive(Debug)]
pub struct Tape<T> {
    ring: Sender<(u64, T)>,
    next: u64,
}

impl<T: Payload> Tape<T> {
    /// Puts one entry on the tape: what the device answered to the job released at `release`. Bits
    /// are kept as they are, finite or not.
    pub fn append(&mut self, release: Nanos, entry: T) {
        // A full ring shows at the other end as a gap in the numbers.
        let _ = self.ring.send((self.next, entry), release, release);
        self.next += 1;
    }
}

/// The writing end of a tape of array payloads; declared with [`crate::Ports::array_tape`].
pub struct ArrayTape<T> {
    ring: BufferSender<T>,
}

impl<T: ArrayPayload> ArrayTape<T> {
    /// As [`Tape::append`], by copying `entry`; what the tape cannot hold is counted.
    pub fn append(&mut self, release: Nanos, entry: &T) {
        self.ring.send(entry, release, release);
    }
}

/// The reading end in the lane, without its type.
pub(crate) trait AnyTape: Send {
    /// Encodes the oldest entry; says for which release it is and how many were lost before it.
    fn next(&mut self, scratch: &mut [u8]) -> Option<(Nanos, usize, u64)>;
}

struct TapeReader<T> {
    ring: Receiver<(u64, T)>,
    expected: u64,
}

impl<T: Payload> AnyTape for TapeReader<T> {
    fn next(&mut self, scratch: &mut [u8]) -> Option<(Nanos, usize, u64)> {
        let entry = self.ring.next(Nanos::MAX)?;
        let (number, value) = entry.value;
        let lost = number - self.expected;
        self.expected = number + 1;
        value.encode(&mut scratch[..T::SIZE]);
        Some((entry.stamp, T::SIZE, lost))
    }
}

struct ArrayTapeReader<T> {
    ring: BufferReceiver<T>,
    entry: Box<T>,
}

impl<T: ArrayPayload> AnyTape for ArrayTapeReader<T> {
    fn next(&mut self, scratch: &mut [u8]) -> Option<(Nanos, usize, u64)> {
        let arrived = self.ring.next(Nanos::MAX, &mut self.entry)?;
        let size = self.entry.size();
        self.entry.encode(&mut scratch[..size]);
        Some((arrived.stamp, size, arrived.lost))
    }
}

/// A tape as declared, before the machine is joined.
pub(crate) struct TapeDeclaration {
    pub(crate) name: String,
    pub(crate) type_name: Cow<'static, str>,
    pub(crate) fields: Cow<'static, [Field]>,
    pub(crate) size: usize,
    pub(crate) reader: Box<dyn AnyTape>,
}

/// Both ends of a new tape.
pub(crate) fn tape<T: Payload>(name: &str) -> (Tape<T>, TapeDeclaration) {
    let (sender, receiver) = link(ENTRIES_PER_JOB_MAX);
    let declaration = TapeDeclaration {
        name: name.to_owned(),
        type_name: T::NAME.into(),
        fields: T::FIELDS.into(),
        size: T::SIZE,
        reader: Box::new(TapeReader { ring: receiver, expected: 0 }),
    };
    (Tape { ring: sender, next: 0 }, declaration)
}

/// Both ends of a new tape whose entries have the lengths of `like`.
pub(crate) fn array_tape<T: ArrayPayload>(name: &str, like: &T) -> (ArrayTape<T>, TapeDeclaration) {
    let (sender, ring) = buffer_link(like, ENTRIES_PER_JOB_MAX);
    let declaration = TapeDeclaration {
        name: name.to_owned(),
        type_name: like.type_name(),
        fields: like.fields().into(),
        size: like.size(),
        reader: Box::new(ArrayTapeReader { ring, entry: Box::new(like.zeroed()) }),
    };
    (ArrayTape { ring: sender }, declaration)
}

#[cfg(test)]
mod tests {
    use super::*;

    crate::payload! {
        /// One number.
        pub struct One {
            /// value
            pub value: f64,
        }
    }

    #[test]
    fn entries_come_out_in_order_with_their_bits_and_a_gap_is_counted() {
        let (mut tape, mut declared) = tape::<One>("hal.one");
        let mut scratch = [0; One::SIZE];
        let odd = f64::from_bits(0x7FF0_0000_0000_0001);
        tape.append(Nanos(5), One { value: odd });
        assert_eq!(declared.reader.next(&mut scratch), Some((Nanos(5), 8, 0)));
        assert_eq!(scratch, odd.to_le_bytes());
        assert_eq!(declared.reader.next(&mut scratch), None);
        for n in 0..ENTRIES_PER_JOB_MAX + 3 {
            tape.append(Nanos(6), One { value: n as f64 });
        }
        let drained = std::iter::from_fn(|| declared.reader.next(&mut scratch)).count();
        assert_eq!(drained, ENTRIES_PER_JOB_MAX);
        tape.append(Nanos(7), One::ZERO);
        assert_eq!(declared.reader.next(&mut scratch), Some((Nanos(7), 8, 3)));
    }
}
