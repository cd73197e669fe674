//! What each task took against what it declared, and a budget to declare. Refuses to take a virtual
//! machine's longest stall for the task's own time: there the suggestion goes by a percentile.

use std::fmt::Write;

use serde_json::{Value, json};
use taktil_rtcore::Figures;

use super::summary::percentiles_us;

/// From so many steps on, one stall of a host in a thousand does not decide the suggestion.
const ENOUGH_STEPS: u64 = 10_000;
/// Tasks on one line of the table.
const PER_LINE: usize = 4;

/// The tasks of a lane; an empty list when they were not timed.
pub fn json(lane: &Figures, representative: bool) -> Value {
    let task = |task: &taktil_rtcore::TaskFigures| {
        let (basis_ns, from) = if representative {
            (task.execution_ns.max(), "max x 1.5")
        } else if task.execution_ns.len() < ENOUGH_STEPS {
            (task.execution_ns.value_at_quantile(0.99), "p99 x 1.5")
        } else {
            (task.execution_ns.value_at_quantile(0.999), "p99.9 x 1.5")
        };
        let measured = !task.execution_ns.is_empty();
        json!({
            "name": task.name,
            "budget_us": task.budget.map(|budget| budget.0 / 1000),
            "exec_us": percentiles_us(&task.execution_ns),
            "suggested_us": measured.then(|| suggested_us(basis_ns)),
            "suggested_from": from,
        })
    };
    Value::Array(lane.tasks.iter().map(task).collect())
}

/// Half as much again, in whole microseconds, rounded up.
fn suggested_us(ns: u64) -> u64 {
    ns.saturating_mul(3).div_ceil(2000).max(1)
}

/// The lines under a lane of the closing table: all tasks, then those that took more than declared.
pub fn lines(out: &mut String, lane: &Value, mark: &str) {
    let tasks = lane["tasks"].as_array().map_or(&[][..], Vec::as_slice);
    let number = |value: &Value| value.as_f64().map_or_else(|| "-".into(), |n| format!("{n:.1}"));
    for (index, row) in tasks.chunks(PER_LINE).enumerate() {
        let each: Vec<String> = row
            .iter()
            .map(|task| {
                let name = task["name"].as_str().unwrap_or("-");
                let p99 = number(&task["exec_us"]["p99"]);
                let budget = task["budget_us"].as_i64();
                format!("{name} {p99} of {}", budget.map_or("-".into(), |us| us.to_string()))
            })
            .collect();
        let head = if index == 0 { "p99 of budget us" } else { "" };
        let _ = writeln!(out, "    {head:<16}  {}", each.join(", "));
    }
    for task in tasks {
        let (longest, budget) = (task["exec_us"]["max"].as_f64(), task["budget_us"].as_f64());
        if let (Some(longest), Some(budget)) = (longest, budget)
            && longest > budget
        {
            let _ = writeln!(
                out,
                "    over budget: {} {longest:.1} of {budget} us{mark}; suggested {} ({})",
                task["name"].as_str().unwrap_or("-"),
                task["suggested_us"],
                task["suggested_from"].as_str().unwrap_or("-"),
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn suggestions_are_rounded_up_and_never_nothing() {
        assert_eq!(suggested_us(0), 1);
        assert_eq!(suggested_us(10_000), 15);
        assert_eq!(suggested_us(10_001), 16);
        assert_eq!(suggested_us(u64::MAX), u64::MAX.div_ceil(2000));
    }

    #[test]
    fn the_table_names_who_took_too_long_and_nobody_else() {
        let task = |name: &str, max: f64| {
            json!({
                "name": name, "budget_us": 20, "exec_us": {"p99": 3.25, "max": max},
                "suggested_us": 7, "suggested_from": "p99.9 x 1.5",
            })
        };
        let lane = json!({ "tasks": [task("sense", 20.0), task("actuate", 20.1)] });
        let mut out = String::new();
        lines(&mut out, &lane, " *");
        assert!(out.contains("sense 3.2 of 20, actuate 3.2 of 20"), "{out}");
        assert!(!out.contains("over budget: sense"), "{out}");
        assert!(out.contains("over budget: actuate 20.1 of 20 us *; suggested 7 (p99.9 x 1.5)"));
        let mut untimed = String::new();
        lines(&mut untimed, &json!({ "tasks": [] }), "");
        lines(&mut untimed, &json!({}), "");
        assert_eq!(untimed, "");
    }
}
