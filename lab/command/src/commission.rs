//! `taktil commission`: the first power-up of a robot, guided at a terminal. A machine file with
//! sections `[device.NAME]`, or a service's configuration, opens real boards; a scene is a
//! simulated robot, wired as its `[world_joints]` say.

use std::io::{BufRead as _, IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context as _;
use taktil_hal::{Clock as _, Devices, Nanos};
use taktil_lab_commission::simulated::SimulatedRobot;
use taktil_lab_commission::{
    Answer, Cell, Commissioning, Findings, Model, Options, Pace, Shown, Stop, Witness,
};
use taktil_lab_scene::scene::Scene;
use taktil_machine::config::MachineConfig;
use taktil_machine::joints::JointsConfig;
use taktil_machine::robot::{self, AnyRobot, ArmError};
use taktil_machine::source::{FileKind, Source};
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;
use taktil_rtcore::linux::{MonotonicClock, wall_clock};

/// Time between two cycles with real boards.
const BOARD_PERIOD: Nanos = Nanos::from_micros(2_500);
/// Time that real brakes get to open (s).
const BOARD_BRAKE_S: f64 = 0.1;

/// Which robot is commissioned, and how.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Pose the arm so that it rests by itself with its brakes lifted, such as straight up, and say where
it stands with --pose. Stay at the emergency stop.

Examples:
  taktil commission sim/scenes/commission.toml --yes
  taktil commission /etc/taktil/machine.toml --pose 0,90,-90,0,0,0 --write found.toml

Exit codes: 0 found, 1 stopped, with the reason; 2 bad input.")]
pub struct CommissionArgs {
    /// Scene, machine file or service configuration (TOML)
    config: PathBuf,
    /// Do not ask before each motion; before boards somebody still has to say which joint moved
    #[arg(long)]
    yes: bool,
    /// Measure only this joint, counted from 1
    #[arg(long, value_name = "N")]
    joint: Option<usize>,
    /// Angles of the joints now, in degrees, with commas; without it the home pose of the file
    #[arg(long, value_name = "DEG,...", value_delimiter = ',', allow_hyphen_values = true)]
    pose: Vec<f64>,
    /// Do not move joints to their stops: neither counts of a turn nor gears are measured
    #[arg(long)]
    no_stops: bool,
    /// Largest torque, in parts of the largest code
    #[arg(long, value_name = "SHARE", default_value_t = 0.7)]
    torque_share: f64,
    /// Write the machine file with what was found to this file
    #[arg(long, value_name = "FILE")]
    write: Option<PathBuf>,
}

/// A file that describes a robot.
enum Described {
    Scene(Box<Scene>),
    Boards { machine: Box<MachineConfig>, robot: AnyRobot, text: String },
}

/// Commissions the robot.
///
/// # Errors
/// Bad input, located; the reason why the commissioning stopped.
pub fn run(arguments: &CommissionArgs) -> anyhow::Result<ExitCode> {
    if !(0.01..=1.0).contains(&arguments.torque_share) {
        return Err(BadOption("--torque-share: give 0.01 to 1".to_owned()).into());
    }
    match describe(&arguments.config)? {
        Described::Scene(scene) => simulated(arguments, &scene),
        Described::Boards { machine, robot, text } => boards(arguments, *machine, &robot, &text),
    }
}

fn describe(path: &Path) -> anyhow::Result<Described> {
    let source = Source::read(path, FileKind::Machine)?;
    let table: toml::Table = source.parse()?;
    if table.contains_key("title") {
        return Ok(Described::Scene(Box::new(Scene::load(path)?)));
    }
    let source = match table.get("machine").and_then(toml::Value::as_str) {
        Some(name) => {
            let beside = path.parent().unwrap_or(Path::new("")).join(name);
            Source::read(&beside, FileKind::Machine)?
        }
        None => source,
    };
    let machine: MachineConfig = source.parse()?;
    let folder = source.path.parent().unwrap_or(Path::new(""));
    let (robot, _) = robot::load(machine.arm.as_ref(), folder).map_err(|bad| match bad {
        ArmError::Section(bad) => source.locate(bad),
        ArmError::File(located) => *located,
    })?;
    let joints = machine.joints.clone().unwrap_or_default();
    let robot = joints.applied_to(robot).map_err(|bad| source.locate(bad.within("joints")))?;
    Ok(Described::Boards { machine: Box::new(machine), robot, text: source.text.clone() })
}

fn options(arguments: &CommissionArgs, joints: usize, brake_s: f64) -> anyhow::Result<Options> {
    let only_joint = match arguments.joint {
        None => None,
        Some(joint) if (1..=joints).contains(&joint) => Some(joint - 1),
        Some(joint) => {
            let text = format!("--joint {joint}: the arm has joints 1 to {joints}");
            return Err(BadOption(text).into());
        }
    };
    let (torque_share_max, seek_stops) = (arguments.torque_share, !arguments.no_stops);
    Ok(Options { torque_share_max, brake_s, only_joint, seek_stops })
}

fn pose_rad(
    arguments: &CommissionArgs,
    robot: &AnyRobot,
    usual: &[f64],
) -> anyhow::Result<Vec<f64>> {
    let degrees = if arguments.pose.is_empty() { usual } else { &arguments.pose };
    robot.check_pose("--pose", degrees).map_err(|bad| BadOption(bad.to_string()))?;
    Ok(degrees.iter().map(|q| q.to_radians()).collect())
}

fn simulated(arguments: &CommissionArgs, scene: &Scene) -> anyhow::Result<ExitCode> {
    let pose = pose_rad(arguments, &scene.robot, &scene.start_deg)?;
    let model = Model::new(&scene.robot, &pose);
    let options = options(arguments, model.joints, 0.0)?;
    let (robot, devices) = SimulatedRobot::new(scene, scene.seed)?;
    let mut pace = robot.clone();
    let mut eyes = robot.clone();
    let mut witness = Asking { eyes: Some(&mut eyes), ask: !arguments.yes };
    let cell = Cell::new(devices, &mut pace, robot.period(), Nanos::ZERO)?;
    let file = scene.machine.joints.clone().unwrap_or_default();
    let findings = commission(cell, &model, &mut witness, options)?;
    tell(arguments, &findings, &model, &file, scene.machine_text())
}

fn boards(
    arguments: &CommissionArgs,
    mut machine: MachineConfig,
    robot: &AnyRobot,
    text: &str,
) -> anyhow::Result<ExitCode> {
    let usual: Vec<f64> = robot.home_rad().iter().map(|q| q.to_degrees()).collect();
    let model = Model::new(robot, &pose_rad(arguments, robot, &usual)?);
    let options = options(arguments, model.joints, BOARD_BRAKE_S)?;
    // The boards are asked by their own channels; what the file says of the wiring is in doubt.
    let file = machine.joints.take().unwrap_or_default();
    let opened =
        taktil_machine_boards::open(&machine, robot).map_err(|bad| BadOption(bad.to_string()))?;
    let devices: Devices = opened.devices;
    let mut pace = BoardPace(MonotonicClock::starting_in(Nanos::from_millis(10)));
    let mut witness = Asking { eyes: None, ask: !arguments.yes };
    let cell = Cell::new(devices, &mut pace, BOARD_PERIOD, Nanos::ZERO)?;
    let findings = commission(cell, &model, &mut witness, options)?;
    tell(arguments, &findings, &model, &file, text)
}

fn commission(
    mut cell: Cell<'_>,
    model: &Model,
    witness: &mut dyn Witness,
    options: Options,
) -> anyhow::Result<Findings> {
    let mut progress = |line: &str| {
        // Whoever reads the lines may be gone; the robot is brought to its end anyway.
        let _ = out::line(format_args!("{line}"));
    };
    let commissioning = Commissioning::new(&mut cell, model, witness, &mut progress, options);
    Ok(commissioning.run()?)
}

/// Time on the kernel's clock.
struct BoardPace(MonotonicClock);

impl Pace for BoardPace {
    fn wait_until(&mut self, release: Nanos) {
        self.0.sleep_until(release);
    }
}

/// Somebody at the terminal; before a simulated robot its own observer sees what moved.
struct Asking<'a> {
    eyes: Option<&'a mut SimulatedRobot>,
    ask: bool,
}

