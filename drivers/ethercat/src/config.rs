//! The configuration of an EtherCAT segment as a machine file states it. Signs and scales are not
//! part of it: they belong to whoever knows what is wired.

use std::ops::RangeInclusive;

use serde::Deserialize;
use taktil_drivers_cia402::Mode;
use taktil_hal::{CHANNELS, DriveLoop, Invalid, Nanos};

taktil_hal::explained! {
    /// An EtherCAT segment at a network interface of its own. `interface` and `devices` have no
    /// default.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// The network interface that the segment is at, such as `eth1`. Nothing else may be on it.
        pub interface: String,
        /// All devices of the segment, in the order in which a frame reaches them.
        pub devices: Vec<DeviceConfig>,
        /// The channels of the analog outputs. Default: all drives in their order; where there are
        /// none, all channels of the analog terminals.
        pub analog_out: Vec<Place>,
        /// The encoders. Default: all drives in their order; where there are none, all encoder
        /// terminals.
        pub encoders: Vec<Place>,
        /// The channels of the analog inputs. Default: all channels of the input terminals.
        pub analog_in: Vec<Place>,
        /// The lines from the cell; leave the section out for a segment that has none.
        pub lines_in: Option<LinesInConfig>,
        /// The lines to the cell; leave the section out for a segment that has none.
        pub lines_out: Option<LinesOutConfig>,
        /// When frames are exchanged within a cycle. Default `twice`.
        pub exchange: ExchangeTimes,
        /// Drives act by the distributed clocks of the segment, and the machine may follow them
        /// with the task `clock_lock`; leave the section out for drives that act when a frame
        /// comes.
        pub sync: Option<SyncConfig>,
        /// The period of the lane that drives the segment, in microseconds. Default 1000.
        pub period_us: u32 [100.0, 100000.0],
        /// How much of the period one exchange may wait for its frame, 0.01 to 0.45; with the
        /// exchange `pipelined` nothing is waited for. Default 0.3.
        pub wait_share: f64 [0.01, 0.45],
        /// After how long without a frame that every device has served the segment counts as gone,
        /// in milliseconds. Default 200.
        pub lost_ms: u32 [1.0, 10000.0],
        /// After how long without outputs the devices put out their safe values by themselves, in
        /// milliseconds: drives stop by their own quick stop. Default 10.
        pub watchdog_ms: u32 [1.0, 6000.0],
        /// How long the drives may take from enable to operation, in milliseconds. Default 500.
        pub enable_ms: u32 [1.0, 10000.0],
        /// How long a change of state of the devices may take while the segment is opened, in
        /// milliseconds. Default 5000.
        pub open_wait_ms: u32 [10.0, 60000.0],
    }
}

taktil_hal::explained! {
    /// When frames are exchanged within a cycle.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum ExchangeTimes {
        /// At the first reading, and again at the last commit: outputs act in their own cycle.
        #[default]
        Twice,
        /// At the first reading, which takes the outputs of the cycle before along: one frame a
        /// cycle, and outputs act one cycle later.
        Once,
        /// Sent at the first reading as with `once`, but nobody waits for the answer: it is
        /// collected at the first reading of the next cycle. Readings are one cycle old, and say
        /// so; one frame has to hold all process data.
        Pipelined,
    }
}

taktil_hal::explained! {
    /// How the drives are synchronised.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct SyncConfig {
        /// When the pulse SYNC0 comes, after the place of the first frame in the cycle (us):
        /// outputs have to have arrived by then. Default half of `period_us`.
        pub shift_us: Option<u32> [0.0, 99999.0],
    }
}

