//! The input halves decode the words of one list that reads all inputs of the board: counters, A/D
//! channels, gauges, lines. A word that the board cannot mean is refused as out of range.

use taktil_hal::{
    AdcCode, AnalogIn, CHANNELS, Counts, DigitalIn, Encoders, Error, ErrorKind, ForceTorque,
    GaugeCodes, LinesIn, Nanos, Reading,
};

use crate::board::Instruction;
use crate::codes::{Scale, unfolded_count};
use crate::exchange::{InputBank, Tally, whole};
use crate::sharing::Shared;
use crate::uapi::{BITS_INSTRUCTION, READ_INSTRUCTION, channel_word};
use crate::wiring::{Converter, Counter, DigitalLine, Wiring, all_codes};

const ENCODERS_NAME: &str = "comedi.encoders";
const ANALOG_IN_NAME: &str = "comedi.analog_in";
const FORCE_TORQUE_NAME: &str = "comedi.force_torque";
const DIGITAL_IN_NAME: &str = "comedi.digital_in";

/// Where the words of each half stand in the list of a board's inputs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InputLayout {
    counters: usize,
    analog_in: usize,
    gauges: usize,
    lines: usize,
}

/// The list that reads all inputs, and where the words of the halves stand in it.
pub(crate) fn input_list(wiring: &Wiring) -> (Vec<Instruction>, InputLayout) {
    let mut list = Vec::new();
    let read = |subdevice, channel| Instruction::new(READ_INSTRUCTION, subdevice, channel, &[0]);
    let converter = |channel: &Converter| read(channel.subdevice, channel.channel_word);
    let counters = list.len();
    list.extend(wiring.counters.iter().map(|one| read(one.subdevice, one.channel_word)));
    let analog_in = list.len();
    list.extend(wiring.analog_in.iter().map(converter));
    let gauges = list.len();
    list.extend(wiring.gauges.iter().map(converter));
    let lines = list.len();
    for line in &wiring.lines_in {
        let bank = line_bank(*line, 0, 0);
        if !list[lines..].iter().any(|known| is_same_port(known, &bank)) {
            list.push(bank);
        }
    }
    (list, InputLayout { counters, analog_in, gauges, lines })
}

/// The instruction that sets the lines of a mask in the bank of `line` and reads the bank.
pub(crate) fn line_bank(line: DigitalLine, mask: u32, levels: u32) -> Instruction {
    let channel = channel_word(line.bank(), 0, 0);
    Instruction::new(BITS_INSTRUCTION, line.subdevice, channel, &[mask, levels])
}

/// Whether two instructions go to the same channel of the same subdevice.
pub(crate) fn is_same_port(one: &Instruction, other: &Instruction) -> bool {
    one.subdevice == other.subdevice && one.channel == other.channel
}

/// Samples the common list for one half.
#[derive(Debug)]
struct Sampler<T> {
    device: &'static str,
    bank: Shared<InputBank>,
    tally: Tally,
    is_lost: bool,
    last: Option<Reading<T>>,
}

impl<T: Copy> Sampler<T> {
    fn new(device: &'static str, bank: Shared<InputBank>, tally: Tally) -> Sampler<T> {
        Sampler { device, bank, tally, is_lost: false, last: None }
    }

    /// The reading for `release`; `decode` gives the value of the list's words. `acquired` is the
    /// release: the list is executed after it, and the board has no clock of its own.
    fn sample(
        &mut self,
        release: Nanos,
        decode: impl FnOnce(&[Instruction]) -> Result<T, Error>,
    ) -> Result<Reading<T>, Error> {
        if let Some(last) = self.last
            && last.acquired == release
        {
            return Ok(last);
        }
        let refused = whole(self.device);
        if self.is_lost {
            return Err(refused(ErrorKind::Lost));
        }
        let used = self.bank.try_use(|bank| match bank.at(release) {
            Ok(instructions) => decode(instructions),
            Err(kind) => Err(refused(kind)),
        });
        let Some(answer) = used else {
            self.tally.contention();
            return Err(refused(ErrorKind::Transient));
        };
        self.is_lost |= matches!(answer, Err(Error { kind: ErrorKind::Lost, .. }));
        let reading = Reading { value: answer?, acquired: release };
        self.last = Some(reading);
        Ok(reading)
    }
}

