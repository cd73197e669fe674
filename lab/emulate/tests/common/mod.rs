//! A scene whose finger presses the pin from the start, and the production drivers joined with its
//! emulated boards in virtual time.
#![allow(dead_code, reason = "each test binary uses a part of it")]
#![expect(clippy::disallowed_types, reason = "test and driver look at one robot")]

mod card;
pub(crate) mod cell;

use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, Mutex};

use taktil_drivers_ethercat as ethercat;
use taktil_drivers_mesa::{Board, Config, Halves, Port};
use taktil_drivers_serial::{
    BoardKind as SerialKind, Config as SerialConfig, Outlet, Scan, Session,
};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{
    AnalogOut, CHANNELS, DacCode, DigitalIn, DigitalOut, Encoders, LinesIn, LinesOut, Nanos,
};
use taktil_lab_emulate::{BoardKind, EmulatedRobot};
use taktil_lab_scene::scene::Scene;
use taktil_machine::source::{FileKind, Source};

/// The cycle of the tests.
pub(crate) const CYCLE_PERIOD: Nanos = Nanos::from_micros(2_500);

/// How long a datagram takes to the card while it is opened: the driver asks it in a loop until
/// something is done.
const OPENING_TRANSIT_TIME: Nanos = Nanos::from_micros(20);

/// A robot whose finger presses the pin by about 0.1 mm, with its brakes on.
pub(crate) fn pressed_scene(more: &str) -> Scene {
    let machine =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes/machine/puma260.toml");
    let machine = Source::read(&machine, FileKind::Machine).unwrap();
    let text = format!(
        "title = \"Pressed\"\n[start]\nfinger_mm = [310.7, -127.0, -149.15]\n[world.pin]\n\
         radius_mm = 23.0\n{more}"
    );
    let source = Source { path: "pressed.toml".into(), text };
    Scene::of(source, Some(machine), &|_| Err("no other file".to_owned())).unwrap()
}

/// The emulated card, which has to be the board that it is.
pub(crate) fn card_config() -> Config {
    Config { board: "7I92".to_owned(), ..card::card_config("127.0.0.1:27181") }
}

/// Collects scans.
struct Scans {
    empty: Scan,
    all: Vec<Scan>,
}

impl Outlet for Scans {
    fn take(&mut self) -> Option<Box<Scan>> {
        Some(Box::new(self.empty.clone()))
    }

    fn put(&mut self, scan: Box<Scan>) {
        self.all.push(*scan);
    }
}

/// The driver's end of a link in virtual time.
pub(crate) struct VirtualPort {
    robot: Arc<Mutex<EmulatedRobot>>,
    end: Nanos,
    packets: VecDeque<Vec<u8>>,
    /// How long a datagram takes to the card.
    transit: Arc<Mutex<Nanos>>,
}

impl VirtualPort {
    /// Opens the segment, which is the first of the robot's boards. Afterwards the cable takes no
    /// time.
    pub(crate) fn open_segment(
        robot: &Arc<Mutex<EmulatedRobot>>,
        config: &ethercat::Config,
    ) -> ethercat::Halves {
        let transit = Arc::new(Mutex::new(OPENING_TRANSIT_TIME));
        let port = VirtualPort {
            robot: robot.clone(),
            end: Nanos::ZERO,
            packets: VecDeque::new(),
            transit: transit.clone(),
        };
        let halves = ethercat::Segment::attach(Box::new(port), config).unwrap();
        *transit.lock().unwrap() = Nanos::ZERO;
        halves
    }

    /// Opens the card, which is the first of the robot's boards. Afterwards the link takes no time.
    pub(crate) fn open_card(robot: &Arc<Mutex<EmulatedRobot>>, config: &Config) -> Halves {
        let transit = Arc::new(Mutex::new(OPENING_TRANSIT_TIME));
        let port = VirtualPort {
            robot: robot.clone(),
            end: Nanos::ZERO,
            packets: VecDeque::new(),
            transit: transit.clone(),
        };
        let halves = Board::attach(Box::new(port), config).unwrap();
        *transit.lock().unwrap() = Nanos::ZERO;
        halves
    }
}

impl Port for VirtualPort {
    fn send(&mut self, packet: &[u8]) -> std::io::Result<()> {
        let mut robot = self.robot.lock().unwrap();
        let arrival = robot.now() + *self.transit.lock().unwrap();
        robot.advance(arrival);
        robot.receive(0, packet);
        Ok(())
    }

