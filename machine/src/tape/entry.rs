//! The entries of a tape: converts the answer of a device half to a payload and back. The device's
//! name is not recorded, because a player gives its own.

use taktil_hal::{
    AdcCode, Arrival, CHANNELS, Counts, DacCode, Error, ErrorKind, IndexPulses, LinesIn, LinesOut,
    MAX_ROWS, Nanos, Reading, TactileFrame,
};
use taktil_rtcore::payload;

/// An answer without its value: 0 for success, otherwise the kind of error from 1, and its channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// 0 well, 1 transient, 2 stale, 3 out of range, 4 lost.
    pub code: u16,
    /// Channel of the error; 0 when well.
    pub channel: u16,
}

const ERROR_KINDS: [ErrorKind; 4] =
    [ErrorKind::Transient, ErrorKind::Stale, ErrorKind::OutOfRange, ErrorKind::Lost];

impl Outcome {
    fn of<T>(answer: &Result<T, Error>) -> Outcome {
        match answer {
            Ok(_) => Outcome { code: 0, channel: 0 },
            Err(error) => {
                let code = match error.kind {
                    ErrorKind::Transient => 1,
                    ErrorKind::Stale => 2,
                    ErrorKind::OutOfRange => 3,
                    ErrorKind::Lost => 4,
                };
                Outcome { code, channel: error.channel }
            }
        }
    }

    /// The recorded answer of `device`; an unknown code stands for a lost device.
    ///
    /// # Errors
    /// The recorded one.
    pub fn answer(self, device: &'static str) -> Result<(), Error> {
        let Outcome { code, channel } = self;
        match usize::from(code).checked_sub(1) {
            None => Ok(()),
            Some(index) => {
                let kind = ERROR_KINDS.get(index).copied().unwrap_or(ErrorKind::Lost);
                Err(Error::on_channel(kind, device, channel))
            }
        }
    }
}

payload! {
    /// An answer of the encoders.
    pub struct EncoderEntry {
        /// When the counts were latched.
        pub acquired_ns: i64,
        /// Counts of each channel.
        pub counts: [i32; 8],
        /// [`Outcome::code`].
        pub outcome: u16,
        /// [`Outcome::channel`].
        pub channel: u16,
    }
}

payload! {
    /// The index pulses that belong to an answer of the encoders.
    pub struct IndexEntry {
        /// Counts at the newest pulse of each channel, 0 where none has come.
        pub counts: [i32; 8],
        /// 1 where one has come.
        pub seen: [u8; 8],
    }
}

payload! {
    /// An answer of A/D converters or of a force/torque sensor, whose channels are its gauges.
    pub struct AnalogEntry {
        /// When the codes were converted.
        pub acquired_ns: i64,
        /// Codes of each channel.
        pub codes: [i32; 8],
        /// [`Outcome::code`].
        pub outcome: u16,
        /// [`Outcome::channel`].
        pub channel: u16,
    }
}

payload! {
    /// An answer of the input lines; 1 is true.
    pub struct DigitalEntry {
        /// When the lines were read.
        pub acquired_ns: i64,
        /// Drive power is present.
        pub drive_power: u8,
        /// Channel A of the emergency stop is closed.
        pub estop_a_closed: u8,
        /// Channel B.
        pub estop_b_closed: u8,
        /// [`Outcome::code`].
        pub outcome: u16,
        /// [`Outcome::channel`].
        pub channel: u16,
    }
}

payload! {
    /// An answer of the tactile array; all zero but for the outcome when no new frame came.
    pub struct TactileEntry {
        /// When the last row was read.
        pub acquired_ns: i64,
        /// When each row was read.
        pub row_acquired_ns: [i64; 16],
        /// Number of the scan.
        pub sequence: u32,
        /// 1 when a new frame came, 0 when the one before is still the newest.
        pub new: u16,
        /// Rows in use.
        pub rows: u16,
        /// Columns in use.
        pub cols: u16,
        /// [`Outcome::code`].
        pub outcome: u16,
        /// [`Outcome::channel`].
        pub channel: u16,
        /// Raw counts, row by row.
        pub values: [u16; 256],
        /// 1 where the device vouches for the tactel.
        pub valid: [u8; 256],
    }
}

payload! {
    /// A word to the D/A converters, and their answer.
    pub struct AnalogWord {
        /// Code of each channel.
        pub codes: [i32; 8],
        /// [`Outcome::code`].
        pub outcome: u16,
        /// [`Outcome::channel`].
        pub channel: u16,
    }
}

payload! {
    /// A word to the output lines, and their answer; 1 is true.
    pub struct DigitalWord {
        /// The drives may put current into the motors.
        pub enable: u8,
        /// The brakes are lifted.
        pub brake_release: u8,
        /// The line whose changes are signs of life.
        pub watchdog_feed: u8,
        /// [`Outcome::code`].
        pub outcome: u16,
        /// [`Outcome::channel`].
        pub channel: u16,
    }
}

impl EncoderEntry {
    /// The entry for an answer.
    #[must_use]
    pub fn of(answer: &Result<Reading<[Counts; CHANNELS]>, Error>) -> EncoderEntry {
        let Outcome { code: outcome, channel } = Outcome::of(answer);
        let reading = answer.unwrap_or_default();
        let (acquired_ns, counts) = (reading.acquired.0, reading.value.map(|Counts(count)| count));
        EncoderEntry { acquired_ns, counts, outcome, channel }
    }

    /// The recorded answer.
    ///
    /// # Errors
    /// The recorded one.
    pub fn answer(&self, device: &'static str) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        Outcome { code: self.outcome, channel: self.channel }.answer(device)?;
        Ok(Reading { value: self.counts.map(Counts), acquired: Nanos(self.acquired_ns) })
    }
}

