//! The task that is checked, with all that its scene says about it: lane, budget, section, arm, and
//! the signals that its inputs read.

use std::collections::BTreeMap;

use taktil_lab_scene::scene::Scene;
use taktil_machine::own::{OwnTask, Section};
use taktil_machine::robot::AnyRobot;
use taktil_machine_console::option::BadOption;
use taktil_rtcore::harness::Harness;
use taktil_rtcore::payload::Field;
use taktil_rtcore::{Invalid, LaneSpec, Machine, Nanos};

/// The task that is checked.
pub(crate) struct TaskUnderTest {
    task: &'static OwnTask,
    section: Section,
    pub(crate) robot: AnyRobot,
    /// The lane that runs it.
    pub(crate) lane: LaneSpec,
    /// Fields of the signal that each input reads, by the name of the input.
    signals: BTreeMap<String, Vec<Field>>,
}

impl TaskUnderTest {
    /// The task `task` of a scene whose machine was built.
    ///
    /// # Errors
    /// A task that no lane of the machine runs.
    pub(crate) fn new(
        scene: &Scene,
        machine: &Machine,
        task: &'static OwnTask,
    ) -> Result<TaskUnderTest, BadOption> {
        let mut lanes = machine.figures().map(|(spec, _)| spec).zip(machine.task_names());
        let Some((lane, _)) = lanes.find(|(_, tasks)| tasks.contains(&task.name)) else {
            let (name, file) = (task.name, scene.source.path.display());
            let what = format!("no lane of {file} runs the task `{name}`");
            return Err(BadOption(format!("{what}; add [robot.insert.{name}]")));
        };
        let catalog = machine.catalog();
        let prefix = format!("{}.", task.name);
        let mut signals = BTreeMap::new();
        for (input, signal) in &scene.machine.wiring {
            let input = input.strip_prefix(&prefix);
            if let (Some(input), Some(number)) = (input, catalog.find(signal)) {
                signals.insert(input.to_owned(), catalog.signals[number].fields.to_vec());
            }
        }
        Ok(TaskUnderTest {
            task,
            section: scene.machine.own.get(task.name).cloned().unwrap_or_default(),
            robot: scene.robot.clone(),
            lane: lane.clone(),
            signals,
        })
    }

    /// Its name.
    pub(crate) fn name(&self) -> &'static str {
        self.task.name
    }

    /// The declared longest processor time of a step.
    pub(crate) fn budget(&self) -> Option<Nanos> {
        self.lane.budgets.get(self.task.name).copied()
    }

    fn length(&self, input: &str, field: &str) -> Option<usize> {
        let fields = self.signals.get(input)?;
        fields.iter().find(|known| known.name == field).map(|known| known.count)
    }

    /// Builds the task anew.
    ///
    /// # Errors
    /// What the task refuses.
    pub(crate) fn build(&self) -> Result<Harness, Invalid> {
        let make = |ports: &mut _| (self.task.make)(&self.section, &self.robot, ports);
        Harness::new(&|input, field| self.length(input, field), make)
    }

    /// Takes back what was given to the task, which stays as it is.
    ///
    /// # Errors
    /// As [`TaskUnderTest::build`].
    pub(crate) fn clear_inputs(&self, harness: &mut Harness) -> Result<(), Invalid> {
        harness.clear_inputs(&|input, field| self.length(input, field))
    }
}
