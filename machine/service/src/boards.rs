//! The service's configuration file with its machine file, and the boards that both name. A machine
//! file alone is enough for whoever wants the boards without the service.

use std::path::Path;

use serde::Deserialize;
use taktil_machine::config::MachineConfig;
use taktil_machine::contract::ContractConfig;
use taktil_machine::device::DeviceSection;
use taktil_machine::fault_plan::faults_of_text;
use taktil_machine::joints::JointsConfig;
use taktil_machine::robot::{self, AnyRobot, ArmError};
use taktil_machine::source::{FileKind, Located, Source};
use taktil_machine_boards::OpenDevices;
use taktil_machine_fault::{Fault, FaultPlan};
use taktil_machine_operator::OperatorConfig;
use taktil_record::flight::FlightConfig;
use taktil_record::recorder::LogConfig;
use taktil_rtcore::Invalid;

/// The service's configuration file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ServiceFile {
    /// Machine file, relative to this one.
    pub(crate) machine: String,
    /// Which missing real-time rights refuse the start.
    #[serde(default = "default_contract")]
    pub(crate) contract: ContractConfig,
    /// The flight recorder.
    #[serde(default)]
    pub(crate) flight: FlightConfig,
    /// A register board that serves the whole robot, in place of `[device.NAME]` of the machine.
    pub(crate) board: Option<toml::Table>,
    /// Where and how much of the run is recorded; nothing when absent.
    pub(crate) log: Option<LogConfig>,
    /// Where an operator is listened to; nowhere when absent.
    pub(crate) operator: Option<OperatorConfig>,
    /// What is done on purpose that nobody wants at work.
    #[serde(default)]
    pub(crate) service: TrialConfig,
    /// Sections that replace those of the machine file.
    #[serde(default)]
    pub(crate) robot: MachineConfig,
}

/// `[service]`: trials of the service itself.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct TrialConfig {
    /// Whether faults may be put into the readings and words of the boards. Default false.
    pub(crate) fault_injection: bool,
    /// The faults: a file with `[[fault]]`, relative to this one. Default none.
    pub(crate) fault_plan: Option<String>,
}

impl TrialConfig {
    /// The faults that are to be put into the boards of a machine; none without a plan.
    ///
    /// # Errors
    /// A plan where faults are not allowed, a file that cannot be used, a fault of a lane or of the
    /// clock, which a real one has by itself. The place is `service.fault_plan`.
    pub(crate) fn plan(&self, folder: &Path) -> Result<Option<FaultPlan>, Invalid> {
        let place = "service.fault_plan";
        let Some(name) = &self.fault_plan else { return Ok(None) };
        if !self.fault_injection {
            let what = "faults are not put into real boards unless that is allowed";
            return Err(Invalid::new(place, what, "say fault_injection = true, or leave it out"));
        }
        let source = Source::read_beside(folder, name, FileKind::Faults)
            .map_err(|bad| Invalid::new(place, bad.what, bad.remedy))?;
        let faults = faults_of_text(&source)
            .map_err(|bad| Invalid::new(place, format!("{name}: {}", bad.what), bad.remedy))?;
        let elsewhere = |fault: &&Fault| {
            !taktil_machine_fault::is_half(&fault.target) && !fault.target.starts_with("task.")
        };
        if let Some(fault) = faults.iter().find(elsewhere) {
            let what = format!("{name}: `{}` has its faults by itself", fault.target);
            let remedy = "name halves of boards, such as encoders, or tasks, such as task.jog";
            return Err(Invalid::new(place, what, remedy));
        }
        Ok(Some(FaultPlan::new(faults)))
    }
}

fn default_contract() -> ContractConfig {
    ContractConfig::HARD
}

/// The service's file and its machine file, read and joined.
#[derive(Debug)]
pub(crate) struct ServiceSources {
    pub(crate) source: Source,
    pub(crate) machine: Source,
    /// What the service's file says, without its board and the sections of the machine.
    pub(crate) file: ServiceFile,
    pub(crate) config: MachineConfig,
    pub(crate) robot: AnyRobot,
    pub(crate) urdf: Option<Source>,
}

