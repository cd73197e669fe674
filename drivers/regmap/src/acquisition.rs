//! Starts what a board does once a release: latching its counters, converting its inputs. Several
//! halves may ask for it, also from different lanes; the first one with a new release starts it,
//! and each waits for its end with a bounded number of looks at the board.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU32, Ordering};

use taktil_hal::Nanos;

use crate::bus::{Bus, State};
use crate::description::StrobeKind;

/// A release that no job has.
const NO_RELEASE: i64 = i64::MIN;

/// A register whose writing makes the board act.
#[derive(Debug)]
pub(crate) struct Strobe {
    offset: usize,
    kind: StrobeKind,
    word: AtomicU32,
}

impl Strobe {
    /// A strobe of the same value each time, or of numbers that go on from what the register reads.
    pub(crate) fn new(bus: &Bus, offset: usize, kind: StrobeKind, value: u32) -> Strobe {
        let word = match kind {
            StrobeKind::Value => value,
            StrobeKind::Count => bus.read(offset),
        };
        Strobe { offset, kind, word: AtomicU32::new(word) }
    }

    /// Writes the register after everything written before.
    pub(crate) fn write(&self, bus: &Bus) {
        // Relaxed: the number needs only be another one each time; the fence orders the writes.
        let word = match self.kind {
            StrobeKind::Value => self.word.load(Ordering::Relaxed),
            StrobeKind::Count => self.word.fetch_add(1, Ordering::Relaxed).wrapping_add(1),
        };
        bus.order_writes();
        bus.write(self.offset, word);
    }
}

/// What the board does once a release.
#[derive(Debug)]
pub(crate) struct Acquisition {
    bus: Bus,
    strobe: Option<Strobe>,
    busy: Option<State>,
    polls: u32,
    /// How long a look takes.
    read_time: Nanos,
    /// The release that started it last.
    release: AtomicI64,
    /// How often it was started.
    starts: AtomicU32,
}

impl Acquisition {
    pub(crate) fn new(
        bus: Bus,
        strobe: Option<Strobe>,
        busy: Option<State>,
        polls: u32,
    ) -> Acquisition {
        let release = AtomicI64::new(NO_RELEASE);
        let (read_time, starts) = (Nanos::ZERO, AtomicU32::new(0));
        Acquisition { bus, strobe, busy, polls, read_time, release, starts }
    }

    /// The same on a bus that takes so long for one read.
    pub(crate) fn with_read_time(mut self, time: Nanos) -> Acquisition {
        self.read_time = time;
        self
    }

    /// The longest that [`Acquisition::wait`] takes: nothing where no bit shows the end.
    pub(crate) fn longest_wait(&self) -> Nanos {
        self.busy.as_ref().map_or(Nanos::ZERO, |_| self.read_time * i64::from(self.polls))
    }

    /// Starts it unless this release has done so.
    pub(crate) fn start(&self, release: Nanos) {
        let Some(strobe) = &self.strobe else { return };
        // AcqRel: of two lanes with one release only one sees another value here. A lane that reads
        // what a start has spoilt finds the new number of starts, because the number
        // is counted up before the register is written.
        if self.release.swap(release.0, Ordering::AcqRel) != release.0 {
            self.starts.fetch_add(1, Ordering::AcqRel);
            strobe.write(&self.bus);
        }
    }

    /// How often it was started.
    pub(crate) fn starts(&self) -> u32 {
        // Acquire: what is read from the board afterwards belongs to this start or a later one.
        self.starts.load(Ordering::Acquire)
    }

    /// Looks at the board until it is done, as often as the description allows; whether it is.
    pub(crate) fn wait(&self) -> bool {
        let Some(busy) = &self.busy else { return true };
        for _ in 0..self.polls {
            if !busy.holds(&self.bus) {
                self.bus.order_reads();
                return true;
            }
            std::hint::spin_loop();
        }
        false
    }
}

/// Starts the latch and the conversion of a board early in a job, before its halves are sampled:
/// for whoever does something else meanwhile. A half whose release was started does not start it
/// again.
#[derive(Clone)]
pub struct AcquisitionStart(pub(crate) Vec<Arc<Acquisition>>);

impl AcquisitionStart {
    /// Starts everything that this release has not started yet. Writes at most two registers.
    pub fn start(&self, release: Nanos) {
        for acquisition in &self.0 {
            acquisition.start(release);
        }
    }
}

impl fmt::Debug for AcquisitionStart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("AcquisitionStart").field(&self.0.len()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::description::Description;
    use crate::io::RegisterFile;
    use crate::shipped::SHIPPED_BOARDS;

    fn bus() -> (Description, Bus) {
        let own = Description::from_toml(SHIPPED_BOARDS[0].1).unwrap();
        let bus = Bus::new(Arc::new(RegisterFile::anonymous().unwrap()), &own);
        (own, bus)
    }

    #[test]
    fn a_release_starts_once_and_the_next_one_again() {
        let (_, bus) = bus();
        bus.write(0x30, 0xfffe);
        let strobe = Strobe::new(&bus, 0x30, StrobeKind::Count, 0);
        let latch = Arc::new(Acquisition::new(bus.clone(), Some(strobe), None, 1));
        let early = AcquisitionStart(vec![latch.clone()]);
        let numbers = [5, 5, 6, 6, 7, 5].map(|release| {
            early.start(Nanos(release));
            latch.start(Nanos(release));
            (bus.read(0x30), latch.starts())
        });
        let due = [(0xffff, 1), (0xffff, 1), (0, 2), (0, 2), (1, 3), (2, 4)];
        assert_eq!(numbers, due, "the number goes on and wraps");
        assert!(latch.wait(), "nothing shows that it is busy");
        let silent = Acquisition::new(bus.clone(), None, None, 9).with_read_time(Nanos(700));
        assert_eq!(silent.longest_wait(), Nanos::ZERO);
    }

    #[test]
    fn a_busy_bit_is_looked_at_so_often_and_no_more() {
        let (own, bus) = bus();
        let busy = State::new(&own, 0x30, Some(0x8001), Some(0x8000));
        let strobe = Strobe::new(&bus, 0x30, StrobeKind::Value, 0x8000);
        let conversion = Acquisition::new(bus.clone(), Some(strobe), Some(busy), 1_000)
            .with_read_time(Nanos(700));
        assert_eq!(conversion.longest_wait(), Nanos::from_micros(700));
        assert!(conversion.wait());
        conversion.start(Nanos::ZERO);
        assert!(!conversion.wait());
        for idle in [0x8001, 0x0001, 0] {
            bus.write(0x30, idle);
            assert!(conversion.wait(), "{idle:#x}");
        }
    }
}
