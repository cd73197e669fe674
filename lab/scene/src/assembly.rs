//! Builds the machine of a scene: the tasks that a robot runs, wired to the devices of the
//! simulated robot, and the lane that simulates it. Either executor can run the result.

use std::path::Path;

use taktil_hal::fault::FaultPlan;
use taktil_hal::{CHANNELS, Devices};
use taktil_lab_world::Finger;
use taktil_machine::config::MachineConfig;
use taktil_machine::device::{halves_of, move_half};
use taktil_machine::source::Located;
use taktil_machine::tape::player::{DeviceDescription, MissingEntry, Tapes};
use taktil_machine::wiring::{self, OperatorBuilder};
use taktil_rtcore::{Builder, Invalid, LaneSpec, LatePolicy, Machine, Nanos};
use taktil_sim::{Timing, World};

use super::operator::Operator;
use super::scene::Scene;

/// Name of the lane that simulates the world, and of its task.
const WORLD_LANE: &str = "world";

/// Reads a scene and builds its machine once, so that all errors of both files are found.
///
/// # Errors
/// An error of the scene or its machine, located.
pub fn load_checked_scene(file: &Path) -> Result<Scene, Located> {
    let scene = Scene::load(file)?;
    Assembly::new(&scene).build()?;
    Ok(scene)
}

/// A machine over the simulated robot, before it is built.
#[must_use]
pub struct Assembly<'a> {
    scene: &'a Scene,
    seed: u64,
    operator: OperatorBuilder<'a>,
    counts_work: bool,
    without_drives: bool,
    faults: FaultPlan,
}

impl<'a> Assembly<'a> {
    /// The machine of a scene with the scene's own seed, with the scene's script as its operator.
    pub fn new(scene: &'a Scene) -> Assembly<'a> {
        let script = scene.script.clone();
        Assembly {
            scene,
            seed: scene.seed,
            operator: Box::new(move |ports| Ok(Box::new(Operator::new(script, ports)?))),
            counts_work: false,
            without_drives: false,
            faults: scene.faults.clone(),
        }
    }

    /// Uses another seed than the scene's.
    pub fn with_seed(mut self, seed: u64) -> Assembly<'a> {
        self.seed = seed;
        self
    }

    /// Uses another operator than the scene's script.
    pub fn with_operator(mut self, operator: OperatorBuilder<'a>) -> Assembly<'a> {
        self.operator = operator;
        self
    }

    /// Leaves the motors behind converters, whatever loop the drives of the machine close: for
    /// whoever puts drives of another kind before them.
    pub fn without_drives(mut self) -> Assembly<'a> {
        self.without_drives = true;
        self
    }

