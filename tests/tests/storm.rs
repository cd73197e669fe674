//! A storm of misses in one lane stops the whole robot. The service runs in real time over a
//! board's registers, behind which the simulated arm goes on whatever the lanes do. Only the
//! operator's lane begins to be late, while the servo lane moves the arm.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use taktil_drivers_regmap::registers::BLOCK_BYTES;
use taktil_drivers_regmap::{Config, Loopback, RegisterFile};
use taktil_hal::{CHANNELS, DacCode, Devices, LinesOut, Nanos};
use taktil_machine_service::service::Service;
use taktil_record::Log;
use taktil_rtcore::linux::{monotonic, set_fifo};
use taktil_rtcore::status::LaneHealth;
use taktil_rtcore::{Cycle, FaultCode, FaultSet, Io, Mode, Output, Payload, Task};
use taktil_signal::{ControlState, JogCommand, JointState, OperatorMove, Request, State, Verb};
use taktil_sim::{Timing, World, WorldConfig};
use taktil_tests::bench::{SceneDraft, TemporaryFolder};
use toml::{Table, Value};

/// The job of the operator's lane, of 10 ms each, at which the storm begins.
const STORM_START_JOB: u64 = 140;
/// The length of the run.
const RUN_TIME: Nanos = Nanos::from_millis(2_200);

/// Asks for drives, calibration and the programmed moves; then, where it is to, sleeps through its
/// deadlines.
struct Operator {
    late: bool,
    request: Output<Request>,
    jog: Output<JogCommand>,
    moves: Output<OperatorMove>,
}

impl Task for Operator {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let (sequence, verb) = match cycle.tick {
            0..20 => (0, Verb::None),
            20..60 => (1, Verb::Enable),
            60..80 => (2, Verb::Calibrate),
            _ => (3, Verb::Trajectory),
        };
        io.write(&self.request, Request { verb: verb as u32, sequence });
        io.write(&self.jog, JogCommand::default());
        io.write(&self.moves, OperatorMove::default());
        if self.late && cycle.tick >= STORM_START_JOB {
            std::thread::sleep(Duration::from_millis(12));
        }
        Ok(())
    }
}

/// The simulated arm behind the board's registers.
struct Bench {
    model: Loopback,
    world: World,
    devices: Devices,
}

impl Bench {
    fn new(board: &Config, world: &WorldConfig) -> Bench {
        let registers = Arc::new(RegisterFile::open(board).unwrap());
        let timing = Timing {
            control_period: Nanos::from_millis(1),
            actuation_delay: Nanos::ZERO,
            ..Timing::default()
        };
        let (world, devices) = taktil_sim::build(world, &timing, 1).unwrap();
        Bench { model: Loopback::new(registers, board).unwrap(), world, devices }
    }

    /// One millisecond of the world's own time.
    fn tick(&mut self, now: Nanos) {
        self.model.tick(now);
        self.devices.analog_out.as_mut().unwrap().commit(now, &self.model.dac_codes()).unwrap();
        self.devices.digital_out.as_mut().unwrap().commit(now, &self.model.lines_out()).unwrap();
        self.world.advance(now);
        let counts = self.devices.encoders.as_mut().unwrap().sample(now).unwrap().value;
        self.model.set_counts(counts.map(|count| count.0));
        // Nothing is touched.
        self.model.publish_frame(&[0; 256]);
    }
}

/// What the board and the arm were left with.
struct FinalState {
    volts: [DacCode; CHANNELS],
    lines: LinesOut,
    speed_rad_s: f64,
}

