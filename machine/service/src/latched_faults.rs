//! Says which faults the machine has latched, and what the drivers had counted by then: whoever
//! reads the journal learns which drive it was while the machine still stands.

use std::collections::BTreeMap;

use taktil_machine_boards::Counts;
use taktil_record::FieldInfo;
use taktil_record::companion::record_fields;
use taktil_rtcore::record::{Catalog, Record};
use taktil_rtcore::{FaultSet, Nanos};

/// The supervisor's decisions.
const CONTROL_SIGNAL: &str = "supervisor.control";
/// From a fault to the word of it: drives tell their code some cycles after they have stopped, and
/// faults that follow from the first one stand on the same line.
const TELLING_DELAY: Nanos = Nanos::from_millis(100);

/// Looks for faults among the records.
pub(crate) struct LatchedFaults {
    signal: Option<usize>,
    field: Option<FieldInfo>,
    /// What is latched now.
    known: FaultSet,
    /// What was latched and is not told yet.
    untold: FaultSet,
    since: Option<Nanos>,
    /// What each driver counts on its board.
    pub(crate) counts: BTreeMap<String, Counts>,
}

impl LatchedFaults {
    /// Looks at the records of a machine with this catalog.
    pub(crate) fn new(catalog: &Catalog) -> LatchedFaults {
        let signal = catalog.find(CONTROL_SIGNAL);
        let fields = signal.and_then(|signal| record_fields(catalog).into_iter().nth(signal));
        let field = fields.and_then(|all| all.into_iter().find(|info| info.name == "faults"));
        LatchedFaults {
            signal,
            field,
            known: FaultSet::NONE,
            untold: FaultSet::NONE,
            since: None,
            counts: BTreeMap::new(),
        }
    }

    /// Takes a record.
    pub(crate) fn record(&mut self, record: &Record<'_>) {
        let Some(field) = self.field.as_ref().filter(|_| self.signal == Some(record.signal)) else {
            return;
        };
        // Codes of faults are below 53: their word is exact as floating point.
        let word = field.numbers(record.body).first().map_or(0, |word| *word as u64);
        self.untold = FaultSet(self.untold.0 | word & !self.known.0);
        self.known = FaultSet(word);
    }

    /// What there is to say at `now`.
    pub(crate) fn look(&mut self, now: Nanos) -> Option<String> {
        if self.untold.is_empty() || now - *self.since.get_or_insert(now) < TELLING_DELAY {
            return None;
        }
        self.since = None;
        let faults = std::mem::replace(&mut self.untold, FaultSet::NONE);
        let faults: Vec<&str> = faults.iter().map(|fault| fault.text()).collect();
        let counts =
            self.counts.iter().map(|(name, counts)| format!("; {name}: {}", counts.text()));
        Some(format!("latched: {}{}", faults.join(", "), counts.collect::<String>()))
    }
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;

    use taktil_rtcore::FaultCode;
    use taktil_rtcore::payload::{Field, Primitive};
    use taktil_rtcore::record::Signal;

    use super::*;

    fn faults_of_an_arm() -> LatchedFaults {
        let fields = vec![
            Field { name: "entered_ns", kind: Primitive::I64, count: 1, array: false },
            Field { name: "faults", kind: Primitive::U64, count: 1, array: false },
        ];
        let signal = Signal {
            name: CONTROL_SIGNAL.into(),
            lane: 0,
            type_name: "ControlState".into(),
            fields: Cow::Owned(fields),
            size: 16,
        };
        let mut watched = LatchedFaults::new(&Catalog { signals: vec![signal], lanes: vec![] });
        let counts = Counts(Box::new(|| vec![("as device of the newest drive fault", 5)]));
        watched.counts.insert("arm".into(), counts);
        watched
    }

    fn latch(watched: &mut LatchedFaults, faults: &[FaultCode]) {
        let mut set = FaultSet::NONE;
        faults.iter().for_each(|fault| set.insert(*fault));
        let body = [7_u64.to_le_bytes(), set.0.to_le_bytes()].concat();
        watched.record(&Record { signal: 0, tick: 0, release: Nanos::ZERO, body: &body });
    }

    #[test]
    fn each_fault_is_told_once_with_what_the_drivers_had_counted() {
        let (mut watched, at) = (faults_of_an_arm(), Nanos::from_millis);
        latch(&mut watched, &[]);
        assert_eq!(watched.look(at(0)), None);
        latch(&mut watched, &[FaultCode::AnalogOutLost]);
        assert_eq!(watched.look(at(10)), None, "the drive's code may still come");
        latch(&mut watched, &[FaultCode::AnalogOutLost, FaultCode::EncoderLost]);
        let text = watched.look(at(110)).unwrap_or_default();
        let wanted = "latched: the encoder board does not answer, the D/A board does not answer; \
                      arm: 5 as device of the newest drive fault";
        assert_eq!(text, wanted);
        latch(&mut watched, &[FaultCode::AnalogOutLost, FaultCode::EncoderLost]);
        assert_eq!(watched.look(at(900)), None);
        // A fault that was reset is news when it comes again.
        latch(&mut watched, &[]);
        latch(&mut watched, &[FaultCode::AnalogOutLost]);
        assert_eq!(watched.look(at(1_000)), None);
        assert!(watched.look(at(1_100)).is_some_and(|text| text.contains("D/A")));
    }
}
