//! Boards of any bus, order of bytes, width and format, drawn at random: what the driver writes the
//! emulator reads, and the reverse, each by its own reading of the description.

mod rig;

use proptest::prelude::*;
use rig::{CYCLE_PERIOD, Rig, config};
use taktil_drivers_regmap::{Config, Description};
use taktil_hal::{CHANNELS, DacCode};

/// A bus and one bank on it.
#[derive(Clone, Debug)]
struct Drawn {
    bus_bits: u32,
    big: bool,
    high_first: bool,
    spread: usize,
    base: usize,
    gap: usize,
    bits: u32,
    shift: u32,
    format: usize,
    inverted: bool,
    channels: usize,
}

fn drawn(bits: std::ops::RangeInclusive<u32>) -> impl Strategy<Value = Drawn> {
    let bus = (0_usize..3, any::<bool>(), any::<bool>(), 1_usize..4, 0_usize..5, 0_usize..3);
    let value = (bits, 0_u32..=31, 0_usize..3, any::<bool>(), 1_usize..=8);
    (bus, value).prop_map(|(bus, value)| {
        let (width, big, high_first, spread, base, gap) = bus;
        let (bits, shift, format, inverted, channels) = value;
        let shift = shift.min(32 - bits);
        let bus_bits = [8, 16, 32][width];
        Drawn {
            bus_bits,
            big,
            high_first,
            spread,
            base,
            gap,
            bits,
            shift,
            format,
            inverted,
            channels,
        }
    })
}

impl Drawn {
    /// A description with a bank of this kind at the end of the window.
    fn text(&self, bank: &str, more: &str) -> String {
        let bytes = self.bus_bits as usize / 8;
        let stride = bytes * self.spread;
        let words = (self.bits + self.shift).div_ceil(self.bus_bits) as usize;
        let channel_stride = words * stride + self.gap * bytes;
        let first = self.base * bytes;
        let length = first + self.channels * channel_stride + words * stride;
        let order = if self.big { "big" } else { "little" };
        let word_order = if self.high_first { "high-first" } else { "low-first" };
        format!(
            "name = \"drawn\"\nbus_bits = {}\nbyte_order = \"{order}\"\n\
             word_order = \"{word_order}\"\nstride_bytes = {stride}\nlength_bytes = {length}\n\
             [{bank}]\noffset = {first}\nchannels = {}\nchannel_stride_bytes = {channel_stride}\n\
             bits = {}\nshift = {}\ninverted = {}\n{more}",
            self.bus_bits, self.channels, self.bits, self.shift, self.inverted
        )
    }

    fn format(&self) -> String {
        let word = ["offset-binary", "twos-complement", "straight-binary"][self.format];
        format!("format = \"{word}\"")
    }

    fn config(&self, name: &str, text: &str) -> Config {
        let registers = Some(Description::from_toml(text).unwrap());
        // A place of its own for each thread of the tests.
        Config { registers, board: String::new(), ..config(name, "drawn") }
    }
}

/// A value somewhere in a range, its ends included.
fn within(low: i32, high: i32, part: u32) -> i32 {
    let span = i64::from(high) - i64::from(low);
    (i64::from(low) + span * i64::from(part) / i64::from(u32::MAX)) as i32
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn what_is_committed_stands_at_the_terminals(
        drawn in drawn(2..=31),
        parts in proptest::array::uniform8(any::<u32>()),
    ) {
        let text = drawn.text("analog_out", &drawn.format());
        let config = drawn.config("drawn-out", &text);
        let rig = Rig::new(&config, &text);
        let mut half = rig.open(&config).unwrap().analog_out.unwrap();
        let (low, high) = half.code_range();
        for ends in [false, true] {
            let mut codes = [DacCode(0); CHANNELS];
            for (code, part) in codes.iter_mut().zip(parts) {
                *code = match (ends, part & 1) {
                    (true, 0) => low,
                    (true, _) => high,
                    _ => DacCode(within(low.0, high.0, part)),
                };
            }
            half.commit(CYCLE_PERIOD, &codes).unwrap();
            let seen = rig.look().codes;
            let due: Vec<i32> = codes[..drawn.channels].iter().map(|code| code.0).collect();
            prop_assert_eq!(seen, due);
        }
        half.safe().unwrap();
        prop_assert_eq!(rig.look().codes, vec![0; drawn.channels]);
    }

    #[test]
    fn what_converters_read_is_sampled(
        drawn in drawn(2..=31),
        parts in proptest::array::uniform8(any::<u32>()),
    ) {
        let text = drawn.text("analog_in", &format!("{}\nunused_zero = true", drawn.format()));
        let config = drawn.config("drawn-in", &text);
        let rig = Rig::new(&config, &text);
        let mut half = rig.open(&config).unwrap().analog_in.unwrap();
        let (low, high) = half.code_range();
        let codes = parts.map(|part| within(low.0, high.0, part)).to_vec();
        rig.inputs.lock().unwrap().codes = codes.clone();
        rig.job(CYCLE_PERIOD);
        let read = half.sample(CYCLE_PERIOD).unwrap().value;
        let read: Vec<i32> = read[..drawn.channels].iter().map(|code| code.0).collect();
        prop_assert_eq!(&read[..], &codes[..drawn.channels]);
    }

    #[test]
    fn counts_are_followed_through_every_wrap(
        drawn in drawn(8..=32),
        steps in proptest::collection::vec(any::<i32>(), 1..12),
    ) {
        let text = drawn.text("encoders", "");
        let config = drawn.config("drawn-counts", &text);
        let rig = Rig::new(&config, &text);
        let mut half = rig.open(&config).unwrap().encoders.unwrap();
        // A step stays below half the range of the counter, and of the counts themselves.
        let reach = i64::from(i32::MAX >> (32 - drawn.bits)).min(i64::from(i32::MAX / 16));
        let mut count = 0_i64;
        for (at, step) in (1..).zip(steps) {
            count += i64::from(step) % (reach + 1);
            rig.inputs.lock().unwrap().counts = vec![count; 8];
            let release = CYCLE_PERIOD * at;
            rig.job(release);
            let read = half.sample(release).unwrap().value;
            prop_assert!(read[..drawn.channels].iter().all(|read| i64::from(read.0) == count));
        }
    }
}
