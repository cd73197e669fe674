//! Counts of what the faults of a plan befell, so that a run can tell what it went through.

use super::FaultKind;

/// How many messages and readings each kind of fault befell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FaultCounts([u64; FaultKind::ALL.len()]);

impl FaultCounts {
    /// One more message or reading was befallen by `kind`.
    pub fn add(&mut self, kind: FaultKind) {
        let count = &mut self.0[kind as usize];
        *count = count.saturating_add(1);
    }

    /// How many `kind` befell.
    #[must_use]
    pub fn of(&self, kind: FaultKind) -> u64 {
        self.0[kind as usize]
    }

    /// The kinds that befell anything, with their counts.
    pub fn iter(&self) -> impl Iterator<Item = (FaultKind, u64)> + '_ {
        let counts = FaultKind::ALL.into_iter().map(|kind| (kind, self.of(kind)));
        counts.filter(|(_, count)| *count > 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kind_has_a_count_of_its_own() {
        let mut counts = FaultCounts::default();
        assert_eq!(counts.iter().next(), None);
        for (index, kind) in FaultKind::ALL.into_iter().enumerate() {
            (0..=index).for_each(|_| counts.add(kind));
        }
        for (index, (kind, count)) in counts.iter().enumerate() {
            assert_eq!((kind, count), (FaultKind::ALL[index], index as u64 + 1));
        }
    }
}
