//! Prints the driver's own time for a cycle with six drives, and beside it that of ethercrab alone
//! for one exchange of the same segment: encoding, decoding and book-keeping, over a cable that
//! answers at once from memory.
//!
//! `ethercat_own_time [CYCLES]`; `ethercat_own_time --instructions CYCLES` runs the driver's cycle
//! of two exchanges alone and prints nothing, for a tool that counts, and
//! `--instructions --library` one exchange of the library.

use std::future::Future;
use std::io;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

use ethercrab::{MainDevice, MainDeviceConfig, PduRx, PduStorage, PduTx, RetryBehaviour, Timeouts};
use taktil_drivers_ethercat::{
    Config, DeviceConfig, ExchangeTimes, Halves, Kind, Line, LineKind, LinesOutConfig, Port,
    Segment,
};
use taktil_drivers_ethercat_emulator as emulator;
use taktil_hal::{AnalogOut, CHANNELS, DacCode, DigitalOut, Encoders, LinesOut, Nanos};
use taktil_rtcore::guard::{self, CountingAllocator};
use taktil_rtcore::linux::monotonic;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Cycles of a slice.
const SLICE_CYCLES: i64 = 1_000;
/// Headers of Ethernet and EtherCAT.
const FRAME_HEADER_BYTES: usize = 16;
/// Header and working counter of a datagram.
const DATAGRAM_OVERHEAD_BYTES: usize = 12;

/// More frames than the opening of the segment and the enabling of its drives take.
const FRAMES_UNTIL_FROZEN: usize = 5_000;

/// A segment that answers by itself until it is frozen; from then on its newest answer comes again,
/// with the numbers of the frame that asks.
struct Replay {
    segment: emulator::Segment,
    now: Nanos,
    frozen: bool,
    answer: Vec<u8>,
    waiting: bool,
}

impl Replay {
    fn new() -> Replay {
        let mut devices = vec![emulator::Model::Coupler.into()];
        devices.extend((0..6).map(|_| emulator::Description::from(emulator::Model::Drive)));
        let segment = emulator::Segment::new(devices, emulator::idle_motors());
        Replay { segment, now: Nanos(1), frozen: false, answer: Vec::new(), waiting: false }
    }

    fn ask(&mut self, frame: &[u8]) {
        self.waiting = true;
        if self.frozen && frame.len() == self.answer.len() {
            number(&mut self.answer, frame);
            return;
        }
        self.now += Nanos(20_000);
        self.segment.receive(self.now, frame);
        let mut answers = Vec::new();
        self.segment.poll(self.now, &mut answers);
        self.answer = answers.pop().unwrap_or_default();
    }

    fn take(&mut self) -> Option<&[u8]> {
        core::mem::take(&mut self.waiting).then_some(self.answer.as_slice())
    }
}

/// Gives each datagram of an answer the number of the one that it answers.
fn number(answer: &mut [u8], frame: &[u8]) {
    let mut at = FRAME_HEADER_BYTES;
    while at + DATAGRAM_OVERHEAD_BYTES <= frame.len() {
        answer[at + 1] = frame[at + 1];
        let flags = u16::from_le_bytes([frame[at + 6], frame[at + 7]]);
        at += DATAGRAM_OVERHEAD_BYTES + usize::from(flags & 0x07ff);
        if flags & 0x8000 == 0 {
            break;
        }
    }
}

/// The driver's end; the segment freezes after so many frames.
struct ReplayPort {
    replay: Replay,
    frames_until_frozen: usize,
}

impl Port for ReplayPort {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        self.frames_until_frozen = self.frames_until_frozen.saturating_sub(1);
        self.replay.frozen = self.frames_until_frozen == 0;
        self.replay.ask(frame);
        Ok(())
    }

    fn start_wait(&mut self, _wait: Nanos) {}

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        if !self.replay.waiting {
            self.replay.now += Nanos::from_micros(100);
        }
        let answer = self.replay.take()?;
        buffer[..answer.len()].copy_from_slice(answer);
        Some(answer.len())
    }

    fn elapsed(&mut self) -> Nanos {
        self.replay.now
    }
}

fn config(exchange: ExchangeTimes) -> Config {
    let (vendor, product) = (emulator::DRIVE_VENDOR_ID, emulator::DRIVE_PRODUCT_ID);
    let drive = || DeviceConfig {
        vendor: Some(vendor),
        product: Some(product),
        ..DeviceConfig::of(Kind::Drive)
    };
    let mut devices = vec![DeviceConfig::of(Kind::Ek1100)];
    devices.extend((0..6).map(|_| drive()));
    let enable = Line { at: LineKind::Drives, device: 0, channel: 0, inverted: false };
    let lines = LinesOutConfig { enable, brake_release: None, watchdog_feed: None };
    Config { devices, lines_out: Some(lines), exchange, watchdog_ms: 1_000, ..Config::default() }
}

