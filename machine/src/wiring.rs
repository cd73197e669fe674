//! Assembles a machine: decides which task gets which device half. This is the only module that
//! knows all tasks; it does not know the concrete devices. Robot, rehearsal and tests assemble the
//! same machine here.

use std::collections::{BTreeMap, BTreeSet};

use taktil_hal::{Devices, TACTILE};
use taktil_mechanics::arm::Arm;
use taktil_mechanics::robot::Robot;
use taktil_rtcore::{Builder, Invalid, Nanos, Ports, Task};
use taktil_signal::renamed::current_port;
use taktil_tasks_actuate::{Actuate, Motors};
use taktil_tasks_analog_scan::AnalogScan;
use taktil_tasks_clock_lock::ClockLock;
use taktil_tasks_grasp::Grasp;
use taktil_tasks_jog::Jog;
use taktil_tasks_joint_servo::JointServo;
use taktil_tasks_sense::Sense;
use taktil_tasks_setpoint::Setpoint;
use taktil_tasks_supervisor::Supervisor;
use taktil_tasks_tactile_scan::TactileScan;
use taktil_tasks_tactile_servo::TactileServo;
use taktil_tasks_trajectory::Trajectory;
use taktil_tasks_wrist_scan::WristScan;

use crate::config::MachineConfig;
use crate::own::{self, OwnTask, TASK_NAMES};
use crate::robot::AnyRobot;
use crate::with_robot;
use crate::{cpus, cross_checks, tape};

/// Builds the operator's task: a script, a socket, or none.
pub type OperatorBuilder<'a> = Box<dyn FnOnce(&mut Ports) -> Result<Box<dyn Task>, Invalid> + 'a>;

/// Device halves that no task has taken yet, and the names of those that were taken. What no task
/// takes stays open until the machine is dropped, so that its driver keeps the outputs safe.
struct UnassignedDevices {
    left: Devices,
    taken: BTreeSet<String>,
}

impl UnassignedDevices {
    /// Takes a half for the task that alone may have it.
    fn take<T>(
        &mut self,
        half: &str,
        task: &str,
        of: impl FnOnce(&mut Devices) -> Option<T>,
    ) -> Result<T, Invalid> {
        if let Some(taken) = of(&mut self.left) {
            self.taken.insert(half.to_owned());
            return Ok(taken);
        }
        if self.taken.contains(half) {
            return Err(in_two_lanes(task));
        }
        let what = format!("no device serves `{half}`, which `{task}` needs");
        let remedy = format!("name `{half}` in `serves` of a device, or leave `{task}` out");
        Err(Invalid::new("", what, remedy))
    }
}

/// How long each task may wait in the halves that it reads or writes, longest case.
fn longest_waits(devices: &Devices) -> BTreeMap<String, Nanos> {
    let of = |wait: Option<Nanos>| wait.unwrap_or(Nanos::ZERO);
    let sense = of(devices.encoders.as_ref().map(|half| half.longest_wait()))
        + of(devices.drive_in.as_ref().map(|half| half.longest_wait()))
        + of(devices.digital_in.as_ref().map(|half| half.longest_wait()));
    let actuate = of(devices.analog_out.as_ref().map(|half| half.longest_wait()))
        + of(devices.drive_out.as_ref().map(|half| half.longest_wait()))
        + of(devices.digital_out.as_ref().map(|half| half.longest_wait()));
    let analog_scan = of(devices.analog_in.as_ref().map(|half| half.longest_wait()));
    let wrist_scan = of(devices.force_torque.as_ref().map(|half| half.longest_wait()));
    let clock_lock = of(devices.board_clock.as_ref().map(|half| half.longest_wait()));
    let named = [
        ("sense", sense),
        ("actuate", actuate),
        ("analog_scan", analog_scan),
        ("wrist_scan", wrist_scan),
        ("clock_lock", clock_lock),
    ];
    let mut waits: BTreeMap<String, Nanos> =
        named.into_iter().map(|(task, wait)| (task.to_owned(), wait)).collect();
    for (array, half) in &devices.tactile {
        let task = match array.strip_prefix(TACTILE) {
            Some(rest) if !rest.is_empty() => format!("{}_scan", rest.trim_start_matches('_')),
            _ => format!("{TACTILE}_scan"),
        };
        waits.insert(task, half.longest_wait());
    }
    waits
}

