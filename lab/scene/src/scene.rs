//! A scene: what is simulated, on which machine, with which operator, for how long. Reads the scene
//! file and the machine file that it names. Every error is located in the file that contains the
//! value, and unknown keys are errors.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;
use taktil_hal::fault::FaultPlan;
use taktil_machine::config::MachineConfig;
use taktil_machine::contract::ContractConfig;
use taktil_machine::joints::JointsConfig;
use taktil_machine::operator::command::CommandContext;
use taktil_machine::robot::{self, AnyRobot, ArmError};
use taktil_machine::source::{FileKind, Located, Source};
use taktil_machine::touch_task;
use taktil_rtcore::explain::{Explain, Key};
use taktil_rtcore::{Invalid, Nanos, Transaction};
use taktil_sim::scene::WorldConfig;

use crate::probe::{self, Shape};

mod edits;
mod faults;
mod fingertip;
mod recorded;
mod script;
mod start;

pub use recorded::Read;
pub use script::{OperatorAction, Step};
use script::{StepFile, script};
use start::Start;

/// Longest title (bytes): it is one line.
const TITLE_BYTES_MAX: usize = 256;
/// Shortest run, s.
const DURATION_MIN_S: f64 = 1e-3;
/// Longest run, s: a day.
const DURATION_MAX_S: f64 = 86_400.0;

taktil_rtcore::explained! {
    /// The scene file.
    #[derive(Clone, Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct SceneFile {
        /// One line for people, of at most 256 bytes.
        title: String,
        /// Machine file, relative to this one. Default: none, and every section stands in
        /// `[robot]`.
        machine: Option<String>,
        /// How long it runs, s: 0.001 to 86400. Default 10.
        #[serde(default = "default_duration_s")]
        duration_s: f64,
        /// Seed of all chance. Default 1.
        #[serde(default = "default_seed")]
        seed: u64,
        /// From the release of a job that writes a D/A word to the instant at which the word acts,
        /// us: more than 0, at most the period of the lane that actuates. Default 1250.
        #[serde(default = "default_delay_us")]
        actuation_delay_us: i64,
        /// `SCHED_FIFO` priority, 1 to 99, of the lane that simulates the world in a live run.
        /// Default 70.
        #[serde(default = "default_world_priority")]
        world_priority: i64,
        /// CPU of the lane that simulates the world; any when absent.
        world_cpu: Option<usize>,
        /// Longest processor time of one job of the lane that simulates the world, us; when absent
        /// the lane is not analysed.
        world_budget_us: Option<i64>,
        /// Which missing real-time rights refuse a live run: `hard` for priority, CPU and memory,
        /// `soft` (default) for none, or a table of items.
        #[serde(default = "soft")]
        contract: ContractConfig,
        /// Where the arm stands when power comes on. Default `[world.arm] home_deg`, for an arm
        /// from a file its home pose.
        start: Option<Start>,
        /// What the operator asks for, which keys are held and what is typed, one thing after the
        /// other. Default nothing.
        #[serde(default)]
        operator: Vec<StepFile>,
        /// Edits of parameters while it runs. Default none.
        #[serde(default)]
        edit: Vec<EditFile>,
        /// What is simulated.
        #[serde(default)]
        world: WorldConfig,
        /// How the joints of the simulated robot are wired. Default: as `[joints]` of the machine
        /// says; another wiring shows what a machine file with mistakes does.
        world_joints: Option<JointsConfig>,
        /// Sections that replace those of the machine file, lanes, wires and own tasks name by
        /// name.
        #[serde(default)]
        robot: MachineConfig,
    }
}

fn soft() -> ContractConfig {
    ContractConfig::SOFT
}

fn default_duration_s() -> f64 {
    10.0
}

fn default_seed() -> u64 {
    1
}

fn default_delay_us() -> i64 {
    1250
}

fn default_world_priority() -> i64 {
    70
}

taktil_rtcore::explained! {
    /// One edit: what is set, and when.
    #[derive(Clone, Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct EditFile {
        /// At which instant, s: 0 to 86400.
        at_s: f64,
        /// New values of parameters by their names, such as `"joint_servo.damping" = 0.6`; all act
        /// at once.
        set: BTreeMap<String, f64>,
    }
}

