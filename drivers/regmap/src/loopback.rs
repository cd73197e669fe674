//! A model of the board behind its registers, advanced by a test: A/D channel n reads what D/A
//! channel n puts out, the watchdogs act, and blocks are published under their numbers. It is no
//! model of a robot: encoders, gauges and lines show what the test sets.

use std::sync::Arc;

use taktil_hal::{
    CHANNELS, Counts, DacCode, FORCE_TORQUE_CHANNELS, IndexPulses, Invalid, LinesIn, LinesOut,
    Nanos,
};

use crate::codes::Codec;
use crate::config::Config;
use crate::io::RegisterFile;
use crate::registers::{
    ADC, Block, DAC, DAC_STROBE, DIGITAL_IN, DIGITAL_OUT, ENCODERS, FEATURE_INDEX, FEATURES,
    FORCE_TORQUE, ID, ID_VALUE, IN_BEAT_SHIFT, IN_DRIVE_POWER, IN_ESTOP_A_CLOSED,
    IN_ESTOP_B_CLOSED, INDEX, LAYOUT_CHANNELS, OUT_BRAKE_RELEASE, OUT_ENABLE, OUT_WATCHDOG_FEED,
    TACTILE, VERSION, VERSION_VALUE, WATCHDOG_MS,
};

/// The watchdog of one group of outputs: a change of its word is a sign of life.
#[derive(Debug)]
struct Watchdog {
    seen: u16,
    /// When the last change was seen; `None` until the first: outputs are safe from power-up on.
    alive: Option<Nanos>,
}

impl Watchdog {
    fn tick(&mut self, now: Nanos, sign: u16, silence: Nanos) -> bool {
        if sign != self.seen {
            self.seen = sign;
            self.alive = Some(now);
        }
        // A silence of 0 is a watchdog that nobody has set: it keeps the outputs safe.
        self.alive.is_some_and(|alive| silence > Nanos::ZERO && now - alive <= silence)
    }
}

/// The board's own side of the registers.
///
/// A tick and a `commit` at the same moment from two threads may mix words of two commits for one
/// tick, which a board with double-buffered converters would not.
#[derive(Debug)]
pub struct Loopback {
    registers: Arc<RegisterFile>,
    dac: Codec,
    adc: Codec,
    gauge: Codec,
    dac_to_adc_shift: i32,
    dac_watchdog: Watchdog,
    line_watchdog: Watchdog,
    volts: [DacCode; CHANNELS],
    lines_out: LinesOut,
    counts: [i32; CHANNELS],
    counter_bits: u32,
    marks: IndexPulses,
    gauges: [i32; FORCE_TORQUE_CHANNELS],
    lines_in: LinesIn,
    number: u16,
    frame_number: u16,
}

impl Loopback {
    /// Powers the board up: outputs safe, counts 0, no frame, cell powered and emergency stop
    /// closed. `config.path` is not looked at.
    ///
    /// # Errors
    /// The config is refused.
    pub fn new(registers: Arc<RegisterFile>, config: &Config) -> Result<Loopback, Invalid> {
        config.check_board()?;
        registers.write(VERSION, VERSION_VALUE);
        registers.write(WATCHDOG_MS, 0);
        registers.write(ID, ID_VALUE);
        Ok(Loopback {
            dac: Codec::offset_binary(config.dac_bits),
            adc: Codec::offset_binary(config.adc_bits),
            gauge: Codec::offset_binary(config.gauge_bits),
            dac_to_adc_shift: config.adc_bits as i32 - config.dac_bits as i32,
            dac_watchdog: Watchdog { seen: registers.read(DAC_STROBE), alive: None },
            line_watchdog: Watchdog {
                seen: registers.read(DIGITAL_OUT) & OUT_WATCHDOG_FEED,
                alive: None,
            },
            volts: [DacCode(0); CHANNELS],
            lines_out: LinesOut::SAFE,
            counts: [0; CHANNELS],
            counter_bits: config.counter_bits,
            marks: [None; CHANNELS],
            gauges: [0; FORCE_TORQUE_CHANNELS],
            lines_in: LinesIn { drive_power: true, estop_a_closed: true, estop_b_closed: true },
            number: 0,
            frame_number: 0,
            registers,
        })
    }

