//! The halves of the A/D converters, of gauges and of the lines from the cell. A word with bits set
//! that the board does not have is refused as out of range.

use std::sync::Arc;

use taktil_hal::{
    AdcCode, AnalogIn, CHANNELS, DigitalIn, Error, ErrorKind, ForceTorque, GaugeCodes, LinesIn,
    Nanos, Reading,
};

use crate::acquisition::Acquisition;
use crate::block::{NumberedReadings, Numbers, TORN_RETRIES, Torn, read_consistent};
use crate::bus::{Bus, Field};
use crate::codes::Codec;

/// The names of the halves in errors.
pub(crate) const ANALOG_IN_NAME: &str = "regmap.analog_in";
pub(crate) const FORCE_TORQUE_NAME: &str = "regmap.force_torque";
pub(crate) const DIGITAL_IN_NAME: &str = "regmap.digital_in";

/// A/D converters that are started together.
#[derive(Clone, Debug)]
pub(crate) struct Converters {
    pub(crate) conversion: Arc<Acquisition>,
    pub(crate) numbers: Option<Numbers>,
    pub(crate) codec: Codec,
    pub(crate) unused_zero: bool,
    /// Whether a half of another lane may start a conversion while this one is read.
    pub(crate) is_started_elsewhere: bool,
}

impl Converters {
    /// The codes of some channels, from one conversion that `release` has started, with the number
    /// of the block.
    fn codes<const N: usize>(
        &self,
        bus: &Bus,
        release: Nanos,
        fields: &[Field],
        device: &'static str,
    ) -> Result<(Option<u32>, [AdcCode; N]), Error> {
        self.conversion.start(release);
        let mut words = [0; N];
        let number = self.read(bus, |bus| {
            for (word, field) in words.iter_mut().zip(fields) {
                *word = field.read_whole(bus);
            }
        });
        let number = number.map_err(|Torn| Error::whole(ErrorKind::Transient, device))?;
        let mut codes = [AdcCode(0); N];
        for (channel, (code, field)) in (0u16..).zip(codes.iter_mut().zip(fields)) {
            let whole = words[usize::from(channel)];
            if self.unused_zero && field.has_unused(whole) {
                return Err(Error::on_channel(ErrorKind::OutOfRange, device, channel));
            }
            *code = AdcCode(self.codec.code(field.bits(whole)));
        }
        Ok((number, codes))
    }

    /// The longest that a reading waits for the board: a conversion that another lane starts anew
    /// meanwhile is waited for again.
    fn longest_wait(&self) -> Nanos {
        let again = if self.is_started_elsewhere { TORN_RETRIES as i64 } else { 0 };
        self.conversion.longest_wait() * (1 + again)
    }

    /// Waits for the conversion and copies what it gave; again when another lane has started one
    /// meanwhile. The number of the block.
    fn read(&self, bus: &Bus, mut copy: impl FnMut(&Bus)) -> Result<Option<u32>, Torn> {
        for _ in 0..=TORN_RETRIES {
            let starts = self.conversion.starts();
            if !self.conversion.wait() {
                return Err(Torn);
            }
            let number = match self.numbers {
                Some(numbers) => Some(read_consistent(bus, numbers, &mut copy)?),
                None => {
                    copy(bus);
                    None
                }
            };
            bus.order_reads();
            if self.conversion.starts() == starts {
                return Ok(number);
            }
        }
        Err(Torn)
    }
}

/// A/D converters.
#[derive(Debug)]
pub struct RegisterAnalogIn {
    bus: Bus,
    fields: Box<[Field]>,
    converters: Converters,
    readings: NumberedReadings<[AdcCode; CHANNELS]>,
}

impl RegisterAnalogIn {
    pub(crate) fn new(
        bus: Bus,
        fields: Box<[Field]>,
        converters: Converters,
        readings: NumberedReadings<[AdcCode; CHANNELS]>,
    ) -> RegisterAnalogIn {
        RegisterAnalogIn { bus, fields, converters, readings }
    }
}

impl AnalogIn for RegisterAnalogIn {
    fn longest_wait(&self) -> Nanos {
        self.converters.longest_wait()
    }

    fn channels(&self) -> usize {
        self.fields.len()
    }

    fn code_range(&self) -> (AdcCode, AdcCode) {
        let (low, high) = self.converters.codec.range();
        (AdcCode(low), AdcCode(high))
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
        let (fields, converters) = (&self.fields, &self.converters);
        self.readings.sample(&self.bus, release, |bus| {
            converters.codes(bus, release, fields, ANALOG_IN_NAME)
        })
    }
}

