//! Builds a world from its description: checks it, solves the contacts, puts the pin on the table
//! in static balance, connects the devices and latches the first samples. A scene too stiff for the
//! integration step is an error.

mod chain;

use glam::{DMat3, DVec3};
use taktil_contact::Accuracy;
use taktil_hal::{
    AdcCode, CHANNELS, Counts, Devices, FORCE_TORQUE_CHANNELS, LinesOut, Nanos, TACTILE,
    TACTILE_OPPOSED,
};
use taktil_mechanics::hand::Hand;
use taktil_mechanics::rigid_body::GRAVITY_M_S2;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::rotation_z;
use taktil_mechanics::transmission::Drive;

use crate::any_plant::AnyPlant;
use crate::arm::{Arm, JOINT_COUNT};
use crate::carriage::{Carriage, MovingCarriage};
use crate::contact::{Patch, Reaction, Surface};
use crate::devices::{ARRAYS_MAX, BoardSpec, HAND_ARRAYS, connect};
use crate::electronics::{Fingertip, TactileSensor, Wrist};
use crate::faults::Faults;
use crate::fixture::PinFixture;
use crate::geometry::ArrayGeometry;
use crate::hand::GraspingHand;
use crate::index_pulses::IndexPulseModel;
use crate::last_sent::{LastSent, ScanFeed};
use crate::manipulator::{Coordinates, Manipulator};
use crate::object::Objects;
use crate::opposed::OpposedPad;
use crate::pin::{CylinderSize, Pin};
use crate::rolling::RollingPin;
use crate::rubber::Rubber;
use crate::scene::fidelity::{ContactModel, Integrator};
use crate::scene::{Invalid, PinConfig, TactileConfig, Timing, WorldConfig, invalid};
use crate::spatial::{PadSection, SpatialSolver};
use crate::step::{Method, Plant, StepRoom, StepStatistics, WarmStart};
use crate::table::Table;
use crate::world::World;

pub use chain::{SimulatedChain, build_with_chain};

/// Load at which the stability of the integration is judged (N): four times the load of the rolling
/// task. The integration would become unstable at sixteen times the stiffness at this load.
pub const RATED_LOAD_N: f64 = 60.0;
/// Largest accepted product of step and natural frequency.
const STEP_FREQUENCY_MAX: f64 = 0.5;
/// Largest share of a step's stability that contact damping may take.
const STEP_DAMPING_MAX: f64 = 1.0;

/// Builds the bench with the PUMA 260.
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
    let arm = Arm::new(&config.arm, config.fidelity.arm, config.arm_refresh_steps)?;
    let mass_kg = arm.mass_at_tool_kg();
    let (code_min, code_max) = Drive::reference().code_range();
    let board = BoardSpec { joints: JOINT_COUNT, code_min, code_max };
    assemble::<6, 12>(config, timing, seed, Box::new(arm), mass_kg, board)
}

/// Builds the bench with a finger on rails instead of an arm; the encoders read zero.
///
/// # Errors
/// The errors of [`build`]; also `carriage` when its path or its guide is not finite or not in
/// order.
pub fn build_with_carriage(
    config: &WorldConfig,
    timing: &Timing,
    seed: u64,
    carriage: Carriage,
) -> Result<(World, Devices), Invalid> {
    config.check()?;
    timing.check()?;
    carriage.check()?;
    let carriage = MovingCarriage::new(carriage);
    let mass_kg = carriage.mass_kg();
    let (code_min, code_max) = Drive::reference().code_range();
    let board = BoardSpec { joints: JOINT_COUNT, code_min, code_max };
    assemble::<6, 12>(config, timing, seed, Box::new(carriage), mass_kg, board)
}

