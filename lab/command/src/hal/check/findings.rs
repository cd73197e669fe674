//! What a check found, promise by promise, and the verdict.

use serde_json::{Value, json};

/// How something stands to its promise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    /// It keeps it.
    Good,
    /// It was only looked at, or could not be judged.
    Noted,
    /// It does not.
    Bad,
}

impl Outcome {
    pub(super) fn of(good: bool) -> Outcome {
        if good { Outcome::Good } else { Outcome::Bad }
    }

    fn name(self) -> &'static str {
        match self {
            Outcome::Good => "good",
            Outcome::Noted => "note",
            Outcome::Bad => "BAD",
        }
    }
}

/// One line of the report.
#[derive(Clone, Debug)]
pub(super) struct Finding {
    /// What it is about: a half, an array, a channel, a joint.
    pub(super) about: String,
    pub(super) outcome: Outcome,
    /// What was seen, with the promise beside it.
    pub(super) text: String,
    /// What to do about it; empty for what is good.
    pub(super) remedy: String,
}

/// All findings.
#[derive(Clone, Debug, Default)]
pub(super) struct Findings(pub(super) Vec<Finding>);

impl Findings {
    pub(super) fn add(
        &mut self,
        about: impl Into<String>,
        outcome: Outcome,
        text: impl Into<String>,
        remedy: &str,
    ) {
        let remedy = if outcome == Outcome::Bad { remedy.to_owned() } else { String::new() };
        self.0.push(Finding { about: about.into(), outcome, text: text.into(), remedy });
    }

    pub(super) fn is_good(&self) -> bool {
        self.0.iter().all(|finding| finding.outcome != Outcome::Bad)
    }

    /// A line for each, and the verdict.
    pub(super) fn text(&self) -> String {
        let mut text = String::new();
        for Finding { about, outcome, text: seen, remedy } in &self.0 {
            text += &format!("{:<4}  {about:<18} {seen}\n", outcome.name());
            if !remedy.is_empty() {
                text += &format!("{:<25}= {remedy}\n", "");
            }
        }
        let bad = self.0.iter().filter(|finding| finding.outcome == Outcome::Bad).count();
        text + &match bad {
            0 => "verdict: good\n".to_owned(),
            1 => "verdict: BAD, one thing is out of its promise\n".to_owned(),
            count => format!("verdict: BAD, {count} things are out of their promise\n"),
        }
    }

    pub(super) fn as_json(&self) -> Value {
        let one = |finding: &Finding| {
            json!({
                "about": finding.about,
                "outcome": finding.outcome.name().to_lowercase(),
                "found": finding.text,
                "remedy": finding.remedy,
            })
        };
        let all: Vec<Value> = self.0.iter().map(one).collect();
        json!({ "good": self.is_good(), "findings": all })
    }
}
