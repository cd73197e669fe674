//! `taktil hal emulate`: serves the simulated robot of a scene through emulated boards until Ctrl-C
//! or for a given time.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use taktil_hal::{Clock, Nanos};
use taktil_lab_emulate::{BoardKind, EmulatedRobot, Places, Server, fault_plan};
use taktil_lab_scene::scene::{self, Scene};
use taktil_machine_console::option::BadOption;
use taktil_machine_console::{out, signals};
use taktil_rtcore::linux::MonotonicClock;

use crate::input::lines_of_input;

/// Within which time faults are drawn where no `--for` says how long the boards are served.
const DRAWN_TIME: Nanos = Nanos::from_secs(60);

/// Which boards are served, before which robot, and what goes wrong.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Boards:
  mesa                           HostMot2 card with a 7I77, on UDP: motors, encoders, lines
  myrmex, flexitac,              tactile arrays, each on a pseudo-terminal; the first one named
  weiss-wts, weiss-dsa           shows the finger's array, the second one the array opposed to it
  regmap                         registers of the project's layout in a file: a whole cell
  vme-arm                        registers of three VME boards in a file: encoders, D/A, A/D
  ethercat                       CiA 402 drives and an EL1008 on a network interface
  can                            drives of CANopen on a CAN bus: motors, positions, lines
  netft                          ATI Net F/T box, on UDP: the gauges of the wrist

Examples:
  taktil hal emulate mesa myrmex --scene sim/scenes/roll-pin.toml --link pad
  taktil hal emulate mesa --address 127.0.0.1:27181 --fault 'kind=loss value=0.01'
  taktil hal emulate myrmex --fault plan.toml --for 60
  taktil hal emulate regmap --link /dev/shm/cell --fault 'kind=frozen target=regmap.encoders at=5'
  taktil hal emulate mesa --scene sim/scenes/commission.toml --eyes
  taktil hal emulate ethercat --interface veth1 --fault 'kind=failing target=ethercat.3 value=1'
  taktil hal emulate can netft --link /run/taktil/can --address 127.0.0.1:49152
  taktil hal emulate can --link vcan0 --fault 'kind=silence target=can.2 at=5'

A plan of faults has a section for each; kinds are loss, duplication, reordering (mesa only), delay,
corruption, truncation, silence, unplugged, restart, frozen and failing, as far as the board has
them; the target of a segment or a bus may name a device of it, the first is 1:
  [[fault]]
  kind = \"delay\"        # what goes wrong
  target = \"mesa\"       # which board; every board when left out
  at = 2.0              # from when on (s); 0 when left out
  for = 0.5             # how long (s); for good when left out
  value = 0.005         # a probability, or the delay (s)

Exit codes: 0 ended by Ctrl-C or --for, 1 a board's interface broke, 2 bad input.")]
pub struct EmulateArgs {
    /// Boards to serve, all before one robot
    #[arg(required = true, value_name = "BOARD")]
    boards: Vec<BoardKind>,
    /// Scene file (TOML) whose robot is served
    #[arg(long, value_name = "SCENE", default_value = "sim/scenes/roll-pin.toml")]
    scene: PathBuf,
    /// Seed of the simulator's noise and of which messages the faults hit, instead of the scene's
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Address and port of a board on UDP, once for each, in their order; port 0, the default, is
    /// any that is free
    #[arg(long, value_name = "ADDRESS:PORT")]
    address: Vec<String>,
    /// Network interface of the segment, such as one end of a veth pair
    #[arg(long, value_name = "IF")]
    interface: Option<String>,
    /// Symbolic link to the pseudo-terminal of a serial board, the file of a board of registers, or
    /// the socket or interface of a CAN bus; once for each, in their order
    #[arg(long, value_name = "PATH")]
    link: Vec<PathBuf>,
    /// A fault, such as "kind=loss target=mesa at=2 for=1 value=0.1", or a file with a plan of them
    #[arg(long, value_name = "FAULT|FILE")]
    fault: Vec<String>,
    /// Draw a plan of faults from this seed, within --for or the first 60 s
    #[arg(long, value_name = "N")]
    fault_seed: Option<u64>,
    /// Let the scene's time begin when a host has sent something, not at once
    #[arg(long)]
    wait: bool,
    /// Priority of SCHED_FIFO at which the boards are served, below that of the lanes
    #[arg(long, value_name = "1..99", value_parser = clap::value_parser!(u8).range(1..=99))]
    priority: Option<u8>,
    /// Print the angles of the joints (deg) for each line on the standard input: what somebody
    /// beside the robot sees, for `taktil commission`
    #[arg(long)]
    eyes: bool,
    /// Seconds after which it ends by itself
    #[arg(long = "for", value_name = "S", allow_negative_numbers = true)]
    for_s: Option<f64>,
}

/// Serves the boards.
///
/// # Errors
/// An error in the scene or a plan of faults, located; [`BadOption`] for a board that the scene has
/// nothing for, or a place that cannot be had; an interface that broke.
pub fn run(arguments: &EmulateArgs) -> anyhow::Result<ExitCode> {
    let length = arguments.for_s.map(|seconds| scene::duration(seconds, "--for")).transpose();
    let length = length.map_err(|bad| BadOption(format!("--for: {}; {}", bad.what, bad.remedy)))?;
    let scene = Scene::load(&arguments.scene)?;
    let boards = &arguments.boards;
    let drawn_within = length.unwrap_or(DRAWN_TIME);
    let plan = fault_plan(&arguments.fault, arguments.fault_seed, boards, drawn_within)?;
    let robot = EmulatedRobot::new(&scene, boards, &plan, arguments.seed.unwrap_or(scene.seed))?;
    let places = Places {
        addresses: arguments.address.clone(),
        interface: arguments.interface.clone(),
        links: arguments.link.clone(),
    };
    let stop = signals::stop_request()?;
    let mut server = Server::open(robot, &places)?.with_priority(arguments.priority);
    if arguments.wait {
        server = server.starting_on_request();
    }
    for board in 0..server.robot().board_count() {
        out::line(format_args!("{} at {}", server.robot().name(board), server.place(board)?))?;
        out::line(format_args!("  {}", server.robot().description(board)))?;
    }
    for fault in plan.faults() {
        out::line(format_args!("fault {fault}"))?;
    }
    out::line(format_args!("ready: {}", scene.title))?;
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    clock.sleep_until(Nanos::ZERO);
    let end = length.unwrap_or(Nanos::MAX);
    let mut moved = |name: &str, place: &Path| {
        // Whoever reads the lines may be gone; the boards go on.
        let _ = out::line(format_args!("{name} at {}", place.display()));
    };
    let looks = arguments.eyes.then(lines_of_input);
    let mut is_over = |robot: &EmulatedRobot| {
        if looks.as_ref().is_some_and(|looks| looks.try_recv().is_ok()) {
            let (q, _) = robot.world().joints();
            let all = q.iter().take(scene.robot.joints());
            let shown: Vec<String> = all.map(|q| format!("{:.4}", q.to_degrees())).collect();
            // Whoever reads the lines may be gone; the boards go on.
            let _ = out::line(format_args!("joints {}", shown.join(" ")));
        }
        robot.now() >= end || stop.is_set()
    };
    let lateness = server.run(&clock, &mut is_over, &mut moved)?;
    let robot = server.robot();
    out::line(format_args!("served {:.3} s: {lateness}", robot.now().as_secs_f64()))?;
    for board in 0..robot.board_count() {
        if let Some(traffic) = robot.traffic(board) {
            out::line(format_args!("{}: {traffic}", robot.name(board)))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}
