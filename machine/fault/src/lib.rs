//! Puts the faults of a plan into the device halves of a machine, whatever implements them: each
//! half that the plan names gets a decorator, the others stay as they are. Which half implements
//! what is not known here, so that the same plan befalls a simulated robot, an emulated board and a
//! real one.
//!
//! ```
//! use taktil_hal::Devices;
//! use taktil_hal::fault::FaultPlan;
//! use taktil_machine_fault::decorate;
//!
//! let plan = FaultPlan::new(vec!["kind=jump target=encoders.3 at=1 value=500".parse()?]);
//! let refused = decorate(Devices::default(), &plan, 1).unwrap_err();
//! assert_eq!(refused.what, "there is no `encoders`");
//! # Ok::<(), taktil_hal::Invalid>(())
//! ```

mod analog;
mod digital;
mod drives;
mod encoders;
mod force_torque;
mod tactile;
mod target_faults;

pub use analog::{ANALOG_IN_KINDS, ANALOG_OUT_KINDS};
pub use digital::{DIGITAL_IN_KINDS, DIGITAL_OUT_KINDS};
pub use drives::{DRIVE_IN_KINDS, DRIVE_OUT_KINDS};
pub use encoders::ENCODER_KINDS;
pub use force_torque::FORCE_TORQUE_KINDS;
pub use tactile::TACTILE_KINDS;
pub use target_faults::TargetFaults;

use taktil_hal::fault::FaultKind;
pub use taktil_hal::fault::{Fault, FaultPlan};
use taktil_hal::{Devices, Invalid, TACTILE};

/// The kinds that can befall the half of this name, as in `serves` of a machine file; none for a
/// name that no half has.
#[must_use]
pub fn kinds_of_half(half: &str) -> &'static [FaultKind] {
    match half {
        "encoders" => &ENCODER_KINDS,
        "analog_out" => &ANALOG_OUT_KINDS,
        "drive_out" => &DRIVE_OUT_KINDS,
        "drive_in" => &DRIVE_IN_KINDS,
        "analog_in" => &ANALOG_IN_KINDS,
        "digital_in" => &DIGITAL_IN_KINDS,
        "digital_out" => &DIGITAL_OUT_KINDS,
        "force_torque" => &FORCE_TORQUE_KINDS,
        _ if half.starts_with(TACTILE) => &TACTILE_KINDS,
        _ => &[],
    }
}

/// How many channels the half of this name has; `None` when it is not there. The lines of a cell
/// are three each way.
fn channels_of_half(devices: &Devices, half: &str) -> Option<usize> {
    match half {
        "encoders" => devices.encoders.as_ref().map(|half| half.joints()),
        "analog_out" => devices.analog_out.as_ref().map(|half| half.channels()),
        "drive_out" => devices.drive_out.as_ref().map(|half| half.channels()),
        "drive_in" => devices.drive_in.as_ref().map(|half| half.channels()),
        "analog_in" => devices.analog_in.as_ref().map(|half| half.channels()),
        "digital_in" => devices.digital_in.as_ref().map(|_| 3),
        "digital_out" => devices.digital_out.as_ref().map(|_| 3),
        "force_torque" => devices.force_torque.as_ref().map(|_| taktil_hal::FORCE_TORQUE_CHANNELS),
        array => devices.tactile.get(array).map(|half| half.rows() * half.cols()),
    }
}

/// Whether a target is that of a device half, rather than a lane, a task, the operator or the store
/// of records.
#[must_use]
pub fn is_half(target: &str) -> bool {
    !kinds_of_half(target).is_empty()
}

/// The devices with the faults of `plan` in them; faults with a probability happen by chance from
/// `seed`. Faults of targets that are no halves ([`is_half`]) are left to others.
///
/// # Errors
/// A half that is not there, a kind that cannot befall it, a channel that it does not have, a
/// device fault without a target: the place is `fault[i].KEY`.
pub fn decorate(devices: Devices, plan: &FaultPlan, seed: u64) -> Result<Devices, Invalid> {
    check_plan(&devices, plan)?;
    let faults =
        |half: &str| Some(TargetFaults::of(plan, half, seed)).filter(|faults| !faults.is_empty());
    let Devices {
        mut encoders,
        mut analog_out,
        mut drive_out,
        mut drive_in,
        mut analog_in,
        tactile,
        mut force_torque,
        mut digital_in,
        mut digital_out,
        board_clock,
    } = devices;
    if let Some(faults) = faults("encoders") {
        encoders = encoders.map(|half| Box::new(encoders::FaultyEncoders::new(half, faults)) as _);
    }
    if let Some(faults) = faults("analog_out") {
        analog_out =
            analog_out.map(|half| Box::new(analog::FaultyAnalogOut::new(half, faults)) as _);
    }
    if let Some(faults) = faults("drive_out") {
        drive_out = drive_out.map(|half| Box::new(drives::FaultyDriveOut::new(half, faults)) as _);
    }
    if let Some(faults) = faults("drive_in") {
        drive_in = drive_in.map(|half| Box::new(drives::FaultyDriveIn::new(half, faults)) as _);
    }
    if let Some(faults) = faults("analog_in") {
        analog_in = analog_in.map(|half| Box::new(analog::FaultyAnalogIn::new(half, faults)) as _);
    }
    if let Some(faults) = faults("digital_in") {
        digital_in =
            digital_in.map(|half| Box::new(digital::FaultyDigitalIn::new(half, faults)) as _);
    }
    if let Some(faults) = faults("digital_out") {
        digital_out =
            digital_out.map(|half| Box::new(digital::FaultyDigitalOut::new(half, faults)) as _);
    }
    if let Some(faults) = faults("force_torque") {
        force_torque = force_torque
            .map(|half| Box::new(force_torque::FaultyForceTorque::new(half, faults)) as _);
    }
    let tactile = tactile.into_iter().map(|(name, half)| match faults(&name) {
        Some(faults) => {
            let faulty = tactile::FaultyTactileArray::new(half, faults);
            (name, Box::new(faulty) as _)
        }
        None => (name, half),
    });
    let tactile = tactile.collect();
    Ok(Devices {
        encoders,
        analog_out,
        drive_out,
        drive_in,
        analog_in,
        tactile,
        force_torque,
        digital_in,
        digital_out,
        board_clock,
    })
}

/// Refuses what cannot befall these devices.
fn check_plan(devices: &Devices, plan: &FaultPlan) -> Result<(), Invalid> {
    for (index, fault) in plan.faults().iter().enumerate() {
        let place = |key: &str| format!("fault[{index}].{key}");
        if fault.target.is_empty() {
            let remedy = "name a device half, such as encoders, or one channel of it: encoders.3";
            return Err(Invalid::new(place("target"), "is missing", remedy));
        }
        let kinds = kinds_of_half(&fault.target);
        if kinds.is_empty() {
            continue;
        }
        let Some(channels) = channels_of_half(devices, &fault.target) else {
            let what = format!("there is no `{}`", fault.target);
            return Err(Invalid::new(place("target"), what, "name a half that the robot has"));
        };
        if !kinds.contains(&fault.kind) {
            let what = format!("`{}` cannot befall `{}`", fault.kind.name(), fault.target);
            let remedy = format!("it is one of: {}", FaultKind::words(kinds));
            return Err(Invalid::new(place("kind"), what, remedy));
        }
        if fault.channel.is_some_and(|channel| usize::from(channel) > channels) {
            let what = format!("`{}` has {channels} channels", fault.target);
            return Err(Invalid::new(place("target"), what, format!("give 1 to {channels}")));
        }
    }
    Ok(())
}
