//! The emulated cell and the simulated one as devices of a machine, both in virtual time: the first
//! through the production drivers, whose bytes the boards answer, the second through the
//! simulator's own halves with the same delays.

use std::sync::{Arc, Mutex};

use taktil_drivers_ethercat as ethercat;
use taktil_drivers_mesa::{Config, Halves, REMOTE_VOLTS_PER_CODE};
use taktil_drivers_serial::{Config as SerialConfig, ScanRings, SerialTactile, Session, attach};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{
    Arrival, CHANNELS, Counts, Devices, DigitalIn, Encoders, Error, ErrorKind, IndexPulses,
    LinesIn, Nanos, Reading, TACTILE, TactileArray, TactileFrame,
};
use taktil_lab_emulate::{BoardKind, EmulatedRobot};
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_machine::joints::JointsConfig;
use taktil_sim::World;

use super::{VirtualPort, card_config};

/// Longest dialogue with a tactile board, and longest time to its first scan.
const DIALOGUE_TIME_MAX: Nanos = Nanos::from_secs(2);
/// From one look at a line to the next during the dialogue.
const LOOK_PERIOD: Nanos = Nanos::from_micros(100);

/// What stands behind the halves, and moves in time only when somebody looks.
pub(crate) trait Cell: Send {
    /// Brings it up to an instant of the machine.
    fn bring_to(&mut self, instant: Nanos);
}

impl Cell for World {
    fn bring_to(&mut self, instant: Nanos) {
        self.advance(instant);
    }
}

/// The tactile board's line with its driver, and the instant of the boards at which the world and
/// the machine begin.
pub(crate) struct CellLine {
    pub(crate) robot: Arc<Mutex<EmulatedRobot>>,
    pub(crate) session: Session,
    rings: ScanRings,
    zero: Nanos,
    /// The number of the last scan before the machine began.
    pub(crate) scans_before: u32,
}

impl CellLine {
    /// The hash of the world at an instant of the machine, up to which it is integrated.
    pub(crate) fn world_hash(&mut self, instant: Nanos) -> u64 {
        self.bring_to(instant);
        let mut robot = self.robot.lock().unwrap();
        robot.integrate();
        robot.world().state_hash()
    }
}

impl Cell for CellLine {
    /// Carries bytes between board and driver.
    fn bring_to(&mut self, instant: Nanos) {
        let mut robot = self.robot.lock().unwrap();
        let to = self.zero + instant;
        while robot.now() < to {
            let next = robot.next_due(1).max(robot.now() + Nanos(1)).min(to);
            robot.advance(next);
            let mut bytes = Vec::new();
            robot.deliver(1, &mut |some| bytes.extend(some));
            self.session.push(next - self.zero, &bytes, &mut self.rings);
            if let Some(request) = self.session.poll(next - self.zero) {
                robot.receive(1, request.bytes());
            }
        }
        self.rings.report(self.session.health());
    }
}

/// A half that brings its cell up to a release before it is sampled.
struct Synchronous<C, H> {
    cell: Arc<Mutex<C>>,
    half: H,
}

impl<C: Cell, H: Encoders + ?Sized> Encoders for Synchronous<C, Box<H>> {
    fn joints(&self) -> usize {
        self.half.joints()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        self.cell.lock().unwrap().bring_to(release);
        self.half.sample(release)
    }

    fn has_index(&self) -> bool {
        self.half.has_index()
    }

    fn index_pulses(&self) -> IndexPulses {
        self.half.index_pulses()
    }
}

impl<C: Cell, H: TactileArray + ?Sized> TactileArray for Synchronous<C, Box<H>> {
    fn rows(&self) -> usize {
        self.half.rows()
    }

    fn cols(&self) -> usize {
        self.half.cols()
    }

    fn full_scale(&self) -> u16 {
        self.half.full_scale()
    }

    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        self.cell.lock().unwrap().bring_to(release);
        self.half.sample(release, frame)
    }
}

/// A card and a tactile board that were opened before a world that waits.
struct Opened {
    line: CellLine,
    motors: Devices,
    array: SerialTactile,
}

/// What drives the motors: the board, and what the wiring of the joints says of its codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Motors {
    Card,
    Drives(ethercat::ExchangeTimes),
}

impl Motors {
    fn board(self) -> BoardKind {
        match self {
            Motors::Card => BoardKind::Mesa,
            Motors::Drives(_) => BoardKind::Ethercat,
        }
    }

