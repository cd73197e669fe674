//! Device halves that are played from tapes. Input halves give the answer that was recorded for the
//! same release. Output halves accept any word and answer as the board did. When the tape has no
//! entry for a release, the device's name is noted and the device counts as lost.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use taktil_hal::{
    AdcCode, AnalogIn, AnalogOut, Arrival, CHANNELS, Counts, DacCode, Devices, DigitalIn,
    DigitalOut, DriveLoop, Encoders, Error, ErrorKind, ForceTorque, GaugeCodes, IndexPulses,
    LinesIn, LinesOut, Nanos, Reading, TACTILE, TACTILE_OPPOSED, TactileArray, TactileFrame,
};
use taktil_rtcore::FromRecord;
use taktil_rtcore::payload::Field;

use super::clock::{BoardClockPlayer, ClockEntry};
use super::drives::{DriveEntry, DriveInPlayer, DriveOutPlayer, DriveWord};
use super::entry::{
    AnalogEntry, AnalogWord, DigitalEntry, DigitalWord, EncoderEntry, IndexEntry, NARROW_CHANNELS,
    TactileEntry,
};
use super::name;
pub use super::playback::MissingEntry;
use super::playback::{Entries, Player, player};
use crate::strict;

/// Rows, columns and full scale of a tactile array.
type ArrayDescription = (usize, usize, u16);

/// The constant properties of the devices, which are in a log's metadata. What describes a half
/// that the machine does not have is absent.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DeviceDescription {
    #[serde(skip_serializing_if = "Option::is_none")]
    joints: Option<usize>,
    /// The field may be absent in logs of boards without index pulses.
    #[serde(skip_serializing_if = "core::ops::Not::not")]
    index: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    analog_out_channels: Option<usize>,
    analog_out_codes: (i32, i32),
    analog_out_safe: i32,
    analog_out_silence_ns: i64,
    #[serde(skip_serializing_if = "Option::is_none")]
    analog_in_channels: Option<usize>,
    analog_in_codes: (i32, i32),
    #[serde(skip_serializing_if = "Option::is_none")]
    tactile_rows: Option<usize>,
    tactile_cols: usize,
    tactile_full_scale: u16,
    #[serde(skip_serializing_if = "Option::is_none")]
    digital_out_silence_ns: Option<i64>,
    /// The array on the opposed fingertip, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    tactile_opposed: Option<ArrayDescription>,
    /// True where there is no force/torque sensor.
    #[serde(skip_serializing_if = "core::ops::Not::not")]
    without_force_torque: bool,
    /// True where there are no input lines.
    #[serde(skip_serializing_if = "core::ops::Not::not")]
    without_digital_in: bool,
    /// What describes drives that close a loop; absent where there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    drive_in_channels: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    drive_out_channels: Option<usize>,
    #[serde(skip_serializing_if = "String::is_empty")]
    drive_out_loop: String,
    #[serde(skip_serializing_if = "is_zero")]
    drive_out_targets: (i32, i32),
    #[serde(skip_serializing_if = "is_zero")]
    drive_out_silence_ns: i64,
    /// The cycle of a board's clock; absent where the machine has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    board_clock_cycle_ns: Option<i64>,
    /// Further tactile arrays.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    arrays: BTreeMap<String, ArrayDescription>,
}

/// Whether a number is absent, or a pair of them.
fn is_zero<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

