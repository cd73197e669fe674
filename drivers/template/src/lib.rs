//! A/D converters behind the kernel's industrial I/O subsystem, read one by one from sysfs: a
//! driver to begin one's own with. Signs and scales are not its business: they belong to the task
//! that reads the channels.
//!
//! - System calls in a job ([`SYSTEM_CALLS`]): one `pread64` for each channel; the kernel converts
//!   while it waits, at most [`READ_TIME_MAX`] for each.
//! - Source: the kernel's Documentation/ABI/testing/sysfs-bus-iio, `in_voltageY_raw`.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use taktil_hal::{
    AdcCode, AnalogIn, CHANNELS, Devices, Error, ErrorKind, Invalid, Nanos, OpenError, Reading,
    SystemCall,
};
use taktil_machine::own::Section;
use taktil_machine_boards::{Driver, Epoch, Opened};
use taktil_rtcore::explain::Explain;

/// The driver, for the list that a program registers.
pub const DRIVER: Driver = Driver::new("iio", open, Config::keys).with_system_calls(SYSTEM_CALLS);

/// What the half asks of the kernel within a job.
pub const SYSTEM_CALLS: &[SystemCall] = &[SystemCall {
    name: "pread64",
    about: "reads the text of one channel while the kernel converts, for READ_TIME_MAX at most",
}];

/// Longest that one conversion is taken to last: what the analysis of the schedule counts.
pub const READ_TIME_MAX: Nanos = Nanos::from_micros(50);

/// Digits, sign and line feed of a code.
const TEXT_BYTES_MAX: usize = 16;

taktil_hal::explained! {
    /// `[device.NAME]` with `driver = "iio"`.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Config {
        /// Folder of the device, such as /sys/bus/iio/devices/iio:device0.
        pub path: PathBuf,
        /// Channels in the order in which tasks see them: the Y of `in_voltageY_raw`.
        pub channels: Vec<u32>,
        /// Width of a code (bits).
        pub bits: u32 [2.0, 31.0],
    }
}

impl Config {
    fn check(&self) -> Result<(), Invalid> {
        if self.channels.is_empty() || self.channels.len() > CHANNELS {
            let what = format!("{} channels", self.channels.len());
            return Err(Invalid::new("channels", what, format!("list 1 to {CHANNELS}")));
        }
        if !(2..=31).contains(&self.bits) {
            return Err(Invalid::new("bits", format!("{} bits", self.bits), "give 2 to 31"));
        }
        Ok(())
    }
}

/// The half for a lane.
#[derive(Debug)]
pub struct IioAnalogIn {
    files: Vec<File>,
    code_max: i32,
    last: Option<Reading<[AdcCode; CHANNELS]>>,
}

const DEVICE_NAME: &str = "iio.analog_in";

impl IioAnalogIn {
    /// Opens the channels of the device.
    ///
    /// # Errors
    /// A configuration that cannot be meant; a channel that is not there or cannot be read.
    pub fn open(config: &Config) -> Result<IioAnalogIn, OpenError> {
        config.check()?;
        let mut files = Vec::new();
        for (at, channel) in config.channels.iter().enumerate() {
            let path = config.path.join(format!("in_voltage{channel}_raw"));
            files.push(File::open(&path).map_err(|error| unreadable(&path, at, &error))?);
        }
        Ok(IioAnalogIn { files, code_max: i32::MAX >> (31 - config.bits), last: None })
    }

    fn read(&self) -> Result<[AdcCode; CHANNELS], Error> {
        let mut codes = [AdcCode(0); CHANNELS];
        for (channel, (file, code)) in self.files.iter().zip(&mut codes).enumerate() {
            let channel = u16::try_from(channel).unwrap_or(Error::ALL_CHANNELS);
            let failed = |kind| Error::on_channel(kind, DEVICE_NAME, channel);
            let mut text = [0; TEXT_BYTES_MAX];
            let length = file.read_at(&mut text, 0).map_err(|_| failed(ErrorKind::Lost))?;
            let value = parse(&text[..length]).ok_or(failed(ErrorKind::Transient))?;
            if !(0..=self.code_max).contains(&value) {
                return Err(failed(ErrorKind::OutOfRange));
            }
            *code = AdcCode(value);
        }
        Ok(codes)
    }
}

fn unreadable(path: &Path, at: usize, error: &std::io::Error) -> OpenError {
    let what = format!("{} cannot be opened: {error}", path.display());
    let remedy = "look at what `ls` shows in the device's folder, and at who may read it";
    Invalid::new(format!("channels[{at}]"), what, remedy).into()
}

/// A whole number as the kernel writes it; no heap, no panic.
fn parse(text: &[u8]) -> Option<i32> {
    std::str::from_utf8(text).ok()?.trim().parse().ok()
}

impl AnalogIn for IioAnalogIn {
    fn channels(&self) -> usize {
        self.files.len()
    }

    fn code_range(&self) -> (AdcCode, AdcCode) {
        (AdcCode(0), AdcCode(self.code_max))
    }

    fn longest_wait(&self) -> Nanos {
        READ_TIME_MAX * self.files.len() as i64
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
        // A second call with the same release gives the same reading again.
        if let Some(last) = self.last.filter(|last| last.acquired == release) {
            return Ok(last);
        }
        let reading = Reading { value: self.read()?, acquired: release };
        self.last = Some(reading);
        Ok(reading)
    }
}

fn open(section: &Section, _: &Epoch) -> Result<Opened, OpenError> {
    let half = IioAnalogIn::open(&section.read()?)?;
    let devices = Devices { analog_in: Some(Box::new(half)), ..Devices::default() };
    Ok(Opened { devices, ..Opened::default() })
}
