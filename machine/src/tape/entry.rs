//! The entries of a tape: converts the answer of a device half to a payload and back. The device's
//! name is not recorded, because a player gives its own.

use taktil_hal::{
    AdcCode, Arrival, CHANNELS, Counts, DacCode, Error, ErrorKind, FORCE_TORQUE_CHANNELS,
    GaugeCodes, IndexPulses, LinesIn, LinesOut, Nanos, Reading, TactileFrame,
};
use taktil_rtcore::{array_payload, payload};

/// Channels of the entries of a half that has no more of them; the entries of a half with more are
/// as wide as a half can be.
pub const NARROW_CHANNELS: usize = 8;

/// The channel in which the entry of a force/torque sensor has one bit for each gauge that stood at
/// an end of its converter's range, the first gauge in bit 0. It was 0 before there was such a
/// flag.
pub const OVER_RANGE_CHANNEL: usize = FORCE_TORQUE_CHANNELS;

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
    pub(super) fn of<T>(answer: &Result<T, Error>) -> Outcome {
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
    pub struct EncoderEntry<const N: usize = 8> {
        /// When the counts were latched.
        pub acquired_ns: i64,
        /// Counts of each channel.
        pub counts: [i32; N],
        /// [`Outcome::code`].
        pub outcome: u16,
        /// [`Outcome::channel`].
        pub channel: u16,
    }
}

payload! {
    /// The index pulses that belong to an answer of the encoders.
    pub struct IndexEntry<const N: usize = 8> {
        /// Counts at the newest pulse of each channel, 0 where none has come.
        pub counts: [i32; N],
        /// 1 where one has come.
        pub seen: [u8; N],
    }
}