    /// Adds the signal `world.statistics`, in which the physics counts its steps and iterations.
    /// Hands, and arms other than the PUMA 260 that touch nothing, do not have it.
    pub fn with_work_counts(mut self) -> Assembly<'a> {
        self.counts_work = true;
        self
    }

    /// Adds faults to those of the scene, for halves, lanes, tasks and the clock.
    pub fn with_faults(mut self, plan: &FaultPlan) -> Assembly<'a> {
        let both = self.faults.faults().iter().chain(plan.faults()).cloned();
        self.faults = FaultPlan::new(both.collect());
        self
    }

    /// Builds the machine, with the scene's edits and faults planned.
    ///
    /// # Errors
    /// An error in the scene, the machine file or the wiring, located.
    pub fn build(self) -> Result<Machine, Located> {
        let (scene, faults, seed) = (self.scene, self.faults.clone(), self.seed);
        self.builder(|devices| {
            taktil_machine_fault::decorate(devices, &faults, seed)
                .map_err(|bad| bad.within("world"))
        })
        .and_then(|builder| builder.build().map_err(of_world))
        .and_then(|machine| with_edits(machine, scene))
        .and_then(|mut machine| {
            let injected = machine.inject(&faults, WORLD_LANE);
            injected.map(|()| machine).map_err(|bad| bad.within("world"))
        })
        .map_err(|invalid| scene.locate(invalid))
    }

    /// Builds the machine that repeats a recorded run: its devices answer from `tapes`, and it
    /// tolerates lanes that stood still for `stall`. No edits are planned, because a replay applies
    /// those that were recorded, and of the faults only those of tasks. The caller has to feed the
    /// outputs of the tasks `operator` and `world`.
    ///
    /// # Errors
    /// As [`Assembly::build`].
    pub fn build_replay(
        self,
        tapes: Tapes,
        stall: Nanos,
    ) -> Result<(Machine, MissingEntry), Located> {
        let (scene, faults) = (self.scene, self.faults.clone());
        let mut lack = MissingEntry::default();
        let taped = |devices: Devices| {
            let (devices, lacking) = tapes.devices(&DeviceDescription::from_devices(&devices));
            lack = lacking;
            Ok(devices)
        };
        let machine = self.builder(taped).and_then(|mut builder| {
            builder.for_replay(stall);
            let mut machine = builder.build().map_err(of_world)?;
            machine.inject(&faults, WORLD_LANE).map_err(|bad| bad.within("world"))?;
            Ok(machine)
        });
        Ok((machine.map_err(|invalid| scene.locate(invalid))?, lack))
    }

    /// Builds the world alone, with the devices through which it is driven and sensed.
    ///
    /// # Errors
    /// As [`Assembly::build`].
    pub fn build_world(self) -> Result<(World, Devices), Located> {
        let world = timing(self.scene).and_then(|timing| self.world(&timing));
        world.map_err(|invalid| self.scene.locate(invalid))
    }

    /// The world with the scene's arm in it.
    fn world(&self, timing: &Timing) -> Result<(World, Devices), Invalid> {
        let (scene, seed) = (self.scene, self.seed);
        let start: Vec<f64> = scene.start_deg.iter().map(|q| q.to_radians()).collect();
        let robot = &scene.plain_robot;
        let world = taktil_lab_world::build(robot, &scene.world, timing, seed, &start);
        let (mut world, mut devices) = world.map_err(|bad| bad.within("world"))?;
        let drive_loop = scene.machine.actuate.as_ref().and_then(|actuate| actuate.drive_loop);
        if let Some(name) = drive_loop.filter(|_| !self.without_drives) {
            let added = world.add_drives(&mut devices, name.drive_loop());
            added.map_err(|bad| bad.within("actuate.drive_loop"))?;
        }
        let devices = scene
            .wired
            .as_wired(&scene.plain_robot, devices, &SIMULATED_VOLTS_PER_CODE)
            .map_err(|bad| bad.within("world_joints"))?;
        Ok((world, devices))
    }

    /// The halves that the machine's devices serve, in the order of its joints.
    fn served(&self, mut devices: Devices) -> Result<Devices, Invalid> {
        let machine = &self.scene.machine;
        if !machine.device.is_empty() {
            devices = served_halves(machine, devices)?;
        }
        let Some(joints) = &machine.joints else { return Ok(devices) };
        let connected = joints.connect(&self.scene.robot, devices, &SIMULATED_VOLTS_PER_CODE);
        connected.map_err(|bad| bad.within("joints"))
    }

    /// The machine's builder; `exchange` may replace the simulated devices by others.
    fn builder(
        self,
        exchange: impl FnOnce(Devices) -> Result<Devices, Invalid>,
    ) -> Result<Builder, Invalid> {
        let scene = self.scene;
        let mut machine = scene.machine.clone();
        let timing = timing(scene)?;
        // The lane that writes D/A words must end before they act; that is its deadline.
        for (name, lane) in &mut machine.lane {
            if lane.tasks.iter().any(|task| task == "actuate") {
                let spec =
                    lane.spec(name).map_err(|invalid| invalid.within(&format!("lane.{name}")))?;
                let latest = wiring::actuation_deadline(timing.actuation_delay, spec.period)?;
                lane.deadline_us = Some(spec.deadline.min(latest).0 / 1000);
            }
        }
        let (world, devices) = self.world(&timing)?;
        let devices = exchange(self.served(devices)?)?;
        let mut builder = wiring::assemble(machine, &scene.robot, devices, self.operator)?;
        add_world(&mut builder, scene, &timing, world, self.counts_work)?;
        Ok(builder)
    }
}

