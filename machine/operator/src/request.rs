//! A line of a client as a request. A line is words, or a JSON object with a number and words:
//! `{"id": 7, "say": "move by 0 0 5"}`.

use serde_json::Value;
use taktil_machine::operator::command::{CommandContext, OperatorCommand, parse};
use taktil_rtcore::Invalid;
use taktil_signal::Verb;

use crate::scope::ScopeRequest;
use crate::words::{finite, shortened};

/// Longest line in words (bytes).
pub(crate) const WORDS_BYTES_MAX: usize = 1024;
/// Longest line (bytes).
pub(crate) const LINE_BYTES_MAX: usize = 1 << 16;
/// Deepest nesting of a JSON line.
const DEPTH_MAX: usize = 8;
/// Longest text that may number a request (characters).
const ID_CHARACTERS_MAX: usize = 64;
/// Largest number of signals that one `watch` may name.
const WATCHED_MAX: usize = 32;
/// Fastest rate of `watch` (Hz).
pub(crate) const WATCH_RATE_MAX_HZ: f64 = 100.0;

/// What a client asks for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Word {
    /// A command for the machine, or a question about its state in words.
    Machine(OperatorCommand),
    /// Everything about the machine.
    Status,
    /// The arm: its joints' frames and limits.
    Model,
    /// The signals with their fields.
    Signals,
    /// The parameters with their ranges and present values.
    Parameters,
    /// New values of parameters, all of them or none.
    Set(Vec<(String, f64)>),
    /// Signals at a rate (Hz), until the next `watch`.
    Watch { rate_hz: f64, paths: Vec<String> },
    /// No more of them.
    WatchOff,
    /// Values around an event.
    Scope(ScopeRequest),
    /// Forget what was asked for.
    ScopeOff,
    /// The latched faults.
    FaultList,
    /// Begin or end the recording.
    Record(bool),
    /// Take the control lease.
    ControlTake,
    /// Give it back.
    ControlRelease,
    /// Who has it.
    ControlState,
    /// The words.
    Help,
    /// The versions of the protocol and the program.
    Version,
}

/// A line that asks for something.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Request {
    /// The client's number, for a line of JSON.
    pub(crate) id: Option<Value>,
    pub(crate) word: Word,
}

/// A line that cannot be understood, with the number under which to say so.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Unreadable {
    pub(crate) id: Option<Value>,
    pub(crate) why: Invalid,
}

/// Reads a line; `None` for an empty one and a comment.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn read(line: &str, context: &CommandContext) -> Result<Option<Request>, Unreadable> {
    let (id, words) = split_number(line)?;
    match read_words(&words, context) {
        Ok(word) => Ok(word.map(|word| Request { id, word })),
        Err(why) => Err(Unreadable { id, why }),
    }
}

/// Whether a line says `stop`, in words or in JSON, whatever the client has said before.
pub(crate) fn is_stop(line: &str) -> bool {
    let Ok((_, words)) = split_number(line) else { return false };
    let mut words = words.split('#').next().unwrap_or_default().split_whitespace();
    words.next() == Some(Verb::Stop.name()) && words.next().is_none()
}

