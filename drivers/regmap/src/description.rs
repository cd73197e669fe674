//! The description of a board's registers as a file states it: the bus, and the registers of each
//! half. Offsets are bytes from the start of the mapped window.

use serde::Deserialize;

mod bounds;
mod overlap;

pub(crate) use bounds::within;
pub use bounds::{CHANNELS_MAX, REGISTER_BITS_MAX, SPAN_MAX_V, WINDOW_BYTES_MAX};

/// The most looks at a busy bit that a description may allow: a look at a register of a VME or PCI
/// board takes about a microsecond, so that this many end within a period of 2.5 ms.
pub const BUSY_POLLS_MAX: u32 = 1_000;

taktil_hal::explained! {
    /// The registers of a board.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Description {
        /// What the board is, for messages.
        pub name: String,
        /// The width of every access, which is also that of a register: 8, 16 or 32.
        pub bus_bits: u32 [8.0, 32.0],
        /// In which order the bytes of a register stand: `big` on VME, `little` on PCI.
        pub byte_order: ByteOrder,
        /// Which register of a value that takes several stands first. Default `high-first` for a
        /// big byte order, `low-first` for a little one.
        pub word_order: Option<WordOrder>,
        /// From a register to the next one, in bytes. Default the width of the bus; 2 for a board
        /// of 8 bits that answers at odd bytes, 4 for registers of 16 bits on a bus of 32.
        pub stride_bytes: Option<usize>,
        /// How many bytes the board takes on the bus.
        pub length_bytes: usize,
        /// How long the bus takes for one read, longest case (ns): by this the analysis of the
        /// schedule counts what looks at busy bits may take. Default 1000: a VME bus behind a
        /// bridge; PCI takes about half of it.
        #[serde(default = "read_default_ns")]
        pub read_ns: u32 [1.0, 1e6],
        /// A register by which every cycle sees that the board still answers. Without one a board
        /// that is gone is not noticed.
        pub presence: Option<Expected>,
        /// Registers by which the board is known when it is opened. Default none.
        #[serde(default)]
        pub identity: Vec<Expected>,
        /// What is written once when the board is opened, in this order. Default nothing.
        #[serde(default)]
        pub setup: Vec<Written>,
        /// The watchdog over the outputs. By default the board has none.
        pub watchdog: Option<Watchdog>,
        /// Encoder counters. By default the board has none.
        pub encoders: Option<EncoderBank>,
        /// Counters at index pulses. By default the board latches none.
        pub index: Option<IndexBank>,
        /// D/A converters. By default the board has none.
        pub analog_out: Option<OutputBank>,
        /// A/D converters. By default the board has none.
        pub analog_in: Option<InputBank>,
        /// Six gauges with registers of their own. By default the board has none; `gauge_channels`
        /// of the device takes them from the A/D converters.
        pub force_torque: Option<InputBank>,
        /// A frame of a tactile array. By default the board has none.
        pub tactile: Option<TactileBank>,
        /// Lines from the cell. By default the board has none.
        pub digital_in: Option<InputLines>,
        /// Lines to the cell. By default the board has none.
        pub digital_out: Option<OutputLines>,
    }
}

taktil_hal::explained! {
    /// The order of the bytes of a register.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum ByteOrder {
        /// The most significant byte stands first.
        Big,
        /// The least significant byte stands first.
        Little,
    }
}

taktil_hal::explained! {
    /// The order of the registers of one value.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum WordOrder {
        /// The most significant register stands first.
        HighFirst,
        /// The least significant register stands first.
        LowFirst,
    }
}

taktil_hal::explained! {
    /// What a register reads on a board that is there.
    #[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Expected {
        /// The register.
        pub offset: usize,
        /// Its name, for messages. By default its offset.
        pub register: Option<String>,
        /// Which of its bits count. Default all.
        pub mask: Option<u32>,
        /// What these bits read.
        pub value: u32,
    }
}

taktil_hal::explained! {
    /// What is written to a register.
    #[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Written {
        /// The register.
        pub offset: usize,
        /// What is written.
        pub value: u32,
    }
}

taktil_hal::explained! {
    /// A watchdog that sends the outputs to their safe values by itself.
    #[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Watchdog {
        /// The register that takes the longest silence, and reads it back.
        pub offset: usize,
        /// What one step of that register is worth, in microseconds. Default 1000.
        #[serde(default = "watchdog_unit_us")]
        pub unit_us: u32 [1.0, 1e6],
        /// A register whose writing is the sign of life. By default the D/A strobe and the feed
        /// line are.
        pub kick_offset: Option<usize>,
        /// What is written there with every commit. Default 1.
        #[serde(default = "one")]
        pub kick_value: u32,
    }
}

taktil_hal::explained! {
    /// How a converter's code stands in its bits.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Format {
        /// All bits 0 is the most negative code, half scale is zero volts.
        OffsetBinary,
        /// Two's complement.
        TwosComplement,
        /// Unsigned, zero volts at 0: a converter of one polarity.
        StraightBinary,
    }
}

