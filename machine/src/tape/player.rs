//! Device halves that are played from tapes. Input halves give the answer that was recorded for the
//! same release. Output halves accept any word and answer as the board did. When the tape has no
//! entry for a release, the device's name is noted and the device counts as lost.

use std::collections::VecDeque;
use std::sync::{Arc, OnceLock};

use serde::{Deserialize, Serialize};
use taktil_hal::{
    AdcCode, AnalogIn, AnalogOut, Arrival, CHANNELS, Counts, DacCode, Devices, DigitalIn,
    DigitalOut, Encoders, Error, ErrorKind, FORCE_TORQUE_CHANNELS, ForceTorque, IndexPulses,
    LinesIn, LinesOut, Nanos, Reading, TactileArray, TactileFrame,
};
use taktil_rtcore::Payload;

use super::entry::{
    AnalogEntry, AnalogWord, DigitalEntry, DigitalWord, EncoderEntry, IndexEntry, TactileEntry,
};
use super::name;

/// The constant properties of the devices, which are in a log's metadata.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeviceDescription {
    joints: usize,
    /// The field may be absent in logs of boards without index pulses.
    #[serde(default, skip_serializing_if = "core::ops::Not::not")]
    index: bool,
    analog_out_channels: usize,
    analog_out_codes: (i32, i32),
    analog_out_safe: i32,
    analog_out_silence_ns: i64,
    analog_in_channels: usize,
    analog_in_codes: (i32, i32),
    tactile_rows: usize,
    tactile_cols: usize,
    tactile_full_scale: u16,
    digital_out_silence_ns: i64,
    /// Rows, columns and full scale of the array on the opposed fingertip, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    tactile_opposed: Option<(usize, usize, u16)>,
}

impl DeviceDescription {
    /// Reads the description from devices.
    #[must_use]
    pub fn from_devices(devices: &Devices) -> DeviceDescription {
        let (DacCode(low), DacCode(high)) = devices.analog_out.code_range();
        let (AdcCode(least), AdcCode(most)) = devices.analog_in.code_range();
        DeviceDescription {
            joints: devices.encoders.joints(),
            index: devices.encoders.has_index(),
            analog_out_channels: devices.analog_out.channels(),
            analog_out_codes: (low, high),
            analog_out_safe: devices.analog_out.safe_value().0,
            analog_out_silence_ns: devices.analog_out.longest_silence().0,
            analog_in_channels: devices.analog_in.channels(),
            analog_in_codes: (least, most),
            tactile_rows: devices.tactile.rows(),
            tactile_cols: devices.tactile.cols(),
            tactile_full_scale: devices.tactile.full_scale(),
            digital_out_silence_ns: devices.digital_out.longest_silence().0,
            tactile_opposed: devices
                .tactile_opposed
                .as_ref()
                .map(|array| (array.rows(), array.cols(), array.full_scale())),
        }
    }

    /// The description with the opposed fingertip's array in place of the finger's.
    fn opposed(&self) -> Option<DeviceDescription> {
        let (rows, cols, full) = self.tactile_opposed?;
        let (tactile_rows, tactile_cols, tactile_full_scale) = (rows, cols, full);
        Some(DeviceDescription { tactile_rows, tactile_cols, tactile_full_scale, ..self.clone() })
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
        toml::from_str(text).map_err(|error| error.message().to_owned())
    }
}

type Entries<E> = VecDeque<(Nanos, E)>;

/// The tapes of a run.
#[derive(Clone, Debug, Default)]
pub struct Tapes {
    encoders: Entries<EncoderEntry>,
    index: Entries<IndexEntry>,
    analog_out: Entries<AnalogWord>,
    analog_in: Entries<AnalogEntry>,
    tactile: Entries<TactileEntry>,
    tactile_opposed: Entries<TactileEntry>,
    force_torque: Entries<AnalogEntry>,
    digital_in: Entries<DigitalEntry>,
    digital_out: Entries<DigitalWord>,
}

fn append<E: Payload>(entries: &mut Entries<E>, release: Nanos, body: &[u8]) -> bool {
    let entry = E::decode(body);
    entries.extend(entry.map(|entry| (release, entry)));
    entry.is_some()
}

impl Tapes {
    /// Appends a record to the tape of this name; false when the body is not one of its entries.
    /// Other signals are let pass.
    pub fn append(&mut self, signal: &str, release: Nanos, body: &[u8]) -> bool {
        match signal {
            name::ENCODERS => append(&mut self.encoders, release, body),
            name::INDEX => append(&mut self.index, release, body),
            name::ANALOG_OUT => append(&mut self.analog_out, release, body),
            name::ANALOG_IN => append(&mut self.analog_in, release, body),
            name::TACTILE => append(&mut self.tactile, release, body),
            name::TACTILE_OPPOSED => append(&mut self.tactile_opposed, release, body),
            name::FORCE_TORQUE => append(&mut self.force_torque, release, body),
            name::DIGITAL_IN => append(&mut self.digital_in, release, body),
            name::DIGITAL_OUT => append(&mut self.digital_out, release, body),
            _ => true,
        }
    }