/// Builds the bench with a hand, which starts at `start` (rad) around the object of `[hand]`. The
/// devices have one array a finger, `tactile_finger1` and so on.
///
/// # Errors
/// The errors of [`build`]; also a pin, an object, an opposed fingertip and a named integrator,
/// none of which a hand has, and an object that stands in a fingertip.
pub fn build_with_hand<const F: usize, const N: usize>(
    config: &WorldConfig,
    timing: &Timing,
    seed: u64,
    robot: &Robot<N, Hand<F, N>>,
    start: &[f64],
) -> Result<(World, Devices), Invalid> {
    config.check()?;
    timing.check()?;
    if config.pin.present {
        let what = "is true, but a hand holds the object of [hand]".to_owned();
        return Err(invalid("pin.present", what, "say false"));
    }
    if !config.object.is_empty() {
        let what = "stands there, but a hand holds the object of [hand]".to_owned();
        return Err(invalid("object", what, "leave it out"));
    }
    if config.fidelity.integrator != Integrator::Auto {
        let what = "is named, but a hand has a method of its own".to_owned();
        return Err(invalid("fidelity.integrator", what, "say auto"));
    }
    let hand = GraspingHand::new(robot, start, config)?;
    let (code_min, code_max) = robot.drive.code_range();
    let board = BoardSpec { joints: N, code_min, code_max };
    // The joints of a hand are none of the plant's coordinates: it steps by itself.
    assemble::<6, 12>(config, timing, seed, Box::new(hand), None, board)
}

/// The feeds of the arrays: of so many fingers of a hand, or of the finger and the one opposed to
/// it.
fn scan_feeds(config: &WorldConfig, fingers: Option<usize>) -> [Option<ScanFeed>; ARRAYS_MAX] {
    let opposed = config.opposed.present;
    match fingers {
        Some(fingers) => core::array::from_fn(|i| {
            (i < fingers).then(|| ScanFeed::of(&config.tactile, HAND_ARRAYS[i]))
        }),
        None => [
            Some(ScanFeed::of(&config.tactile, TACTILE)),
            opposed.then(|| ScanFeed::of(&config.opposed.tactile, TACTILE_OPPOSED)),
            None,
        ],
    }
}

/// The tactile sensors of a hand's fingers.
fn hand_sensors(
    config: &WorldConfig,
    timing: &Timing,
    seed: u64,
    fingers: usize,
) -> Result<[Option<Box<TactileSensor>>; ARRAYS_MAX], Invalid> {
    let mut sensors = [const { None }; ARRAYS_MAX];
    let count = if config.tactile.present { fingers } else { 0 };
    for (finger, sensor) in sensors.iter_mut().enumerate().take(count) {
        let tip = Fingertip::OfHand(finger);
        *sensor = Some(Box::new(TactileSensor::new(&config.tactile, timing, seed, tip)?));
    }
    Ok(sensors)
}

/// Puts the bodies on the bench and connects the devices.
fn assemble<const J: usize, const U: usize>(
    config: &WorldConfig,
    timing: &Timing,
    seed: u64,
    finger: Box<dyn Coordinates<J>>,
    finger_kg: Option<f64>,
    board: BoardSpec,
) -> Result<(World, Devices), Invalid>
where
    Plant<J, U>: Into<AnyPlant>,
{
    let table = Table::new(&config.table, config.table_height_mm());
    let rolling = rolling_pin(config, &table, finger.pose().translation, finger_kg)?;
    let objects = Objects::new(config, &table, finger.pose().translation)?;
    let fingers = finger.grasp().map(|hand| hand.fingers());
    let arrays = match fingers {
        Some(fingers) => hand_sensors(config, timing, seed, fingers)?,
        None => tactile_sensors(config, timing, seed)?,
    };
    let feeds = scan_feeds(config, fingers);
    let last_sent = LastSent { board, feeds, ..LastSent::default() };
    let index = index(config, finger.as_ref())?;
    let (links, devices) =
        connect(timing.actuation_delay, board, index.is_some(), last_sent.tactile_specs());
    let method = method(config, finger.as_ref())?;
    let plant = Plant::<J, U> {
        method,
        room: StepRoom::new(method, rolling.as_deref()),
        finger,
        rolling,
        objects,
        table,
        substep: Nanos((1e3 * config.substep_us).round() as i64),
        error_m: 0.0,
        statistics: StepStatistics::default(),
        warm_start: WarmStart::default(),
        contacts_current: false,
    }
    .into();
    let mut world = World {
        t: Nanos::ZERO,
        timing: *timing,
        power_on: Nanos((1e9 * config.arm.power_on_s).round() as i64),
        plant,
        arrays,
        wrist: config.wrist.present.then(|| Wrist::new(&config.wrist, seed)),
        faults: Faults::new(&config.fault, seed),
        is_hand: fingers.is_some(),
        links,
        next_control: Nanos::ZERO,
        sequences: [0; ARRAYS_MAX],
        counts: [Counts(0); CHANNELS],
        index,
        gauges: [AdcCode(0); FORCE_TORQUE_CHANNELS],
        codes: [0; CHANNELS],
        lines_out: LinesOut::SAFE,
        last_code_time: Nanos::ZERO,
        last_feed_time: Nanos::ZERO,
        last_sent,
        drives: None,
    };
    world.latch();
    check_start(&world.plant)?;
    Ok((world, devices))
}

