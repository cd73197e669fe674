//! Opens the boards that the sections `[device.NAME]` of a machine file name and joins the halves
//! that they serve to the devices of one robot. The drivers are those of this repository and those
//! that the program [`register`]s.
//!
//! ```
//! use taktil_machine::config::MachineConfig;
//! use taktil_machine::robot::AnyRobot;
//!
//! let machine: MachineConfig = toml::from_str(
//!     r#"
//!     [device.pad]
//!     driver = "serial"
//!     serves = ["tactile"]
//!     path = "/dev/no-such-tty"
//!     "#,
//! )?;
//! let bad = taktil_machine_boards::open(&machine, &AnyRobot::puma260()).unwrap_err();
//! assert_eq!(bad.place, "device.pad.path");
//! # Ok::<(), toml::de::Error>(())
//! ```

mod driver;
mod epoch;
mod house;
mod registry;
mod thread;

use std::collections::BTreeMap;

use taktil_hal::{DacCode, Devices, Invalid, OpenError, TACTILE};
use taktil_machine::config::MachineConfig;
use taktil_machine::device::{DeviceKeys, SIMULATOR, halves_of, move_half};
use taktil_machine::joints::JointsConfig;
use taktil_machine::robot::AnyRobot;
use taktil_machine::with_robot;

pub use driver::{Counts, Driver, MakeSafe, Open, Opened};
pub use epoch::Epoch;
pub use registry::{drivers, find, left_out, register};
pub use thread::{DriverThread, MissingGrant, RunningThread};

/// The devices of one robot, and what keeps them going.
#[derive(Debug)]
pub struct OpenDevices {
    /// The halves, in the order and direction of the joints.
    pub devices: Devices,
    /// Threads that exchange with boards; they end when the halves are dropped.
    pub threads: Vec<RunningThread>,
    /// What each driver counts, by the name of its device.
    pub counts: BTreeMap<String, Counts>,
    /// To be told when the run begins.
    pub epoch: Epoch,
    /// What serves each half, for people.
    pub served: BTreeMap<String, String>,
}

impl OpenDevices {
    /// Refuses converters of another width than the arm's drives have, where `[joints]` does not
    /// say what their codes are worth: every torque would be wrong by the same factor.
    ///
    /// # Errors
    /// Such converters; the place is the device's.
    pub fn require_code_scale(
        &self,
        machine: &MachineConfig,
        robot: &AnyRobot,
    ) -> Result<(), Invalid> {
        let Some(converters) = &self.devices.analog_out else { return Ok(()) };
        if machine.joints.as_ref().is_some_and(JointsConfig::states_code_scale) {
            return Ok(());
        }
        let (_, own) = with_robot!(robot, robot => robot.drive.code_range());
        let (_, DacCode(board)) = converters.code_range();
        // A reversed motor widens the range by one code.
        if board.abs_diff(own) <= 1 {
            return Ok(());
        }
        let device = self.served.get("analog_out").map_or("", String::as_str);
        let what = format!(
            "its converters go to code {board}, the arm's drives to {own}, and nothing says what a \
             code is worth"
        );
        let remedy = "give one of `full_scale_v`, `full_scale_codes`, `codes_per_nm` and \
                      `volts_per_nm` in [joints]";
        Err(Invalid::new(format!("device.{device}"), what, remedy))
    }
}

/// Opens every device of the machine and puts the wiring of the joints between. Opening a board
/// writes the safe values of its outputs.
///
/// # Errors
/// An unknown driver; what a driver refuses; a half that two devices serve, or that a device does
/// not have; what [`taktil_machine::joints::JointsConfig::connect`] refuses. The place is in the
/// machine file; boards that were opened before are closed, with safe outputs.
pub fn open(machine: &MachineConfig, robot: &AnyRobot) -> Result<OpenDevices, Invalid> {
    let mut all = OpenDevices {
        devices: Devices::default(),
        threads: Vec::new(),
        counts: BTreeMap::new(),
        epoch: Epoch::default(),
        served: BTreeMap::new(),
    };
    let mut volts_per_code = Vec::new();
    for (name, section) in &machine.device {
        let place = format!("device.{name}");
        let within = |bad: Invalid| bad.within(&place);
        let (keys, own) = section.split().map_err(within)?;
        let driver = find(&keys.driver).ok_or_else(|| within(unknown_driver(&keys.driver)))?;
        let opened = (driver.open)(&own, &all.epoch).map_err(|bad| within(bad.into_invalid()))?;
        let served = serve(opened.devices, &keys, name, &mut all).map_err(within)?;
        if served.iter().any(|half| half == "analog_out") {
            volts_per_code = opened.analog_out_volts_per_code;
        }
        if let Some(counts) = opened.counts {
            all.counts.insert(name.clone(), counts);
        }
        for thread in opened.threads {
            all.threads.push(thread.start(name, &keys.thread).map_err(within)?);
        }
    }
    let joints = machine.joints.clone().unwrap_or_default();
    let connected = joints.connect(robot, all.devices, &volts_per_code);
    all.devices = connected.map_err(|bad| bad.within("joints"))?;
    Ok(all)
}

