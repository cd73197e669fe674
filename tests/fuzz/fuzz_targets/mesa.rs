//! Whatever a card answers: registers of any content, and datagrams that are lost, cut, padded,
//! doubled, late or made up. The driver refuses the card with a place and a remedy, or runs with
//! bounded work, and an answer that it takes for new is one.
#![no_main]

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, LazyLock, Mutex};

use libfuzzer_sys::fuzz_target;
use taktil_drivers_mesa::{
    Analog, Board, Config, Halves, Line, LinesInConfig, LinesOutConfig, Port, Terminal,
};
use taktil_drivers_mesa_emulator::{Emulator, Firmware, Inputs};
use taktil_fuzz::Numbers;
use taktil_hal::{
    AnalogOut, CHANNELS, DacCode, DigitalIn, DigitalOut, Encoders, ErrorKind, LinesOut, Nanos,
};

/// Words of the FPGA's registers.
const REGISTERS_COUNT: usize = 0x4000;
/// Bytes that a scratch area takes.
const SCRATCH_BYTES: usize = 32;
/// Bytes of an ordinary answer.
const ANSWER_BYTES: usize = 256;
/// Most datagrams of a job: requests for smart serial's sake, steps of recovery, the write packet.
const DATAGRAMS_MAX: usize = 40;
/// Most changes of registers before the card is opened.
const CHANGES_MAX: usize = 24;
/// Most jobs of a card.
const JOBS_MAX: usize = 24;

/// The registers of a card that has been switched on, with remotes that tell their names.
fn registers(firmware: Firmware) -> Vec<u32> {
    let emulator = Emulator::new(firmware, 0, Box::new(|_, _| Inputs::default()));
    let addresses = (0..REGISTERS_COUNT).map(|word| 4 * word as u16);
    let mut words: Vec<u32> =
        addresses.map(|address| emulator.register(Nanos::ZERO, address)).collect();
    for (channel, unit) in [0x1200_0001, 0x1100_0001].into_iter().enumerate() {
        words[0x5c00 / 4 + channel] = 0;
        words[0x5d00 / 4 + channel] = unit;
        words[0x5e00 / 4 + channel] = u32::from_le_bytes(*b"7I77");
    }
    words
}

static CARDS: LazyLock<[Vec<u32>; 2]> =
    LazyLock::new(|| [registers(Firmware::with_7i77()), registers(Firmware::with_pwm())]);

/// A card whose registers stand as the bytes say, and a link that treats its answers so.
struct Wire {
    registers: Vec<u32>,
    scratch: [u8; SCRATCH_BYTES],
    /// What befalls the next answers, one byte each.
    faults: VecDeque<u8>,
    answers: VecDeque<Vec<u8>>,
    /// An answer that comes behind the next one.
    late: Option<Vec<u8>>,
    datagrams: usize,
}

impl Wire {
    /// Executes a packet of the driver's, which keeps the rules of the protocol.
    fn execute(&mut self, packet: &[u8]) {
        self.datagrams += 1;
        let mut at = 0;
        let mut answer = Vec::with_capacity(ANSWER_BYTES);
        let half = |at: usize| u16::from_le_bytes([packet[at], packet[at + 1]]);
        while at < packet.len() {
            let (head, address) = (half(at), usize::from(half(at + 2)));
            at += 4;
            let space = head >> 10 & 7;
            let bytes = usize::from(head & 0x7f) * if space == 0 { 4 } else { 2 };
            if head & 0x8000 != 0 {
                if space == 4 && address + bytes <= SCRATCH_BYTES {
                    self.scratch[address..address + bytes].copy_from_slice(&packet[at..at + bytes]);
                }
                at += bytes;
                continue;
            }
            if space == 0 {
                let first = address / 4;
                for at in first..first + bytes / 4 {
                    let word = self.registers[at % REGISTERS_COUNT];
                    answer.extend_from_slice(&word.to_le_bytes());
                }
            } else {
                let kept = space == 4 && address + bytes <= SCRATCH_BYTES;
                let range = if kept { address..address + bytes } else { 0..0 };
                answer.extend_from_slice(&self.scratch[range]);
                answer.resize(answer.len() + if kept { 0 } else { bytes }, 0);
            }
        }
        if !answer.is_empty() {
            self.deliver(answer);
        }
    }

    fn deliver(&mut self, mut answer: Vec<u8>) {
        let fault = self.faults.pop_front().unwrap_or(0);
        match fault & 7 {
            1 => return,
            2 => answer.truncate(answer.len() * usize::from(fault >> 3) / 32),
            3 => answer.resize(answer.len() + usize::from(fault >> 3), 0),
            4 => self.answers.push_back(answer.clone()),
            5 => {
                self.late = Some(answer);
                return;
            }
            6 => {
                let at = usize::from(fault >> 3) * answer.len() / 32;
                let count = (self.faults.len()).min(8);
                for (byte, other) in answer[at..].iter_mut().zip(self.faults.drain(..count)) {
                    *byte ^= other;
                }
            }
            7 => self.answers.push_back(self.faults.iter().copied().collect()),
            _ => {}
        }
        self.answers.push_back(answer);
        self.answers.extend(self.late.take());
    }
}

