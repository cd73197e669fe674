//! The configuration of a HostMot2 card as a machine file states it. Signs and scales are not part
//! of it: they belong to whoever knows what is wired.

use std::net::SocketAddr;
use std::ops::RangeInclusive;

use serde::Deserialize;
use taktil_hal::{CHANNELS, Invalid, Nanos};

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
        /// Which encoder module of the card they are at. Default `any`.
        pub encoder_kind: EncoderKind,
        /// Whether index pulses are wired to the encoders. Default true.
        pub index: bool,
        /// Highest step of a counter from one reading to the next (counts), 1 to 16384: a larger
        /// one is not believed. Default 16384.
        pub step_max_counts: i32 [1.0, 16384.0],
        /// What drives the motors. Default `7i77`.
        pub analog: Analog,
        /// Analog outputs wired: the channels of this half. Default 6.
        pub analog_channels: usize [1.0, CHANNELS as f64],
        /// Where each analog channel is, in the order of the channels. Default: the outputs of the
        /// first 7I77, then those of the next one; modulators from the first one on.
        pub outputs: Vec<OutputPlace>,
        /// The 7I77s behind the card. Default: one, at port 0, channel 0.
        pub remotes: Vec<RemotePlace>,
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
        /// Whether an answer is waited for by asking the socket again and again instead of
        /// sleeping: no wake-up is paid then, and the whole wait is processor time of the lane,
        /// whose CPU must be its own. Default false.
        pub busy_poll: bool,
        /// The UDP port of this host that speaks to the card; 0 for any that is free. Default 0.
        pub local_port: u16,
    }
}

taktil_hal::explained! {
    /// Where a 7I77 is connected.
    #[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct RemotePlace {
        /// The smart-serial port of the card. Default 0.
        pub port: usize [0.0, 3.0],
        /// The channel of the port at which the field terminals are; the analog outputs are the
        /// next one. Default 0.
        pub channel: usize [0.0, 6.0],
    }
}

taktil_hal::explained! {
    /// Where an analog channel is.
    #[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct OutputPlace {
        /// Which of `remotes`, counted from 0; 0 for a modulator. Default 0.
        #[serde(default)]
        pub remote: usize [0.0, 7.0],
        /// Which output of it, 0 to 5, or which modulator.
        pub output: usize [0.0, CHANNELS as f64],
    }
}

taktil_hal::explained! {
    /// Kinds of encoder modules, for a card that has both.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum EncoderKind {
        /// The first module of the card that has enough channels.
        #[default]
        Any,
        /// Three pins for each channel.
        Plain,
        /// Channels in pairs that share their pins, as those of a 7I77.
        Muxed,
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
        /// At the terminals of a 7I77, or at a pin of the card.
        pub at: Terminal,
        /// Number of the terminal, inputs 0 to 31 and outputs 0 to 15, or of the pin as the card
        /// counts them, 0 to 143; 0 for `spindle`. Default 0.
        #[serde(default)]
        pub number: u32 [0.0, 143.0],
        /// Which of `remotes`, counted from 0, for a line at a 7I77. Default 0.
        #[serde(default)]
        pub remote: usize [0.0, 7.0],
        /// Whether the line is low when it is true. A pin that the watchdog has released is pulled
        /// up by the card: an output there that must be off then is to be inverted. Default false.
        #[serde(default)]
        pub inverted: bool,
        /// Whether an output at a pin only pulls down and floats when it is high. Default false.
        #[serde(default)]
        pub open_drain: bool,
    }
}

impl Line {
    /// The line at a terminal of the first 7I77 or at a pin, high when it is true.
    #[must_use]
    pub fn at(at: Terminal, number: u32) -> Line {
        Line { at, number, remote: 0, inverted: false, open_drain: false }
    }
}

