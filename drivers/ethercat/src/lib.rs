//! EtherCAT segments: drives by CiA 402 in the cyclic modes, terminals with analog channels,
//! encoders and digital lines, exchanged within the job of a lane by the crate `ethercrab`.
//!
//! A segment is opened in steps: the devices are found and compared with the configuration, number
//! by number; drives get their process data and mode, and every device the time of its watchdog;
//! then all are led to OP and back to SAFEOP, so that what they refuse is known before a lane
//! begins. They go to OP again with the first commits of the lane, because the watchdogs run there.
//!
//! # A cycle
//!
//! The first input half that is sampled exchanges the process data of all devices in one frame and
//! waits for it, the other input halves get the same answer. The output half that commits last
//! exchanges again, so that outputs act in their own cycle; with `exchange = "once"` they go with
//! the next reading instead. A frame that does not come within the wait is given up; when it comes
//! later it is counted and discarded. The working counter is compared with that of all devices, and
//! readings of an exchange that not every device has served are withheld.
//!
//! With `exchange = "pipelined"` nobody waits: the first half of a job sends the frame, with the
//! outputs of the job before, and takes the answer to the frame of the job before. Readings are one
//! cycle old, as `acquired` says, and the first job has none. A frame has until the next release to
//! come back; then it is given up before the next one is sent, so that one is under way at a time.
//!
//! System calls after opening: those of [`SYSTEM_CALLS`], on two descriptors. There is no thread
//! beside the lane, and nothing is allocated in it.
//!
//! # Drives
//!
//! A half for drives commands them by three separate acts: to follow, to stop by their own quick
//! stop, and to reset a fault, which enables nothing. Torques, velocities or positions are its
//! targets, by `mode`; velocities have to be counts a second in the drives, and positions are those
//! of their own counters. Without it codes go to the drives as to converters.
//!
//! In that case the enable line leads all drives through the states of CiA 402 when it is
//! `at = "drives"`, and
//! takes them out by their own quick stop when it falls. While a drive is wanted and does not
//! follow, commits of its channel fail; [`SegmentMonitor`] tells the code of its fault. Whoever was
//! told so takes the line away; its next rise resets the fault and enables. A fault that no commit
//! has told of is only reset by the first rise, and the commits then say that the drive is missing.
//!
//! # Clocks
//!
//! With `sync` the drives act by their distributed clocks: SYNC0 of each is set up while the
//! segment is opened, and each frame carries the time of the first device that has a clock to all
//! others. [`EthercatClock`] says how much later than its place in the cycle the first frame of a
//! job passed that device, by which the machine may follow the segment.
//!
//! # When something fails
//!
//! Lost and late frames, working counters that are too low and devices that leave OP are counted.
//! Devices that fell back to SAFEOP, for example because their watchdog has bitten, are led to OP
//! by the commits that follow, with outputs at their safe values; a wish to enable that stood
//! meanwhile has to be given up before it counts again. A segment that no exchange has served as a
//! whole for `lost_ms` is gone until it is opened anew.
//!
//! Longest silence: devices put their safe values out `watchdog_ms` after the last outputs. The
//! driver does it for a half that has not committed for as long while others go on, the lines with
//! a change of the feed line.
//!
//! The halves of a segment belong on one lane. They may be on several: a half that finds another
//! one on the segment answers with a transient error at once, and going safe is then done by the
//! other.

mod bus;
mod clock;
mod config;
mod drive;
mod drive_halves;
mod emergency;
mod field;
mod halves;
mod health;
mod identity;
mod master;
mod port;
mod setup;
mod ticks;
mod transfer;
mod wiring;

use std::ops::RangeInclusive;
use std::sync::Arc;

use taktil_drivers_cia402::error_text;
pub use taktil_drivers_exchange::LEVEL_LIMIT;
use taktil_drivers_exchange::{Refusal, Shared};
pub use taktil_hal::OpenError;
use taktil_hal::{CHANNELS, DacCode, DriveLoop, Nanos, SystemCall};

pub use clock::EthercatClock;
pub use config::{
    Config, DeviceConfig, DriveMode, ExchangeTimes, Kind, Line, LineKind, LinesInConfig,
    LinesOutConfig, Place, SyncConfig,
};
pub use drive_halves::{EthercatDriveIn, EthercatDriveOut};
pub use halves::{
    EthercatAnalogIn, EthercatAnalogOut, EthercatDigitalIn, EthercatDigitalOut, EthercatEncoders,
    SegmentMonitor,
};
pub use health::Diagnostics;
pub use port::{Port, RawPort};
pub use setup::DriveFacts;
pub use wiring::TERMINAL_VOLTS_PER_CODE;