    /// What the board does between two instants: outputs through their watchdogs, then converters,
    /// counters, gauges and lines published anew. `now` must not run backwards.
    pub fn tick(&mut self, now: Nanos) {
        let silence = Nanos::from_millis(i64::from(self.registers.read(WATCHDOG_MS)));
        self.tick_outputs(now, silence);
        self.number = self.number.wrapping_add(1);
        let (number, shift) = (self.number, self.dac_to_adc_shift);
        let adc = self.volts.map(|code| {
            let code = if shift >= 0 { code.0 << shift } else { code.0 >> -shift };
            self.adc.saturating_field(code) as u16
        });
        publish(&self.registers, ADC, number, adc);
        let gauges = self.gauges.map(|code| self.gauge.saturating_field(code) as u16);
        publish(&self.registers, FORCE_TORQUE, number, gauges);
        let mask = u32::MAX >> (32 - self.counter_bits);
        let halves = |count: i32| {
            let raw = count.cast_unsigned() & mask;
            [(raw >> 16) as u16, raw as u16]
        };
        publish(&self.registers, ENCODERS, number, self.counts.map(halves).into_iter().flatten());
        let seen = (0..LAYOUT_CHANNELS).map(|i| u16::from(self.marks[i].is_some()) << i).sum();
        let pulses = self.marks.map(|mark| halves(mark.map_or(0, |Counts(count)| count)));
        let pulses = pulses.into_iter().flatten().take(2 * LAYOUT_CHANNELS).chain([seen]);
        publish(&self.registers, INDEX, number, pulses);
        let bit = |set: bool, bit: u16| if set { bit } else { 0 };
        let lines = bit(self.lines_in.drive_power, IN_DRIVE_POWER)
            | bit(self.lines_in.estop_a_closed, IN_ESTOP_A_CLOSED)
            | bit(self.lines_in.estop_b_closed, IN_ESTOP_B_CLOSED);
        self.registers.write(DIGITAL_IN, (number << IN_BEAT_SHIFT) | lines);
    }

    fn tick_outputs(&mut self, now: Nanos, silence: Nanos) {
        let strobe = self.registers.read(DAC_STROBE);
        self.registers.order_reads();
        let driven = self.dac_watchdog.seen != strobe;
        if !self.dac_watchdog.tick(now, strobe, silence) {
            self.volts = [DacCode(0); CHANNELS];
        } else if driven {
            for (code, register) in self.volts.iter_mut().zip(DAC.iter()) {
                *code = DacCode(self.dac.code(u32::from(self.registers.read(register))));
            }
        }
        let word = self.registers.read(DIGITAL_OUT);
        let feed = word & OUT_WATCHDOG_FEED;
        let alive = self.line_watchdog.tick(now, feed, silence);
        self.lines_out = LinesOut {
            enable: alive && word & OUT_ENABLE != 0,
            brake_release: alive && word & OUT_BRAKE_RELEASE != 0,
            watchdog_feed: feed != 0,
        };
    }

    /// The codes at the D/A outputs since the last tick.
    #[must_use]
    pub fn dac_codes(&self) -> [DacCode; CHANNELS] {
        self.volts
    }

    /// The lines to the cell since the last tick.
    #[must_use]
    pub fn lines_out(&self) -> LinesOut {
        self.lines_out
    }

    /// Sets the encoders' counts, which are published from the next tick on. Counts beyond the
    /// counters' width wrap.
    pub fn set_counts(&mut self, counts: [i32; CHANNELS]) {
        self.counts = counts;
    }

    /// Makes it a board that latches index pulses; to be called before a driver is attached.
    pub fn enable_index_latch(&mut self) {
        self.registers.write(FEATURES, FEATURE_INDEX);
    }

    /// Latches index pulses at these counts, which are published from the next tick on.
    pub fn set_index_pulses(&mut self, marks: IndexPulses) {
        self.marks = marks;
    }

    /// Sets the gauges' codes, clamped to their range; they are published from the next tick on.
    pub fn set_gauges(&mut self, gauges: [i32; FORCE_TORQUE_CHANNELS]) {
        self.gauges = gauges;
    }

    /// Sets the lines from the cell, which are published from the next tick on.
    pub fn set_lines(&mut self, lines: LinesIn) {
        self.lines_in = lines;
    }

    /// Publishes a tactile frame at once under the next number.
    pub fn publish_frame(&mut self, frame: &[u16; 256]) {
        self.frame_number = self.frame_number.wrapping_add(1);
        publish(&self.registers, TACTILE, self.frame_number, frame.iter().copied());
    }
}

fn publish(
    registers: &RegisterFile,
    block: Block,
    number: u16,
    words: impl IntoIterator<Item = u16>,
) {
    registers.write(block.begin, number);
    registers.order_writes();
    for (register, word) in block.words.iter().zip(words) {
        registers.write(register, word);
    }
    registers.order_writes();
    registers.write(block.end, number);
}