fn in_two_lanes(task: &str) -> Invalid {
    let what = format!("`{task}` stands in more than one lane: two producers, one device");
    Invalid::new("", what, "name each task once")
}

fn take_once<T>(half: &mut Option<T>, task: &str) -> Result<T, Invalid> {
    half.take().ok_or_else(|| in_two_lanes(task))
}

/// The name in [`Devices::tactile`] of the array that a task reads: `tactile_scan` the fingertip's,
/// `NAME_scan` that of `tactile_NAME`.
fn array_of_task(task: &str) -> Option<String> {
    match task.strip_suffix("_scan")? {
        TACTILE => Some(TACTILE.to_owned()),
        name => Some(format!("{TACTILE}_{name}")),
    }
}

/// Assembles a machine from its description, its arm and a set of devices.
///
/// # Errors
/// The first error, located at its dotted path in the description.
pub fn assemble(
    config: MachineConfig,
    robot: &AnyRobot,
    devices: Devices,
    operator: OperatorBuilder<'_>,
) -> Result<Builder, Invalid> {
    let arrays: BTreeSet<String> = devices.tactile.keys().cloned().collect();
    let (waits, silence) = (longest_waits(&devices), cross_checks::shortest_silence(&devices));
    cross_checks::check(&config, &devices)?;
    let mut devices = UnassignedDevices { left: devices, taken: BTreeSet::new() };
    check_names(&config)?;
    check_no_idle_lane(&config)?;
    let mut builder = Builder::new();
    builder.allowance(config.schedule.unwrap_or_default().allowance()?)?;
    if let Some(record) = config.record {
        builder.recording(record.recording());
    }
    // Where the kernel does not report the CPUs, the read-back at the start decides.
    if let Some(online) = cpus::online() {
        builder.cpus(online);
    }
    let mut operator = Some(operator);
    let mut tasks = config.lane.values().flat_map(|lane| &lane.tasks);
    let has_touch = tasks.any(|task| [TACTILE_TASK, GRASP_TASK].contains(&task.as_str()));
    for (name, lane) in &config.lane {
        let outer = format!("lane.{name}");
        let mut spec = lane.spec(name).map_err(|invalid| invalid.within(&outer))?;
        for (task, budget) in &mut spec.budgets {
            *budget += waits.get(task).copied().unwrap_or(Nanos::ZERO);
        }
        let period = spec.period;
        let id = builder.lane(spec)?;
        for task in &lane.tasks {
            let place = format!("{outer}.tasks.{task}");
            let make = |ports: &mut Ports| {
                if task == TACTILE_TASK {
                    check_fingertip(&config)?;
                }
                if task == GRASP_TASK {
                    return build_grasp(&config, robot, ports);
                }
                if let Some(task) = own::find(task) {
                    return build_own_task(task, &config, robot, ports);
                }
                let devices = &mut devices;
                let (config, arrays) = (&config, &arrays);
                let context = TaskContext { config, has_touch, arrays, period, silence, devices };
                with_robot!(robot, robot => build_task(task, context, robot, &mut operator, ports))
            };
            builder.task(id, task, make).map_err(|invalid| {
                if invalid.place.is_empty() { invalid.within(&place) } else { invalid }
            })?;
        }
    }
    count_threads(&config, &mut builder)?;
    bind_signals(&config, &mut builder)?;
    Ok(builder)
}

/// Binds inputs to signals as the description says, and what every machine binds alike.
fn bind_signals(config: &MachineConfig, builder: &mut Builder) -> Result<(), Invalid> {
    for (input, signal) in &config.wiring {
        check_current_name(input, input)?;
        check_current_name(input, signal)?;
        builder.bind(input, signal);
    }
    bind_readings_of_actuate(config, builder);
    builder.mode_from("supervisor.mode");
    if runs(config, "clock_lock") {
        builder.pace_from("clock_lock.pace");
    }
    Ok(())
}

/// Binds what `actuate` reads by itself: the reports of drives that close a loop, and what the
/// fingertip feels. A file may name another signal.
fn bind_readings_of_actuate(config: &MachineConfig, builder: &mut Builder) {
    let readings = [
        ("actuate.drives", "sense.drives", closes_loop(config)),
        ("actuate.features", "tactile_servo.features", runs(config, "tactile_servo")),
    ];
    for (input, signal, is_read) in readings {
        if is_read && runs(config, "actuate") && !config.wiring.contains_key(input) {
            builder.bind(input, signal);
        }
    }
}

