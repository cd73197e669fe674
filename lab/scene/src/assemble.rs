//! The whole stack over the simulated robot: scene in, machine out. Refuses to know whether it will
//! run live or in virtual time.

use taktil_hal::Devices;
use taktil_machine::robot::AnyRobot;
use taktil_machine::source::Located;
use taktil_machine::tape::player::{DeviceDescription, MissingEntry, Tapes};
use taktil_machine::wiring;
use taktil_rtcore::{Builder, Invalid, LaneSpec, LatePolicy, Machine, Nanos};
use taktil_sim::{Timing, World};

use super::operator::Operator;
use super::scene::Scene;
use super::world::{FreeArm, Simulation};

/// The lane that simulates the world.
const WORLD: &str = "world";

/// Builds the machine of a scene over a world with this seed.
///
/// # Errors
/// Whatever the scene, the machine file or the wiring got wrong, located.
pub fn assemble(scene: &Scene, seed: u64) -> Result<Machine, Located> {
    assemble_with(scene, seed, script(scene))
}

/// A scene that can be run: read, wired and built.
///
/// # Errors
/// Whatever is wrong with it, located.
pub fn sound_scene(file: &std::path::Path) -> Result<Scene, Located> {
    let scene = Scene::load(file)?;
    assemble(&scene, scene.seed)?;
    Ok(scene)
}

/// As [`assemble`], with somebody else who asks than the scene's script.
///
/// # Errors
/// As [`assemble`].
pub fn assemble_with(
    scene: &Scene,
    seed: u64,
    operator: wiring::OperatorBuilder<'_>,
) -> Result<Machine, Located> {
    whole(scene, seed, operator, false)
}

/// As [`assemble`], with a world that also says what its physics was asked to do: the signal
/// `world.work`, which arms other than the PUMA 260 do not have.
///
/// # Errors
/// As [`assemble`].
pub fn assemble_counted(scene: &Scene, seed: u64) -> Result<Machine, Located> {
    whole(scene, seed, script(scene), true)
}

fn whole(
    scene: &Scene,
    seed: u64,
    operator: wiring::OperatorBuilder<'_>,
    counted: bool,
) -> Result<Machine, Located> {
    let plain = |devices| devices;
    build(scene, seed, plain, operator, counted)
        .and_then(|builder| builder.build().map_err(of_world))
        .and_then(|machine| edited(machine, scene))
        .map_err(|invalid| scene.locate(invalid))
}

/// The world of a scene alone, with the devices through which it is driven and felt.
///
/// # Errors
/// As [`assemble`].
pub fn world(scene: &Scene, seed: u64) -> Result<(World, Devices), Located> {
    let timing = timing(scene).map_err(|invalid| scene.locate(invalid))?;
    built(scene, &timing, seed).map_err(|invalid| scene.locate(invalid))
}

/// The world with the scene's arm in it.
fn built(scene: &Scene, timing: &Timing, seed: u64) -> Result<(World, Devices), Invalid> {
    let start: Vec<f64> = scene.start_deg.iter().map(|q| q.to_radians()).collect();
    let built = match &scene.robot {
        AnyRobot::Puma260(_) => taktil_sim::build(&scene.world, timing, seed),
        AnyRobot::Six(robot) => {
            taktil_sim::build_with_chain(&scene.world, timing, seed, robot, &start)
        }
        AnyRobot::Seven(robot) => {
            taktil_sim::build_with_chain(&scene.world, timing, seed, robot, &start)
        }
    };
    built.map_err(|bad| bad.within("world"))
}

/// The operator who follows the scene's script.
fn script(scene: &Scene) -> wiring::OperatorBuilder<'static> {
    let script = scene.script.clone();
    Box::new(move |ports| Ok(Box::new(Operator::new(script, ports)?)))
}

/// With the scene's edits planned.
fn edited(mut machine: Machine, scene: &Scene) -> Result<Machine, Invalid> {
    machine.plan_edits(&scene.edits).map_err(|bad| match bad.place.strip_suffix(".at") {
        Some(edit) => Invalid { place: format!("{edit}.at_s"), ..bad },
        None => bad,
    })?;
    Ok(machine)
}

/// The machine that repeats a run of this scene and seed: its devices answer from `tapes`, and it
/// bears lanes that stood still for `stall`. Edits are those that were recorded. The tasks
/// `operator` and `world` are to be fed.
///
/// # Errors
/// As [`assemble`].
pub fn rebuild(
    scene: &Scene,
    seed: u64,
    tapes: Tapes,
    stall: Nanos,
) -> Result<(Machine, MissingEntry), Located> {
    let mut lack = MissingEntry::default();
    let taped = |devices: Devices| {
        let (devices, noted) = tapes.devices(&DeviceDescription::from_devices(&devices));
        lack = noted;
        devices
    };
    let machine = build(scene, seed, taped, script(scene), false).and_then(|mut builder| {
        builder.for_replay(stall);
        builder.build().map_err(of_world)
    });
    Ok((machine.map_err(|invalid| scene.locate(invalid))?, lack))
}

