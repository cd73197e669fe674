//! Prints the driver's own time for a cycle of six drives of CANopen: encoding, decoding and
//! book-keeping of a SYNC, six answers, six targets, a controlword and a sign of life, over a bus
//! that answers at once from memory.
//!
//! `can_own_time [CYCLES]`; `can_own_time --instructions CYCLES` prints nothing, for a tool that
//! counts.

use std::collections::VecDeque;

use taktil_drivers_can::frame::FLEXIBLE_BYTES;
use taktil_drivers_can::{Config, Frame, Halves, NodeConfig, Port, SendError, attach, canopen};
use taktil_drivers_can_emulator::{Emulator, Kind};
use taktil_hal::{AnalogOut, CHANNELS, DacCode, DigitalOut, Encoders, LinesOut, Nanos};
use taktil_rtcore::guard::{self, CountingAllocator};
use taktil_rtcore::linux::monotonic;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Cycles of a slice.
const SLICE_CYCLES: i64 = 1_000;
/// Drives on the bus.
const DRIVES_COUNT: u8 = 6;
/// SYNCs until the drives are set up and enabled: from then on what they said last comes again.
const SYNCS_UNTIL_FROZEN: usize = 400;

/// A bus that answers by an emulator until it is frozen, and from memory afterwards.
struct Replay {
    emulator: Emulator,
    now: Nanos,
    syncs: usize,
    inbox: VecDeque<Frame>,
    /// What came after the newest SYNC.
    answers: Vec<Frame>,
}

impl Replay {
    fn is_frozen(&self) -> bool {
        self.syncs >= SYNCS_UNTIL_FROZEN
    }

    fn poll(&mut self) {
        let mut all = Vec::new();
        self.emulator.poll(self.now, &mut all);
        for frame in all.iter().filter_map(|bytes| Frame::read(bytes)) {
            self.answers.push(frame);
            self.inbox.push_back(frame);
        }
    }
}

impl Port for Replay {
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        let is_sync = frame.id == u32::from(canopen::SYNC_ID);
        if self.is_frozen() {
            if is_sync {
                self.inbox.extend(&self.answers);
            }
            return Ok(());
        }
        if is_sync {
            self.syncs += 1;
            self.answers.clear();
        }
        self.now += Nanos(50_000);
        let mut bytes = [0; FLEXIBLE_BYTES];
        let count = frame.write(&mut bytes);
        self.emulator.receive(self.now, &bytes[..count]);
        self.poll();
        if self.is_frozen() {
            // Only what answers a SYNC comes again.
            self.answers.retain(|frame| (0x180..0x200).contains(&frame.id));
            assert_eq!(self.answers.len(), usize::from(DRIVES_COUNT), "every drive answers");
        }
        Ok(())
    }

    fn start_wait(&mut self, wait: Nanos) {
        if !self.is_frozen() {
            self.now += Nanos(wait.0 / 100);
            self.poll();
        }
    }

    fn receive(&mut self) -> Option<Frame> {
        self.inbox.pop_front()
    }

    fn receive_now(&mut self) -> Option<Frame> {
        self.inbox.pop_front()
    }
}

fn cycle(halves: &mut Halves, release: Nanos) -> bool {
    let counts = halves.encoders.sample(release).is_ok();
    let codes = [DacCode((release.0 & 0x1ff) as i32); CHANNELS];
    let codes = halves.analog_out.as_mut().map(|half| half.commit(release, &codes).is_ok());
    let feed = (release.0 / 1_000_000) & 1 == 1;
    let lines = LinesOut { enable: true, brake_release: true, watchdog_feed: feed };
    let lines = halves.digital_out.as_mut().map(|half| half.commit(release, &lines).is_ok());
    counts && codes == Some(true) && lines == Some(true)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let counted = arguments.iter().position(|word| word == "--instructions");
    let counted = counted.map(|at| arguments.remove(at)).is_some();
    let cycles: i64 = arguments.first().map_or(Ok(100_000), |word| word.parse())?;
    let ids: Vec<u8> = (1..=DRIVES_COUNT).collect();
    let nodes = ids.iter().map(|id| NodeConfig { id: *id, ..NodeConfig::default() }).collect();
    let config =
        Config { interface: "memory".to_owned(), nodes, period_us: 1_000, ..Config::default() };
    let port = Replay {
        emulator: Emulator::new(Kind::CanOpen(1_000), &ids),
        now: Nanos(1),
        syncs: 0,
        inbox: VecDeque::with_capacity(64),
        answers: Vec::with_capacity(64),
    };
    let mut halves = attach(Box::new(port), &config)?;
    let mut release = Nanos::ZERO;
    for _ in 0..2 * SYNCS_UNTIL_FROZEN {
        release += Nanos::from_millis(1);
        cycle(&mut halves, release);
    }
    let (mut slices, mut calls, mut failed) = (Vec::new(), 0, 0);
    for _ in 0..(cycles / SLICE_CYCLES).max(1) {
        let length = SLICE_CYCLES.min(cycles);
        let begin = monotonic();
        let ((), heap) = guard::count_heap_calls(|| {
            for _ in 0..length {
                release += Nanos::from_millis(1);
                failed += i32::from(!cycle(&mut halves, release));
            }
        });
        calls += heap;
        slices.push((monotonic() - begin).0 as f64 / length as f64);
    }
    assert_eq!(failed, 0, "every cycle is good");
    slices.sort_by(f64::total_cmp);
    if !counted {
        let median = slices[slices.len() / 2];
        println!("{median:.0} ns a cycle of six drives, {calls} calls of the heap");
    }
    Ok(())
}
