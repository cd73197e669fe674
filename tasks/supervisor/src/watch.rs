//! Conditions with a state of their own: standstill, a condition that persists, faults latched in
//! order. They report whether a condition holds and since when; other modules decide on the
//! reaction.

use taktil_rtcore::fault::Class;
use taktil_rtcore::{FaultCode, FaultSet, Fold, Nanos, StateHash};

/// Detects that the arm stands still: no joint has left a small band for a given time. Neither
/// flickering counts nor a slow speed estimate affect the result.
#[derive(Clone, Debug)]
pub struct Standstill<const N: usize = 6> {
    band_rad: f64,
    time: Nanos,
    around: Option<([f64; N], Nanos)>,
}

impl<const N: usize> Fold for Standstill<N> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.around);
    }
}

impl<const N: usize> Standstill<N> {
    /// Still means: within `band_rad` of one place for `time`.
    #[must_use]
    pub fn new(band_rad: f64, time: Nanos) -> Standstill<N> {
        Standstill { band_rad, time, around: None }
    }

    /// Takes the joints as they are at `now`; `None` when they are not known.
    pub fn update(&mut self, now: Nanos, q_rad: Option<[f64; N]>) -> bool {
        let Some(q_rad) = q_rad else {
            self.around = None;
            return false;
        };
        let near = |place: &[f64; N]| (0..N).all(|i| (q_rad[i] - place[i]).abs() <= self.band_rad);
        match &self.around {
            Some((place, since)) if near(place) => now - *since >= self.time,
            _ => {
                self.around = Some((q_rad, now));
                false
            }
        }
    }
}

/// Detects that a stop does not slow the arm: in one span of time after the other the farthest way
/// of a joint has to shrink. It needs no model, and no limit of the time that a stop takes.
#[derive(Clone, Debug)]
pub struct StopMonitor<const N: usize = 6> {
    span: Nanos,
    least_rad: f64,
    from: Option<([f64; N], Nanos)>,
    before_rad: Option<f64>,
}

/// A way that is not shorter than this share of the way before has not shrunk: readings are
/// rounded.
const SHRINKING_SHARE: f64 = 0.98;

impl<const N: usize> Fold for StopMonitor<N> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.from).add(&self.before_rad);
    }
}

impl<const N: usize> StopMonitor<N> {
    /// Ways in spans of `span` are compared; a way up to `least_rad` is none.
    #[must_use]
    pub fn new(span: Nanos, least_rad: f64) -> StopMonitor<N> {
        StopMonitor { span, least_rad, from: None, before_rad: None }
    }

    /// Forgets the past: no stop is under way.
    pub fn reset(&mut self) {
        (self.from, self.before_rad) = (None, None);
    }

    /// Takes the joints as they are at `now`, in a stop; true when they do not slow down. Joints
    /// that are not known are left to others.
    pub fn update(&mut self, now: Nanos, q_rad: Option<[f64; N]>) -> bool {
        let Some(q_rad) = q_rad else {
            self.reset();
            return false;
        };
        let (place, since) = *self.from.get_or_insert((q_rad, now));
        if now - since < self.span {
            return false;
        }
        let way_rad = (0..N).map(|i| (q_rad[i] - place[i]).abs()).fold(0.0, f64::max);
        self.from = Some((q_rad, now));
        let before_rad = self.before_rad.replace(way_rad);
        way_rad > self.least_rad
            && before_rad.is_some_and(|before_rad| way_rad > SHRINKING_SHARE * before_rad)
    }
}

/// Detects that a condition has held for longer than a limit.
#[derive(Clone, Debug)]
pub struct PersistenceTimer {
    limit: Nanos,
    since: Option<Nanos>,
}

impl Fold for PersistenceTimer {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.since);
    }
}

impl PersistenceTimer {
    /// True only after more than `limit`.
    #[must_use]
    pub fn new(limit: Nanos) -> PersistenceTimer {
        PersistenceTimer { limit, since: None }
    }

    /// Updates the timer with the condition at `now`.
    pub fn update(&mut self, now: Nanos, so: bool) -> bool {
        if !so {
            self.since = None;
            return false;
        }
        now - *self.since.get_or_insert(now) > self.limit
    }
}

/// Faults that have happened since the last reset, and the first of them. Notes are not kept.
#[derive(Clone, Copy, Debug, Default)]
pub struct FaultLatch {
    faults: FaultSet,
    first: Option<FaultCode>,
}

impl Fold for FaultLatch {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.faults).add(&self.first);
    }
}

impl FaultLatch {
    /// Adds faults; of several at once the one with the strongest reaction counts as first, then
    /// the one with the lowest code.
    pub fn add(&mut self, raised: FaultSet) {
        let mut strongest: Option<FaultCode> = None;
        for fault in raised.iter().filter(|fault| fault.class() > Class::Note) {
            self.faults.insert(fault);
            if strongest.is_none_or(|before| fault.class() > before.class()) {
                strongest = Some(fault);
            }
        }
        self.first = self.first.or(strongest);
    }

    /// All that is latched.
    #[must_use]
    pub fn faults(&self) -> FaultSet {
        self.faults
    }

    /// The part that stops the machine.
    #[must_use]
    pub fn stopping(&self) -> FaultSet {
        faults_of_class(self.faults, |class| class >= Class::ControlledStop)
    }

    /// Code of the first fault, 0 when none.
    #[must_use]
    pub fn first_code(&self) -> u32 {
        self.first.map_or(0, |fault| fault as u32)
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        *self = FaultLatch::default();
    }
}

