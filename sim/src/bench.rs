//! Puts a bench together from its description: checks it, solves the contacts, sets the pin on the
//! table in static balance, connects the devices, latches the first samples. Refuses scenes whose
//! stiffness the integration step cannot follow.

use glam::{DMat3, DVec3};
use taktil_contact::Accuracy;
use taktil_hal::{AXES, AdcCode, CHANNELS, Counts, Devices, LinesOut, Nanos};
use taktil_mechanics::rigid_body::GRAVITY_M_S2;
use taktil_mechanics::robot::ChainRobot;
use taktil_mechanics::spatial::rotation_z;
use taktil_mechanics::transmission::Drive;

use crate::arm::{Arm, JOINTS};
use crate::carriage::{Carriage, Riding};
use crate::chained::Chained;
use crate::contact::{PAD_HALF_M, Patch, Reaction, Surface};
use crate::devices::connect;
use crate::electronics::{Array, Tip, Wrist};
use crate::faults::Faults;
use crate::fidelity::{ArmModel, ContactModel, Integrator};
use crate::finger::{Finger, Unheld};
use crate::hand::Hand;
use crate::index::Index;
use crate::object::Objects;
use crate::opposed::Opposed;
use crate::pin::Pin;
use crate::rolling::Rolling;
use crate::rubber::Rubber;
use crate::scene::{Invalid, PinConfig, RubberConfig, TactileConfig, Timing, WorldConfig, invalid};
use crate::snapshot::{Feed, Told};
use crate::spatial::Spatial;
use crate::step::{Bench, Habit, Method, Work};
use crate::table::Table;
use crate::world::World;

/// Load at which the stability of the integration is judged (N): four times the rolling task's.
/// Sixteen times the stiffness at this load is where the integration would break.
pub const RATED_LOAD_N: f64 = 60.0;
/// Largest product of step and natural frequency that is accepted.
const STEP_FREQUENCY_MAX: f64 = 0.5;
/// Largest share of a step's stability that contact damping may take.
const STEP_DAMPING_MAX: f64 = 1.0;

/// Builds the bench with the arm.
///
/// # Errors
/// [`Invalid`] with the place inside the configuration: see [`WorldConfig::check`]; also a contact
/// that cannot be solved, a start outside the joints' ranges, a step too long for the stiffness.
pub fn build(
    config: &WorldConfig,
    timing: &Timing,
    seed: u64,
) -> Result<(World, Devices), Invalid> {
    config.check()?;
    timing.check()?;
    let arm = Arm::new(&config.arm, config.fidelity.arm, config.arm_every)?;
    let mass_kg = arm.mass_at_tool_kg();
    let board = (JOINTS, Drive::reference().code_range());
    assemble(config, timing, seed, (Finger::Arm(Box::new(arm)), mass_kg), board)
}

/// Builds the bench with another arm, which starts at `start` (rad) and touches nothing.
///
/// # Errors
/// As [`build`]; a pin or an object, which this arm could not feel, and an integrator that it
/// cannot have.
pub fn build_with_chain<const N: usize>(
    config: &WorldConfig,
    timing: &Timing,
    seed: u64,
    robot: &ChainRobot<N>,
    start: &[f64],
) -> Result<(World, Devices), Invalid> {
    config.check()?;
    timing.check()?;
    if config.pin.present {
        let what = "is true, but only the PUMA 260 feels a pin".to_owned();
        return Err(invalid("pin.present", what, "say false: other arms move freely"));
    }
    if !config.object.is_empty() {
        let what = "stands there, but only the PUMA 260 feels objects".to_owned();
        return Err(invalid("object", what, "leave it out: other arms move freely"));
    }
    if config.fidelity.integrator != Integrator::Auto {
        let what = "is named, but this arm has a method of its own".to_owned();
        return Err(invalid("fidelity.integrator", what, "say auto"));
    }
    let arm = Chained::new(robot, start, &config.arm, config.fidelity.arm)?;
    let finger = Finger::Chained(Box::new(Unheld::new(Box::new(arm))));
    assemble(config, timing, seed, (finger, None), (N, robot.drive.code_range()))
}