use bus::Bus;
use drive_halves::DriveTargets;
use halves::OutputTimes;
use health::Counts;
use setup::Ready;
use wiring::{AnalogPlace, TERMINAL_CODE_MAX, TERMINAL_CODE_MIN, Wiring};

/// What the halves ask of the kernel within a job.
pub const SYSTEM_CALLS: &[SystemCall] = &[
    SystemCall {
        name: "send",
        about: "the frame of an exchange, or a request of operation; the socket does not block",
    },
    SystemCall {
        name: "recv",
        about: "takes one frame; the socket does not block, and calls of a wait are counted",
    },
    SystemCall {
        name: "poll",
        about: "waits for a frame; the timer ends it, within the wait that the half declares",
    },
    SystemCall { name: "timerfd_settime", about: "sets the end of a wait before it begins" },
];

/// The halves that a segment offers by its configuration.
#[derive(Debug)]
pub struct Halves {
    /// Encoders, where there are some.
    pub encoders: Option<EthercatEncoders>,
    /// Targets of drives or analog outputs, where there are some.
    pub analog_out: Option<EthercatAnalogOut>,
    /// Commands to the drives, where there are some and all are in one mode; in place of
    /// `analog_out`, which has to be dropped then.
    pub drive_out: Option<EthercatDriveOut>,
    /// What the drives report, where there are some.
    pub drive_in: Option<EthercatDriveIn>,
    /// Analog inputs, where there are some.
    pub analog_in: Option<EthercatAnalogIn>,
    /// Lines from the cell, where they are configured.
    pub digital_in: Option<EthercatDigitalIn>,
    /// Lines to the cell, where they are configured.
    pub digital_out: Option<EthercatDigitalOut>,
    /// The segment's clock, where the drives act by it.
    pub board_clock: Option<EthercatClock>,
    /// What was counted.
    pub monitor: SegmentMonitor,
    /// What the drives say of their motors and limits.
    pub drives: Vec<DriveFacts>,
    /// Volts for one code of each analog channel; empty where drives are behind them.
    pub analog_out_volts_per_code: Vec<f64>,
}

/// Opens a segment and splits it into its halves.
#[derive(Debug)]
pub struct Segment;

/// The standard's text for the code of a drive's fault (object 0x603F).
#[must_use]
pub fn fault_text(code: u16) -> &'static str {
    error_text(code)
}

impl Segment {
    /// Opens the segment at the interface that `config` names. The devices then wait in SAFEOP,
    /// without torque and with outputs off.
    ///
    /// # Errors
    /// The config is refused; the interface cannot be had; nothing answers; the devices are not
    /// those that are listed, or refuse what they are asked for.
    pub fn open(config: &Config) -> Result<Halves, OpenError> {
        config.check()?;
        let port = raw_port(&config.interface)?;
        Segment::attach(Box::new(port), config)
    }

    /// Takes a cable that exists already, such as to a model of a segment in the same process;
    /// `config.interface` appears in messages only.
    ///
    /// # Errors
    /// As [`Segment::open`].
    pub fn attach(port: Box<dyn Port>, config: &Config) -> Result<Halves, OpenError> {
        config.check_segment()?;
        let ready = setup::open(port, config).map_err(|refusal| refusal.at(&config.interface))?;
        Ok(split(ready, config))
    }
}

fn raw_port(interface: &str) -> Result<RawPort, OpenError> {
    RawPort::open(interface).map_err(|error| {
        let remedy = if error.kind() == std::io::ErrorKind::PermissionDenied {
            "give the program the capability CAP_NET_RAW"
        } else {
            "name an interface as `ip link` lists it"
        };
        let what = format!("no raw socket can be had there ({error})");
        Refusal::new("interface", what, remedy).at(interface)
    })
}

