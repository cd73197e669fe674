//! Triggered capture: the values of a few channels before and after an event, at the full rate of
//! their signals, as an oscilloscope shows them.

use std::collections::VecDeque;

use serde_json::{Value, json};
use taktil_rtcore::record::Record;
use taktil_rtcore::{Invalid, Nanos};

use crate::signals::{SignalPath, SignalTable};
use crate::words::{finite, shortened};

/// Largest number of channels.
const CHANNELS_MAX: usize = 8;
/// Largest number of samples of one channel.
const SAMPLES_MAX: usize = 8000;
/// Longest time before and after the event together (s).
const DURATION_MAX_S: f64 = 60.0;
/// How far the records of one lane may be behind those of another.
const LAG_MAX: Nanos = Nanos::from_millis(50);

/// What the trigger's value has to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Condition {
    /// Come from below the level to it or above.
    Rises,
    /// Come from above the level to it or below.
    Falls,
    /// Be at or above the level.
    Above,
    /// Be at or below the level.
    Below,
}

/// A capture as a client asks for it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ScopeRequest {
    channels: Vec<String>,
    trigger: String,
    condition: Condition,
    level: f64,
    before_s: f64,
    after_s: f64,
}

const USAGE: &str = "say `scope CHANNEL .. trigger CHANNEL rises LEVEL before 0.5 after 1`: at \
                     most 8 single numbers such as sense.joints.q_rad[0]; rises, falls, above or \
                     below; seconds, 60 in all";

impl ScopeRequest {
    /// Reads the words after `scope`.
    pub(crate) fn read(words: &[&str]) -> Result<ScopeRequest, Invalid> {
        let bad = |what: String| Err(Invalid::new("scope", what, USAGE));
        let Some(at) = words.iter().position(|word| *word == "trigger") else {
            return bad("no trigger is named".into());
        };
        let (channels, rest) = (&words[..at], &words[at + 1..]);
        if !(1..=CHANNELS_MAX).contains(&channels.len()) {
            return bad(format!("{} channels", channels.len()));
        }
        let [trigger, condition, level, "before", before, "after", after] = rest else {
            return bad("incomplete behind `trigger`".into());
        };
        let condition = match *condition {
            "rises" => Condition::Rises,
            "falls" => Condition::Falls,
            "above" => Condition::Above,
            "below" => Condition::Below,
            other => return bad(format!("`{}` is no condition", shortened(other))),
        };
        let Some(level) = finite(level) else { return bad("the level is no number".into()) };
        let seconds = |word: &str| finite(word).filter(|seconds| *seconds >= 0.0);
        let (Some(before_s), Some(after_s)) = (seconds(before), seconds(after)) else {
            return bad("before and after are no seconds".into());
        };
        if before_s + after_s > DURATION_MAX_S {
            return bad(format!("{} s in all", before_s + after_s));
        }
        let channels = channels.iter().map(|name| (*name).to_owned()).collect();
        let trigger = (*trigger).to_owned();
        Ok(ScopeRequest { channels, trigger, condition, level, before_s, after_s })
    }
}

#[derive(Debug)]
struct ScopeChannel {
    path: SignalPath,
    samples: VecDeque<(Nanos, f64)>,
    is_truncated: bool,
}

/// A capture that waits for its event, or for the time after it.
#[derive(Debug)]
pub(crate) struct Scope {
    channels: Vec<ScopeChannel>,
    trigger: SignalPath,
    condition: Condition,
    level: f64,
    before: Nanos,
    after: Nanos,
    previous: Option<f64>,
    triggered: Option<Nanos>,
    newest: Nanos,
}

impl Scope {
    /// Arms a capture.
    ///
    /// # Errors
    /// A channel that does not exist or is not a single number.
    pub(crate) fn arm(request: &ScopeRequest, table: &SignalTable) -> Result<Scope, Invalid> {
        let channel = |name: &String| {
            let path = table.find_number(name).map_err(|bad| bad.within("scope"))?;
            Ok(ScopeChannel { path, samples: VecDeque::new(), is_truncated: false })
        };
        let span = |seconds: f64| Nanos((seconds * 1e9).round() as i64);
        Ok(Scope {
            channels: request.channels.iter().map(channel).collect::<Result<_, Invalid>>()?,
            trigger: table.find_number(&request.trigger).map_err(|bad| bad.within("scope"))?,
            condition: request.condition,
            level: request.level,
            before: span(request.before_s),
            after: span(request.after_s),
            previous: None,
            triggered: None,
            newest: Nanos::ZERO,
        })
    }

    /// Takes in a record; the table names the places of its fields.
    pub(crate) fn record(&mut self, record: &Record<'_>, table: &SignalTable) {
        self.newest = self.newest.max(record.release);
        let oldest = self.newest - self.before - LAG_MAX;
        let is_armed = self.triggered.is_none();
        for channel in self.channels.iter_mut().filter(|c| c.path.signal == record.signal) {
            let Some(value) = table.number_in(&channel.path, record.body) else { continue };
            channel.samples.push_back((record.release, value));
            let is_old = |sample: Option<&(Nanos, f64)>| sample.is_some_and(|s| s.0 < oldest);
            while is_armed && is_old(channel.samples.front()) {
                channel.samples.pop_front();
            }
            if channel.samples.len() > SAMPLES_MAX {
                channel.samples.pop_front();
                channel.is_truncated = true;
            }
        }
        if self.triggered.is_none() && self.trigger.signal == record.signal {
            self.look_for_event(record, table);
        }
    }