payload! {
    /// An answer of A/D converters or of a force/torque sensor, whose channels are its gauges; in
    /// [`OVER_RANGE_CHANNEL`], which no gauge has, then stands which of them were over range.
    pub struct AnalogEntry<const N: usize = 8> {
        /// When the codes were converted.
        pub acquired_ns: i64,
        /// Codes of each channel.
        pub codes: [i32; N],
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

array_payload! {
    /// An answer of the tactile array; all zero but for the outcome when no new frame came.
    pub struct TactileEntry {
        /// When the last row was read.
        pub acquired_ns: i64,
        /// When each row was read.
        pub row_acquired_ns: Box<[i64]>,
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
        pub values: Box<[u16]>,
        /// 1 where the device vouches for the tactel.
        pub valid: Box<[u8]>,
    }
    usual [16, 256, 256]
}

payload! {
    /// A word to the D/A converters, and their answer.
    pub struct AnalogWord<const N: usize = 8> {
        /// Code of each channel.
        pub codes: [i32; N],
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

/// The first `N` of `all`.
pub(super) fn first<const N: usize, T: Copy + Default>(all: &[T; CHANNELS]) -> [T; N] {
    const { assert!(N <= CHANNELS, "an entry has no more channels than a half") };
    core::array::from_fn(|i| all[i])
}

/// All channels of a half, of which `some` are known.
pub(super) fn widened<const N: usize, T: Copy + Default>(some: &[T; N]) -> [T; CHANNELS] {
    core::array::from_fn(|i| some.get(i).copied().unwrap_or_default())
}

impl<const N: usize> EncoderEntry<N> {
    /// The same entry with all channels that a half can have.
    #[must_use]
    pub fn widened(self) -> EncoderEntry<CHANNELS> {
        let EncoderEntry { acquired_ns, counts, outcome, channel } = self;
        EncoderEntry { acquired_ns, counts: widened(&counts), outcome, channel }
    }

    /// The entry for an answer.
    #[must_use]
    pub fn of(answer: &Result<Reading<[Counts; CHANNELS]>, Error>) -> EncoderEntry<N> {
        let Outcome { code: outcome, channel } = Outcome::of(answer);
        let (acquired_ns, counts) = match answer {
            Ok(reading) => (reading.acquired.0, first::<N, _>(&reading.value)),
            Err(_) => (0, [Counts::default(); N]),
        };
        EncoderEntry { acquired_ns, counts: counts.map(|Counts(count)| count), outcome, channel }
    }

    /// The recorded answer.
    ///
    /// # Errors
    /// The recorded one.
    pub fn answer(&self, device: &'static str) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        Outcome { code: self.outcome, channel: self.channel }.answer(device)?;
        let value = widened(&self.counts.map(Counts));
        Ok(Reading { value, acquired: Nanos(self.acquired_ns) })
    }
}

impl<const N: usize> IndexEntry<N> {
    /// The same entry with all channels that a half can have.
    #[must_use]
    pub fn widened(self) -> IndexEntry<CHANNELS> {
        IndexEntry { counts: widened(&self.counts), seen: widened(&self.seen) }
    }

    /// The entry for these index pulses.
    #[must_use]
    pub fn of(marks: &IndexPulses) -> IndexEntry<N> {
        let marks = first::<N, _>(marks);
        let counts = marks.map(|mark| mark.map_or(0, |Counts(count)| count));
        IndexEntry { counts, seen: marks.map(|mark| u8::from(mark.is_some())) }
    }

    /// The recorded index pulses.
    #[must_use]
    pub fn index_pulses(&self) -> IndexPulses {
        widened::<N, _>(&core::array::from_fn(|i| {
            (self.seen[i] == 1).then(|| Counts(self.counts[i]))
        }))
    }
}

impl<const N: usize> AnalogEntry<N> {
    /// The same entry with all channels that a half can have.
    #[must_use]
    pub fn widened(self) -> AnalogEntry<CHANNELS> {
        let AnalogEntry { acquired_ns, codes, outcome, channel } = self;
        AnalogEntry { acquired_ns, codes: widened(&codes), outcome, channel }
    }

    /// The entry for an answer with `M` channels.
    #[must_use]
    pub fn of<const M: usize>(answer: &Result<Reading<[AdcCode; M]>, Error>) -> AnalogEntry<N> {
        let Outcome { code: outcome, channel } = Outcome::of(answer);
        let mut entry = AnalogEntry { outcome, channel, ..AnalogEntry::default() };
        if let Ok(reading) = answer {
            entry.acquired_ns = reading.acquired.0;
            for (code, AdcCode(read)) in entry.codes.iter_mut().zip(&reading.value) {
                *code = *read;
            }
        }
        entry
    }

    /// The recorded answer.
    ///
    /// # Errors
    /// The recorded one.
    pub fn answer<const M: usize>(
        &self,
        device: &'static str,
    ) -> Result<Reading<[AdcCode; M]>, Error> {
        Outcome { code: self.outcome, channel: self.channel }.answer(device)?;
        let mut value = [AdcCode::default(); M];
        for (to, code) in value.iter_mut().zip(self.codes) {
            *to = AdcCode(code);
        }
        Ok(Reading { value, acquired: Nanos(self.acquired_ns) })
    }
}

impl AnalogEntry {
    /// The entry for an answer of a force/torque sensor.
    #[must_use]
    pub fn of_gauges(answer: &Result<Reading<GaugeCodes>, Error>) -> AnalogEntry {
        let codes =
            answer.map(|Reading { value, acquired }| Reading { value: value.codes, acquired });
        let mut entry = AnalogEntry::of(&codes);
        if let Ok(Reading { value, .. }) = answer {
            for (gauge, over) in value.over_range.into_iter().enumerate() {
                entry.codes[OVER_RANGE_CHANNEL] |= i32::from(over) << gauge;
            }
        }
        entry
    }

    /// The recorded answer of a force/torque sensor.
    ///
    /// # Errors
    /// The recorded one.
    pub fn gauges(&self, device: &'static str) -> Result<Reading<GaugeCodes>, Error> {
        let Reading { value: codes, acquired } = self.answer(device)?;
        let bits = self.codes[OVER_RANGE_CHANNEL];
        let over_range = core::array::from_fn(|gauge| bits >> gauge & 1 == 1);
        Ok(Reading { value: GaugeCodes { codes, over_range }, acquired })
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
    /// An entry for an array of these many rows and columns; allocates.
    #[must_use]
    pub fn new(rows: usize, cols: usize) -> TactileEntry {
        TactileEntry {
            acquired_ns: 0,
            row_acquired_ns: vec![0; rows].into(),
            sequence: 0,
            new: 0,
            rows: 0,
            cols: 0,
            outcome: 0,
            channel: 0,
            values: vec![0; rows * cols].into(),
            valid: vec![0; rows * cols].into(),
        }
    }

    /// Takes the answer of the device that was given `frame`.
    pub fn set(&mut self, frame: &TactileFrame, answer: &Result<Arrival, Error>) {
        let Outcome { code, channel } = Outcome::of(answer);
        (self.outcome, self.channel) = (code, channel);
        if *answer == Ok(Arrival::New) {
            self.acquired_ns = frame.acquired.0;
            for (at, Nanos(row)) in self.row_acquired_ns.iter_mut().zip(&frame.row_acquired) {
                *at = *row;
            }
            self.sequence = frame.sequence;
            (self.new, self.rows, self.cols) = (1, frame.rows(), frame.cols());
            for (to, from) in self.values.iter_mut().zip(&frame.values) {
                *to = *from;
            }
            for (to, from) in self.valid.iter_mut().zip(&frame.valid) {
                *to = u8::from(*from);
            }
            return;
        }
        (self.acquired_ns, self.sequence, self.new, self.rows, self.cols) = (0, 0, 0, 0, 0);
        self.row_acquired_ns.fill(0);
        self.values.fill(0);
        self.valid.fill(0);
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
        frame.sequence = self.sequence;
        frame.acquired = Nanos(self.acquired_ns);
        for (row, at) in frame.row_acquired.iter_mut().zip(&self.row_acquired_ns) {
            *row = Nanos(*at);
        }
        for (to, from) in frame.values.iter_mut().zip(&self.values) {
            *to = *from;
        }
        for (to, from) in frame.valid.iter_mut().zip(&self.valid) {
            *to = *from == 1;
        }
        Ok(Arrival::New)
    }
}

impl<const N: usize> AnalogWord<N> {
    /// The same entry with all channels that a half can have.
    #[must_use]
    pub fn widened(self) -> AnalogWord<CHANNELS> {
        let AnalogWord { codes, outcome, channel } = self;
        AnalogWord { codes: widened(&codes), outcome, channel }
    }

    /// The entry for codes and their answer.
    #[must_use]
    pub fn of(codes: &[DacCode; CHANNELS], answer: &Result<(), Error>) -> AnalogWord<N> {
        let Outcome { code: outcome, channel } = Outcome::of(answer);
        let codes = first::<N, _>(codes).map(|DacCode(code)| code);
        AnalogWord { codes, outcome, channel }
    }

    /// The recorded codes, 0 for channels that were not recorded.
    #[must_use]
    pub fn codes(&self) -> [DacCode; CHANNELS] {
        widened(&self.codes.map(DacCode))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gauges_come_back_with_their_flags_and_old_entries_have_none() {
        let codes = [-2_048, 1, 2, 3, 4, 2_047].map(AdcCode);
        let value = GaugeCodes::within(AdcCode(-2_048), AdcCode(2_047), codes);
        let answer = Ok(Reading { value, acquired: Nanos(7) });
        let entry = AnalogEntry::of_gauges(&answer);
        assert_eq!(entry.gauges("board"), answer);
        assert_eq!(entry.codes[OVER_RANGE_CHANNEL], 0b10_0001);
        // As it was recorded before the flags.
        let plain: Result<Reading<[AdcCode; FORCE_TORQUE_CHANNELS]>, Error> =
            Ok(Reading { value: codes, acquired: Nanos(7) });
        let read = AnalogEntry::<NARROW_CHANNELS>::of(&plain).gauges("board").unwrap();
        assert_eq!((read.value.codes, read.value.is_within_range()), (codes, true));
        let lost = Err(Error::on_channel(ErrorKind::Lost, "board", 3));
        assert_eq!(AnalogEntry::of_gauges(&lost).gauges("board"), lost);
    }
}