fn cycle(halves: &mut Halves, release: Nanos) -> bool {
    let counts = halves.encoders.as_mut().map(|half| half.sample(release).is_ok());
    let codes = [DacCode((release.0 & 0x1ff) as i32); CHANNELS];
    let feed = (release.0 / 1_000_000) & 1 == 1;
    let lines = LinesOut { enable: true, brake_release: true, watchdog_feed: feed };
    let lines = halves.digital_out.as_mut().map(|half| half.commit(release, &lines).is_ok());
    let codes = halves.analog_out.as_mut().map(|half| half.commit(release, &codes).is_ok());
    [counts, lines, codes] == [Some(true); 3]
}

/// Time of a cycle (ns), median of slices, and calls of the heap.
fn measure(start: Nanos, cycles: i64, mut cycle: impl FnMut(Nanos)) -> (f64, u64) {
    let (mut slices, mut release, mut calls) = (Vec::new(), start, 0);
    for _ in 0..(cycles / SLICE_CYCLES).max(1) {
        let length = SLICE_CYCLES.min(cycles);
        let begin = monotonic();
        let ((), heap) = guard::count_heap_calls(|| {
            for _ in 0..length {
                release += Nanos::from_millis(1);
                cycle(release);
            }
        });
        calls += heap;
        slices.push((monotonic() - begin).0 as f64 / length as f64);
    }
    slices.sort_by(f64::total_cmp);
    (slices[slices.len() / 2], calls)
}

/// Polls a future to its end over the cable from memory.
fn run<F: Future>(
    replay: &mut Replay,
    tx: &mut PduTx<'_>,
    rx: &mut PduRx<'_>,
    future: F,
) -> F::Output {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    loop {
        if let Poll::Ready(outcome) = future.as_mut().poll(&mut context) {
            return outcome;
        }
        while let Some(frame) = tx.next_sendable_frame() {
            let _ = frame.send_blocking(|bytes| {
                replay.ask(bytes);
                Ok(bytes.len())
            });
            if let Some(answer) = replay.take() {
                let _ = rx.receive_frame(answer);
            }
        }
    }
}

/// ethercrab alone: one exchange of six drives with their own process data.
fn library(cycles: i64) -> Result<(f64, u64), Box<dyn std::error::Error>> {
    static FRAMES: PduStorage<16, { PduStorage::element_size(1_400) }> = PduStorage::new();
    let (mut tx, mut rx, frames) = FRAMES.try_split().map_err(|()| "split")?;
    let retries = RetryBehaviour::Count(5);
    let own = MainDeviceConfig { dc_static_sync_iterations: 100, retry_behaviour: retries };
    let device = MainDevice::new(frames, Timeouts::default(), own);
    let mut replay = Replay::new();
    let init = device.init_single_group::<64, 1_024>(|| 0);
    let group = run(&mut replay, &mut tx, &mut rx, init).map_err(|error| error.to_string())?;
    let group = run(&mut replay, &mut tx, &mut rx, group.into_op(&device));
    let group = group.map_err(|error| error.to_string())?;
    // From the second exchange on the answer comes from memory.
    let first = run(&mut replay, &mut tx, &mut rx, group.tx_rx(&device));
    first.map_err(|error| error.to_string())?;
    replay.frozen = true;
    let mut failed = 0;
    let measured = measure(Nanos::ZERO, cycles, |_| {
        let answer = run(&mut replay, &mut tx, &mut rx, group.tx_rx(&device));
        failed += i32::from(!answer.is_ok_and(|answer| answer.working_counter == 18));
    });
    assert_eq!(failed, 0, "every exchange is whole");
    Ok(measured)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let counted = arguments.iter().position(|word| word == "--instructions");
    let counted = counted.map(|at| arguments.remove(at)).is_some();
    let is_library = arguments.first().is_some_and(|word| word == "--library");
    if is_library {
        arguments.remove(0);
    }
    let cycles: i64 = arguments.first().map_or(Ok(100_000), |word| word.parse())?;
    if counted && is_library {
        return library(cycles).map(drop);
    }
    for (exchange, name) in [
        (ExchangeTimes::Twice, "two exchanges a cycle"),
        (ExchangeTimes::Once, "one exchange a cycle"),
        (ExchangeTimes::Pipelined, "one that is collected a cycle later"),
    ] {
        let port = ReplayPort { replay: Replay::new(), frames_until_frozen: FRAMES_UNTIL_FROZEN };
        let mut halves = Segment::attach(Box::new(port), &config(exchange))?;
        let mut release = Nanos::ZERO;
        while halves.monitor.diagnostics().exchanges < FRAMES_UNTIL_FROZEN as u64 {
            release += Nanos::from_millis(1);
            cycle(&mut halves, release);
        }
        let mut failed = 0;
        let (time, calls) =
            measure(release, cycles, |release| failed += i32::from(!cycle(&mut halves, release)));
        assert_eq!(failed, 0, "every cycle is good");
        if counted {
            return Ok(());
        }
        println!("driver, {name}: {time:.0} ns a cycle, {calls} calls of the heap");
    }
    let (time, calls) = library(cycles)?;
    println!("ethercrab alone, one exchange: {time:.0} ns, {calls} calls of the heap");
    Ok(())
}