impl IndexEntry {
    /// The entry for these index pulses.
    #[must_use]
    pub fn of(marks: &IndexPulses) -> IndexEntry {
        let counts = marks.map(|mark| mark.map_or(0, |Counts(count)| count));
        IndexEntry { counts, seen: marks.map(|mark| u8::from(mark.is_some())) }
    }

    /// The recorded index pulses.
    #[must_use]
    pub fn index_pulses(&self) -> IndexPulses {
        core::array::from_fn(|i| (self.seen[i] == 1).then(|| Counts(self.counts[i])))
    }
}

impl AnalogEntry {
    /// The entry for an answer with `N` channels.
    #[must_use]
    pub fn of<const N: usize>(answer: &Result<Reading<[AdcCode; N]>, Error>) -> AnalogEntry {
        let Outcome { code: outcome, channel } = Outcome::of(answer);
        let mut entry = AnalogEntry { outcome, channel, ..AnalogEntry::default() };
        if let Ok(reading) = answer {
            entry.acquired_ns = reading.acquired.0;
            for (code, AdcCode(read)) in entry.codes.iter_mut().zip(reading.value) {
                *code = read;
            }
        }
        entry
    }

    /// The recorded answer.
    ///
    /// # Errors
    /// The recorded one.
    pub fn answer<const N: usize>(
        &self,
        device: &'static str,
    ) -> Result<Reading<[AdcCode; N]>, Error> {
        Outcome { code: self.outcome, channel: self.channel }.answer(device)?;
        let mut value = [AdcCode::default(); N];
        for (to, code) in value.iter_mut().zip(self.codes) {
            *to = AdcCode(code);
        }
        Ok(Reading { value, acquired: Nanos(self.acquired_ns) })
    }
}

impl DigitalEntry {
    /// The entry for an answer.
    #[must_use]
    pub fn of(answer: &Result<Reading<LinesIn>, Error>) -> DigitalEntry {
        let Outcome { code: outcome, channel } = Outcome::of(answer);
        let reading = answer.unwrap_or_default();
        DigitalEntry {
            acquired_ns: reading.acquired.0,
            drive_power: u8::from(reading.value.drive_power),
            estop_a_closed: u8::from(reading.value.estop_a_closed),
            estop_b_closed: u8::from(reading.value.estop_b_closed),
            outcome,
            channel,
        }
    }

    /// The recorded answer.
    ///
    /// # Errors
    /// The recorded one.
    pub fn answer(&self, device: &'static str) -> Result<Reading<LinesIn>, Error> {
        Outcome { code: self.outcome, channel: self.channel }.answer(device)?;
        let value = LinesIn {
            drive_power: self.drive_power == 1,
            estop_a_closed: self.estop_a_closed == 1,
            estop_b_closed: self.estop_b_closed == 1,
        };
        Ok(Reading { value, acquired: Nanos(self.acquired_ns) })
    }
}

impl TactileEntry {
    /// The entry for an answer of the device that was given `frame`.
    #[must_use]
    pub fn of(frame: &TactileFrame, answer: &Result<Arrival, Error>) -> TactileEntry {
        let Outcome { code: outcome, channel } = Outcome::of(answer);
        let mut entry = TactileEntry { outcome, channel, ..TactileEntry::default() };
        if *answer == Ok(Arrival::New) {
            entry.acquired_ns = frame.acquired.0;
            entry.row_acquired_ns = frame.row_acquired.map(|Nanos(at)| at);
            entry.sequence = frame.sequence;
            (entry.new, entry.rows, entry.cols) = (1, frame.rows, frame.cols);
            entry.values = frame.values;
            entry.valid = frame.valid.map(u8::from);
        }
        entry
    }

    /// The recorded answer; a new frame is copied to `frame`.
    ///
    /// # Errors
    /// The recorded one.
    pub fn answer(&self, device: &'static str, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        Outcome { code: self.outcome, channel: self.channel }.answer(device)?;
        if self.new == 0 {
            return Ok(Arrival::Held);
        }
        let mut row_acquired = [Nanos::ZERO; MAX_ROWS];
        for (row, at) in row_acquired.iter_mut().zip(self.row_acquired_ns) {
            *row = Nanos(at);
        }
        *frame = TactileFrame {
            rows: self.rows,
            cols: self.cols,
            sequence: self.sequence,
            acquired: Nanos(self.acquired_ns),
            values: self.values,
            valid: self.valid.map(|valid| valid == 1),
            row_acquired,
        };
        Ok(Arrival::New)
    }
}

impl AnalogWord {
    /// The entry for codes and their answer.
    #[must_use]
    pub fn of(codes: &[DacCode; CHANNELS], answer: &Result<(), Error>) -> AnalogWord {
        let Outcome { code: outcome, channel } = Outcome::of(answer);
        AnalogWord { codes: codes.map(|DacCode(code)| code), outcome, channel }
    }

    /// The recorded answer.
    #[must_use]
    pub fn outcome(&self) -> Outcome {
        Outcome { code: self.outcome, channel: self.channel }
    }
}

impl DigitalWord {
    /// The entry for lines and their answer.
    #[must_use]
    pub fn of(lines: &LinesOut, answer: &Result<(), Error>) -> DigitalWord {
        let Outcome { code: outcome, channel } = Outcome::of(answer);
        DigitalWord {
            enable: u8::from(lines.enable),
            brake_release: u8::from(lines.brake_release),
            watchdog_feed: u8::from(lines.watchdog_feed),
            outcome,
            channel,
        }
    }

    /// The recorded answer.
    #[must_use]
    pub fn outcome(&self) -> Outcome {
        Outcome { code: self.outcome, channel: self.channel }
    }
}
