//! Reads from the metadata of a log what ran: a scene with its machine and seed, or the service's
//! files. A log of another version, or one without these metadata, is an error.

use std::path::PathBuf;

use taktil_machine::renamed::with_current_keys;
use taktil_machine::robot::AnyRobot;
use taktil_machine::source::{Located, Source};
use taktil_machine::tape::player::{DeviceDescription, MissingEntry, Tapes};
use taktil_machine_service::service::{self, LoggedSources};
use taktil_rtcore::{Machine, Nanos};

use crate::RECORDED_FILE_PREFIX;
use crate::assembly::Assembly;
use crate::scene::Scene;
use taktil_record::{Log, METADATA_RUN};

/// The origin of a log.
pub enum Origin {
    /// A scene, live or in virtual time.
    Scene {
        /// The scene with its machine.
        scene: Box<Scene>,
        /// Seed of the run.
        seed: u64,
        /// One line of text for people.
        title: String,
    },
    /// The service over a board.
    Board {
        /// The files that it read.
        sources: Box<LoggedSources>,
        /// The devices of the board.
        about: Box<DeviceDescription>,
        /// One line of text for people.
        title: String,
    },
}

impl Origin {
    /// Reads the origin from the metadata of a log.
    ///
    /// # Errors
    /// A log of another version or without these metadata; a scene or machine that cannot be used.
    pub fn of(log: &Log) -> Result<Origin, String> {
        let run = log
            .metadata()
            .get(METADATA_RUN)
            .filter(|about| about.contains_key("machine_text"))
            .ok_or("it does not say what ran: it has no metadata of a run")?;
        let here = env!("CARGO_PKG_VERSION");
        match run.get("taktil").map(String::as_str) {
            Some(version) if version == here => {}
            Some(version) => {
                return Err(format!("taktil {version} wrote it, this is {here}; use that one"));
            }
            None => return Err("it does not say which version wrote it".to_owned()),
        }
        let find =
            |key: &str| run.get(key).cloned().ok_or_else(|| format!("its metadata lack `{key}`"));
        let source = |path: &str, text: &str| -> Result<Source, String> {
            let text = with_current_keys(&find(text)?);
            Ok(Source { path: PathBuf::from(find(path)?), text })
        };
        let text = with_current_keys(&find("machine_text")?);
        let machine = Source { path: PathBuf::from("machine"), text };
        let mode = find("mode")?;
        if mode == "board" {
            let service = source("service", "service_text")?;
            let about = DeviceDescription::parse(&find("devices")?)
                .map_err(|why| format!("its metadata `devices` cannot be used: {why}"))?;
            let title = format!("{}, on a board", service.path.display());
            let named = |key: &str, name: &str| {
                let text = run.get(key)?.clone();
                Some(Source { path: PathBuf::from(name), text })
            };
            let (urdf, task) = (named("urdf_text", "arm"), named("task_text", "task"));
            let sources = Box::new(LoggedSources { service, machine, urdf, task });
            return Ok(Origin::Board { sources, about: Box::new(about), title });
        }
        let scene = source("scene", "scene_text")?;
        let seed = find("seed")?;
        let title = format!("{}, {mode}, seed {seed}", scene.path.display());
        let seed = seed.parse().map_err(|_| format!("its seed `{seed}` is no number"))?;
        let machine = Some(machine).filter(|machine| !machine.text.is_empty());
        let read = |name: &str| {
            let text = find(&format!("{RECORDED_FILE_PREFIX}{name}"))?;
            Ok(Source { path: PathBuf::from(name), text })
        };
        let scene = Box::new(Scene::of(scene, machine, &read).map_err(on_one_line)?);
        Ok(Origin::Scene { scene, seed, title })
    }

    /// One line of text for people.
    #[must_use]
    pub fn title(&self) -> String {
        match self {
            Origin::Scene { title, .. } | Origin::Board { title, .. } => title.clone(),
        }
    }

    /// Tasks that stand for what is outside the machine. A replay takes their outputs from the log.
    #[must_use]
    pub fn replayed_tasks(&self) -> Vec<&'static str> {
        match self {
            Origin::Scene { .. } => vec!["operator", "world"],
            Origin::Board { .. } => vec!["operator"],
        }
    }

    /// The scene that ran, and its seed.
    ///
    /// # Errors
    /// A run over a board, which had no scene.
    pub fn into_scene(self) -> Result<(Scene, u64), String> {
        match self {
            Origin::Scene { scene, seed, .. } => Ok((*scene, seed)),
            Origin::Board { .. } => Err("it is of a board: nothing was simulated".to_owned()),
        }
    }

    /// The robot that ran.
    ///
    /// # Errors
    /// Texts that cannot be used, on one line.
    pub fn robot(&self) -> Result<AnyRobot, String> {
        match self {
            Origin::Scene { scene, .. } => Ok(scene.robot.clone()),
            Origin::Board { sources, .. } => service::robot_of(sources).map_err(on_one_line),
        }
    }

    /// Builds the machine with its devices on `tapes`.
    ///
    /// # Errors
    /// As [`Assembly::build_replay`] and [`service::rebuild`], on one line.
    pub fn machine(&self, tapes: Tapes, stall: Nanos) -> Result<(Machine, MissingEntry), String> {
        match self {
            Origin::Scene { scene, seed, .. } => {
                Assembly::new(scene).with_seed(*seed).build_replay(tapes, stall)
            }
            Origin::Board { sources, about, .. } => service::rebuild(sources, tapes, about, stall),
        }
        .map_err(on_one_line)
    }
}

/// An error in a text of a log, on one line.
fn on_one_line(bad: Located) -> String {
    format!("what it says of its run cannot be used: {}", bad.what)
}
