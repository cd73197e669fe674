//! Emulated boards of a whole cell before the simulated robot, in a process of their own, and the
//! service that drives them with its production drivers in another one.
#![allow(dead_code, unreachable_pub, reason = "every test file uses a part of it")]

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use taktil_hal::{Clock, Nanos};
use taktil_lab_emulate::{BoardKind, EmulatedRobot, Places, Server, fault_plan};
use taktil_lab_scene::scene::Scene;
use taktil_rtcore::linux::{MonotonicClock, monotonic};

use crate::process::{Caller, Folder, NO_FLIGHT, Service, command};

/// Environment variable by which a test's own program becomes the boards: the faults, one a line.
const FAULTS_VARIABLE: &str = "TAKTILD_TEST_BOARDS_FAULTS";
/// Environment variables with the file of the registers, or the address of the card and the link to
/// its pad.
const REGISTERS_VARIABLE: &str = "TAKTILD_TEST_REGISTERS";
const CARD_VARIABLE: &str = "TAKTILD_TEST_CARD";
const PAD_VARIABLE: &str = "TAKTILD_TEST_PAD";
/// Priority at which boards are served: below the lanes, above everything that is no board.
const BOARDS_PRIORITY: u8 = 60;
/// For how long the boards are served at most: nothing is left behind by a test that was killed.
const SERVED_TIME_MAX: Nanos = Nanos::from_secs(120);

/// How often a word is said again that the machine does not take yet, or not any more, because a
/// busy host has taken the drives.
pub(crate) const TRIES_MAX: usize = 20;

/// Brings the service's robot up: drives on, arm held.
pub(crate) fn hold(boards: &mut Boards, caller: &mut Caller) {
    for _ in 0..TRIES_MAX {
        caller.ask("reset");
        caller.ask("enable");
        if boards.look_until(|sight| sight.is_enabled && !sight.is_braked).is_enabled {
            return;
        }
    }
    panic!("the drives do not come on: {}", caller.ask("state"));
}

/// Serves boards in this process if its environment says so, until the process is killed; the body
/// of a test of each program that uses [`Boards`].
pub(crate) fn serve_if_asked() {
    let Ok(faults) = std::env::var(FAULTS_VARIABLE) else {
        println!("nothing to do: this is the child of another test");
        return;
    };
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes/roll-pin.toml");
    let scene = Scene::load(&scene).unwrap_or_else(|bad| panic!("{bad}"));
    let variable = |name: &str| std::env::var(name).ok();
    let (kinds, places) = match variable(REGISTERS_VARIABLE) {
        Some(path) => {
            let places = Places { links: vec![path.into()], ..Places::default() };
            (vec![BoardKind::Regmap], places)
        }
        None => {
            let places = Places {
                addresses: variable(CARD_VARIABLE).into_iter().collect(),
                links: variable(PAD_VARIABLE).into_iter().map(Into::into).collect(),
                ..Places::default()
            };
            (vec![BoardKind::Mesa, BoardKind::Myrmex], places)
        }
    };
    let faults: Vec<String> = faults.lines().map(str::to_owned).collect();
    let plan = fault_plan(&faults, None, &kinds, SERVED_TIME_MAX).unwrap();
    let robot = EmulatedRobot::new(&scene, &kinds, &plan, scene.seed).unwrap();
    let priority = taktil_rtcore::linux::is_root().then_some(BOARDS_PRIORITY);
    let mut server = Server::open(robot, &places).unwrap().with_priority(priority);
    server = server.starting_on_request();
    println!("ready {}", server.place(0).unwrap());
    let (asked, questions) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lines().map_while(Result::ok) {
            let _ = asked.send(line);
        }
    });
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    clock.sleep_until(Nanos::ZERO);
    let mut is_over = |robot: &EmulatedRobot| {
        if questions.try_recv().is_ok() {
            let truth = robot.world().truth();
            let speed = truth.qd.amax();
            println!("robot {} {} {speed}", truth.enabled, truth.braked);
        }
        robot.now() >= SERVED_TIME_MAX
    };
    server.run(&clock, &mut is_over, &mut |_, _| {}).unwrap();
}

/// What somebody beside the robot sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sight {
    pub(crate) is_enabled: bool,
    pub(crate) is_braked: bool,
    /// The fastest joint (rad/s).
    pub(crate) speed_rad_s: f64,
}

impl Sight {
    /// Whether drives are off and brakes on.
    pub(crate) fn is_safe(&self) -> bool {
        !self.is_enabled && self.is_braked
    }

    /// The same, of an arm that has come to rest.
    pub(crate) fn is_at_rest(&self) -> bool {
        self.is_safe() && self.speed_rad_s < 0.01
    }
}

/// The process of the boards, killed at the end of its test.
pub(crate) struct Boards {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    /// Where the first board is.
    pub(crate) place: String,
}

impl Boards {
    /// A board of registers in the folder's file `cell`, with these faults by plan; the plan's time
    /// begins with the first word of a host. `child` is the test of this program that calls
    /// [`serve_if_asked`].
    pub(crate) fn registers(folder: &Folder, child: &str, faults: &[&str]) -> Boards {
        let mut command = Boards::command(child, faults);
        command.env(REGISTERS_VARIABLE, folder.join("cell"));
        Boards::start(command)
    }

    /// A card on UDP, and a pad on a pseudo-terminal behind the folder's link `pad`.
    pub(crate) fn card(folder: &Folder, child: &str, faults: &[&str]) -> Boards {
        let mut command = Boards::command(child, faults);
        command.env(CARD_VARIABLE, "127.0.0.1:0").env(PAD_VARIABLE, folder.join("pad"));
        Boards::start(command)
    }