taktil_hal::explained! {
    /// What a write to a strobe register is.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum StrobeKind {
        /// The same value each time.
        #[default]
        Value,
        /// Another number each time, counted on from what the register reads at opening.
        Count,
    }
}

taktil_hal::explained! {
    /// D/A converters.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct OutputBank {
        /// The first register of channel 0.
        pub offset: usize,
        /// How many channels there are.
        pub channels: usize [1.0, CHANNELS_MAX as f64],
        /// From a channel to the next one, in bytes. By default one follows the other.
        pub channel_stride_bytes: Option<usize>,
        /// The converter's width.
        pub bits: u32 [2.0, 31.0],
        /// How many bits stand below the code: 4 for 12 bits at the left of 16. Default 0.
        #[serde(default)]
        pub shift: u32,
        /// How the code stands in its bits.
        pub format: Format,
        /// Whether all bits of the code are inverted on the bus. Default false.
        #[serde(default)]
        pub inverted: bool,
        /// The code at which the actuators do no harm. Default 0: no volts.
        #[serde(default)]
        pub safe_code: i32,
        /// The voltage of the lowest code. Default -10.
        #[serde(default = "low_default_v")]
        pub low_v: f64 [-SPAN_MAX_V, SPAN_MAX_V],
        /// The voltage one code above the highest one. Default 10.
        #[serde(default = "high_default_v")]
        pub high_v: f64 [-SPAN_MAX_V, SPAN_MAX_V],
        /// A register whose writing puts all channels out together. By default each channel puts
        /// out what it gets at once.
        pub strobe_offset: Option<usize>,
        /// What is written there. Default `value`.
        #[serde(default)]
        pub strobe: StrobeKind,
        /// The value of such a write. Default 1.
        #[serde(default = "one")]
        pub strobe_value: u32,
        /// Whether the registers read back what was written: each commit then looks whether the
        /// board still holds the last one. Default false.
        #[serde(default)]
        pub read_back: bool,
    }
}

taktil_hal::explained! {
    /// Encoder counters.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct EncoderBank {
        /// The first register of channel 0.
        pub offset: usize,
        /// How many channels there are.
        pub channels: usize [1.0, CHANNELS_MAX as f64],
        /// From a channel to the next one, in bytes. By default one follows the other.
        pub channel_stride_bytes: Option<usize>,
        /// The counters' width. Narrower ones than 32 bits are carried across their wrap.
        pub bits: u32 [8.0, 32.0],
        /// How many registers a count takes, its bits at the right. By default as many as it
        /// needs.
        pub words: Option<usize>,
        /// How many bits stand below the count. Default 0.
        #[serde(default)]
        pub shift: u32,
        /// Whether all bits of the count are inverted on the bus. Default false.
        #[serde(default)]
        pub inverted: bool,
        /// A register whose writing latches all counters together. By default there is none.
        pub latch_offset: Option<usize>,
        /// What is written there. Default `value`.
        #[serde(default)]
        pub latch: StrobeKind,
        /// The value of such a write. Default 1.
        #[serde(default = "one")]
        pub latch_value: u32,
        /// What keeps the words of a count together. Default `reread`.
        #[serde(default)]
        pub hold: Hold,
        /// A register that shows whether latching is under way. By default the latch acts at once.
        pub busy_offset: Option<usize>,
        /// Which of its bits are looked at. Default all.
        pub busy_mask: Option<u32>,
        /// What these bits read while latching is under way. Default all ones.
        pub busy_value: Option<u32>,
        /// How often it is looked at before the reading is given up; a job waits for so many times
        /// `read_ns` at most. Default 100.
        #[serde(default = "polls_default")]
        pub polls: u32 [1.0, BUSY_POLLS_MAX as f64],
        /// The register of the number under which the counters are published, written before them.
        pub begin_offset: Option<usize>,
        /// The register of that number that is written after them.
        pub end_offset: Option<usize>,
        /// The largest step of a count from one reading to the next that is believed at once; a
        /// larger one is believed when the next reading is near it. Default 0: any step.
        #[serde(default)]
        pub step_max_counts: u32 [0.0, i32::MAX as f64],
    }
}

taktil_hal::explained! {
    /// What keeps the words of a count together while they are read.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Hold {
        /// Nothing: the counters are read again until two passes are equal.
        #[default]
        Reread,
        /// The latch holds them until the next strobe.
        Latch,
        /// Reading the first word of a count holds its others.
        Read,
    }
}

taktil_hal::explained! {
    /// Counters at index pulses, in the width and order of the encoders.
    #[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct IndexBank {
        /// The first register of channel 0.
        pub offset: usize,
        /// From a channel to the next one, in bytes. By default one follows the other.
        pub channel_stride_bytes: Option<usize>,
        /// A register with a bit for each channel that has passed a pulse since power-up.
        pub seen_offset: usize,
        /// The register of the number under which the pulses are published, written before them.
        pub begin_offset: Option<usize>,
        /// The register of that number that is written after them.
        pub end_offset: Option<usize>,
        /// A register that shows whether the board has the latch at all. By default it has.
        pub feature_offset: Option<usize>,
        /// The bits of it that are set on a board with the latch. Default 1.
        #[serde(default = "one")]
        pub feature_mask: u32,
    }
}