/// A complete scene after all checks.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The scene file, for later errors and for the log.
    pub source: Source,
    machine_source: Option<Source>,
    /// The files that motions of the table and the arm name, with those names.
    recorded: Vec<(String, Source)>,
    /// One line for people.
    pub title: String,
    /// Duration of the run.
    pub duration: Nanos,
    /// Seed when the command line gives none.
    pub seed: u64,
    /// A D/A word acts this long after the release of the job that wrote it.
    pub actuation_delay: Nanos,
    /// Priority of the lane that simulates the world.
    pub world_priority: i64,
    /// CPU of that lane.
    pub world_cpu: Option<usize>,
    /// Declared processor time of one job of that lane; the lane is not analysed when absent.
    pub world_budget: Option<Nanos>,
    /// Which missing real-time rights refuse a live run.
    pub contract: ContractConfig,
    /// The operator's script, in order.
    pub script: Vec<Step>,
    /// Edits of parameters, in order of time.
    pub edits: Vec<Transaction>,
    /// What is simulated.
    pub world: WorldConfig,
    /// The faults of `[[world.fault]]` that befall halves, lanes and tasks.
    pub faults: FaultPlan,
    /// The machine that controls it.
    pub machine: MachineConfig,
    /// The arm of the machine, with the scales of its `[joints]`.
    pub robot: AnyRobot,
    /// What is remarkable about the arm's description, a line each.
    pub arm_remarks: Vec<String>,
    /// The arm as it is without `[joints]`, which the world simulates.
    pub plain_robot: AnyRobot,
    /// How the joints of the simulated robot are wired.
    pub wired: JointsConfig,
    /// Where the joints of the arm stand when power comes on (deg).
    pub start_deg: Vec<f64>,
}

impl Scene {
    /// Reads a scene and its machine.
    ///
    /// # Errors
    /// An error in either file, located there.
    pub fn load(path: &Path) -> Result<Scene, Located> {
        let source = Source::read(path, FileKind::Scene)?;
        let file: SceneFile = source.parse()?;
        let machine_source = match &file.machine {
            None => None,
            Some(name) => Some(read_machine(&source, name)?),
        };
        Scene::beside(source, machine_source, file)
    }

    /// Reads a scene with another machine than the one that it names. What the scene says of the
    /// machine under `[robot]` holds as before, but for how fast its moves are where the machine
    /// file says that.
    ///
    /// # Errors
    /// An error in either file, located there.
    pub fn load_with_machine(path: &Path, machine: &Path) -> Result<Scene, Located> {
        let source = Source::read(path, FileKind::Scene)?;
        let mut file: SceneFile = source.parse()?;
        let machine_source = Source::read(machine, FileKind::Machine)?;
        // Files that the machine names stand beside it, wherever the scene is.
        let whole = std::path::absolute(&machine_source.path);
        let whole = whole.unwrap_or_else(|_| machine_source.path.clone());
        file.machine = Some(whole.display().to_string());
        // Speeds and transitions belong to the arm, the moves to the scene.
        let other: MachineConfig = machine_source.parse()?;
        if let (Some(moves), Some(arm)) = (&mut file.robot.trajectory, other.trajectory) {
            let own = std::mem::replace(moves, arm);
            moves.moves = own.moves;
        }
        Scene::beside(source, Some(machine_source), file)
    }

    /// A scene with the files that stand beside it.
    fn beside(
        source: Source,
        machine_source: Option<Source>,
        file: SceneFile,
    ) -> Result<Scene, Located> {
        let folder = source.folder().to_owned();
        let beside = |name: &str| {
            Source::read_beside(&folder, name, FileKind::Motion).map_err(|error| error.what)
        };
        Scene::from_file(source, machine_source, &beside, file)
    }

    /// A scene from texts that were already read, for example from a log. `read` returns the files
    /// that its motions name.
    ///
    /// # Errors
    /// As [`Scene::load`].
    pub fn of(
        source: Source,
        machine_source: Option<Source>,
        read: Read<'_>,
    ) -> Result<Scene, Located> {
        let file: SceneFile = source.parse()?;
        Scene::from_file(source, machine_source, read, file)
    }

