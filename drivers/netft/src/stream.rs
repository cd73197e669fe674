//! The numbers of a stream of records: which record is newer than all before, how many are missing,
//! and whether the box has restarted.

use crate::rdt::Record;

/// This many records in a row that are older than one before them belong to another stream.
const OLD_RECORDS_MAX: u32 = 8;

/// A sample that is further ahead belongs to a box that has restarted: 40 min at 7000 a second.
const SAMPLES_AHEAD_MAX: i32 = 1 << 24;

/// What was counted on a stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamCounts {
    /// Records that were taken.
    pub records: u64,
    /// Numbers that were left out.
    pub missing: u64,
    /// Records that came late or twice.
    pub old: u64,
    /// Records whose status was not 0.
    pub invalid: u64,
    /// Datagrams that are no record.
    pub strange: u64,
    /// Times at which the numbers began anew.
    pub streams: u64,
    /// Times at which the box had restarted.
    pub restarts: u64,
    /// Times at which too many records had piled up.
    pub backlogs: u64,
    /// Times at which a silent box was asked to start again.
    pub requests: u64,
    /// Times at which nobody listened.
    pub refusals: u64,
}

/// What a record is to its stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The newest one, and valid.
    New,
    /// The newest one, of a box that is not well.
    Invalid,
    /// Not newer than one before.
    Old,
}

/// The state of a stream.
#[derive(Clone, Debug, Default)]
pub(crate) struct Stream {
    last: Option<Record>,
    /// Records in a row that were old.
    olds: u32,
    pub(crate) seen: StreamCounts,
}

/// How far `now` is ahead of `before`, both of which wrap; negative when it is behind.
const fn ahead(now: u32, before: u32) -> i32 {
    now.wrapping_sub(before).cast_signed()
}

impl Stream {
    /// Takes a record in the order of arrival.
    pub(crate) fn take(&mut self, record: Record) -> Verdict {
        if let Some(last) = self.last {
            let steps = ahead(record.rdt_sequence, last.rdt_sequence);
            let samples = ahead(record.ft_sequence, last.ft_sequence);
            if samples > SAMPLES_AHEAD_MAX {
                self.seen.restarts += 1;
            } else if steps > 0 && samples > 0 {
                self.seen.missing += u64::from(steps.unsigned_abs()) - 1;
            } else if samples > 0 {
                // Somebody asked the box to start again: its records count from 1.
                self.seen.streams += 1;
            } else {
                self.olds += 1;
                // A sample that is newer than the one before it, but older than all others, again
                // and again: the box counts from its start.
                if self.olds < OLD_RECORDS_MAX {
                    self.seen.old += 1;
                    return Verdict::Old;
                }
                self.seen.restarts += 1;
            }
        }
        self.olds = 0;
        self.last = Some(record);
        self.seen.records += 1;
        if record.status == 0 {
            Verdict::New
        } else {
            self.seen.invalid += 1;
            Verdict::Invalid
        }
    }

    /// A restart of the numbers that is due: records before it do not count.
    pub(crate) fn expect_new_stream(&mut self) {
        self.olds = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(rdt_sequence: u32, ft_sequence: u32) -> Record {
        Record { rdt_sequence, ft_sequence, status: 0, counts: [0; 6] }
    }

    fn takes(numbers: &[(u32, u32)]) -> (Vec<Verdict>, StreamCounts) {
        let mut stream = Stream::default();
        let takes = numbers.iter().map(|(rdt, ft)| stream.take(record(*rdt, *ft))).collect();
        (takes, stream.seen)
    }

    #[test]
    fn gaps_and_old_records_are_counted() {
        let (takes, seen) = takes(&[(1, 100), (2, 101), (5, 104), (4, 103), (5, 104), (6, 105)]);
        let (new, old) = (Verdict::New, Verdict::Old);
        assert_eq!(takes, [new, new, new, old, old, new]);
        assert_eq!((seen.records, seen.missing, seen.old), (4, 2, 2));
    }

    #[test]
    fn numbers_wrap() {
        let (takes, seen) = takes(&[(u32::MAX, u32::MAX - 1), (0, u32::MAX), (1, 0), (3, 2)]);
        assert_eq!((takes, seen.missing, seen.restarts), (vec![Verdict::New; 4], 1, 0));
    }

    #[test]
    fn a_stream_that_was_asked_for_anew_goes_on() {
        let (takes, seen) = takes(&[(900, 5000), (1, 5003), (2, 5004)]);
        assert_eq!((takes, seen.streams, seen.missing), (vec![Verdict::New; 3], 1, 0));
    }

    #[test]
    fn a_box_that_counts_from_its_start_again_has_restarted() {
        let mut numbers = vec![(900, 5000)];
        numbers.extend((1..=20).map(|at| (at, 30 + at)));
        let (takes, seen) = takes(&numbers);
        assert_eq!((seen.restarts, seen.old), (1, u64::from(OLD_RECORDS_MAX) - 1));
        assert_eq!(takes[OLD_RECORDS_MAX as usize..], [Verdict::New; 13]);
    }

    #[test]
    fn a_restart_is_seen_also_where_the_numbers_wrap() {
        let (takes, seen) = takes(&[(900, 0x9000_0000), (1, 5), (2, 6)]);
        assert_eq!((takes, seen.restarts, seen.missing), (vec![Verdict::New; 3], 1, 0));
    }

    #[test]
    fn a_status_that_is_not_zero_makes_a_record_invalid() {
        let mut stream = Stream::default();
        let bad = Record { status: 1, ..record(1, 1) };
        assert_eq!((stream.take(bad), stream.seen.invalid), (Verdict::Invalid, 1));
        assert_eq!(stream.take(record(2, 2)), Verdict::New);
    }
}