/// Refuses a machine without lanes and a section of a task that the program does not have.
fn check_names(config: &MachineConfig) -> Result<(), Invalid> {
    if config.lane.is_empty() {
        return Err(Invalid::new(
            "lane",
            "the machine has no lanes: nothing would run",
            "name a machine file with `machine = \"...\"`, or write [lane.NAME] sections",
        ));
    }
    if let Some(name) = config.own.keys().find(|name| own::find(name).is_none()) {
        let what = format!("this program has no task `{name}` of its own");
        return Err(Invalid::new(format!("own.{name}"), what, own_tasks_remedy()));
    }
    Ok(())
}

/// Has the analysis count the threads of drivers that declare a budget.
fn count_threads(config: &MachineConfig, builder: &mut Builder) -> Result<(), Invalid> {
    for (name, section) in &config.device {
        let place = format!("device.{name}");
        let (keys, _) = section.split().map_err(|bad| bad.within(&place))?;
        if let Some(thread) = keys.thread.demand(name) {
            builder.thread_beside(thread);
        }
    }
    Ok(())
}

/// Refuses the old name of a port that was renamed, in the line of the wiring that binds `input`.
fn check_current_name(input: &str, port: &str) -> Result<(), Invalid> {
    let new = current_port(port);
    if new == port {
        return Ok(());
    }
    let what = format!("unknown port `{port}`; it is called `{new}` now");
    Err(Invalid::new(format!("wiring.{input}"), what, format!("write `{new}`")))
}

/// A lane without tasks is an error, because it would cost processor time for nothing.
fn check_no_idle_lane(config: &MachineConfig) -> Result<(), Invalid> {
    let idle = config.lane.iter().find(|(_, lane)| lane.tasks.is_empty());
    idle.map_or(Ok(()), |(name, _)| {
        let remedy = "name its tasks, or leave the lane out";
        Err(Invalid::new(format!("lane.{name}.tasks"), "a lane without a task", remedy))
    })
}

/// The task that moves by touch; only a machine that runs it needs a tactile sensor.
const TACTILE_TASK: &str = "tactile_servo";
/// The task by which a hand grasps; only a hand runs it.
const GRASP_TASK: &str = "grasp";

/// That an arm which moves by touch carries a fingertip.
fn check_fingertip(config: &MachineConfig) -> Result<(), Invalid> {
    if config.has_fingertip() {
        return Ok(());
    }
    let remedy =
        format!("say in [arm.fingertip] where on the arm it is, or leave `{TACTILE_TASK}` out");
    Err(Invalid::new("", "the arm carries no fingertip", remedy))
}

/// Builds the task of a hand.
fn build_grasp(
    config: &MachineConfig,
    robot: &AnyRobot,
    ports: &mut Ports,
) -> Result<Box<dyn Task>, Invalid> {
    let config = config.grasp.clone().unwrap_or_default();
    let made = match robot {
        AnyRobot::TwoFingers(robot) => Grasp::new(&config, robot.arm, ports).map(boxed),
        AnyRobot::ThreeFingers(robot) => Grasp::new(&config, robot.arm, ports).map(boxed),
        AnyRobot::TwoFingersOnArm(robot) => Grasp::new(&config, robot.arm, ports).map(boxed),
        AnyRobot::ThreeFingersOnArm(robot) => Grasp::new(&config, robot.arm, ports).map(boxed),
        _ => {
            let what = "only a hand grasps";
            let remedy = format!("leave `{GRASP_TASK}` out, or name the tips of a hand in [arm]");
            return Err(Invalid::new("", what, remedy));
        }
    };
    made.map_err(|invalid| invalid.within(GRASP_TASK))
}

/// The arguments that the constructors of tasks need.
struct TaskContext<'a> {
    config: &'a MachineConfig,
    has_touch: bool,
    /// Names of the tactile arrays.
    arrays: &'a BTreeSet<String>,
    /// Period of the lane that runs the task.
    period: Nanos,
    /// Shortest silence after which an output lets go by itself.
    silence: Nanos,
    devices: &'a mut UnassignedDevices,
}