/// Builds the bench with a finger on rails instead of the arm; the encoders read zero.
///
/// # Errors
/// As [`build`]; `carriage` when its path or its float is not finite or not in order.
pub fn build_with_carriage(
    config: &WorldConfig,
    timing: &Timing,
    seed: u64,
    carriage: Carriage,
) -> Result<(World, Devices), Invalid> {
    config.check()?;
    timing.check()?;
    carriage.check()?;
    let riding = Riding::new(carriage);
    let mass_kg = riding.mass_kg();
    let board = (JOINTS, Drive::reference().code_range());
    assemble(config, timing, seed, (Finger::Carriage(Box::new(riding)), mass_kg), board)
}

fn assemble(
    config: &WorldConfig,
    timing: &Timing,
    seed: u64,
    (finger, finger_kg): (Finger, Option<f64>),
    board: (usize, (i32, i32)),
) -> Result<(World, Devices), Invalid> {
    let table = Table::new(&config.table, config.table_height_mm());
    let rolling = if config.pin.present {
        let rolling = put_pin(config, &table, finger.pose().translation)?;
        if config.fidelity.integrator == Integrator::Euler {
            check_step(config, &rolling, finger_kg)?;
        }
        Some(Box::new(rolling))
    } else {
        None
    };
    let objects = Objects::new(config, &table, finger.pose().translation)?;
    let opposed = config.opposed.present;
    let array = |tactile: &TactileConfig, tip: Tip| {
        let array = tactile.present.then(|| Array::new(tactile, timing, seed, tip));
        array.transpose().map(|array| array.map(Box::new))
    };
    let arrays = [
        array(&config.tactile, Tip::Finger)?,
        if opposed { array(&config.opposed.tactile, Tip::Opposed)? } else { None },
    ];
    let feeds =
        [Some(Feed::of(&config.tactile)), opposed.then(|| Feed::of(&config.opposed.tactile))];
    let told = Told { board, feeds, ..Told::default() };
    let index = index(config, &finger)?;
    let (ends, devices) = connect(timing.actuation_delay, board, index.is_some(), told.facts());
    let bench = Bench {
        method: method(config, &finger)?,
        finger,
        rolling,
        objects,
        table,
        substep: Nanos((1e3 * config.substep_us).round() as i64),
        error_m: 0.0,
        work: Work::default(),
        habit: Habit::default(),
        felt: false,
    };
    let mut world = World {
        t: Nanos::ZERO,
        timing: *timing,
        power_on: Nanos((1e9 * config.arm.power_on_s).round() as i64),
        bench,
        arrays,
        wrist: config.wrist.present.then(|| Wrist::new(&config.wrist, seed)),
        faults: Faults::new(&config.fault, seed),
        ends,
        next_control: Nanos::ZERO,
        sequences: [0; 2],
        counts: [Counts(0); CHANNELS],
        index,
        gauges: [AdcCode(0); AXES],
        codes: [0; CHANNELS],
        orders: LinesOut::SAFE,
        last_word: Nanos::ZERO,
        last_feed: Nanos::ZERO,
        told,
    };
    world.latch();
    check_start(&world.bench)?;
    Ok((world, devices))
}

/// Refuses a finger that starts inside the pin or an object, or deeper in its rubber than small
/// strain goes: the first step would be an explosion.
fn check_start(bench: &Bench) -> Result<(), Invalid> {
    let mut inside = None;
    if let Some(rolling) = &bench.rolling {
        let deepest_m = rolling.pad.slices.each().map(|slice| slice.delta_m).fold(0.0, f64::max);
        if deepest_m > rolling.pad.rubber.deepest_m() {
            inside = Some(("pin".to_owned(), deepest_m));
        }
    }
    if let Some(objects) = &bench.objects {
        let found = objects.too_deep().map(|(i, deep_m)| (format!("object[{i}]"), deep_m));
        inside = inside.or(found);
    }
    let Some((place, deep_m)) = inside else { return Ok(()) };
    let what = format!("stands {:.3} mm inside the finger's rubber at the start", 1e3 * deep_m);
    let remedy = "start the finger higher, or put the table (table.height_mm) lower";
    Err(invalid(&place, what, remedy))
}