impl Asking<'_> {
    fn line(question: &str) -> Result<String, Stop> {
        let broken = |_| Stop::new("the terminal has gone", "run it again at a terminal");
        let mut prompt = std::io::stderr().lock();
        write!(prompt, "{question} ").and_then(|()| prompt.flush()).map_err(broken)?;
        let mut line = String::new();
        match std::io::stdin().lock().read_line(&mut line).map_err(broken)? {
            0 => Err(Stop::new("nobody answers", "run it at a terminal, or with --yes")),
            _ => Ok(line.trim().to_owned()),
        }
    }
}

impl Witness for Asking<'_> {
    fn look(&mut self) {
        if let Some(eyes) = &mut self.eyes {
            eyes.look();
        }
    }

    fn seen(&mut self, shown: &Shown) -> Result<Answer, Stop> {
        if let Some(eyes) = &mut self.eyes {
            return eyes.seen(shown);
        }
        if !std::io::stdin().is_terminal() {
            let what = "which joint moved, and which way, cannot be known without eyes";
            return Err(Stop::new(what, "run it at a terminal, beside the robot"));
        }
        loop {
            let answer = Asking::line(
                "Which joint moved, and did its angle grow? Such as 3+ or 3-; r: once more:",
            )?;
            if answer == "r" {
                return Ok(Answer::Again);
            }
            let (number, sign) = answer.split_at(answer.len().saturating_sub(1));
            if let (Ok(joint @ 1..), "+" | "-") = (number.parse::<usize>(), sign) {
                return Ok(Answer::Moved { joint: joint - 1, grew: sign == "+" });
            }
        }
    }

    fn allow(&mut self, _: usize, what: &str) -> Result<(), Stop> {
        if !self.ask {
            return Ok(());
        }
        match Asking::line(&format!("Next: {what}. Go on? [y/n]"))?.as_str() {
            "y" | "yes" => Ok(()),
            _ => Err(Stop::new("it was not allowed", "run it again when the robot may move")),
        }
    }
}

