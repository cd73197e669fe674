//! What all pages see: one connection to the machine that asks once, however many look. The newest
//! values replace older ones. When the machine has gone, the connection is tried again.

use std::collections::BTreeSet;
use std::path::PathBuf;

use serde_json::{Value, json};
use taktil_machine_client::OperatorSocket;
use taktil_rtcore::Nanos;

/// Rate at which values are asked for (Hz): a little more than 30, for a clock that is not ours.
const WATCH_RATE_HZ: u32 = 32;
/// Signals, fields and elements that the machine sends to one client at most.
const WATCHED_MAX: usize = 32;
/// Time between two questions for the machine's status.
const STATUS_INTERVAL: Nanos = Nanos::from_millis(200);
/// Time between two questions for its parameters, which others may set.
const PARAMETERS_INTERVAL: Nanos = Nanos::from_secs(2);
/// Time between two attempts to connect.
const RETRY_INTERVAL: Nanos = Nanos::from_millis(500);
/// A machine that has answered nothing for this long is connected to anew.
const SILENCE_MAX: Nanos = Nanos::from_secs(3);

/// What is asked of the machine, in the order of [`Feed::documents`].
const QUESTIONS: [&str; 4] = ["model", "signals", "status", "parameters"];
/// Place of the model among the questions.
#[cfg(feature = "foxglove")]
pub(crate) const MODEL_INDEX: usize = 0;
/// Place of the signals among the questions.
#[cfg(feature = "foxglove")]
pub(crate) const SIGNALS_INDEX: usize = 1;
/// Place of the status among the questions.
const STATUS_INDEX: usize = 2;

/// An answer that is the same for all pages.
#[derive(Clone, Debug, Default)]
pub(crate) struct Document {
    /// Grows with every new text; 0 before the first.
    pub(crate) version: u64,
    /// The event for pages.
    pub(crate) text: String,
}

/// The answer to a stop, for the page that said it.
#[derive(Debug)]
pub(crate) struct StopAnswer {
    pub(crate) page: u64,
    /// The answer under the page's own number.
    pub(crate) text: String,
}

/// The connection and what came over it.
#[derive(Debug)]
pub(crate) struct Feed {
    path: PathBuf,
    socket: Option<OperatorSocket>,
    next_attempt: Nanos,
    heard: Nanos,
    next_status: Nanos,
    next_parameters: Nanos,
    /// Signals that are there, by the machine's own list.
    signals: Value,
    /// What was last asked for by `watch`.
    watched: String,
    /// What pages want beyond the usual.
    wanted: BTreeSet<String>,
    /// The newest values, as the machine sent them.
    pub(crate) values: Document,
    /// Model, signals, status and parameters.
    pub(crate) documents: [Document; QUESTIONS.len()],
    /// Whether the machine is there.
    pub(crate) link: Document,
    is_up: bool,
}

impl Feed {
    pub(crate) fn new(path: PathBuf) -> Feed {
        Feed {
            path,
            socket: None,
            next_attempt: Nanos::ZERO,
            heard: Nanos::ZERO,
            next_status: Nanos::ZERO,
            next_parameters: Nanos::ZERO,
            signals: Value::Null,
            watched: String::new(),
            wanted: BTreeSet::new(),
            values: Document::default(),
            documents: Default::default(),
            link: link(1, false, "the machine has not answered yet"),
            is_up: false,
        }
    }

    /// The connection, to wait for it.
    pub(crate) fn socket(&self) -> Option<&OperatorSocket> {
        self.socket.as_ref()
    }

    /// What pages want beyond the usual.
    pub(crate) fn set_wanted(&mut self, wanted: BTreeSet<String>) {
        self.wanted = wanted;
    }

    /// Takes in what came, asks what is due, and returns the answers to stops.
    pub(crate) fn turn(&mut self, now: Nanos) -> Vec<StopAnswer> {
        if self.socket.is_none() && now >= self.next_attempt {
            self.connect(now);
        }
        let mut stops = Vec::new();
        match self.exchange(now, &mut stops) {
            Ok(()) if !self.is_up || now - self.heard < SILENCE_MAX => {}
            Ok(()) => self.drop_link("the machine does not answer"),
            Err(_) => self.drop_link("the machine has gone; its run has ended, or its service"),
        }
        stops
    }

    fn connect(&mut self, now: Nanos) {
        self.next_attempt = now + RETRY_INTERVAL;
        let Ok(mut socket) = OperatorSocket::connect(&self.path) else { return };
        let asked = QUESTIONS.iter().try_for_each(|word| socket.send(&question(word)));
        if asked.is_ok() {
            self.socket = Some(socket);
            (self.heard, self.next_status) = (now, now + STATUS_INTERVAL);
            self.next_parameters = now + PARAMETERS_INTERVAL;
            self.watched.clear();
        }
    }