fn build_task<const N: usize, A: Arm<N>>(
    task: &str,
    TaskContext { config, has_touch, arrays, period, silence, devices }: TaskContext<'_>,
    robot: &Robot<N, A>,
    operator: &mut Option<OperatorBuilder<'_>>,
    ports: &mut Ports,
) -> Result<Box<dyn Task>, Invalid> {
    // The section is added to the place afterwards, so that an error names its section.
    let made: Result<Box<dyn Task>, Invalid> = match task {
        "operator" => return take_once(operator, task)?(ports),
        "sense" => return build_sense(config, devices, robot, ports),
        "actuate" => return build_actuate(config, devices, robot, ports),
        "analog_scan" => {
            let board = devices.take("analog_in", task, |left| left.analog_in.take())?;
            let board = tape::analog_in(board, ports);
            let config = config.analog_scan.clone().unwrap_or_default();
            AnalogScan::new(&config, board, ports).map(boxed)
        }
        "wrist_scan" => {
            let sensor = devices.take("force_torque", task, |left| left.force_torque.take())?;
            let sensor = tape::force_torque(sensor, ports);
            WristScan::new(config.wrist_scan.unwrap_or_default(), sensor, ports).map(boxed)
        }
        "clock_lock" => {
            let clock = devices.take("board_clock", task, |left| left.board_clock.take())?;
            let clock = tape::board_clock(clock, ports);
            ClockLock::new(config.clock_lock.unwrap_or_default(), clock, period, ports).map(boxed)
        }
        "supervisor" => {
            let config = config.supervisor.clone().unwrap_or_default();
            let task = Supervisor::<N>::new(config, has_touch, ports);
            task.map(|task| boxed(task.with_silence(silence)))
        }
        "jog" => Jog::new(config.jog.clone().unwrap_or_default(), robot, ports).map(boxed),
        "trajectory" => {
            Trajectory::new(config.trajectory.clone().unwrap_or_default(), robot, ports).map(boxed)
        }
        "tactile_servo" => {
            let config = config.tactile_servo.clone().unwrap_or_default();
            config
                .check_period(period.as_secs_f64())
                .and_then(|()| TactileServo::new(config, robot, ports).map(boxed))
        }
        "setpoint" => {
            let config = config.setpoint.clone().unwrap_or_default();
            Setpoint::new(config, robot, has_touch, ports).map(boxed)
        }
        "joint_servo" => {
            JointServo::new(config.joint_servo.clone().unwrap_or_default(), robot, ports).map(boxed)
        }
        scan if is_array_scan(scan, arrays) => build_array_scan(scan, config, devices, ports),
        _ => {
            let remedy = format!("tasks are: {}; {}", TASK_NAMES.join(", "), own_tasks_remedy());
            return Err(Invalid::new("", format!("there is no task `{task}`"), remedy));
        }
    };
    made.map_err(|invalid| invalid.within(task))
}

/// Builds the task that reads encoders, lines and drives.
fn build_sense<const N: usize, A: Arm<N>>(
    config: &MachineConfig,
    devices: &mut UnassignedDevices,
    robot: &Robot<N, A>,
    ports: &mut Ports,
) -> Result<Box<dyn Task>, Invalid> {
    let encoders = devices.take("encoders", "sense", |left| left.encoders.take())?;
    let lines = devices.take("digital_in", "sense", |left| left.digital_in.take())?;
    let encoders = tape::encoders(encoders, ports);
    let lines = tape::digital_in(lines, ports);
    let sense = config.sense.clone().unwrap_or_default();
    let sense = Sense::new(sense, robot, encoders, lines, ports);
    let sense = sense.map_err(|bad| bad.within("sense"))?;
    if !closes_loop(config) {
        return Ok(boxed(sense));
    }
    let drives = devices.take("drive_in", "sense", |left| left.drive_in.take())?;
    let sense = sense.with_drives(tape::drive_in(drives, ports), ports);
    sense.map(boxed).map_err(|bad| bad.within("sense"))
}

