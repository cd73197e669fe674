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
        Acquisition { bus, strobe, busy, polls, release, starts: AtomicU32::new(0) }
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

/// Starts the latch and the conversion of a board early in a job, before its halves are sampled: for
/// whoever does something else meanwhile. A half whose release was started does not start it again.
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
