//! Signals at a rate. A client that reads too slowly gets fewer of them, and is told how many it
//! missed.

use serde_json::{Map, Value, json};
use taktil_rtcore::{Invalid, Nanos};

use crate::signals::{SignalPath, SignalTable};

/// What a client watches.
#[derive(Debug)]
pub(crate) struct Watch {
    paths: Vec<SignalPath>,
    period: Nanos,
    next: Nanos,
    skipped: u64,
}

impl Watch {
    /// Begins to watch at once.
    ///
    /// # Errors
    /// A name that does not exist.
    pub(crate) fn begin(
        rate_hz: f64,
        paths: &[String],
        table: &SignalTable,
        now: Nanos,
    ) -> Result<Watch, Invalid> {
        let find = |path: &String| table.find(path).map_err(|bad| bad.within("watch"));
        let paths = paths.iter().map(find).collect::<Result<_, Invalid>>()?;
        Ok(Watch { paths, period: Nanos((1e9 / rate_hz).round() as i64), next: now, skipped: 0 })
    }

    /// The event that is due at `now`, unless the client `is_behind` with what it was sent before.
    pub(crate) fn event(
        &mut self,
        now: Nanos,
        is_behind: bool,
        table: &SignalTable,
    ) -> Option<Value> {
        if now < self.next {
            return None;
        }
        // A stall does not make a burst.
        self.next = (self.next + self.period).max(now);
        if is_behind {
            self.skipped += 1;
            return None;
        }
        let value =
            |path: &SignalPath| (path.name.clone(), table.value(path).unwrap_or(Value::Null));
        let values: Map<String, Value> = self.paths.iter().map(value).collect();
        let skipped = std::mem::take(&mut self.skipped);
        let release = table.newest_release();
        Some(json!({ "event": "watch", "t_ns": release.0, "values": values, "skipped": skipped }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signals::tests::{body, catalog};
    use taktil_rtcore::record::Record;

    #[test]
    fn values_come_at_the_rate_and_what_a_slow_reader_missed_is_counted() {
        let mut table = SignalTable::new(&catalog());
        let begin = Nanos::from_secs(5);
        let paths = ["a.mixed.count".to_owned(), "a.mixed_more".to_owned()];
        let mut watch = Watch::begin(10.0, &paths, &table, begin).unwrap();
        let at = |ms| begin + Nanos::from_millis(ms);
        let body = body([0.0; 3], 4);
        table.record(&Record { signal: 0, tick: 1, release: Nanos(7), body: &body });
        let first = watch.event(at(0), false, &table).unwrap();
        assert_eq!(first["values"], json!({ "a.mixed.count": 4, "a.mixed_more": null }));
        assert_eq!((&first["t_ns"], &first["skipped"]), (&json!(7), &json!(0)));
        assert!(watch.event(at(99), false, &table).is_none());
        assert!(watch.event(at(100), true, &table).is_none());
        assert!(watch.event(at(250), true, &table).is_none());
        assert_eq!(watch.event(at(350), false, &table).unwrap()["skipped"], json!(2));
        assert!(watch.event(at(351), false, &table).is_none(), "no burst after a stall");
        assert!(Watch::begin(10.0, &["b".into()], &table, begin).is_err());
    }
}