/// Counters of the joints' encoders. They are read one after the other, microseconds apart: no
/// interface of Comedi latches several counters together, nor a count at an index pulse.
#[derive(Debug)]
pub struct ComediEncoders {
    counters: Box<[Counter]>,
    first: usize,
    counts: [i32; CHANNELS],
    sampler: Sampler<[Counts; CHANNELS]>,
}

impl Encoders for ComediEncoders {
    fn joints(&self) -> usize {
        self.counters.len()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        let ComediEncoders { counters, first, counts, sampler } = self;
        sampler.sample(release, |instructions| {
            let mut next = *counts;
            let words = instructions[*first..].iter().map(Instruction::first);
            for ((joint, counter), raw) in (0u16..).zip(counters.iter()).zip(words) {
                if raw > counter.maxdata {
                    return Err(Error::on_channel(ErrorKind::OutOfRange, ENCODERS_NAME, joint));
                }
                let count = &mut next[usize::from(joint)];
                *count = unfolded_count(*count, raw, counter.bits);
            }
            *counts = next;
            Ok(next.map(Counts))
        })
    }

    fn index_pulse_reach(&self) -> i32 {
        let narrowest = self.counters.iter().map(|counter| counter.bits).min().unwrap_or(32);
        i32::MAX >> (32 - narrowest)
    }
}

/// The codes of the converters whose words stand from `first` on.
fn codes<const N: usize>(
    instructions: &[Instruction],
    first: usize,
    scales: &[Scale],
    device: &'static str,
) -> Result<[AdcCode; N], Error> {
    let mut codes = [AdcCode(0); N];
    let words = instructions[first..].iter().map(Instruction::first);
    for (((channel, code), scale), word) in (0u16..).zip(&mut codes).zip(scales).zip(words) {
        let refused = Error::on_channel(ErrorKind::OutOfRange, device, channel);
        *code = AdcCode(scale.code(word).ok_or(refused)?);
    }
    Ok(codes)
}

/// A/D converters. The range of codes is that of all channels together: a channel of a smaller
/// range clips before.
#[derive(Debug)]
pub struct ComediAnalogIn {
    scales: Box<[Scale]>,
    range: [i32; 2],
    first: usize,
    sampler: Sampler<[AdcCode; CHANNELS]>,
}

impl AnalogIn for ComediAnalogIn {
    fn channels(&self) -> usize {
        self.scales.len()
    }

    fn code_range(&self) -> (AdcCode, AdcCode) {
        let [low, high] = self.range;
        (AdcCode(low), AdcCode(high))
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
        let (scales, first) = (&self.scales, self.first);
        self.sampler
            .sample(release, |instructions| codes(instructions, first, scales, ANALOG_IN_NAME))
    }
}

/// A six-axis force/torque sensor's gauges on A/D converters.
#[derive(Debug)]
pub struct ComediForceTorque {
    scales: Box<[Scale]>,
    first: usize,
    sampler: Sampler<GaugeCodes>,
}

impl ForceTorque for ComediForceTorque {
    fn sample(&mut self, release: Nanos) -> Result<Reading<GaugeCodes>, Error> {
        let (scales, first) = (&self.scales, self.first);
        self.sampler.sample(release, |instructions| {
            let codes = codes(instructions, first, scales, FORCE_TORQUE_NAME)?;
            let mut gauges = GaugeCodes { codes, ..GaugeCodes::default() };
            // The sample tells, not the code: calibration may take a clipped one off the end.
            let words = instructions[first..].iter().map(Instruction::first);
            for ((over, scale), word) in gauges.over_range.iter_mut().zip(scales).zip(words) {
                *over = scale.is_at_end(word);
            }
            Ok(gauges)
        })
    }
}