/// Builds the task that drives the motors.
fn build_actuate<const N: usize, A: Arm<N>>(
    config: &MachineConfig,
    devices: &mut UnassignedDevices,
    robot: &Robot<N, A>,
    ports: &mut Ports,
) -> Result<Box<dyn Task>, Invalid> {
    let motors = if closes_loop(config) {
        let drives = devices.take("drive_out", "actuate", |left| left.drive_out.take())?;
        Motors::Drives(tape::drive_out(drives, ports))
    } else {
        let analog = devices.take("analog_out", "actuate", |left| left.analog_out.take())?;
        Motors::Converters(tape::analog_out(analog, ports))
    };
    let digital = devices.take("digital_out", "actuate", |left| left.digital_out.take())?;
    let digital = tape::digital_out(digital, ports);
    // The counts that `actuate` watches are those of the board, as `sense` reads them.
    let scale = config.sense.as_ref().map_or(1.0, |sense| sense.encoder_scale);
    let gears = robot.gears.with_encoder_scale(scale);
    let robot = &Robot { gears, ..robot.clone() };
    let actuate = config.actuate.clone().unwrap_or_default();
    let actuate = Actuate::new(actuate, robot, motors, digital, ports)
        .map_err(|bad| bad.within("actuate"))?;
    if runs(config, "tactile_servo") {
        let array = config.tactile_servo.clone().unwrap_or_default().array;
        return Ok(boxed(
            actuate.with_touch([array.pitch_x_mm, array.pitch_y_mm].map(|mm| 1e-3 * mm), ports),
        ));
    }
    // A hand that grasps holds its own joints by what it grasps.
    Ok(if runs(config, "grasp") { boxed(actuate) } else { boxed(actuate.without_touch()) })
}

/// Whether a lane runs this task.
fn runs(config: &MachineConfig, task: &str) -> bool {
    config.lane.values().any(|lane| lane.tasks.iter().any(|name| name == task))
}

/// Whether the motors are driven by drives that close a loop themselves.
fn closes_loop(config: &MachineConfig) -> bool {
    config.actuate.as_ref().is_some_and(|actuate| actuate.drive_loop.is_some())
}

/// Whether the task of this name reads a tactile array.
fn is_array_scan(task: &str, arrays: &BTreeSet<String>) -> bool {
    ["tactile_scan", "opposed_scan"].contains(&task)
        || array_of_task(task).is_some_and(|array| arrays.contains(&array))
}

/// Builds the task that reads a tactile array.
fn build_array_scan(
    task: &str,
    config: &MachineConfig,
    devices: &mut UnassignedDevices,
    ports: &mut Ports,
) -> Result<Box<dyn Task>, Invalid> {
    let array = array_of_task(task).unwrap_or_default();
    let half = devices.take(&array, task, |left| left.tactile.remove(&array)).map_err(|bad| {
        match task == "opposed_scan" && !bad.what.contains("two producers") {
            true => Invalid {
                remedy: format!("{}; a scene gives one by world.opposed.present", bad.remedy),
                ..bad
            },
            false => bad,
        }
    })?;
    let config = match task {
        "tactile_scan" => config.tactile_scan.clone(),
        "opposed_scan" => config.opposed_scan.clone(),
        _ => config.scan.get(task.trim_end_matches("_scan")).cloned(),
    };
    let half = tape::tactile(half, &array, ports);
    TactileScan::new(config.unwrap_or_default(), half, ports).map(boxed)
}

/// Builds a registered task of the program.
fn build_own_task(
    task: &OwnTask,
    config: &MachineConfig,
    robot: &AnyRobot,
    ports: &mut Ports,
) -> Result<Box<dyn Task>, Invalid> {
    let section = config.own.get(task.name).cloned().unwrap_or_default();
    let made = (task.make)(&section, robot, ports);
    made.map_err(|invalid| invalid.within(&format!("own.{}", task.name)))
}

/// Text that lists the registered tasks of this program.
fn own_tasks_remedy() -> String {
    let names: Vec<&str> = own::tasks().iter().map(|task| task.name).collect();
    match names.as_slice() {
        [] => "a task of one's own needs a program of one's own that names it".to_owned(),
        names => format!("its own are: {}", names.join(", ")),
    }
}

fn boxed<T: Task + 'static>(task: T) -> Box<dyn Task> {
    Box::new(task)
}

/// The tightest deadline that an actuation delay leaves to the lane that writes the D/A words.
///
/// # Errors
/// A delay outside (0, period]; the place is `actuation_delay_us`.
pub fn actuation_deadline(delay: Nanos, period: Nanos) -> Result<Nanos, Invalid> {
    if delay > Nanos::ZERO && delay <= period {
        return Ok(delay);
    }
    Err(Invalid::new(
        "actuation_delay_us",
        format!("a delay of {delay} is not within one period of {period}"),
        "give more than 0 and at most the period of the lane that actuates",
    ))
}