    /// Devices that answer from these tapes, and the note of the first missing entry.
    #[must_use]
    pub fn devices(self, description: &DeviceDescription) -> (Devices, MissingEntry) {
        let missing = MissingEntry::default();
        let note = || missing.clone();
        let opposed = description.opposed().map(|description| {
            let array = player(self.tactile_opposed, name::TACTILE_OPPOSED, &description, note());
            Box::new(array) as Box<dyn TactileArray>
        });
        let devices = Devices {
            encoders: Box::new(EncoderPlayer {
                counts: player(self.encoders, name::ENCODERS, description, note()),
                index: description
                    .index
                    .then(|| player(self.index, name::INDEX, description, note())),
                marks: [None; CHANNELS],
            }),
            analog_out: Box::new(player(self.analog_out, name::ANALOG_OUT, description, note())),
            analog_in: Box::new(player(self.analog_in, name::ANALOG_IN, description, note())),
            tactile: Box::new(player(self.tactile, name::TACTILE, description, note())),
            tactile_opposed: opposed,
            force_torque: Box::new(player(
                self.force_torque,
                name::FORCE_TORQUE,
                description,
                note(),
            )),
            digital_in: Box::new(player(self.digital_in, name::DIGITAL_IN, description, note())),
            digital_out: Box::new(player(self.digital_out, name::DIGITAL_OUT, description, note())),
        };
        (devices, missing)
    }
}

/// The first answer that was requested and is on no tape.
#[derive(Clone, Debug, Default)]
pub struct MissingEntry(Arc<OnceLock<(&'static str, Nanos)>>);

impl MissingEntry {
    fn note(&self, device: &'static str, release: Nanos) {
        // Only the first missing entry is kept.
        let _ = self.0.set((device, release));
    }

    /// Device and release of the missing entry, if there is one.
    #[must_use]
    pub fn first(&self) -> Option<(&'static str, Nanos)> {
        self.0.get().copied()
    }
}

/// A device half that reads a tape.
struct Player<E> {
    entries: Entries<E>,
    device: &'static str,
    description: DeviceDescription,
    missing: MissingEntry,
}

fn player<E>(
    entries: Entries<E>,
    device: &'static str,
    description: &DeviceDescription,
    missing: MissingEntry,
) -> Player<E> {
    Player { entries, device, description: description.clone(), missing }
}

impl<E: Payload> Player<E> {
    /// The entry for this release.
    fn next(&mut self, release: Nanos) -> Result<E, Error> {
        let here = self.entries.front().is_some_and(|entry| entry.0 == release);
        match here.then(|| self.entries.pop_front()).flatten() {
            Some((_, entry)) => Ok(entry),
            None => {
                self.missing.note(self.device, release);
                Err(Error::whole(ErrorKind::Lost, self.device))
            }
        }
    }
}

/// Encoders that read a tape.
struct EncoderPlayer {
    counts: Player<EncoderEntry>,
    index: Option<Player<IndexEntry>>,
    marks: IndexPulses,
}

impl Encoders for EncoderPlayer {
    fn joints(&self) -> usize {
        self.counts.description.joints
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

impl AnalogOut for Player<AnalogWord> {
    fn channels(&self) -> usize {
        self.description.analog_out_channels
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        let (low, high) = self.description.analog_out_codes;
        (DacCode(low), DacCode(high))
    }

    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let entry = self.next(release)?;
        let (low, high) = self.code_range();
        let wired = codes.iter().take(self.channels());
        if let Some(channel) = wired.clone().position(|code| *code < low || *code > high) {
            let channel = u16::try_from(channel).unwrap_or(Error::ALL_CHANNELS);
            return Err(Error::on_channel(ErrorKind::OutOfRange, self.device, channel));
        }
        entry.outcome().answer(self.device)
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

impl AnalogIn for Player<AnalogEntry> {
    fn channels(&self) -> usize {
        self.description.analog_in_channels
    }

    fn code_range(&self) -> (AdcCode, AdcCode) {
        let (low, high) = self.description.analog_in_codes;
        (AdcCode(low), AdcCode(high))
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
        self.next(release)?.answer(self.device)
    }
}

impl TactileArray for Player<TactileEntry> {
    fn rows(&self) -> usize {
        self.description.tactile_rows
    }

    fn cols(&self) -> usize {
        self.description.tactile_cols
    }

    fn full_scale(&self) -> u16 {
        self.description.tactile_full_scale
    }

    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        self.next(release)?.answer(self.device, frame)
    }
}

impl ForceTorque for Player<AnalogEntry> {
    fn sample(
        &mut self,
        release: Nanos,
    ) -> Result<Reading<[AdcCode; FORCE_TORQUE_CHANNELS]>, Error> {
        self.next(release)?.answer(self.device)
    }
}

impl DigitalIn for Player<DigitalEntry> {
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        self.next(release)?.answer(self.device)
    }
}

impl DigitalOut for Player<DigitalWord> {
    fn commit(&mut self, release: Nanos, _lines: &LinesOut) -> Result<(), Error> {
        self.next(release)?.outcome().answer(self.device)
    }

    fn safe(&mut self) -> Result<(), Error> {
        Ok(())
    }

    fn longest_silence(&self) -> Nanos {
        Nanos(self.description.digital_out_silence_ns)
    }
}
