//! The output halves: D/A words and lines, safe on opening, on request and on drop. A code out of
//! range is refused before any register is written.

use taktil_hal::{AnalogOut, CHANNELS, DacCode, DigitalOut, Error, ErrorKind, LinesOut, Nanos};

use crate::acquisition::Strobe;
use crate::block::Presence;
use crate::bus::{Bus, Field};
use crate::codes::Codec;

pub(crate) const ANALOG_OUT_NAME: &str = "regmap.analog_out";
pub(crate) const DIGITAL_OUT_NAME: &str = "regmap.digital_out";

/// How the D/A converters are written.
#[derive(Debug)]
pub(crate) struct OutputChannels {
    /// All channels of the board; those that are not wired get the safe value when the half goes
    /// safe.
    pub(crate) all: Box<[Field]>,
    /// The channels that are wired.
    pub(crate) wired: Box<[Field]>,
    pub(crate) codec: Codec,
    pub(crate) safe_code: DacCode,
    pub(crate) strobe: Option<Strobe>,
    /// What feeds the watchdog.
    pub(crate) kick: Option<Strobe>,
    pub(crate) reads_back: bool,
}

/// D/A converters. A word of 0 may be full scale, so that a board that was never written is not
/// safe; taking the half into use writes the safe value first.
#[derive(Debug)]
pub struct RegisterAnalogOut {
    bus: Bus,
    channels: OutputChannels,
    longest_silence: Nanos,
    /// What the wired channels were last written.
    written: [u32; CHANNELS],
    presence: Presence,
}

impl RegisterAnalogOut {
    pub(crate) fn new(
        bus: Bus,
        channels: OutputChannels,
        longest_silence: Nanos,
        presence: Presence,
    ) -> RegisterAnalogOut {
        let written = [0; CHANNELS];
        let mut half = RegisterAnalogOut { bus, channels, longest_silence, written, presence };
        half.write_safe();
        half
    }

    /// Lets everything that was written out, without a sign of life.
    fn put_out(&self) {
        match &self.channels.strobe {
            Some(strobe) => strobe.write(&self.bus),
            None => self.bus.order_writes(),
        }
    }

    /// Writes the safe word to all channels, also those that are not wired.
    fn write_safe(&mut self) {
        let safe = self.channels.codec.saturating_field(self.channels.safe_code.0);
        for field in &self.channels.all {
            field.write(&self.bus, safe);
        }
        self.written = [safe; CHANNELS];
        self.put_out();
    }

    /// The first wired channel whose registers do not hold what was written last.
    fn changed_channel(&self) -> Option<u16> {
        let fields = (0u16..).zip(self.channels.wired.iter().zip(self.written));
        let mut changed = fields
            .filter(|(_, (field, bits))| field.bits(field.read_whole(&self.bus)) != *bits)
            .map(|(channel, _)| channel);
        changed.next()
    }
}

impl AnalogOut for RegisterAnalogOut {
    fn channels(&self) -> usize {
        self.channels.wired.len()
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        let (low, high) = self.channels.codec.range();
        (DacCode(low), DacCode(high))
    }

    fn commit(&mut self, _release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let mut staged = self.written;
        let wired = self.channels.wired.len();
        for (channel, (bits, code)) in (0u16..).zip(staged.iter_mut().zip(codes).take(wired)) {
            let refused = Error::on_channel(ErrorKind::OutOfRange, ANALOG_OUT_NAME, channel);
            *bits = self.channels.codec.field(code.0).ok_or(refused)?;
        }
        self.presence.check(&self.bus, ANALOG_OUT_NAME)?;
        let changed = if self.channels.reads_back { self.changed_channel() } else { None };
        for (field, bits) in self.channels.wired.iter().zip(staged) {
            field.write(&self.bus, bits);
        }
        self.written = staged;
        self.put_out();
        if let Some(kick) = &self.channels.kick {
            kick.write(&self.bus);
        }
        match changed {
            None => Ok(()),
            Some(channel) => Err(Error::on_channel(ErrorKind::Transient, ANALOG_OUT_NAME, channel)),
        }
    }

    fn safe(&mut self) -> Result<(), Error> {
        // The safe words are written even to a board that seems lost: this does no harm, and they
        // may still arrive.
        self.write_safe();
        self.presence.check(&self.bus, ANALOG_OUT_NAME)
    }

    fn safe_value(&self) -> DacCode {
        self.channels.safe_code
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

/// Where the lines stand in their register.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OutputMasks {
    pub(crate) offset: usize,
    pub(crate) enable: u32,
    pub(crate) brake_release: u32,
    pub(crate) watchdog_feed: u32,
    pub(crate) inverted: u32,
}

impl OutputMasks {
    fn word(&self, lines: &LinesOut) -> u32 {
        let bit = |set: bool, bit: u32| if set { bit } else { 0 };
        let levels = bit(lines.enable, self.enable)
            | bit(lines.brake_release, self.brake_release)
            | bit(lines.watchdog_feed, self.watchdog_feed);
        levels ^ self.inverted
    }
}

/// Lines to the cell.
#[derive(Debug)]
pub struct RegisterDigitalOut {
    bus: Bus,
    masks: OutputMasks,
    longest_silence: Nanos,
    /// The present level of the feed line.
    feed: bool,
    presence: Presence,
}

impl RegisterDigitalOut {
    pub(crate) fn new(
        bus: Bus,
        masks: OutputMasks,
        longest_silence: Nanos,
        presence: Presence,
    ) -> RegisterDigitalOut {
        let feed = (bus.read(masks.offset) ^ masks.inverted) & masks.watchdog_feed != 0;
        let half = RegisterDigitalOut { bus, masks, longest_silence, feed, presence };
        half.write_safe();
        half
    }

    fn write_safe(&self) {
        let lines = LinesOut { watchdog_feed: self.feed, ..LinesOut::SAFE };
        self.bus.write(self.masks.offset, self.masks.word(&lines));
    }
}

impl DigitalOut for RegisterDigitalOut {
    fn commit(&mut self, _release: Nanos, lines: &LinesOut) -> Result<(), Error> {
        self.presence.check(&self.bus, DIGITAL_OUT_NAME)?;
        self.feed = lines.watchdog_feed;
        self.bus.write(self.masks.offset, self.masks.word(lines));
        Ok(())
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.write_safe();
        self.presence.check(&self.bus, DIGITAL_OUT_NAME)
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