/// The range of codes that all analog channels take.
fn code_range(wiring: &Wiring, ready: &Ready, config: &Config) -> RangeInclusive<DacCode> {
    let listed: Vec<&DeviceConfig> =
        config.devices.iter().filter(|one| one.kind == Kind::Drive).collect();
    let limit = |number: usize| {
        let own = listed.get(number).and_then(|one| one.code_max);
        let facts = ready.drives.get(number);
        let most = facts.map_or(0, |facts| u32::from(facts.torque_max_permille));
        own.unwrap_or(most.min(i16::MAX.unsigned_abs().into()))
    };
    let drives = wiring.analog_out.iter().filter_map(|place| match place {
        AnalogPlace::Drive(number) => Some(limit(*number)),
        AnalogPlace::Terminal(_) => None,
    });
    match drives.min() {
        Some(most) => {
            let most = i32::try_from(most).unwrap_or(i32::MAX);
            DacCode(-most)..=DacCode(most)
        }
        None => DacCode(TERMINAL_CODE_MIN)..=DacCode(TERMINAL_CODE_MAX),
    }
}

/// What all drives take alike; `None` without drives, and where their modes differ.
fn drive_targets(ready: &Ready, config: &Config) -> Option<DriveTargets> {
    let listed: Vec<&DeviceConfig> =
        config.devices.iter().filter(|one| one.kind == Kind::Drive).collect();
    let mode = listed.first()?.mode;
    if listed.len() > CHANNELS || listed.iter().any(|one| one.mode != mode) {
        return None;
    }
    let control_loop = mode.control_loop();
    let own_limit = match control_loop {
        DriveLoop::Torque => i32::from(i16::MAX),
        DriveLoop::Velocity => i32::MAX,
        // Where a drive may be led is bounded by its steps, not by its counter.
        DriveLoop::Position => {
            let (low, high) = (i32::MIN, i32::MAX);
            return Some(DriveTargets { drives: listed.len(), control_loop, low, high });
        }
    };
    let limit = |(one, facts): (&&DeviceConfig, &DriveFacts)| {
        let stated = one.code_max.unwrap_or(u32::from(facts.torque_max_permille));
        i32::try_from(stated).unwrap_or(i32::MAX).min(own_limit)
    };
    let most = listed.iter().zip(&ready.drives).map(limit).min()?;
    Some(DriveTargets { drives: listed.len(), control_loop, low: -most, high: most })
}

fn split(ready: Ready, config: &Config) -> Halves {
    let wiring = ready.wiring.clone();
    let drives = ready.drives.clone();
    let range = code_range(&wiring, &ready, config);
    let targets = drive_targets(&ready, config);
    let shared = Arc::new(Shared::new(Bus::new(ready, config), Counts::default()));
    let wait = config.exchange_wait();
    // The first input half waits for all of them, and the lines for both output halves.
    let has_encoders = !wiring.encoders.is_empty();
    let has_inputs = !wiring.analog_in.is_empty();
    let wait_unless = |served: bool| if served { Nanos::ZERO } else { wait };
    let longest_silence = Nanos::from_millis(i64::from(config.watchdog_ms));
    let has_outputs = !wiring.analog_out.is_empty();
    let is_terminal = |place: &&AnalogPlace| matches!(place, AnalogPlace::Terminal(_));
    let terminals = wiring.analog_out.iter().filter(is_terminal).count();
    let times = |wait| OutputTimes { longest_silence, wait };
    Halves {
        encoders: has_encoders
            .then(|| EthercatEncoders::new(shared.clone(), wiring.encoders.len(), wait)),
        analog_out: has_outputs.then(|| {
            let channels = wiring.analog_out.len();
            EthercatAnalogOut::new(shared.clone(), channels, range, times(wait))
        }),
        drive_out: targets
            .map(|targets| EthercatDriveOut::new(shared.clone(), targets, times(wait))),
        drive_in: (1..=CHANNELS)
            .contains(&drives.len())
            .then(|| EthercatDriveIn::new(shared.clone(), drives.len(), wait_unless(has_encoders))),
        analog_in: has_inputs.then(|| {
            let channels = wiring.analog_in.len();
            EthercatAnalogIn::new(shared.clone(), channels, wait_unless(has_encoders))
        }),
        digital_in: wiring.lines_in.map(|_| {
            EthercatDigitalIn::new(shared.clone(), wait_unless(has_encoders || has_inputs))
        }),
        digital_out: wiring.lines_out.map(|_| EthercatDigitalOut::new(shared.clone(), times(wait))),
        board_clock: config.sync.map(|_| {
            let wait = wait_unless(has_encoders || has_inputs || wiring.lines_in.is_some());
            EthercatClock::new(shared.clone(), config.period(), wait)
        }),
        monitor: SegmentMonitor::new(shared),
        drives,
        analog_out_volts_per_code: vec![TERMINAL_VOLTS_PER_CODE; terminals],
    }
}
