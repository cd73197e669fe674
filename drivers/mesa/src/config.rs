//! The configuration of a HostMot2 card as a machine file states it. Signs and scales are not part
//! of it: they belong to whoever knows what is wired.

use std::net::SocketAddr;
use std::ops::RangeInclusive;

use serde::Deserialize;
use taktil_hal::{CHANNELS, Invalid};

taktil_hal::explained! {
    /// A HostMot2 card behind UDP. Only `address` has no default.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// Address and port of the card, such as `10.10.10.10:27181`. Jumpers choose
        /// 192.168.1.121, the address in the card's memory (10.10.10.10 as delivered), or BOOTP.
        pub address: String,
        /// The board's name in the card's own table without its maker's, such as `7I92`. Empty for
        /// any board. Default empty.
        pub board: String,
        /// Encoders wired, from the card's first channel on; 0 for no encoders. Default 6.
        pub encoders: usize [0.0, CHANNELS as f64],
        /// Whether index pulses are wired to the encoders. Default true.
        pub index: bool,
        /// Highest step of a counter from one reading to the next (counts), 1 to 16384: a larger
        /// one is not believed. Default 16384.
        pub step_max_counts: i32 [1.0, 16384.0],
        /// What drives the motors. Default `7i77`.
        pub analog: Analog,
        /// Analog outputs wired, from the first one on. Default 6.
        pub analog_channels: usize [1.0, CHANNELS as f64],
        /// The smart-serial channel of the 7I77's field terminals; its analog outputs are the next
        /// one. Default 0.
        pub serial_channel: usize [0.0, 6.0],
        /// Frequency of the pulse-width modulators (Hz). Default 20000.
        pub pwm_hz: u32 [100.0, 200000.0],
        /// The lines from the cell; leave the section out for a card that has none.
        pub lines_in: Option<LinesInConfig>,
        /// The lines to the cell; leave the section out for a card that has none.
        pub lines_out: Option<LinesOutConfig>,
        /// The period of the lane that drives the card, in microseconds. Default 2500.
        pub period_us: u32 [100.0, 100000.0],
        /// How much of the period a job may wait for the card's answer, 0.01 to 0.9. Default 0.4.
        pub wait_share: f64 [0.01, 0.9],
        /// After how long without an answer the card counts as gone, in milliseconds: what the
        /// counters did meanwhile is not known any more. Default 200.
        pub lost_ms: u32 [10.0, 10000.0],
        /// After how long without a sign of life the FPGA switches its outputs off, in
        /// milliseconds. Default 25: ten cycles of 2.5 ms.
        pub watchdog_ms: u32 [1.0, 10000.0],
        /// After how long without an exchange a 7I77 switches its outputs off, in milliseconds, as
        /// the remote is set: the driver cannot set it. Default 50.
        pub remote_watchdog_ms: u32 [1.0, 10000.0],
        /// How long each answer is waited for while the card is opened, in milliseconds.
        /// Default 200.
        pub open_wait_ms: u32 [1.0, 10000.0],
    }
}

taktil_hal::explained! {
    /// What drives the motors.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Analog {
        /// The analog outputs of a 7I77 behind smart serial, -10 to 10 V.
        #[default]
        #[serde(rename = "7i77")]
        Remote,
        /// Pulse-width modulators of the FPGA with direction and enable.
        Pwm,
        /// Nothing.
        None,
    }
}

taktil_hal::explained! {
    /// Where a line is wired.
    #[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Line {
        /// At the field terminals of the 7I77, or at a pin of the card.
        pub at: Terminal,
        /// Number of the terminal, inputs 0 to 31 and outputs 0 to 15, or of the pin as the card
        /// counts them, 0 to 143.
        pub number: u32 [0.0, 143.0],
        /// Whether the line is low when it is true. Default false.
        #[serde(default)]
        pub inverted: bool,
    }
}