    fn exchange(&mut self, now: Nanos, stops: &mut Vec<StopAnswer>) -> std::io::Result<()> {
        while let Some(socket) = &mut self.socket {
            let Some(line) = socket.receive()? else { break };
            self.heard = now;
            self.take_in(&line, stops);
        }
        self.ask_what_is_due(now)
    }

    fn ask_what_is_due(&mut self, now: Nanos) -> std::io::Result<()> {
        let Some(socket) = &mut self.socket else { return Ok(()) };
        socket.flush()?;
        if now >= self.next_status {
            self.next_status = now + STATUS_INTERVAL;
            socket.send(&question("status"))?;
        }
        if now >= self.next_parameters {
            self.next_parameters = now + PARAMETERS_INTERVAL;
            socket.send(&question("parameters"))?;
        }
        let words = watch_words(&self.signals, &self.wanted);
        if !words.is_empty() && words != self.watched {
            socket.send(&json!({ "id": "watch", "say": words }).to_string())?;
            self.watched = words;
        }
        Ok(())
    }

    fn take_in(&mut self, line: &str, stops: &mut Vec<StopAnswer>) {
        if !self.is_up {
            self.is_up = true;
            self.link = link(self.link.version + 1, true, "");
        }
        if line.starts_with("{\"event\":\"watch\"") {
            self.values.version += 1;
            line.clone_into(&mut self.values.text);
            return;
        }
        let Ok(mut answer) = serde_json::from_str::<Value>(line) else { return };
        let id = answer["id"].as_str().unwrap_or_default().to_owned();
        if let Some(stop) = stop_answer(&id, &mut answer) {
            stops.push(stop);
            return;
        }
        let Some(at) = QUESTIONS.iter().position(|word| *word == id) else { return };
        if answer["outcome"] != "ok" {
            return;
        }
        let data = answer["data"].take();
        let document = &mut self.documents[at];
        let text = json!({ "event": QUESTIONS[at], "data": data }).to_string();
        if at == STATUS_INDEX || document.text != text {
            document.version += 1;
            document.text = text;
        }
        if QUESTIONS[at] == "signals" {
            self.signals = data_of(&document.text);
        }
    }

    fn drop_link(&mut self, why: &str) {
        self.socket = None;
        if self.is_up {
            self.is_up = false;
            self.link = link(self.link.version + 1, false, why);
        }
    }

    /// Says `stop` for a page, which came at `now`; false when the machine is not there.
    pub(crate) fn stop(&mut self, page: u64, id: u64, now: Nanos) -> bool {
        let Some(socket) = &mut self.socket else { return false };
        let id = format!("stop {page} {id} {}", now.0);
        socket.send(&json!({ "id": id, "say": "stop" }).to_string()).is_ok()
    }

    /// Asks for the parameters now: one was set.
    pub(crate) fn refresh_parameters(&mut self) {
        self.next_parameters = Nanos::ZERO;
    }

    /// Whether the machine is there.
    #[cfg(feature = "foxglove")]
    pub(crate) fn is_up(&self) -> bool {
        self.is_up
    }

    /// What the machine answered to a question; null before it has.
    #[cfg(feature = "foxglove")]
    pub(crate) fn data(&self, question: usize) -> Value {
        data_of(&self.documents[question].text)
    }

    /// Whether a signal, a field or an element is there.
    pub(crate) fn has_signal(&self, path: &str) -> bool {
        has_path(&self.signals, path)
    }
}

fn question(word: &str) -> String {
    json!({ "id": word, "say": word }).to_string()
}

fn link(version: u64, is_up: bool, why: &str) -> Document {
    let text = json!({ "event": "link", "up": is_up, "text": why }).to_string();
    Document { version, text }
}

fn data_of(event: &str) -> Value {
    serde_json::from_str::<Value>(event).map(|mut event| event["data"].take()).unwrap_or_default()
}

/// The answer to a stop of a page, under the number of the page. Among its values stands `page_ns`,
/// the instant at which the stop came here, on the clock of the machine's own instants.
fn stop_answer(id: &str, answer: &mut Value) -> Option<StopAnswer> {
    let mut words = id.split(' ');
    if words.next() != Some("stop") {
        return None;
    }
    let (page, number) = (words.next()?.parse().ok()?, words.next()?.parse::<u64>().ok()?);
    answer["id"] = json!(number);
    if let (Some(came), Some(data)) = (words.next(), answer["data"].as_object_mut()) {
        data.insert("page_ns".to_owned(), json!(came.parse::<i64>().ok()?));
    }
    Some(StopAnswer { page, text: answer.to_string() })
}

