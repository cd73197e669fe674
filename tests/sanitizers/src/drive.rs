//! The halves of a driver's board in a lane: all of them are sampled, committed and made safe
//! within jobs, as tasks do it. A run whose halves had no answer would show nothing and is an
//! error.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use nix::errno::Errno;
use taktil_drivers_comedi as comedi;
use taktil_drivers_comedi::board::{
    Board, ChannelInfo, DeviceInfo, InstructionList, Range, SubdeviceInfo,
};
use taktil_drivers_comedi_double::Double;
use taktil_hal::{
    Arrival, CHANNELS, Devices, DriveCommand, DriveRequest, LinesOut, Nanos, TactileFrame,
};
use taktil_machine::config::MachineConfig;
use taktil_machine::robot::AnyRobot;
use taktil_machine_boards::{Epoch, OpenDevices, find};
use taktil_rtcore::live::{self, Contract, Pace, RunObserver, RunOptions};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{Builder, Cycle, FaultCode, Io, LaneSpec, Machine, Output, Task};

use crate::Numbers;
use crate::emulated::section;
use crate::wired_double::{SharedDouble, robot_config};

/// Why a run shows nothing.
type Failure = Box<dyn std::error::Error>;

/// Period of the lane: a loaded machine shall keep it.
const LANE_PERIOD: Nanos = Nanos::from_millis(20);
/// Length of a run: a Myrmex alone is deaf for its first 150 ms.
const RUN_TIME: Nanos = Nanos::from_millis(1_200);
/// The job in which the outputs are made safe, once.
const SAFE_TICK: u64 = 20;
/// The kinds of halves, in the order in which their answers are counted.
const HALF_NAMES: [&str; 10] = [
    "encoders",
    "drive_in",
    "board_clock",
    "analog_in",
    "force_torque",
    "digital_in",
    "tactile",
    "analog_out",
    "drive_out",
    "digital_out",
];

/// How often each kind of half had a good answer.
type Answers = Arc<[AtomicU32; HALF_NAMES.len()]>;

struct HalvesTask {
    devices: Devices,
    frames: Vec<TactileFrame>,
    answers: Answers,
    to: Output<Numbers>,
}

impl HalvesTask {
    fn sample(&mut self, release: Nanos) -> [bool; 7] {
        let devices = &mut self.devices;
        let mut arrived = false;
        for (array, frame) in devices.tactile.values_mut().zip(&mut self.frames) {
            arrived |= array.sample(release, frame) == Ok(Arrival::New);
        }
        [
            devices.encoders.as_mut().is_some_and(|half| half.sample(release).is_ok()),
            devices.drive_in.as_mut().is_some_and(|half| half.sample(release).is_ok()),
            devices.board_clock.as_mut().is_some_and(|half| half.sample(release).is_ok()),
            devices.analog_in.as_mut().is_some_and(|half| half.sample(release).is_ok()),
            devices.force_torque.as_mut().is_some_and(|half| half.sample(release).is_ok()),
            devices.digital_in.as_mut().is_some_and(|half| half.sample(release).is_ok()),
            arrived,
        ]
    }

    fn commit(&mut self, cycle: &Cycle) -> [bool; 3] {
        let feed = cycle.tick % 2 == 0;
        let lines = LinesOut { enable: true, brake_release: true, watchdog_feed: feed };
        let analog = self.devices.analog_out.as_mut().is_some_and(|half| {
            let code = if feed { half.safe_value() } else { half.code_range().1 };
            half.commit(cycle.release, &[code; CHANNELS]).is_ok()
        });
        let drives = self.devices.drive_out.as_mut().is_some_and(|half| {
            // Some jobs follow, some stop, some reset, so that every act is watched.
            let request = DriveRequest::ALL[(cycle.tick / 8 % 3) as usize];
            let targets = [half.target_range().1.min(1); CHANNELS];
            let command = DriveCommand { targets, request, reset: cycle.tick % 16 == 0 };
            half.commit(cycle.release, &command).is_ok()
        });
        let digital = self.devices.digital_out.as_mut();
        [analog, drives, digital.is_some_and(|half| half.commit(cycle.release, &lines).is_ok())]
    }
}

impl Task for HalvesTask {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let sampled = self.sample(cycle.release);
        let committed = self.commit(cycle);
        if cycle.tick == SAFE_TICK {
            // A board without outputs says that it has none.
            let _ = self.devices.safe();
        }
        for (count, good) in self.answers.iter().zip(sampled.into_iter().chain(committed)) {
            count.fetch_add(u32::from(good), Ordering::Relaxed);
        }
        io.write(&self.to, Numbers::default());
        Ok(())
    }
}

/// Tells the halves when the run began.
struct Beginning(Epoch);

