//! A board whose power is on: what its registers do from one look at them to the next.

use std::fmt;
use std::io;
use std::path::Path;

use taktil_hal::fault::{FaultKind, FaultPlan, SplitMix};
use taktil_hal::{Invalid, LinesIn, LinesOut, Nanos};

use crate::layout::{Busy, Event, Inputs as Bank, Layout, Numbers, Row};
use crate::memory::Memory;

/// How long a conversion takes unless it is set: that of a board of the 1980s with eight channels.
pub const CONVERSION_TIME: Nanos = Nanos(20_000);
/// The kinds of faults that the emulator executes.
pub const FAULT_KINDS: [FaultKind; 6] = [
    FaultKind::Frozen,
    FaultKind::Silence,
    FaultKind::Corruption,
    FaultKind::Delay,
    FaultKind::Unplugged,
    FaultKind::Restart,
];

/// What the board puts out.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Outputs {
    /// Codes at the D/A converters, signed about zero volts.
    pub codes: Vec<i32>,
    /// Lines to the cell.
    pub lines: LinesOut,
}

/// What the board's inputs read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Inputs {
    /// Counts of the encoders.
    pub counts: Vec<i64>,
    /// For each encoder the count at its newest index pulse.
    pub index: Vec<Option<i64>>,
    /// Codes at the A/D converters, signed about zero volts; taken to the nearest code in range.
    pub codes: Vec<i32>,
    /// Codes of gauges that have registers of their own.
    pub gauges: Vec<i32>,
    /// Lines from the cell.
    pub lines: LinesIn,
    /// A scan of the tactile array, row by row, when one has been finished.
    pub frame: Option<Vec<u16>>,
}

/// What stands behind the board: from an instant and its outputs to its inputs.
pub type Plant = Box<dyn FnMut(Nanos, &Outputs) -> Inputs + Send>;

/// A sign of life of a group of outputs.
#[derive(Clone, Copy, Debug, Default)]
struct Life {
    seen: u64,
    /// When the last sign came; `None` until the first.
    last: Option<Nanos>,
}

/// A board in a shared file.
pub struct Emulator {
    layout: Layout,
    name: String,
    memory: Memory,
    plant: Plant,
    plan: FaultPlan,
    random: SplitMix,
    conversion_time: Nanos,
    outputs: Outputs,
    inputs: Inputs,
    output_life: Life,
    line_life: Life,
    strobe_seen: u64,
    latch_seen: u64,
    /// When a conversion under way is done: of the A/D, and of gauges of their own.
    conversion_ends: [Option<Nanos>; 2],
    number: u64,
    frame_number: u64,
    /// The cable is pulled.
    gone: bool,
    /// The restart under way has been executed.
    restarted: bool,
}

impl fmt::Debug for Emulator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Emulator")
            .field("name", &self.name)
            .field("outputs", &self.outputs)
            .finish_non_exhaustive()
    }
}

impl Emulator {
    /// Switches a board on whose registers stand from `offset_bytes` of a file on, which is made if
    /// it is not there. `name` is that of the board in a plan of faults.
    ///
    /// # Errors
    /// The description cannot be read, or the file cannot be made.
    pub fn new(
        name: &str,
        description: &str,
        path: &Path,
        offset_bytes: u64,
        plant: Plant,
    ) -> Result<Emulator, Invalid> {
        let layout = Layout::parse(description)?;
        let unusable = |error: io::Error| {
            let what = format!("{}: {error}", path.display());
            Invalid::new("path", what, "name a file in a folder that can be written")
        };
        let memory =
            Memory::open(path, offset_bytes, layout.length, layout.bus).map_err(unusable)?;
        let mut emulator = Emulator {
            layout,
            name: name.to_owned(),
            memory,
            plant,
            plan: FaultPlan::default(),
            random: SplitMix::new(1),
            conversion_time: CONVERSION_TIME,
            outputs: Outputs::default(),
            inputs: Inputs::default(),
            output_life: Life::default(),
            line_life: Life::default(),
            strobe_seen: 0,
            latch_seen: 0,
            conversion_ends: [None; 2],
            number: 0,
            frame_number: 0,
            gone: false,
            restarted: false,
        };
        emulator.switch_on().map_err(unusable)?;
        Ok(emulator)
    }

