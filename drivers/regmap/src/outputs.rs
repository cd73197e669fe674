//! The output halves: D/A words and lines, safe on opening, on request and on drop. A code out of
//! range is refused before any register is written.

use std::sync::Arc;

use taktil_hal::{AnalogOut, CHANNELS, DacCode, DigitalOut, Error, ErrorKind, LinesOut, Nanos};

use crate::block::Presence;
use crate::codes::OffsetBinary;
use crate::config::Config;
use crate::io::RegisterFile;
use crate::registers::{
    DAC, DAC_STROBE, DIGITAL_OUT, OUT_BRAKE_RELEASE, OUT_ENABLE, OUT_WATCHDOG_FEED,
};

const ANALOG_OUT_NAME: &str = "regmap.analog_out";
const DIGITAL_OUT_NAME: &str = "regmap.digital_out";

/// Zero volts: no current through any motor.
const SAFE_CODE: DacCode = DacCode(0);

fn watchdog_time(config: &Config) -> Nanos {
    Nanos::from_millis(i64::from(config.watchdog_ms))
}

/// D/A converters. A word of 0 is full negative scale, so a block that was never written is not
/// safe; taking the half into use writes the safe value first.
#[derive(Debug)]
pub struct RegisterAnalogOut {
    registers: Arc<RegisterFile>,
    channels: usize,
    coding: OffsetBinary,
    longest_silence: Nanos,
    strobe: u16,
    presence: Presence,
}

impl RegisterAnalogOut {
    pub(crate) fn new(registers: Arc<RegisterFile>, config: &Config) -> RegisterAnalogOut {
        let mut half = RegisterAnalogOut {
            strobe: registers.read(DAC_STROBE),
            registers,
            channels: config.dac_channels,
            coding: OffsetBinary::new(config.dac_bits),
            longest_silence: watchdog_time(config),
            presence: Presence::default(),
        };
        half.write_safe();
        half
    }

    fn write_words(&mut self, words: &[u16; CHANNELS]) {
        for (register, word) in DAC.iter().zip(words) {
            self.registers.write(register, *word);
        }
        self.registers.order_writes();
        self.strobe = self.strobe.wrapping_add(1);
        self.registers.write(DAC_STROBE, self.strobe);
    }

    /// All eight channels, also those that are not wired.
    fn write_safe(&mut self) {
        self.write_words(&[self.coding.zero(); CHANNELS]);
    }
}

impl AnalogOut for RegisterAnalogOut {
    fn channels(&self) -> usize {
        self.channels
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        let (low, high) = self.coding.range();
        (DacCode(low), DacCode(high))
    }

    fn commit(&mut self, _release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let mut words = [self.coding.zero(); CHANNELS];
        for (channel, (word, code)) in (0u16..).zip(words.iter_mut().zip(codes).take(self.channels))
        {
            let refused = Error::on_channel(ErrorKind::OutOfRange, ANALOG_OUT_NAME, channel);
            *word = self.coding.word(code.0).ok_or(refused)?;
        }
        self.presence.check(&self.registers, ANALOG_OUT_NAME)?;
        self.write_words(&words);
        Ok(())
    }

    fn safe(&mut self) -> Result<(), Error> {
        // The safe words are written even to a board that seems lost: this does no harm, and they
        // may still arrive.
        self.write_safe();
        self.presence.check(&self.registers, ANALOG_OUT_NAME)
    }

    fn safe_value(&self) -> DacCode {
        SAFE_CODE
    }

    fn longest_silence(&self) -> Nanos {
        self.longest_silence
    }
}

impl Drop for RegisterAnalogOut {
    fn drop(&mut self) {
        self.write_safe();
    }
}

/// Lines to the cell.
#[derive(Debug)]
pub struct RegisterDigitalOut {
    registers: Arc<RegisterFile>,
    longest_silence: Nanos,
    /// The present level of the feed line.
    feed: u16,
    presence: Presence,
}

impl RegisterDigitalOut {
    pub(crate) fn new(registers: Arc<RegisterFile>, config: &Config) -> RegisterDigitalOut {
        let half = RegisterDigitalOut {
            feed: registers.read(DIGITAL_OUT) & OUT_WATCHDOG_FEED,
            registers,
            longest_silence: watchdog_time(config),
            presence: Presence::default(),
        };
        half.write_safe();
        half
    }

    fn write_safe(&self) {
        self.registers.write(DIGITAL_OUT, self.feed);
    }
}

impl DigitalOut for RegisterDigitalOut {
    fn commit(&mut self, _release: Nanos, lines: &LinesOut) -> Result<(), Error> {
        self.presence.check(&self.registers, DIGITAL_OUT_NAME)?;
        let bit = |set: bool, bit: u16| if set { bit } else { 0 };
        self.feed = bit(lines.watchdog_feed, OUT_WATCHDOG_FEED);
        let word =
            bit(lines.enable, OUT_ENABLE) | bit(lines.brake_release, OUT_BRAKE_RELEASE) | self.feed;
        self.registers.write(DIGITAL_OUT, word);
        Ok(())
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.write_safe();
        self.presence.check(&self.registers, DIGITAL_OUT_NAME)
    }

    fn longest_silence(&self) -> Nanos {
        self.longest_silence
    }
}

impl Drop for RegisterDigitalOut {
    fn drop(&mut self) {
        self.write_safe();
    }
}