/// The members whose class is wanted.
#[must_use]
pub fn faults_of_class(faults: FaultSet, wanted: impl Fn(Class) -> bool) -> FaultSet {
    let mut some = FaultSet::NONE;
    for fault in faults.iter().filter(|fault| wanted(fault.class())) {
        some.insert(fault);
    }
    some
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn still_is_a_band_kept_for_a_time() {
        let mut still = Standstill::new(0.01, Nanos(100));
        assert!(!still.update(Nanos(0), Some([0.0; 6])));
        assert!(!still.update(Nanos(99), Some([0.01; 6])), "the edge of the band belongs to it");
        assert!(still.update(Nanos(100), Some([-0.01; 6])));
        assert!(!still.update(Nanos(110), Some([0.0, 0.0, 0.0, 0.0, 0.0, 0.011])));
        assert!(!still.update(Nanos(209), Some([0.0, 0.0, 0.0, 0.0, 0.0, 0.011])));
        assert!(still.update(Nanos(210), Some([0.0, 0.0, 0.0, 0.0, 0.0, 0.011])));
        assert!(!still.update(Nanos(220), None), "unknown joints are not still");
        assert!(!still.update(Nanos(230), Some([0.0; 6])));
        assert!(!still.update(Nanos(900), Some([f64::NAN; 6])));
    }

    #[test]
    fn a_stop_that_slows_is_one_and_one_that_goes_on_is_not() {
        let run = |place: fn(f64) -> f64| {
            let mut stop = StopMonitor::new(Nanos::from_millis(100), 1e-3);
            (0..400).find(|tick| {
                let q_rad = [0.0, place(2.5e-3 * f64::from(*tick)), 0.0, 0.0, 0.0, 0.0];
                stop.update(Nanos::from_micros(2500) * i64::from(*tick), Some(q_rad))
            })
        };
        assert_eq!(run(|t| t * (1.0 - t / 2.0)), None, "a second from 1 rad/s to rest");
        assert_eq!(run(|t| t / (0.1 + t)), None);
        assert_eq!(run(|t| 9e-3 * t), None, "too slow to matter");
        assert_eq!(run(|t| 0.5 * t), Some(80), "the speed stays");
        assert_eq!(run(|t| t + t * t), Some(80), "the speed rises");
        assert_eq!(run(|t| -t * t), Some(80), "the speed rises from rest");
        assert_eq!(run(|t| t * (1.0 - t) + t * t * t), Some(200), "it slows at first");
    }

    #[test]
    fn unknown_joints_are_no_failed_stop_and_a_new_stop_begins_anew() {
        let mut stop = StopMonitor::new(Nanos(10), 1e-3);
        assert!(!stop.update(Nanos(0), Some([0.0; 6])) && !stop.update(Nanos(10), Some([1.0; 6])));
        assert!(!stop.update(Nanos(15), None) && !stop.update(Nanos(20), Some([2.0; 6])));
        assert!(!stop.update(Nanos(30), Some([3.0; 6])), "nothing to compare with yet");
        stop.reset();
        assert!(!stop.update(Nanos(40), Some([4.0; 6])) && !stop.update(Nanos(50), Some([5.0; 6])));
        assert!(stop.update(Nanos(60), Some([6.0; 6])));
    }

    #[test]
    fn a_slow_creep_is_not_still() {
        let mut still = Standstill::new(0.01, Nanos(100));
        for step in 0..1000 {
            let q = [1e-3 * f64::from(step); 6];
            assert!(!still.update(Nanos(9 * i64::from(step)), Some(q)), "0.11 rad in 1000 ns");
        }
    }

    #[test]
    fn lasting_is_longer_than_the_limit_without_a_break() {
        let mut lasting = PersistenceTimer::new(Nanos(20));
        assert!(!lasting.update(Nanos(5), true));
        assert!(!lasting.update(Nanos(25), true), "exactly the limit is not longer");
        assert!(lasting.update(Nanos(26), true));
        assert!(!lasting.update(Nanos(27), false));
        assert!(!lasting.update(Nanos(28), true));
        assert!(!lasting.update(Nanos(48), true));
        assert!(lasting.update(Nanos(49), true));
    }

    #[test]
    fn the_first_fault_stays_first_and_notes_do_not_count() {
        let set = |faults: &[FaultCode]| {
            let mut all = FaultSet::NONE;
            faults.iter().for_each(|fault| all.insert(*fault));
            all
        };
        let mut latch = FaultLatch::default();
        latch.add(set(&[FaultCode::Overrun]));
        assert_eq!((latch.faults(), latch.first_code()), (FaultSet::NONE, 0));
        latch.add(set(&[FaultCode::FollowingError, FaultCode::EmergencyStop, FaultCode::Overrun]));
        assert_eq!(latch.first_code(), FaultCode::EmergencyStop as u32);
        latch.add(set(&[FaultCode::EncoderJump, FaultCode::TactileStale]));
        assert_eq!(latch.first_code(), FaultCode::EmergencyStop as u32);
        assert!(latch.faults().contains(FaultCode::EncoderJump));
        assert!(latch.faults().contains(FaultCode::TactileStale));
        assert!(!latch.stopping().contains(FaultCode::TactileStale));
        assert!(latch.stopping().contains(FaultCode::FollowingError));
        latch.reset();
        assert_eq!((latch.faults(), latch.first_code()), (FaultSet::NONE, 0));
    }
}
