//! Records device halves: a recording half passes each call on to the device and writes the answer
//! as a signal `hal.NAME`, which is called a tape. The inverse, in [`player`], gives these answers
//! in place of the devices. The answer of `safe` is not recorded, because no task acts on it.

mod clock;
mod drives;
pub mod entry;
mod playback;
pub mod player;

use taktil_hal::{
    AdcCode, AnalogIn, AnalogOut, Arrival, CHANNELS, Counts, DacCode, DigitalIn, DigitalOut,
    Encoders, Error, ForceTorque, GaugeCodes, IndexPulses, LinesIn, LinesOut, Nanos, Reading,
    TactileArray, TactileFrame,
};
use taktil_rtcore::{ArrayTape, Payload, Ports, Tape};

pub use clock::{ClockEntry, board_clock};
pub use drives::{DriveEntry, DriveWord, drive_in, drive_out};
pub use entry::{
    AnalogEntry, AnalogWord, DigitalEntry, DigitalWord, EncoderEntry, IndexEntry, NARROW_CHANNELS,
    Outcome, TactileEntry,
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
    /// Tactile frames of the array of this name in [`taktil_hal::Devices::tactile`].
    #[must_use]
    pub fn tactile(array: &str) -> String {
        format!("hal.{array}")
    }
    /// The array whose frames are on the tape of this name, if it is one of theirs.
    #[must_use]
    pub fn array_of(tape: &str) -> Option<&str> {
        tape.strip_prefix("hal.").filter(|array| array.starts_with(taktil_hal::TACTILE))
    }
    /// Gauges of the force/torque sensor.
    pub const FORCE_TORQUE: &str = "hal.force_torque";
    /// Input lines.
    pub const DIGITAL_IN: &str = "hal.digital_in";
    /// Output lines.
    pub const DIGITAL_OUT: &str = "hal.digital_out";
    /// Phases of the jobs by a board's clock.
    pub const BOARD_CLOCK: &str = "hal.board_clock";
    /// Reports of drives that close a loop.
    pub const DRIVE_IN: &str = "hal.drive_in";
    /// Words to drives that close a loop.
    pub const DRIVE_OUT: &str = "hal.drive_out";
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
    fn recording<const N: usize>(half: Box<dyn Encoders>, ports: &mut Ports) -> Box<dyn Encoders> {
        let index = half.has_index().then(|| ports.tape::<IndexEntry<N>>(name::INDEX));
        let recording_half = recording_half::<_, EncoderEntry<N>>(half, name::ENCODERS, ports);
        Box::new(RecordingEncoders { recording_half, index })
    }
    if half.joints() <= NARROW_CHANNELS {
        recording::<NARROW_CHANNELS>(half, ports)
    } else {
        recording::<CHANNELS>(half, ports)
    }
}

/// Recording D/A converters.
#[must_use]
pub fn analog_out(half: Box<dyn AnalogOut>, ports: &mut Ports) -> Box<dyn AnalogOut> {
    if half.channels() <= NARROW_CHANNELS {
        Box::new(recording_half::<_, AnalogWord>(half, name::ANALOG_OUT, ports))
    } else {
        Box::new(recording_half::<_, AnalogWord<CHANNELS>>(half, name::ANALOG_OUT, ports))
    }
}

/// Recording A/D converters.
#[must_use]
pub fn analog_in(half: Box<dyn AnalogIn>, ports: &mut Ports) -> Box<dyn AnalogIn> {
    if half.channels() <= NARROW_CHANNELS {
        Box::new(recording_half::<_, AnalogEntry>(half, name::ANALOG_IN, ports))
    } else {
        Box::new(recording_half::<_, AnalogEntry<CHANNELS>>(half, name::ANALOG_IN, ports))
    }
}

/// A recording tactile array, of this name in [`taktil_hal::Devices::tactile`].
#[must_use]
pub fn tactile(
    half: Box<dyn TactileArray>,
    array: &str,
    ports: &mut Ports,
) -> Box<dyn TactileArray> {
    let entry = TactileEntry::new(half.rows(), half.cols());
    let tape = ports.array_tape(&name::tactile(array), &entry);
    Box::new(RecordingArray { half, tape, entry })
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
struct RecordingEncoders<const N: usize> {
    recording_half: RecordingHalf<dyn Encoders, EncoderEntry<N>>,
    index: Option<Tape<IndexEntry<N>>>,
}

impl<const N: usize> Encoders for RecordingEncoders<N> {
    fn longest_wait(&self) -> Nanos {
        self.recording_half.half.longest_wait()
    }

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

impl<const N: usize> AnalogOut for RecordingHalf<dyn AnalogOut, AnalogWord<N>> {
    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

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

impl<const N: usize> AnalogIn for RecordingHalf<dyn AnalogIn, AnalogEntry<N>> {
    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

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

/// A tactile array that records its frames.
struct RecordingArray {
    half: Box<dyn TactileArray>,
    tape: ArrayTape<TactileEntry>,
    /// The entry of the newest answer.
    entry: TactileEntry,
}

impl TactileArray for RecordingArray {
    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

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
        self.entry.set(frame, &answer);
        self.tape.append(release, &self.entry);
        answer
    }
}

impl ForceTorque for RecordingHalf<dyn ForceTorque, AnalogEntry> {
    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<GaugeCodes>, Error> {
        let answer = self.half.sample(release);
        self.tape.append(release, AnalogEntry::of_gauges(&answer));
        answer
    }
}

impl DigitalIn for RecordingHalf<dyn DigitalIn, DigitalEntry> {
    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        let answer = self.half.sample(release);
        self.tape.append(release, DigitalEntry::of(&answer));
        answer
    }
}

impl DigitalOut for RecordingHalf<dyn DigitalOut, DigitalWord> {
    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

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
