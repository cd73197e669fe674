//! `[device.NAME]` of a machine file: which driver serves which half of the robot. The keys beside
//! those below belong to the driver.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use taktil_hal::{Devices, TACTILE};
use taktil_rtcore::analysis::Demand;
use taktil_rtcore::explain::Explain;
use taktil_rtcore::{Invalid, LaneSpec, Nanos};

use crate::own::Section;
use crate::strict::{self, ReadError};

/// The driver that stands for the simulated robot of a scene. Keys of another driver may stand
/// beside it, so that a machine file moves between both by this word alone.
pub const SIMULATOR: &str = "simulator";

/// The halves of a robot that a device may serve, besides further arrays `tactile_NAME`.
pub const HALVES: [&str; 11] = [
    "encoders",
    "analog_out",
    "drive_out",
    "drive_in",
    "analog_in",
    "tactile",
    "tactile_opposed",
    "force_torque",
    "digital_in",
    "digital_out",
    "board_clock",
];

/// The section of one device.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(transparent)]
pub struct DeviceSection {
    table: toml::Table,
    /// The folder of the file in which it stands.
    #[serde(skip)]
    folder: PathBuf,
}

/// Only the driver knows the meaning of most keys.
impl Explain for DeviceSection {}

/// The keys that every device has.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceKeys {
    /// Name of the driver.
    pub driver: String,
    /// Halves that the device serves; all that it has when absent.
    pub serves: Option<Vec<String>>,
    /// The thread of a driver that has one.
    pub thread: ThreadConfig,
}

taktil_rtcore::explained! {
    /// `thread`: how the thread of a driver that exchanges with its board beside the lanes is
    /// scheduled. The response-time analysis counts it where a budget is declared.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct ThreadConfig {
        /// `SCHED_FIFO` priority, 1 to 99, below those of the lanes; ordinary when absent.
        pub priority: Option<u8>,
        /// CPU to run on; any when absent.
        pub cpu: Option<usize>,
        /// Time between two exchanges (us).
        pub period_us: Option<i64>,
        /// Longest processor time of one exchange (us).
        pub budget_us: Option<i64>,
    }
}

impl DeviceSection {
    /// A section with the content of this table.
    #[must_use]
    pub fn new(table: toml::Table) -> DeviceSection {
        DeviceSection { table, folder: PathBuf::new() }
    }

    /// Says in which folder the file of the section stands: drivers take relative paths from there.
    pub fn set_folder(&mut self, folder: &Path) {
        folder.clone_into(&mut self.folder);
    }

    /// Whether the section gives a key.
    #[must_use]
    pub fn has_key(&self, key: &str) -> bool {
        self.table.contains_key(key)
    }

    /// The common keys, and the driver's own.
    ///
    /// # Errors
    /// A common key that is missing or of another type; the place is the key.
    pub fn split(&self) -> Result<(DeviceKeys, Section), Invalid> {
        let mut own = self.table.clone();
        let typed = |key: &str, error: &ReadError, remedy: &str| {
            Invalid::new(key, error.message().replace('\n', " "), remedy)
        };
        let Some(driver) = own.remove("driver") else {
            let remedy = format!("name a driver, or `{SIMULATOR}`");
            return Err(Invalid::new("", "has no `driver`", remedy));
        };
        let driver =
            strict::read_value(driver).map_err(|bad| typed("driver", &bad, "give its name"))?;
        let serves: Option<Vec<String>> = match own.remove("serves") {
            None => None,
            Some(list) => {
                let remedy = "list halves, such as [\"encoders\", \"analog_out\"]";
                Some(strict::read_value(list).map_err(|bad| typed("serves", &bad, remedy))?)
            }
        };
        for (at, half) in serves.iter().flatten().enumerate() {
            check_half(half).map_err(|bad| bad.within(&format!("serves[{at}]")))?;
            if serves.iter().flatten().take(at).any(|other| other == half) {
                let what = format!("`{half}` stands there twice");
                return Err(Invalid::new(format!("serves[{at}]"), what, "name it once"));
            }
        }
        let thread = match own.remove("thread") {
            None => ThreadConfig::default(),
            Some(table) => {
                let remedy = "give `priority`, `cpu`, `period_us` and `budget_us`";
                strict::read_value(table).map_err(|bad| typed("thread", &bad, remedy))?
            }
        };
        thread.check().map_err(|bad| bad.within("thread"))?;
        Ok((DeviceKeys { driver, serves, thread }, Section::new(own).within_folder(&self.folder)))
    }
}

