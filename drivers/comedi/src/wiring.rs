//! Finds what a configuration asks for on a board, before anything is written. What the board does
//! not have is refused with the place of the channel that wants it.

use nix::errno::Errno;
use taktil_hal::{Invalid, OpenError};

use crate::board::{Board, ChannelInfo, DeviceInfo, SubdeviceInfo};
use crate::codes::{Scale, counter_bits, fitting_range};
use crate::config::{AnalogChannel, Config, EncoderChannel, Level, Line, Reference};
use crate::error;
use crate::uapi;

/// Lines that one instruction reaches.
const BANK_LINES: u16 = 32;

/// A counter that serves a joint.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Counter {
    pub(crate) subdevice: u32,
    pub(crate) channel_word: u32,
    pub(crate) maxdata: u32,
    pub(crate) bits: u32,
}

/// A channel of a converter.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Converter {
    pub(crate) subdevice: u32,
    pub(crate) channel_word: u32,
    pub(crate) scale: Scale,
}

/// A digital line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DigitalLine {
    pub(crate) subdevice: u32,
    pub(crate) channel: u16,
    pub(crate) is_inverted: bool,
    /// The line's direction has to be set.
    pub(crate) has_direction: bool,
}

impl DigitalLine {
    /// The channel from which an instruction counts the lines: 0 for all boards with up to 32.
    pub(crate) fn bank(self) -> u16 {
        self.channel - self.channel % BANK_LINES
    }

    /// The line's bit in the word of its bank.
    pub(crate) fn bit(self) -> u32 {
        1 << (self.channel % BANK_LINES)
    }
}

/// All that a configuration asks for, found.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wiring {
    pub(crate) counters: Vec<Counter>,
    pub(crate) analog_out: Vec<Converter>,
    pub(crate) analog_in: Vec<Converter>,
    pub(crate) gauges: Vec<Converter>,
    /// Drive power and both channels of the emergency stop, or none.
    pub(crate) lines_in: Vec<DigitalLine>,
    /// Enable, brake release and feed, or none.
    pub(crate) lines_out: Vec<DigitalLine>,
}

impl Wiring {
    /// Finds all halves.
    pub(crate) fn find(board: &dyn Board, config: &Config) -> Result<Wiring, OpenError> {
        let mut survey = Survey::new(board, config)?;
        let mut wiring = survey.outputs(config)?;
        for (at, channel) in config.encoders.iter().enumerate() {
            wiring.counters.push(survey.counter(&format!("encoders[{at}]"), channel)?);
        }
        wiring.analog_in = survey.converters("analog_in", &config.analog_in, &ANALOG_IN)?;
        wiring.gauges = survey.converters("force_torque", &config.force_torque, &ANALOG_IN)?;
        if let Some(lines) = &config.lines_in {
            for (name, line) in [
                ("drive_power", &lines.drive_power),
                ("estop_a_closed", &lines.estop_a_closed),
                ("estop_b_closed", &lines.estop_b_closed),
            ] {
                let place = format!("lines_in.{name}");
                let found = survey.line(&place, line, &DIGITAL_IN)?;
                refuse_repeated_line(&place, found, &wiring.lines_out)?;
                wiring.lines_in.push(found);
            }
        }
        Ok(wiring)
    }

    /// Finds the outputs alone, for whoever makes a board safe.
    pub(crate) fn find_outputs(board: &dyn Board, config: &Config) -> Result<Wiring, OpenError> {
        Survey::new(board, config)?.outputs(config)
    }

    /// The subdevices that are used, each once, in order.
    pub(crate) fn subdevices(&self) -> Vec<u32> {
        let converters = self.analog_out.iter().chain(&self.analog_in).chain(&self.gauges);
        let lines = self.lines_in.iter().chain(&self.lines_out);
        let mut all: Vec<u32> = self.counters.iter().map(|counter| counter.subdevice).collect();
        all.extend(converters.map(|converter| converter.subdevice));
        all.extend(lines.map(|line| line.subdevice));
        all.sort_unstable();
        all.dedup();
        all
    }
}

/// What kinds of subdevices serve a purpose, the preferred one first, and its name.
struct Purpose {
    kinds: &'static [u32],
    name: &'static str,
}

const ANALOG_IN: Purpose = Purpose { kinds: &[uapi::ANALOG_IN_KIND], name: "analog input" };
const ANALOG_OUT: Purpose = Purpose { kinds: &[uapi::ANALOG_OUT_KIND], name: "analog output" };
const COUNTER: Purpose = Purpose { kinds: &[uapi::COUNTER_KIND], name: "counter" };
const DIGITAL_IN: Purpose =
    Purpose { kinds: &[uapi::DIGITAL_IN_KIND, uapi::DIGITAL_IO_KIND], name: "digital input" };
const DIGITAL_OUT: Purpose =
    Purpose { kinds: &[uapi::DIGITAL_OUT_KIND, uapi::DIGITAL_IO_KIND], name: "digital output" };

/// A board that is being looked at.
struct Survey<'a> {
    board: &'a dyn Board,
    path: &'a str,
    device: DeviceInfo,
    subdevices: Vec<SubdeviceInfo>,
}