    /// Lets faults happen. They befall the board by its name, or one part of it by `NAME.encoders`,
    /// `NAME.analog_in`, `NAME.analog_out`:
    /// `frozen` inputs keep their value; `silence` of the encoders or the A/D leaves them busy, of
    /// the D/A leaves its outputs where they are, of the board does all; `corruption` with a
    /// probability tears counters; `delay` makes a conversion longer; `unplugged` reads all ones.
    ///
    /// # Errors
    /// The plan has a fault for this board that is none of [`FAULT_KINDS`].
    pub fn set_faults(&mut self, plan: FaultPlan, seed: u64) -> Result<(), Invalid> {
        for part in ["", ".encoders", ".analog_in", ".analog_out"] {
            plan.check_kinds(&format!("{}{part}", self.name), &FAULT_KINDS)?;
        }
        (self.plan, self.random) = (plan, SplitMix::new(seed));
        Ok(())
    }

    /// How long a conversion takes from now on.
    pub fn set_conversion_time(&mut self, time: Nanos) {
        self.conversion_time = time;
    }

    /// What the board put out at the latest step.
    #[must_use]
    pub fn outputs(&self) -> &Outputs {
        &self.outputs
    }

    /// Power comes on: converters at their safe values, nothing under way, identity shown.
    fn switch_on(&mut self) -> io::Result<()> {
        self.memory.fill(0)?;
        if let Some(outputs) = self.layout.outputs {
            let row = outputs.row;
            let safe = row.encode(outputs.safe_code);
            for channel in 0..row.channels {
                self.memory.set_whole(&row, channel, safe, row.words)?;
            }
            self.outputs.codes = vec![outputs.safe_code as i32; row.channels];
        }
        if let Some(lines) = self.layout.lines_out {
            self.memory.set(lines.offset, lines.inverted)?;
        }
        self.outputs.lines = LinesOut::default();
        (self.output_life, self.line_life) = (Life::default(), Life::default());
        (self.strobe_seen, self.latch_seen, self.conversion_ends) = (0, 0, [None; 2]);
        let parts = [self.layout.encoders, self.layout.analog, self.layout.gauges];
        for bank in parts.into_iter().flatten() {
            self.release(bank.start)?;
            self.show_busy(bank.busy, false)?;
        }
        self.release(self.layout.outputs.and_then(|outputs| outputs.strobe))?;
        self.release(self.layout.watchdog.and_then(|watchdog| watchdog.kick))?;
        if let Some(feature) = self.layout.index.and_then(|index| index.feature) {
            self.memory.set(feature.offset, feature.value)?;
        }
        for fixed in self.layout.fixed.clone() {
            self.memory.set(fixed.offset, fixed.value)?;
        }
        Ok(())
    }

    /// Lets the register of an event show that it has not happened.
    fn release(&mut self, event: Option<Event>) -> io::Result<()> {
        match event {
            Some(Event { offset, value: Some(value) }) => {
                let free = if value == 0 { self.layout.bus.modulus() - 1 } else { 0 };
                self.memory.write(offset, free)
            }
            _ => Ok(()),
        }
    }

    fn show_busy(&mut self, busy: Option<Busy>, is_busy: bool) -> io::Result<()> {
        let Some(Busy { offset, mask, value }) = busy else { return Ok(()) };
        let rest = self.memory.word(offset) & !mask;
        let bits = if is_busy { value } else { !value & mask };
        self.memory.write(offset, rest | bits)
    }

    /// Whether an event has happened since the register was released or seen.
    fn has_happened(&self, event: Event, seen: u64) -> bool {
        let word = self.memory.word(event.offset);
        event.value.map_or(word != seen, |value| word == value)
    }

    fn strength(&self, kind: FaultKind, part: &str, now: Nanos) -> Option<f64> {
        if self.plan.faults().is_empty() {
            return None;
        }
        let of_part = format!("{}.{part}", self.name);
        let all =
            [self.plan.strength(kind, &self.name, now), self.plan.strength(kind, &of_part, now)];
        all.into_iter().flatten().reduce(f64::max)
    }

    /// What the board does up to `now`, which must not run backwards.
    ///
    /// # Errors
    /// The file's.
    pub fn step(&mut self, now: Nanos) -> io::Result<()> {
        let unplugged = self.plan.strength(FaultKind::Unplugged, &self.name, now).is_some();
        if unplugged || self.gone {
            if unplugged {
                self.gone = true;
                return self.memory.fill(u8::MAX);
            }
            self.gone = false;
            self.switch_on()?;
        }
        let restarts = self.plan.strength(FaultKind::Restart, &self.name, now).is_some();
        if restarts && !self.restarted {
            self.switch_on()?;
        }
        self.restarted = restarts;
        self.memory.refresh()?;
        self.take_outputs(now)?;
        self.take_lines(now);
        let read = (self.plant)(now, &self.outputs);
        self.take_inputs(read, now);
        if self.plan.strength(FaultKind::Silence, &self.name, now).is_some() {
            return Ok(());
        }
        self.number += 1;
        self.show_counters(now)?;
        self.show_conversions(now)?;
        self.show_lines()?;
        self.show_frame()
    }

