//! Reads the file of a touch task that a machine names. What is wrong in it is located in that
//! file.

use std::path::Path;

use taktil_rtcore::Invalid;
use taktil_tasks_tactile_servo::config::phases::TouchTask;

use crate::config::MachineConfig;
use crate::source::{Located, Source};

/// Key of a machine file that names a task.
const TASK_FILE_KEY: &str = "tactile_servo.task_file";

/// Reads the task that the machine names into its configuration; returns the path by which it was
/// read, and the file. `folder` is the folder of the file in which the section stands, `read`
/// returns the file of a path, `locate` puts an error about the section at its place.
///
/// # Errors
/// A task beside one that is written out, a file that cannot be read, anything wrong in it.
pub fn fill(
    machine: &mut MachineConfig,
    folder: &Path,
    read: &dyn Fn(&str) -> Result<Source, String>,
    locate: &dyn Fn(Invalid) -> Located,
) -> Result<Option<(String, Source)>, Located> {
    let Some(servo) = &mut machine.tactile_servo else { return Ok(None) };
    let Some(name) = servo.task_file.clone() else { return Ok(None) };
    if servo.phases.is_some() {
        let what = "stands beside a task that is written out";
        return Err(locate(Invalid::new(TASK_FILE_KEY, what, "give one of the two")));
    }
    let name = folder.join(name).display().to_string();
    let source = read(&name).map_err(|what| {
        let remedy = "name a task by its path from the folder of the file in which this stands";
        locate(Invalid::new(TASK_FILE_KEY, what, remedy))
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