    fn open(self, robot: &Arc<Mutex<EmulatedRobot>>, joints: usize) -> Devices {
        match self {
            Motors::Card => {
                let config = Config { index: false, ..card_config() };
                let card: Halves = VirtualPort::open_card(robot, &config);
                Devices {
                    encoders: card.encoders.map(|half| Box::new(half) as _),
                    analog_out: card.analog_out.map(|half| Box::new(half) as _),
                    digital_in: card.digital_in.map(|half| Box::new(half) as _),
                    digital_out: card.digital_out.map(|half| Box::new(half) as _),
                    ..Devices::default()
                }
            }
            Motors::Drives(exchange) => {
                let config = ethercat::Config { exchange, ..segment_config(joints) };
                let drives = VirtualPort::open_segment(robot, &config);
                Devices {
                    encoders: drives.encoders.map(|half| Box::new(half) as _),
                    analog_out: drives.analog_out.map(|half| Box::new(half) as _),
                    digital_in: drives.digital_in.map(|half| Box::new(half) as _),
                    digital_out: drives.digital_out.map(|half| Box::new(half) as _),
                    ..Devices::default()
                }
            }
        }
    }

    fn joints(self) -> (JointsConfig, [f64; CHANNELS]) {
        let (text, volts) = match self {
            Motors::Card => ("full_scale_v = [10, 10, 10, 10, 10, 10]", REMOTE_VOLTS_PER_CODE),
            Motors::Drives(_) => ("full_scale_codes = [1000, 1000, 1000, 1000, 1000, 1000]", 0.0),
        };
        (toml::from_str(text).unwrap(), [volts; CHANNELS])
    }
}

/// The emulated segment: a coupler, a terminal with the lines, and a drive for each joint.
fn segment_config(joints: usize) -> ethercat::Config {
    let line = |channel| ethercat::Line {
        at: ethercat::LineKind::Terminal,
        device: 1,
        channel,
        inverted: false,
    };
    let at_drives =
        ethercat::Line { at: ethercat::LineKind::Drives, device: 0, channel: 0, inverted: false };
    let drive = || ethercat::DeviceConfig {
        vendor: Some(0xffe),
        product: Some(0x402),
        ..ethercat::DeviceConfig::of(ethercat::Kind::Drive)
    };
    let mut devices = vec![
        ethercat::DeviceConfig::of(ethercat::Kind::Ek1100),
        ethercat::DeviceConfig::of(ethercat::Kind::El1008),
    ];
    devices.extend((0..joints).map(|_| drive()));
    ethercat::Config {
        devices,
        lines_in: Some(ethercat::LinesInConfig {
            drive_power: line(0),
            estop_a: line(1),
            estop_b: line(2),
        }),
        lines_out: Some(ethercat::LinesOutConfig {
            enable: at_drives,
            brake_release: None,
            watchdog_feed: None,
        }),
        period_us: 2_500,
        watchdog_ms: 25,
        ..ethercat::Config::default()
    }
}

impl Opened {
    /// Opens the boards; `zero` is the instant of the boards at which the machine begins.
    fn new(
        scene: &Scene,
        motors: Motors,
        board: BoardKind,
        config: &SerialConfig,
        faults: &[&str],
        zero: Nanos,
    ) -> Opened {
        let boards = [motors.board(), board];
        let plan = FaultPlan::new(faults.iter().map(|text| text.parse().unwrap()).collect());
        let robot = EmulatedRobot::new(scene, &boards, &plan, scene.seed).unwrap();
        let robot = Arc::new(Mutex::new(robot.with_waiting_world()));
        let motors = motors.open(&robot, scene.robot.joints());
        let (array, mut session, rings) = attach(config).unwrap();
        // Nobody listened to a board that streams by itself while the card was opened.
        robot.lock().unwrap().deliver(1, &mut |_| ());
        session.restart(robot.lock().unwrap().now() - zero);
        Opened { line: CellLine { robot, session, rings, zero, scans_before: 0 }, motors, array }
    }

    /// Carries the dialogue on for one look, and not beyond `end` (machine's time).
    fn look(&mut self, end: Nanos) -> Nanos {
        let now = self.line.robot.lock().unwrap().now() - self.line.zero;
        let next = (now + LOOK_PERIOD).min(end);
        self.line.bring_to(next);
        next
    }

    /// Carries the dialogue on until the first scan has come; when it was complete.
    fn first_scan(mut self) -> Nanos {
        let mut frame = TactileFrame::of(&self.array);
        loop {
            let now = self.look(Nanos::MAX);
            assert!(now < DIALOGUE_TIME_MAX, "{:?}", self.line.session);
            if self.array.sample(now, &mut frame) == Ok(Arrival::New) {
                return frame.acquired;
            }
        }
    }
}