    fn from_file(
        source: Source,
        machine_source: Option<Source>,
        read: Read<'_>,
        file: SceneFile,
    ) -> Result<Scene, Located> {
        let base: Option<MachineConfig> = machine_source.as_ref().map(Source::parse).transpose()?;
        let base = base.unwrap_or_default();
        let edits = edits::transactions(&file.edit).map_err(|invalid| source.locate(invalid))?;
        let mut world = file.world.clone();
        let mut recorded = recorded::fill(&mut world, &source, read)?;
        let machine = base.overridden_by(file.robot.clone()).with_insertions();
        let within = |bad| locate_section(bad, &source, machine_source.as_ref());
        let mut machine = machine.map_err(within)?;
        let namer = file.machine.as_deref().filter(|_| file.robot.tactile_servo.is_none());
        let beside = namer.and_then(|machine| Path::new(machine).parent()).unwrap_or(Path::new(""));
        recorded.extend(touch_task::fill(&mut machine, beside, read, &within)?);
        fingertip::set_defaults(&mut world, &machine, &source);
        let mut arm_remarks = Vec::new();
        let plain_robot = match &machine.arm {
            None => AnyRobot::puma260(),
            Some(arm) => {
                let (name, urdf) = arm_file(&file, arm, read).map_err(within)?;
                let built = robot::build(arm, &urdf);
                arm_remarks = robot::remarks(arm, &urdf);
                recorded.push((name, urdf));
                let namer = machine_source.as_ref().filter(|_| file.robot.arm.is_none());
                built.map_err(|bad| locate_arm(bad, &source, namer))?
            }
        };
        let joints = machine.joints.clone().unwrap_or_default();
        let robot = scaled_robot(&joints, &plain_robot, &source, machine_source.as_ref())?;
        let wired = file.world_joints.clone().unwrap_or(joints);
        let trajectory = machine.trajectory.clone().unwrap_or_default();
        let context = CommandContext { trajectory, robot };
        let script = script(&file.operator, &context).map_err(|invalid| source.locate(invalid))?;
        let robot = context.robot;
        let mut scene = Scene {
            machine,
            machine_source,
            recorded,
            title: file.title.clone(),
            duration: Nanos::ZERO,
            seed: file.seed,
            actuation_delay: Nanos::ZERO,
            world_priority: file.world_priority,
            world_cpu: file.world_cpu,
            // The delay is clamped above every valid deadline, so that it is rejected and cannot
            // overflow.
            world_budget: file
                .world_budget_us
                .map(|us| Nanos::from_micros(us.clamp(-1, 1_000_000_000))),
            contract: file.contract,
            script,
            edits,
            world,
            faults: FaultPlan::default(),
            start_deg: robot.home_rad().iter().map(|q| q.to_degrees()).collect(),
            robot,
            arm_remarks,
            plain_robot,
            wired,
            source,
        };
        scene.complete(&file).map_err(|invalid| scene.locate(invalid))?;
        Ok(scene)
    }

    /// Whether there is something to touch.
    #[must_use]
    pub fn has_contact(&self) -> bool {
        self.world.pin.present || !self.world.object.is_empty()
    }

    fn complete(&mut self, file: &SceneFile) -> Result<(), Invalid> {
        if self.title.len() > TITLE_BYTES_MAX {
            let what = format!("has {} bytes", self.title.len());
            return Err(Invalid::new("title", what, format!("give at most {TITLE_BYTES_MAX}")));
        }
        self.duration = duration(file.duration_s, "duration_s")?;
        if !(-1_000_000..=1_000_000).contains(&file.actuation_delay_us) {
            return Err(Invalid::new(
                "actuation_delay_us",
                format!("{} us is no actuation delay", file.actuation_delay_us),
                "give more than 0 and at most the period of the lane that actuates",
            ));
        }
        self.actuation_delay = Nanos::from_micros(file.actuation_delay_us);
        self.world.check().map_err(|bad| bad.within("world"))?;
        fingertip::check(&self.world, &self.machine)?;
        self.faults = faults::planned(&self.world)?;
        self.place_arm(file.start.as_ref())?;
        // The machine gets the start pose of the arm unless its own file states another one.
        let servo = self.machine.joint_servo.get_or_insert_default();
        servo.assumed_pose_deg.get_or_insert_with(|| self.start_deg.clone());
        let sense = self.machine.sense.get_or_insert_default();
        sense.home_deg.get_or_insert_with(|| self.start_deg.clone());
        Ok(())
    }

