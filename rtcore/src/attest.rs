//! The attestation of what the kernel granted, read back and not assumed: for each lane its policy,
//! priority and CPUs, and for the process memory, limits, throttling, clock and power. Missing
//! items that were asked for are listed separately from those that were not.

use crate::contract::{Demands, Item, Shortfall, Weight, shortfalls};
use crate::facts::{Facts, LaneGrant};

/// What the kernel granted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Attestation {
    /// Every item that is not as demanded, with its weight, also those of no weight.
    pub shortfalls: Vec<Shortfall>,
    /// What was asked for or demanded and not granted, one sentence each.
    pub missing: Vec<String>,
    /// Items that were not asked for but impair real-time behaviour, one sentence each.
    pub notes: Vec<String>,
    /// The kernel is built with PREEMPT_RT.
    pub preempt_rt: bool,
    /// It runs in a virtual machine.
    pub virtual_machine: bool,
    /// Each lane's thread.
    pub lanes: Vec<LaneGrant>,
    /// The machine and the process.
    pub facts: Facts,
}

impl Attestation {
    /// Policy, priority, processor and memory are as asked for, and nothing demanded is missing.
    #[must_use]
    pub fn is_granted(&self) -> bool {
        self.missing.is_empty()
    }

    /// What was demanded and is missing: a run that drives a board is refused.
    pub fn refused(&self) -> impl Iterator<Item = &Shortfall> {
        self.shortfalls.iter().filter(|short| short.weight == Weight::Hard)
    }

    /// Timing figures of this run say something about the machine's real-time abilities, whatever
    /// was demanded.
    #[must_use]
    pub fn is_representative(&self) -> bool {
        let core = self.shortfalls.iter().any(|short| short.item.is_core());
        self.is_granted() && !core && self.preempt_rt && !self.virtual_machine
    }

    /// Weighs what was asked for and not granted, and what the facts fall short of, once they are
    /// complete.
    pub(crate) fn assess(&mut self, asked: Vec<Shortfall>, demands: &Demands) {
        let facts = &self.facts;
        self.shortfalls = asked;
        let said = self.shortfalls.iter().any(|short| short.item == Item::Memory);
        let hard = demands.of(Item::Memory) == Weight::Hard;
        self.shortfalls.extend(unlocked_memory(facts, hard).filter(|_| !said));
        self.shortfalls.extend(shortfalls(facts, self.preempt_rt, &self.lanes, demands));
        if self.virtual_machine {
            self.notes.push("a virtual machine: its host may take the processor".to_owned());
        }
        for short in &mut self.shortfalls {
            short.weight = demands.of(short.item);
            let asked = short.item.is_core() || short.weight == Weight::Hard;
            match short.weight {
                Weight::None => {}
                _ if asked => self.missing.push(short.found.clone()),
                _ => self.notes.push(short.found.clone()),
            }
        }
    }
}

/// Resident memory that no lock covers: pages of the kernel's own, mapped into every process.
const UNLOCKED_KIB: u64 = 256;

/// A memory lock that was not refused and does not cover the process, or, where it is demanded
/// `hard`, is not seen to.
fn unlocked_memory(facts: &Facts, hard: bool) -> Option<Shortfall> {
    let found = match facts.locked_kib.zip(facts.resident_kib) {
        Some((locked, resident)) => (locked + UNLOCKED_KIB < resident)
            .then(|| format!("memory: {locked} KiB locked of {resident} KiB resident"))?,
        None if hard => "memory: VmLck or VmRSS cannot be read".to_owned(),
        None => return None,
    };
    Some(Shortfall::new(Item::Memory, found))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_that_does_not_cover_is_missing() {
        let facts = |locked, resident| Facts {
            locked_kib: locked,
            resident_kib: resident,
            ..Facts::default()
        };
        let judged = |facts: Facts, asked, demands: &Demands| {
            let mut attestation = Attestation { preempt_rt: true, facts, ..Attestation::default() };
            attestation.assess(asked, demands);
            attestation
        };
        let missing = |facts: Facts| judged(facts, Vec::new(), &Demands::SOFT).missing;
        assert_eq!(missing(facts(Some(9000), Some(9000))).len(), 0);
        assert_eq!(missing(facts(Some(4000), Some(9000))).len(), 1);
        assert_eq!(missing(facts(Some(0), Some(9000))).len(), 1, "a lock that locked nothing");
        assert_eq!(missing(facts(None, Some(9000))).len(), 0, "unknown is not missing");
        let unseen = judged(facts(None, Some(9000)), Vec::new(), &Demands::BOARD);
        assert_eq!(unseen.refused().count(), 1, "unless it is demanded");
        let refused = vec![Shortfall::new(Item::Memory, "refused")];
        let both = judged(facts(Some(0), Some(9000)), refused, &Demands::BOARD);
        assert_eq!(both.missing, ["refused"], "said once");
    }

    #[test]
    fn the_weight_of_an_item_decides_what_missing_it_means() {
        let judged = |demands: &Demands| {
            let facts = Facts { locked_kib: Some(9), resident_kib: Some(9), ..Facts::default() };
            let mut attestation = Attestation { preempt_rt: true, facts, ..Attestation::default() };
            attestation.assess(vec![Shortfall::new(Item::Fifo, "no priority")], demands);
            attestation
        };
        let soft = judged(&Demands::SOFT);
        assert_eq!(
            (soft.refused().count(), soft.missing.as_slice()),
            (0, &["no priority".into()][..])
        );
        assert_eq!(soft.notes.len(), 1, "dma latency");
        assert!(!soft.is_granted());
        let board = judged(&Demands::BOARD);
        assert_eq!(board.refused().map(|short| short.item).collect::<Vec<_>>(), [Item::Fifo]);
        let none =
            Demands::SOFT.with(Item::Fifo, Weight::None).with(Item::DmaLatency, Weight::None);
        let silent = judged(&none);
        assert!(silent.is_granted() && silent.notes.is_empty() && silent.refused().count() == 0);
        assert!(!silent.is_representative(), "silence grants nothing");
        let strict = judged(&none.with(Item::DmaLatency, Weight::Hard));
        assert_eq!(
            strict.refused().map(|short| short.item).collect::<Vec<_>>(),
            [Item::DmaLatency]
        );
        assert_eq!(strict.missing.len(), 1, "what is demanded and missing is no mere note");
    }
}