/// The drivers' halves before the emulated boards of a scene: motors, encoders and lines at a
/// card, touch at a board on a serial line. World and machine begin when a scan of the board is
/// complete and one has come: the line streams, and the scans before have been taken away.
pub(crate) fn emulated(
    scene: &Scene,
    motors: Motors,
    board: BoardKind,
    config: &SerialConfig,
    faults: &[&str],
) -> (Arc<Mutex<CellLine>>, Devices) {
    // A first try tells when that is: equal bytes come at equal instants.
    let first = Opened::new(scene, motors, board, config, faults, Nanos::ZERO).first_scan();
    let zero = first + config.geometry().period;
    let mut opened = Opened::new(scene, motors, board, config, faults, zero);
    while opened.look(Nanos::ZERO) < Nanos::ZERO {}
    let mut frame = TactileFrame::of(&opened.array);
    assert_eq!(opened.array.sample(Nanos(-1), &mut frame), Ok(Arrival::New));
    let Opened { line, motors: driven, array } = opened;
    line.robot.lock().unwrap().start_world();
    let cell = Arc::new(Mutex::new(CellLine { scans_before: frame.sequence, ..line }));
    let encoders = Synchronous { cell: cell.clone(), half: driven.encoders.unwrap() };
    let array = Synchronous { cell: cell.clone(), half: Box::new(array) };
    let devices = Devices {
        encoders: Some(Box::new(encoders)),
        analog_out: driven.analog_out,
        digital_in: driven.digital_in,
        digital_out: driven.digital_out,
        tactile: [(TACTILE.to_owned(), Box::new(array) as Box<dyn TactileArray>)].into(),
        ..Devices::default()
    };
    let (joints, volts_per_code) = motors.joints();
    let devices = joints.connect(&scene.robot, devices, &volts_per_code);
    (cell, devices.unwrap())
}

/// The simulator's own halves before the world of a scene; a board would have numbered
/// `scans_before` scans before.
pub(crate) fn simulated(scene: &Scene, scans_before: u32) -> (Arc<Mutex<World>>, Devices) {
    let (world, mut devices) = Assembly::new(scene).build_world().unwrap();
    let cell = Arc::new(Mutex::new(world));
    let encoders = Synchronous { cell: cell.clone(), half: devices.encoders.take().unwrap() };
    let lines = LinesOfLastCycle { half: devices.digital_in.take().unwrap(), last: None };
    let half = devices.tactile.remove(TACTILE).unwrap();
    let row_period = Nanos((1e3 * scene.world.tactile.row_us).round() as i64);
    let half: Box<dyn TactileArray> = Box::new(ScansOfBoard { half, row_period, scans_before });
    let array = Synchronous { cell: cell.clone(), half };
    let devices = Devices {
        encoders: Some(Box::new(encoders)),
        analog_out: devices.analog_out,
        digital_in: Some(Box::new(lines)),
        digital_out: devices.digital_out,
        tactile: [(TACTILE.to_owned(), Box::new(array) as Box<dyn TactileArray>)].into(),
        ..Devices::default()
    };
    (cell, devices)
}

/// Scans of the simulator with the numbers and row times of a board that was on before the machine
/// began: the simulator's first scan has the number 0, and its rows were read before time zero,
/// where the simulator has none.
struct ScansOfBoard {
    half: Box<dyn TactileArray>,
    row_period: Nanos,
    scans_before: u32,
}

impl TactileArray for ScansOfBoard {
    fn rows(&self) -> usize {
        self.half.rows()
    }

    fn cols(&self) -> usize {
        self.half.cols()
    }

    fn full_scale(&self) -> u16 {
        self.half.full_scale()
    }

    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        let answer = self.half.sample(release, frame)?;
        if answer == Arrival::New {
            frame.sequence += self.scans_before + 1;
            for (row, acquired) in frame.row_acquired.iter_mut().rev().enumerate() {
                *acquired = frame.acquired - self.row_period * row as i64;
            }
        }
        Ok(answer)
    }
}

/// Lines that are one cycle old, as those of a 7I77 are: the exchange of a cycle reads them, and
/// the next cycle's request collects them.
struct LinesOfLastCycle {
    half: Box<dyn DigitalIn>,
    last: Option<Reading<LinesIn>>,
}

impl DigitalIn for LinesOfLastCycle {
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        let now = self.half.sample(release)?;
        let none = Error::whole(ErrorKind::Transient, "sim.digital_in");
        self.last.replace(now).ok_or(none)
    }
}
