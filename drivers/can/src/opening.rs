//! Opens a bus: every drive is asked what it is and set up, with its torque off, before the halves
//! are handed out.

use std::sync::Arc;

use taktil_drivers_exchange::Shared;
use taktil_hal::{Nanos, OpenError};

use crate::bus::Bus;
use crate::canopen::setup::Setup;
use crate::canopen::{self, CanOpenDrive};
use crate::config::{Config, DriveMode, NodeConfig, Protocol};
use crate::drive::{Drive, DriveMessage};
use crate::frame::{ErrorClass, Frame};
use crate::halves::{
    CanAnalogOut, CanDigitalIn, CanDigitalOut, CanDriveIn, CanDriveOut, CanEncoders,
};
use crate::monitor::BusMonitor;
use crate::moteus::MoteusDrive;
use crate::odrive::{OdriveAxis, torque_mode};
use crate::port::{Port, SocketPort};

/// How often a drive is asked for its first answer.
const FIRST_ANSWERS_MAX: u32 = 3;
/// Length of a queue that holds a cycle of any arm.
const QUEUE_FRAMES_USUAL: usize = 64;
/// Frames of others that may come before it.
const FRAMES_MAX: usize = 10_000;

/// The halves of the drives on a bus.
#[derive(Debug)]
pub struct Halves {
    /// Positions.
    pub encoders: CanEncoders,
    /// Torques; there is none where the drives close a loop themselves.
    pub analog_out: Option<CanAnalogOut>,
    /// Commands to the drives, in place of `analog_out`, which has to be dropped then.
    pub drive_out: CanDriveOut,
    /// What the drives report.
    pub drive_in: CanDriveIn,
    /// Power and faults.
    pub digital_in: CanDigitalIn,
    /// Enable and brakes. Where this half is dropped, drives follow by the word of `drive_out`
    /// alone.
    pub digital_out: Option<CanDigitalOut>,
    /// What is counted.
    pub monitor: BusMonitor,
}

/// Opens the interface that `config` names and sets its drives up.
///
/// # Errors
/// The config is refused; there is no such interface; a drive does not answer, is none, or refuses
/// what it is asked for. No drive was enabled then.
pub fn open(config: &Config) -> Result<Halves, OpenError> {
    config.check()?;
    let port = SocketPort::open(&config.interface).map_err(|error| {
        let what = format!("it cannot be opened ({error})");
        let remedy = "look with `ip -details link` whether there is such an interface, and whether \
                      it is up";
        OpenError::device(&config.interface, "interface", what, remedy)
    })?;
    if let Some(held) = port.queue_frames() {
        check_queue(config, held)?;
    }
    attach(Box::new(port), config)
}

/// Refuses a queue that does not hold the frames of a cycle: they are handed over faster than a bus
/// carries them.
fn check_queue(config: &Config, held: u32) -> Result<(), OpenError> {
    let needed = config.cycle_frames();
    if held as usize >= needed {
        return Ok(());
    }
    let what = format!("its queue holds {held} frames, and a cycle has {needed}");
    let remedy =
        format!("`ip link set {} txqueuelen {}`", config.interface, needed.max(QUEUE_FRAMES_USUAL));
    Err(OpenError::device(&config.interface, "interface", what, remedy))
}

/// Takes a link that exists already, such as to a model of the bus in the same process;
/// `config.interface` appears in messages only.
///
/// # Errors
/// As [`open`].
pub fn attach(mut port: Box<dyn Port>, config: &Config) -> Result<Halves, OpenError> {
    config.check()?;
    let drives = match config.protocol {
        Protocol::Canopen => canopen_drives(port.as_mut(), config)?,
        Protocol::Moteus => moteus_drives(port.as_mut(), config)?,
        Protocol::Odrive => odrive_axes(port.as_mut(), config)?,
    };
    // What came besides is no answer of the first cycle.
    for _ in 0..FRAMES_MAX {
        if port.receive_now().is_none() {
            break;
        }
    }
    let joints = drives.len();
    let silence = Nanos::from_millis(i64::from(config.silence_ms));
    let monitor = BusMonitor::default();
    let shared = Arc::new(Shared::new(Bus::new(port, config, drives), monitor.clone()));
    let torque_max = config.torque_max;
    Ok(Halves {
        encoders: CanEncoders { shared: shared.clone(), joints, wait: config.wait() },
        analog_out: (config.mode == DriveMode::Torque).then(|| CanAnalogOut {
            shared: shared.clone(),
            channels: joints,
            torque_max,
            silence,
        }),
        drive_out: CanDriveOut {
            shared: shared.clone(),
            drives: joints,
            control_loop: config.mode.control_loop(),
            targets: config.target_range(),
            silence,
        },
        drive_in: CanDriveIn { shared: shared.clone(), drives: joints },
        digital_in: CanDigitalIn { shared: shared.clone() },
        digital_out: Some(CanDigitalOut { shared: shared.clone(), silence }),
        monitor,
    })
}