/// Whether the machine's list has a path: one that is not there would be refused with all others.
fn has_path(signals: &Value, path: &str) -> bool {
    let Some(all) = signals.as_object() else { return false };
    let behind = |name: &String| {
        let rest = path.strip_prefix(name.as_str())?;
        (rest.is_empty() || rest.starts_with('.')).then_some(rest)
    };
    let found = all.iter().filter_map(|(name, fields)| Some((name, fields, behind(name)?)));
    let Some((_, fields, rest)) = found.max_by_key(|(name, ..)| name.len()) else { return false };
    let Some(rest) = rest.strip_prefix('.') else { return true };
    let (name, index) = match rest.split_once('[') {
        None => (rest, None),
        Some((name, index)) => (name, Some(index)),
    };
    let mut fields = fields.as_array().into_iter().flatten();
    let Some(field) = fields.find(|field| field["name"] == name) else { return false };
    let Some(index) = index else { return true };
    let element = index.strip_suffix(']').and_then(|index| index.parse::<u64>().ok());
    element.is_some_and(|at| at < field["count"].as_u64().unwrap_or(0))
}

/// The words that ask for what every page shows, as far as this machine has it, and for what pages
/// want beyond that.
fn watch_words(signals: &Value, wanted: &BTreeSet<String>) -> String {
    let Some(all) = signals.as_object() else { return String::new() };
    let has = |signal: &str, field: &str| {
        let fields = all.get(signal).and_then(Value::as_array);
        fields.is_some_and(|fields| fields.iter().any(|one| one["name"] == field))
    };
    let mut paths: Vec<String> = Vec::new();
    for (signal, field) in [
        ("sense.joints", "q_rad"),
        ("setpoint.desired", "q_rad"),
        ("actuate.applied", "tau_nm"),
        ("world.truth", "t_ns"),
        ("world.object", "normal_n"),
    ] {
        if has(signal, field) {
            let is_whole = signal.starts_with("world.");
            paths.push(if is_whole { signal.into() } else { format!("{signal}.{field}") });
        }
    }
    for signal in all.keys() {
        if has(signal, "rows") && has(signal, "cols") && signal.ends_with(".image") {
            let fields =
                ["counts", "valid", "rows", "cols"].map(|field| format!("{signal}.{field}"));
            paths.extend(fields);
        }
        if has(signal, "x_c") && has(signal, "theta_z_rad") {
            paths.push(signal.clone());
        }
        if signal.starts_with("wrist_scan.") && has(signal, "force_n") {
            paths.push(signal.clone());
        }
    }
    paths.truncate(WATCHED_MAX / 2);
    for path in wanted {
        if paths.len() < WATCHED_MAX && !paths.contains(path) {
            paths.push(path.clone());
        }
    }
    if paths.is_empty() {
        String::new()
    } else {
        format!("watch {WATCH_RATE_HZ} {}", paths.join(" "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_this_machine_has_is_watched_and_what_pages_want_comes_behind() {
        let fields = |names: &[&str]| -> Value {
            names
                .iter()
                .map(|name| json!({ "name": name, "type": "float64", "count": 1 }))
                .collect()
        };
        let signals = json!({
            "sense.joints": fields(&["q_rad"]),
            "tactile_scan.image": fields(&["rows", "cols", "counts"]),
            "tactile_servo.features": fields(&["x_c", "theta_z_rad"]),
            "servo.state": fields(&["task"]),
        });
        let wanted = BTreeSet::from(["servo.health.jobs".to_owned()]);
        assert_eq!(
            watch_words(&signals, &wanted),
            "watch 32 sense.joints.q_rad tactile_scan.image.counts tactile_scan.image.valid \
             tactile_scan.image.rows tactile_scan.image.cols tactile_servo.features \
             servo.health.jobs"
        );
        assert_eq!(watch_words(&Value::Null, &wanted), "");
        for path in ["servo.state", "servo.state.task", "servo.state.task[0]"] {
            assert!(has_path(&signals, path), "{path}");
        }
        for path in
            ["servo", "servo.stat", "servo.state.t", "servo.state.task[1]", "servo.state.task["]
        {
            assert!(!has_path(&signals, path), "{path}");
        }
        let many: BTreeSet<String> = (0..100).map(|i| format!("a.b[{i}]")).collect();
        let words = watch_words(&signals, &many);
        assert_eq!(words.split(' ').count(), 2 + WATCHED_MAX);
    }

    #[test]
    fn an_answer_to_a_stop_goes_to_the_page_that_said_it_under_its_own_number() {
        let data = json!({ "received_ns": 11 });
        let mut answer =
            json!({ "id": "stop 3 41 9", "outcome": "ok", "text": "START", "data": data });
        let stop = stop_answer("stop 3 41 9", &mut answer).unwrap();
        assert_eq!(stop.page, 3);
        let told: Value = serde_json::from_str(&stop.text).unwrap();
        let data = json!({ "received_ns": 11, "page_ns": 9 });
        assert_eq!(told, json!({ "id": 41, "outcome": "ok", "text": "START", "data": data }));
        assert!(stop_answer("status", &mut json!({})).is_none());
    }
}