/// The index pulses of the discs, if the scene gives them any.
fn index(config: &WorldConfig, finger: &Finger) -> Result<Option<Index>, Invalid> {
    let Some(before) = &config.arm.index_counts else { return Ok(None) };
    let (home, per_rev) = match finger {
        Finger::Arm(arm) => arm.home_counts(&config.arm),
        Finger::Chained(unheld) => unheld.arm.home_counts(),
        Finger::Carriage(_) => return Ok(None),
    };
    Index::new(before, &home, &per_rev).map(Some)
}

/// The integrator for what is on the bench.
fn method(config: &WorldConfig, finger: &Finger) -> Result<Method, Invalid> {
    let free = matches!(finger, Finger::Arm(arm) if arm.is_smooth());
    let smooth = free && !config.pin.present && config.object.is_empty();
    let integrator = config.fidelity.integrator;
    if matches!(finger, Finger::Chained(_)) {
        // Its own step, taken in order.
        return Ok(Method::Euler);
    }
    if integrator == Integrator::Rk4 && !smooth {
        let what = "is rk4, but something touches or rubs".to_owned();
        let remedy = "say auto, or take the pin away and say arm = \"rigid\"";
        return Err(invalid("fidelity.integrator", what, remedy));
    }
    if integrator == Integrator::Euler && !config.object.is_empty() {
        let what = "is euler, which knows the pin only".to_owned();
        return Err(invalid("fidelity.integrator", what, "say auto, or leave the objects out"));
    }
    let gives_way = config.fidelity.arm == ArmModel::Compliant && matches!(finger, Finger::Arm(_));
    if integrator == Integrator::Euler && gives_way {
        let what = "is euler, which cannot follow gears that give way".to_owned();
        return Err(invalid("fidelity.integrator", what, "say auto or implicit"));
    }
    Ok(Method::of(integrator, smooth))
}

/// The pin on the table, sunk in until the rubber carries its weight.
fn put_pin(config: &WorldConfig, table: &Table, finger: DVec3) -> Result<Rolling, Invalid> {
    let c = &config.pin;
    let (radius_m, length_m) = (1e-3 * c.radius_mm, 1e-3 * c.length_mm);
    let rolling_m = 1e-3 * c.rolling_resistance_mm;
    let (_, axes, surface) = table.at(0.0);
    let (on_finger, spatial) = fingertip(config, &config.finger.rubber, "finger.rubber")?;
    let tip = &config.opposed;
    let (on_table, friction, carried_m, opposed) = if tip.present {
        let (rubber, spatial) = fingertip(config, &tip.rubber, "opposed.rubber")?;
        let opposed = Opposed::new(tip, finger, (&axes, &surface), spatial);
        (rubber, tip.friction, length_m.min(2.0 * PAD_HALF_M), Some(Box::new(opposed)))
    } else {
        let rubber = Rubber::blind(&config.table.rubber, c.radius_mm, "table.rubber")?;
        (rubber, config.table.friction, length_m, None)
    };
    let weight_n = c.mass_kg * GRAVITY_M_S2 * surface.normal.z;
    let sunk_m = on_table.penetration_m(weight_n / carried_m);
    let centre = centre_above(c, finger, &surface, radius_m - sunk_m);
    let turned: DMat3 = axes * rotation_z(c.yaw_deg.to_radians());
    let pin = Pin::at_rest(centre, &turned, (radius_m, length_m), c.mass_kg);
    if let Some(opposed) = &opposed {
        let pose = opposed.pose(&axes, &surface);
        let lever = pose.rotation.transpose() * (centre - pose.translation);
        if lever.x.abs().max(lever.y.abs()) > PAD_HALF_M {
            let what = format!(
                "puts its middle {:.1} mm and {:.1} mm beside that of the pin, which would fall",
                -1e3 * lever.x,
                -1e3 * lever.y
            );
            let off = axes.transpose() * (centre - pose.translation);
            let key = if off.y.abs() > off.x.abs() { "y_mm" } else { "x_mm" };
            let remedy = format!("put it under the pin: pin.{key}");
            return Err(invalid(&format!("opposed.{key}"), what, &remedy));
        }
    }
    let mut hand = Hand::new(&pin, &axes, &surface, c.steady_until_n);
    hand.holding = c.steadied;
    Ok(Rolling {
        pin,
        pad: Patch::new(on_finger, config.finger.friction, rolling_m),
        bed: Patch::new(on_table, friction, rolling_m).along_pin(length_m),
        opposed,
        hand,
        released: None,
        by_finger: Reaction::default(),
        by_table: Reaction::default(),
        across: 1.0,
        spatial,
    })
}

