//! The input halves that give readings: encoders, A/D, force/torque, lines. A word with bits set
//! that the board does not have is refused as out of range.

use std::sync::Arc;

use taktil_hal::{
    AdcCode, AnalogIn, CHANNELS, Counts, DigitalIn, Encoders, Error, ErrorKind,
    FORCE_TORQUE_CHANNELS, ForceTorque, IndexPulses, LinesIn, Nanos, Reading,
};

use crate::block::{NumberedReadings, read_consistent};
use crate::codes::{OffsetBinary, unwrap_count, unwrap_reach};
use crate::config::Config;
use crate::io::RegisterFile;
use crate::registers::{
    ADC, BOARD_CHANNELS, Block, DIGITAL_IN, ENCODER_LATCH, ENCODERS, FEATURE_INDEX, FEATURES,
    FORCE_TORQUE, IN_BEAT_SHIFT, IN_DRIVE_POWER, IN_ESTOP_A_CLOSED, IN_ESTOP_B_CLOSED, IN_RESERVED,
    INDEX,
};

const ENCODERS_NAME: &str = "regmap.encoders";
const ANALOG_IN_NAME: &str = "regmap.analog_in";
const FORCE_TORQUE_NAME: &str = "regmap.force_torque";
const DIGITAL_IN_NAME: &str = "regmap.digital_in";

fn stale_after(config: &Config) -> Nanos {
    Nanos::from_millis(i64::from(config.stale_ms))
}

/// Encoder counters.
#[derive(Debug)]
pub struct RegisterEncoders {
    registers: Arc<RegisterFile>,
    joints: usize,
    counter_bits: u32,
    latch: u16,
    counts: [i32; CHANNELS],
    index: Option<IndexLatch>,
    readings: NumberedReadings<[Counts; CHANNELS]>,
}

/// The index pulses of a board that latches them.
#[derive(Debug)]
struct IndexLatch {
    /// The counters' words at the newest pulses.
    raw: [Option<u32>; CHANNELS],
    pulses: IndexPulses,
}

impl IndexLatch {
    /// Takes in what the board has latched. A word that has changed is a new pulse and lies near
    /// the present count; one that has not is the pulse known before.
    fn update(&mut self, raw: [Option<u32>; CHANNELS], counts: &[i32; CHANNELS], bits: u32) {
        for (i, raw) in raw.into_iter().enumerate() {
            if raw != self.raw[i] {
                self.raw[i] = raw;
                self.pulses[i] = raw.map(|raw| Counts(unwrap_count(counts[i], raw, bits)));
            }
        }
    }
}

/// The latched counters of the first `joints` channels that have passed an index pulse; `None` when
/// the block was torn.
fn read_index_block(registers: &RegisterFile, joints: usize) -> Option<[Option<u32>; CHANNELS]> {
    let (mut words, mut seen) = ([0u32; CHANNELS], 0);
    read_consistent(registers, INDEX, |registers| {
        let mut all = INDEX.words.iter();
        let mut next = || all.next().map_or(0, |register| registers.read(register));
        for word in words.iter_mut().take(BOARD_CHANNELS) {
            *word = (u32::from(next()) << 16) | u32::from(next());
        }
        seen = next();
    })?;
    Some(core::array::from_fn(|i| (i < joints && seen >> i & 1 == 1).then_some(words[i])))
}

impl RegisterEncoders {
    pub(crate) fn new(registers: Arc<RegisterFile>, config: &Config) -> RegisterEncoders {
        RegisterEncoders {
            latch: registers.read(ENCODER_LATCH),
            index: (registers.read(FEATURES) & FEATURE_INDEX != 0)
                .then_some(IndexLatch { raw: [None; CHANNELS], pulses: [None; CHANNELS] }),
            registers,
            joints: config.joints,
            counter_bits: config.counter_bits,
            counts: [0; CHANNELS],
            readings: NumberedReadings::new(ENCODERS_NAME, stale_after(config)),
        }
    }
}

impl Encoders for RegisterEncoders {
    fn joints(&self) -> usize {
        self.joints
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        let RegisterEncoders { latch, counts, index, joints, counter_bits, .. } = self;
        self.readings.sample(&self.registers, release, |registers| {
            *latch = latch.wrapping_add(1);
            registers.write(ENCODER_LATCH, *latch);
            let mut raw = [0u32; CHANNELS];
            let number = read_consistent(registers, ENCODERS, |registers| {
                let mut halves = ENCODERS.words.iter();
                for raw in &mut raw {
                    let mut half = || halves.next().map_or(0, |r| u32::from(registers.read(r)));
                    *raw = (half() << 16) | half();
                }
            });
            let number = number.ok_or(Error::whole(ErrorKind::Transient, ENCODERS_NAME))?;
            for (count, raw) in counts.iter_mut().zip(raw).take(*joints) {
                *count = unwrap_count(*count, raw, *counter_bits);
            }
            if let Some(index) = index {
                let raw = read_index_block(registers, *joints);
                let raw = raw.ok_or(Error::whole(ErrorKind::Transient, ENCODERS_NAME))?;
                index.update(raw, counts, *counter_bits);
            }
            Ok((number, counts.map(Counts)))
        })
    }