impl ServiceSources {
    /// Reads the file and whatever it names.
    ///
    /// # Errors
    /// Anything wrong, located in the file where it stands.
    pub(crate) fn read(path: &Path) -> Result<ServiceSources, Located> {
        let source = Source::read(path, FileKind::Service)?;
        let mut file: ServiceFile = source.parse()?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let machine_path = folder.join(&file.machine);
        let machine = Source::read(&machine_path, FileKind::Machine)
            .map_err(|bad| source.locate(Invalid::new("machine", bad.what, bad.remedy)))?;
        // The arm's file is relative to the file that names it.
        let namer = if file.robot.arm.is_some() { path } else { &machine_path };
        let beside = namer.parent().unwrap_or(Path::new("")).to_owned();
        let mut own = std::mem::take(&mut file.robot);
        own.set_folder(folder);
        let mut config = machine_config(&source, &machine, own)?;
        let (robot, urdf) = robot::load(config.arm.as_ref(), &beside)
            .map_err(|bad| locate_arm_error(bad, &source, &machine))?;
        let robot = with_joints(&config, robot).map_err(|bad| locate(bad, &source, &machine))?;
        add_board(&mut config, file.board.take(), folder)
            .map_err(|bad| locate(bad, &source, &machine))?;
        Ok(ServiceSources { source, machine, file, config, robot, urdf })
    }

    /// Opens the boards, which writes the safe values of their outputs.
    ///
    /// # Errors
    /// What a driver refuses, located.
    pub(crate) fn open(&self) -> Result<OpenDevices, Located> {
        taktil_machine_boards::open(&self.config, &self.robot)
            .map_err(|bad| locate(bad, &self.source, &self.machine))
    }
}

/// The boards of a configuration, open.
#[derive(Debug)]
pub struct OpenBoards {
    /// The machine that names them.
    pub config: MachineConfig,
    /// The arm, with the scales of `[joints]`.
    pub robot: AnyRobot,
    /// The halves.
    pub opened: OpenDevices,
}

/// Opens the boards of a service's configuration, or of a machine file, without the service.
/// Opening a board writes the safe values of its outputs.
///
/// # Errors
/// Anything wrong with the file, or what a driver refuses, located.
pub fn open_boards(path: &Path) -> Result<OpenBoards, Located> {
    open_connected(path, Wiring::AsDescribed)
}

/// Opens the boards as [`open_boards`] does, but by their own channels and directions, for whoever
/// finds out how they are wired: of `[joints]` only what a code is worth stays between. The machine
/// and the arm are those of the file, with all that it says.
///
/// # Errors
/// As [`open_boards`]; what a code is worth where it depends on the wiring; converters of another
/// width than the arm's where the file does not say what a code is worth.
pub fn open_boards_by_channel(path: &Path) -> Result<OpenBoards, Located> {
    open_connected(path, Wiring::ByChannel)
}

/// What stands between joints and boards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wiring {
    /// What the file says.
    AsDescribed,
    /// Nothing but what a code is worth.
    ByChannel,
}

impl Wiring {
    fn open(self, config: &MachineConfig, robot: &AnyRobot) -> Result<OpenDevices, Invalid> {
        if self == Wiring::AsDescribed {
            return taktil_machine_boards::open(config, robot);
        }
        let joints = config.joints.as_ref().map(JointsConfig::without_wiring).transpose();
        let joints = joints.map_err(|bad| bad.within("joints"))?;
        let config = MachineConfig { joints, ..config.clone() };
        let opened = taktil_machine_boards::open(&config, robot)?;
        opened.require_code_scale(&config, robot).map(|()| opened)
    }
}