/// The rubber of a fingertip under the pin, as faithful as the scene asks for.
fn fingertip(
    config: &WorldConfig,
    rubber: &RubberConfig,
    place: &str,
) -> Result<(Rubber, Option<Box<Spatial>>), Invalid> {
    let (pin, model) = (&config.pin, config.fidelity.contact);
    let mut layer = Rubber::new(rubber, pin.radius_mm, place)?;
    if model != ContactModel::Line {
        layer = layer.traced(rubber, place)?;
    }
    let level = match model {
        ContactModel::Layer3d => Accuracy::Fast,
        ContactModel::Layer3dFine => Accuracy::Default,
        ContactModel::Line | ContactModel::Layer2d => return Ok((layer, None)),
    };
    let size_m = (1e-3 * pin.radius_mm, 1e-3 * pin.length_mm);
    Ok((layer, Some(Box::new(Spatial::new(rubber, size_m, level, place)?))))
}

/// The point over the wanted x and y at a distance from the surface.
fn centre_above(c: &PinConfig, finger: DVec3, surface: &Surface, distance_m: f64) -> DVec3 {
    let (x, y) = (finger.x + 1e-3 * c.x_mm, finger.y + 1e-3 * c.y_mm);
    let (n, o) = (surface.normal, surface.origin);
    let z = o.z + (distance_m - n.x * (x - o.x) - n.y * (y - o.y)) / n.z;
    DVec3::new(x, y, z)
}

/// Judges the step against the fastest oscillation of the pin between its rubbers.
fn check_step(
    config: &WorldConfig,
    rolling: &Rolling,
    finger_kg: Option<f64>,
) -> Result<(), Invalid> {
    let (pin, pad, bed) = (&rolling.pin, &rolling.pad.rubber, &rolling.bed.rubber);
    let pad_m = (2.0 * PAD_HALF_M).min(pin.length_m);
    let on_pad = pad.at(pad.penetration_m(RATED_LOAD_N / pad_m));
    let on_bed = bed.at(bed.penetration_m(RATED_LOAD_N / pin.length_m));
    let finger_mobility = finger_kg.map_or(0.0, |m| 1.0 / m);
    // Bound of the largest eigenvalue; across its axis a rolling pin is three times as mobile.
    let square = |pad_n_m2: f64, bed_n_m2: f64, mobility: f64| {
        mobility * (pad_n_m2 * pad_m + bed_n_m2 * pin.length_m) + finger_mobility * pad_n_m2 * pad_m
    };
    let light = 1.0 / pin.mass_kg;
    let normal = square(on_pad.stiffness_n_m2, on_bed.stiffness_n_m2, light);
    let shear = square(on_pad.shear_n_m2, on_bed.shear_n_m2, 3.0 * light);
    let square = normal.max(shear);
    let h = 1e-6 * config.substep_us;
    let step_frequency = h * square.sqrt();
    let relaxation = pad.relaxation_s.max(bed.relaxation_s);
    let damping = h * square * (0.5 * h + relaxation);
    if step_frequency <= STEP_FREQUENCY_MAX && damping <= STEP_DAMPING_MAX {
        return Ok(());
    }
    let longest_s = (STEP_FREQUENCY_MAX / square.sqrt())
        .min(STEP_DAMPING_MAX / square / (relaxation + 0.5 * h));
    let what = format!(
        "is {}, too long for a pin of {} kg between these rubbers: {:.0} rad/s at {} N, \
         step x frequency {:.2} (at most {}), damping {:.2} (at most {})",
        config.substep_us,
        config.pin.mass_kg,
        square.sqrt(),
        RATED_LOAD_N,
        step_frequency,
        STEP_FREQUENCY_MAX,
        damping,
        STEP_DAMPING_MAX,
    );
    let remedy = format!(
        "use {:.0} or less, a softer or thicker rubber, less relaxation or a heavier pin",
        (1e6 * longest_s).floor().max(1.0)
    );
    Err(invalid("substep_us", what, &remedy))
}