/// Where the level of a line stands in the list.
#[derive(Clone, Copy, Debug)]
struct LinePlace {
    at: usize,
    bit: u32,
    is_inverted: bool,
}

/// Lines from the cell.
#[derive(Debug)]
pub struct ComediDigitalIn {
    /// Drive power and both channels of the emergency stop.
    places: [LinePlace; 3],
    sampler: Sampler<LinesIn>,
}

impl DigitalIn for ComediDigitalIn {
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        let places = self.places;
        self.sampler.sample(release, |instructions| {
            let [drive_power, estop_a_closed, estop_b_closed] = places.map(|place| {
                let levels = instructions.get(place.at).and_then(|bank| bank.words().get(1));
                levels.is_some_and(|levels| (levels & place.bit != 0) != place.is_inverted)
            });
            Ok(LinesIn { drive_power, estop_a_closed, estop_b_closed })
        })
    }
}

/// Makes the input halves of one board.
pub(crate) struct InputMaker<'a> {
    pub(crate) wiring: &'a Wiring,
    pub(crate) layout: InputLayout,
    /// The list that `layout` describes.
    pub(crate) list: &'a [Instruction],
    pub(crate) bank: Shared<InputBank>,
    pub(crate) tally: &'a dyn Fn() -> Tally,
}

fn scales(converters: &[Converter]) -> Box<[Scale]> {
    converters.iter().map(|converter| converter.scale).collect()
}

impl InputMaker<'_> {
    fn sampler<T: Copy>(&self, device: &'static str) -> Sampler<T> {
        Sampler::new(device, self.bank.clone(), (self.tally)())
    }

    pub(crate) fn encoders(&self) -> Option<Box<dyn Encoders>> {
        let counters = &self.wiring.counters;
        (!counters.is_empty()).then(|| {
            Box::new(ComediEncoders {
                counters: counters.clone().into_boxed_slice(),
                first: self.layout.counters,
                counts: [0; CHANNELS],
                sampler: self.sampler(ENCODERS_NAME),
            }) as Box<dyn Encoders>
        })
    }

    pub(crate) fn analog_in(&self) -> Option<Box<dyn AnalogIn>> {
        let channels = &self.wiring.analog_in;
        (!channels.is_empty()).then(|| {
            Box::new(ComediAnalogIn {
                scales: scales(channels),
                range: all_codes(channels),
                first: self.layout.analog_in,
                sampler: self.sampler(ANALOG_IN_NAME),
            }) as Box<dyn AnalogIn>
        })
    }

    pub(crate) fn force_torque(&self) -> Option<Box<dyn ForceTorque>> {
        let gauges = &self.wiring.gauges;
        (!gauges.is_empty()).then(|| {
            Box::new(ComediForceTorque {
                scales: scales(gauges),
                first: self.layout.gauges,
                sampler: self.sampler(FORCE_TORQUE_NAME),
            }) as Box<dyn ForceTorque>
        })
    }

    pub(crate) fn digital_in(&self) -> Option<Box<dyn DigitalIn>> {
        let place = |line: &DigitalLine| {
            let bank = line_bank(*line, 0, 0);
            let banks = &self.list[self.layout.lines..];
            let at = banks.iter().position(|known| is_same_port(known, &bank)).unwrap_or(0);
            LinePlace { at: self.layout.lines + at, bit: line.bit(), is_inverted: line.is_inverted }
        };
        let [power, estop_a, estop_b] = self.wiring.lines_in.as_slice() else { return None };
        let places = [power, estop_a, estop_b].map(place);
        let sampler = self.sampler(DIGITAL_IN_NAME);
        Some(Box::new(ComediDigitalIn { places, sampler }))
    }
}
