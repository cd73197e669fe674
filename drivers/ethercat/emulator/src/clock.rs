//! The clock of one device: it drifts, follows the time of the reference clock as frames bring it,
//! and makes the pulses SYNC0. All times are whole nanoseconds.

use taktil_hal::Nanos;

/// Each clock began at an instant of its own (ns), by its position.
const ORIGIN_STEP_NS: u64 = 1_000_003;
/// The part of the difference to the reference that one frame takes away, as a power of two.
const FOLLOW_SHIFT: u32 = 4;
/// Sign of the difference as the register shows it.
const SIGN_BIT: u32 = 1 << 31;
/// Cyclic operation, and SYNC0.
const SYNC_BITS: u8 = 3;

/// SYNC0 as the host has set it up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Sync {
    start: u64,
    cycle: u64,
    /// Whether the start was still to come: a controller waits for the very instant.
    is_armed: bool,
    /// Pulses so far.
    count: u64,
}

/// What SYNC0 did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Pulses {
    /// Pulses since the look before.
    pub(crate) count: u64,
    /// How long ago the newest one was (ns).
    pub(crate) ago_ns: u64,
}

/// A device's clock.
#[derive(Clone, Debug)]
pub(crate) struct DeviceClock {
    origin_ns: u64,
    ppm: i64,
    /// Since when it has this drift, and what it was fast by then (ns).
    since: Nanos,
    fast_ns: i64,
    /// What following the reference has added (ns).
    correction_ns: i64,
    sync: Option<Sync>,
}

impl DeviceClock {
    pub(crate) fn new(position: usize) -> DeviceClock {
        DeviceClock {
            origin_ns: ORIGIN_STEP_NS * (position as u64 + 1),
            ppm: 0,
            since: Nanos::ZERO,
            fast_ns: 0,
            correction_ns: 0,
            sync: None,
        }
    }

    /// As after power-up, but for the crystal.
    pub(crate) fn restart(&mut self) {
        (self.correction_ns, self.sync) = (0, None);
    }

    pub(crate) fn set_drift(&mut self, ppm: i64, now: Nanos) {
        (self.fast_ns, self.since, self.ppm) = (self.fast_by(now), now, ppm);
    }

    fn fast_by(&self, now: Nanos) -> i64 {
        let passed = now - self.since;
        let drifted = i128::from(passed.0) * i128::from(self.ppm) / 1_000_000;
        self.fast_ns.saturating_add(i64::try_from(drifted).unwrap_or(i64::MAX))
    }

    /// The clock as it runs freely.
    pub(crate) fn local(&self, now: Nanos) -> u64 {
        now.0.wrapping_add(self.fast_by(now)).cast_unsigned().wrapping_add(self.origin_ns)
    }

    pub(crate) fn system_time(&self, now: Nanos, offset: u64) -> u64 {
        let added = offset.wrapping_add_signed(self.correction_ns);
        self.local(now).wrapping_add(added)
    }

    /// The host has set the offset anew.
    pub(crate) fn forget_correction(&mut self) {
        self.correction_ns = 0;
    }

    /// A frame brings the reference's time; gives the difference as the register shows it.
    pub(crate) fn follow(&mut self, own: u64, reference: u64) -> u32 {
        let difference = own.wrapping_sub(reference).cast_signed();
        self.correction_ns = self.correction_ns.wrapping_sub(difference >> FOLLOW_SHIFT);
        let size = u32::try_from(difference.unsigned_abs()).unwrap_or(u32::MAX) & !SIGN_BIT;
        // The bit is set when the own time is behind.
        if difference < 0 { size | SIGN_BIT } else { size }
    }

    /// The host starts or stops SYNC0 at `system` of the segment's time.
    pub(crate) fn set_sync(&mut self, activation: u8, start: u64, cycle: u32, system: u64) {
        let is_armed = start > system && cycle > 0;
        let sync = Sync { start, cycle: u64::from(cycle).max(1), is_armed, count: 0 };
        self.sync = (activation & SYNC_BITS == SYNC_BITS).then_some(sync);
    }

    pub(crate) fn has_sync(&self) -> Option<bool> {
        self.sync.map(|sync| sync.is_armed)
    }

    pub(crate) fn pulses(&mut self, system: u64) -> Pulses {
        let Some(sync) = self.sync.as_mut().filter(|sync| sync.is_armed) else {
            return Pulses::default();
        };
        let Some(passed) = system.checked_sub(sync.start) else { return Pulses::default() };
        let count = passed / sync.cycle + 1;
        // A clock that is set back repeats no pulse.
        let new = count.saturating_sub(sync.count);
        sync.count = sync.count.max(count);
        Pulses { count: new, ago_ns: passed % sync.cycle }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_follows_stays_with_the_reference_however_both_drift() {
        let (mut reference, mut device) = (DeviceClock::new(0), DeviceClock::new(5));
        reference.set_drift(100, Nanos::ZERO);
        device.set_drift(-100, Nanos::ZERO);
        let offset = reference.origin_ns.wrapping_sub(device.origin_ns);
        let mut worst = 0;
        for job in 0..60_000 {
            let now = Nanos::from_millis(job);
            let (due, own) = (reference.system_time(now, 0), device.system_time(now, offset));
            let shown = device.follow(own, due);
            if job > 1_000 {
                worst = worst.max(shown & !SIGN_BIT);
            }
        }
        // 200 ppm are 200 ns in each frame, of which a sixteenth is taken away at a time.
        assert!((3_000..=3_300).contains(&worst), "{worst} ns");
    }

    #[test]
    fn a_drift_that_changes_does_not_make_the_clock_jump() {
        let mut clock = DeviceClock::new(0);
        clock.set_drift(50, Nanos::ZERO);
        let second = Nanos::from_secs(1);
        let before = clock.local(second);
        clock.set_drift(-50, second);
        assert_eq!(clock.local(second), before);
        assert_eq!(clock.local(second * 2) - before, 1_000_000_000 - 50_000);
    }

    #[test]
    fn pulses_come_from_their_start_and_never_when_it_has_passed() {
        let mut clock = DeviceClock::new(0);
        clock.set_sync(3, 1_000, 500, 200);
        assert_eq!(clock.pulses(999), Pulses::default());
        assert_eq!(clock.pulses(1_000), Pulses { count: 1, ago_ns: 0 });
        assert_eq!(clock.pulses(2_499), Pulses { count: 2, ago_ns: 499 });
        assert_eq!(clock.pulses(2_400).count, 0);
        clock.set_sync(3, 1_000, 500, 1_000);
        assert_eq!((clock.has_sync(), clock.pulses(9_000)), (Some(false), Pulses::default()));
        clock.set_sync(0, 1_000, 500, 0);
        assert_eq!(clock.has_sync(), None);
    }
}
