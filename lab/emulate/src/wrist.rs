//! A Net F/T box before the simulated robot: a record holds the codes of the wrist's gauges at its
//! instant.

use taktil_drivers_netft_emulator::Emulator;
use taktil_hal::Nanos;
use taktil_hal::fault::FaultPlan;

use crate::board::Traffic;
use crate::simulated::SimulatedRobot;

/// Records a second.
const RECORD_RATE_HZ: u32 = 1_000;

/// The box.
pub(crate) struct WristBox {
    emulator: Emulator,
    /// Records for the host.
    pub(crate) outbox: Vec<Vec<u8>>,
}

impl WristBox {
    pub(crate) fn new(plan: FaultPlan, name: &str, seed: u64) -> WristBox {
        let emulator = Emulator::without_sensor(RECORD_RATE_HZ).with_faults(plan, name, seed);
        WristBox { emulator, outbox: Vec::new() }
    }

    /// What it is and serves, for people.
    pub(crate) fn description(&self) -> String {
        format!("Net F/T: the codes of the wrist's gauges, {RECORD_RATE_HZ} records/s when asked")
    }

    /// The next instant at which it does something by itself.
    pub(crate) fn next_event(&self) -> Nanos {
        self.emulator.next_due().unwrap_or(Nanos::MAX)
    }

    /// Executes what happens at `now`: the world is integrated to the instants of records only.
    pub(crate) fn step(&mut self, now: Nanos, robot: &mut SimulatedRobot) {
        if self.next_event() <= now {
            robot.advance(now);
            self.emulator.set_counts(robot.readings(now).gauges);
        }
        self.emulator.poll(now, &mut self.outbox);
    }

    /// Takes a request at `now`, up to which the world has been integrated.
    pub(crate) fn receive(&mut self, now: Nanos, request: &[u8], robot: &mut SimulatedRobot) {
        self.emulator.set_counts(robot.readings(now).gauges);
        self.emulator.receive(now, request);
        self.step(now, robot);
    }

    pub(crate) fn traffic(&self) -> Traffic {
        Traffic::Wrist(self.emulator.traffic())
    }
}