taktil_hal::explained! {
    /// A/D converters.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct InputBank {
        /// The first register of channel 0.
        pub offset: usize,
        /// How many channels there are.
        pub channels: usize [1.0, CHANNELS_MAX as f64],
        /// From a channel to the next one, in bytes. By default one follows the other.
        pub channel_stride_bytes: Option<usize>,
        /// The converter's width.
        pub bits: u32 [2.0, 31.0],
        /// How many bits stand below the code. Default 0.
        #[serde(default)]
        pub shift: u32,
        /// How the code stands in its bits.
        pub format: Format,
        /// Whether all bits of the code are inverted on the bus. Default false.
        #[serde(default)]
        pub inverted: bool,
        /// Whether bits outside the code read 0, so that a set one is refused. Default false.
        #[serde(default)]
        pub unused_zero: bool,
        /// The voltage of the lowest code. Default -10.
        #[serde(default = "low_default_v")]
        pub low_v: f64 [-SPAN_MAX_V, SPAN_MAX_V],
        /// The voltage one code above the highest one. Default 10.
        #[serde(default = "high_default_v")]
        pub high_v: f64 [-SPAN_MAX_V, SPAN_MAX_V],
        /// A register whose writing starts a conversion of all channels. By default the board
        /// converts by itself.
        pub start_offset: Option<usize>,
        /// What is written there. Default 1.
        #[serde(default = "one")]
        pub start_value: u32,
        /// Which half starts the conversion. Default `sample`.
        #[serde(default)]
        pub start_by: StartBy,
        /// A register that shows whether a conversion is under way. By default there is none.
        pub busy_offset: Option<usize>,
        /// Which of its bits are looked at. Default all.
        pub busy_mask: Option<u32>,
        /// What these bits read while a conversion is under way. Default all ones.
        pub busy_value: Option<u32>,
        /// How often it is looked at before the reading is given up; a job waits for so many times
        /// `read_ns` at most. Default 100.
        #[serde(default = "polls_default")]
        pub polls: u32 [1.0, BUSY_POLLS_MAX as f64],
        /// The register of the number under which the codes are published, written before them.
        pub begin_offset: Option<usize>,
        /// The register of that number that is written after them.
        pub end_offset: Option<usize>,
    }
}

taktil_hal::explained! {
    /// Which half starts a conversion.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum StartBy {
        /// The half that reads the codes, just before it does.
        #[default]
        Sample,
        /// The encoders of the same board, which a job samples first: the conversion runs while
        /// they are read.
        Encoders,
    }
}

taktil_hal::explained! {
    /// A frame of a tactile array, row by row, one register a tactel.
    #[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct TactileBank {
        /// The register of row 0, column 0.
        pub offset: usize,
        /// Rows.
        pub rows: usize [1.0, 64.0],
        /// Columns.
        pub cols: usize [1.0, 64.0],
        /// Width of a tactel's count.
        pub bits: u32 [2.0, 16.0],
        /// How long a scan takes, in microseconds: the rows of a frame are stamped evenly over it.
        pub scan_us: u32 [1.0, 1e6],
        /// The register of the number under which a frame is published, written before it.
        pub begin_offset: usize,
        /// The register of that number that is written after it.
        pub end_offset: usize,
    }
}

taktil_hal::explained! {
    /// The lines from the cell: bits of one register.
    #[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct InputLines {
        /// The register.
        pub offset: usize,
        /// The bit of: the drives' supply is on.
        pub drive_power_bit: u32,
        /// The bit of: channel A of the emergency-stop chain is closed.
        pub estop_a_bit: u32,
        /// The bit of: channel B of the emergency-stop chain is closed.
        pub estop_b_bit: u32,
        /// Bits that read 0 when their line is true. Default none.
        #[serde(default)]
        pub inverted_mask: u32,
        /// Bits that read 0 on a board that works. Default none.
        #[serde(default)]
        pub zero_mask: u32,
        /// The lowest bit of a number that the board counts up to show that it is alive.
        pub beat_shift: Option<u32>,
        /// How many bits that number has. Default 8.
        #[serde(default = "beat_bits_default")]
        pub beat_bits: u32,
    }
}

taktil_hal::explained! {
    /// The lines to the cell: bits of one register, whose other bits are written 0.
    #[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct OutputLines {
        /// The register.
        pub offset: usize,
        /// The bit of: the drives may put current into the motors.
        pub enable_bit: u32,
        /// The bit of: the brakes are lifted.
        pub brake_release_bit: u32,
        /// The bit of the line whose changes are the sign of life.
        pub watchdog_feed_bit: u32,
        /// Bits that are written 0 to make their line true. Default none.
        #[serde(default)]
        pub inverted_mask: u32,
    }
}

fn watchdog_unit_us() -> u32 {
    1_000
}

fn one() -> u32 {
    1
}

fn low_default_v() -> f64 {
    -10.0
}

fn high_default_v() -> f64 {
    10.0
}

fn read_default_ns() -> u32 {
    1_000
}

fn polls_default() -> u32 {
    100
}

fn beat_bits_default() -> u32 {
    8
}
