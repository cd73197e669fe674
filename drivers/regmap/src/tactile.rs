//! The tactile array's half. It hands out a whole frame or none: a frame that was overwritten while
//! it was read is read again or left out.

use taktil_hal::{Arrival, Error, ErrorKind, Nanos, TactileArray, TactileFrame};

use crate::block::{Numbers, Presence, Torn, read_consistent};
use crate::bus::{Bus, Field};

const TACTILE_NAME: &str = "regmap.tactile";

/// Where a frame stands and what it is.
#[derive(Debug)]
pub(crate) struct FrameRegisters {
    /// One for each tactel, row by row.
    pub(crate) fields: Box<[Field]>,
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    pub(crate) bits: u32,
    pub(crate) numbers: Numbers,
    /// All bits of a number.
    pub(crate) number_mask: u32,
    pub(crate) scan_time: Nanos,
}

/// The tactile frame buffer. Its number is 0 until the board has scanned for the first time.
///
/// The board does not time its rows: a frame is stamped with the release that found it, and its
/// rows evenly over the scan time before that, the last row at the stamp.
#[derive(Debug)]
pub struct RegisterTactile {
    bus: Bus,
    registers: FrameRegisters,
    full_scale: u16,
    row_period: Nanos,
    presence: Presence,
    /// The number of the frame handed out last, carried on beyond the bits of the board's.
    sequence: Option<u32>,
    last_new: Option<Nanos>,
    words: Box<[u32]>,
}

impl RegisterTactile {
    pub(crate) fn new(bus: Bus, registers: FrameRegisters, presence: Presence) -> RegisterTactile {
        RegisterTactile {
            bus,
            full_scale: u16::MAX >> (16 - registers.bits),
            row_period: Nanos(registers.scan_time.0 / registers.rows as i64),
            presence,
            sequence: None,
            last_new: None,
            words: vec![0; registers.fields.len()].into_boxed_slice(),
            registers,
        }
    }

    /// The sequence number of the frame with the board's `number`, unless it was handed out before.
    fn newer_sequence(&self, number: u32) -> Option<u32> {
        let last = self.sequence.unwrap_or(0);
        // The low bits are all that the board counts.
        let ahead = number.wrapping_sub(last) & self.registers.number_mask;
        if ahead == 0 { None } else { Some(last.wrapping_add(ahead)) }
    }

    fn fill(&self, release: Nanos, sequence: u32, frame: &mut TactileFrame) {
        frame.sequence = sequence;
        frame.acquired = release;
        for (value, word) in frame.values.iter_mut().zip(&self.words) {
            *value = *word as u16;
        }
        frame.valid.fill(true);
        let mut acquired = release;
        for row in frame.row_acquired.iter_mut().rev() {
            *row = acquired;
            acquired -= self.row_period;
        }
    }
}

impl TactileArray for RegisterTactile {
    fn rows(&self) -> usize {
        self.registers.rows
    }

    fn cols(&self) -> usize {
        self.registers.cols
    }

    fn full_scale(&self) -> u16 {
        self.full_scale
    }

    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        if !frame.fits(self) {
            return Err(Error::whole(ErrorKind::OutOfRange, TACTILE_NAME));
        }
        if self.last_new == Some(release) {
            return Ok(Arrival::Held);
        }
        self.presence.check(&self.bus, TACTILE_NAME)?;
        let numbers = self.registers.numbers;
        if self.newer_sequence(self.bus.read(numbers.end)).is_none() {
            return Ok(Arrival::Held);
        }
        let (words, fields) = (&mut self.words, &self.registers.fields);
        let number = read_consistent(&self.bus, numbers, |bus| {
            for (word, field) in words.iter_mut().zip(fields) {
                *word = field.read_whole(bus);
            }
        });
        let number = number.map_err(|Torn| Error::whole(ErrorKind::Transient, TACTILE_NAME))?;
        let Some(sequence) = self.newer_sequence(number) else {
            return Ok(Arrival::Held);
        };
        let full_scale = u32::from(self.full_scale);
        if let Some(tactel) = self.words.iter().position(|word| *word > full_scale) {
            return Err(Error::on_channel(ErrorKind::OutOfRange, TACTILE_NAME, tactel as u16));
        }
        self.fill(release, sequence, frame);
        self.sequence = Some(sequence);
        self.last_new = Some(release);
        Ok(Arrival::New)
    }
}