#[derive(Clone)]
struct Link(Arc<Mutex<Wire>>);

impl Port for Link {
    fn send(&mut self, packet: &[u8]) -> io::Result<()> {
        self.0.lock().expect("one thread").execute(packet);
        Ok(())
    }

    fn start_wait(&mut self, _wait: Nanos) {}

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        let answer = self.0.lock().expect("one thread").answers.pop_front()?;
        let bytes = answer.len().min(buffer.len());
        buffer[..bytes].copy_from_slice(&answer[..bytes]);
        Some(bytes)
    }
}

fn line(at: Terminal, number: u32) -> Line {
    Line { at, number, remote: 0, inverted: number % 2 == 1, open_drain: false }
}

fn config(kind: u8) -> Config {
    let (is_pwm, has_lines) = (kind & 1 == 1, kind & 2 == 2);
    let (at, first) = if is_pwm { (Terminal::Pin, 48) } else { (Terminal::Field, 3) };
    let mut config = Config { index: kind & 4 == 0, ..Config::default() };
    if is_pwm {
        config.analog = Analog::Pwm;
    }
    if has_lines {
        config.lines_in = Some(LinesInConfig {
            drive_power: line(at, first),
            estop_a: line(at, first + 1),
            estop_b: line(at, first + 2),
        });
        let enable = if is_pwm { line(at, 51) } else { line(Terminal::Spindle, 0) };
        config.lines_out = Some(LinesOutConfig {
            enable,
            brake_release: line(at, first + 4),
            watchdog_feed: Some(line(at, first + 5)),
        });
    }
    config
}

fn change(wire: &mut Wire, numbers: &mut Numbers<'_>) {
    let mut word = |count: usize| {
        (0..count).fold(0_u32, |word, at| word | (u32::from(numbers.byte()) << (8 * at)))
    };
    // Most changes are of the tables, whose places a fuzzer need not find.
    let place = word(2) as usize;
    let place = match place & 3 {
        0 => 0x0100 / 4 + (place >> 2) % 4,
        1 => 0x0400 / 4 + (place >> 2) % 256,
        _ => (place >> 2) % REGISTERS_COUNT,
    };
    wire.registers[place] = word(4);
}

fn job(halves: &mut Halves, link: &Link, release: Nanos, feed: bool) {
    link.0.lock().expect("one thread").datagrams = 0;
    if let Some(encoders) = &mut halves.encoders {
        match encoders.sample(release) {
            Ok(reading) => assert_eq!(reading.acquired, release),
            Err(error) => assert_ne!(error.kind, ErrorKind::OutOfRange),
        }
        assert!(encoders.speeds_counts_s().iter().all(|speed| speed.is_finite()));
    }
    if let Some(half) = &mut halves.digital_in
        && let Ok(reading) = half.sample(release)
    {
        assert!(reading.acquired <= release);
    }
    if let Some(half) = &mut halves.analog_out {
        let _ = half.commit(release, &[DacCode(1_000); CHANNELS]);
    }
    if let Some(half) = &mut halves.digital_out {
        let lines = LinesOut { enable: true, brake_release: true, watchdog_feed: feed };
        let _ = half.commit(release, &lines);
    }
    assert!(link.0.lock().expect("one thread").datagrams <= DATAGRAMS_MAX);
}

fuzz_target!(|bytes: &[u8]| {
    let mut numbers = Numbers::new(bytes);
    let (kind, changes, faults) = (numbers.byte(), numbers.byte(), numbers.byte());
    let mut wire = Wire {
        registers: CARDS[usize::from(kind & 1)].clone(),
        scratch: [0; SCRATCH_BYTES],
        faults: VecDeque::new(),
        answers: VecDeque::new(),
        late: None,
        datagrams: 0,
    };
    for _ in 0..usize::from(changes) % CHANGES_MAX {
        change(&mut wire, &mut numbers);
    }
    wire.faults.extend((0..faults % 64).map(|_| numbers.byte()));
    let link = Link(Arc::new(Mutex::new(wire)));
    let mut halves = match Board::attach(Box::new(link.clone()), &config(kind)) {
        Ok(halves) => halves,
        Err(refused) => {
            let text = refused.to_string();
            assert!(!refused.place().is_empty() && text.contains("; "), "{text}");
            return;
        }
    };
    let mut release = Nanos::from_millis(100);
    for step in 0..JOBS_MAX {
        if numbers.any() {
            let mut wire = link.0.lock().expect("one thread");
            if numbers.byte() & 1 == 1 {
                change(&mut wire, &mut numbers);
            }
            let count = numbers.byte() % 32;
            wire.faults.extend((0..count).map(|_| numbers.byte()));
        }
        release += Nanos::from_micros(2_500);
        job(&mut halves, &link, release, step % 2 == 0);
    }
    let seen = halves.monitor.diagnostics();
    assert!(seen.answers + seen.timeouts <= seen.requests, "{seen:?}");
});