    /// Silence of the watchdog, as its register has it; `None` for a board without one.
    fn longest_silence(&self) -> Option<Nanos> {
        let watchdog = self.layout.watchdog?;
        let steps = self.memory.word(watchdog.offset).cast_signed();
        Some(Nanos(steps.saturating_mul(watchdog.unit_us).saturating_mul(1_000)))
    }

    /// Whether a group of outputs may act: always without a watchdog, and while its sign of life is
    /// younger than the longest silence, which 0 makes never.
    fn may_act(&self, life: Life, now: Nanos) -> bool {
        self.longest_silence().is_none_or(|silence| {
            silence > Nanos::ZERO && life.last.is_some_and(|last| now - last <= silence)
        })
    }

    fn take_outputs(&mut self, now: Nanos) -> io::Result<()> {
        let Some(outputs) = self.layout.outputs else { return Ok(()) };
        let silent = self.strength(FaultKind::Silence, "analog_out", now).is_some();
        let strobed = match outputs.strobe {
            None => true,
            Some(strobe) if self.has_happened(strobe, self.strobe_seen) => {
                self.strobe_seen = self.memory.word(strobe.offset);
                self.release(Some(strobe))?;
                true
            }
            Some(_) => false,
        };
        match self.layout.watchdog.and_then(|watchdog| watchdog.kick) {
            Some(kick) if self.has_happened(kick, 0) => {
                self.output_life.last = Some(now);
                self.release(Some(kick))?;
            }
            Some(_) => {}
            None if strobed => self.output_life.last = Some(now),
            None => {}
        }
        let row = outputs.row;
        if silent {
            return Ok(());
        }
        if !self.may_act(self.output_life, now) {
            self.outputs.codes.fill(outputs.safe_code as i32);
        } else if strobed {
            for channel in 0..row.channels {
                self.outputs.codes[channel] = row.decode(self.memory.whole(&row, channel)) as i32;
            }
        }
        Ok(())
    }

    fn take_lines(&mut self, now: Nanos) {
        let Some(lines) = self.layout.lines_out else { return };
        let word = self.memory.word(lines.offset) ^ lines.inverted;
        let bit = |place: u32| word >> place & 1;
        if self.line_life.seen != bit(lines.feed) {
            self.line_life = Life { seen: bit(lines.feed), last: Some(now) };
        }
        let alive = self.may_act(self.line_life, now);
        self.outputs.lines = LinesOut {
            enable: alive && bit(lines.enable) == 1,
            brake_release: alive && bit(lines.brake) == 1,
            watchdog_feed: bit(lines.feed) == 1,
        };
    }

    /// Takes over what the plant's sensors read, as far as they are not frozen.
    fn take_inputs(&mut self, read: Inputs, now: Nanos) {
        let frozen = |part: &str| self.strength(FaultKind::Frozen, part, now).is_some();
        let (counters, converters) = (frozen("encoders"), frozen("analog_in"));
        let all = self.plan.strength(FaultKind::Frozen, &self.name, now).is_some();
        if !counters {
            (self.inputs.counts, self.inputs.index) = (read.counts, read.index);
        }
        if !converters {
            (self.inputs.codes, self.inputs.gauges) = (read.codes, read.gauges);
        }
        if !all {
            self.inputs.lines = read.lines;
        }
        self.inputs.frame = if all { None } else { read.frame };
    }

    fn begin(&mut self, numbers: Option<Numbers>, number: u64) -> io::Result<()> {
        numbers.map_or(Ok(()), |numbers| self.memory.set(numbers.begin, number))
    }

    fn end(&mut self, numbers: Option<Numbers>, number: u64) -> io::Result<()> {
        numbers.map_or(Ok(()), |numbers| self.memory.set(numbers.end, number))
    }