fn tell(
    arguments: &CommissionArgs,
    findings: &Findings,
    model: &Model,
    file: &JointsConfig,
    machine_text: &str,
) -> anyhow::Result<ExitCode> {
    for difference in findings.differences(file, model) {
        out::line(format_args!("{difference}"))?;
    }
    let section = findings.text(model, &today());
    match &arguments.write {
        None => out::text(&section).map(|_| ())?,
        Some(path) => {
            let text = with_section(machine_text, &section, findings);
            std::fs::write(path, text)
                .with_context(|| format!("cannot write {}", path.display()))?;
            out::line(format_args!("written to {}", path.display()))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// The text of a machine file with its section `[joints]` replaced. The home counts go into
/// `[sense.index]` where the file has no such section yet, else into a comment.
fn with_section(machine_text: &str, section: &str, findings: &Findings) -> String {
    let mut text = String::new();
    let mut within = false;
    for line in machine_text.lines() {
        if line.trim_start().starts_with('[') {
            within = line.trim() == "[joints]";
        }
        if !within {
            text.push_str(line);
            text.push('\n');
        }
    }
    text.push('\n');
    text.push_str(section);
    if let Some(counts) = findings.home_counts() {
        let has_index = text.lines().any(|line| {
            let line = line.trim();
            line == "[sense.index]" || line.starts_with("index =") || line.starts_with("index=")
        });
        let mark = if has_index { "# " } else { "" };
        text.push_str(&format!(
            "\n# Counts of the pose of the commissioning past the index pulses.\n\
             {mark}[sense.index]\n{mark}home_counts = {counts:?}\n"
        ));
    }
    text
}

/// The day, in UTC, by the civil calendar (Hinnant 2013).
fn today() -> String {
    let days = wall_clock().0.max(0).unsigned_abs() / 86_400_000_000_000 + 719_468;
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    let year = year_of_era + 400 * era + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_section_is_replaced_and_the_rest_of_the_file_stays() {
        let file = "[lane.servo]\nperiod_us = 1\n[joints]\nmotor_sign = [1]\n[sense]\nx = 1\n";
        let text = with_section(file, "[joints]\nmotor_sign = [-1]\n", &Findings::default());
        assert!(text.contains("[sense]\nx = 1\n") && text.contains("period_us = 1"));
        assert_eq!(text.matches("motor_sign").count(), 1);
        assert!(text.contains("motor_sign = [-1]"));
    }
}
