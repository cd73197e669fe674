//! `taktil commission`: the first power-up of a robot, guided at a terminal. A machine file with
//! sections `[device.NAME]`, or a service's configuration, opens real boards; a scene is a
//! simulated robot, wired as its `[world_joints]` say.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::mpsc::{Receiver, TryRecvError};

use anyhow::Context as _;
use taktil_hal::{Clock as _, Nanos};
use taktil_lab_commission::simulated::SimulatedRobot;
use taktil_lab_commission::{
    Answer, Cell, Commissioning, Findings, Model, Options, Pace, Shown, Stop, Witness,
};
use taktil_lab_scene::scene::Scene;
use taktil_machine::joints::JointsConfig;
use taktil_machine::robot::AnyRobot;
use taktil_machine::source::{FileKind, Source};
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;
use taktil_machine_service::boards::{OpenBoards, open_boards_by_channel};
use taktil_rtcore::linux::{MonotonicClock, wall_clock};

use crate::input::lines_of_input;

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
  taktil commission taktild.toml --joint 6 --pose 0,90,-90,0,0,0 --write found.toml

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
    /// Largest torque on a joint that has not answered, in parts of the friction and gravity that
    /// the arm's model gives it
    #[arg(long, value_name = "RATIO", default_value_t = 4.0)]
    friction_ratio: f64,
    /// Time between two cycles with boards, us
    #[arg(long, value_name = "US", default_value_t = 2_500)]
    period_us: u32,
    /// Write the machine file with what was found to this file
    #[arg(long, value_name = "FILE")]
    write: Option<PathBuf>,
}

/// A file that describes a robot.
enum Described {
    Scene(Box<Scene>),
    Boards,
}

/// Commissions the robot.
///
/// # Errors
/// Bad input, located; the reason why the commissioning stopped.
pub fn run(arguments: &CommissionArgs) -> anyhow::Result<ExitCode> {
    if !(0.01..=1.0).contains(&arguments.torque_share) {
        return Err(BadOption("--torque-share: give 0.01 to 1".to_owned()).into());
    }
    if !(1.0..=100.0).contains(&arguments.friction_ratio) {
        return Err(BadOption("--friction-ratio: give 1 to 100".to_owned()).into());
    }
    if !(500..=20_000).contains(&arguments.period_us) {
        return Err(BadOption("--period-us: give 500 to 20000".to_owned()).into());
    }
    match describe(&arguments.config)? {
        Described::Scene(scene) => simulated(arguments, &scene),
        Described::Boards => boards(arguments),
    }
}

fn describe(path: &Path) -> anyhow::Result<Described> {
    let source = Source::read(path, FileKind::Machine)?;
    let table: toml::Table = source.parse()?;
    if table.contains_key("title") {
        return Ok(Described::Scene(Box::new(Scene::load(path)?)));
    }
    Ok(Described::Boards)
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
    let friction_ratio_max = arguments.friction_ratio;
    Ok(Options { torque_share_max, brake_s, only_joint, seek_stops, friction_ratio_max })
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
    let mut witness = Asking::new(Some(&mut eyes), !arguments.yes);
    let cell = Cell::new(devices, &mut pace, robot.period(), Nanos::ZERO)?;
    let file = scene.machine.joints.clone().unwrap_or_default();
    let findings = commission(cell, &model, &mut witness, options)?;
    tell(arguments, &findings, &model, &file, scene.machine_text())
}

fn boards(arguments: &CommissionArgs) -> anyhow::Result<ExitCode> {
    // The boards are asked by their own channels; what the file says of the wiring is in doubt.
    let OpenBoards { config, robot, opened } = open_boards_by_channel(&arguments.config)?;
    let usual: Vec<f64> = robot.home_rad().iter().map(|q| q.to_degrees()).collect();
    let model = Model::new(&robot, &pose_rad(arguments, &robot, &usual)?);
    let options = options(arguments, model.joints, BOARD_BRAKE_S)?;
    let file = config.joints.clone().unwrap_or_default();
    let mut pace = BoardPace(MonotonicClock::starting_in(Nanos::from_millis(10)));
    let mut witness = Asking::new(None, !arguments.yes);
    let period = Nanos::from_micros(i64::from(arguments.period_us));
    let cell = Cell::new(opened.devices, &mut pace, period, Nanos::ZERO)?;
    if let Some(silence) = cell.longest_silence() {
        out::line(format_args!(
            "a pulse that this program cannot end lasts until the boards' watchdog, {silence}"
        ))?;
    }
    let findings = commission(cell, &model, &mut witness, options)?;
    let text = std::fs::read_to_string(&arguments.config)
        .with_context(|| format!("cannot read {}", arguments.config.display()))?;
    tell(arguments, &findings, &model, &file, &text)
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
    fn wait_until(&mut self, release: Nanos) -> Nanos {
        self.0.sleep_until(release);
        self.0.now().max(release)
    }
}

/// Somebody at the terminal, or behind a pipe; before a simulated robot its own observer sees what
/// moved. Lines are read in a thread of their own, so that the boards are fed while he thinks.
struct Asking<'a> {
    eyes: Option<&'a mut SimulatedRobot>,
    ask: bool,
    lines: Option<Receiver<String>>,
    /// A question that waits for its answer.
    has_asked: bool,
}

