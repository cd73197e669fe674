//! The half of the encoder counters: latched together, carried across their wrap, and a step that
//! no joint can make is not believed until the next reading confirms it.

use std::sync::Arc;

use taktil_hal::{CHANNELS, Counts, Encoders, Error, ErrorKind, IndexPulses, Nanos, Reading};

use crate::acquisition::Acquisition;
use crate::block::{NumberedReadings, Numbers, Torn, read_consistent, read_twice};
use crate::bus::{Bus, Field};
use crate::codes::{unwrap_count, unwrap_reach};
use crate::description::Hold;

/// The name of the half in errors.
pub(crate) const ENCODERS_NAME: &str = "regmap.encoders";

/// How the counters are read.
#[derive(Debug)]
pub(crate) struct Counters {
    pub(crate) fields: Box<[Field]>,
    pub(crate) bits: u32,
    /// The bits that are turned over on the bus.
    pub(crate) inverted: u32,
    pub(crate) numbers: Option<Numbers>,
    pub(crate) hold: Hold,
    /// 0 where every step is believed.
    pub(crate) step_max_counts: u32,
}

impl Counters {
    fn pass(&self, bus: &Bus, fields: &[Field]) -> [u32; CHANNELS] {
        let mut raw = [0; CHANNELS];
        for (raw, field) in raw.iter_mut().zip(fields) {
            *raw = field.bits(field.read_whole(bus)) ^ self.inverted;
        }
        raw
    }

    /// The counters' words, in one piece, with the number of the block.
    fn read(&self, bus: &Bus) -> Result<(Option<u32>, [u32; CHANNELS]), Torn> {
        if let Some(numbers) = self.numbers {
            let mut raw = [0; CHANNELS];
            let number = read_consistent(bus, numbers, |bus| raw = self.pass(bus, &self.fields))?;
            return Ok((Some(number), raw));
        }
        let raw = match self.hold {
            Hold::Latch | Hold::Read => self.pass(bus, &self.fields),
            Hold::Reread => read_twice(bus, |bus| self.pass(bus, &self.fields))?,
        };
        Ok((None, raw))
    }
}

/// The counters at index pulses of a board that latches them.
#[derive(Debug)]
pub(crate) struct IndexLatch {
    pub(crate) fields: Box<[Field]>,
    /// The register with a bit for each channel of the board.
    pub(crate) seen_offset: usize,
    /// Which bit is whose.
    pub(crate) channels: Box<[usize]>,
    pub(crate) numbers: Option<Numbers>,
    /// The counters' words at the newest pulses.
    raw: [Option<u32>; CHANNELS],
    pulses: IndexPulses,
}

impl IndexLatch {
    pub(crate) fn new(
        fields: Box<[Field]>,
        seen_offset: usize,
        channels: Box<[usize]>,
        numbers: Option<Numbers>,
    ) -> IndexLatch {
        let (raw, pulses) = ([None; CHANNELS], [None; CHANNELS]);
        IndexLatch { fields, seen_offset, channels, numbers, raw, pulses }
    }

    /// The words of the channels that have passed a pulse.
    fn read(&self, bus: &Bus, counters: &Counters) -> Result<[Option<u32>; CHANNELS], Torn> {
        let pass = |bus: &Bus| (counters.pass(bus, &self.fields), bus.read(self.seen_offset));
        let mut found = ([0; CHANNELS], 0);
        match self.numbers {
            Some(numbers) => {
                read_consistent(bus, numbers, |bus| found = pass(bus))?;
            }
            None => found = read_twice(bus, pass)?,
        }
        let (words, seen) = found;
        let mut raw = [None; CHANNELS];
        for ((raw, word), channel) in raw.iter_mut().zip(words).zip(&self.channels) {
            *raw = (seen >> channel & 1 == 1).then_some(word);
        }
        Ok(raw)
    }

    /// Takes in what the board has latched. A word that has changed is a new pulse and lies near
    /// the present count; one that has not is the pulse known before.
    fn update(&mut self, raw: [Option<u32>; CHANNELS], counts: &[i32; CHANNELS], bits: u32) {
        for (i, raw) in raw.into_iter().enumerate() {
            // A board that has lost its power has forgotten pulses; they stay where they were.
            if raw.is_some() && raw != self.raw[i] {
                self.raw[i] = raw;
                self.pulses[i] = raw.map(|raw| Counts(unwrap_count(counts[i], raw, bits)));
            }
        }
    }
}