/// Volts for one code of the simulated converters, whose range is +-10 V.
const SIMULATED_VOLTS_PER_CODE: [f64; CHANNELS] = [10.0 / 2048.0; CHANNELS];

/// The simulated halves that the sections `[device.NAME]` name, whatever their drivers.
fn served_halves(machine: &MachineConfig, mut all: Devices) -> Result<Devices, Invalid> {
    let mut served = Devices::default();
    for (name, section) in &machine.device {
        let place = format!("device.{name}");
        let (keys, _) = section.split().map_err(|bad| bad.within(&place))?;
        let offered = halves_of(&all);
        let halves = keys.serves.unwrap_or_else(|| offered.into_iter().collect());
        for (at, half) in halves.iter().enumerate() {
            if !move_half(half, &mut all, &mut served) {
                let known = halves_of(&served).contains(half);
                let what = match known {
                    true => format!("`{half}` is served by another device already"),
                    false => format!("the simulated robot has no `{half}`"),
                };
                let place = format!("{place}.serves[{at}]");
                return Err(Invalid::new(place, what, format!("leave `{half}` out")));
            }
        }
    }
    Ok(served)
}

/// Plans the scene's edits.
fn with_edits(mut machine: Machine, scene: &Scene) -> Result<Machine, Invalid> {
    machine.plan_edits(&scene.edits).map_err(|bad| match bad.place.strip_suffix(".at") {
        Some(edit) => Invalid { place: format!("{edit}.at_s"), ..bad },
        None => bad,
    })?;
    Ok(machine)
}

/// Locates an error of the world's lane in the scene, not under `lane`.
fn of_world(bad: Invalid) -> Invalid {
    let place = match bad.place.as_str() {
        "lane.world.priority" => "world_priority",
        "lane.world.cpu" => "world_cpu",
        "lane.world" | "lane.world.budget_us" | "lane.world.budget_us.world" => "world_budget_us",
        _ => return bad,
    };
    Invalid { place: place.into(), ..bad }
}

/// The timing of the simulated boards, from the lanes that read and write them.
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
    let scan = match scene.robot.is_hand() {
        true => "finger1_scan",
        false => "tactile_scan",
    };
    let scan_period = period_of(scan)?.unwrap_or(control_period * 2);
    wiring::actuation_deadline(scene.actuation_delay, control_period)?;
    Ok(Timing { control_period, actuation_delay: scene.actuation_delay, scan_period })
}

fn add_world(
    builder: &mut Builder,
    scene: &Scene,
    timing: &Timing,
    world: World,
    counts_work: bool,
) -> Result<(), Invalid> {
    let period = timing.control_period;
    // A word of the job released at r acts from r + delay. The world starts there and integrates
    // one period ahead, past the next sampling instant, at which its answer must be visible.
    let phase = if timing.actuation_delay == period { Nanos::ZERO } else { timing.actuation_delay };
    let delivery = period - phase;
    let priority = u8::try_from(scene.world_priority).map_err(|_| {
        Invalid::new(
            "world_priority",
            format!("{} is not a SCHED_FIFO priority", scene.world_priority),
            "give 1 (lowest) to 99 (highest)",
        )
    })?;
    let budgets = scene.world_budget.map(|budget| (WORLD_LANE.to_owned(), budget));
    let lane = builder
        .lane(LaneSpec {
            phase,
            delivery,
            deadline: delivery,
            cpu: scene.world_cpu,
            late: LatePolicy::CatchUp { at_most: u32::MAX },
            budgets: budgets.into_iter().collect(),
            ..LaneSpec::new(WORLD_LANE, period, priority)
        })
        .map_err(of_world)?;
    let table = &scene.world.table;
    let finger = Finger {
        pin_radius_mm: scene.world.pin.radius_mm,
        pivot_mm: [table.pivot_x_mm, table.pivot_y_mm],
        has_contact: scene.has_contact(),
        counts_work,
    };
    builder.task(lane, WORLD_LANE, |ports| {
        Ok(taktil_lab_world::task(&scene.robot, &finger, world, ports))
    })
}
