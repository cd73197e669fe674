//! A driver with a fault: its half makes a call that the driver does not list. The sanitizer has to
//! find it; otherwise its silence about the drivers of this repository would mean nothing.

use std::fs::File;
use std::os::unix::fs::FileExt;

use taktil_hal::{
    AdcCode, AnalogIn, CHANNELS, Devices, Error, ErrorKind, Nanos, Reading, SystemCall,
};
use taktil_machine::own::Section;
use taktil_machine_boards::{Driver, Epoch, Opened};

/// It lists one of its two calls.
pub static DRIVERS: [Driver; 1] =
    [Driver::new("planted", open, Vec::new).with_system_calls(SYSTEM_CALLS)];

const SYSTEM_CALLS: &[SystemCall] =
    &[SystemCall { name: "pread64", about: "reads a byte of a file in memory" }];

struct PlantedAnalogIn {
    file: File,
}

impl AnalogIn for PlantedAnalogIn {
    fn channels(&self) -> usize {
        1
    }

    fn code_range(&self) -> (AdcCode, AdcCode) {
        (AdcCode(0), AdcCode(255))
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
        let mut byte = [0];
        let lost = |_| Error::whole(ErrorKind::Lost, "planted.analog_in");
        self.file.read_at(&mut byte, 0).map_err(lost)?;
        // The call that no list names.
        File::open("/dev/null").map_err(lost)?;
        let mut value = [AdcCode(0); CHANNELS];
        value[0] = AdcCode(i32::from(byte[0]));
        Ok(Reading { value, acquired: release })
    }
}

fn open(_: &Section, _: &Epoch) -> Result<Opened, taktil_hal::OpenError> {
    let unreadable = |error| {
        let what = format!("/dev/zero cannot be opened ({error})");
        taktil_hal::Invalid::new("", what, "run this where there is one")
    };
    let half = PlantedAnalogIn { file: File::open("/dev/zero").map_err(unreadable)? };
    let devices = Devices { analog_in: Some(Box::new(half)), ..Devices::default() };
    Ok(Opened { devices, ..Opened::default() })
}
