//! The tactile array's half. It hands out a whole frame or none: a frame that was overwritten while
//! it was read is read again or left out.

use std::sync::Arc;

use taktil_hal::{Arrival, Error, ErrorKind, Nanos, TactileArray, TactileFrame};

use crate::block::{Presence, read_consistent};
use crate::config::Config;
use crate::io::RegisterFile;
use crate::registers::{TACTILE, TACTILE_COLS, TACTILE_ROWS};

const NAME: &str = "regmap.tactile";
/// Tactels of the frame buffer.
const TACTEL_COUNT: usize = TACTILE_ROWS * TACTILE_COLS;

/// The tactile frame buffer. Its number is 0 until the board has scanned for the first time.
///
/// The board does not time its rows: a frame is stamped with the release that found it, and its
/// rows evenly over the scan time before that, the last row at the stamp.
#[derive(Debug)]
pub struct RegisterTactile {
    registers: Arc<RegisterFile>,
    full_scale: u16,
    row_period: Nanos,
    presence: Presence,
    /// The number of the frame handed out last, carried on beyond 16 bits.
    sequence: Option<u32>,
    last_new: Option<Nanos>,
    words: [u16; TACTEL_COUNT],
}

impl RegisterTactile {
    pub(crate) fn new(registers: Arc<RegisterFile>, config: &Config) -> RegisterTactile {
        RegisterTactile {
            registers,
            full_scale: u16::MAX >> (16 - config.tactile_bits),
            row_period: Nanos(i64::from(config.tactile_scan_us) * 1_000 / TACTILE_ROWS as i64),
            presence: Presence::default(),
            sequence: None,
            last_new: None,
            words: [0; TACTEL_COUNT],
        }
    }

    /// The sequence number of the frame with the board's `number`, unless it was handed out before.
    fn newer_sequence(&self, number: u16) -> Option<u32> {
        let last = self.sequence.unwrap_or(0);
        // The low half is all that the board counts.
        let ahead = number.wrapping_sub(last as u16);
        if ahead == 0 { None } else { Some(last.wrapping_add(u32::from(ahead))) }
    }

    fn fill(&self, release: Nanos, sequence: u32, frame: &mut TactileFrame) {
        frame.sequence = sequence;
        frame.acquired = release;
        frame.values.copy_from_slice(&self.words);
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
        TACTILE_ROWS
    }

    fn cols(&self) -> usize {
        TACTILE_COLS
    }

    fn full_scale(&self) -> u16 {
        self.full_scale
    }

    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        if !frame.fits(self) {
            return Err(Error::whole(ErrorKind::OutOfRange, NAME));
        }
        if self.last_new == Some(release) {
            return Ok(Arrival::Held);
        }
        self.presence.check(&self.registers, NAME)?;
        if self.newer_sequence(self.registers.read(TACTILE.end)).is_none() {
            return Ok(Arrival::Held);
        }
        let words = &mut self.words;
        let number = read_consistent(&self.registers, TACTILE, |registers| {
            for (word, register) in words.iter_mut().zip(TACTILE.words.iter()) {
                *word = registers.read(register);
            }
        });
        let number = number.ok_or(Error::whole(ErrorKind::Transient, NAME))?;
        let Some(sequence) = self.newer_sequence(number) else {
            return Ok(Arrival::Held);
        };
        if let Some(tactel) = self.words.iter().position(|word| *word > self.full_scale) {
            return Err(Error::on_channel(ErrorKind::OutOfRange, NAME, tactel as u16));
        }
        self.fill(release, sequence, frame);
        self.sequence = Some(sequence);
        self.last_new = Some(release);
        Ok(Arrival::New)
    }
}