taktil_hal::explained! {
    /// A device of the segment.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct DeviceConfig {
        /// What it is.
        pub kind: Kind,
        /// Its vendor number. Default: that of the kind; a drive has none.
        #[serde(default)]
        pub vendor: Option<u32>,
        /// Its product number. Default: that of the kind; a drive has none.
        #[serde(default)]
        pub product: Option<u32>,
        /// Its revision number. Default: any.
        #[serde(default)]
        pub revision: Option<u32>,
        /// Its station alias. Default: any.
        #[serde(default)]
        pub alias: Option<u16>,
        /// What a drive follows. Default `torque`.
        #[serde(default)]
        pub mode: DriveMode,
        /// Highest code of a drive, of either sign. Default for `torque`: what the drive allows by
        /// its object 6072; other modes have none.
        #[serde(default)]
        pub code_max: Option<u32> [1.0, 2147483647.0],
        /// Highest step of a drive's target from one cycle to the next in mode `position` (counts).
        /// Default 1000.
        #[serde(default = "default_step")]
        pub step_max_counts: u32 [1.0, 2147483647.0],
        /// Whether a drive's process data are set up anew; otherwise they must hold what is needed.
        /// Default true.
        #[serde(default = "default_true")]
        pub map: bool,
    }
}

taktil_hal::explained! {
    /// Kinds of devices.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Kind {
        /// The coupler EK1100.
        Ek1100,
        /// EL1008: eight digital inputs.
        El1008,
        /// EL2008: eight digital outputs.
        El2008,
        /// EL4134: four analog outputs of -10 to 10 V and 16 bits.
        El4134,
        /// EL3104: four analog inputs of -10 to 10 V and 16 bits.
        El3104,
        /// EL5101: an encoder of 16 bits.
        El5101,
        /// EL5151: an encoder of 32 bits.
        El5151,
        /// A drive by CiA 402 with its encoder; `vendor` and `product` are needed.
        Drive,
        /// A device that is there and is not used; `vendor` and `product` are needed.
        Other,
    }
}

taktil_hal::explained! {
    /// What a drive follows.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum DriveMode {
        /// Cyclic synchronous torque: a code is 0.1 % of the rated torque, object 6076.
        #[default]
        Torque,
        /// Cyclic synchronous velocity: a code is one unit of the drive's object 60FF.
        Velocity,
        /// Cyclic synchronous position: a code is one count away from where the drive was enabled.
        Position,
    }
}

impl DriveMode {
    /// The cyclic mode of CiA 402.
    pub(crate) const fn cyclic(self) -> Mode {
        Mode::cyclic(self.control_loop())
    }

    /// The loop that the drive closes.
    pub(crate) const fn control_loop(self) -> DriveLoop {
        match self {
            DriveMode::Torque => DriveLoop::Torque,
            DriveMode::Velocity => DriveLoop::Velocity,
            DriveMode::Position => DriveLoop::Position,
        }
    }
}

taktil_hal::explained! {
    /// Where a channel is.
    #[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Place {
        /// Which of `devices`, counted from 0.
        pub device: usize [0.0, 63.0],
        /// Which channel of it, counted from 0. Default 0.
        #[serde(default)]
        pub channel: usize [0.0, 7.0],
    }
}

taktil_hal::explained! {
    /// Where a line is.
    #[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Line {
        /// At a terminal, or the drives themselves.
        pub at: LineKind,
        /// Which of `devices`, counted from 0, for a line at a terminal. Default 0.
        #[serde(default)]
        pub device: usize [0.0, 63.0],
        /// Which channel of it, counted from 0. Default 0.
        #[serde(default)]
        pub channel: usize [0.0, 7.0],
        /// Whether the line is low when it is true; for a line at a terminal. Default false.
        #[serde(default)]
        pub inverted: bool,
    }
}

taktil_hal::explained! {
    /// Kinds of places of a line.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum LineKind {
        /// A digital terminal.
        Terminal,
        /// All drives: as `enable`, they are led to operation; as `drive_power` or a channel of the
        /// emergency stop, each of them reports that its voltage is on.
        Drives,
    }
}

taktil_hal::explained! {
    /// The lines from the cell.
    #[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct LinesInConfig {
        /// The drives' supply is on.
        pub drive_power: Line,
        /// Channel A of the emergency-stop chain is closed.
        pub estop_a: Line,
        /// Channel B of the emergency-stop chain is closed.
        pub estop_b: Line,
    }
}