    fn command(child: &str, faults: &[&str]) -> Command {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", child, "--nocapture"]).env(FAULTS_VARIABLE, faults.join("\n"));
        command
    }

    fn start(mut command: Command) -> Boards {
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let input = child.stdin.take().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        let mut boards = Boards { child, input, output, place: String::new() };
        boards.place = boards.answer("ready ");
        boards
    }

    fn answer(&mut self, start: &str) -> String {
        loop {
            let mut line = String::new();
            assert_ne!(self.output.read_line(&mut line).unwrap(), 0, "the boards have ended");
            // The first line may follow what the test harness says without an end of line.
            if let Some((_, rest)) = line.split_once(start) {
                return rest.trim_end().to_owned();
            }
        }
    }

    /// The robot behind the boards, now.
    pub(crate) fn look(&mut self) -> Sight {
        self.input.write_all(b"\n").unwrap();
        let answer = self.answer("robot ");
        let words: Vec<&str> = answer.split(' ').collect();
        Sight {
            is_enabled: words[0].parse().unwrap(),
            is_braked: words[1].parse().unwrap(),
            speed_rad_s: words[2].parse().unwrap(),
        }
    }

    /// Looks until the robot is seen as wanted; what was seen last.
    pub(crate) fn look_until(&mut self, wanted: impl Fn(&Sight) -> bool) -> Sight {
        let mut sight = self.look();
        for _ in 0..1_000 {
            if wanted(&sight) {
                break;
            }
            std::thread::sleep(Duration::from_millis(10));
            sight = self.look();
        }
        sight
    }

    /// Looks for a while at a robot that must not be driven meanwhile.
    pub(crate) fn assert_safe_for(&mut self, time: Duration) {
        let end = monotonic() + Nanos::from_millis(i64::try_from(time.as_millis()).unwrap());
        while monotonic() < end {
            let sight = self.look();
            assert!(sight.is_safe(), "{sight:?}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    pub(crate) fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(i32::try_from(self.child.id()).unwrap()), signal).unwrap();
    }
}

impl Drop for Boards {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Writes the configuration of a service over these boards, with an operator's socket `op`, and
/// `more` at its end; `section` says which boards.
fn config(folder: &Folder, section: &str, more: &str) -> std::path::PathBuf {
    let machine = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes/machine");
    let machine = machine.join("puma260.toml").canonicalize().unwrap();
    let socket = folder.join("op");
    let text = format!(
        "machine = \"{}\"\ncontract = \"soft\"\n[operator]\nsocket = \"{}\"\n{section}\n\
         [robot.sense]\nhome_deg = {HOME_DEG}\n[robot.sense.index]\nignore = true\n\
         [robot.joint_servo]\nassumed_pose_deg = {HOME_DEG}\n{NO_FLIGHT}\n{more}\n",
        machine.display(),
        socket.display(),
    );
    let path = folder.join("taktild.toml");
    std::fs::write(&path, text).unwrap();
    path
}

/// Where the arm of the scene stands.
const HOME_DEG: &str =
    "[0.0, 50.58757564959106, -167.18973377355596, -180.0, 63.3978418760351, 180.0]";

/// The configuration over the registers of [`Boards::registers`].
pub(crate) fn registers_config(folder: &Folder, more: &str) -> std::path::PathBuf {
    let section = format!(
        "[robot.device.cell]\ndriver = \"regmap\"\npath = \"{}\"\n\
         serves = [\"encoders\", \"analog_out\", \"digital_in\", \"digital_out\", \"tactile\"]\n",
        folder.join("cell").display()
    );
    config(folder, &section, more)
}

/// The configuration over the card and the pad of [`Boards::card`].
pub(crate) fn card_config(folder: &Folder, boards: &Boards, more: &str) -> std::path::PathBuf {
    let section = format!(
        "[robot.device.card]\ndriver = \"mesa\"\naddress = \"{}\"\nindex = false\n\
         serves = [\"encoders\", \"analog_out\", \"digital_in\", \"digital_out\"]\n\
         lines_in = {{ drive_power = {{ at = \"field\", number = 0 }}, \
         estop_a = {{ at = \"field\", number = 1 }}, \
         estop_b = {{ at = \"field\", number = 2 }} }}\n\
         lines_out = {{ enable = {{ at = \"field\", number = 0 }}, \
         brake_release = {{ at = \"field\", number = 1 }}, \
         watchdog_feed = {{ at = \"field\", number = 2 }} }}\n\
         [robot.device.pad]\ndriver = \"serial\"\nserves = [\"tactile\"]\nboard = \"myrmex\"\n\
         path = \"{}\"\nrate_hz = 200.0\n\
         thread = {{ priority = 70, period_us = 5000, budget_us = 100 }}\n\
         [robot.joints]\nfull_scale_v = [10.0, 10.0, 10.0, 10.0, 10.0, 10.0]\n",
        boards.place,
        folder.join("pad").display()
    );
    config(folder, &section, more)
}

/// Starts the service and waits until its lanes run.
pub(crate) fn served(folder: &Folder, config: &Path) -> Service {
    served_by(folder, command(config))
}

/// The same by this command.
pub(crate) fn served_by(folder: &Folder, command: Command) -> Service {
    let _ = std::fs::remove_file(folder.join("notify"));
    let service = Service::spawn(folder, command);
    service.wait_for_message("READY=1");
    service.wait_for_message("WATCHDOG=1");
    service
}