/// The service's file: the machine of the scene of straight lines, with the operator in a lane of
/// its own whose bucket alone can fill.
fn service(folder: &Path, board: &Config) -> (Table, WorldConfig) {
    let draft = SceneDraft::of("lines.toml").set("world.pin.present", false);
    let world = draft.scene().world;
    let machine = draft.value("machine").as_str().unwrap().to_owned();
    let mut lanes: Table = std::fs::read_to_string(machine.as_str()).unwrap().parse().unwrap();
    let mut lanes = lanes.remove("lane").unwrap().as_table().unwrap().clone();
    let servo = lanes["servo"].as_table_mut().unwrap();
    let tasks = servo["tasks"].as_array_mut().unwrap();
    tasks.retain(|task| task.as_str() != Some("operator"));
    servo["budget_us"].as_table_mut().unwrap().remove("operator").unwrap();
    let table = |text: &str| Value::Table(text.parse().unwrap());
    for lane in ["servo", "touch"] {
        // However busy this machine is, its host included.
        let lane = lanes[lane].as_table_mut().unwrap();
        lane.insert("misses".to_owned(), table("bucket = 1000000\nleak_jobs = 1"));
        lane.insert("stall_limit_us".to_owned(), Value::Integer(3_000_000));
    }
    let own = "period_us = 10000\ndelivery_us = 2500\npriority = 60\ntasks = [\"operator\"]\n\
               stall_limit_us = 3000000\nmisses = { bucket = 20, leak_jobs = 2 }";
    lanes.insert("operator".to_owned(), table(own));
    let mut robot = draft.value("robot").as_table().unwrap().clone();
    robot.insert("lane".to_owned(), Value::Table(lanes));
    // One line that lasts beyond the run.
    let line = "line_mm_s = 60.0\n[[moves]]\nstraight = true\nby_mm = [50.0, 60.0, -40.0]";
    robot.insert("trajectory".to_owned(), table(line));
    let home = world.arm.home_deg.map(Value::Float).to_vec();
    robot.insert(
        "sense".to_owned(),
        Value::Table(Table::from_iter([("home_deg".into(), Value::Array(home))])),
    );
    // The arm's thread has no rights here: what it is late by is no fault of the robot's.
    robot.insert("supervisor".to_owned(), table("input_stale_s = 0.5\ntactile_timeout_s = 3.0"));
    robot.insert(
        "actuate".to_owned(),
        table("following_floor_deg = [30.0, 30.0, 30.0, 30.0, 30.0, 30.0]"),
    );
    let text = format!(
        "contract = \"soft\"\n[board]\npath = \"{}\"\nwatchdog_ms = 1000\nstale_ms = 1000\n\
         [flight]\nenabled = false\n[log]\npath = \"{}\"\n",
        board.path.display(),
        folder.join("run.mcap").display()
    );
    let mut file: Table = text.parse().unwrap();
    file.insert("machine".to_owned(), machine.into());
    file.insert("robot".to_owned(), Value::Table(robot));
    (file, world)
}

/// Runs the service for `RUN_TIME`; returns its log and what was left.
fn run(late: bool) -> (Log, FinalState) {
    let folder = TemporaryFolder::new();
    let path = folder.path().join("board.bin");
    let board = Config { path, watchdog_ms: 1000, stale_ms: 1000, ..Config::default() };
    std::fs::write(&board.path, vec![0; BLOCK_BYTES]).unwrap();
    let (file, world) = service(folder.path(), &board);
    let path = folder.path().join("taktild.toml");
    std::fs::write(&path, toml::to_string(&file).unwrap()).unwrap();
    let mut bench = Bench::new(&board, &world);
    let stop = AtomicBool::new(false);
    let left = std::thread::scope(|scope| {
        let cell = scope.spawn(|| {
            // Better in time than not, where that is allowed; judged is what is in the log.
            let _granted = set_fifo(90);
            let begin = monotonic();
            let mut now = Nanos::ZERO;
            while now < RUN_TIME {
                now = Nanos::from_millis((monotonic() - begin).0 / 1_000_000);
                bench.tick(now);
                std::thread::sleep(Duration::from_millis(1));
            }
            let left = FinalState {
                volts: bench.model.dac_codes(),
                lines: bench.model.lines_out(),
                speed_rad_s: bench.world.truth().qd.amax(),
            };
            stop.store(true, Ordering::SeqCst);
            left
        });
        let make = Box::new(|ports: &mut taktil_rtcore::Ports| {
            let operator = Operator {
                late,
                request: ports.output("request"),
                jog: ports.output("jog"),
                moves: ports.output("moves"),
            };
            Ok(Box::new(operator) as Box<dyn Task>)
        });
        let mut service = Service::with_operator(&path, make).unwrap_or_else(|bad| panic!("{bad}"));
        service.run_until(&stop).unwrap();
        cell.join().unwrap()
    });
    (Log::open(&folder.path().join("run.mcap")).unwrap(), left)
}

