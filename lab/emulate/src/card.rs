//! A HostMot2 card before the simulated robot: volts at its analog outputs drive the motors, its
//! lines the drives, and its counters follow the discs.

use taktil_drivers_mesa_emulator::{Emulator, Firmware, IndexPulses, Inputs, Outputs};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{CHANNELS, Counts, Nanos};

use crate::board::Traffic;
use crate::simulated::{Commands, SimulatedRobot};
use crate::wiring::{CardWiring, code_of_volts};

/// Motors that a 7I77 drives.
pub(crate) const MOTORS_MAX: usize = 6;
/// How often a voltage that stays is told to the world again, which takes silence for a cable that
/// is off: well below its 50 ms.
const REFRESH_TIME: Nanos = Nanos::from_millis(20);
/// Ports of the card's pins.
const PIN_PORTS: usize = 2;

/// The card and what it put out last.
pub(crate) struct Card {
    emulator: Emulator,
    wiring: CardWiring,
    outputs: Outputs,
    exchanges: u64,
    /// When the world was last told.
    driven: Nanos,
    /// When the newest exchange was, and the longest time after one for which outputs stayed on.
    heard: Nanos,
    unattended: Nanos,
    /// The relay's line, where the card does not drive one.
    feed: bool,
    /// Datagrams for the host.
    pub(crate) outbox: Vec<Vec<u8>>,
}

impl Card {
    pub(crate) fn new(
        robot: &SimulatedRobot,
        wiring: CardWiring,
        plan: FaultPlan,
        name: &str,
        seed: u64,
    ) -> Card {
        let places = robot.index_pulse_places();
        let pulses: Vec<IndexPulses> = places
            .iter()
            .map(|place| IndexPulses {
                first: i64::from(place.first.0),
                turn: i64::from(place.turn_counts),
            })
            .collect();
        let emulator = Emulator::without_plant(Firmware::with_7i77())
            .with_index_pulses(&pulses)
            .with_faults(plan, name, seed);
        Card {
            emulator,
            wiring,
            outputs: Outputs::default(),
            exchanges: 0,
            driven: Nanos::ZERO,
            heard: Nanos::ZERO,
            unattended: Nanos::ZERO,
            feed: false,
            outbox: Vec::new(),
        }
    }

    /// The next instant at which it does something by itself.
    pub(crate) fn next_event(&self) -> Nanos {
        let refresh = Some(self.driven + REFRESH_TIME);
        let all = [self.emulator.next_change(), self.emulator.next_due(), refresh];
        all.into_iter().flatten().min().unwrap_or(Nanos::MAX)
    }

    /// When the next datagram for the host is due.
    pub(crate) fn next_due(&self) -> Nanos {
        self.emulator.next_due().unwrap_or(Nanos::MAX)
    }

    /// Executes what happens at `now`: the robot is driven by what the card puts out.
    pub(crate) fn step(&mut self, now: Nanos, robot: &mut SimulatedRobot) {
        let outputs = self.emulator.outputs(now);
        let exchanges = self.emulator.exchanges();
        if self.is_on() {
            self.unattended = self.unattended.max(now - self.heard);
        }
        if exchanges != self.exchanges {
            self.heard = now;
        }
        let refresh = now - self.driven >= REFRESH_TIME;
        if refresh || exchanges != self.exchanges || outputs != self.outputs {
            if refresh {
                // Whoever says the same for a long time does not fill the links.
                robot.advance(now);
            }
            self.feed = !self.feed;
            robot.drive(now, &self.commands(&outputs, robot.full_codes()));
            (self.outputs, self.exchanges, self.driven) = (outputs, exchanges, now);
        }
        self.emulator.poll(now, &mut self.outbox);
    }

    /// Whether anything was put out last but zeros and lines that are off.
    fn is_on(&self) -> bool {
        let lines = self.wiring.lines_out(self.outputs.field, false);
        self.outputs.volts.iter().any(|volts| *volts != 0.0) || lines.enable || lines.brake_release
    }

    fn commands(&self, outputs: &Outputs, full_codes: f64) -> Commands {
        let mut codes = [0; CHANNELS];
        for (code, volts) in codes.iter_mut().zip(outputs.volts) {
            *code = code_of_volts(volts, full_codes);
        }
        Commands { codes, lines: self.wiring.lines_out(outputs.field, self.feed) }
    }

    /// Reads the robot's discs and lines, which has been integrated up to `now`.
    pub(crate) fn read(&mut self, now: Nanos, robot: &mut SimulatedRobot) {
        let counts = robot.counts();
        let wired = robot.joints().min(MOTORS_MAX);
        let inputs = Inputs {
            counts: counts.iter().take(wired).map(|Counts(count)| i64::from(*count)).collect(),
            field: self.wiring.field_inputs(robot.lines_in()),
            pins: vec![0; PIN_PORTS],
            ..Inputs::default()
        };
        self.emulator.set_inputs(now, inputs);
    }

    /// Takes a datagram at `now`; the inputs have been read.
    pub(crate) fn receive(&mut self, now: Nanos, packet: &[u8], robot: &mut SimulatedRobot) {
        self.emulator.receive(now, packet);
        self.step(now, robot);
    }

    pub(crate) fn traffic(&self) -> Traffic {
        Traffic::Card {
            link: self.emulator.traffic(),
            bites: self.emulator.bites(),
            overrun_commands: self.emulator.overrun_commands(),
            unattended: self.unattended,
        }
    }
}