taktil_hal::explained! {
    /// Kinds of places of a line.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Terminal {
        /// The field terminals of a 7I77.
        Field,
        /// The spindle-enable output of a 7I77, an output alone: it lives with its analog outputs.
        Spindle,
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
            encoder_kind: EncoderKind::Any,
            index: true,
            step_max_counts: 16_384,
            analog: Analog::Remote,
            analog_channels: 6,
            outputs: Vec::new(),
            remotes: vec![RemotePlace::default()],
            pwm_hz: 20_000,
            lines_in: None,
            lines_out: None,
            period_us: 2_500,
            wait_share: 0.4,
            lost_ms: 200,
            watchdog_ms: 25,
            remote_watchdog_ms: 50,
            open_wait_ms: 200,
            busy_poll: false,
            local_port: 0,
        }
    }
}

/// How long a job may wait in a half of a card.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WaitBound {
    /// In a `sample`, the first one apart.
    pub sample: Nanos,
    /// In the very first `sample` of a card whose input lines stand at a 7I77's terminals.
    pub first_sample: Nanos,
    /// In a `commit` or `safe`, where smart serial has not finished the exchange before.
    pub commit: Nanos,
    /// The waits are processor time, not sleep.
    pub is_processor_time: bool,
}

/// Ports of smart serial that a card may have.
pub(crate) const SERIAL_PORTS_MAX: usize = 4;
/// 7I77s behind one card.
pub(crate) const REMOTES_MAX: usize = 8;
/// Modulators of a card.
const MODULATORS_MAX: usize = 32;
/// Readings of smart serial's command register before an exchange that follows another one within
/// the same cycle.
pub(crate) const COMMAND_READS_MAX: usize = 4;
/// Longest wait for smart serial before a write: its exchange takes some 100 us, and each look at
/// it a round trip.
const SETTLE_TIME: Nanos = Nanos::from_micros(600);