/// The tactile sensors of the finger and of the fingertip opposed to it, where they exist.
fn tactile_sensors(
    config: &WorldConfig,
    timing: &Timing,
    seed: u64,
) -> Result<[Option<Box<TactileSensor>>; ARRAYS_MAX], Invalid> {
    let sensor = |tactile: &TactileConfig, tip: Fingertip| {
        let sensor = tactile.present.then(|| TactileSensor::new(tactile, timing, seed, tip));
        sensor.transpose().map(|sensor| sensor.map(Box::new))
    };
    let finger = sensor(&config.tactile, Fingertip::Finger)?;
    let opposed = match config.opposed.present {
        true => sensor(&config.opposed.tactile, Fingertip::Opposed)?,
        false => None,
    };
    Ok([finger, opposed, None])
}

/// Refuses a finger that starts inside the pin or an object, or deeper in its rubber than small
/// strain goes: the first step would throw the bodies apart.
fn check_start(plant: &AnyPlant) -> Result<(), Invalid> {
    let mut inside = None;
    if let Some(rolling) = plant.rolling() {
        let deepest_m = rolling.pad.slices.iter().map(|slice| slice.delta_m).fold(0.0, f64::max);
        if deepest_m > rolling.pad.rubber.deepest_m() {
            inside = Some(("pin".to_owned(), deepest_m));
        }
    }
    if let Some(objects) = plant.objects() {
        let found =
            objects.first_beyond_small_strain().map(|(i, deep_m)| (format!("object[{i}]"), deep_m));
        inside = inside.or(found);
    }
    let Some((place, deep_m)) = inside else { return Ok(()) };
    let what = format!("stands {:.3} mm inside the finger's rubber at the start", 1e3 * deep_m);
    let remedy = "start the finger higher, or put the table (table.height_mm) lower";
    Err(invalid(&place, what, remedy))
}

/// The index pulses of the encoder discs, if the scene describes them.
fn index(
    config: &WorldConfig,
    finger: &dyn Manipulator,
) -> Result<Option<IndexPulseModel>, Invalid> {
    let Some(before) = &config.arm.index_counts else { return Ok(None) };
    let Some(home) = finger.home_counts() else { return Ok(None) };
    IndexPulseModel::new(before, &home.counts, &home.counts_per_turn).map(Some)
}