/// The number and the words of a line.
fn split_number(line: &str) -> Result<(Option<Value>, String), Unreadable> {
    let unnumbered = |what: String, remedy: &str| {
        let why = Invalid::new("", what, remedy);
        Err(Unreadable { id: None, why })
    };
    if !line.trim_start().starts_with('{') {
        if line.len() > WORDS_BYTES_MAX {
            return unnumbered("a line of more than 1024 bytes".into(), "say one thing a line");
        }
        return Ok((None, line.to_owned()));
    }
    let form = "write {\"id\": 1, \"say\": \"status\"}";
    if depth(line) > DEPTH_MAX {
        return unnumbered(format!("nested deeper than {DEPTH_MAX}"), form);
    }
    let object = match serde_json::from_str::<Value>(line) {
        Ok(Value::Object(object)) => object,
        Ok(_) => return unnumbered("no object".into(), form),
        Err(error) => return unnumbered(format!("no JSON: {error}"), form),
    };
    let id = match object.get("id") {
        Some(Value::Number(number)) if number.is_u64() => Value::Number(number.clone()),
        Some(Value::String(text)) if text.chars().count() <= ID_CHARACTERS_MAX => {
            Value::String(text.clone())
        }
        Some(_) => {
            let remedy = "number it with a whole number, or at most 64 characters";
            return unnumbered("`id` is no number of a request".into(), remedy);
        }
        None => return unnumbered("`id` is missing".into(), form),
    };
    let refuse = |what: String| {
        let why = Invalid::new("", what, form);
        Err(Unreadable { id: Some(id.clone()), why })
    };
    if let Some(other) = object.keys().find(|key| !matches!(key.as_str(), "id" | "say")) {
        return refuse(format!("there is no key `{}`", shortened(other)));
    }
    match object.get("say") {
        Some(Value::String(words)) if words.contains('\n') => refuse("two lines in `say`".into()),
        Some(Value::String(words)) if words.len() > WORDS_BYTES_MAX => {
            refuse("more than 1024 bytes in `say`".into())
        }
        Some(Value::String(words)) => Ok((Some(id), words.clone())),
        Some(_) => refuse("`say` is no text".into()),
        None => refuse("`say` is missing".into()),
    }
}

/// How deep brackets are nested outside texts; wrong for a line that is no JSON, which is refused
/// all the same.
fn depth(line: &str) -> usize {
    let (mut depth, mut deepest, mut in_text, mut escaped) = (0usize, 0, false, false);
    for byte in line.bytes() {
        match byte {
            _ if escaped => escaped = false,
            b'\\' if in_text => escaped = true,
            b'"' => in_text = !in_text,
            b'{' | b'[' if !in_text => {
                depth += 1;
                deepest = deepest.max(depth);
            }
            b'}' | b']' if !in_text => depth = depth.saturating_sub(1),
            _ => {}
        }
    }
    deepest
}

fn read_words(line: &str, context: &CommandContext) -> Result<Option<Word>, Invalid> {
    let words: Vec<&str> = line.split('#').next().unwrap_or_default().split_whitespace().collect();
    let word = match *words.as_slice() {
        ["status"] => Word::Status,
        ["model"] => Word::Model,
        ["signals"] => Word::Signals,
        ["parameters"] => Word::Parameters,
        ["set", ref pairs @ ..] => Word::Set(read_pairs(pairs)?),
        ["watch", "off"] => Word::WatchOff,
        ["watch", ref rest @ ..] => read_watch(rest)?,
        ["scope", "off"] => Word::ScopeOff,
        ["scope", ref rest @ ..] => Word::Scope(ScopeRequest::read(rest)?),
        ["fault", "list"] => Word::FaultList,
        ["fault", "reset"] => Word::Machine(OperatorCommand::Request(Verb::Reset)),
        ["record", "start"] => Word::Record(true),
        ["record", "stop"] => Word::Record(false),
        ["control", "take"] => Word::ControlTake,
        ["control", "release"] => Word::ControlRelease,
        ["control"] => Word::ControlState,
        ["help"] => Word::Help,
        ["version"] => Word::Version,
        [
            first
            @ ("fault" | "record" | "control" | "status" | "model" | "signals" | "parameters"),
            ..,
        ] => {
            let remedy = "say `help` for all words";
            return Err(Invalid::new(first, "unknown or missing words follow", remedy));
        }
        _ => return Ok(parse(line, context)?.map(Word::Machine)),
    };
    Ok(Some(word))
}

/// Names and values by turns.
fn read_pairs(words: &[&str]) -> Result<Vec<(String, f64)>, Invalid> {
    let usage = "say `set NAME VALUE`, and further names and values behind them";
    if words.is_empty() || !words.len().is_multiple_of(2) {
        return Err(Invalid::new("set", "names and values do not come in pairs", usage));
    }
    let pair = |pair: &[&str]| {
        let value = finite(pair[1]).ok_or_else(|| {
            let what = format!("`{}` is no number of use here", shortened(pair[1]));
            Invalid::new(format!("set.{}", shortened(pair[0])), what, usage)
        })?;
        Ok((pair[0].to_owned(), value))
    };
    words.chunks_exact(2).map(pair).collect()
}

