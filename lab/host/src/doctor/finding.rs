//! One row of the doctor's answer: the expectation, the finding, its severity and the remedy.
//! Control characters are replaced, because the text of a file goes to a terminal and into a
//! script.

use serde_json::{Value, json};

/// Longest text of a cell in characters.
const CELL_CHARACTERS_MAX: usize = 200;

/// Severity for motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Required for any motion.
    High,
    /// Visible in the worst latencies.
    Medium,
    /// Information only.
    Low,
}

impl Severity {
    /// The severity as text.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Severity::High => "high",
            Severity::Medium => "medium",
            Severity::Low => "low",
        }
    }
}

/// The verdict of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// As expected.
    Ok,
    /// Worse than expected; motion is possible.
    Warn,
    /// Not fit for motion.
    Bad,
    /// The check could not be made.
    Unknown,
}

impl Verdict {
    /// The verdict as text.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Verdict::Ok => "ok",
            Verdict::Warn => "warn",
            Verdict::Bad => "bad",
            Verdict::Unknown => "unknown",
        }
    }
}

/// A remedy: commands for a root shell, and parameters of the kernel's command line.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Fix {
    /// Commands, each a line of `sh`. They never contain text that was read from the host.
    pub commands: Vec<String>,
    /// Boot parameters.
    pub boot: Vec<String>,
}

impl Fix {
    /// A remedy of commands only.
    pub fn run<S: Into<String>>(commands: impl IntoIterator<Item = S>) -> Fix {
        Fix { commands: commands.into_iter().map(Into::into).collect(), boot: Vec::new() }
    }

    /// A remedy of boot parameters only.
    pub fn boot<S: Into<String>>(parameters: impl IntoIterator<Item = S>) -> Fix {
        Fix { commands: Vec::new(), boot: parameters.into_iter().map(Into::into).collect() }
    }
}

/// The result of one check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Row {
    /// The checked property.
    pub name: &'static str,
    /// The expectation.
    pub expectation: String,
    /// The finding.
    pub found: String,
    /// The severity for motion.
    pub severity: Severity,
    /// The verdict.
    pub verdict: Verdict,
    /// The remedy as a sentence; empty when all is well.
    pub remedy: String,
    /// The remedy for a shell.
    pub fix: Fix,
}

impl Row {
    /// A check that has not been made.
    #[must_use]
    pub fn new(name: &'static str, severity: Severity, expectation: &str) -> Row {
        Row {
            name,
            expectation: expectation.to_owned(),
            found: String::new(),
            severity,
            verdict: Verdict::Unknown,
            remedy: String::new(),
            fix: Fix::default(),
        }
    }

    fn with(mut self, verdict: Verdict, found: &str, remedy: &str) -> Row {
        self.verdict = verdict;
        self.found = printable_text(found);
        self.remedy = printable_text(remedy);
        self
    }

    /// Sets the verdict "as expected".
    #[must_use]
    pub fn ok(self, found: impl AsRef<str>) -> Row {
        self.with(Verdict::Ok, found.as_ref(), "")
    }

    /// Sets the verdict "worse than expected".
    #[must_use]
    pub fn warn(self, found: impl AsRef<str>, remedy: impl AsRef<str>) -> Row {
        self.with(Verdict::Warn, found.as_ref(), remedy.as_ref())
    }

    /// Sets the verdict "not fit for motion".
    #[must_use]
    pub fn bad(self, found: impl AsRef<str>, remedy: impl AsRef<str>) -> Row {
        self.with(Verdict::Bad, found.as_ref(), remedy.as_ref())
    }

    /// Sets the verdict "unknown"; `found` is the reason.
    #[must_use]
    pub fn unknown(self, found: impl ToString) -> Row {
        self.with(Verdict::Unknown, &found.to_string(), "")
    }

    /// Adds commands or boot parameters.
    #[must_use]
    pub fn fix(mut self, fix: Fix) -> Row {
        self.fix = fix;
        self
    }

    /// The row as a JSON object.
    #[must_use]
    pub fn json(&self) -> Value {
        json!({
            "name": self.name,
            "expectation": self.expectation,
            "found": self.found,
            "severity": self.severity.word(),
            "verdict": self.verdict.word(),
            "remedy": self.remedy,
        })
    }
}

/// The text as one line of printable characters, of bounded length.
fn printable_text(text: &str) -> String {
    let printable = |c: char| if c.is_control() || c == '\u{fffd}' { '?' } else { c };
    let mut out: String = text.trim().chars().take(CELL_CHARACTERS_MAX).map(printable).collect();
    if text.trim().chars().count() > CELL_CHARACTERS_MAX {
        out.push_str("...");
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_of_a_file_cannot_leave_its_cell() {
        let row = Row::new("x", Severity::Low, "").ok("a\nrm -rf\u{1b}[2J\0");
        assert_eq!(row.found, "a?rm -rf?[2J?");
        let long = Row::new("x", Severity::Low, "").unknown("y".repeat(5000));
        assert_eq!(long.found.chars().count(), CELL_CHARACTERS_MAX + 3);
    }
}