impl<'a> Asking<'a> {
    fn new(eyes: Option<&'a mut SimulatedRobot>, ask: bool) -> Asking<'a> {
        Asking { eyes, ask, lines: None, has_asked: false }
    }

    /// Asks once, and looks whether a line has come.
    fn line(&mut self, question: &str) -> Result<Option<String>, Stop> {
        let lines = self.lines.get_or_insert_with(lines_of_input);
        if !self.has_asked {
            let mut prompt = std::io::stderr().lock();
            let shown = writeln!(prompt, "{question}").and_then(|()| prompt.flush());
            shown.map_err(|_| Stop::new("the terminal has gone", "run it again at a terminal"))?;
            self.has_asked = true;
        }
        match lines.try_recv() {
            Ok(line) => {
                self.has_asked = false;
                Ok(Some(line.trim().to_owned()))
            }
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => {
                let what = "nobody answers, and which joint moved, and which way, cannot be known \
                            without eyes";
                Err(Stop::new(what, "run it at a terminal, beside the robot"))
            }
        }
    }
}

/// What a line says about a motion; `None` for one that says nothing.
fn seen_motion(line: &str) -> Option<Answer> {
    if line == "r" {
        return Some(Answer::Again);
    }
    let number = line.strip_suffix(['+', '-'])?;
    let joint = number.parse::<usize>().ok()?.checked_sub(1)?;
    Some(Answer::Moved { joint, grew: line.ends_with('+') })
}

impl Witness for Asking<'_> {
    fn look(&mut self) -> Result<bool, Stop> {
        if let Some(eyes) = &mut self.eyes {
            return eyes.look();
        }
        let question = "A joint is about to move by some tenths of a degree. Enter when you look:";
        Ok(self.line(question)?.is_some())
    }

    fn seen(&mut self, shown: &Shown) -> Result<Option<Answer>, Stop> {
        if let Some(eyes) = &mut self.eyes {
            return eyes.seen(shown);
        }
        let question = "Which joint moved, and did its angle grow? Such as 3+ or 3-; r: once more:";
        // A line that says nothing is asked for again.
        Ok(self.line(question)?.and_then(|line| seen_motion(&line)))
    }

    fn allow(&mut self, _: usize, what: &str) -> Result<bool, Stop> {
        if !self.ask {
            return Ok(true);
        }
        match self.line(&format!("Next: {what}. Go on? [y/n]"))?.as_deref() {
            None => Ok(false),
            Some("y" | "yes") => Ok(true),
            Some(_) => Err(Stop::new("it was not allowed", "run it again when the robot may move")),
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
    let section = findings.text(model, file, &today());
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

/// The text of a file with its section `joints` replaced: that of a machine file, or
/// `[robot.joints]` of a service's configuration. The home counts go into `sense.index` where the
/// file has no such
/// section yet, else into a comment.
fn with_section(text_before: &str, section: &str, findings: &Findings) -> String {
    let table: toml::Table = toml::from_str(text_before).unwrap_or_default();
    let prefix = if table.contains_key("machine") { "robot." } else { "" };
    let header = format!("[{prefix}joints]");
    let mut text = String::new();
    let mut within = false;
    for line in text_before.lines() {
        if line.trim_start().starts_with('[') {
            within = line.trim() == header;
        }
        if !within {
            text.push_str(line);
            text.push('\n');
        }
    }
    text.push('\n');
    text.push_str(&section.replace("[joints]", &header));
    if let Some(counts) = findings.home_counts() {
        let robot = match prefix {
            "" => Some(&table),
            _ => table.get("robot").and_then(toml::Value::as_table),
        };
        let sense = robot.and_then(|robot| robot.get("sense"));
        let mark = if sense.is_some_and(|sense| sense.get("index").is_some()) { "# " } else { "" };
        text.push_str(&format!(
            "\n# Counts of the pose of the commissioning past the index pulses.\n\
             {mark}[{prefix}sense.index]\n{mark}home_counts = {counts:?}\n"
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

    #[test]
    fn a_services_configuration_gets_the_section_of_its_robot() {
        let file = "machine = \"m.toml\"\n[robot.joints]\nfull_scale_v = [1]\n[operator]\n";
        let text = with_section(file, "[joints]\nmotor_sign = [-1]\n", &Findings::default());
        assert!(text.contains("[robot.joints]\nmotor_sign = [-1]\n"), "{text}");
        assert!(text.contains("[operator]\n") && !text.contains("full_scale_v"), "{text}");
    }

    #[test]
    fn a_line_says_which_joint_moved_and_which_way_or_nothing() {
        let moved = |joint, grew| Some(Answer::Moved { joint, grew });
        assert_eq!([seen_motion("3+"), seen_motion("12-")], [moved(2, true), moved(11, false)]);
        assert_eq!(seen_motion("r"), Some(Answer::Again));
        for nothing in ["", "+", "0+", "3", "x-", "-3", "3 +"] {
            assert_eq!(seen_motion(nothing), None, "{nothing:?}");
        }
    }
}