taktil_hal::explained! {
    /// Kinds of places of a line.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Terminal {
        /// The field terminals of the 7I77.
        Field,
        /// A pin of the card.
        Pin,
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
        /// The brakes are lifted.
        pub brake_release: Line,
        /// A line that toggles every cycle, for a relay that watches it; left out for none.
        #[serde(default)]
        pub watchdog_feed: Option<Line>,
    }
}

impl Default for Config {
    fn default() -> Config {
        Config {
            address: String::new(),
            board: String::new(),
            encoders: 6,
            index: true,
            step_max_counts: 16_384,
            analog: Analog::Remote,
            analog_channels: 6,
            serial_channel: 0,
            pwm_hz: 20_000,
            lines_in: None,
            lines_out: None,
            period_us: 2_500,
            wait_share: 0.4,
            lost_ms: 200,
            watchdog_ms: 25,
            remote_watchdog_ms: 50,
            open_wait_ms: 200,
        }
    }
}

/// Analog outputs of a 7I77.
pub(crate) const REMOTE_OUTPUTS: usize = 6;
/// Numbers of a 7I77's field inputs.
const FIELD_INPUTS: RangeInclusive<u32> = 0..=31;
/// Numbers of a 7I77's field outputs.
const FIELD_OUTPUTS: RangeInclusive<u32> = 0..=15;
/// Numbers of a card's pins.
const PIN_NUMBERS: RangeInclusive<u32> = 0..=143;
/// Times in milliseconds that the config takes.
const TIMES_MS: RangeInclusive<u32> = 1..=10_000;

impl Config {
    /// Checks every field against the bounds that it states.
    ///
    /// # Errors
    /// The first value that is outside the bounds its field states.
    pub fn check(&self) -> Result<(), Invalid> {
        if self.address.parse::<SocketAddr>().is_err() {
            let what = format!("`{}` is no address with a port", self.address);
            let remedy = "write the card's address such as 10.10.10.10:27181";
            return Err(Invalid::new("address", what, remedy));
        }
        self.check_card()
    }

    /// Checks everything but where the card is.
    pub(crate) fn check_card(&self) -> Result<(), Invalid> {
        within("encoders", self.encoders, 0..=CHANNELS)?;
        within("step_max_counts", self.step_max_counts, 1..=16_384)?;
        let outputs = if self.analog == Analog::Remote { REMOTE_OUTPUTS } else { CHANNELS };
        within("analog_channels", self.analog_channels, 1..=outputs.min(CHANNELS))?;
        within("serial_channel", self.serial_channel, 0..=6)?;
        within("pwm_hz", self.pwm_hz, 100..=200_000)?;
        within("period_us", self.period_us, 100..=100_000)?;
        within("wait_share", self.wait_share, 0.01..=0.9)?;
        within("lost_ms", self.lost_ms, 10..=10_000)?;
        within("watchdog_ms", self.watchdog_ms, TIMES_MS)?;
        within("remote_watchdog_ms", self.remote_watchdog_ms, TIMES_MS)?;
        within("open_wait_ms", self.open_wait_ms, TIMES_MS)?;
        for (place, line, outputs) in self.lines() {
            let range = match (line.at, outputs) {
                (Terminal::Pin, _) => PIN_NUMBERS,
                (Terminal::Field, false) => FIELD_INPUTS,
                (Terminal::Field, true) => FIELD_OUTPUTS,
            };
            within(&format!("{place}.number"), line.number, range)?;
        }
        Ok(())
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
            all.push(("lines_out.brake_release", &lines.brake_release, true));
            let feed = lines.watchdog_feed.iter();
            all.extend(feed.map(|line| ("lines_out.watchdog_feed", line, true)));
        }
        all
    }

    /// Whether a line stands at the field terminals.
    pub(crate) fn has_field_lines(&self) -> bool {
        self.lines().iter().any(|(_, line, _)| line.at == Terminal::Field)
    }
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