    /// The files that were read.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        let machine = self.machine_source.as_ref().map(|source| source.path.as_path());
        let recorded = self.recorded.iter().map(|(_, source)| source.path.as_path());
        [self.source.path.as_path()].into_iter().chain(machine).chain(recorded)
    }

    /// The files that the motions name: the name and the text of each.
    pub fn recorded(&self) -> impl Iterator<Item = (&str, &str)> {
        self.recorded.iter().map(|(name, source)| (name.as_str(), source.text.as_str()))
    }

    /// The text of the machine file; empty when the scene names none.
    #[must_use]
    pub fn machine_text(&self) -> &str {
        self.machine_source.as_ref().map_or("", |source| &source.text)
    }

    /// Locates an error in the scene or in the machine file.
    #[must_use]
    pub fn locate(&self, invalid: Invalid) -> Located {
        let section = invalid.place.split(['.', '[']).next().unwrap_or_default();
        let in_scene = invalid.clone().within("robot");
        match &self.machine_source {
            _ if self.source.contains(&invalid.place) => self.source.locate(invalid),
            _ if self.source.contains(&in_scene.place) => self.source.locate(in_scene),
            Some(machine) if machine.contains(section) => machine.locate(invalid),
            _ => self.source.locate(invalid),
        }
    }
}

/// The keys and types of a scene file.
///
/// # Errors
/// A declaration that cannot be probed.
pub fn shape() -> Result<Shape, String> {
    probe::shape::<SceneFile>()
}

/// The meanings of the keys of a scene file.
#[must_use]
pub fn keys() -> Vec<Key> {
    SceneFile::keys()
}

/// Converts seconds to an exact duration.
///
/// # Errors
/// A value that is not finite, not positive, or longer than a day.
pub fn duration(seconds: f64, place: &str) -> Result<Nanos, Invalid> {
    if (DURATION_MIN_S..=DURATION_MAX_S).contains(&seconds) {
        #[expect(clippy::cast_possible_truncation, reason = "at most a day of nanoseconds")]
        return Ok(Nanos((seconds * 1e9).round() as i64));
    }
    let remedy = format!("give {DURATION_MIN_S} to {DURATION_MAX_S} seconds");
    let plain = seconds == 0.0 || (1e-6..1e9).contains(&seconds.abs()) || !seconds.is_finite();
    let shown = if plain { format!("{seconds}") } else { format!("{seconds:e}") };
    Err(Invalid::new(place, format!("{shown} s is not a duration"), remedy))
}

/// The arm with the scales of `[joints]`; an error is located in the file in which the section
/// stands.
fn scaled_robot(
    joints: &JointsConfig,
    plain: &AnyRobot,
    scene: &Source,
    machine: Option<&Source>,
) -> Result<AnyRobot, Located> {
    let scaled = joints.applied_to(plain.clone());
    scaled.map_err(|bad| locate_section(bad.within("joints"), scene, machine))
}

/// Locates an error in a section of the machine: in the scene where it has that section, or else in
/// the machine file.
fn locate_section(bad: Invalid, scene: &Source, machine: Option<&Source>) -> Located {
    let own = bad.clone().within("robot");
    match machine {
        Some(machine) if !scene.contains(&own.place) => machine.locate(bad),
        _ => scene.locate(own),
    }
}

fn read_machine(scene: &Source, name: &str) -> Result<Source, Located> {
    Source::read_beside(scene.folder(), name, FileKind::Machine).map_err(|error| {
        let located = scene.locate(Invalid::new("machine", error.what, error.remedy));
        Located { what: located.what, ..located }
    })
}

/// An error of an arm at its place: in its file, in the machine file that names it, or in the
/// scene.
fn locate_arm(bad: ArmError, scene: &Source, machine: Option<&Source>) -> Located {
    match (bad, machine) {
        (ArmError::File(located), _) => *located,
        (ArmError::Section(bad), Some(machine)) => machine.locate(bad),
        (ArmError::Section(bad), None) => scene.locate(bad.within("robot")),
    }
}

/// The URDF of an arm: its name relative to the scene's folder, and the file.
fn arm_file(
    file: &SceneFile,
    arm: &robot::ArmConfig,
    read: Read<'_>,
) -> Result<(String, Source), Invalid> {
    // The name is relative to the file that contains it.
    let machine = file.machine.as_deref().filter(|_| file.robot.arm.is_none());
    let folder = machine.and_then(|machine| Path::new(machine).parent()).unwrap_or(Path::new(""));
    let name = folder.join(&arm.urdf).display().to_string();
    let remedy = "name a URDF file by its path from the folder of the file in which this stands";
    let urdf = read(&name).map_err(|what| Invalid::new("arm.urdf", what, remedy))?;
    Ok((name, urdf))
}