impl ThreadConfig {
    /// What the analysis counts of the thread of this device; `None` for an ordinary thread, which
    /// takes no time from lanes, and where no budget is declared.
    #[must_use]
    pub fn demand(&self, device: &str) -> Option<Demand> {
        let (priority, period) = (self.priority?, Nanos::from_micros(self.period_us?));
        let budget = Nanos::from_micros(self.budget_us?);
        let spec = LaneSpec { cpu: self.cpu, ..LaneSpec::new(device, period, priority) };
        Some(Demand { spec, budget: Some(budget) })
    }

    fn check(&self) -> Result<(), Invalid> {
        if self.priority.is_some_and(|priority| !(1..=99).contains(&priority)) {
            return Err(Invalid::new("priority", "is no SCHED_FIFO priority", "give 1 to 99"));
        }
        for (key, span) in [("period_us", self.period_us), ("budget_us", self.budget_us)] {
            if let Some(us) = span.filter(|us| !(1..=10_000_000).contains(us)) {
                return Err(Invalid::new(key, format!("{us} us is no span"), "give 1 to 10000000"));
            }
        }
        match (self.period_us, self.budget_us) {
            (None, Some(_)) => {
                Err(Invalid::new("budget_us", "has no period", "give `period_us` beside it"))
            }
            _ => Ok(()),
        }
    }
}

fn check_half(half: &str) -> Result<(), Invalid> {
    let further = half.strip_prefix(TACTILE).and_then(|rest| rest.strip_prefix('_'));
    let named = further.is_some_and(|name| {
        let first = name.bytes().next().is_some_and(|c| c.is_ascii_lowercase());
        first && name.bytes().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'_')
    });
    if HALVES.contains(&half) || named {
        return Ok(());
    }
    let what = format!("there is no half `{half}`");
    Err(Invalid::new("", what, format!("halves are: {}, tactile_NAME", HALVES.join(", "))))
}

/// Names of the halves that are there.
#[must_use]
pub fn halves_of(devices: &Devices) -> BTreeSet<String> {
    let mut names: BTreeSet<String> = devices.tactile.keys().cloned().collect();
    for (name, there) in [
        ("encoders", devices.encoders.is_some()),
        ("analog_out", devices.analog_out.is_some()),
        ("drive_out", devices.drive_out.is_some()),
        ("drive_in", devices.drive_in.is_some()),
        ("analog_in", devices.analog_in.is_some()),
        ("force_torque", devices.force_torque.is_some()),
        ("digital_in", devices.digital_in.is_some()),
        ("digital_out", devices.digital_out.is_some()),
        ("board_clock", devices.board_clock.is_some()),
    ] {
        if there {
            names.insert(name.to_owned());
        }
    }
    names
}

/// Moves the half of this name from one set to another; false when it is not there.
pub fn move_half(name: &str, from: &mut Devices, to: &mut Devices) -> bool {
    fn moved<T>(from: &mut Option<T>, to: &mut Option<T>) -> bool {
        let there = from.is_some();
        if there {
            *to = from.take();
        }
        there
    }
    match name {
        "encoders" => moved(&mut from.encoders, &mut to.encoders),
        "analog_out" => moved(&mut from.analog_out, &mut to.analog_out),
        "drive_out" => moved(&mut from.drive_out, &mut to.drive_out),
        "drive_in" => moved(&mut from.drive_in, &mut to.drive_in),
        "analog_in" => moved(&mut from.analog_in, &mut to.analog_in),
        "force_torque" => moved(&mut from.force_torque, &mut to.force_torque),
        "digital_in" => moved(&mut from.digital_in, &mut to.digital_in),
        "digital_out" => moved(&mut from.digital_out, &mut to.digital_out),
        "board_clock" => moved(&mut from.board_clock, &mut to.board_clock),
        array => match from.tactile.remove_entry(array) {
            Some((name, half)) => to.tactile.insert(name, half).is_none(),
            None => false,
        },
    }
}
