//! Reads the file of a touch task that a scene or its machine file names. What is wrong in it is
//! located in that file.

use std::path::Path;

use taktil_machine::config::MachineConfig;
use taktil_machine::source::{Located, Source};
use taktil_rtcore::Invalid;
use taktil_tasks_tactile_servo::config::phases::TouchTask;

use super::SceneFile;
use super::recorded::Read;

/// Reads the task that the machine names into its configuration; returns the name of the file from
/// the scene's folder, and the file. A task that the machine file names lies beside that file.
/// `locate` puts an error about the section at its place.
pub(super) fn fill(
    machine: &mut MachineConfig,
    file: &SceneFile,
    read: Read<'_>,
    locate: &dyn Fn(Invalid) -> Located,
) -> Result<Option<(String, Source)>, Located> {
    let Some(servo) = &mut machine.tactile_servo else { return Ok(None) };
    let Some(name) = servo.task_file.clone() else { return Ok(None) };
    if servo.phases.is_some() {
        let what = "stands beside a task that is written out";
        return Err(locate(Invalid::new("tactile_servo.task_file", what, "give one of the two")));
    }
    let namer = file.machine.as_deref().filter(|_| file.robot.tactile_servo.is_none());
    let folder = namer.and_then(|machine| Path::new(machine).parent());
    let name = folder.unwrap_or(Path::new("")).join(name).display().to_string();
    let source = read(&name).map_err(|what| {
        let remedy = "name a task by its path from the folder of the file in which this stands";
        locate(Invalid::new("tactile_servo.task_file", what, remedy))
    })?;
    let task: TouchTask = source.parse()?;
    // The servo's other keys are checked with it, each where it stands.
    if servo.clone().resolved().is_ok() {
        servo.phases = Some(task.clone());
        task.check(servo).map_err(|bad| source.locate(bad))?;
    }
    servo.phases = Some(task);
    Ok(Some((name, source)))
}