impl DeviceDescription {
    /// Reads the description from devices.
    #[must_use]
    pub fn from_devices(devices: &Devices) -> DeviceDescription {
        let of = |array: &dyn TactileArray| (array.rows(), array.cols(), array.full_scale());
        let mut arrays: BTreeMap<String, ArrayDescription> = devices
            .tactile
            .iter()
            .map(|(name, array)| (name.clone(), of(array.as_ref())))
            .collect();
        let fingertip = arrays.remove(TACTILE);
        let mut description = DeviceDescription {
            joints: devices.encoders.as_ref().map(|half| half.joints()),
            index: devices.encoders.as_ref().is_some_and(|half| half.has_index()),
            tactile_rows: fingertip.map(|(rows, ..)| rows),
            tactile_cols: fingertip.map_or(0, |(_, cols, _)| cols),
            tactile_full_scale: fingertip.map_or(0, |(.., full)| full),
            digital_out_silence_ns: devices
                .digital_out
                .as_ref()
                .map(|half| half.longest_silence().0),
            tactile_opposed: arrays.remove(TACTILE_OPPOSED),
            without_force_torque: devices.force_torque.is_none(),
            without_digital_in: devices.digital_in.is_none(),
            arrays,
            board_clock_cycle_ns: devices.board_clock.as_ref().map(|half| half.cycle().0),
            ..DeviceDescription::default()
        };
        if let Some(half) = &devices.analog_out {
            let (DacCode(low), DacCode(high)) = half.code_range();
            description.analog_out_channels = Some(half.channels());
            description.analog_out_codes = (low, high);
            description.analog_out_safe = half.safe_value().0;
            description.analog_out_silence_ns = half.longest_silence().0;
        }
        description.drive_in_channels = devices.drive_in.as_ref().map(|half| half.channels());
        if let Some(half) = &devices.drive_out {
            description.drive_out_channels = Some(half.channels());
            description.drive_out_loop = half.control_loop().name().to_owned();
            description.drive_out_targets = half.target_range();
            description.drive_out_silence_ns = half.longest_silence().0;
        }
        if let Some(half) = &devices.analog_in {
            let (AdcCode(least), AdcCode(most)) = half.code_range();
            description.analog_in_channels = Some(half.channels());
            description.analog_in_codes = (least, most);
        }
        description
    }

    /// All tactile arrays by name.
    fn tactile(&self) -> BTreeMap<String, ArrayDescription> {
        let mut all = self.arrays.clone();
        let fingertip =
            self.tactile_rows.map(|rows| (rows, self.tactile_cols, self.tactile_full_scale));
        all.extend(fingertip.map(|array| (TACTILE.to_owned(), array)));
        all.extend(self.tactile_opposed.map(|array| (TACTILE_OPPOSED.to_owned(), array)));
        all
    }

    /// The description as text for a log.
    #[must_use]
    pub fn text(&self) -> String {
        toml::to_string(self).unwrap_or_default()
    }

    /// Reads the description from the text of a log.
    ///
    /// # Errors
    /// What is wrong with the text.
    pub fn parse(text: &str) -> Result<DeviceDescription, String> {
        let description: DeviceDescription =
            strict::read_text(text).map_err(|error| error.message().to_owned())?;
        match (description.drive_out_channels, description.drive_loop()) {
            (Some(_), None) => Err(format!("no loop is called `{}`", description.drive_out_loop)),
            _ => Ok(description),
        }
    }

    /// The loop that the drives close; nothing without drives.
    fn drive_loop(&self) -> Option<DriveLoop> {
        DriveLoop::ALL.into_iter().find(|one| one.name() == self.drive_out_loop)
    }
}

/// The tapes of a run.
#[derive(Clone, Debug, Default)]
pub struct Tapes {
    encoders: Entries<EncoderEntry<CHANNELS>>,
    index: Entries<IndexEntry<CHANNELS>>,
    analog_out: Entries<AnalogWord<CHANNELS>>,
    analog_in: Entries<AnalogEntry<CHANNELS>>,
    tactile: BTreeMap<String, Entries<TactileEntry>>,
    force_torque: Entries<AnalogEntry>,
    digital_in: Entries<DigitalEntry>,
    digital_out: Entries<DigitalWord>,
    drive_in: Entries<DriveEntry<CHANNELS>>,
    drive_out: Entries<DriveWord<CHANNELS>>,
    board_clock: Entries<ClockEntry>,
}

/// A record on a tape.
struct TapeRecord<'a> {
    fields: &'a [Field],
    release: Nanos,
    body: &'a [u8],
}

impl TapeRecord<'_> {
    /// Appends the entry; false when the body is not one.
    fn append<E: FromRecord>(&self, entries: &mut Entries<E>) -> bool {
        self.append_as(entries, |entry: E| entry)
    }

    /// As [`TapeRecord::append`], with another width than that of the record.
    fn append_as<F: FromRecord, E>(&self, entries: &mut Entries<E>, to: impl Fn(F) -> E) -> bool {
        let entry = F::from_record(self.fields, self.body);
        let found = entry.is_some();
        entries.extend(entry.map(|entry| (self.release, to(entry))));
        found
    }
}