/// Every value of a signal with its release.
fn values<T: Payload>(log: &Log, name: &str) -> Vec<(Nanos, T)> {
    let channel = log.find(name).unwrap_or_else(|| panic!("there is no `{name}`"));
    let messages = log.messages().filter(|message| message.channel == channel);
    messages.map(|m| (Nanos(m.release_ns), T::decode(&m.body[..T::SIZE]).unwrap())).collect()
}

fn has_storm_fault(faults: u64) -> bool {
    FaultSet(faults).contains(FaultCode::OverrunStorm)
}

/// The fastest joint's mean speed over the 25 ms before an instant, rad/s.
fn mean_speed_rad_s(joints: &[(Nanos, JointState)], at: Nanos) -> f64 {
    let before = |instant: Nanos| joints.iter().rfind(|(release, _)| *release <= instant).unwrap();
    let (from, to) = (before(at - Nanos::from_millis(25)), before(at));
    let ways = from.1.q_rad.iter().zip(&to.1.q_rad).map(|(a, b)| (b - a).abs());
    ways.fold(0.0, f64::max) / (to.0 - from.0).as_secs_f64()
}

#[test]
fn a_storm_in_a_lane_beside_stops_the_arm() {
    let (log, left) = run(true);
    let control: Vec<(Nanos, ControlState)> = values(&log, "supervisor.control");
    let joints: Vec<(Nanos, JointState)> = values(&log, "sense.joints");
    let own: Vec<(Nanos, LaneHealth)> = values(&log, "operator.health");
    let (raised, _) =
        own.iter().find(|(_, health)| has_storm_fault(health.faults)).expect("a storm");
    let (heard, found) =
        control.iter().find(|(_, control)| has_storm_fault(control.faults)).expect("heard");
    let before = control.iter().rfind(|(at, _)| at < heard).expect("a job before").1;
    assert_eq!(before.mode(), Mode::Moving, "{before:?}");
    // Told by the end of that lane's job, acted upon by the servo lane's next ones.
    assert!(*heard - *raised < Nanos::from_millis(60), "raised {raised}, heard {heard}");
    assert_eq!(found.mode(), Mode::Stopping);
    assert!(
        mean_speed_rad_s(&joints, *heard) > 0.1,
        "the arm was on its way: {}",
        mean_speed_rad_s(&joints, *heard)
    );
    let (ended, last) = control.last().unwrap();
    assert_eq!(last.mode(), Mode::Fault, "until somebody resets: {last:?}");
    assert!(mean_speed_rad_s(&joints, *ended) < 1e-3, "{}", mean_speed_rad_s(&joints, *ended));
    // Decelerated under servo, not let fall: the drives went off when it stood.
    let off = control.iter().find(|(at, c)| at > heard && c.mode == last.mode).unwrap().0;
    assert!(mean_speed_rad_s(&joints, off) < 0.06, "{}", mean_speed_rad_s(&joints, off));
    assert!(off - *heard < Nanos::from_millis(1_000), "{heard} to {off}");
    assert_eq!(left.volts, [DacCode(0); CHANNELS]);
    assert!(!left.lines.enable && !left.lines.brake_release, "{:?}", left.lines);
    assert!(left.speed_rad_s < 1e-3, "{}", left.speed_rad_s);
}

#[test]
fn without_the_storm_it_continues() {
    let (log, _) = run(false);
    let control: Vec<(Nanos, ControlState)> = values(&log, "supervisor.control");
    let joints: Vec<(Nanos, JointState)> = values(&log, "sense.joints");
    let (ended, last) = control.last().unwrap();
    // Single misses are this machine's.
    assert!(!has_storm_fault(last.faults), "{last:?}");
    assert_eq!((last.state, last.mode()), (State::Trajectory as u32, Mode::Moving));
    assert!(
        mean_speed_rad_s(&joints, *ended) > 0.1,
        "it stands: {}",
        mean_speed_rad_s(&joints, *ended)
    );
}
