//! What a driver is to a machine file: a name, a way to open the device of a section, and the keys
//! of that section.

use taktil_hal::{Devices, OpenError, SystemCall};
use taktil_machine::own::Section;
use taktil_rtcore::explain::Key;

use crate::epoch::Epoch;
use crate::thread::DriverThread;

/// What a driver has counted since it opened its board: each number with its name for people. Any
/// thread may ask, at any time; no lane waits for it.
pub struct Counts(pub Box<dyn Fn() -> Vec<(&'static str, u64)> + Send>);

impl Counts {
    /// The numbers above 0 as one line.
    #[must_use]
    pub fn text(&self) -> String {
        let counted = (self.0)().into_iter().filter(|(_, count)| *count > 0);
        let words: Vec<String> = counted.map(|(name, count)| format!("{count} {name}")).collect();
        if words.is_empty() { "nothing counted".to_owned() } else { words.join(", ") }
    }
}

impl std::fmt::Debug for Counts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Counts").field(&self.text()).finish()
    }
}

/// What a driver made of its section.
#[derive(Debug, Default)]
pub struct Opened {
    /// The halves that the board offers by its section. A device with one tactile array offers it
    /// as [`taktil_hal::TACTILE`].
    pub devices: Devices,
    /// Threads that exchange with the board beside the lanes.
    pub threads: Vec<DriverThread>,
    /// What the driver counts on its board, where it counts anything.
    pub counts: Option<Counts>,
    /// Volts for one code of each D/A channel, where the board knows them.
    pub analog_out_volts_per_code: Vec<f64>,
}

/// Writes the safe values of the outputs of a section's board and closes it.
pub type MakeSafe = fn(&Section) -> Result<(), OpenError>;

/// Opens the device of a section.
pub type Open = fn(&Section, &Epoch) -> Result<Opened, OpenError>;

/// A driver that `[device.NAME]` may name.
#[derive(Clone, Copy, Debug)]
pub struct Driver {
    /// Name: lower-case letters, digits, `_` and `-`.
    pub name: &'static str,
    /// Opens the board of a section; its errors are located in the section. A driver whose readings
    /// are stamped by a thread of its own keeps the epoch.
    pub open: Open,
    /// The keys of its section, explained.
    pub keys: fn() -> Vec<Key>,
    /// Writes the safe values of the board's outputs and closes it; `None` for a device without
    /// outputs.
    pub make_safe: Option<MakeSafe>,
    /// What its halves ask of the kernel within a job, call by call; what is not listed they must
    /// not do.
    pub system_calls: &'static [SystemCall],
}

impl Driver {
    /// A driver of a device without outputs, whose halves make no system call.
    #[must_use]
    pub const fn new(name: &'static str, open: Open, keys: fn() -> Vec<Key>) -> Driver {
        Driver { name, open, keys, make_safe: None, system_calls: &[] }
    }

    /// The same driver, of a device with outputs.
    #[must_use]
    pub const fn with_make_safe(self, make_safe: MakeSafe) -> Driver {
        Driver { make_safe: Some(make_safe), ..self }
    }

    /// The same driver, whose halves make these system calls within a job.
    #[must_use]
    pub const fn with_system_calls(self, system_calls: &'static [SystemCall]) -> Driver {
        Driver { system_calls, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_happened_is_told() {
        let counts = |timeouts: u64| {
            Counts(Box::new(move || vec![("answers", 7 * timeouts), ("timeouts", timeouts)]))
        };
        assert_eq!(counts(3).text(), "21 answers, 3 timeouts");
        assert_eq!(counts(0).text(), "nothing counted");
    }
}