    fn start_wait(&mut self, wait: Nanos) {
        self.end = self.robot.lock().unwrap().now() + wait;
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        let mut robot = self.robot.lock().unwrap();
        loop {
            robot.deliver(0, &mut |packet| self.packets.push_back(packet.to_vec()));
            if let Some(packet) = self.packets.pop_front() {
                buffer[..packet.len()].copy_from_slice(&packet);
                return Some(packet.len());
            }
            if robot.now() >= self.end {
                return None;
            }
            let due = robot.next_due(0).min(self.end);
            robot.advance(due);
        }
    }
}

impl ethercat::Port for VirtualPort {
    fn send(&mut self, frame: &[u8]) -> std::io::Result<()> {
        Port::send(self, frame)
    }

    fn start_wait(&mut self, wait: Nanos) {
        Port::start_wait(self, wait);
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        Port::receive(self, buffer)
    }

    fn elapsed(&mut self) -> Nanos {
        self.robot.lock().unwrap().now()
    }
}

/// What a cycle saw.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Seen {
    pub(crate) counts: Option<[i32; 6]>,
    pub(crate) lines: Option<LinesIn>,
    pub(crate) state_hash: u64,
}

/// Drivers and boards in virtual time: a card, and a tactile board.
pub(crate) struct Bench {
    pub(crate) robot: Arc<Mutex<EmulatedRobot>>,
    halves: Halves,
    session: Session,
    scans: Scans,
    cycle: i64,
    start: Nanos,
    feed: bool,
}

impl Bench {
    pub(crate) fn new(scene: &Scene, tactile: BoardKind, faults: &[&str], seed: u64) -> Bench {
        let plan = FaultPlan::new(faults.iter().map(|text| text.parse().unwrap()).collect());
        let boards = [BoardKind::Mesa, tactile];
        let robot = EmulatedRobot::new(scene, &boards, &plan, seed).unwrap().with_waiting_world();
        let robot = Arc::new(Mutex::new(robot));
        let halves = VirtualPort::open_card(&robot, &card_config());
        let board = match tactile {
            BoardKind::Myrmex => SerialKind::Myrmex,
            BoardKind::Flexitac => SerialKind::Flexitac,
            BoardKind::WeissWts => SerialKind::WeissWts,
            _ => SerialKind::WeissDsa,
        };
        let config = SerialConfig { board, rate_hz: 100.0, ..SerialConfig::default() };
        let mut session = Session::new(&config).unwrap();
        let scans = Scans { empty: Scan::new(session.geometry()), all: Vec::new() };
        let now = robot.lock().unwrap().now();
        session.restart(now);
        robot.lock().unwrap().start_world();
        let start = now;
        Bench { robot, halves, session, scans, cycle: 0, start, feed: false }
    }

    /// A cycle with these codes of the card and lines.
    pub(crate) fn cycle(&mut self, codes: [i32; 6], enabled: bool) -> Seen {
        let release = self.start + CYCLE_PERIOD * self.cycle;
        self.cycle += 1;
        self.exchange(release);
        let counts = self.halves.encoders.as_mut().unwrap().sample(release).ok();
        let lines = self.halves.digital_in.as_mut().unwrap().sample(release).ok();
        let mut words = [DacCode(0); CHANNELS];
        words.iter_mut().zip(codes).for_each(|(word, code)| *word = DacCode(code));
        self.feed = !self.feed;
        let out = LinesOut { enable: enabled, brake_release: enabled, watchdog_feed: self.feed };
        let _ = self.halves.analog_out.as_mut().unwrap().commit(release, &words);
        let _ = self.halves.digital_out.as_mut().unwrap().commit(release, &out);
        Seen {
            counts: counts.map(|reading| core::array::from_fn(|i| reading.value[i].0)),
            lines: lines.map(|reading| reading.value),
            state_hash: self.robot.lock().unwrap().world().state_hash(),
        }
    }

    /// Bytes between the tactile board and its session, up to an instant.
    fn exchange(&mut self, to: Nanos) {
        let mut robot = self.robot.lock().unwrap();
        while robot.now() < to {
            let next = robot.next_due(1).max(robot.now() + Nanos(1)).min(to);
            robot.advance(next);
            let mut bytes = Vec::new();
            robot.deliver(1, &mut |some| bytes.extend(some));
            self.session.push(next, &bytes, &mut self.scans);
            if let Some(request) = self.session.poll(next) {
                robot.receive(1, request.bytes());
            }
        }
    }

    /// The count of the newest index pulse of joint 1, as the driver saw it.
    pub(crate) fn index_pulse(&self) -> Option<i32> {
        let pulses = self.halves.encoders.as_ref().unwrap().index_pulses();
        pulses[0].map(|count| count.0)
    }

    /// All scans that arrived.
    pub(crate) fn scans(&self) -> &[Scan] {
        &self.scans.all
    }
}
