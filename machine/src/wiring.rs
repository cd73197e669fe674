//! Assembles a machine: decides which task gets which device half. This is the only module that
//! knows all tasks; it does not know the concrete devices. Robot, rehearsal and tests assemble the
//! same machine here.

use taktil_hal::{
    AnalogIn, AnalogOut, Devices, DigitalIn, DigitalOut, Encoders, ForceTorque, TactileArray,
};
use taktil_mechanics::arm::Arm;
use taktil_mechanics::robot::Robot;
use taktil_rtcore::{Builder, Invalid, Nanos, Ports, Task};
use taktil_signal::renamed::current_port;
use taktil_tasks_actuate::Actuate;
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
use crate::{cpus, tape};

/// Builds the operator's task: a script, a socket, or none.
pub type OperatorBuilder<'a> = Box<dyn FnOnce(&mut Ports) -> Result<Box<dyn Task>, Invalid> + 'a>;

/// Device halves that no task has taken yet.
struct UnassignedDevices {
    encoders: Option<Box<dyn Encoders>>,
    analog_out: Option<Box<dyn AnalogOut>>,
    tactile: Option<Box<dyn TactileArray>>,
    tactile_opposed: Option<Box<dyn TactileArray>>,
    digital_in: Option<Box<dyn DigitalIn>>,
    digital_out: Option<Box<dyn DigitalOut>>,
    force_torque: Option<Box<dyn ForceTorque>>,
    // No task reads these yet. They stay open until the machine is dropped, so that their drivers
    // keep the outputs in their safe states.
    _analog_in: Box<dyn AnalogIn>,
}

impl UnassignedDevices {
    fn new(devices: Devices) -> UnassignedDevices {
        UnassignedDevices {
            encoders: Some(devices.encoders),
            analog_out: Some(devices.analog_out),
            tactile: Some(devices.tactile),
            tactile_opposed: devices.tactile_opposed,
            digital_in: Some(devices.digital_in),
            digital_out: Some(devices.digital_out),
            force_torque: Some(devices.force_torque),
            _analog_in: devices.analog_in,
        }
    }
}

fn take_once<T>(half: &mut Option<T>, task: &str) -> Result<T, Invalid> {
    half.take().ok_or_else(|| {
        let what = format!("`{task}` stands in more than one lane: two producers, one device");
        Invalid::new("", what, "name each task once")
    })
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
    let opposed = devices.tactile_opposed.is_some();
    let mut devices = UnassignedDevices::new(devices);
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
    let has_touch = tasks.any(|task| task == TACTILE_TASK);
    for (name, lane) in &config.lane {
        let outer = format!("lane.{name}");
        let spec = lane.spec(name).map_err(|invalid| invalid.within(&outer))?;
        let period = spec.period;
        let id = builder.lane(spec)?;
        for task in &lane.tasks {
            let place = format!("{outer}.tasks.{task}");
            let make = |ports: &mut Ports| {
                if task == TACTILE_TASK && !robot.is_puma260() {
                    let what = "only the PUMA 260 moves by touch";
                    return Err(Invalid::new("", what, format!("leave `{TACTILE_TASK}` out")));
                }
                if let Some(task) = own::find(task) {
                    return build_own_task(task, &config, robot, ports);
                }
                let devices = &mut devices;
                let context = TaskContext { config: &config, has_touch, opposed, period, devices };
                with_robot!(robot, robot => build_task(task, context, robot, &mut operator, ports))
            };
            builder.task(id, task, make).map_err(|invalid| {
                if invalid.place.is_empty() { invalid.within(&place) } else { invalid }
            })?;
        }
    }
    for (input, signal) in &config.wiring {
        check_current_name(input, input)?;
        check_current_name(input, signal)?;
        builder.bind(input, signal);
    }
    builder.mode_from("supervisor.mode");
    Ok(builder)
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

/// The arguments that the constructors of tasks need.
struct TaskContext<'a> {
    config: &'a MachineConfig,
    has_touch: bool,
    /// Whether the devices have a second array.
    opposed: bool,
    /// Period of the lane that runs the task.
    period: Nanos,
    devices: &'a mut UnassignedDevices,
}

fn build_task<const N: usize, A: Arm<N>>(
    task: &str,
    TaskContext { config, has_touch, opposed, period, devices }: TaskContext<'_>,
    robot: &Robot<N, A>,
    operator: &mut Option<OperatorBuilder<'_>>,
    ports: &mut Ports,
) -> Result<Box<dyn Task>, Invalid> {
    // The section is added to the place afterwards, so that an error names its section.
    let made: Result<Box<dyn Task>, Invalid> = match task {
        "operator" => return take_once(operator, task)?(ports),
        "sense" => {
            let encoders = tape::encoders(take_once(&mut devices.encoders, task)?, ports);
            let lines = tape::digital_in(take_once(&mut devices.digital_in, task)?, ports);
            let config = config.sense.clone().unwrap_or_default();
            Sense::new(config, robot, encoders, lines, ports).map(boxed)
        }
        "actuate" => {
            let analog = tape::analog_out(take_once(&mut devices.analog_out, task)?, ports);
            let digital = tape::digital_out(take_once(&mut devices.digital_out, task)?, ports);
            let config = config.actuate.clone().unwrap_or_default();
            Actuate::new(config, robot, analog, digital, ports).map(boxed)
        }
        "tactile_scan" => {
            let array = tape::tactile(take_once(&mut devices.tactile, task)?, ports);
            TactileScan::new(config.tactile_scan.clone().unwrap_or_default(), array, ports)
                .map(boxed)
        }
        "opposed_scan" => {
            if !opposed {
                let what = "this robot has no second fingertip, whose array this task reads";
                let remedy = "leave `opposed_scan` out; a scene gives one by world.opposed.present";
                return Err(Invalid::new("", what, remedy));
            }
            let array =
                tape::tactile_opposed(take_once(&mut devices.tactile_opposed, task)?, ports);
            TactileScan::new(config.opposed_scan.clone().unwrap_or_default(), array, ports)
                .map(boxed)
        }
        "wrist_scan" => {
            let sensor = tape::force_torque(take_once(&mut devices.force_torque, task)?, ports);
            WristScan::new(config.wrist_scan.unwrap_or_default(), sensor, ports).map(boxed)
        }
        "supervisor" => {
            let config = config.supervisor.clone().unwrap_or_default();
            Supervisor::<N>::new(config, has_touch, ports).map(boxed)
        }
        "jog" => Jog::new(config.jog.clone().unwrap_or_default(), robot, ports).map(boxed),
        "trajectory" => {
            Trajectory::new(config.trajectory.clone().unwrap_or_default(), robot, ports).map(boxed)
        }
        "tactile_servo" => {
            let config = config.tactile_servo.clone().unwrap_or_default();
            config
                .check_period(period.as_secs_f64())
                .and_then(|()| TactileServo::new(config, ports).map(boxed))
        }
        "setpoint" => {
            let config = config.setpoint.clone().unwrap_or_default();
            Setpoint::new(config, robot, has_touch, ports).map(boxed)
        }
        "joint_servo" => {
            JointServo::new(config.joint_servo.clone().unwrap_or_default(), robot, ports).map(boxed)
        }
        _ => {
            let remedy = format!("tasks are: {}; {}", TASK_NAMES.join(", "), own_tasks_remedy());
            return Err(Invalid::new("", format!("there is no task `{task}`"), remedy));
        }
    };
    made.map_err(|invalid| invalid.within(task))
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