impl Tapes {
    /// Appends a record, written with these fields, to the tape of this name; false when the body
    /// is not one of its entries. Other signals are let pass.
    pub fn append(&mut self, signal: &str, fields: &[Field], release: Nanos, body: &[u8]) -> bool {
        let record = TapeRecord { fields, release, body };
        match signal {
            name::ENCODERS => {
                record.append_as(&mut self.encoders, EncoderEntry::<NARROW_CHANNELS>::widened)
                    || record.append(&mut self.encoders)
            }
            name::INDEX => {
                record.append_as(&mut self.index, IndexEntry::<NARROW_CHANNELS>::widened)
                    || record.append(&mut self.index)
            }
            name::ANALOG_OUT => {
                record.append_as(&mut self.analog_out, AnalogWord::<NARROW_CHANNELS>::widened)
                    || record.append(&mut self.analog_out)
            }
            name::ANALOG_IN => {
                record.append_as(&mut self.analog_in, AnalogEntry::<NARROW_CHANNELS>::widened)
                    || record.append(&mut self.analog_in)
            }
            name::DRIVE_IN => {
                record.append_as(&mut self.drive_in, DriveEntry::<NARROW_CHANNELS>::widened)
                    || record.append(&mut self.drive_in)
            }
            name::DRIVE_OUT => {
                record.append_as(&mut self.drive_out, DriveWord::<NARROW_CHANNELS>::widened)
                    || record.append(&mut self.drive_out)
            }
            name::FORCE_TORQUE => record.append(&mut self.force_torque),
            name::BOARD_CLOCK => record.append(&mut self.board_clock),
            name::DIGITAL_IN => record.append(&mut self.digital_in),
            name::DIGITAL_OUT => record.append(&mut self.digital_out),
            other => match name::array_of(other) {
                Some(array) => record.append(self.tactile.entry(array.to_owned()).or_default()),
                None => true,
            },
        }
    }

    /// Devices that answer from these tapes, and the note of the first missing entry.
    #[must_use]
    pub fn devices(mut self, description: &DeviceDescription) -> (Devices, MissingEntry) {
        let missing = MissingEntry::default();
        let note = || missing.clone();
        let mut devices = Devices::default();
        if let Some(joints) = description.joints {
            devices.encoders = Some(Box::new(EncoderPlayer {
                counts: player(self.encoders, name::ENCODERS, note()),
                joints,
                index: description.index.then(|| player(self.index, name::INDEX, note())),
                marks: [None; CHANNELS],
            }));
        }
        if let Some(channels) = description.analog_out_channels {
            let player = player(self.analog_out, name::ANALOG_OUT, note());
            let description = description.clone();
            devices.analog_out = Some(Box::new(AnalogOutPlayer { player, channels, description }));
        }
        if let Some(channels) = description.analog_in_channels {
            let player = player(self.analog_in, name::ANALOG_IN, note());
            let codes = description.analog_in_codes;
            devices.analog_in = Some(Box::new(AnalogInPlayer { player, channels, codes }));
        }
        if let Some(channels) = description.drive_in_channels {
            let player = player(self.drive_in, name::DRIVE_IN, note());
            devices.drive_in = Some(Box::new(DriveInPlayer { player, channels }));
        }
        if let Some(channels) = description.drive_out_channels {
            let player = player(self.drive_out, name::DRIVE_OUT, note());
            devices.drive_out = Some(Box::new(DriveOutPlayer {
                player,
                channels,
                control_loop: description.drive_loop().unwrap_or_default(),
                targets: description.drive_out_targets,
                silence: Nanos(description.drive_out_silence_ns),
            }));
        }
        for (array, description) in description.tactile() {
            let entries = self.tactile.remove(&array).unwrap_or_default();
            let opposed = array == TACTILE_OPPOSED;
            let device = if opposed { "hal.tactile_opposed" } else { "hal.tactile" };
            let player = ArrayPlayer { player: player(entries, device, note()), description };
            devices.tactile.insert(array, Box::new(player));
        }
        if !description.without_force_torque {
            let player = player(self.force_torque, name::FORCE_TORQUE, note());
            devices.force_torque = Some(Box::new(player));
        }
        if let Some(cycle_ns) = description.board_clock_cycle_ns {
            let player = player(self.board_clock, name::BOARD_CLOCK, note());
            devices.board_clock =
                Some(Box::new(BoardClockPlayer { player, cycle: Nanos(cycle_ns) }));
        }
        if !description.without_digital_in {
            devices.digital_in = Some(Box::new(player(self.digital_in, name::DIGITAL_IN, note())));
        }
        if let Some(silence_ns) = description.digital_out_silence_ns {
            let player = player(self.digital_out, name::DIGITAL_OUT, note());
            devices.digital_out =
                Some(Box::new(DigitalOutPlayer { player, silence: Nanos(silence_ns) }));
        }
        (devices, missing)
    }
}