    fn look_for_event(&mut self, record: &Record<'_>, table: &SignalTable) {
        let Some(value) = table.number_in(&self.trigger, record.body) else { return };
        let previous = self.previous.replace(value);
        let happened = match self.condition {
            Condition::Rises => previous.is_some_and(|p| p < self.level) && value >= self.level,
            Condition::Falls => previous.is_some_and(|p| p > self.level) && value <= self.level,
            Condition::Above => value >= self.level,
            Condition::Below => value <= self.level,
        };
        if happened {
            self.triggered = Some(record.release);
        }
    }

    /// The capture as an event, once it is complete; `lost` records did not reach it.
    pub(crate) fn event(&self, lost: u64) -> Option<Value> {
        let at = self.triggered?;
        if self.newest < at + self.after + LAG_MAX {
            return None;
        }
        let channels = self.channels.iter().map(|channel| {
            let wanted = channel
                .samples
                .iter()
                .filter(|(time, _)| (at - self.before..=at + self.after).contains(time));
            let (times, values): (Vec<f64>, Vec<f64>) =
                wanted.map(|(time, value)| ((*time - at).as_secs_f64(), *value)).unzip();
            json!({
                "name": channel.path.name,
                "t_s": times,
                "values": values,
                "truncated": channel.is_truncated,
            })
        });
        let channels: Vec<Value> = channels.collect();
        Some(json!({ "event": "scope", "at_ns": at.0, "channels": channels, "lost": lost }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signals::tests::{body, catalog};

    /// Sends `count` values, 1 ms apart, from a function of the time in ms.
    fn capture(words: &str, count: i64, value: impl Fn(i64) -> f64) -> Option<Value> {
        let words: Vec<&str> = words.split_whitespace().collect();
        let table = SignalTable::new(&catalog());
        let mut scope = Scope::arm(&ScopeRequest::read(&words).unwrap(), &table).unwrap();
        for ms in 0..count {
            let body = body([value(ms), 0.0, 0.0], ms as u32);
            let release = Nanos::from_millis(ms);
            scope.record(&Record { signal: 0, tick: ms as u64, release, body: &body }, &table);
        }
        scope.event(3)
    }

    const ALL: &str = "a.mixed.three[0] a.mixed.count trigger a.mixed.three[0]";

    #[test]
    fn a_capture_holds_what_came_before_and_after_the_edge() {
        let words = format!("{ALL} rises 0.5 before 0.01 after 0.02");
        let event = capture(&words, 300, |ms| if ms < 100 { 0.0 } else { 1.0 }).unwrap();
        assert_eq!((&event["at_ns"], &event["lost"]), (&json!(100_000_000), &json!(3)));
        let counts: Vec<f64> =
            serde_json::from_value(event["channels"][1]["values"].clone()).unwrap();
        assert_eq!(counts, (90..=120).map(f64::from).collect::<Vec<_>>());
        assert_eq!(event["channels"][0]["t_s"][0], json!(-0.01));
        assert!(capture(&words, 160, |ms| f64::from(ms >= 100)).is_none(), "not complete yet");
    }

    #[test]
    fn levels_and_edges_differ() {
        let at = |condition: &str, value: fn(i64) -> f64| {
            let words = format!("{ALL} {condition} before 0 after 0");
            capture(&words, 300, value).map(|event| event["at_ns"].as_i64().unwrap() / 1_000_000)
        };
        let high = |ms| f64::from(ms < 50);
        assert_eq!(at("above 0.5", high), Some(0));
        assert_eq!(at("rises 0.5", high), None, "it was never below");
        assert_eq!(at("falls 0.5", high), Some(50));
        assert_eq!(at("below 0.5", high), Some(50));
        assert_eq!(at("above 2", high), None);
        assert_eq!(at("above 0", |_| f64::NAN), None);
    }

    #[test]
    fn long_captures_are_bounded_and_say_so() {
        let words = format!("{ALL} falls -1 before 50 after 0");
        let event = capture(&words, 12_000, |ms| if ms < 11_900 { 0.0 } else { -2.0 }).unwrap();
        let channel = &event["channels"][0];
        assert_eq!(channel["truncated"], json!(true));
        assert!(channel["values"].as_array().unwrap().len() <= SAMPLES_MAX);
    }

    #[test]
    fn what_cannot_be_captured_is_refused() {
        for words in [
            "",
            "a",
            "trigger a rises 1 before 1 after 1",
            "a trigger a",
            "a trigger a jumps 1 before 1 after 1",
            "a trigger a rises nan before 1 after 1",
            "a trigger a rises 1 before -1 after 1",
            "a trigger a rises 1 before 40 after 40",
            "a b c d e f g h i trigger a rises 1 before 1 after 1",
        ] {
            let words: Vec<&str> = words.split_whitespace().collect();
            let bad = ScopeRequest::read(&words).unwrap_err();
            assert_eq!(bad.remedy, USAGE, "{words:?}");
        }
        let words = "a.mixed.three trigger a.mixed.count rises 1 before 1 after 1";
        let words: Vec<&str> = words.split_whitespace().collect();
        let request = ScopeRequest::read(&words).unwrap();
        assert!(Scope::arm(&request, &SignalTable::new(&catalog())).is_err());
    }
}