/// A six-axis force/torque sensor's gauges: registers of their own, or chosen A/D channels.
#[derive(Debug)]
pub struct RegisterForceTorque {
    bus: Bus,
    fields: Box<[Field]>,
    converters: Converters,
    readings: NumberedReadings<GaugeCodes>,
}

impl RegisterForceTorque {
    pub(crate) fn new(
        bus: Bus,
        fields: Box<[Field]>,
        converters: Converters,
        readings: NumberedReadings<GaugeCodes>,
    ) -> RegisterForceTorque {
        RegisterForceTorque { bus, fields, converters, readings }
    }
}

impl ForceTorque for RegisterForceTorque {
    fn longest_wait(&self) -> Nanos {
        self.converters.longest_wait()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<GaugeCodes>, Error> {
        let (fields, converters) = (&self.fields, &self.converters);
        self.readings.sample(&self.bus, release, |bus| {
            let (number, codes) = converters.codes(bus, release, fields, FORCE_TORQUE_NAME)?;
            let (low, high) = converters.codec.range();
            Ok((number, GaugeCodes::within(AdcCode(low), AdcCode(high), codes)))
        })
    }
}

/// Where the lines stand in their register.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InputMasks {
    pub(crate) offset: usize,
    pub(crate) drive_power: u32,
    pub(crate) estop_a: u32,
    pub(crate) estop_b: u32,
    pub(crate) inverted: u32,
    pub(crate) zero: u32,
    /// How far the board's beat stands from bit 0, and its bits there.
    pub(crate) beat: Option<(u32, u32)>,
}

/// Lines from the cell. The lines and their running number share one word, so they are never torn.
#[derive(Debug)]
pub struct RegisterDigitalIn {
    bus: Bus,
    masks: InputMasks,
    readings: NumberedReadings<LinesIn>,
}

impl RegisterDigitalIn {
    pub(crate) fn new(
        bus: Bus,
        masks: InputMasks,
        readings: NumberedReadings<LinesIn>,
    ) -> RegisterDigitalIn {
        RegisterDigitalIn { bus, masks, readings }
    }
}

impl DigitalIn for RegisterDigitalIn {
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        let masks = self.masks;
        self.readings.sample(&self.bus, release, |bus| {
            let word = bus.read(masks.offset);
            if word & masks.zero != 0 {
                return Err(Error::whole(ErrorKind::OutOfRange, DIGITAL_IN_NAME));
            }
            let levels = word ^ masks.inverted;
            let lines = LinesIn {
                drive_power: levels & masks.drive_power != 0,
                estop_a_closed: levels & masks.estop_a != 0,
                estop_b_closed: levels & masks.estop_b != 0,
            };
            Ok((masks.beat.map(|(shift, bits)| word >> shift & bits), lines))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquisition::Strobe;
    use crate::description::{Description, StrobeKind};
    use crate::io::RegisterFile;
    use crate::shipped::SHIPPED_BOARDS;

    /// Lets another lane start a conversion during the first so many attempts; the answer and the
    /// attempts.
    fn disturbed(starts: i64) -> (Result<Option<u32>, Torn>, i64) {
        let own = Description::from_toml(SHIPPED_BOARDS[0].1).unwrap();
        let bus = Bus::new(Arc::new(RegisterFile::anonymous().unwrap()), &own);
        let strobe = Strobe::new(&bus, 0x30, StrobeKind::Value, 1);
        let conversion = Arc::new(Acquisition::new(bus.clone(), Some(strobe), None, 1));
        let converters = Converters {
            conversion: conversion.clone(),
            numbers: None,
            codec: Codec::offset_binary(12),
            unused_zero: false,
            is_started_elsewhere: true,
        };
        let mut attempts = 0;
        let answer = converters.read(&bus, |_| {
            attempts += 1;
            if attempts <= starts {
                conversion.start(Nanos(attempts));
            }
        });
        (answer, attempts)
    }

    #[test]
    fn what_another_lane_has_spoilt_is_read_again_and_not_for_ever() {
        let last = TORN_RETRIES as i64 + 1;
        assert_eq!(disturbed(0), (Ok(None), 1));
        assert_eq!(disturbed(1), (Ok(None), 2));
        assert_eq!(disturbed(last - 1), (Ok(None), last));
        assert_eq!(disturbed(last), (Err(Torn), last));
    }
}