fn build(
    scene: &Scene,
    seed: u64,
    exchange: impl FnOnce(Devices) -> Devices,
    operator: wiring::OperatorBuilder<'_>,
    counted: bool,
) -> Result<Builder, Invalid> {
    let mut machine = scene.machine.clone();
    let timing = timing(scene)?;
    // The lane that writes D/A words must be done before they act; that is its deadline.
    for (name, lane) in &mut machine.lane {
        if lane.tasks.iter().any(|task| task == "actuate") {
            let spec =
                lane.spec(name).map_err(|invalid| invalid.within(&format!("lane.{name}")))?;
            let latest = wiring::actuation_deadline(timing.actuation_delay, spec.period)?;
            lane.deadline_us = Some(spec.deadline.min(latest).0 / 1000);
        }
    }
    let (world, devices) = built(scene, &timing, seed)?;
    let mut builder = wiring::assemble(machine, &scene.robot, exchange(devices), operator)?;
    add_world(&mut builder, scene, &timing, world, counted)?;
    Ok(builder)
}

/// The place of a complaint about the world's lane is in the scene, not under `lane`.
fn of_world(bad: Invalid) -> Invalid {
    let place = match bad.place.as_str() {
        "lane.world.priority" => "world_priority",
        "lane.world.cpu" => "world_cpu",
        "lane.world" | "lane.world.budget_us" | "lane.world.budget_us.world" => "world_budget_us",
        _ => return bad,
    };
    Invalid { place: place.into(), ..bad }
}

/// The instants that the simulated boards go by: those of the lanes that read and write them.
fn timing(scene: &Scene) -> Result<Timing, Invalid> {
    let period_of = |task: &str| {
        let lane = scene.machine.lane.iter().find(|(_, lane)| lane.tasks.iter().any(|t| t == task));
        let Some((name, lane)) = lane else { return Ok(None) };
        let spec = lane.spec(name).and_then(|spec| spec.check().map(|()| spec));
        spec.map(|spec| Some(spec.period)).map_err(|bad| bad.within(&format!("lane.{name}")))
    };
    let missing = |task: &str| {
        Invalid::new(
            "lane",
            format!("no lane runs `{task}`: the simulated robot needs it to keep time"),
            format!("add \"{task}\" to the tasks of a lane"),
        )
    };
    let control_period = period_of("actuate")?.ok_or_else(|| missing("actuate"))?;
    let scan_period = period_of("tactile_scan")?.unwrap_or(control_period * 2);
    wiring::actuation_deadline(scene.actuation_delay, control_period)?;
    Ok(Timing { control_period, actuation_delay: scene.actuation_delay, scan_period })
}

fn add_world(
    builder: &mut Builder,
    scene: &Scene,
    timing: &Timing,
    world: World,
    counted: bool,
) -> Result<(), Invalid> {
    let period = timing.control_period;
    // A word of the job released at r acts from r + delay: the world starts there and integrates
    // one period ahead, passing the next sampling instant, at which its answer must be visible.
    let phase = if timing.actuation_delay == period { Nanos::ZERO } else { timing.actuation_delay };
    let delivery = period - phase;
    let priority = u8::try_from(scene.world_priority).map_err(|_| {
        Invalid::new(
            "world_priority",
            format!("{} is not a SCHED_FIFO priority", scene.world_priority),
            "give 1 (lowest) to 99 (highest)",
        )
    })?;
    let budgets = scene.world_budget.map(|budget| (WORLD.to_owned(), budget));
    let lane = builder
        .lane(LaneSpec {
            phase,
            delivery,
            deadline: delivery,
            cpu: scene.world_cpu,
            late: LatePolicy::CatchUp { at_most: u32::MAX },
            budgets: budgets.into_iter().collect(),
            ..LaneSpec::new(WORLD, period, priority)
        })
        .map_err(of_world)?;
    let (radius_mm, table) = (scene.world.pin.radius_mm, &scene.world.table);
    let pivot_mm = [table.pivot_x_mm, table.pivot_y_mm];
    builder.task(lane, WORLD, |ports| match &scene.robot {
        AnyRobot::Puma260(_) => {
            let task = Simulation::new(world, radius_mm, pivot_mm, ports);
            Ok(Box::new(if counted { task.counted(ports) } else { task }))
        }
        AnyRobot::Six(_) => Ok(Box::new(FreeArm::<6>::new(world, ports))),
        AnyRobot::Seven(_) => Ok(Box::new(FreeArm::<7>::new(world, ports))),
    })
}