/// The integrator for the bodies on the bench.
fn method(config: &WorldConfig, finger: &dyn Manipulator) -> Result<Method, Invalid> {
    let smooth = finger.is_smooth() && !config.pin.present && config.object.is_empty();
    let integrator = config.fidelity.integrator;
    if finger.steps_by_itself() {
        // The explicit loop calls the step of the manipulator, which has its own method.
        return Ok(Method::Euler);
    }
    if integrator == Integrator::Rk4 && !smooth {
        let what = "is rk4, but something touches or rubs".to_owned();
        let remedy = "say auto, or take the pin away and say arm = \"rigid\"";
        return Err(invalid("fidelity.integrator", what, remedy));
    }
    if integrator == Integrator::Euler && !finger.has_explicit_steps() {
        let what = "is euler, which only the PUMA 260 takes in contact".to_owned();
        return Err(invalid("fidelity.integrator", what, "say auto or implicit"));
    }
    if integrator == Integrator::Euler && !config.object.is_empty() {
        let what = "is euler, which knows the pin only".to_owned();
        return Err(invalid("fidelity.integrator", what, "say auto, or leave the objects out"));
    }
    if integrator == Integrator::Euler && finger.has_compliant_gears() {
        let what = "is euler, which cannot follow gears that give way".to_owned();
        return Err(invalid("fidelity.integrator", what, "say auto or implicit"));
    }
    Ok(Method::of(integrator, smooth))
}

/// The pin of a scene that has one, checked against the steps of the integrator.
fn rolling_pin(
    config: &WorldConfig,
    table: &Table,
    finger: DVec3,
    finger_kg: Option<f64>,
) -> Result<Option<Box<RollingPin>>, Invalid> {
    if !config.pin.present {
        return Ok(None);
    }
    let rolling = place_pin(config, table, finger)?;
    if config.fidelity.integrator == Integrator::Euler {
        check_step(config, &rolling, finger_kg)?;
    }
    Ok(Some(Box::new(rolling)))
}