impl Observer for Beginning {
    fn record(&mut self, _: &Record<'_>) {}
}

impl RunObserver for Beginning {
    fn on_epoch(&mut self, origin: Nanos) {
        self.0.set(origin);
    }
}

fn lane(devices: Devices, answers: &Answers) -> Result<Machine, Failure> {
    let mut builder = Builder::new();
    let lane = builder.lane(LaneSpec::new("halves", LANE_PERIOD, 40))?;
    let frames = devices.tactile.values().map(|half| TactileFrame::of(half.as_ref())).collect();
    let answers = answers.clone();
    builder.task(lane, "halves", |ports| {
        let to = ports.output("x");
        Ok(Box::new(HalvesTask { devices, frames, answers, to }))
    })?;
    Ok(builder.build()?)
}

/// A double whose lists go through the driver's own call of the kernel first, which refuses them
/// because the node is no board; what the double makes of them is the answer.
#[derive(Debug)]
struct CalledDouble {
    node: comedi::DeviceFile,
    double: Arc<dyn Board>,
}

impl Board for CalledDouble {
    fn device_info(&self) -> Result<DeviceInfo, Errno> {
        self.double.device_info()
    }

    fn subdevices(&self) -> Result<Vec<SubdeviceInfo>, Errno> {
        self.double.subdevices()
    }

    fn channels(&self, subdevice: u32) -> Result<Vec<ChannelInfo>, Errno> {
        self.double.channels(subdevice)
    }

    fn ranges(&self, range_type: u32) -> Result<Vec<Range>, Errno> {
        self.double.ranges(range_type)
    }

    fn lock(&self, subdevice: u32) -> Result<(), Errno> {
        self.double.lock(subdevice)
    }

    fn execute(&self, list: &mut InstructionList) -> Result<usize, Errno> {
        let refused = self.node.execute(list);
        assert_eq!(refused, Err(Errno::ENOTTY), "/dev/null is no board");
        self.double.execute(list)
    }
}

/// The robot's board of the double.
fn comedi_devices() -> Result<Devices, Failure> {
    let double = SharedDouble::new(Double::robot_board(24)).node()?;
    let node = comedi::DeviceFile::from_file(std::fs::File::open("/dev/null")?);
    let halves = comedi::attach(Arc::new(CalledDouble { node, double }), &robot_config())?;
    Ok(Devices {
        encoders: halves.encoders,
        analog_out: halves.analog_out,
        analog_in: halves.analog_in,
        force_torque: halves.force_torque,
        digital_in: halves.digital_in,
        digital_out: halves.digital_out,
        ..Devices::default()
    })
}

fn open(driver: &str, place: &str) -> Result<OpenDevices, Failure> {
    let machine: MachineConfig = toml::from_str(&section(driver, place))?;
    Ok(taktil_machine_boards::open(&machine, &AnyRobot::puma260())?)
}

/// Which kinds of halves there are.
fn served(devices: &Devices) -> [bool; HALF_NAMES.len()] {
    [
        devices.encoders.is_some(),
        devices.drive_in.is_some(),
        devices.board_clock.is_some(),
        devices.analog_in.is_some(),
        devices.force_torque.is_some(),
        devices.digital_in.is_some(),
        !devices.tactile.is_empty(),
        devices.analog_out.is_some(),
        devices.drive_out.is_some(),
        devices.digital_out.is_some(),
    ]
}

/// Runs the halves of a driver's board at `place` in a lane, and says how many answers they had.
///
/// # Errors
/// The board cannot be opened, or one of its halves never had a good answer.
pub fn run(driver: &str, place: &str) -> Result<(), Failure> {
    let (devices, epoch, threads) = if driver == "comedi" {
        (comedi_devices()?, Epoch::default(), Vec::new())
    } else {
        let opened = open(driver, place)?;
        (opened.devices, opened.epoch, opened.threads)
    };
    let there = served(&devices);
    let answers = Answers::default();
    let mut machine = lane(devices, &answers)?;
    let terms = RunOptions { until: RUN_TIME, contract: Contract::Soft, pace: Pace::Fixed };
    live::run(&mut machine, terms, &AtomicBool::new(false), &mut Beginning(epoch))?;
    drop((machine, threads));
    let mut silent = Vec::new();
    for ((name, there), count) in HALF_NAMES.iter().zip(there).zip(answers.iter()) {
        let count = count.load(Ordering::Relaxed);
        if there {
            println!("{driver}: {name} answers={count}");
        }
        if there && count == 0 {
            silent.push(*name);
        }
    }
    if silent.is_empty() { Ok(()) } else { Err(format!("no answer: {}", silent.join(", ")).into()) }
}

/// Prints what the sanitizer is to permit to a driver: the calls that it lists, each by its whole
/// name, but for `except`.
///
/// # Errors
/// There is no such driver, or it does not list `except`.
pub fn print_permitted(driver: &str, except: Option<&str>) -> Result<(), Failure> {
    let calls = find(driver).ok_or("there is no such driver")?.system_calls;
    let names: Vec<&str> = calls.iter().map(|call| call.name).collect();
    if let Some(except) = except.filter(|except| !names.contains(except)) {
        return Err(format!("{driver} does not list {except}").into());
    }
    for name in names.iter().filter(|name| Some(**name) != except) {
        println!("function-name-matches:^{name}$");
    }
    Ok(())
}
