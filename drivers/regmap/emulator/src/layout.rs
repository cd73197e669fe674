//! The places of a board's registers, as its description states them, and how codes stand in them.
//! Read from the text anew: nothing is shared with the driver.

use taktil_hal::Invalid;

use crate::text::{Section, Text};

/// A word on the bus and what it has to be.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fixed {
    pub(crate) offset: usize,
    pub(crate) value: u64,
}

/// How a code is written in bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Coding {
    Offset,
    Twos,
    Straight,
}

/// A row of values.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row {
    pub(crate) offset: usize,
    pub(crate) channels: usize,
    pub(crate) stride: usize,
    pub(crate) words: usize,
    pub(crate) bits: u32,
    pub(crate) shift: u32,
    pub(crate) coding: Coding,
    pub(crate) inverted: bool,
    /// Registers of the number before and after the values.
    pub(crate) numbers: Option<Numbers>,
}

/// Registers of the number under which values are published.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Numbers {
    pub(crate) begin: usize,
    pub(crate) end: usize,
}

/// A register whose writing is an event.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Event {
    pub(crate) offset: usize,
    /// The value that is written each time; `None` for numbers that change.
    pub(crate) value: Option<u64>,
}

/// Bits that read so while something is under way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Busy {
    pub(crate) offset: usize,
    pub(crate) mask: u64,
    pub(crate) value: u64,
}