/// Why the outputs of a device were not made safe.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NotSafe {
    /// What is wrong, at its place in the machine file, and what to do about it.
    pub bad: Invalid,
    /// Whether the section cannot be used: nobody knows then which board it stands for. Otherwise
    /// the board did not take the safe values, or another process drives it.
    pub is_configuration: bool,
}

impl From<OpenError> for NotSafe {
    fn from(error: OpenError) -> NotSafe {
        let is_configuration = matches!(error, OpenError::Invalid(_));
        NotSafe { bad: error.into_invalid(), is_configuration }
    }
}

/// Writes the safe values of the outputs of every device that has some, whatever became of the
/// others: for a program that runs after the process that drove them has died. Answers what came of
/// each, by the name of the device.
#[must_use]
pub fn make_safe(machine: &MachineConfig) -> Vec<(String, Result<(), NotSafe>)> {
    let mut all = Vec::new();
    for (name, section) in &machine.device {
        let outcome = section.split().map_err(OpenError::from).and_then(|(keys, own)| {
            let driver = find(&keys.driver).ok_or_else(|| unknown_driver(&keys.driver))?;
            driver.make_safe.map_or(Ok(false), |make_safe| make_safe(&own).map(|()| true))
        });
        let place = format!("device.{name}");
        match outcome {
            Ok(false) => {}
            Ok(true) => all.push((name.clone(), Ok(()))),
            Err(error) => {
                let NotSafe { bad, is_configuration } = error.into();
                let bad = bad.within(&place);
                all.push((name.clone(), Err(NotSafe { bad, is_configuration })));
            }
        }
    }
    all
}

/// Moves the halves that a device serves to the robot's devices; the others are closed.
fn serve(
    mut own: Devices,
    keys: &DeviceKeys,
    name: &str,
    all: &mut OpenDevices,
) -> Result<Vec<String>, Invalid> {
    let offered = halves_of(&own);
    let served: Vec<String> =
        keys.serves.clone().unwrap_or_else(|| offered.iter().cloned().collect());
    for (at, half) in served.iter().enumerate() {
        let place = if keys.serves.is_some() { format!("serves[{at}]") } else { String::new() };
        if let Some(other) = all.served.get(half) {
            let what = format!("`{half}` is served by `{other}` already");
            let remedy = format!("leave it out of `serves` of `{name}` or of `{other}`");
            return Err(Invalid::new(place, what, remedy));
        }
        // A device with one array serves it under whatever name the robot has for it.
        if half.starts_with(TACTILE)
            && !offered.contains(half)
            && let Some(array) = own.tactile.remove(TACTILE)
        {
            own.tactile.insert(half.clone(), array);
        }
        if !move_half(half, &mut own, &mut all.devices) {
            let has: Vec<&str> = offered.iter().map(String::as_str).collect();
            let what = format!("the device has no `{half}`");
            let remedy = format!("its section gives it: {}", has.join(", "));
            return Err(Invalid::new(place, what, remedy));
        }
        all.served.insert(half.clone(), name.to_owned());
    }
    Ok(served)
}

fn unknown_driver(name: &str) -> Invalid {
    if name == SIMULATOR {
        let remedy = "run a scene with this machine file: `taktil run SCENE`; or name a driver";
        return Invalid::new("driver", "the simulated robot has no boards to open", remedy);
    }
    if let Some(remedy) = left_out(name) {
        return Invalid::new("driver", format!("there is no driver `{name}` here"), remedy);
    }
    let names: Vec<&str> = drivers().map(|driver| driver.name).collect();
    let remedy = format!("drivers are: {}, {SIMULATOR}", names.join(", "));
    Invalid::new("driver", format!("there is no driver `{name}`"), remedy)
}
