//! A segment in this process: the emulator behind a cable in virtual time, for the tests of the
//! driver.
#![allow(dead_code)]
#![expect(clippy::disallowed_types, reason = "test and driver look at one segment")]

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use taktil_drivers_ethercat::{
    Config, DeviceConfig, Halves, Kind, Line, LineKind, LinesInConfig, LinesOutConfig, OpenError,
    Port, Segment,
};
use taktil_drivers_ethercat_emulator as emulator;
use taktil_drivers_ethercat_emulator::{Description, Inputs, Model, Shaft};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{CHANNELS, DacCode, LinesOut, Nanos};

/// How long a frame takes.
const TRANSIT_TIME: Nanos = Nanos(20_000);
/// The cycle of all tests.
pub(crate) const CYCLE_PERIOD: Nanos = Nanos::from_micros(1_000);

/// What emulator, cable and test share.
pub(crate) struct World {
    pub(crate) segment: emulator::Segment,
    pub(crate) now: Nanos,
    /// Frames from the driver.
    pub(crate) sent: usize,
    /// After how many frames the drive at position 3 sends an emergency; 0 for never.
    pub(crate) emergency_frames: usize,
    /// Frames that arrive before the segment's answers.
    pub(crate) arrived: VecDeque<Vec<u8>>,
}

/// What others share, also after a test has failed with it in its hands.
pub(crate) fn locked<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The driver's end of the cable.
struct VirtualPort {
    world: Arc<Mutex<World>>,
    end: Nanos,
}

impl Port for VirtualPort {
    fn send(&mut self, frame: &[u8]) -> std::io::Result<()> {
        let mut world = locked(&self.world);
        world.sent += 1;
        world.now += TRANSIT_TIME;
        let now = world.now;
        if world.emergency_frames > 0 && world.sent.is_multiple_of(world.emergency_frames) {
            world.segment.send_emergency(3, 0x3220);
        }
        world.segment.receive(now, frame);
        Ok(())
    }

    fn start_wait(&mut self, wait: Nanos) {
        self.end = locked(&self.world).now + wait;
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        let mut world = locked(&self.world);
        if world.arrived.is_empty() {
            let Some(due) = world.segment.next_due().filter(|due| *due <= self.end) else {
                world.now = world.now.max(self.end);
                let now = world.now;
                world.segment.advance(now);
                return None;
            };
            world.now = world.now.max(due);
            let (now, mut answers) = (world.now, Vec::new());
            world.segment.poll(now, &mut answers);
            world.arrived.extend(answers);
        }
        let frame = world.arrived.pop_front()?;
        buffer[..frame.len()].copy_from_slice(&frame);
        Some(frame.len())
    }

    fn elapsed(&mut self) -> Nanos {
        locked(&self.world).now
    }
}

/// What the plant shows.
pub(crate) type Cell = Arc<Mutex<Inputs>>;

/// Emulator, plant and cable.
#[derive(Clone)]
pub(crate) struct Rig {
    pub(crate) world: Arc<Mutex<World>>,
    pub(crate) cell: Cell,
}

impl Rig {
    pub(crate) fn new(devices: Vec<Description>) -> Rig {
        let cell = Cell::default();
        locked(&cell).has_supply = true;
        let shown = cell.clone();
        let plant = move |_: Nanos, _: &emulator::Outputs| locked(&shown).clone();
        let segment = emulator::Segment::new(devices, Box::new(plant));
        let (sent, emergency_frames, arrived) = (0, 0, VecDeque::new());
        let world = World { segment, now: Nanos(1), sent, emergency_frames, arrived };
        Rig { world: Arc::new(Mutex::new(world)), cell }
    }

    /// A segment with motors that turn.
    pub(crate) fn with_motors(devices: Vec<Description>) -> Rig {
        let rig = Rig::new(devices.clone());
        let motors = emulator::idle_motors();
        rig.world().segment = emulator::Segment::new(devices, motors);
        rig
    }

    /// Lets faults befall the segment from now on; their times count from now.
    pub(crate) fn with_faults(self, faults: &[&str]) -> Rig {
        let plan = FaultPlan::new(faults.iter().map(|text| text.parse().unwrap()).collect());
        let mut world = self.world();
        let stand_in = emulator::Segment::new(vec![Model::Coupler.into()], emulator::idle_motors());
        let segment = std::mem::replace(&mut world.segment, stand_in);
        world.segment = segment.with_faults(plan, "ethercat", 1).unwrap();
        drop(world);
        self
    }

    pub(crate) fn world(&self) -> MutexGuard<'_, World> {
        locked(&self.world)
    }

    pub(crate) fn open(&self, config: &Config) -> Result<Halves, OpenError> {
        let port = VirtualPort { world: self.world.clone(), end: Nanos::ZERO };
        Segment::attach(Box::new(port), config)
    }

    /// Moves the world on by a cycle.
    pub(crate) fn pass(&self, span: Nanos) {
        let mut world = self.world();
        world.now += span;
        let now = world.now;
        world.segment.advance(now);
    }

    pub(crate) fn set_counts(&self, counts: impl Fn(usize) -> i64) {
        let mut cell = locked(&self.cell);
        cell.counts = (0..6).map(&counts).collect();
        let shaft = |position| Shaft { position_counts: position as f64, speed_counts_s: 0.0 };
        cell.shafts = (0..6).map(|one| shaft(counts(one))).collect();
    }

    pub(crate) fn outputs(&self) -> emulator::Outputs {
        self.world().segment.outputs()
    }
}

