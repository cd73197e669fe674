//! Shows what was counted on a bus, and the newest error of each drive, to any thread.

use core::sync::atomic::{AtomicU8, AtomicU16, AtomicU64, Ordering};
use std::sync::Arc;

use taktil_drivers_cia402::error_text;
use taktil_hal::CHANNELS;

use crate::bus::{Bus, BusCounts};

/// The numbers that are shown.
#[derive(Debug, Default)]
struct Words {
    counts: [AtomicU64; BusCounts::NUMBERS_COUNT],
    collisions: AtomicU64,
    errors: [AtomicU16; CHANNELS],
    registers: [AtomicU8; CHANNELS],
}

/// The counters of a bus as its halves published them last.
#[derive(Clone, Debug, Default)]
pub struct BusMonitor {
    words: Arc<Words>,
}

impl BusMonitor {
    pub(crate) fn publish(&self, bus: &Bus, collisions: u64) {
        // Relaxed: the numbers order nothing.
        self.words.collisions.store(collisions, Ordering::Relaxed);
        for (shown, word) in self.words.counts.iter().zip(bus.counts().numbers()) {
            // Relaxed: the numbers order nothing.
            shown.store(word, Ordering::Relaxed);
        }
        for (shown, code) in self.words.errors.iter().zip(bus.error_codes()) {
            // Relaxed: the numbers order nothing.
            shown.store(code, Ordering::Relaxed);
        }
        for (shown, register) in self.words.registers.iter().zip(bus.error_registers()) {
            // Relaxed: the numbers order nothing.
            shown.store(register, Ordering::Relaxed);
        }
    }

    /// What was counted since the bus was opened, each number with its name. Each is whole; two of
    /// them may be a cycle apart.
    #[must_use]
    pub fn counts(&self) -> Vec<(&'static str, u64)> {
        // Relaxed: the numbers order nothing.
        let numbers = self.words.counts.iter().map(|word| word.load(Ordering::Relaxed));
        let mut named: Vec<_> = BusCounts::NAMES.into_iter().zip(numbers).collect();
        named.push(("collisions of lanes", self.words.collisions.load(Ordering::Relaxed)));
        named
    }

    /// The newest error of the drive of a channel by its own numbers; 0 for none.
    #[must_use]
    pub fn error_code(&self, channel: usize) -> u16 {
        // Relaxed: the number orders nothing.
        self.words.errors.get(channel).map_or(0, |word| word.load(Ordering::Relaxed))
    }

    /// The error register (object 1001) of the newest emergency message of the drive of a channel;
    /// 0 without one.
    #[must_use]
    pub fn error_register(&self, channel: usize) -> u8 {
        // Relaxed: the number orders nothing.
        self.words.registers.get(channel).map_or(0, |word| word.load(Ordering::Relaxed))
    }

    /// The same as a text for people, for drives after CiA 402.
    #[must_use]
    pub fn error_text(&self, channel: usize) -> &'static str {
        error_text(self.error_code(channel))
    }
}