/// Encoders that read a tape.
struct EncoderPlayer {
    counts: Player<EncoderEntry<CHANNELS>>,
    joints: usize,
    index: Option<Player<IndexEntry<CHANNELS>>>,
    marks: IndexPulses,
}

impl Encoders for EncoderPlayer {
    fn joints(&self) -> usize {
        self.joints
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        if let Some(index) = &mut self.index {
            self.marks = index.next(release)?.index_pulses();
        }
        self.counts.next(release)?.answer(self.counts.device)
    }

    fn has_index(&self) -> bool {
        self.index.is_some()
    }

    fn index_pulses(&self) -> IndexPulses {
        self.marks
    }
}

/// D/A converters that read a tape.
struct AnalogOutPlayer {
    player: Player<AnalogWord<CHANNELS>>,
    channels: usize,
    description: DeviceDescription,
}

impl AnalogOut for AnalogOutPlayer {
    fn channels(&self) -> usize {
        self.channels
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        let (low, high) = self.description.analog_out_codes;
        (DacCode(low), DacCode(high))
    }

    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let entry = self.player.next(release)?;
        let (low, high) = self.code_range();
        let wired = codes.iter().take(self.channels);
        if let Some(channel) = wired.clone().position(|code| *code < low || *code > high) {
            let channel = u16::try_from(channel).unwrap_or(Error::ALL_CHANNELS);
            return Err(Error::on_channel(ErrorKind::OutOfRange, self.player.device, channel));
        }
        entry.outcome().answer(self.player.device)
    }

    fn safe(&mut self) -> Result<(), Error> {
        Ok(())
    }

    fn safe_value(&self) -> DacCode {
        DacCode(self.description.analog_out_safe)
    }

    fn longest_silence(&self) -> Nanos {
        Nanos(self.description.analog_out_silence_ns)
    }
}

/// A/D converters that read a tape.
struct AnalogInPlayer {
    player: Player<AnalogEntry<CHANNELS>>,
    channels: usize,
    codes: (i32, i32),
}

impl AnalogIn for AnalogInPlayer {
    fn channels(&self) -> usize {
        self.channels
    }

    fn code_range(&self) -> (AdcCode, AdcCode) {
        (AdcCode(self.codes.0), AdcCode(self.codes.1))
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
        self.player.next(release)?.answer(self.player.device)
    }
}

/// A tactile array that reads a tape.
struct ArrayPlayer {
    player: Player<TactileEntry>,
    description: ArrayDescription,
}

impl TactileArray for ArrayPlayer {
    fn rows(&self) -> usize {
        self.description.0
    }

    fn cols(&self) -> usize {
        self.description.1
    }

    fn full_scale(&self) -> u16 {
        self.description.2
    }

    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        if !frame.fits(self) {
            return Err(Error::whole(ErrorKind::OutOfRange, self.player.device));
        }
        self.player.next(release)?.answer(self.player.device, frame)
    }
}

impl ForceTorque for Player<AnalogEntry> {
    fn sample(&mut self, release: Nanos) -> Result<Reading<GaugeCodes>, Error> {
        self.next(release)?.gauges(self.device)
    }
}

impl DigitalIn for Player<DigitalEntry> {
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        self.next(release)?.answer(self.device)
    }
}

/// Output lines that read a tape.
struct DigitalOutPlayer {
    player: Player<DigitalWord>,
    silence: Nanos,
}

impl DigitalOut for DigitalOutPlayer {
    fn commit(&mut self, release: Nanos, _lines: &LinesOut) -> Result<(), Error> {
        self.player.next(release)?.outcome().answer(self.player.device)
    }

    fn safe(&mut self) -> Result<(), Error> {
        Ok(())
    }

    fn longest_silence(&self) -> Nanos {
        self.silence
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drives_of_a_loop_that_there_is_not_are_refused() {
        let text = "drive_out_channels = 6\ndrive_out_loop = 'velocity'\n";
        assert_eq!(DeviceDescription::parse(text).unwrap().drive_loop(), Some(DriveLoop::Velocity));
        let wrong = DeviceDescription::parse(&text.replace("velocity", "speed")).unwrap_err();
        assert!(wrong.contains("no loop is called `speed`"), "{wrong}");
        assert_eq!(DeviceDescription::parse("joints = 6").unwrap().drive_loop(), None);
    }
}