/// Volts at an analog output of a 7I77 for one code.
pub const REMOTE_VOLTS_PER_CODE: f64 = 10.0 / 4096.0;
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
        within("analog_channels", self.analog_channels, 1..=CHANNELS)?;
        self.check_remotes()?;
        self.check_outputs()?;
        within("pwm_hz", self.pwm_hz, 100..=200_000)?;
        within("period_us", self.period_us, 100..=100_000)?;
        within("wait_share", self.wait_share, 0.01..=0.9)?;
        within("lost_ms", self.lost_ms, 10..=10_000)?;
        within("watchdog_ms", self.watchdog_ms, TIMES_MS)?;
        within("remote_watchdog_ms", self.remote_watchdog_ms, TIMES_MS)?;
        within("open_wait_ms", self.open_wait_ms, TIMES_MS)?;
        for (place, line, is_output) in self.lines() {
            self.check_line(place, line, is_output)?;
        }
        Ok(())
    }

    fn check_remotes(&self) -> Result<(), Invalid> {
        if self.remotes.len() > REMOTES_MAX {
            let what = format!("{} are configured", self.remotes.len());
            return Err(Invalid::new("remotes", what, format!("at most {REMOTES_MAX} are known")));
        }
        for (index, remote) in self.remotes.iter().enumerate() {
            within(&format!("remotes[{index}].port"), remote.port, 0..=SERIAL_PORTS_MAX - 1)?;
            within(&format!("remotes[{index}].channel"), remote.channel, 0..=6)?;
            let overlaps = |other: &RemotePlace| {
                other.port == remote.port && other.channel.abs_diff(remote.channel) < 2
            };
            if self.remotes[..index].iter().any(overlaps) {
                let place = format!("remotes[{index}].channel");
                let what = "a 7I77 takes two channels, and another one has one of these";
                return Err(Invalid::new(place, what, "give each 7I77 channels of its own"));
            }
        }
        Ok(())
    }

    fn check_outputs(&self) -> Result<(), Invalid> {
        let is_remote = self.analog == Analog::Remote;
        if self.outputs.is_empty() {
            let outputs = self.remotes.len() * REMOTE_OUTPUTS;
            if is_remote && self.analog_channels > outputs {
                let what = format!("{} are more than the 7I77s have", self.analog_channels);
                let remedy = format!("give 1 to {outputs}, or add a 7I77 to `remotes`");
                return Err(Invalid::new("analog_channels", what, remedy));
            }
            return Ok(());
        }
        if self.outputs.len() != self.analog_channels {
            let (has, wants) = (self.outputs.len(), self.analog_channels);
            let what = format!("{has} places are given for {wants} analog channels");
            return Err(Invalid::new("outputs", what, "give one for each channel, or none"));
        }
        let outputs = if is_remote { REMOTE_OUTPUTS } else { MODULATORS_MAX };
        for (index, place) in self.outputs.iter().enumerate() {
            self.check_remote(&format!("outputs[{index}]"), place.remote, is_remote)?;
            within(&format!("outputs[{index}].output"), place.output, 0..=outputs - 1)?;
            if self.outputs[..index].contains(place) {
                let what = "it is the output of another channel";
                let at = format!("outputs[{index}]");
                return Err(Invalid::new(at, what, "give each channel an output of its own"));
            }
        }
        Ok(())
    }

    /// Refuses the number of a 7I77 that is not there.
    fn check_remote(&self, place: &str, remote: usize, is_remote: bool) -> Result<(), Invalid> {
        let count = if is_remote { self.remotes.len() } else { 1 };
        if remote < count {
            return Ok(());
        }
        let what = format!("there is no 7I77 of number {remote}");
        let remedy = format!("`remotes` lists {count}, counted from 0");
        Err(Invalid::new(format!("{place}.remote"), what, remedy))
    }

    fn check_line(&self, place: &str, line: &Line, is_output: bool) -> Result<(), Invalid> {
        let range = match (line.at, is_output) {
            (Terminal::Pin, _) => PIN_NUMBERS,
            (Terminal::Field, false) => FIELD_INPUTS,
            (Terminal::Field, true) => FIELD_OUTPUTS,
            (Terminal::Spindle, true) => 0..=0,
            (Terminal::Spindle, false) => {
                let what = "the spindle-enable output of a 7I77 is no input";
                let remedy = "give a field terminal or a pin";
                return Err(Invalid::new(format!("{place}.at"), what, remedy));
            }
        };
        within(&format!("{place}.number"), line.number, range)?;
        self.check_remote(place, line.remote, line.at != Terminal::Pin)?;
        if line.open_drain && !(is_output && line.at == Terminal::Pin) {
            let what = "only an output at a pin can be open drain";
            return Err(Invalid::new(format!("{place}.open_drain"), what, "leave it out"));
        }
        Ok(())
    }

    /// Where each analog channel is.
    pub(crate) fn output_places(&self) -> Vec<OutputPlace> {
        if !self.outputs.is_empty() {
            return self.outputs.clone();
        }
        let is_remote = self.analog == Analog::Remote;
        let each = if is_remote { REMOTE_OUTPUTS } else { MODULATORS_MAX };
        let place = |channel| OutputPlace { remote: channel / each, output: channel % each };
        (0..self.analog_channels).map(place).collect()
    }

    /// How long a job may wait in a half, for whoever analyses the schedule.
    #[must_use]
    pub fn wait_bound(&self) -> WaitBound {
        let sample = Nanos((f64::from(self.period_us) * 1e3 * self.wait_share) as i64);
        let repeats = if self.reads_field() { COMMAND_READS_MAX as i64 } else { 0 };
        let is_serial = self.analog == Analog::Remote || self.has_remote_lines();
        WaitBound {
            sample,
            first_sample: sample * (1 + repeats),
            commit: if is_serial { sample.min(SETTLE_TIME) } else { Nanos::ZERO },
            is_processor_time: self.busy_poll,
        }
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

    /// Whether a line stands at such a place.
    pub(crate) fn has_lines_at(&self, at: Terminal) -> bool {
        self.lines().iter().any(|(_, line, _)| line.at == at)
    }

    /// Whether a line from the cell stands at the field terminals.
    pub(crate) fn reads_field(&self) -> bool {
        let lines = self.lines();
        lines.iter().any(|(_, line, output)| !output && line.at == Terminal::Field)
    }

    /// Whether a line stands at a 7I77.
    pub(crate) fn has_remote_lines(&self) -> bool {
        self.lines().iter().any(|(_, line, _)| line.at != Terminal::Pin)
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