/// Encoder counters.
#[derive(Debug)]
pub struct RegisterEncoders {
    bus: Bus,
    joints: usize,
    counters: Counters,
    latch: Arc<Acquisition>,
    /// A conversion that runs while the counters are read.
    conversion: Option<Arc<Acquisition>>,
    counts: [i32; CHANNELS],
    /// The counts are those of a reading, not yet the zeros of the beginning.
    is_started: bool,
    /// What a step that was not believed led to.
    suspected: [Option<i32>; CHANNELS],
    index: Option<IndexLatch>,
    readings: NumberedReadings<[Counts; CHANNELS]>,
}

impl RegisterEncoders {
    pub(crate) fn new(
        bus: Bus,
        counters: Counters,
        latch: Arc<Acquisition>,
        conversion: Option<Arc<Acquisition>>,
        index: Option<IndexLatch>,
        readings: NumberedReadings<[Counts; CHANNELS]>,
    ) -> RegisterEncoders {
        RegisterEncoders {
            bus,
            joints: counters.fields.len(),
            counters,
            latch,
            conversion,
            counts: [0; CHANNELS],
            is_started: false,
            suspected: [None; CHANNELS],
            index,
            readings,
        }
    }
}

/// What a sample changes besides the reading.
struct State<'a> {
    counts: &'a mut [i32; CHANNELS],
    is_started: &'a mut bool,
    suspected: &'a mut [Option<i32>; CHANNELS],
}

impl State<'_> {
    /// Carries the counts on to what the counters read.
    ///
    /// # Errors
    /// The first channel whose step is not believed; no count has changed then.
    fn update(
        &mut self,
        raw: [u32; CHANNELS],
        joints: usize,
        counters: &Counters,
    ) -> Result<(), Error> {
        let mut counts = *self.counts;
        for (count, raw) in counts.iter_mut().zip(raw).take(joints) {
            *count = unwrap_count(*count, raw, counters.bits);
        }
        if counters.step_max_counts > 0 && *self.is_started {
            let far = |to: i32, from: i32| {
                to.wrapping_sub(from).unsigned_abs() > counters.step_max_counts
            };
            let mut refused = None;
            let steps = counts.iter().zip(*self.counts).zip(self.suspected.iter_mut());
            for (channel, ((to, from), suspected)) in (0..).zip(steps.take(joints)) {
                let confirmed = suspected.is_some_and(|before| !far(*to, before));
                let jumps = far(*to, from);
                *suspected = jumps.then_some(*to);
                if jumps && !confirmed && refused.is_none() {
                    refused = Some(channel);
                }
            }
            if let Some(channel) = refused {
                return Err(Error::on_channel(ErrorKind::Transient, ENCODERS_NAME, channel));
            }
            *self.suspected = [None; CHANNELS];
        }
        *self.counts = counts;
        *self.is_started = true;
        Ok(())
    }
}

impl Encoders for RegisterEncoders {
    fn longest_wait(&self) -> Nanos {
        self.latch.longest_wait()
    }

    fn joints(&self) -> usize {
        self.joints
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        let RegisterEncoders { joints, counters, latch, conversion, index, .. } = self;
        let mut state = State {
            counts: &mut self.counts,
            is_started: &mut self.is_started,
            suspected: &mut self.suspected,
        };
        self.readings.sample(&self.bus, release, |bus| {
            if let Some(conversion) = conversion {
                conversion.start(release);
            }
            latch.start(release);
            let torn = Error::whole(ErrorKind::Transient, ENCODERS_NAME);
            if !latch.wait() {
                return Err(torn);
            }
            let (number, raw) = counters.read(bus).map_err(|Torn| torn)?;
            state.update(raw, *joints, counters)?;
            if let Some(index) = index {
                let raw = index.read(bus, counters).map_err(|Torn| torn)?;
                index.update(raw, state.counts, counters.bits);
            }
            Ok((number, state.counts.map(Counts)))
        })
    }

    fn has_index(&self) -> bool {
        self.index.is_some()
    }

    fn index_pulses(&self) -> IndexPulses {
        self.index.as_ref().map_or([None; CHANNELS], |index| index.pulses)
    }

    fn index_pulse_reach(&self) -> i32 {
        unwrap_reach(self.counters.bits)
    }
}