fn open_connected(path: &Path, wiring: Wiring) -> Result<OpenBoards, Located> {
    let source = Source::read(path, FileKind::Service)?;
    if source.contains("machine") {
        let sources = ServiceSources::read(path)?;
        let opened = wiring
            .open(&sources.config, &sources.robot)
            .map_err(|bad| locate(bad, &sources.source, &sources.machine))?;
        return Ok(OpenBoards { config: sources.config, robot: sources.robot, opened });
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let config = source.parse::<MachineConfig>()?.with_insertions();
    let mut config = config.map_err(|bad| source.locate(bad))?;
    config.set_folder(folder);
    let (robot, _) = robot::load(config.arm.as_ref(), folder).map_err(|bad| match bad {
        ArmError::Section(bad) => source.locate(bad),
        ArmError::File(located) => *located,
    })?;
    let robot = with_joints(&config, robot).map_err(|bad| source.locate(bad))?;
    add_board(&mut config, None, folder).map_err(|bad| source.locate(bad))?;
    let opened = wiring.open(&config, &robot).map_err(|bad| source.locate(bad))?;
    Ok(OpenBoards { config, robot, opened })
}

/// Why the outputs of a board were not made safe.
#[derive(Debug)]
pub struct NotSafe {
    /// What is wrong, located.
    pub located: Located,
    /// Whether the board's section cannot be used; otherwise the board is what failed.
    pub is_configuration: bool,
}

/// What came of the boards of a configuration, by their names.
pub type SafetyOutcomes = Vec<(String, Result<(), NotSafe>)>;

/// Writes the safe values of the outputs of every board that a service's configuration names; what
/// came of each, by its name. A board that fails does not keep the others from being tried.
///
/// # Errors
/// A file that cannot be read as a configuration, located.
pub fn make_safe(path: &Path) -> Result<SafetyOutcomes, Located> {
    let sources = ServiceSources::read(path)?;
    let outcomes = taktil_machine_boards::make_safe(&sources.config).into_iter();
    let of_board = |(name, outcome): (String, Result<(), taktil_machine_boards::NotSafe>)| {
        let located = outcome.map_err(|why| NotSafe {
            located: locate(why.bad, &sources.source, &sources.machine),
            is_configuration: why.is_configuration,
        });
        (name, located)
    };
    Ok(outcomes.map(of_board).collect())
}

pub(crate) fn machine_config(
    source: &Source,
    machine: &Source,
    robot: MachineConfig,
) -> Result<MachineConfig, Located> {
    let mut config = machine.parse::<MachineConfig>()?;
    config.set_folder(machine.path.parent().unwrap_or(Path::new("")));
    let config = config.overridden_by(robot).with_insertions();
    let mut config = config.map_err(|bad| locate(bad, source, machine))?;
    if config.actuate.as_ref().is_some_and(|actuate| !actuate.runaway_detection) {
        let remedy = "leave it out: boards are not driven without it";
        let bad = Invalid::new("actuate.runaway_detection", "is off", remedy);
        return Err(locate(bad, source, machine));
    }
    // Without an operator nothing reads the feedback to the script.
    config.wiring.remove("operator.control");
    config.wiring.remove("operator.queue");
    Ok(config)
}

/// The arm with the scales of `[joints]`.
pub(crate) fn with_joints(config: &MachineConfig, robot: AnyRobot) -> Result<AnyRobot, Invalid> {
    match &config.joints {
        None => Ok(robot),
        Some(joints) => joints.applied_to(robot).map_err(|bad| bad.within("joints")),
    }
}

/// Takes `[board]` as the section of a register board that serves everything.
fn add_board(
    config: &mut MachineConfig,
    board: Option<toml::Table>,
    folder: &Path,
) -> Result<(), Invalid> {
    let Some(mut board) = board else {
        if config.device.is_empty() {
            let remedy = "write [device.NAME] with a driver and what it serves";
            return Err(Invalid::new("device", "no board is named", remedy));
        }
        return Ok(());
    };
    if let Some(other) = config.device.keys().next() {
        let what = format!("stands beside `device.{other}`");
        return Err(Invalid::new("device.board", what, "leave one of them out"));
    }
    board.insert("driver".into(), "regmap".into());
    let mut section = DeviceSection::new(board);
    section.set_folder(folder);
    config.device.insert("board".into(), section);
    Ok(())
}

/// Locates an error in the service's file or in the machine's.
pub(crate) fn locate(bad: Invalid, source: &Source, machine: &Source) -> Located {
    // The section `[board]` stands for a device of that name.
    if let Some(rest) = bad.place.strip_prefix("device.board")
        && source.contains("board")
        && !source.contains("robot.device.board")
    {
        return source.locate(Invalid { place: format!("board{rest}"), ..bad });
    }
    let here = bad.clone().within("robot");
    if source.contains(&here.place) { source.locate(here) } else { machine.locate(bad) }
}

pub(crate) fn locate_arm_error(bad: ArmError, source: &Source, machine: &Source) -> Located {
    match bad {
        ArmError::Section(bad) => locate(bad, source, machine),
        ArmError::File(located) => *located,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_put_into_boards_only_where_the_file_allows_it() {
        let folder = std::env::temp_dir().join(format!("taktil-trial-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let write = |name: &str, target: &str| {
            let text = format!("[[fault]]\nkind = \"silence\"\ntarget = \"{target}\"\n");
            std::fs::write(folder.join(name), text).unwrap();
        };
        write("halves.toml", "encoders");
        write("lanes.toml", "lane.servo");
        let plan = |text: &str| toml::from_str::<TrialConfig>(text).unwrap().plan(&folder);
        assert_eq!(plan("").unwrap(), None);
        assert_eq!(plan("fault_injection = true").unwrap(), None);
        let named = "fault_plan = \"halves.toml\"";
        let forbidden = plan(named).unwrap_err();
        assert_eq!(forbidden.place, "service.fault_plan");
        assert!(forbidden.what.contains("unless that is allowed"), "{forbidden}");
        let allowed = plan(&format!("fault_injection = true\n{named}")).unwrap().unwrap();
        assert_eq!(allowed.faults().len(), 1);
        for file in ["lanes.toml", "nowhere.toml"] {
            let bad = plan(&format!("fault_injection = true\nfault_plan = \"{file}\""));
            assert_eq!(bad.unwrap_err().place, "service.fault_plan", "{file}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
