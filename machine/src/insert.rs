//! Tasks that are added to a lane that another file describes: a scene adds one task to a machine
//! without repeating the lane.

use std::collections::BTreeMap;

use serde::Deserialize;
use taktil_rtcore::Invalid;

taktil_rtcore::explained! {
    /// A task that is added to a lane.
    #[derive(Clone, Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct InsertConfig {
        /// Name of the lane.
        pub lane: String,
        /// Task of that lane directly before which it runs.
        pub before: Option<String>,
        /// Task of that lane directly after which it runs, instead of `before`.
        pub after: Option<String>,
        /// Longest processor time of one step, us; needed where the lane's other tasks declare
        /// theirs.
        pub budget_us: Option<i64>,
    }
}

/// The tasks of a lane, and the budgets that they declare (us).
#[derive(Debug)]
pub(crate) struct LaneTasks<'a> {
    pub(crate) name: &'a str,
    pub(crate) tasks: &'a mut Vec<String>,
    pub(crate) budget_us: &'a mut BTreeMap<String, i64>,
}

impl InsertConfig {
    /// Puts the task `name` into the lane.
    ///
    /// # Errors
    /// A neighbour that does not exist, is not given or given twice; a budget that is missing.
    pub(crate) fn insert(self, name: &str, lane: LaneTasks<'_>) -> Result<(), Invalid> {
        let InsertConfig { before, after, budget_us, .. } = self;
        let (key, neighbour, offset) = match (before, after) {
            (Some(task), None) => ("before", task, 0),
            (None, Some(task)) => ("after", task, 1),
            _ => {
                let what = "needs one of `before` and `after`";
                return Err(Invalid::new("", what, "name the task next to which it runs"));
            }
        };
        let LaneTasks { name: lane_name, tasks, budget_us: budgets } = lane;
        let Some(at) = tasks.iter().position(|task| *task == neighbour) else {
            let what = format!("lane `{lane_name}` has no task `{neighbour}`");
            let remedy = format!("its tasks are: {}", tasks.join(", "));
            return Err(Invalid::new(key, what, remedy));
        };
        match budget_us {
            Some(us) => {
                budgets.insert(name.to_owned(), us);
            }
            None if budgets.is_empty() => {}
            None => {
                let what = format!(
                    "declares no budget, and lane `{lane_name}` is analysed by those of its tasks"
                );
                let remedy = "add `budget_us`, the longest processor time of one step in us";
                return Err(Invalid::new("", what, remedy));
            }
        }
        tasks.insert(at + offset, name.to_owned());
        Ok(())
    }
}