impl<'a> Survey<'a> {
    fn new(board: &'a dyn Board, config: &'a Config) -> Result<Survey<'a>, OpenError> {
        config.check()?;
        let path = config.path.as_str();
        let failed = |action: &str, errno: Errno| error::from_errno(path, action, errno);
        let device = board.device_info().map_err(|errno| failed("asking for the board", errno))?;
        if let Some(wanted) = &config.board
            && *wanted != device.board
            && *wanted != device.driver
        {
            let what =
                format!("driver `{}` with board `{}` is attached", device.driver, device.board);
            let remedy = format!("attach `{wanted}` to {path}, or correct the key");
            return Err(Invalid::new("board", what, remedy).into());
        }
        let subdevices =
            board.subdevices().map_err(|errno| failed("asking for the subdevices", errno))?;
        Ok(Survey { board, path, device, subdevices })
    }

    fn failed(&self, action: &str, errno: Errno) -> OpenError {
        error::from_errno(self.path, action, errno)
    }

    fn outputs(&mut self, config: &Config) -> Result<Wiring, OpenError> {
        let mut wiring = Wiring {
            analog_out: self.converters("analog_out", &config.analog_out, &ANALOG_OUT)?,
            ..Wiring::default()
        };
        check_analog_out(&wiring.analog_out)?;
        if let Some(lines) = &config.lines_out {
            for (name, line) in [
                ("enable", &lines.enable),
                ("brake_release", &lines.brake_release),
                ("watchdog_feed", &lines.watchdog_feed),
            ] {
                let place = format!("lines_out.{name}");
                let found = self.line(&place, line, &DIGITAL_OUT)?;
                refuse_repeated_line(&place, found, &wiring.lines_out)?;
                wiring.lines_out.push(found);
            }
        }
        Ok(wiring)
    }

    /// The subdevice that a channel names, or the first one that serves the purpose.
    fn subdevice(
        &self,
        place: &str,
        wanted: Option<u32>,
        purpose: &Purpose,
    ) -> Result<u32, Invalid> {
        let place = format!("{place}.subdevice");
        let Some(number) = wanted else {
            let of = |kind: &u32| self.subdevices.iter().position(|found| found.kind == *kind);
            let found = purpose.kinds.iter().find_map(of);
            return found.map(|number| number as u32).ok_or_else(|| {
                let what = format!("board `{}` has no {}", self.device.board, purpose.name);
                Invalid::new(place, what, "take it from another board, or leave the half out")
            });
        };
        let Some(found) = self.subdevices.get(number as usize) else {
            let what = format!("{number} is beyond the board's {}", self.subdevices.len());
            return Err(Invalid::new(place, what, "count subdevices from 0"));
        };
        if !purpose.kinds.contains(&found.kind) {
            let what = format!("subdevice {number} is {}, not {}", found.kind_name(), purpose.name);
            return Err(Invalid::new(place, what, "name another one, or leave the key out"));
        }
        Ok(number)
    }

    fn channel(&self, place: &str, subdevice: u32, channel: u16) -> Result<ChannelInfo, OpenError> {
        let channels = self.board.channels(subdevice).map_err(|errno| {
            self.failed(&format!("asking for the channels of subdevice {subdevice}"), errno)
        })?;
        channels.get(usize::from(channel)).copied().ok_or_else(|| {
            let what = format!(
                "subdevice {subdevice} has no channel {channel}, it has {}",
                channels.len()
            );
            Invalid::new(format!("{place}.channel"), what, "count channels from 0").into()
        })
    }

    fn counter(&self, place: &str, wanted: &EncoderChannel) -> Result<Counter, OpenError> {
        let subdevice = self.subdevice(place, wanted.subdevice, &COUNTER)?;
        let ChannelInfo { maxdata, .. } = self.channel(place, subdevice, wanted.channel)?;
        let Some(bits) = counter_bits(maxdata) else {
            let what = format!("the counter goes to {maxdata}, which is no whole 8 to 32 bits");
            return Err(Invalid::new(place, what, "name a channel that counts").into());
        };
        let channel_word = uapi::channel_word(wanted.channel, 0, 0);
        Ok(Counter { subdevice, channel_word, maxdata, bits })
    }

    fn converters(
        &self,
        list: &str,
        wanted: &[AnalogChannel],
        purpose: &Purpose,
    ) -> Result<Vec<Converter>, OpenError> {
        let numbered = wanted.iter().enumerate();
        numbered.map(|(at, one)| self.converter(&format!("{list}[{at}]"), one, purpose)).collect()
    }

    fn converter(
        &self,
        place: &str,
        wanted: &AnalogChannel,
        purpose: &Purpose,
    ) -> Result<Converter, OpenError> {
        let subdevice = self.subdevice(place, wanted.subdevice, purpose)?;
        let ChannelInfo { maxdata, range_type } = self.channel(place, subdevice, wanted.channel)?;
        let reference = self.reference(place, subdevice, wanted.reference)?;
        let ranges = self.board.ranges(range_type).map_err(|errno| {
            self.failed(&format!("asking for the ranges of subdevice {subdevice}"), errno)
        })?;
        let (low_v, high_v) = (wanted.low_v, wanted.high_v);
        let Some((number, range)) = fitting_range(&ranges, low_v, high_v) else {
            let offered: Vec<String> = ranges.iter().map(range_text).collect();
            let what = format!("no range holds {low_v} to {high_v} V");
            let remedy = format!("set `low_v` and `high_v` to fit one of: {}", offered.join(", "));
            return Err(Invalid::new(place, what, remedy).into());
        };
        let Some(scale) = Scale::new(range, maxdata, wanted.gain, wanted.offset_codes) else {
            let what = format!("samples to {maxdata} over this range are no codes of 32 bits");
            return Err(Invalid::new(place, what, "take another range").into());
        };
        let channel_word = uapi::channel_word(wanted.channel, number, reference);
        Ok(Converter { subdevice, channel_word, scale })
    }

    fn reference(&self, place: &str, subdevice: u32, wanted: Reference) -> Result<u8, Invalid> {
        let number = match wanted {
            Reference::Ground => 0,
            Reference::Common => 1,
            Reference::Differential => 2,
            Reference::Other => 3,
        };
        let flags = self.subdevices[subdevice as usize].flags;
        // Some drivers of the kernel say nothing of references.
        let says_nothing = uapi::REFERENCE_FLAGS.iter().all(|flag| flags & flag == 0);
        if says_nothing || flags & uapi::REFERENCE_FLAGS[usize::from(number)] != 0 {
            return Ok(number);
        }
        let what = format!("subdevice {subdevice} cannot take this reference");
        Err(Invalid::new(format!("{place}.reference"), what, "take another one"))
    }

    fn line(
        &self,
        place: &str,
        wanted: &Line,
        purpose: &Purpose,
    ) -> Result<DigitalLine, OpenError> {
        let subdevice = self.subdevice(place, wanted.subdevice, purpose)?;
        self.channel(place, subdevice, wanted.channel)?;
        Ok(DigitalLine {
            subdevice,
            channel: wanted.channel,
            is_inverted: wanted.active == Level::Low,
            has_direction: self.subdevices[subdevice as usize].kind == uapi::DIGITAL_IO_KIND,
        })
    }
}