/// The pin on the table, pressed in until the rubber carries its weight.
fn place_pin(config: &WorldConfig, table: &Table, finger: DVec3) -> Result<RollingPin, Invalid> {
    let c = &config.pin;
    let (radius_m, length_m) = (1e-3 * c.radius_mm, 1e-3 * c.length_mm);
    let rolling_m = 1e-3 * c.rolling_resistance_mm;
    let (_, axes, surface) = table.at(0.0);
    let (array, opposed_array) = (config.tactile.geometry(), config.opposed.tactile.geometry());
    let (on_finger, spatial) = fingertip(config, &finger_pad(config, &array))?;
    let tip = &config.opposed;
    let (support, carried_m, opposed) = if tip.present {
        let (rubber, spatial) = fingertip(config, &opposed_pad(config, &opposed_array))?;
        let opposed = OpposedPad::new(tip, finger, &axes, &surface, spatial);
        let carried_m = length_m.min(2.0 * opposed_array.half_y_m());
        let patch = Patch::on_pad(rubber, tip.friction, rolling_m, &opposed_array);
        (patch, carried_m, Some(Box::new(opposed)))
    } else {
        let rubber =
            Rubber::without_base_shares(&config.table.rubber, c.radius_mm, "table.rubber")?;
        let patch = Patch::on_table(rubber, config.table.friction, rolling_m, length_m);
        (patch, length_m, None)
    };
    let weight_n = c.mass_kg * GRAVITY_M_S2 * surface.normal.z;
    let sunk_m = support.rubber.penetration_m(weight_n / carried_m);
    let centre = pin_centre_above(c, finger, &surface, radius_m - sunk_m);
    let turned: DMat3 = axes * rotation_z(c.yaw_deg.to_radians());
    let size = CylinderSize { radius_m, length_m };
    let pin = Pin::at_rest(centre, &turned, size, c.mass_kg);
    if let Some(opposed) = &opposed {
        let pose = opposed.pose(&axes, &surface);
        let lever = pose.rotation.transpose() * (centre - pose.translation);
        let (half_x_m, half_y_m) = (opposed_array.half_x_m(), opposed_array.half_y_m());
        if lever.x.abs() > half_x_m || lever.y.abs() > half_y_m {
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
    let mut fixture = PinFixture::new(&pin, &axes, &surface, c.fixture_release_n);
    fixture.holding = c.fixture;
    let pad = Patch::on_pad(on_finger, config.finger.friction, rolling_m, &array);
    let start = [pad.slices.bristles.clone(), support.slices.bristles.clone()];
    Ok(RollingPin {
        pin,
        pad,
        array,
        support,
        start: Box::new(start),
        opposed,
        fixture,
        released: None,
        finger_reaction: Reaction::default(),
        support_reaction: Reaction::default(),
        rolling_cosine: 1.0,
        spatial,
    })
}

/// The finger's pad and its places in the scene.
fn finger_pad<'a>(config: &'a WorldConfig, array: &'a ArrayGeometry) -> PadSection<'a> {
    let rubber = &config.finger.rubber;
    PadSection { array, array_place: "tactile", rubber, rubber_place: "finger.rubber" }
}

/// The pad opposed to it and its places in the scene.
fn opposed_pad<'a>(config: &'a WorldConfig, array: &'a ArrayGeometry) -> PadSection<'a> {
    let (rubber, rubber_place) = (&config.opposed.rubber, "opposed.rubber");
    PadSection { array, array_place: "opposed.tactile", rubber, rubber_place }
}

/// The rubber of a fingertip under the pin, with the solver in three dimensions if the scene asks
/// for it.
fn fingertip(
    config: &WorldConfig,
    pad: &PadSection<'_>,
) -> Result<(Rubber, Option<Box<SpatialSolver>>), Invalid> {
    let (pin, model) = (&config.pin, config.fidelity.contact);
    let mut layer = Rubber::new(pad.rubber, pin.radius_mm, pad.rubber_place)?;
    if model != ContactModel::Line {
        layer = layer.with_tangential_influence(pad.rubber, pad.rubber_place)?;
    }
    let level = match model {
        ContactModel::Layer3d => Accuracy::Fast,
        ContactModel::Layer3dFine => Accuracy::Default,
        ContactModel::Line | ContactModel::Layer2d => return Ok((layer, None)),
    };
    let size = CylinderSize { radius_m: 1e-3 * pin.radius_mm, length_m: 1e-3 * pin.length_mm };
    Ok((layer, Some(Box::new(SpatialSolver::new(pad, size, level)?))))
}

/// The point over the configured x and y at a distance from the surface.
fn pin_centre_above(c: &PinConfig, finger: DVec3, surface: &Surface, distance_m: f64) -> DVec3 {
    let (x, y) = (finger.x + 1e-3 * c.x_mm, finger.y + 1e-3 * c.y_mm);
    let (n, o) = (surface.normal, surface.origin);
    let z = o.z + (distance_m - n.x * (x - o.x) - n.y * (y - o.y)) / n.z;
    DVec3::new(x, y, z)
}

/// Compares the step with the fastest oscillation of the pin between its rubbers.
fn check_step(
    config: &WorldConfig,
    rolling: &RollingPin,
    finger_kg: Option<f64>,
) -> Result<(), Invalid> {
    let (pin, pad, support) = (&rolling.pin, &rolling.pad.rubber, &rolling.support.rubber);
    let pad_m = (2.0 * rolling.array.half_y_m()).min(pin.length_m);
    let on_pad = pad.at(pad.penetration_m(RATED_LOAD_N / pad_m));
    let on_bed = support.at(support.penetration_m(RATED_LOAD_N / pin.length_m));
    let finger_mobility = finger_kg.map_or(0.0, |m| 1.0 / m);
    // This bounds the largest eigenvalue; a rolling pin is three times as mobile across its axis.
    let square = |pad_n_m2: f64, bed_n_m2: f64, mobility: f64| {
        mobility * (pad_n_m2 * pad_m + bed_n_m2 * pin.length_m) + finger_mobility * pad_n_m2 * pad_m
    };
    let light = 1.0 / pin.mass_kg;
    let normal = square(on_pad.stiffness_n_m2, on_bed.stiffness_n_m2, light);
    let shear = square(on_pad.shear_n_m2, on_bed.shear_n_m2, 3.0 * light);
    let square = normal.max(shear);
    let h = 1e-6 * config.substep_us;
    let step_frequency = h * square.sqrt();
    let relaxation = pad.relaxation_s.max(support.relaxation_s);
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
