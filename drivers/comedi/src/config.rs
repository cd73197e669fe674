//! Describes a Comedi board as a machine file states it: which channel of which subdevice serves
//! what. Signs and scales are not part of it: they belong to whoever knows what is wired.

use serde::Deserialize;
use taktil_hal::{CHANNELS, FORCE_TORQUE_CHANNELS, Invalid};

/// The largest voltage of a wanted span, either way (V).
pub const SPAN_MAX_V: f64 = 1000.0;
/// The smallest and the largest gain of a calibration; a board that is farther off is broken.
pub const GAIN_BOUNDS: [f64; 2] = [0.5, 2.0];
/// The largest offset of a calibration, either way (codes).
pub const OFFSET_MAX_CODES: f64 = 65_536.0;
/// The longest time of the watchdog on the feed line (ms).
pub const WATCHDOG_MAX_MS: u16 = 10_000;

taktil_hal::explained! {
    /// A board behind the kernel's Comedi interface. A half whose list or section is absent is not
    /// offered.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Config {
        /// The device node, such as `/dev/comedi0`.
        pub path: String,
        /// The board that has to be attached to the node, such as `pci-6221`, or its kernel driver,
        /// such as `ni_pcimio`. By default any board.
        pub board: Option<String>,
        /// After how long without a change of the feed line the relay that hangs on it drops the
        /// drives, in milliseconds, 1 to 10 000. Comedi boards have no watchdog of their own.
        pub watchdog_ms: u16 [1.0, WATCHDOG_MAX_MS as f64],
        /// Counters of the joints' encoders, in the order of the joints. Default none.
        #[serde(default)]
        pub encoders: Vec<EncoderChannel>,
        /// D/A channels, in the order of the outputs. Default none.
        #[serde(default)]
        pub analog_out: Vec<AnalogChannel>,
        /// A/D channels, in the order of the inputs. Default none.
        #[serde(default)]
        pub analog_in: Vec<AnalogChannel>,
        /// The A/D channels of the six gauges of a force/torque sensor; six or none. Default none.
        #[serde(default)]
        pub force_torque: Vec<AnalogChannel>,
        /// The lines from the cell. By default none is wired.
        pub lines_in: Option<InputLines>,
        /// The lines to the cell. By default none is wired.
        pub lines_out: Option<OutputLines>,
    }
}

taktil_hal::explained! {
    /// One counter.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct EncoderChannel {
        /// The counter's subdevice. By default the first one that is a counter.
        pub subdevice: Option<u32>,
        /// The channel in it, from 0. Default 0: boards whose counters are subdevices have the
        /// count there.
        #[serde(default)]
        pub channel: u16,
        /// How the counter is made to count. Default `running`.
        #[serde(default)]
        pub setup: CounterSetup,
        /// The counter's mode word. By default four counts a period, direction by the order of the
        /// tracks, for `armed`; 0 for `quadrature`.
        pub mode: Option<u32>,
        /// For `armed`: the number of the terminal to which track A goes. By default as the kernel
        /// driver has it.
        pub source_a: Option<u32>,
        /// The same of track B.
        pub source_b: Option<u32>,
    }
}

taktil_hal::explained! {
    /// How a counter is made to count.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum CounterSetup {
        /// It counts by itself, and nothing is sent to it.
        #[default]
        Running,
        /// Reset, gates off, terminals, mode, arm: general-purpose counters (`ni_pcimio`,
        /// `ni_660x`).
        Armed,
        /// One configuration as a quadrature encoder with `mode` and a preload of 0 (`s526`).
        Quadrature,
        /// One configuration with a preload of 0 (`s626`).
        Preload,
    }
}

taktil_hal::explained! {
    /// One channel of a converter.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct AnalogChannel {
        /// The converter's subdevice. By default the first one of the kind.
        pub subdevice: Option<u32>,
        /// The channel in it, from 0.
        pub channel: u16,
        /// The lowest voltage that must fit (V). The smallest range that holds this and `high_v` is
        /// taken. Default -10.
        #[serde(default = "low_default_v")]
        pub low_v: f64 [-SPAN_MAX_V, SPAN_MAX_V],
        /// The highest voltage that must fit (V). Default 10.
        #[serde(default = "high_default_v")]
        pub high_v: f64 [-SPAN_MAX_V, SPAN_MAX_V],
        /// What the voltage is measured against. Default `ground`.
        #[serde(default)]
        pub reference: Reference,
        /// Calibration: by what a code about zero is multiplied, read from the converter or on its
        /// way there, 0.5 to 2. Default 1.
        #[serde(default = "gain_default")]
        pub gain: f64 [GAIN_BOUNDS[0], GAIN_BOUNDS[1]],
        /// Calibration: what is added after that (codes). Default 0.
        #[serde(default)]
        pub offset_codes: f64 [-OFFSET_MAX_CODES, OFFSET_MAX_CODES],
    }
}

taktil_hal::explained! {
    /// What a voltage is measured against.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Reference {
        /// Analog ground.
        #[default]
        Ground,
        /// The common line of the channels.
        Common,
        /// A second line of the channel.
        Differential,
        /// What the board calls other.
        Other,
    }
}

