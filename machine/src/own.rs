//! Tasks of a program outside this repository. The program registers them at its start; lanes of
//! machine files may then run them, and `[own.NAME]` configures them. They get ports, but no
//! device. A name that occurs twice, a name of a task of this repository, and a second registration
//! are errors.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use taktil_rtcore::explain::Explain;
use taktil_rtcore::{Invalid, Ports, Task};

use crate::robot::AnyRobot;
use crate::strict;

/// The task names of this repository.
pub const TASK_NAMES: [&str; 15] = [
    "operator",
    "sense",
    "supervisor",
    "jog",
    "trajectory",
    "tactile_servo",
    "grasp",
    "setpoint",
    "joint_servo",
    "actuate",
    "tactile_scan",
    "opposed_scan",
    "wrist_scan",
    "analog_scan",
    "clock_lock",
];

/// Builds a task from its section, the machine's arm and its ports.
pub type TaskBuilder = fn(&Section, &AnyRobot, &mut Ports) -> Result<Box<dyn Task>, Invalid>;

/// A task that a lane may name.
#[derive(Clone, Copy, Debug)]
pub struct OwnTask {
    /// Name of the task in lanes, wires and its section: lower-case letters, digits, `_`.
    pub name: &'static str,
    /// Builds the task; its errors are located in `own.NAME`.
    pub make: TaskBuilder,
}

/// The section `[own.NAME]` of a machine file; empty when there is none.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(transparent)]
pub struct Section {
    table: toml::Table,
    #[serde(skip)]
    folder: PathBuf,
}

/// Only the program that has the task knows the meaning of the section's keys.
impl Explain for Section {}

impl Section {
    /// A section with the content of this table.
    #[must_use]
    pub fn new(table: toml::Table) -> Section {
        Section { table, folder: PathBuf::new() }
    }

    /// The same section, standing in a file of this folder.
    #[must_use]
    pub fn within_folder(mut self, folder: &Path) -> Section {
        self.folder = folder.to_owned();
        self
    }

    /// The folder of the file in which the section stands, from which relative paths in it are
    /// taken; empty, thus the working directory, where nobody has said it.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Reads the section as a configuration. Unknown keys are errors if the configuration has
    /// `deny_unknown_fields`.
    ///
    /// # Errors
    /// Unknown keys, wrong types, missing keys.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, Invalid> {
        strict::read_value(toml::Value::Table(self.table.clone())).map_err(|error| {
            let what = error.message().replace('\n', " ");
            // The key is the place, where the message names it.
            let unknown =
                what.strip_prefix("unknown field `").and_then(|rest| rest.split('`').next());
            let place = unknown.unwrap_or_default().to_owned();
            Invalid::new(place, what, "look at what its configuration takes")
        })
    }
}

/// The registered tasks of this program.
static OWN_TASKS: OnceLock<&'static [OwnTask]> = OnceLock::new();

/// Registers the tasks of this program, once, before anything is loaded.
///
/// # Errors
/// A second call; a name that occurs twice, is a task of this repository, or is not a valid name.
pub fn register(tasks: &'static [OwnTask]) -> Result<(), Invalid> {
    check(tasks)?;
    OWN_TASKS.set(tasks).map_err(|_| {
        let what = "the tasks of this program were named already";
        Invalid::new("own", what, "name all of them in one call")
    })
}

fn check(tasks: &[OwnTask]) -> Result<(), Invalid> {
    for (at, OwnTask { name, .. }) in tasks.iter().enumerate() {
        let place = format!("own.{name}");
        let first = name.bytes().next().is_some_and(|c| c.is_ascii_lowercase());
        let rest = |c: u8| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'_';
        if !first || !name.bytes().all(rest) {
            let remedy = "begin with a lower-case letter; go on with such, digits and `_`";
            return Err(Invalid::new(place, format!("`{name}` is no name of a task"), remedy));
        }
        if TASK_NAMES.contains(name) || *name == "world" {
            let what = format!("`{name}` is a task of the house");
            return Err(Invalid::new(place, what, "give it another name"));
        }
        if tasks[..at].iter().any(|other| other.name == *name) {
            let what = format!("two tasks are called `{name}`");
            return Err(Invalid::new(place, what, "give one of them another name"));
        }
    }
    Ok(())
}

/// The tasks that [`register`] registered.
#[must_use]
pub fn tasks() -> &'static [OwnTask] {
    OWN_TASKS.get().copied().unwrap_or_default()
}

/// The task of this name.
#[must_use]
pub fn find(name: &str) -> Option<&'static OwnTask> {
    tasks().iter().find(|task| task.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn none(_: &Section, _: &AnyRobot, _: &mut Ports) -> Result<Box<dyn Task>, Invalid> {
        Err(Invalid::new("", "makes nothing", ""))
    }

    fn refused(names: &[&'static str]) -> String {
        let tasks: Vec<OwnTask> = names.iter().map(|name| OwnTask { name, make: none }).collect();
        check(&tasks).map_or_else(|bad| bad.to_string(), |()| String::new())
    }

    #[test]
    fn names_that_cannot_be_told_apart_or_written_are_refused() {
        assert_eq!(refused(&["sway", "sway_2"]), "");
        assert!(refused(&["sway", "beat", "sway"]).contains("two tasks are called `sway`"));
        for house in TASK_NAMES.into_iter().chain(["world"]) {
            assert!(refused(&[house]).contains("task of the house"), "{house}");
        }
        for bad in ["", "Sway", "2sway", "_sway", "sway.goal", "sw ay", "sw\u{e4}y"] {
            assert!(refused(&[bad]).contains("no name of a task"), "{bad:?}");
        }
    }

    #[test]
    fn a_section_reads_what_it_holds_and_refuses_the_rest() {
        #[derive(Debug, PartialEq, serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Config {
            hz: f64,
        }
        let section = |text: &str| Section::new(text.parse().unwrap());
        assert_eq!(section("hz = 0.5").read(), Ok(Config { hz: 0.5 }));
        for (text, what) in [
            ("", "missing field `hz`"),
            ("hz = 1.0\nhx = 2", "unknown field `hx`"),
            ("hz = \"a\"", "invalid type"),
        ] {
            let bad = section(text).read::<Config>().unwrap_err();
            assert!(bad.what.contains(what) && !bad.what.contains('\n'), "{bad}");
        }
    }
}
