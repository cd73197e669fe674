//! The lines below a lane of the closing table: the time of its tasks compared with their declared
//! budgets.

use std::fmt::Write;

use taktil_record::summary::{LaneSummary, TaskSummary};

/// Tasks on one line of the table.
const TASKS_PER_LINE: usize = 4;

/// Appends all tasks of a lane, then those that exceeded their budgets. `mark` follows times that
/// are not representative.
pub(super) fn append_tasks(out: &mut String, lane: &LaneSummary, mark: &str) {
    for (index, row) in lane.tasks.chunks(TASKS_PER_LINE).enumerate() {
        let each: Vec<String> = row.iter().map(p99_of_budget).collect();
        let head = if index == 0 { "p99 of budget us" } else { "" };
        let _ = writeln!(out, "    {head:<16}  {}", each.join(", "));
    }
    for task in &lane.tasks {
        #[expect(clippy::cast_precision_loss, reason = "microseconds of a step")]
        let budget_us = task.budget_us.map(|us| us as f64);
        let longest_us = task.exec_us.max;
        if let Some(budget_us) = budget_us
            && longest_us > budget_us
        {
            let suggested = task.suggested_us.map_or("-".into(), |us| us.to_string());
            let (name, from) = (&task.name, &task.suggested_from);
            let _ = writeln!(
                out,
                "    over budget: {name} {longest_us:.1} of {budget_us} us{mark}; suggested \
                 {suggested} ({from})"
            );
        }
    }
}

fn p99_of_budget(task: &TaskSummary) -> String {
    let budget = task.budget_us.map_or("-".into(), |us| us.to_string());
    format!("{} {:.1} of {budget}", task.name, task.exec_us.p99)
}

#[cfg(test)]
mod tests {
    use taktil_record::summary::Percentiles;

    use super::*;

    #[test]
    fn the_table_names_tasks_over_their_budget_and_no_others() {
        let task = |name: &str, max: f64| TaskSummary {
            name: name.into(),
            budget_us: Some(20),
            exec_us: Percentiles { p99: 3.25, max, ..Percentiles::default() },
            suggested_us: Some(7),
            suggested_from: "p99.9 x 1.5".into(),
        };
        let tasks = vec![task("sense", 20.0), task("actuate", 20.1)];
        let mut out = String::new();
        append_tasks(&mut out, &LaneSummary { tasks, ..LaneSummary::default() }, " *");
        assert!(out.contains("sense 3.2 of 20, actuate 3.2 of 20"), "{out}");
        assert!(!out.contains("over budget: sense"), "{out}");
        assert!(out.contains("over budget: actuate 20.1 of 20 us *; suggested 7 (p99.9 x 1.5)"));
        let mut untimed = String::new();
        append_tasks(&mut untimed, &LaneSummary::default(), "");
        assert_eq!(untimed, "");
    }
}