    fn has_index(&self) -> bool {
        self.index.is_some()
    }

    fn index_pulses(&self) -> IndexPulses {
        self.index.as_ref().map_or([None; CHANNELS], |index| index.pulses)
    }

    fn index_pulse_reach(&self) -> i32 {
        unwrap_reach(self.counter_bits)
    }
}

/// A/D converters.
#[derive(Debug)]
pub struct RegisterAnalogIn {
    registers: Arc<RegisterFile>,
    channels: usize,
    coding: OffsetBinary,
    readings: NumberedReadings<[AdcCode; CHANNELS]>,
}

impl RegisterAnalogIn {
    pub(crate) fn new(registers: Arc<RegisterFile>, config: &Config) -> RegisterAnalogIn {
        RegisterAnalogIn {
            registers,
            channels: config.adc_channels,
            coding: OffsetBinary::new(config.adc_bits),
            readings: NumberedReadings::new(ANALOG_IN_NAME, stale_after(config)),
        }
    }
}

impl AnalogIn for RegisterAnalogIn {
    fn channels(&self) -> usize {
        self.channels
    }

    fn code_range(&self) -> (AdcCode, AdcCode) {
        let (low, high) = self.coding.range();
        (AdcCode(low), AdcCode(high))
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
        let (channels, coding) = (self.channels, self.coding);
        self.readings.sample(&self.registers, release, |registers| {
            codes(registers, ADC, ANALOG_IN_NAME, channels, coding)
        })
    }
}

/// A six-axis force/torque sensor's gauges.
#[derive(Debug)]
pub struct RegisterForceTorque {
    registers: Arc<RegisterFile>,
    coding: OffsetBinary,
    readings: NumberedReadings<[AdcCode; FORCE_TORQUE_CHANNELS]>,
}

impl RegisterForceTorque {
    pub(crate) fn new(registers: Arc<RegisterFile>, config: &Config) -> RegisterForceTorque {
        RegisterForceTorque {
            registers,
            coding: OffsetBinary::new(config.gauge_bits),
            readings: NumberedReadings::new(FORCE_TORQUE_NAME, stale_after(config)),
        }
    }
}

impl ForceTorque for RegisterForceTorque {
    fn sample(
        &mut self,
        release: Nanos,
    ) -> Result<Reading<[AdcCode; FORCE_TORQUE_CHANNELS]>, Error> {
        let coding = self.coding;
        self.readings.sample(&self.registers, release, |registers| {
            codes(registers, FORCE_TORQUE, FORCE_TORQUE_NAME, FORCE_TORQUE_CHANNELS, coding)
        })
    }
}

/// The codes of one consistent block of offset binary words, with its number; words from `channels`
/// on are not decoded.
fn codes<const N: usize>(
    registers: &RegisterFile,
    block: Block,
    device: &'static str,
    channels: usize,
    coding: OffsetBinary,
) -> Result<(u16, [AdcCode; N]), Error> {
    let mut words = [0u16; N];
    let number = read_consistent(registers, block, |registers| {
        for (word, register) in words.iter_mut().zip(block.words.iter()) {
            *word = registers.read(register);
        }
    });
    let number = number.ok_or(Error::whole(ErrorKind::Transient, device))?;
    let mut codes = [AdcCode(0); N];
    for (channel, (code, word)) in (0u16..).zip(codes.iter_mut().zip(words).take(channels)) {
        let refused = Error::on_channel(ErrorKind::OutOfRange, device, channel);
        *code = AdcCode(coding.code(word).ok_or(refused)?);
    }
    Ok((number, codes))
}

/// Lines from the cell. The lines and their running number share one word, so they are never torn.
#[derive(Debug)]
pub struct RegisterDigitalIn {
    registers: Arc<RegisterFile>,
    readings: NumberedReadings<LinesIn>,
}

impl RegisterDigitalIn {
    pub(crate) fn new(registers: Arc<RegisterFile>, config: &Config) -> RegisterDigitalIn {
        RegisterDigitalIn {
            registers,
            readings: NumberedReadings::new(DIGITAL_IN_NAME, stale_after(config)),
        }
    }
}

impl DigitalIn for RegisterDigitalIn {
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        self.readings.sample(&self.registers, release, |registers| {
            let word = registers.read(DIGITAL_IN);
            if word & IN_RESERVED != 0 {
                return Err(Error::whole(ErrorKind::OutOfRange, DIGITAL_IN_NAME));
            }
            let lines = LinesIn {
                drive_power: word & IN_DRIVE_POWER != 0,
                estop_a_closed: word & IN_ESTOP_A_CLOSED != 0,
                estop_b_closed: word & IN_ESTOP_B_CLOSED != 0,
            };
            Ok((word >> IN_BEAT_SHIFT, lines))
        })
    }
}
