//! One subdevice of the double keeps its channels here: values, directions, counters, and who has
//! locked it.

use crate::SubdeviceFacts;

/// What a subdevice is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A/D converters.
    AnalogIn,
    /// D/A converters.
    AnalogOut,
    /// Lines to the computer.
    DigitalIn,
    /// Lines from the computer.
    DigitalOut,
    /// Lines whose direction is chosen; inputs at power-up.
    DigitalIo,
    /// Counters.
    Counter,
}

/// A range of a converter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VoltRange {
    /// What sample 0 stands for (uV).
    pub min_uv: i32,
    /// What the largest sample stands for (uV).
    pub max_uv: i32,
}

impl VoltRange {
    /// A range of `volts` either way.
    #[must_use]
    pub const fn symmetric(volts: i32) -> VoltRange {
        VoltRange { min_uv: -1_000_000 * volts, max_uv: 1_000_000 * volts }
    }
}

/// Flag of the header: can be read.
const READABLE_FLAG: u32 = 0x0001_0000;
/// Flag of the header: can be written.
const WRITABLE_FLAG: u32 = 0x0002_0000;
/// Flag of the header: can refer to analog ground.
const GROUND_FLAG: u32 = 0x0010_0000;

/// A subdevice.
#[derive(Clone, Debug)]
pub struct Subdevice {
    pub(crate) kind: Kind,
    pub(crate) maxdata: u32,
    pub(crate) ranges: Vec<VoltRange>,
    /// Samples; the levels of lines as the board knows them.
    pub(crate) values: Vec<u32>,
    /// What inputs show; the same as what there is unless they are frozen.
    pub(crate) shown: Vec<u32>,
    /// The level applied to each line from outside; cut wires are pulled up.
    applied: Vec<Option<bool>>,
    pub(crate) outputs: Vec<bool>,
    group: usize,
    needs_arming: bool,
    /// Per counter: how far its disc has turned, and where it stood when the counter was zero.
    turned: Vec<i64>,
    zero: Vec<i64>,
    pub(crate) armed: Vec<bool>,
    pub(crate) owner: Option<u32>,
}

impl Subdevice {
    /// A subdevice of so many channels and bits, with a range of 10 V either way, as at power-up.
    #[must_use]
    pub fn new(kind: Kind, channels: usize, bits: u32) -> Subdevice {
        let mut made = Subdevice {
            kind,
            maxdata: u32::MAX >> (32 - bits.clamp(1, 32)),
            ranges: vec![VoltRange::symmetric(10)],
            values: vec![0; channels],
            shown: vec![0; channels],
            applied: vec![None; channels],
            outputs: vec![false; channels],
            group: 1,
            needs_arming: false,
            turned: vec![0; channels],
            zero: vec![0; channels],
            armed: vec![false; channels],
            owner: None,
        };
        made.restart();
        made
    }

    /// The same subdevice with these ranges.
    #[must_use]
    pub fn with_ranges(mut self, ranges: &[VoltRange]) -> Subdevice {
        self.ranges = ranges.to_vec();
        self
    }

    /// The same subdevice with another largest sample, for counters of odd moduli.
    #[must_use]
    pub fn with_largest_sample(mut self, maxdata: u32) -> Subdevice {
        self.maxdata = maxdata;
        self
    }

    /// The same lines, directed so many at a time.
    #[must_use]
    pub fn directed_in_groups(mut self, lines: usize) -> Subdevice {
        self.group = lines.max(1);
        self
    }

    /// The same counters, at rest until they are told to count.
    #[must_use]
    pub fn armed_by_instruction(mut self) -> Subdevice {
        self.needs_arming = true;
        self.restart();
        self
    }

    /// What is as at power-up: D/A channels in the middle, lines inputs, counters at zero.
    pub(crate) fn restart(&mut self) {
        let value = if self.kind == Kind::AnalogOut { self.maxdata / 2 } else { 0 };
        if !matches!(self.kind, Kind::AnalogIn) {
            self.values.fill(value);
        }
        self.outputs.fill(self.kind == Kind::DigitalOut);
        self.armed.fill(!self.needs_arming);
        self.zero.clone_from(&self.turned);
    }

    pub(crate) fn facts(&self) -> SubdeviceFacts {
        let (kind, flags) = match self.kind {
            Kind::AnalogIn => (1, READABLE_FLAG | GROUND_FLAG),
            Kind::AnalogOut => (2, WRITABLE_FLAG | GROUND_FLAG),
            Kind::DigitalIn => (3, READABLE_FLAG),
            Kind::DigitalOut => (4, WRITABLE_FLAG),
            Kind::DigitalIo => (5, READABLE_FLAG | WRITABLE_FLAG),
            Kind::Counter => (6, READABLE_FLAG | WRITABLE_FLAG),
        };
        SubdeviceFacts { kind, channels: self.values.len() as u32, flags }
    }

    pub(crate) fn is_digital(&self) -> bool {
        matches!(self.kind, Kind::DigitalIn | Kind::DigitalOut | Kind::DigitalIo)
    }

    pub(crate) fn turn(&mut self, channel: usize, count: i64) {
        if channel >= self.turned.len() {
            return;
        }
        if !self.armed[channel] {
            // A counter at rest misses the way.
            self.zero[channel] += count - self.turned[channel];
        }
        self.turned[channel] = count;
    }

    pub(crate) fn reset_counter(&mut self, channel: usize, preload: u32) {
        self.zero[channel] = self.turned[channel] - i64::from(preload);
    }

    pub(crate) fn apply(&mut self, channel: usize, level: Option<bool>) {
        if let Some(applied) = self.applied.get_mut(channel) {
            *applied = level;
        }
    }

    pub(crate) fn driven(&self, channel: usize) -> Option<bool> {
        let is_output = self.is_digital() && *self.outputs.get(channel)?;
        is_output.then(|| self.values[channel] != 0)
    }

    /// Directs a line and the others of its group.
    pub(crate) fn direct(&mut self, channel: usize, output: bool) {
        let first = channel - channel % self.group;
        let end = (first + self.group).min(self.outputs.len());
        self.outputs[first..end].fill(output);
    }

    /// What a channel is now, seen from the computer.
    pub(crate) fn present(&self, channel: usize) -> u32 {
        match self.kind {
            Kind::Counter => {
                let count = self.turned[channel] - self.zero[channel];
                // A counter shows the low bits of its count, or the remainder of an odd modulus.
                count.rem_euclid(i64::from(self.maxdata) + 1) as u32
            }
            _ if self.is_digital() && !self.outputs[channel] => {
                u32::from(self.applied[channel].unwrap_or(true))
            }
            _ => self.values[channel],
        }
    }
}
