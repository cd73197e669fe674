//! The faults that befall one target, and the chance by which those happen that have a probability.
//! Reading it allocates nothing.

use taktil_hal::fault::{Fault, FaultKind, FaultPlan, SplitMix};
use taktil_hal::{Error, Nanos, Reading};

/// What an input half answers.
pub(crate) type Answer<T> = Result<Reading<T>, Error>;

/// The faults of one target.
#[derive(Clone, Debug)]
pub struct TargetFaults {
    faults: Vec<Fault>,
    random: SplitMix,
}

impl TargetFaults {
    /// Those of a plan that befall `target`, with chance of its own from the seed of the run.
    #[must_use]
    pub fn of(plan: &FaultPlan, target: &str, seed: u64) -> TargetFaults {
        let befalls = |fault: &&Fault| fault.target.is_empty() || fault.target == target;
        let faults = plan.faults().iter().filter(befalls).cloned().collect();
        // FNV-1a of the name: streams of different targets differ.
        let name = target.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        });
        TargetFaults { faults, random: SplitMix::new(seed ^ name) }
    }

    /// Whether there is none at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.faults.is_empty()
    }

    /// All of them.
    #[must_use]
    pub fn faults(&self) -> &[Fault] {
        &self.faults
    }

    /// Whether a fault of this kind is under way at `now`, for whatever channel.
    #[must_use]
    pub fn is_active(&self, kind: FaultKind, now: Nanos) -> bool {
        self.faults.iter().any(|fault| fault.kind == kind && fault.is_under_way(now))
    }

    /// How strongly a kind of fault befalls `channel` (from 0) at `now`: the strongest of those
    /// under way, by magnitude.
    #[must_use]
    pub fn strength(&self, kind: FaultKind, channel: usize, now: Nanos) -> Option<f64> {
        let befalls = |fault: &&Fault| {
            fault.kind == kind && fault.is_under_way(now) && fault.has_channel(channel)
        };
        let stronger = |a: f64, b: f64| if b.abs() > a.abs() { b } else { a };
        self.faults.iter().filter(befalls).map(|fault| fault.value).reduce(stronger)
    }

    /// Whether a kind of fault befalls `channel` (from 0) at `now`.
    #[must_use]
    pub fn has(&self, kind: FaultKind, channel: usize, now: Nanos) -> bool {
        self.strength(kind, channel, now).is_some()
    }

    /// Whether a fault whose strength is a probability happens at `now`. Draws one number for each
    /// that is under way.
    pub fn happens(&mut self, kind: FaultKind, now: Nanos) -> bool {
        let mut happens = false;
        for fault in &self.faults {
            if fault.kind == kind && fault.is_under_way(now) {
                happens |= self.random.unit() < fault.value;
            }
        }
        happens
    }

    /// A whole number below `end`, by chance.
    pub fn below(&mut self, end: usize) -> usize {
        self.random.below(end)
    }

    /// The begin of the newest fault of this kind that has begun by `now`, even if it has ended.
    #[must_use]
    pub fn newest_begin(&self, kind: FaultKind, now: Nanos) -> Option<Nanos> {
        let begun = |fault: &&Fault| fault.kind == kind && fault.at <= now;
        self.faults.iter().filter(begun).map(|fault| fault.at).max()
    }
}
