//! A card in this process: the emulator behind a link in virtual time, for the tests of the driver.
#![allow(dead_code)]
#![expect(clippy::disallowed_types, reason = "test and driver look at one emulator")]

use std::sync::{Arc, Mutex};

use taktil_drivers_mesa::{
    Board, Config, Halves, Line, LinesInConfig, LinesOutConfig, OpenError, Port, Terminal,
};
use taktil_drivers_mesa_emulator::{Emulator, Firmware, Inputs, Outputs};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{CHANNELS, DacCode, LinesIn, LinesOut, Nanos};

/// How long a datagram takes.
const TRANSIT_TIME: Nanos = Nanos(20_000);
/// The cycle of all tests.
pub(crate) const CYCLE_PERIOD: Nanos = Nanos::from_micros(2_500);
/// Counts of a turn.
pub(crate) const TURN_COUNTS: i64 = 1_000;

/// What emulator, link and test share.
pub(crate) struct World {
    pub(crate) emulator: Emulator,
    pub(crate) now: Nanos,
    /// Every datagram from the driver.
    pub(crate) sent: Vec<Vec<u8>>,
    /// Datagrams that the link puts before the card's answers.
    pub(crate) garbage: Vec<Vec<u8>>,
    /// Bytes that the network puts behind every answer.
    pub(crate) padding: usize,
}

/// What the plant shows.
#[derive(Clone, Default)]
pub(crate) struct Cell {
    pub(crate) inputs: Arc<Mutex<Inputs>>,
}

/// The driver's end of the link.
struct VirtualPort {
    world: Arc<Mutex<World>>,
    end: Nanos,
}

impl Port for VirtualPort {
    fn send(&mut self, packet: &[u8]) -> std::io::Result<()> {
        let mut world = self.world.lock().unwrap();
        world.sent.push(packet.to_vec());
        world.now += TRANSIT_TIME;
        let now = world.now;
        world.emulator.receive(now, packet);
        Ok(())
    }

    fn start_wait(&mut self, wait: Nanos) {
        self.end = self.world.lock().unwrap().now + wait;
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        let mut world = self.world.lock().unwrap();
        if let Some(bytes) = world.garbage.pop() {
            let length = bytes.len().min(buffer.len());
            buffer[..length].copy_from_slice(&bytes[..length]);
            return Some(length);
        }
        let Some(due) = world.emulator.next_due().filter(|due| *due <= self.end) else {
            world.now = world.now.max(self.end);
            return None;
        };
        world.now = world.now.max(due);
        let (now, mut answers) = (world.now, Vec::new());
        world.emulator.poll(now, &mut answers);
        let first = (!answers.is_empty()).then(|| answers.remove(0));
        answers.reverse();
        let padding = world.padding;
        world.garbage.extend(answers);
        drop(world);
        let mut bytes = first?;
        bytes.resize(bytes.len() + padding, 0);
        let length = bytes.len().min(buffer.len());
        buffer[..length].copy_from_slice(&bytes[..length]);
        Some(length)
    }
}

/// Emulator, plant and link.
#[derive(Clone)]
pub(crate) struct Rig {
    pub(crate) world: Arc<Mutex<World>>,
    pub(crate) cell: Cell,
}

impl Rig {
    pub(crate) fn new(firmware: Firmware) -> Rig {
        let cell = Cell::default();
        let inputs = cell.inputs.clone();
        let plant = move |_: Nanos, _: &Outputs| inputs.lock().unwrap().clone();
        let emulator = Emulator::new(firmware, TURN_COUNTS, Box::new(plant));
        let (sent, garbage) = (Vec::new(), Vec::new());
        let world = World { emulator, now: Nanos::ZERO, sent, garbage, padding: 0 };
        Rig { world: Arc::new(Mutex::new(world)), cell }
    }

    /// Puts faults onto the link, from the instant that the world shows now.
    pub(crate) fn with_faults(self, faults: &[&str], seed: u64) -> Rig {
        let plan = FaultPlan::new(faults.iter().map(|text| text.parse().unwrap()).collect());
        let mut world = self.world.lock().unwrap();
        let empty = Emulator::new(Firmware::with_pwm(), 0, Box::new(|_, _| Inputs::default()));
        let emulator = std::mem::replace(&mut world.emulator, empty);
        world.emulator = emulator.with_faults(plan, "mesa", seed);
        drop(world);
        self
    }

