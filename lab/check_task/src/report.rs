//! The result of a check: what was looked for, what was done to find it, what was found and how it
//! is seen again; as a table for people and as JSON.

use std::fmt::Write;

use serde_json::{Value, json};
use taktil_rtcore::Nanos;

/// What is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Check {
    /// A heap call in a step.
    HeapCalls,
    /// A panic.
    Panics,
    /// A value that is not finite at an output.
    NotFinite,
    /// A stale or invalid value that changes what the task does.
    StaleInputs,
    /// An output out of the range that is declared for it.
    Ranges,
    /// A step that takes longer than its budget.
    Budget,
    /// A step that is another when the same inputs come again.
    Repeats,
    /// State that outlives a stop.
    Restart,
    /// Memory that each start loses.
    Leak,
}

impl Check {
    /// Every check, in the order of the table.
    pub const ALL: [Check; 9] = [
        Check::HeapCalls,
        Check::Panics,
        Check::NotFinite,
        Check::StaleInputs,
        Check::Ranges,
        Check::Budget,
        Check::Repeats,
        Check::Restart,
        Check::Leak,
    ];

    /// What it is called in the table.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Check::HeapCalls => "heap calls",
            Check::Panics => "panics",
            Check::NotFinite => "not finite",
            Check::StaleInputs => "stale inputs",
            Check::Ranges => "ranges",
            Check::Budget => "budget",
            Check::Repeats => "repeats",
            Check::Restart => "restart",
            Check::Leak => "leak",
        }
    }
}

/// The step at which something was found.
#[derive(Clone, Debug, PartialEq)]
pub struct FailedStep {
    /// Run of the plan.
    pub run: usize,
    /// The kind of its inputs.
    pub kind: &'static str,
    /// Step of the run, the first is 0.
    pub step: usize,
    /// The task's inputs at this step, one line each.
    pub inputs: Vec<String>,
}

/// What was found first.
#[derive(Clone, Debug, PartialEq)]
pub struct Failure {
    /// In one line.
    pub what: String,
    /// Where; absent when it is no single step.
    pub at: Option<FailedStep>,
    /// How often it was seen; 1 where only the first one is looked for.
    pub count: u64,
}

/// How a check ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// Nothing was found.
    Held,
    /// Something was.
    Failed(Failure),
    /// Nothing could be found, for this reason, which is no defect.
    Skipped(String),
    /// It could not be looked for, for this reason, which is to be removed.
    Unchecked(String),
}

/// One line of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckResult {
    /// What was looked for.
    pub check: Check,
    /// What was done.
    pub done: String,
    /// What was found.
    pub outcome: Outcome,
}

/// The whole result.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Name of the task.
    pub task: String,
    /// Scene, lane, ports in one line.
    pub about: String,
    /// CheckResult by line in the order of [`Check::ALL`].
    pub lines: Vec<CheckResult>,
    /// Step time that 99.9 % of the steps do not exceed.
    pub p999: Nanos,
    /// Longest step time, each step by its shortest repeat.
    pub worst: Nanos,
    /// The declared one, if any.
    pub budget: Option<Nanos>,
    /// The command line that does all of it again.
    pub again: String,
}

impl Report {
    /// The outcome of a check; none where it was left out.
    #[must_use]
    pub fn outcome(&self, check: Check) -> Option<&Outcome> {
        self.lines.iter().find(|line| line.check == check).map(|line| &line.outcome)
    }

    /// The checks that failed or could not be made.
    pub fn failed(&self) -> impl Iterator<Item = Check> {
        let bad = |line: &&CheckResult| {
            matches!(line.outcome, Outcome::Failed(_) | Outcome::Unchecked(_))
        };
        self.lines.iter().filter(bad).map(|line| line.check)
    }

    /// Whether everything was checked and nothing was found.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.failed().next().is_none()
    }

    /// The command line that repeats a failure.
    fn again(&self, failure: &Failure) -> String {
        match &failure.at {
            Some(at) => format!("{} --run {}", self.again, at.run),
            None => self.again.clone(),
        }
    }

    /// The table and the verdict.
    #[must_use]
    pub fn text(&self) -> String {
        let width = self.lines.iter().map(|line| line.done.chars().count()).max().unwrap_or(0);
        let mut out = format!("{}: {}\n", self.task, self.about);
        let _ = writeln!(out, "  {:<12}  {:<width$}  result", "check", "done");
        for CheckResult { check, done, outcome } in &self.lines {
            let result = match outcome {
                Outcome::Held => "ok".to_owned(),
                Outcome::Failed(Failure { count, .. }) if *count > 1 => {
                    format!("FAILED {count} times")
                }
                Outcome::Failed(_) => "FAILED".to_owned(),
                Outcome::Skipped(why) => why.clone(),
                Outcome::Unchecked(why) => format!("NOT CHECKED: {why}"),
            };
            let _ = writeln!(out, "  {:<12}  {done:<width$}  {result}", check.name());
        }
        let of = self.budget.map_or_else(String::new, |budget| format!(" of {budget}"));
        let _ = writeln!(out, "step time: p99.9 {}, worst {}{of}", self.p999, self.worst);
        for line in &self.lines {
            if let Outcome::Failed(failure) = &line.outcome {
                self.tell_failure(&mut out, line.check, failure);
            }
        }
        let failed: Vec<&str> = self.failed().map(Check::name).collect();
        let _ = match failed.as_slice() {
            [] => writeln!(out, "{}: sound", self.task),
            failed => writeln!(out, "{}: NOT SOUND: {}", self.task, failed.join(", ")),
        };
        out
    }

    fn tell_failure(&self, out: &mut String, check: Check, failure: &Failure) {
        let _ = writeln!(out, "FAILED {}: {}", check.name(), failure.what);
        if let Some(at) = &failure.at {
            let _ = writeln!(out, "  at step {} of run {}, {}", at.step, at.run, at.kind);
            for line in &at.inputs {
                let _ = writeln!(out, "    {line}");
            }
        }
        let _ = writeln!(out, "  again: {}", self.again(failure));
    }

    /// The same as JSON; times in us.
    #[must_use]
    pub fn json(&self) -> Value {
        let us = |span: Nanos| span.as_micros_f64();
        let line = |line: &CheckResult| {
            let (result, why) = match &line.outcome {
                Outcome::Held => ("held", None),
                Outcome::Failed(_) => ("failed", None),
                Outcome::Skipped(why) => ("skipped", Some(why)),
                Outcome::Unchecked(why) => ("unchecked", Some(why)),
            };
            let failure = match &line.outcome {
                Outcome::Failed(failure) => json!({
                    "what": failure.what,
                    "count": failure.count,
                    "run": failure.at.as_ref().map(|at| at.run),
                    "kind": failure.at.as_ref().map(|at| at.kind),
                    "step": failure.at.as_ref().map(|at| at.step),
                    "inputs": failure.at.as_ref().map(|at| &at.inputs),
                    "again": self.again(failure),
                }),
                _ => Value::Null,
            };
            json!({
                "check": line.check.name(),
                "done": line.done,
                "result": result,
                "why": why,
                "failure": failure,
            })
        };
        json!({
            "task": self.task,
            "about": self.about,
            "checks": self.lines.iter().map(line).collect::<Vec<_>>(),
            "step_p999_us": us(self.p999),
            "step_worst_us": us(self.worst),
            "budget_us": self.budget.map(us),
            "again": self.again,
            "sound": self.is_sound(),
        })
    }
}
