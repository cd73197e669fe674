//! Prints the driver's own time for a cycle with six encoders and six analog outputs: encoding,
//! decoding and book-keeping, over a link that answers at once from memory.
//!
//! `mesa_own_time [CYCLES]`; `mesa_own_time --instructions CYCLES` prints nothing, for a tool that
//! counts.

use std::io;

use taktil_drivers_mesa::{Board, Config, Halves, Port};
use taktil_drivers_mesa_emulator::{Emulator, Firmware, Inputs};
use taktil_hal::{AnalogOut, CHANNELS, DacCode, Encoders, Nanos};
use taktil_rtcore::linux::monotonic;

/// Cycles of a slice.
const SLICE_CYCLES: i64 = 1_000;
/// How a packet begins that carries the number of a request.
const NUMBERED_HEAD: [u8; 4] = [0x82, 0xd1, 0x10, 0x00];
/// A request of a cycle is longer than this; a question of the opening is not (bytes).
const QUESTION_BYTES_MAX: usize = 24;

/// While a card is opened the emulator answers; from the first cycle on a recorded answer does,
/// with the numbers of the newest packets.
struct Replay {
    emulator: Option<Box<Emulator>>,
    now: Nanos,
    answer: Vec<u8>,
    number: [u8; 4],
    write_number: [u8; 4],
    asked: bool,
}

impl Port for Replay {
    fn send(&mut self, packet: &[u8]) -> io::Result<()> {
        self.now += Nanos(50_000);
        let request = packet.len() > QUESTION_BYTES_MAX && packet.starts_with(&NUMBERED_HEAD);
        if request {
            self.number.copy_from_slice(&packet[4..8]);
            self.asked = true;
        } else if packet.len() > QUESTION_BYTES_MAX {
            self.write_number.copy_from_slice(&packet[packet.len() - 4..]);
        }
        if let Some(emulator) = &mut self.emulator {
            emulator.receive(self.now, packet);
            if request {
                let mut answers = Vec::new();
                emulator.poll(self.now, &mut answers);
                self.answer = answers.pop().unwrap_or_default();
                self.emulator = None;
            }
        }
        Ok(())
    }

    fn start_wait(&mut self, _wait: Nanos) {}

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        if let Some(emulator) = &mut self.emulator {
            let mut answers = Vec::new();
            emulator.poll(self.now, &mut answers);
            let answer = answers.first()?;
            buffer[..answer.len()].copy_from_slice(answer);
            return Some(answer.len());
        }
        if !core::mem::take(&mut self.asked) {
            return None;
        }
        let length = self.answer.len();
        buffer[..length].copy_from_slice(&self.answer);
        buffer[length - 12..length - 8].copy_from_slice(&self.number);
        buffer[length - 8..length - 4].copy_from_slice(&self.write_number);
        Some(length)
    }
}

fn cycle(halves: &mut Halves, release: Nanos) {
    let counts = halves.encoders.as_mut().map(|half| half.sample(release));
    let codes = [DacCode((release.0 & 0x7ff) as i32); CHANNELS];
    let done = halves.analog_out.as_mut().map(|half| half.commit(release, &codes));
    assert!(matches!((counts, done), (Some(Ok(_)), Some(Ok(())))), "{done:?}");
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let counted = arguments.iter().position(|word| word == "--instructions");
    let counted = counted.map(|at| arguments.remove(at)).is_some();
    let cycles: i64 = arguments.first().map_or(Ok(100_000), |word| word.parse())?;
    let plant = |_: Nanos, _: &_| Inputs { counts: vec![0; 6], ..Inputs::default() };
    let port = Replay {
        emulator: Some(Box::new(Emulator::new(Firmware::with_7i77(), 0, Box::new(plant)))),
        now: Nanos::ZERO,
        answer: Vec::new(),
        number: [0; 4],
        write_number: [0; 4],
        asked: false,
    };
    let mut halves = Board::attach(Box::new(port), &Config::default())?;
    let (mut slices, mut release) = (Vec::new(), Nanos::ZERO);
    for _ in 0..(cycles / SLICE_CYCLES).max(1) {
        let length = SLICE_CYCLES.min(cycles);
        let begin = monotonic();
        for _ in 0..length {
            release += Nanos::from_micros(2_500);
            cycle(&mut halves, release);
        }
        slices.push((monotonic() - begin).0 as f64 / length as f64);
    }
    slices.sort_by(f64::total_cmp);
    if !counted {
        println!("{:.0} ns a cycle, median of {} slices", slices[slices.len() / 2], slices.len());
    }
    Ok(())
}
