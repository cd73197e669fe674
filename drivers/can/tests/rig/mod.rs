//! A bus in this process, behind a link in virtual time, for the tests of the driver.
#![allow(dead_code, reason = "each test program uses a part of it")]
#![expect(clippy::disallowed_types, reason = "test and driver look at one emulator")]

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use taktil_drivers_can::frame::FLEXIBLE_BYTES;
use taktil_drivers_can::{Config, Frame, Halves, NodeConfig, Port, Protocol, SendError, attach};
use taktil_drivers_can_emulator::{BusFrame, Emulator, Kind, Motor, Outputs};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{
    AnalogOut, CHANNELS, DacCode, DigitalOut, Encoders, Error, LinesOut, Nanos, OpenError,
};

/// How long a frame takes.
const TRANSIT_TIME: Nanos = Nanos::from_micros(50);
/// The cycle of all tests.
pub(crate) const CYCLE_PERIOD: Nanos = Nanos::from_micros(2_500);
/// Numbers of the drives.
pub(crate) const DRIVE_IDS: [u8; 3] = [1, 5, 9];

/// What emulator, link and test share.
pub(crate) struct World {
    pub(crate) emulator: Emulator,
    pub(crate) now: Nanos,
    inbox: VecDeque<Vec<u8>>,
    /// Every frame from the driver.
    pub(crate) sent: Vec<Frame>,
    /// Frames that the interface takes before its queue is full.
    pub(crate) room: usize,
    /// Frames that a wait makes room for.
    pub(crate) room_a_wait: usize,
}

struct VirtualPort {
    world: Arc<Mutex<World>>,
    end: Nanos,
}

impl Port for VirtualPort {
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        let mut world = self.world.lock().unwrap();
        if world.room == 0 {
            return Err(SendError::Full);
        }
        world.room -= 1;
        world.sent.push(*frame);
        let mut bytes = [0; FLEXIBLE_BYTES];
        let count = frame.write(&mut bytes);
        world.now += TRANSIT_TIME;
        let now = world.now;
        world.emulator.receive(now, &bytes[..count]);
        Ok(())
    }

    fn start_wait(&mut self, wait: Nanos) {
        let mut world = self.world.lock().unwrap();
        world.room = world.room.saturating_add(world.room_a_wait);
        self.end = world.now + wait;
    }

    fn receive(&mut self) -> Option<Frame> {
        let mut world = self.world.lock().unwrap();
        for _ in 0..1_000 {
            if let Some(bytes) = world.inbox.pop_front() {
                return Frame::read(&bytes);
            }
            let due = world.emulator.next_due().filter(|due| *due <= self.end);
            world.now = world.now.max(due.unwrap_or(self.end));
            world.poll();
            if due.is_none() && world.inbox.is_empty() {
                return None;
            }
        }
        panic!("the emulator has something due at all times");
    }

    fn receive_now(&mut self) -> Option<Frame> {
        let mut world = self.world.lock().unwrap();
        world.poll();
        world.inbox.pop_front().and_then(|bytes| Frame::read(&bytes))
    }
}

impl World {
    fn poll(&mut self) {
        let mut frames = Vec::new();
        self.emulator.poll(self.now, &mut frames);
        self.inbox.extend(frames);
    }
}

/// The bus with its link.
#[derive(Clone)]
pub(crate) struct Rig {
    pub(crate) world: Arc<Mutex<World>>,
}

impl Rig {
    /// Drives of a kind; faults begin at the instant at which the world is, which the opening moves
    /// on by some milliseconds.
    pub(crate) fn new(kind: Kind, faults: &[&str]) -> Rig {
        Rig::with_ids(kind, &DRIVE_IDS, faults)
    }

    pub(crate) fn with_ids(kind: Kind, ids: &[u8], faults: &[&str]) -> Rig {
        let plan = FaultPlan::new(faults.iter().map(|text| text.parse().unwrap()).collect());
        let emulator = Emulator::new(kind, ids).with_faults(plan, "can", 1);
        let world = World {
            emulator,
            now: Nanos::ZERO,
            inbox: VecDeque::new(),
            sent: Vec::new(),
            room: usize::MAX,
            room_a_wait: 0,
        };
        Rig { world: Arc::new(Mutex::new(world)) }
    }