fn range_text(range: &crate::board::Range) -> String {
    let volts = |millionths: i32| f64::from(millionths) * 1e-6;
    let unit = match range.flags & uapi::UNIT_MASK_BITS {
        _ if range.flags & uapi::EXTERNAL_REFERENCE_FLAG != 0 => "of an external reference",
        uapi::VOLTS_UNIT => "V",
        1 => "mA",
        _ => "without unit",
    };
    format!("{} to {} {unit}", volts(range.min_millionths), volts(range.max_millionths))
}

/// Outputs need zero volts, a common range, and each its own channel.
fn check_analog_out(channels: &[Converter]) -> Result<(), Invalid> {
    const PORT_MASK_BITS: u32 = 0xffff;
    for (at, channel) in channels.iter().enumerate() {
        let place = format!("analog_out[{at}]");
        if !channel.scale.has_zero() {
            let what = "the range does not hold 0 V, which is the safe value";
            return Err(Invalid::new(place, what, "set `low_v` to 0 or below, `high_v` above"));
        }
        let port = |other: &Converter| (other.subdevice, other.channel_word & PORT_MASK_BITS);
        if let Some(before) = channels[..at].iter().position(|other| port(other) == port(channel)) {
            let what = format!("is the channel of analog_out[{before}] too");
            return Err(Invalid::new(place, what, "give each output a channel of its own"));
        }
        let [low, high] = common_codes(&channels[..=at]);
        if low >= high {
            let what = "the range has no code but 0 in common with the outputs before it";
            return Err(Invalid::new(place, what, "take ranges of one sign for all outputs"));
        }
    }
    Ok(())
}

/// Lowest and highest code that every converter takes.
pub(crate) fn common_codes(channels: &[Converter]) -> [i32; 2] {
    channels.iter().fold([i32::MIN, i32::MAX], |[low, high], channel| {
        [low.max(channel.scale.low()), high.min(channel.scale.high())]
    })
}

/// Lowest and highest code that any converter gives.
pub(crate) fn all_codes(channels: &[Converter]) -> [i32; 2] {
    channels.iter().fold([i32::MAX, i32::MIN], |[low, high], channel| {
        [low.min(channel.scale.low()), high.max(channel.scale.high())]
    })
}

fn refuse_repeated_line(
    place: &str,
    line: DigitalLine,
    others: &[DigitalLine],
) -> Result<(), Invalid> {
    let port = |line: &DigitalLine| (line.subdevice, line.channel);
    if others.iter().all(|other| port(other) != port(&line)) {
        return Ok(());
    }
    let what = format!(
        "channel {} of subdevice {} is an output line already",
        line.channel, line.subdevice
    );
    Err(Invalid::new(place, what, "give each line a channel of its own"))
}