    /// Shows the counters: when they are latched where the board says so, else always.
    fn show_counters(&mut self, now: Nanos) -> io::Result<()> {
        let Some(Bank { row, start, busy }) = self.layout.encoders else { return Ok(()) };
        if self.strength(FaultKind::Silence, "encoders", now).is_some() {
            return Ok(());
        }
        if let (Some(latch), Some(_)) = (start, busy) {
            if !self.has_happened(latch, self.latch_seen) {
                return Ok(());
            }
            self.latch_seen = self.memory.word(latch.offset);
        }
        let torn = self.strength(FaultKind::Corruption, "encoders", now);
        let torn = torn.is_some_and(|probability| self.random.unit() < probability);
        self.begin(row.numbers, self.number)?;
        let counts = &self.inputs.counts;
        let count = |channel| row.encode_count(counts.get(channel).copied().unwrap_or(0));
        let wholes: Vec<u64> = (0..row.channels).map(count).collect();
        if torn {
            for (channel, whole) in wholes.iter().enumerate() {
                self.memory.set_whole(&row, channel, *whole, row.words - 1)?;
            }
        } else {
            self.memory.set_row(&row, &wholes)?;
            self.end(row.numbers, self.number)?;
        }
        self.show_index()?;
        if busy.is_some() {
            self.release(start)?;
        }
        self.show_busy(busy, false)
    }

    fn show_index(&mut self) -> io::Result<()> {
        let Some(index) = self.layout.index else { return Ok(()) };
        let row = index.row;
        self.begin(row.numbers, self.number)?;
        let mark = |channel: usize| self.inputs.index.get(channel).copied().flatten();
        let wholes: Vec<u64> =
            (0..row.channels).map(|channel| row.encode_count(mark(channel).unwrap_or(0))).collect();
        let seen = (0..row.channels)
            .fold(0, |seen, channel| seen | u64::from(mark(channel).is_some()) << channel);
        self.memory.set_row(&row, &wholes)?;
        self.memory.set(index.seen, seen)?;
        self.end(row.numbers, self.number)
    }

    /// Shows what converters read: after a start where the board needs one, else always.
    fn show_conversions(&mut self, now: Nanos) -> io::Result<()> {
        for (part, bank) in [self.layout.analog, self.layout.gauges].into_iter().enumerate() {
            let (Some(Bank { row, start, busy }), is_analog) = (bank, part == 0) else { continue };
            if let Some(start) = start {
                if self.has_happened(start, 0) && self.conversion_ends[part].is_none() {
                    let late = self.strength(FaultKind::Delay, "analog_in", now).unwrap_or(0.0);
                    let late = Nanos((late * 1e9) as i64);
                    self.conversion_ends[part] = Some(now + self.conversion_time + late);
                    // A register that is both is never seen idle in between.
                    self.show_busy(busy, true)?;
                    if busy.is_none_or(|busy| busy.offset != start.offset) {
                        self.release(Some(start))?;
                    }
                }
                let silent = self.strength(FaultKind::Silence, "analog_in", now).is_some();
                if silent || self.conversion_ends[part].is_none_or(|end| now < end) {
                    continue;
                }
                self.conversion_ends[part] = None;
            }
            self.show_codes(&row, is_analog)?;
            self.show_busy(busy, false)?;
        }
        Ok(())
    }

    fn show_codes(&mut self, row: &Row, is_analog: bool) -> io::Result<()> {
        self.begin(row.numbers, self.number)?;
        let codes = if is_analog { &self.inputs.codes } else { &self.inputs.gauges };
        let code = |channel| i64::from(codes.get(channel).copied().unwrap_or(0));
        let wholes: Vec<u64> = (0..row.channels).map(|channel| row.encode(code(channel))).collect();
        self.memory.set_row(row, &wholes)?;
        self.end(row.numbers, self.number)
    }

    fn show_lines(&mut self) -> io::Result<()> {
        let Some(lines) = self.layout.lines_in else { return Ok(()) };
        let read = self.inputs.lines;
        let levels = u64::from(read.drive_power) << lines.power
            | u64::from(read.estop_a_closed) << lines.stop_a
            | u64::from(read.estop_b_closed) << lines.stop_b;
        let beat = lines.beat.map_or(0, |beat| (self.number % (1 << beat.bits)) << beat.shift);
        self.memory.set(lines.offset, (levels ^ lines.inverted) | beat)
    }

    fn show_frame(&mut self) -> io::Result<()> {
        let (Some(row), Some(frame)) = (self.layout.tactile, self.inputs.frame.take()) else {
            return Ok(());
        };
        self.frame_number += 1;
        self.begin(row.numbers, self.frame_number)?;
        let wholes: Vec<u64> = frame.iter().map(|count| u64::from(*count)).collect();
        self.memory.set_row(&row, &wholes)?;
        self.end(row.numbers, self.frame_number)
    }
}