taktil_hal::explained! {
    /// The lines to the cell.
    #[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct LinesOutConfig {
        /// The drives may put current into the motors.
        pub enable: Line,
        /// The brakes are lifted; left out where the drives lift them.
        #[serde(default)]
        pub brake_release: Option<Line>,
        /// A line that toggles every cycle, for a relay that watches it; left out for none.
        #[serde(default)]
        pub watchdog_feed: Option<Line>,
    }
}

const fn default_true() -> bool {
    true
}

const fn default_step() -> u32 {
    1_000
}

/// Devices of a segment.
pub(crate) const DEVICES_MAX: usize = 64;

impl Default for Config {
    fn default() -> Config {
        Config {
            interface: String::new(),
            devices: Vec::new(),
            analog_out: Vec::new(),
            encoders: Vec::new(),
            analog_in: Vec::new(),
            lines_in: None,
            lines_out: None,
            exchange: ExchangeTimes::Twice,
            sync: None,
            period_us: 1_000,
            wait_share: 0.3,
            lost_ms: 200,
            watchdog_ms: 10,
            enable_ms: 500,
            open_wait_ms: 5_000,
        }
    }
}

impl DeviceConfig {
    /// A device of a kind, whatever its revision and alias.
    #[must_use]
    pub const fn of(kind: Kind) -> DeviceConfig {
        DeviceConfig {
            kind,
            vendor: None,
            product: None,
            revision: None,
            alias: None,
            mode: DriveMode::Torque,
            code_max: None,
            step_max_counts: default_step(),
            map: true,
        }
    }
}

impl Config {
    /// Checks every field against the bounds that it states.
    ///
    /// # Errors
    /// The first value that is outside the bounds its field states.
    pub fn check(&self) -> Result<(), Invalid> {
        let name = self.interface.as_bytes();
        if name.is_empty() || name.len() > 15 || name.iter().any(|byte| !byte.is_ascii_graphic()) {
            let what = format!("`{}` is no interface", self.interface);
            return Err(Invalid::new("interface", what, "write its name such as eth1"));
        }
        self.check_segment()
    }

    /// Checks everything but where the segment is.
    pub(crate) fn check_segment(&self) -> Result<(), Invalid> {
        if self.devices.is_empty() || self.devices.len() > DEVICES_MAX {
            let what = format!("{} are listed", self.devices.len());
            let remedy = format!("list all devices of the segment, 1 to {DEVICES_MAX}");
            return Err(Invalid::new("devices", what, remedy));
        }
        for (index, device) in self.devices.iter().enumerate() {
            check_device(device).map_err(|bad| bad.within(&format!("devices[{index}]")))?;
        }
        for (name, places) in [
            ("analog_out", &self.analog_out),
            ("encoders", &self.encoders),
            ("analog_in", &self.analog_in),
        ] {
            self.check_places(name, places)?;
        }
        for (place, line, _) in self.lines() {
            within(&format!("{place}.device"), line.device, 0..=self.devices.len() - 1)?;
            within(&format!("{place}.channel"), line.channel, 0..=7)?;
        }
        within("period_us", self.period_us, 100..=100_000)?;
        within("wait_share", self.wait_share, 0.01..=0.45)?;
        within("lost_ms", self.lost_ms, 1..=10_000)?;
        within("watchdog_ms", self.watchdog_ms, 1..=6_000)?;
        within("enable_ms", self.enable_ms, 1..=10_000)?;
        within("open_wait_ms", self.open_wait_ms, 10..=60_000)?;
        if let Some(shift_us) = self.sync.and_then(|sync| sync.shift_us) {
            within("sync.shift_us", shift_us, 0..=self.period_us - 1)?;
        }
        if u64::from(self.watchdog_ms) * 1_000 < 2 * u64::from(self.period_us) {
            let what = format!("{} ms is less than two periods", self.watchdog_ms);
            let remedy = "give a few periods, so that one lost frame does not stop the drives";
            return Err(Invalid::new("watchdog_ms", what, remedy));
        }
        Ok(())
    }