    pub(crate) fn port(&self) -> Box<dyn Port> {
        Box::new(VirtualPort { world: self.world.clone(), end: Nanos::ZERO })
    }

    pub(crate) fn open(&self, config: &Config) -> Result<Halves, OpenError> {
        attach(self.port(), config)
    }

    /// Moves the world up to a release; it may be further already.
    pub(crate) fn advance(&self, release: Nanos) {
        let mut world = self.world.lock().unwrap();
        world.now = world.now.max(release);
        world.poll();
    }

    /// The first release after what has happened.
    pub(crate) fn next_release(&self) -> Nanos {
        CYCLE_PERIOD * (self.world.lock().unwrap().now.0 / CYCLE_PERIOD.0 + 1)
    }

    pub(crate) fn inject(&self, frame: &BusFrame) {
        let mut world = self.world.lock().unwrap();
        let now = world.now;
        world.emulator.inject(now, frame);
    }

    pub(crate) fn outputs(&self, place: usize) -> Outputs {
        let mut world = self.world.lock().unwrap();
        let now = world.now;
        world.emulator.advance(now);
        world.emulator.outputs(place)
    }

    pub(crate) fn motor(&self, place: usize) -> Motor {
        self.world.lock().unwrap().emulator.motor(place)
    }

    pub(crate) fn set_room(&self, room: usize) {
        self.world.lock().unwrap().room = room;
    }
}

/// A rig with open halves that are driven cycle by cycle.
pub(crate) struct Lane {
    pub(crate) rig: Rig,
    pub(crate) halves: Halves,
    pub(crate) release: Nanos,
    feed: bool,
    /// Whether the feed line changes.
    pub(crate) feeds: bool,
    /// Whether torques are committed.
    pub(crate) commits: bool,
}

/// What came of a cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cycle {
    pub(crate) counts: Result<i32, Error>,
    pub(crate) torques: Result<(), Error>,
    pub(crate) lines: Result<(), Error>,
}

impl Lane {
    pub(crate) fn new(rig: &Rig, config: &Config) -> Lane {
        let halves = rig.open(config).unwrap();
        let release = rig.next_release();
        let rig = rig.clone();
        Lane { rig, halves, release, feed: false, feeds: true, commits: true }
    }

    /// One cycle: positions, torques, lines.
    pub(crate) fn cycle(&mut self, enable: bool, code: i32) -> Cycle {
        self.rig.advance(self.release);
        let release = self.release;
        let counts = self.halves.encoders.sample(release).map(|reading| reading.value[0].0);
        let codes = [DacCode(code); CHANNELS];
        let commits = self.commits;
        let analog = self.halves.analog_out.as_mut().unwrap();
        let torques = if commits { analog.commit(release, &codes) } else { Ok(()) };
        self.feed ^= self.feeds;
        let lines = LinesOut { enable, brake_release: enable, watchdog_feed: self.feed };
        let lines = self.halves.digital_out.as_mut().unwrap().commit(release, &lines);
        self.release += CYCLE_PERIOD;
        Cycle { counts, torques, lines }
    }

    pub(crate) fn cycles(&mut self, enable: bool, code: i32, count: usize) -> Vec<Cycle> {
        (0..count).map(|_| self.cycle(enable, code)).collect()
    }

    /// How many drives are enabled.
    pub(crate) fn enabled(&self) -> usize {
        let count = self.rig.world.lock().unwrap().emulator.drives();
        (0..count).filter(|place| self.rig.outputs(*place).is_enabled).count()
    }

    /// A number that the driver counted.
    pub(crate) fn counted(&self, name: &str) -> u64 {
        let counts = self.halves.monitor.counts();
        counts.iter().find(|(own, _)| *own == name).expect("it is counted").1
    }
}

/// The config of the rig's drives.
pub(crate) fn config(protocol: Protocol) -> Config {
    let node = |id| NodeConfig { id, ..NodeConfig::default() };
    Config {
        interface: "rig".to_owned(),
        protocol,
        nodes: DRIVE_IDS.map(node).to_vec(),
        ..Config::default()
    }
}
