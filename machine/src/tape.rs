//! Records device halves: a recording half passes each call on to the device and writes the answer
//! as a signal `hal.NAME`. The inverse, in [`player`], gives these answers in place of the devices.
//! The answer of `safe` is not recorded, because no task acts on it.

pub mod entry;
pub mod player;

use taktil_hal::{
    AdcCode, AnalogIn, AnalogOut, Arrival, CHANNELS, Counts, DacCode, DigitalIn, DigitalOut,
    Encoders, Error, FORCE_TORQUE_CHANNELS, ForceTorque, IndexPulses, LinesIn, LinesOut, Nanos,
    Reading, TactileArray, TactileFrame,
};
use taktil_rtcore::{Payload, Ports, Tape};

pub use entry::{
    AnalogEntry, AnalogWord, DigitalEntry, DigitalWord, EncoderEntry, IndexEntry, Outcome,
    TactileEntry,
};

/// Names of the tapes.
pub mod name {
    /// Encoders.
    pub const ENCODERS: &str = "hal.encoders";
    /// Index pulses of the encoders, of a board that latches them.
    pub const INDEX: &str = "hal.index";
    /// D/A words.
    pub const ANALOG_OUT: &str = "hal.analog_out";
    /// A/D codes.
    pub const ANALOG_IN: &str = "hal.analog_in";
    /// Tactile frames.
    pub const TACTILE: &str = "hal.tactile";
    /// Frames of the array on the opposed fingertip.
    pub const TACTILE_OPPOSED: &str = "hal.tactile_opposed";
    /// Gauges of the force/torque sensor.
    pub const FORCE_TORQUE: &str = "hal.force_torque";
    /// Input lines.
    pub const DIGITAL_IN: &str = "hal.digital_in";
    /// Output lines.
    pub const DIGITAL_OUT: &str = "hal.digital_out";
}

/// A half with its tape.
struct Taped<H: ?Sized, E> {
    half: Box<H>,
    tape: Tape<E>,
}

fn taped<H: ?Sized, E: Payload>(half: Box<H>, name: &str, ports: &mut Ports) -> Taped<H, E> {
    Taped { half, tape: ports.tape(name) }
}

/// Encoders on tape, for the task that declares `ports`.
#[must_use]
pub fn encoders(half: Box<dyn Encoders>, ports: &mut Ports) -> Box<dyn Encoders> {
    let index = half.has_index().then(|| ports.tape(name::INDEX));
    Box::new(TapedEncoders { taped: taped(half, name::ENCODERS, ports), index })
}

/// D/A converters on tape.
#[must_use]
pub fn analog_out(half: Box<dyn AnalogOut>, ports: &mut Ports) -> Box<dyn AnalogOut> {
    Box::new(taped::<_, AnalogWord>(half, name::ANALOG_OUT, ports))
}

/// A/D converters on tape.
#[must_use]
pub fn analog_in(half: Box<dyn AnalogIn>, ports: &mut Ports) -> Box<dyn AnalogIn> {
    Box::new(taped::<_, AnalogEntry>(half, name::ANALOG_IN, ports))
}

/// A tactile array on tape.
#[must_use]
pub fn tactile(half: Box<dyn TactileArray>, ports: &mut Ports) -> Box<dyn TactileArray> {
    Box::new(taped::<_, TactileEntry>(half, name::TACTILE, ports))
}

/// The array on the opposed fingertip on tape.
#[must_use]
pub fn tactile_opposed(half: Box<dyn TactileArray>, ports: &mut Ports) -> Box<dyn TactileArray> {
    Box::new(taped::<_, TactileEntry>(half, name::TACTILE_OPPOSED, ports))
}

/// A force/torque sensor on tape.
#[must_use]
pub fn force_torque(half: Box<dyn ForceTorque>, ports: &mut Ports) -> Box<dyn ForceTorque> {
    Box::new(taped::<_, AnalogEntry>(half, name::FORCE_TORQUE, ports))
}

/// Input lines on tape.
#[must_use]
pub fn digital_in(half: Box<dyn DigitalIn>, ports: &mut Ports) -> Box<dyn DigitalIn> {
    Box::new(taped::<_, DigitalEntry>(half, name::DIGITAL_IN, ports))
}

/// Output lines on tape.
#[must_use]
pub fn digital_out(half: Box<dyn DigitalOut>, ports: &mut Ports) -> Box<dyn DigitalOut> {
    Box::new(taped::<_, DigitalWord>(half, name::DIGITAL_OUT, ports))
}

/// Encoders with their tapes.
struct TapedEncoders {
    taped: Taped<dyn Encoders, EncoderEntry>,
    index: Option<Tape<IndexEntry>>,
}

impl Encoders for TapedEncoders {
    fn joints(&self) -> usize {
        self.taped.half.joints()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        let answer = self.taped.half.sample(release);
        self.taped.tape.append(release, EncoderEntry::of(&answer));
        if let Some(tape) = &mut self.index {
            tape.append(release, IndexEntry::of(&self.taped.half.index_pulses()));
        }
        answer
    }

    fn has_index(&self) -> bool {
        self.index.is_some()
    }

    fn index_pulses(&self) -> IndexPulses {
        self.taped.half.index_pulses()
    }

    fn index_pulse_reach(&self) -> i32 {
        self.taped.half.index_pulse_reach()
    }
}

impl AnalogOut for Taped<dyn AnalogOut, AnalogWord> {
    fn channels(&self) -> usize {
        self.half.channels()
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        self.half.code_range()
    }

    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let answer = self.half.commit(release, codes);
        self.tape.append(release, AnalogWord::of(codes, &answer));
        answer
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.half.safe()
    }

    fn safe_value(&self) -> DacCode {
        self.half.safe_value()
    }

    fn longest_silence(&self) -> Nanos {
        self.half.longest_silence()
    }
}

impl AnalogIn for Taped<dyn AnalogIn, AnalogEntry> {
    fn channels(&self) -> usize {
        self.half.channels()
    }

    fn code_range(&self) -> (AdcCode, AdcCode) {
        self.half.code_range()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
        let answer = self.half.sample(release);
        self.tape.append(release, AnalogEntry::of(&answer));
        answer
    }
}

impl TactileArray for Taped<dyn TactileArray, TactileEntry> {
    fn rows(&self) -> usize {
        self.half.rows()
    }

    fn cols(&self) -> usize {
        self.half.cols()
    }

    fn full_scale(&self) -> u16 {
        self.half.full_scale()
    }

    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        let answer = self.half.sample(release, frame);
        self.tape.append(release, TactileEntry::of(frame, &answer));
        answer
    }
}

impl ForceTorque for Taped<dyn ForceTorque, AnalogEntry> {
    fn sample(
        &mut self,
        release: Nanos,
    ) -> Result<Reading<[AdcCode; FORCE_TORQUE_CHANNELS]>, Error> {
        let answer = self.half.sample(release);
        self.tape.append(release, AnalogEntry::of(&answer));
        answer
    }
}

impl DigitalIn for Taped<dyn DigitalIn, DigitalEntry> {
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        let answer = self.half.sample(release);
        self.tape.append(release, DigitalEntry::of(&answer));
        answer
    }
}

impl DigitalOut for Taped<dyn DigitalOut, DigitalWord> {
    fn commit(&mut self, release: Nanos, lines: &LinesOut) -> Result<(), Error> {
        let answer = self.half.commit(release, lines);
        self.tape.append(release, DigitalWord::of(lines, &answer));
        answer
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.half.safe()
    }

    fn longest_silence(&self) -> Nanos {
        self.half.longest_silence()
    }
}