    fn check_places(&self, name: &str, places: &[Place]) -> Result<(), Invalid> {
        if places.len() > CHANNELS {
            let what = format!("{} are listed", places.len());
            return Err(Invalid::new(name, what, format!("a half has at most {CHANNELS}")));
        }
        for (index, place) in places.iter().enumerate() {
            let at = format!("{name}[{index}]");
            within(&format!("{at}.device"), place.device, 0..=self.devices.len() - 1)?;
            within(&format!("{at}.channel"), place.channel, 0..=7)?;
            if places[..index].contains(place) {
                let what = "it is the place of another channel";
                return Err(Invalid::new(at, what, "give each channel a place of its own"));
            }
        }
        Ok(())
    }

    /// A cycle of the segment.
    pub(crate) fn period(&self) -> Nanos {
        Nanos::from_micros(i64::from(self.period_us))
    }

    /// When SYNC0 comes after the place of the first frame in the cycle; `None` without clocks.
    pub(crate) fn sync_shift(&self) -> Option<Nanos> {
        let shift_us = self.sync?.shift_us.unwrap_or(self.period_us / 2);
        Some(Nanos::from_micros(i64::from(shift_us)))
    }

    /// How long one exchange waits for its frame within a job at most.
    #[must_use]
    pub fn exchange_wait(&self) -> Nanos {
        match self.exchange {
            ExchangeTimes::Pipelined => Nanos::ZERO,
            ExchangeTimes::Twice | ExchangeTimes::Once => self.answer_wait(),
        }
    }

    /// How long an answer is waited for where a wait costs no job anything.
    pub(crate) fn answer_wait(&self) -> Nanos {
        Nanos((f64::from(self.period_us) * 1e3 * self.wait_share) as i64)
    }

    /// All lines with their places and whether they are outputs.
    pub(crate) fn lines(&self) -> Vec<(&'static str, &Line, bool)> {
        let mut all = Vec::new();
        if let Some(lines) = &self.lines_in {
            all.push(("lines_in.drive_power", &lines.drive_power, false));
            all.push(("lines_in.estop_a", &lines.estop_a, false));
            all.push(("lines_in.estop_b", &lines.estop_b, false));
        }
        if let Some(lines) = &self.lines_out {
            all.push(("lines_out.enable", &lines.enable, true));
            let release = lines.brake_release.iter();
            all.extend(release.map(|line| ("lines_out.brake_release", line, true)));
            let feed = lines.watchdog_feed.iter();
            all.extend(feed.map(|line| ("lines_out.watchdog_feed", line, true)));
        }
        all
    }
}

fn check_device(device: &DeviceConfig) -> Result<(), Invalid> {
    let is_named = device.vendor.is_some() && device.product.is_some();
    if matches!(device.kind, Kind::Drive | Kind::Other) && !is_named {
        let what = "a device of this kind has no vendor and product of its own";
        let remedy = "give `vendor` and `product` as its description states them";
        return Err(Invalid::new("product", what, remedy));
    }
    if let Some(code_max) = device.code_max {
        within("code_max", code_max, 1..=i32::MAX.cast_unsigned())?;
    }
    within("step_max_counts", device.step_max_counts, 1..=i32::MAX.cast_unsigned())?;
    let needs_limit = device.kind == Kind::Drive && device.mode != DriveMode::Torque;
    if needs_limit && device.code_max.is_none() {
        let what = "nothing bounds this mode";
        return Err(Invalid::new("code_max", what, "give the highest code that may be asked for"));
    }
    Ok(())
}

fn within<T>(place: &str, value: T, range: RangeInclusive<T>) -> Result<(), Invalid>
where
    T: PartialOrd + std::fmt::Display,
{
    if range.contains(&value) {
        return Ok(());
    }
    let what = format!("{value} is out of bounds");
    Err(Invalid::new(place, what, format!("give {} to {}", range.start(), range.end())))
}