fn canopen_drives(port: &mut dyn Port, config: &Config) -> Result<Vec<Box<dyn Drive>>, OpenError> {
    let mut drives = Vec::new();
    for (index, node) in config.nodes.iter().enumerate() {
        let quick_stop = Setup::new(port, config, *node).run()?;
        let brake_bit = config.brake_bit.filter(|_| index == 0);
        drives.push(CanOpenDrive::new(node.id, config, brake_bit, quick_stop));
    }
    for drive in &mut drives {
        first_answer(port, config, drive, &[canopen::sync()])?;
    }
    Ok(drives.into_iter().map(|drive| Box::new(drive) as _).collect())
}

fn moteus_drives(port: &mut dyn Port, config: &Config) -> Result<Vec<Box<dyn Drive>>, OpenError> {
    let mut drives: Vec<Box<dyn Drive>> = Vec::new();
    for node in &config.nodes {
        let NodeConfig { id, counts_per_turn, .. } = *node;
        let drive = MoteusDrive::new(config.host_id, id, counts_per_turn, config.watchdog_ms());
        let mut drive = drive.following(config.mode, config.step_max_counts);
        let stop = drive.stop_frame();
        first_answer(port, config, &mut drive, &[stop])?;
        drives.push(Box::new(drive));
    }
    Ok(drives)
}

fn odrive_axes(port: &mut dyn Port, config: &Config) -> Result<Vec<Box<dyn Drive>>, OpenError> {
    let mut drives: Vec<Box<dyn Drive>> = Vec::new();
    for node in &config.nodes {
        let mut axis = OdriveAxis::new(node.id, node.counts_per_turn);
        let frames = [axis.idle_frame(), torque_mode(node.id)];
        first_answer(port, config, &mut axis, &frames)?;
        drives.push(Box::new(axis));
    }
    Ok(drives)
}

/// Waits for the first position of a drive, which the last one of `frames` or its own question asks
/// for. All of them are sent at every try, because a drive that answers late may have missed them.
fn first_answer(
    port: &mut dyn Port,
    config: &Config,
    drive: &mut dyn Drive,
    frames: &[Frame],
) -> Result<(), OpenError> {
    let id = config.interface.clone();
    let wait = i64::from(config.open_wait_ms) * 1_000_000 / i64::from(FIRST_ANSWERS_MAX);
    for _ in 0..FIRST_ANSWERS_MAX {
        for frame in frames.iter().copied().chain(drive.query()) {
            // Whether it arrived is seen by what comes.
            let _ = port.send(&frame);
        }
        port.start_wait(Nanos(wait));
        for _ in 0..FRAMES_MAX {
            let Some(frame) = port.receive() else { break };
            if ErrorClass::of(&frame).is_some_and(ErrorClass::is_bus_off) {
                let remedy = "look at bit rate, cable and resistors; `ip link set` restarts it";
                return Err(OpenError::device(id, "interface", "it is bus-off", remedy));
            }
            if let Some(DriveMessage::Position(_)) = drive.receive(&frame) {
                return Ok(());
            }
        }
    }
    let what = format!("{} sends no position within {} ms", drive.name(), config.open_wait_ms);
    let remedy = "switch it on, and look at its number, the bit rate and the bus's two resistors";
    Err(OpenError::device(id, "nodes", what, remedy))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_queue_shorter_than_a_cycle_is_refused_with_the_command_that_mends_it() {
        let nodes = (1..=6).map(|id| NodeConfig { id, ..NodeConfig::default() }).collect();
        let config = Config { interface: "can0".to_owned(), nodes, ..Config::default() };
        let refused = check_queue(&config, 10).unwrap_err().to_string();
        assert!(refused.contains("holds 10 frames, and a cycle has 15"), "{refused}");
        assert!(refused.contains("ip link set can0 txqueuelen 64"), "{refused}");
        assert!(check_queue(&config, 15).is_ok());
    }
}
