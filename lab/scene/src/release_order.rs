//! Records of several lanes in one order, whatever the order in which they came: by release, then
//! by lane, then as their lane wrote them. In virtual time records come in this order; live, each
//! lane's come when its ring is read.

use std::collections::BTreeMap;

use taktil_rtcore::Nanos;
use taktil_rtcore::record::{Catalog, Record};

/// Largest number of records that wait for a lane that writes none; beyond it the oldest is given
/// out nevertheless.
const WAITING_MAX: usize = 1 << 16;

/// A record with a body of its own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeptRecord {
    /// Index into [`Catalog::signals`].
    pub signal: usize,
    /// Encoded payload.
    pub body: Vec<u8>,
}

/// Puts the records of some signals in order.
#[derive(Clone, Debug)]
pub struct ReleaseOrder {
    /// The lane of each signal, and whether its records are kept.
    signals: Vec<(usize, bool)>,
    /// The newest release of each lane that writes a kept signal.
    newest: BTreeMap<usize, Option<Nanos>>,
    waiting: BTreeMap<(Nanos, usize, u64), KeptRecord>,
    count: u64,
}

impl ReleaseOrder {
    /// For the records of `kept`, indices into [`Catalog::signals`].
    #[must_use]
    pub fn new(catalog: &Catalog, kept: &[usize]) -> ReleaseOrder {
        let signals = catalog.signals.iter().enumerate();
        let signals: Vec<_> =
            signals.map(|(index, signal)| (signal.lane, kept.contains(&index))).collect();
        let lanes = signals.iter().filter(|(_, kept)| *kept).map(|(lane, _)| (*lane, None));
        let newest = lanes.collect();
        ReleaseOrder { signals, newest, waiting: BTreeMap::new(), count: 0 }
    }

    /// Takes a record of any signal: also one that is not kept tells how far its lane is.
    pub fn push(&mut self, record: &Record<'_>) {
        let Some((lane, kept)) = self.signals.get(record.signal).copied() else { return };
        if let Some(newest) = self.newest.get_mut(&lane) {
            *newest = (*newest).max(Some(record.release));
        }
        if kept {
            let kept = KeptRecord { signal: record.signal, body: record.body.to_vec() };
            self.waiting.insert((record.release, lane, self.count), kept);
            self.count += 1;
        }
    }

    /// The oldest record, once no lane can write an older one any more.
    pub fn pop(&mut self) -> Option<KeptRecord> {
        let first = self.waiting.first_entry()?;
        let release = first.key().0;
        let known = self.newest.values().all(|newest| newest.is_some_and(|at| at > release));
        if known || self.waiting.len() > WAITING_MAX { self.pop_last() } else { None }
    }

    /// The oldest record, when no further one will come.
    pub fn pop_last(&mut self) -> Option<KeptRecord> {
        self.waiting.pop_first().map(|(_, record)| record)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_rtcore::record::Signal;

    fn catalog() -> Catalog {
        let signal = |(name, lane): (&str, usize)| Signal {
            name: name.to_owned(),
            lane,
            type_name: "T".into(),
            fields: (&[]).into(),
            size: 1,
        };
        let signals = [("a", 0), ("b", 1), ("c", 1)].map(signal).into();
        Catalog { signals, lanes: Vec::new() }
    }

    fn record(order: &mut ReleaseOrder, signal: usize, release: i64, body: u8) {
        order.push(&Record { signal, tick: 0, release: Nanos(release), body: &[body] });
    }

    fn popped(order: &mut ReleaseOrder) -> Vec<u8> {
        std::iter::from_fn(|| order.pop()).map(|record| record.body[0]).collect()
    }

    #[test]
    fn the_order_is_that_of_virtual_time_however_the_lanes_rings_are_read() {
        let virtual_time = [(0, 0, 1), (1, 0, 2), (1, 0, 3), (0, 5, 4), (0, 10, 5), (1, 10, 6)];
        let one_lane_first = [(1, 0, 2), (1, 0, 3), (1, 10, 6), (0, 0, 1), (0, 5, 4), (0, 10, 5)];
        for arrival in [virtual_time, one_lane_first] {
            let mut order = ReleaseOrder::new(&catalog(), &[0, 1]);
            let mut found = Vec::new();
            for (signal, release, body) in arrival {
                record(&mut order, signal, release, body);
                found.extend(popped(&mut order));
            }
            assert_eq!(found, [1, 2, 3, 4], "those of the newest release may not be whole");
            found.extend(std::iter::from_fn(|| order.pop_last()).map(|record| record.body[0]));
            assert_eq!(found, [1, 2, 3, 4, 5, 6]);
        }
    }

    #[test]
    fn a_signal_that_is_not_kept_tells_how_far_its_lane_is() {
        let mut order = ReleaseOrder::new(&catalog(), &[0, 1]);
        record(&mut order, 0, 0, 1);
        record(&mut order, 0, 5, 2);
        assert!(popped(&mut order).is_empty());
        record(&mut order, 2, 5, 9);
        assert_eq!(popped(&mut order), [1]);
    }

    #[test]
    fn a_lane_that_writes_nothing_does_not_keep_all_others_for_ever() {
        let mut order = ReleaseOrder::new(&catalog(), &[0, 1]);
        for release in 0..=WAITING_MAX as i64 {
            assert!(popped(&mut order).is_empty());
            record(&mut order, 0, release, 7);
        }
        assert_eq!(popped(&mut order), [7]);
    }
}