fn read_watch(words: &[&str]) -> Result<Word, Invalid> {
    let usage = "say `watch 20 sense.joints supervisor.control`: a rate of at most 100 Hz, then \
                 signals or fields of them; or `watch off`";
    let bad = |what: String| Err(Invalid::new("watch", what, usage));
    let Some((rate, paths)) = words.split_first() else { return bad("nothing follows".into()) };
    let Some(rate_hz) = finite(rate).filter(|rate| (0.1..=WATCH_RATE_MAX_HZ).contains(rate)) else {
        return bad(format!("`{}` is no rate", shortened(rate)));
    };
    match paths.len() {
        0 => bad("no signal is named".into()),
        1..=WATCHED_MAX => {
            let paths = paths.iter().map(|path| (*path).to_owned()).collect();
            Ok(Word::Watch { rate_hz, paths })
        }
        more => bad(format!("{more} signals, at most {WATCHED_MAX} are sent")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn reading(line: &str) -> Result<Option<Request>, Unreadable> {
        read(line, &CommandContext::default())
    }

    #[test]
    fn a_line_is_words_or_a_numbered_object_with_words() {
        let status = |id| Request { id, word: Word::Status };
        assert_eq!(reading("status # all").unwrap(), Some(status(None)));
        let numbered = reading("{\"say\": \"status\", \"id\": 12}").unwrap();
        assert_eq!(numbered, Some(status(Some(json!(12)))));
        assert_eq!(reading("  # nothing").unwrap(), None);
        let set = reading("{\"id\":\"a\",\"say\":\"set x.y 1 z[2] -0.5\"}").unwrap().unwrap();
        assert_eq!(set.word, Word::Set(vec![("x.y".into(), 1.0), ("z[2]".into(), -0.5)]));
    }

    #[test]
    fn what_cannot_be_read_is_refused_under_its_number() {
        let deep = format!("{{\"id\":1,\"say\":{}1{}}}", "[".repeat(9), "]".repeat(9));
        let long = format!("{{\"id\":1,\"say\":\"{}\"}}", "x".repeat(1025));
        for (line, id, says) in [
            ("{", None, "no JSON"),
            ("{\"id\":1e999,\"say\":\"stop\"}", None, "no JSON"),
            ("{\"id\":-1,\"say\":\"state\"}", None, "`id` is no number"),
            ("{\"id\":[1],\"say\":\"state\"}", None, "`id` is no number"),
            ("{\"say\":\"state\"}", None, "`id` is missing"),
            ("{\"id\":1}", Some(1), "`say` is missing"),
            ("{\"id\":1,\"say\":7}", Some(1), "`say` is no text"),
            ("{\"id\":1,\"say\":\"a\\nb\"}", Some(1), "two lines"),
            ("{\"id\":1,\"say\":\"state\",\"now\":true}", Some(1), "no key `now`"),
            ("{\"id\":1,\"say\":\"fly\"}", Some(1), "no word `fly`"),
            ("{\"id\":1,\"say\":\"set a\"}", Some(1), "pairs"),
            ("{\"id\":1,\"say\":\"set a nan\"}", Some(1), "no number"),
            ("{\"id\":1,\"say\":\"watch 1000 a\"}", Some(1), "no rate"),
            ("{\"id\":1,\"say\":\"watch 10\"}", Some(1), "no signal"),
            ("{\"id\":1,\"say\":\"fault\"}", Some(1), "unknown or missing"),
            (&deep, None, "nested deeper"),
            (&long, Some(1), "more than 1024"),
        ] {
            let bad = reading(line).unwrap_err();
            assert_eq!(bad.id, id.map(|id| json!(id)), "{line}");
            assert!(bad.why.what.contains(says), "{line}: {:?}", bad.why);
            assert!(!bad.why.remedy.is_empty());
        }
    }

    #[test]
    fn a_stop_is_recognised_in_both_forms_and_in_nothing_else() {
        for line in ["stop", " stop # now", "{\"id\":1,\"say\":\"stop\"}"] {
            assert!(is_stop(line), "{line}");
        }
        for line in ["", "stopp", "stop now", "{\"id\":1,\"say\":\"status\"}", "{\"stop\":1}"] {
            assert!(!is_stop(line), "{line}");
        }
    }
}