/// A coupler and terminals: two analog outputs of four channels, two encoders, inputs, lines.
pub(crate) fn terminals() -> (Vec<Description>, Config) {
    let models = [
        (Model::Coupler, Kind::Ek1100),
        (Model::AnalogOutput, Kind::El4134),
        (Model::Encoder16, Kind::El5101),
        (Model::Encoder32, Kind::El5151),
        (Model::AnalogInput, Kind::El3104),
        (Model::DigitalInput, Kind::El1008),
        (Model::DigitalOutput, Kind::El2008),
    ];
    let config = Config {
        devices: models.iter().map(|(_, kind)| DeviceConfig::of(*kind)).collect(),
        lines_in: Some(LinesInConfig {
            drive_power: terminal(5, 0),
            estop_a: terminal(5, 1),
            estop_b: Line { inverted: true, ..terminal(5, 7) },
        }),
        lines_out: Some(LinesOutConfig {
            enable: terminal(6, 0),
            brake_release: Some(Line { inverted: true, ..terminal(6, 1) }),
            watchdog_feed: Some(terminal(6, 7)),
        }),
        ..Config::default()
    };
    (models.iter().map(|(model, _)| (*model).into()).collect(), config)
}

pub(crate) fn terminal(device: usize, channel: usize) -> Line {
    Line { at: LineKind::Terminal, device, channel, inverted: false }
}

pub(crate) fn at_drives() -> Line {
    Line { at: LineKind::Drives, device: 0, channel: 0, inverted: false }
}

/// A drive as the emulator's.
pub(crate) fn drive() -> DeviceConfig {
    let (vendor, product) = (emulator::DRIVE_VENDOR_ID, emulator::DRIVE_PRODUCT_ID);
    DeviceConfig { vendor: Some(vendor), product: Some(product), ..DeviceConfig::of(Kind::Drive) }
}

/// Six drives behind a coupler.
pub(crate) fn six_drives() -> (Vec<Description>, Config) {
    let mut models = vec![Model::Coupler];
    models.extend([Model::Drive; 6]);
    let mut devices = vec![DeviceConfig::of(Kind::Ek1100)];
    devices.extend((0..6).map(|_| drive()));
    let config = Config {
        devices,
        lines_in: Some(LinesInConfig {
            drive_power: at_drives(),
            estop_a: at_drives(),
            estop_b: at_drives(),
        }),
        lines_out: Some(LinesOutConfig {
            enable: at_drives(),
            brake_release: None,
            watchdog_feed: None,
        }),
        ..Config::default()
    };
    (models.into_iter().map(Description::from).collect(), config)
}

/// The codes of analog outputs by the volts outside.
pub(crate) fn codes_of(volts: &[f64]) -> [DacCode; CHANNELS] {
    core::array::from_fn(|channel| {
        DacCode((volts.get(channel).copied().unwrap_or(0.0) * 3_276.8).round() as i32)
    })
}

/// The lines of [`terminals`] by the levels outside.
pub(crate) fn lines_of(levels: &[u8]) -> LinesOut {
    let level = levels.first().copied().unwrap_or(0);
    LinesOut {
        enable: level & 1 != 0,
        brake_release: level & 2 == 0,
        watchdog_feed: level & 0x80 != 0,
    }
}

/// A lane that samples and commits in each cycle.
pub(crate) struct Lane {
    pub(crate) halves: Halves,
    pub(crate) release: Nanos,
    pub(crate) feed: bool,
    /// How old readings are.
    pub(crate) age: Nanos,
}

/// What a cycle of a lane answered.
#[derive(Debug)]
pub(crate) struct Cycle {
    pub(crate) counts: Result<[i32; 6], taktil_hal::Error>,
    pub(crate) analog: Result<(), taktil_hal::Error>,
    pub(crate) lines: Result<(), taktil_hal::Error>,
}

impl Lane {
    pub(crate) fn new(halves: Halves) -> Lane {
        Lane { halves, release: Nanos::ZERO, feed: false, age: Nanos::ZERO }
    }

    /// One cycle with these outputs.
    pub(crate) fn cycle(&mut self, rig: &Rig, enable: bool, code: i32) -> Cycle {
        use taktil_hal::{AnalogOut, DigitalOut, Encoders};
        self.release += CYCLE_PERIOD;
        let due = self.release;
        let encoders = self.halves.encoders.as_mut().unwrap();
        let counts = encoders.sample(due).map(|reading| {
            assert_eq!(reading.acquired, due - self.age);
            core::array::from_fn(|joint| reading.value[joint].0)
        });
        let mut codes = [DacCode(i32::MAX); CHANNELS];
        let analog = self.halves.analog_out.as_mut().unwrap();
        codes[..analog.channels()].fill(DacCode(code));
        let analog = analog.commit(due, &codes);
        self.feed = !self.feed;
        let lines = LinesOut { enable, brake_release: enable, watchdog_feed: self.feed };
        let lines = self.halves.digital_out.as_mut().unwrap().commit(due, &lines);
        rig.pass(Nanos::from_micros(900));
        Cycle { counts, analog, lines }
    }

    /// Cycles with the same outputs; the last one's answers.
    pub(crate) fn cycles(&mut self, rig: &Rig, count: usize, enable: bool, code: i32) -> Cycle {
        for _ in 1..count {
            self.cycle(rig, enable, code);
        }
        self.cycle(rig, enable, code)
    }
}
