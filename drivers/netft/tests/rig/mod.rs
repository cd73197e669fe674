//! A box in this process, behind a link in virtual time, for the tests of the driver.
#![allow(dead_code, reason = "each test program uses a part of it")]
#![expect(clippy::disallowed_types, reason = "test and driver look at one emulator")]

use std::sync::{Arc, Mutex};

use taktil_drivers_netft::{Arrival, Config, NetFt, Port};
use taktil_drivers_netft_emulator::Emulator;
use taktil_hal::fault::FaultPlan;
use taktil_hal::{ForceTorque, GaugeCodes, Nanos, Reading};

/// The cycle of all tests.
pub(crate) const CYCLE_PERIOD: Nanos = Nanos::from_micros(2_500);

/// What emulator, link and test share.
struct World {
    emulator: Emulator,
    now: Nanos,
    /// Datagrams that have arrived.
    inbox: Vec<Vec<u8>>,
    sent: Vec<Vec<u8>>,
}

/// The emulator and its link.
#[derive(Clone)]
pub(crate) struct Rig {
    world: Arc<Mutex<World>>,
}

struct VirtualPort {
    world: Arc<Mutex<World>>,
}

impl Port for VirtualPort {
    fn send(&mut self, packet: &[u8]) -> std::io::Result<()> {
        let mut world = self.world.lock().unwrap();
        let now = world.now;
        world.sent.push(packet.to_vec());
        world.emulator.receive(now, packet);
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Arrival {
        let mut world = self.world.lock().unwrap();
        if world.inbox.is_empty() {
            return Arrival::Nothing;
        }
        let bytes = world.inbox.remove(0);
        let length = bytes.len().min(buffer.len());
        buffer[..length].copy_from_slice(&bytes[..length]);
        Arrival::Datagram(length)
    }
}

impl Rig {
    /// A box of `rate_hz` that streams already; Fz counts microseconds.
    pub(crate) fn new(rate_hz: u32, faults: &[&str]) -> Rig {
        let plan = FaultPlan::new(faults.iter().map(|text| text.parse().unwrap()).collect());
        let sensor = |now: Nanos| [7, -7, (now.0 / 1_000) as i32, 1, -1, 0];
        let mut emulator = Emulator::new(rate_hz, Box::new(sensor)).with_faults(plan, "netft", 1);
        emulator.receive(Nanos::ZERO, &[0x12, 0x34, 0, 2, 0, 0, 0, 0]);
        let world = World { emulator, now: Nanos::ZERO, inbox: Vec::new(), sent: Vec::new() };
        Rig { world: Arc::new(Mutex::new(world)) }
    }

    pub(crate) fn open(&self, config: &Config) -> NetFt {
        NetFt::new(Box::new(VirtualPort { world: self.world.clone() }), config)
    }

    /// Puts a datagram of somebody's before the half.
    pub(crate) fn inject(&self, bytes: &[u8]) {
        self.world.lock().unwrap().inbox.push(bytes.to_vec());
    }

    /// Requests of the driver so far.
    pub(crate) fn sent(&self) -> Vec<Vec<u8>> {
        self.world.lock().unwrap().sent.clone()
    }

    pub(crate) fn advance(&self, release: Nanos) {
        let mut world = self.world.lock().unwrap();
        world.now = release;
        let mut records = Vec::new();
        world.emulator.poll(release, &mut records);
        world.inbox.append(&mut records);
    }

    /// Samples every cycle from one release to another; the outcomes.
    pub(crate) fn run(
        &self,
        half: &mut NetFt,
        from_cycle: i64,
        to_cycle: i64,
    ) -> Vec<Result<Reading<GaugeCodes>, taktil_hal::Error>> {
        let cycle = |cycle| {
            let release = CYCLE_PERIOD * cycle;
            self.advance(release);
            half.sample(release)
        };
        (from_cycle..to_cycle).map(cycle).collect()
    }
}

/// The config of a box of `rate_hz`.
pub(crate) fn config(rate_hz: u32) -> Config {
    Config { address: "127.0.0.1:49152".to_owned(), rate_hz, ..Config::default() }
}
