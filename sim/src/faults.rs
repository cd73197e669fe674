//! The scene's faults over time: the faults that are active at an instant, and the instant of the
//! next change. Random faults depend on the seed only.

use taktil_hal::Nanos;

use crate::hash::Hash;
use crate::prng::{Prng, Stream};
use crate::scene::{Fault, FaultKind};

/// One fault with its instants.
#[derive(Clone, Copy, Debug)]
struct FaultInterval {
    kind: FaultKind,
    from: Nanos,
    to: Nanos,
    joint: usize,
    fraction: f64,
    opposed: bool,
}

/// All faults of a scene.
#[derive(Clone, Debug)]
pub(crate) struct Faults {
    intervals: Vec<FaultInterval>,
    lost: Prng,
}

impl Faults {
    pub(crate) fn new(faults: &[Fault], seed: u64) -> Faults {
        let instant = |s: f64| Nanos((1e9 * s).round() as i64);
        let interval = |fault: &Fault| FaultInterval {
            kind: fault.kind,
            from: instant(fault.at_s),
            to: fault.for_s.map_or(Nanos::MAX, |for_s| instant(fault.at_s + for_s)),
            joint: fault.joint.map_or(usize::MAX, |joint| joint as usize - 1),
            fraction: fault.fraction.unwrap_or(1.0),
            opposed: fault.opposed.unwrap_or(false),
        };
        // Those of a plan befall what is outside the bench.
        let own = faults.iter().filter(|fault| fault.kind.planned().is_none());
        Faults { intervals: own.map(interval).collect(), lost: Prng::new(seed, Stream::LostFrames) }
    }

    fn active(&self, kind: FaultKind, now: Nanos) -> impl Iterator<Item = &FaultInterval> {
        let holds = move |interval: &&FaultInterval| {
            interval.kind == kind && interval.from <= now && now < interval.to
        };
        self.intervals.iter().filter(holds)
    }

    /// Whether a fault of this kind is active.
    pub(crate) fn is_active(&self, kind: FaultKind, now: Nanos) -> bool {
        self.active(kind, now).next().is_some()
    }

    /// Whether the encoder of a joint has stopped counting.
    pub(crate) fn has_dead_encoder(&self, joint: usize, now: Nanos) -> bool {
        self.active(FaultKind::DeadEncoder, now).any(|interval| interval.joint == joint)
    }

    /// Whether the frame that is complete now is lost, of the finger's array or of the array
    /// opposed to it. Draws one random number for each active fault that loses a share of the
    /// frames.
    pub(crate) fn drops_frame(&mut self, now: Nanos, opposed: bool) -> bool {
        let mut lost = false;
        for interval in &self.intervals {
            let here = interval.kind == FaultKind::DropFrames && interval.opposed == opposed;
            if here && interval.from <= now && now < interval.to {
                lost |= interval.fraction >= 1.0 || self.lost.uniform() <= interval.fraction;
            }
        }
        lost
    }

    /// The next instant after `now` at which a fault begins or ends.
    pub(crate) fn next_change(&self, now: Nanos) -> Option<Nanos> {
        let instants = self.intervals.iter().flat_map(|interval| [interval.from, interval.to]);
        instants.filter(|instant| *instant > now && *instant < Nanos::MAX).min()
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        if !self.intervals.is_empty() {
            self.lost.digest(hash);
        }
    }
}
