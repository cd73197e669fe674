//! Records device halves: a recording half passes each call on to the device and writes the answer
//! as a signal `hal.NAME`, which is called a tape. The inverse, in [`player`], gives these answers
//! in place of the devices. The answer of `safe` is not recorded, because no task acts on it.

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

/// A device half that records its answers.
struct RecordingHalf<H: ?Sized, E> {
    half: Box<H>,
    tape: Tape<E>,
}

fn recording_half<H: ?Sized, E: Payload>(
    half: Box<H>,
    name: &str,
    ports: &mut Ports,
) -> RecordingHalf<H, E> {
    RecordingHalf { half, tape: ports.tape(name) }
}

/// Recording encoders, for the task that declares `ports`.
#[must_use]
pub fn encoders(half: Box<dyn Encoders>, ports: &mut Ports) -> Box<dyn Encoders> {
    let index = half.has_index().then(|| ports.tape(name::INDEX));
    Box::new(RecordingEncoders {
        recording_half: recording_half(half, name::ENCODERS, ports),
        index,
    })
}

/// Recording D/A converters.
#[must_use]
pub fn analog_out(half: Box<dyn AnalogOut>, ports: &mut Ports) -> Box<dyn AnalogOut> {
    Box::new(recording_half::<_, AnalogWord>(half, name::ANALOG_OUT, ports))
}

/// Recording A/D converters.
#[must_use]
pub fn analog_in(half: Box<dyn AnalogIn>, ports: &mut Ports) -> Box<dyn AnalogIn> {
    Box::new(recording_half::<_, AnalogEntry>(half, name::ANALOG_IN, ports))
}

/// A recording tactile array.
#[must_use]
pub fn tactile(half: Box<dyn TactileArray>, ports: &mut Ports) -> Box<dyn TactileArray> {
    Box::new(recording_half::<_, TactileEntry>(half, name::TACTILE, ports))
}

/// The recording array on the opposed fingertip.
#[must_use]
pub fn tactile_opposed(half: Box<dyn TactileArray>, ports: &mut Ports) -> Box<dyn TactileArray> {
    Box::new(recording_half::<_, TactileEntry>(half, name::TACTILE_OPPOSED, ports))
}

/// A recording force/torque sensor.
#[must_use]
pub fn force_torque(half: Box<dyn ForceTorque>, ports: &mut Ports) -> Box<dyn ForceTorque> {
    Box::new(recording_half::<_, AnalogEntry>(half, name::FORCE_TORQUE, ports))
}

/// Recording input lines.
#[must_use]
pub fn digital_in(half: Box<dyn DigitalIn>, ports: &mut Ports) -> Box<dyn DigitalIn> {
    Box::new(recording_half::<_, DigitalEntry>(half, name::DIGITAL_IN, ports))
}

/// Recording output lines.
#[must_use]
pub fn digital_out(half: Box<dyn DigitalOut>, ports: &mut Ports) -> Box<dyn DigitalOut> {
    Box::new(recording_half::<_, DigitalWord>(half, name::DIGITAL_OUT, ports))
}

/// Recording encoders with their index pulses.
struct RecordingEncoders {
    recording_half: RecordingHalf<dyn Encoders, EncoderEntry>,
    index: Option<Tape<IndexEntry>>,
}

impl Encoders for RecordingEncoders {
    fn joints(&self) -> usize {
        self.recording_half.half.joints()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        let answer = self.recording_half.half.sample(release);
        self.recording_half.tape.append(release, EncoderEntry::of(&answer));
        if let Some(tape) = &mut self.index {
            tape.append(release, IndexEntry::of(&self.recording_half.half.index_pulses()));
        }
        answer
    }

    fn has_index(&self) -> bool {
        self.index.is_some()
    }

    fn index_pulses(&self) -> IndexPulses {
        self.recording_half.half.index_pulses()
    }

    fn index_pulse_reach(&self) -> i32 {
        self.recording_half.half.index_pulse_reach()
    }
}

impl AnalogOut for RecordingHalf<dyn AnalogOut, AnalogWord> {
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

impl AnalogIn for RecordingHalf<dyn AnalogIn, AnalogEntry> {
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

impl TactileArray for RecordingHalf<dyn TactileArray, TactileEntry> {
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

impl ForceTorque for RecordingHalf<dyn ForceTorque, AnalogEntry> {
    fn sample(
        &mut self,
        release: Nanos,
    ) -> Result<Reading<[AdcCode; FORCE_TORQUE_CHANNELS]>, Error> {
        let answer = self.half.sample(release);
        self.tape.append(release, AnalogEntry::of(&answer));
        answer
    }
}

impl DigitalIn for RecordingHalf<dyn DigitalIn, DigitalEntry> {
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        let answer = self.half.sample(release);
        self.tape.append(release, DigitalEntry::of(&answer));
        answer
    }
}

impl DigitalOut for RecordingHalf<dyn DigitalOut, DigitalWord> {
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