    pub(crate) fn open(&self, config: &Config) -> Result<Halves, OpenError> {
        let port = VirtualPort { world: self.world.clone(), end: Nanos::ZERO };
        Board::attach(Box::new(port), config)
    }

    /// Moves the world up to a release; it may be further already.
    pub(crate) fn advance(&self, release: Nanos) {
        let mut world = self.world.lock().unwrap();
        world.now = world.now.max(release);
    }

    pub(crate) fn now(&self) -> Nanos {
        self.world.lock().unwrap().now
    }

    pub(crate) fn set_counts(&self, counts: [i64; 6]) {
        self.cell.inputs.lock().unwrap().counts = counts.to_vec();
    }

    /// Inputs at the field terminals of all 7I77s.
    pub(crate) fn set_fields(&self, words: &[u32]) {
        let mut inputs = self.cell.inputs.lock().unwrap();
        (inputs.field, inputs.further_fields) = (words[0], words[1..].to_vec());
    }

    pub(crate) fn set_field(&self, word: u32) {
        self.cell.inputs.lock().unwrap().field = word;
    }

    pub(crate) fn set_pins(&self, words: &[u32]) {
        self.cell.inputs.lock().unwrap().pins = words.to_vec();
    }

    /// What the card puts out once everything under way has arrived.
    pub(crate) fn outputs(&self) -> Outputs {
        let mut world = self.world.lock().unwrap();
        world.now += Nanos(100_000);
        let now = world.now;
        world.emulator.outputs(now)
    }

    pub(crate) fn register(&self, address: u16) -> u32 {
        let world = self.world.lock().unwrap();
        world.emulator.register(world.now, address)
    }
}

/// A line at a terminal of the 7I77.
pub(crate) fn field(number: u32) -> Line {
    Line { at: Terminal::Field, number, remote: 0, inverted: false, open_drain: false }
}

/// A line at a pin of the card.
pub(crate) fn pin(number: u32) -> Line {
    Line { at: Terminal::Pin, ..field(number) }
}

/// A card with a 7I77 and all lines at its terminals.
pub(crate) fn with_7i77() -> Config {
    Config {
        address: "10.10.10.10:27181".to_owned(),
        board: "7I92".to_owned(),
        lines_in: Some(LinesInConfig {
            drive_power: field(3),
            estop_a: field(4),
            estop_b: Line { inverted: true, ..field(5) },
        }),
        lines_out: Some(LinesOutConfig {
            enable: field(0),
            brake_release: Line { inverted: true, ..field(1) },
            watchdog_feed: Some(field(2)),
        }),
        ..Config::default()
    }
}

/// A card with modulators and all lines at pins.
pub(crate) fn with_pwm() -> Config {
    Config {
        board: "7I80".to_owned(),
        analog: taktil_drivers_mesa::Analog::Pwm,
        lines_in: Some(LinesInConfig { drive_power: pin(48), estop_a: pin(49), estop_b: pin(71) }),
        lines_out: Some(LinesOutConfig {
            enable: pin(50),
            brake_release: Line { inverted: true, ..pin(51) },
            watchdog_feed: Some(pin(52)),
        }),
        ..with_7i77()
    }
}

/// The lines that a 7I77's terminals show for [`with_7i77`].
pub(crate) fn field_lines(field: u16) -> LinesOut {
    LinesOut {
        enable: field & 1 != 0,
        brake_release: field & 2 == 0,
        watchdog_feed: field & 4 != 0,
    }
}

/// The terminals of [`with_7i77`] for some lines.
pub(crate) fn field_word(lines: LinesIn) -> u32 {
    (u32::from(lines.drive_power) << 3)
        | (u32::from(lines.estop_a_closed) << 4)
        | (u32::from(!lines.estop_b_closed) << 5)
}

/// The codes of a 7I77 that puts out these volts.
pub(crate) fn codes_of(outputs: &Outputs) -> [DacCode; CHANNELS] {
    let mut codes = [DacCode(0); CHANNELS];
    for (code, volts) in codes.iter_mut().zip(outputs.volts) {
        let scale = if volts < 0.0 { 4_096.0 } else { 4_095.0 };
        *code = DacCode((volts * scale / 10.0).round() as i32);
    }
    codes
}