/// What is read after an event, when it is done.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Inputs {
    pub(crate) row: Row,
    pub(crate) start: Option<Event>,
    pub(crate) busy: Option<Busy>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Outputs {
    pub(crate) row: Row,
    pub(crate) safe_code: i64,
    pub(crate) strobe: Option<Event>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Watchdog {
    pub(crate) offset: usize,
    pub(crate) unit_us: i64,
    pub(crate) kick: Option<Event>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Index {
    pub(crate) row: Row,
    pub(crate) seen: usize,
    pub(crate) feature: Option<Fixed>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct LinesIn {
    pub(crate) offset: usize,
    pub(crate) power: u32,
    pub(crate) stop_a: u32,
    pub(crate) stop_b: u32,
    pub(crate) inverted: u64,
    /// The lowest bit of the beat, and how many bits it has.
    pub(crate) beat: Option<Beat>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Beat {
    pub(crate) shift: u32,
    pub(crate) bits: u32,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct LinesOut {
    pub(crate) offset: usize,
    pub(crate) enable: u32,
    pub(crate) brake: u32,
    pub(crate) feed: u32,
    pub(crate) inverted: u64,
}

/// The registers of a board.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    pub(crate) bus: Bus,
    pub(crate) length: usize,
    pub(crate) fixed: Vec<Fixed>,
    pub(crate) watchdog: Option<Watchdog>,
    pub(crate) outputs: Option<Outputs>,
    pub(crate) encoders: Option<Inputs>,
    pub(crate) index: Option<Index>,
    pub(crate) analog: Option<Inputs>,
    pub(crate) gauges: Option<Inputs>,
    pub(crate) tactile: Option<Row>,
    pub(crate) lines_in: Option<LinesIn>,
    pub(crate) lines_out: Option<LinesOut>,
}

/// How words stand on the bus.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bus {
    pub(crate) bytes: usize,
    pub(crate) big: bool,
    pub(crate) high_first: bool,
    pub(crate) stride: usize,
}

impl Bus {
    /// The number of words that a register can hold.
    pub(crate) fn modulus(&self) -> u64 {
        1 << (8 * self.bytes)
    }

    fn all_ones(&self) -> u64 {
        self.modulus() - 1
    }

    fn row(&self, section: &mut Section, channels: Option<usize>) -> Result<Row, Invalid> {
        let (bits, shift): (u32, u32) = (section.number("bits")?, section.number_or("shift", 0)?);
        if !(1..=32).contains(&bits) || shift > 32 - bits {
            return Err(Invalid::new("bits", "do not fit 32 with those below", "correct them"));
        }
        let (mut needed, mut room) = (1, 8 * self.bytes as u64);
        while room < u64::from(bits) + u64::from(shift) && room < 64 {
            (needed, room) = (needed + 1, room + 8 * self.bytes as u64);
        }
        let words = section.number_or("words", needed)?;
        let words_of_format = ["offset-binary", "twos-complement", "straight-binary"];
        let coding = match section.word("format", &words_of_format)? {
            Some(0) => Coding::Offset,
            Some(1) => Coding::Twos,
            _ => Coding::Straight,
        };
        Ok(Row {
            offset: section.number("offset")?,
            channels: channels.map_or_else(|| section.number("channels"), Ok)?,
            stride: section.number_or("channel_stride_bytes", words * self.stride)?,
            words,
            bits,
            shift,
            coding,
            inverted: section.truth("inverted")?,
            numbers: numbers(section)?,
        })
    }

    fn busy(&self, section: &mut Section) -> Result<Option<Busy>, Invalid> {
        let mask = section.number_or("busy_mask", self.all_ones() as i64)? as u64;
        let value = section.number_or("busy_value", mask as i64)? as u64;
        section.skip("polls");
        let offset = section.optional("busy_offset")?;
        Ok(offset.map(|offset| Busy { offset, mask, value }))
    }
}

fn numbers(section: &mut Section) -> Result<Option<Numbers>, Invalid> {
    let (begin, end) = (section.optional("begin_offset")?, section.optional("end_offset")?);
    Ok(begin.zip(end).map(|(begin, end)| Numbers { begin, end }))
}

/// A register of an event: of the same value each time, or of changing numbers.
fn event(section: &mut Section, name: &str) -> Result<Option<Event>, Invalid> {
    let counts = section.word(name, &["value", "count"])? == Some(1);
    let value: i64 = section.number_or(&format!("{name}_value"), 1)?;
    let offset = section.optional(&format!("{name}_offset"))?;
    let value = if counts { None } else { Some(value as u64) };
    Ok(offset.map(|offset| Event { offset, value }))
}

impl Layout {
    /// Reads a description.
    pub(crate) fn parse(text: &str) -> Result<Layout, Invalid> {
        let mut text = Text::parse(text)?;
        let mut head = text.take("").pop().unwrap_or_default();
        head.skip("name");
        let bits: usize = head.number("bus_bits")?;
        if ![8, 16, 32].contains(&bits) {
            return Err(Invalid::new("bus_bits", "is no width of a bus", "give 8, 16 or 32"));
        }
        let big = head.word("byte_order", &["little", "big"])? == Some(1);
        let order = head.word("word_order", &["low-first", "high-first"])?;
        let bytes = bits / 8;
        let stride = head.number_or("stride_bytes", bytes)?;
        let high_first = order.map_or(big, |at| at == 1);
        let bus = Bus { bytes, big, high_first, stride };
        let length = head.number("length_bytes")?;
        head.finish()?;
        let fixed = fixed(&mut text, &bus)?;
        for mut section in text.take("setup") {
            section.skip("offset");
            section.skip("value");
            section.finish()?;
        }
        let mut layout = Layout {
            bus,
            length,
            fixed,
            watchdog: None,
            outputs: None,
            encoders: None,
            index: None,
            analog: None,
            gauges: None,
            tactile: None,
            lines_in: None,
            lines_out: None,
        };
        layout.read_converters(&mut text)?;
        layout.read_counters(&mut text)?;
        layout.read_rest(&mut text)?;
        text.finish()?;
        Ok(layout)
    }

    fn read_converters(&mut self, text: &mut Text) -> Result<(), Invalid> {
        for name in ["analog_in", "force_torque"] {
            let Some(mut section) = text.take(name).pop() else { continue };
            for key in ["low_v", "high_v", "unused_zero", "start_by"] {
                section.skip(key);
            }
            let row = self.bus.row(&mut section, None)?;
            let start = event(&mut section, "start")?;
            let inputs = Inputs { row, start, busy: self.bus.busy(&mut section)? };
            section.finish()?;
            *if name == "analog_in" { &mut self.analog } else { &mut self.gauges } = Some(inputs);
        }
        if let Some(mut section) = text.take("analog_out").pop() {
            for key in ["low_v", "high_v", "read_back"] {
                section.skip(key);
            }
            let row = self.bus.row(&mut section, None)?;
            let safe_code = section.number_or("safe_code", 0)?;
            let strobe = event(&mut section, "strobe")?;
            section.finish()?;
            self.outputs = Some(Outputs { row, safe_code, strobe });
        }
        Ok(())
    }

    fn read_counters(&mut self, text: &mut Text) -> Result<(), Invalid> {
        let Some(mut section) = text.take("encoders").pop() else { return Ok(()) };
        section.skip("hold");
        section.skip("step_max_counts");
        let row = self.bus.row(&mut section, None)?;
        let start = event(&mut section, "latch")?;
        let inputs = Inputs { row, start, busy: self.bus.busy(&mut section)? };
        section.finish()?;
        self.encoders = Some(inputs);
        let Some(mut section) = text.take("index").pop() else { return Ok(()) };
        let offset = section.number("offset")?;
        let stride = section.number_or("channel_stride_bytes", row.words * self.bus.stride)?;
        let row = Row { offset, stride, numbers: numbers(&mut section)?, ..row };
        let seen = section.number("seen_offset")?;
        let value = section.number_or("feature_mask", 1_i64)? as u64;
        let feature = section.optional("feature_offset")?;
        let feature = feature.map(|offset| Fixed { offset, value });
        section.finish()?;
        self.index = Some(Index { row, seen, feature });
        Ok(())
    }

    fn read_rest(&mut self, text: &mut Text) -> Result<(), Invalid> {
        if let Some(mut section) = text.take("tactile").pop() {
            section.skip("scan_us");
            let (rows, cols): (usize, usize) = (section.number("rows")?, section.number("cols")?);
            self.tactile = Some(self.bus.row(&mut section, Some(rows * cols))?);
            section.finish()?;
        }
        if let Some(mut section) = text.take("watchdog").pop() {
            let kick = event(&mut section, "kick")?;
            let unit_us = section.number_or("unit_us", 1_000)?;
            self.watchdog = Some(Watchdog { offset: section.number("offset")?, unit_us, kick });
            section.finish()?;
        }
        if let Some(mut section) = text.take("digital_in").pop() {
            section.skip("zero_mask");
            let bits = section.number_or("beat_bits", 8)?;
            let shift = section.optional("beat_shift")?;
            self.lines_in = Some(LinesIn {
                offset: section.number("offset")?,
                power: section.number("drive_power_bit")?,
                stop_a: section.number("estop_a_bit")?,
                stop_b: section.number("estop_b_bit")?,
                inverted: section.number_or("inverted_mask", 0_i64)? as u64,
                beat: shift.map(|shift| Beat { shift, bits }),
            });
            section.finish()?;
        }
        if let Some(mut section) = text.take("digital_out").pop() {
            self.lines_out = Some(LinesOut {
                offset: section.number("offset")?,
                enable: section.number("enable_bit")?,
                brake: section.number("brake_release_bit")?,
                feed: section.number("watchdog_feed_bit")?,
                inverted: section.number_or("inverted_mask", 0_i64)? as u64,
            });
            section.finish()?;
        }
        Ok(())
    }
}

/// Registers that always read the same.
fn fixed(text: &mut Text, bus: &Bus) -> Result<Vec<Fixed>, Invalid> {
    let mut all = Vec::new();
    let sections = text.take("identity").into_iter().chain(text.take("presence"));
    for mut section in sections {
        section.skip("register");
        let mask = section.number_or("mask", bus.all_ones() as i64)? as u64;
        let value = section.number::<i64>("value")? as u64 & mask;
        all.push(Fixed { offset: section.number("offset")?, value });
        section.finish()?;
    }
    Ok(all)
}

impl Row {
    fn codes(&self) -> i64 {
        1 << self.bits
    }

    /// What the lowest code is.
    fn lowest(&self) -> i64 {
        if self.coding == Coding::Straight { 0 } else { -self.codes() / 2 }
    }

    /// All bits of the registers of a code, which is taken to the nearest one in range.
    pub(crate) fn encode(&self, code: i64) -> u64 {
        let code = code.clamp(self.lowest(), self.lowest() + self.codes() - 1);
        self.place(match self.coding {
            Coding::Offset => code + self.codes() / 2,
            Coding::Twos | Coding::Straight => code.rem_euclid(self.codes()),
        })
    }

    /// All bits of the registers of a count, which wraps.
    pub(crate) fn encode_count(&self, count: i64) -> u64 {
        self.place(count.rem_euclid(self.codes()))
    }

    fn place(&self, steps: i64) -> u64 {
        let steps = if self.inverted { self.codes() - 1 - steps } else { steps };
        steps.cast_unsigned() << self.shift
    }

    /// The code in all bits of the registers.
    pub(crate) fn decode(&self, whole: u64) -> i64 {
        let steps = ((whole >> self.shift) % self.codes().cast_unsigned()).cast_signed();
        let steps = if self.inverted { self.codes() - 1 - steps } else { steps };
        match self.coding {
            Coding::Offset => steps - self.codes() / 2,
            Coding::Twos if steps >= self.codes() / 2 => steps - self.codes(),
            Coding::Twos | Coding::Straight => steps,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_of_data_sheets() {
        let row = |format: &str| {
            let text = format!("offset = 0\nchannels = 1\nbits = 12\nshift = 4\n{format}");
            let mut section = Text::parse(&text).unwrap().take("").pop().unwrap();
            let bus = Bus { bytes: 2, big: true, high_first: true, stride: 2 };
            bus.row(&mut section, None).unwrap()
        };
        let offset = row("format = \"offset-binary\"");
        assert_eq!([-2048, 0, 2047, 9999].map(|c| offset.encode(c)), [0, 0x8000, 0xfff0, 0xfff0]);
        let twos = row("format = \"twos-complement\"\ninverted = true");
        assert_eq!([-2048, -1, 0, 2047].map(|c| twos.encode(c)), [0x7ff0, 0, 0xfff0, 0x8000]);
        for code in -2048..2048 {
            assert_eq!(offset.decode(offset.encode(code)), code);
            assert_eq!(twos.decode(twos.encode(code)), code);
        }
    }
}
