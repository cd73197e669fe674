//! Answers and events, as lines of words or of JSON. A request in words is answered in words, one
//! in JSON under its own number.

use serde_json::{Value, json};

/// The outcome of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// Done, or on its way.
    Ok,
    /// Understood and not done.
    Refused,
    /// Not answered by the machine.
    Error,
}

impl Outcome {
    fn name(self) -> &'static str {
        match self {
            Outcome::Ok => "ok",
            Outcome::Refused => "refused",
            Outcome::Error => "error",
        }
    }
}

/// An answer before it becomes a line.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Answer {
    pub(crate) outcome: Outcome,
    /// A sentence for people; may be empty.
    pub(crate) text: String,
    /// Values for programs.
    pub(crate) data: Option<Value>,
}

impl Answer {
    /// Done, with a sentence.
    pub(crate) fn ok(text: impl Into<String>) -> Answer {
        Answer { outcome: Outcome::Ok, text: text.into(), data: None }
    }

    /// Done, with values.
    pub(crate) fn data(data: Value) -> Answer {
        Answer { outcome: Outcome::Ok, text: String::new(), data: Some(data) }
    }

    /// Refused, with the reason.
    pub(crate) fn refused(text: impl Into<String>) -> Answer {
        Answer { outcome: Outcome::Refused, text: text.into(), data: None }
    }

    /// Not answered by the machine, with the reason.
    pub(crate) fn error(text: impl Into<String>) -> Answer {
        Answer { outcome: Outcome::Error, text: text.into(), data: None }
    }

    /// The same with values added.
    pub(crate) fn with(mut self, data: Value) -> Answer {
        self.data = Some(data);
        self
    }

    /// The line for a request with this number; `None` is a request in words.
    pub(crate) fn line(&self, id: Option<&Value>) -> String {
        let Some(id) = id else {
            let word = if self.outcome == Outcome::Ok { "ok" } else { self.outcome.name() };
            let colon = if self.outcome == Outcome::Ok { "" } else { ":" };
            let space = if self.text.is_empty() { "" } else { " " };
            let data = match &self.data {
                Some(data) if self.text.is_empty() => format!(" {data}"),
                _ => String::new(),
            };
            return format!("{word}{colon}{space}{}{data}\n", single_line(&self.text));
        };
        let mut line = json!({ "id": id, "outcome": self.outcome.name() });
        if !self.text.is_empty() {
            line["text"] = json!(single_line(&self.text));
        }
        if let Some(data) = &self.data {
            line["data"] = data.clone();
        }
        format!("{line}\n")
    }
}

/// The line of an event for a client that speaks in words or in JSON.
pub(crate) fn event_line(event: &Value, is_json: bool) -> String {
    if is_json { format!("{event}\n") } else { format!("event {event}\n") }
}

/// The text without line ends and other control characters, which would end the line or reach a
/// terminal.
fn single_line(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_answered_in_words_and_numbers_under_their_number() {
        assert_eq!(Answer::ok("").line(None), "ok\n");
        assert_eq!(Answer::ok("START").line(None), "ok START\n");
        assert_eq!(Answer::refused("no").line(None), "refused: no\n");
        assert_eq!(Answer::data(json!({ "a": 1 })).line(None), "ok {\"a\":1}\n");
        let id = json!(7);
        let line = Answer::refused("no\n\u{1b}[2J").line(Some(&id));
        let read: Value = serde_json::from_str(&line).unwrap();
        assert_eq!(read, json!({ "id": 7, "outcome": "refused", "text": "no  [2J" }));
        assert_eq!(line.matches('\n').count(), 1);
    }
}