taktil_hal::explained! {
    /// One digital line.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Line {
        /// The line's subdevice. By default the first one of digital lines that can do it.
        pub subdevice: Option<u32>,
        /// The channel in it, from 0.
        pub channel: u16,
        /// The level that means true. Take the one that an open input does not have: a broken wire
        /// then reads false. There is no default.
        pub active: Level,
    }
}

taktil_hal::explained! {
    /// A level of a digital line.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Level {
        /// The upper level: right for inputs that are pulled down.
        High,
        /// The lower level: right for inputs that are pulled up, as most boards have them.
        Low,
    }
}

taktil_hal::explained! {
    /// The lines from the cell.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct InputLines {
        /// The drives' supply is on.
        pub drive_power: Line,
        /// Channel A of the emergency-stop chain is closed.
        pub estop_a_closed: Line,
        /// Channel B of the emergency-stop chain is closed.
        pub estop_b_closed: Line,
    }
}

taktil_hal::explained! {
    /// The lines to the cell.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct OutputLines {
        /// The drives may put current into the motors.
        pub enable: Line,
        /// The brakes are lifted.
        pub brake_release: Line,
        /// The line whose changes keep the watchdog relay closed.
        pub watchdog_feed: Line,
    }
}

fn low_default_v() -> f64 {
    -10.0
}

fn high_default_v() -> f64 {
    10.0
}

fn gain_default() -> f64 {
    1.0
}

impl AnalogChannel {
    /// A channel of the first subdevice of its kind, -10 to 10 V against ground, not calibrated.
    #[must_use]
    pub fn new(channel: u16) -> AnalogChannel {
        AnalogChannel {
            subdevice: None,
            channel,
            low_v: low_default_v(),
            high_v: high_default_v(),
            reference: Reference::Ground,
            gain: gain_default(),
            offset_codes: 0.0,
        }
    }

    fn check(&self, place: &str) -> Result<(), Invalid> {
        let within = |key: &str, value: f64, low: f64, high: f64| {
            if (low..=high).contains(&value) {
                return Ok(());
            }
            let what = format!("{value} is out of bounds");
            Err(Invalid::new(format!("{place}.{key}"), what, format!("give {low} to {high}")))
        };
        within("low_v", self.low_v, -SPAN_MAX_V, SPAN_MAX_V)?;
        within("high_v", self.high_v, -SPAN_MAX_V, SPAN_MAX_V)?;
        within("gain", self.gain, GAIN_BOUNDS[0], GAIN_BOUNDS[1])?;
        within("offset_codes", self.offset_codes, -OFFSET_MAX_CODES, OFFSET_MAX_CODES)?;
        if self.low_v >= self.high_v {
            let what = format!("{} V is not below `high_v`, {} V", self.low_v, self.high_v);
            return Err(Invalid::new(format!("{place}.low_v"), what, "give the lower end"));
        }
        Ok(())
    }
}

impl EncoderChannel {
    /// A channel of the first counter subdevice, set up in this way.
    #[must_use]
    pub fn new(channel: u16, setup: CounterSetup) -> EncoderChannel {
        EncoderChannel {
            subdevice: None,
            channel,
            setup,
            mode: None,
            source_a: None,
            source_b: None,
        }
    }
}

impl Config {
    /// A board of which no half is configured yet.
    #[must_use]
    pub fn new(path: &str, watchdog_ms: u16) -> Config {
        Config {
            path: path.to_owned(),
            board: None,
            watchdog_ms,
            encoders: Vec::new(),
            analog_out: Vec::new(),
            analog_in: Vec::new(),
            force_torque: Vec::new(),
            lines_in: None,
            lines_out: None,
        }
    }

    /// Checks every field against the bounds that it states. What the board has to offer is checked
    /// when it is opened.
    ///
    /// # Errors
    /// The first value that is outside the bounds its field states.
    pub fn check(&self) -> Result<(), Invalid> {
        if self.path.is_empty() {
            let remedy = "name a device node such as /dev/comedi0";
            return Err(Invalid::new("path", "no path is given", remedy));
        }
        if !(1..=WATCHDOG_MAX_MS).contains(&self.watchdog_ms) {
            let what = format!("{} is out of bounds", self.watchdog_ms);
            return Err(Invalid::new("watchdog_ms", what, "give 1 to 10000"));
        }
        for (list, length) in [
            ("encoders", self.encoders.len()),
            ("analog_out", self.analog_out.len()),
            ("analog_in", self.analog_in.len()),
        ] {
            if length > CHANNELS {
                let place = format!("{list}[{CHANNELS}]");
                let what = format!("{length} channels are more than a half carries");
                let remedy = format!("list at most {CHANNELS}; a second board takes the others");
                return Err(Invalid::new(place, what, remedy));
            }
        }
        if !self.force_torque.is_empty() && self.force_torque.len() != FORCE_TORQUE_CHANNELS {
            let what = format!("{} channels are listed", self.force_torque.len());
            let remedy = "list the six channels of the gauges, or none";
            return Err(Invalid::new("force_torque", what, remedy));
        }
        for (list, channels) in [
            ("analog_out", &self.analog_out),
            ("analog_in", &self.analog_in),
            ("force_torque", &self.force_torque),
        ] {
            for (at, channel) in channels.iter().enumerate() {
                channel.check(&format!("{list}[{at}]"))?;
            }
        }
        Ok(())
    }
}
