//! Encoder channels, plain or muxed: counts of 16 bits unfolded to 32, velocity from the stamps of
//! edges, and index pulses from the latch. Source: `qcountersf.vhd`, `timestamp.vhd`.

use taktil_hal::{CHANNELS, Counts, IndexPulses};

/// Register: count in the low half, stamp of the last edge in the high half; any write clears the
/// count, so the driver never writes it.
pub(crate) const COUNT_REGISTER: u32 = 0;
/// Register: control in the low half, latched count in the high half.
pub(crate) const CONTROL_REGISTER: u32 = 1;
/// Register: divisor of the stamps' clock, less 2.
pub(crate) const DIVISOR_REGISTER: u32 = 2;
/// Register: the stamps' clock now.
pub(crate) const STAMP_REGISTER: u32 = 3;

/// Rate of the stamps' clock (Hz): 16 bits last 65 ms.
pub(crate) const STAMP_RATE_HZ: u32 = 1_000_000;
/// Readings in a row with a step that is too large, after which the counters are not believed any
/// more: one or two are garbage on the way, more are a counter that was cleared.
pub(crate) const BAD_READINGS_MAX: u32 = 3;

/// Control: the input filter.
const INPUT_FILTER: u32 = 1 << 11;
/// Control: latch once.
const JUST_ONCE: u32 = 1 << 6;
/// Control: latch the count on an index pulse; clears itself after a pulse when asked once.
const LATCH_ON_INDEX: u32 = 1 << 4;
/// Control: the index is active high.
const INDEX_HIGH: u32 = 1 << 3;
/// Control of a channel without index.
pub(crate) const PLAIN_CONTROL: u32 = INPUT_FILTER;
/// Control while no pulse has come: its latching is an event that can be seen.
pub(crate) const FIRST_PULSE_CONTROL: u32 = INPUT_FILTER | INDEX_HIGH | LATCH_ON_INDEX | JUST_ONCE;
/// Control from then on: every pulse is latched, also between two readings.
pub(crate) const EVERY_PULSE_CONTROL: u32 = INPUT_FILTER | INDEX_HIGH | LATCH_ON_INDEX;

/// The divisor's word for [`STAMP_RATE_HZ`].
pub(crate) fn divisor_word(clock_hz: u32) -> u32 {
    (clock_hz / STAMP_RATE_HZ).saturating_sub(2)
}

/// What the newest reading of a channel said.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ChannelWords {
    pub(crate) count: u32,
    pub(crate) control: u32,
}

/// How far the watch for index pulses is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Watch {
    /// The first pulse is waited for.
    #[default]
    First,
    /// It came; the channel is to latch every pulse from now on.
    Rearm,
    /// Every pulse is latched; the newest latch.
    Every(u16),
}

/// Speed from the stamps of edges (counts a second).
#[derive(Clone, Copy, Debug, Default)]
struct Speed {
    edge: u16,
    /// Since the last edge, as far as it was followed (ticks).
    age_ticks: u32,
    counts_s: f64,
}

impl Speed {
    fn update(&mut self, step: i32, edge: u16, elapsed_ticks: u16) {
        self.age_ticks = self.age_ticks.saturating_add(u32::from(elapsed_ticks));
        let rate = f64::from(STAMP_RATE_HZ);
        if step == 0 {
            // No edge came: it turns at most one count in the time since the last one.
            let most = rate / f64::from(self.age_ticks.max(1));
            self.counts_s = self.counts_s.clamp(-most, most);
            return;
        }
        let whole = edge.wrapping_sub(self.edge);
        // Stamps further apart than 16 bits are ambiguous: then the time that was followed counts.
        let ticks = if self.age_ticks <= u32::from(u16::MAX) && whole > 0 {
            u32::from(whole)
        } else {
            self.age_ticks
        };
        self.counts_s = f64::from(step) * rate / f64::from(ticks.max(1));
        (self.edge, self.age_ticks) = (edge, 0);
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    count: i32,
    raw: u16,
    watch: Watch,
    speed: Speed,
}

/// All channels of a card.
#[derive(Clone, Debug)]
pub(crate) struct EncoderBank {
    channels: [Channel; CHANNELS],
    wired: usize,
    step_max: i32,
    index: bool,
    pulses: IndexPulses,
    /// The stamps' clock at the newest reading; `None` before the first one.
    now: Option<u16>,
    bad_readings: u32,
}

/// A reading whose step is too large, and whether that is so for good.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct StepTooLarge {
    pub(crate) channel: u16,
    pub(crate) lasting: bool,
}

impl EncoderBank {
    pub(crate) fn new(wired: usize, step_max: i32, index: bool) -> EncoderBank {
        EncoderBank {
            channels: [Channel::default(); CHANNELS],
            wired,
            step_max,
            index,
            pulses: [None; CHANNELS],
            now: None,
            bad_readings: 0,
        }
    }

    /// Takes a reading in: all channels or none. `stamp` is the stamps' clock, read before the
    /// counts.
    pub(crate) fn update(
        &mut self,
        stamp: u16,
        words: &[ChannelWords; CHANNELS],
    ) -> Result<(), StepTooLarge> {
        let first = self.now.is_none();
        let step = |channel: &Channel, word: &ChannelWords| {
            i32::from((word.count as u16).wrapping_sub(channel.raw).cast_signed())
        };
        let both = || self.channels.iter().zip(words).take(self.wired);
        let bad = both().position(|(channel, word)| step(channel, word).abs() > self.step_max);
        if let Some(channel) = bad
            && !first
        {
            self.bad_readings += 1;
            let lasting = self.bad_readings >= BAD_READINGS_MAX;
            return Err(StepTooLarge { channel: channel as u16, lasting });
        }
        self.bad_readings = 0;
        let elapsed = stamp.wrapping_sub(self.now.replace(stamp).unwrap_or(stamp));
        for (i, (channel, word)) in self.channels.iter_mut().zip(words).take(self.wired).enumerate()
        {
            let step = step(channel, word);
            channel.count = channel.count.wrapping_add(step);
            channel.raw = word.count as u16;
            let edge = (word.count >> 16) as u16;
            if first {
                channel.speed = Speed { edge, age_ticks: u32::from(u16::MAX) + 1, counts_s: 0.0 };
            } else {
                channel.speed.update(step, edge, elapsed);
            }
            if self.index && channel.has_pulse(word.control) {
                let latch = (word.control >> 16) as u16;
                let behind = i32::from(latch.wrapping_sub(channel.raw).cast_signed());
                self.pulses[i] = Some(Counts(channel.count.wrapping_add(behind)));
            }
        }
        Ok(())
    }

    /// A channel that must be told to latch every pulse.
    pub(crate) fn channel_to_rearm(&self) -> Option<usize> {
        self.channels.iter().take(self.wired).position(|channel| channel.watch == Watch::Rearm)
    }

    pub(crate) fn counts(&self) -> [Counts; CHANNELS] {
        self.channels.map(|channel| Counts(channel.count))
    }

    pub(crate) fn pulses(&self) -> IndexPulses {
        self.pulses
    }

    /// Counts a second, from the stamps of edges.
    pub(crate) fn speeds(&self) -> [f64; CHANNELS] {
        self.channels.map(|channel| channel.speed.counts_s)
    }
}

impl Channel {
    /// Whether the control word tells of a new pulse.
    fn has_pulse(&mut self, control: u32) -> bool {
        let latch = (control >> 16) as u16;
        let (armed, once) = (control & LATCH_ON_INDEX != 0, control & JUST_ONCE != 0);
        match self.watch {
            Watch::First if !armed && once => {
                self.watch = Watch::Rearm;
                true
            }
            Watch::Rearm if armed && !once => {
                self.watch = Watch::Every(latch);
                false
            }
            Watch::Every(known) if known != latch => {
                self.watch = Watch::Every(latch);
                true
            }
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(count: i32, stamp: u16, control: u32) -> [ChannelWords; CHANNELS] {
        let count = u32::from(count as u16) | (u32::from(stamp) << 16);
        [ChannelWords { count, control }; CHANNELS]
    }

    #[test]
    fn sixteen_bits_are_unfolded_across_their_wrap() {
        let mut bank = EncoderBank::new(6, 16_384, false);
        let mut due = 0;
        for step in 0..100 {
            bank.update(step, &words(due, step, 0)).unwrap();
            assert_eq!(bank.counts()[5], Counts(due));
            assert_eq!(bank.counts()[6], Counts(0), "not wired");
            due -= 16_000;
        }
    }

    #[test]
    fn a_step_that_is_too_large_is_not_believed_and_after_some_readings_final() {
        let mut bank = EncoderBank::new(6, 16_384, false);
        bank.update(0, &words(100, 0, 0)).unwrap();
        for lasting in [false, false, true] {
            let refusal = bank.update(1, &words(100 + 20_000, 0, 0)).unwrap_err();
            assert_eq!(refusal, StepTooLarge { channel: 0, lasting });
            assert_eq!(bank.counts()[0], Counts(100));
        }
        bank.update(1, &words(101, 0, 0)).unwrap();
        assert_eq!(bank.counts()[0], Counts(101));
    }

    #[test]
    fn speed_comes_from_the_stamps_of_edges() {
        let mut bank = EncoderBank::new(1, 16_384, false);
        // An edge every 1000 ticks of 1 us, read every 2500 ticks.
        for reading in 0..40u16 {
            let now = reading.wrapping_mul(2_500);
            let edges = i32::from(reading) * 5 / 2;
            let edge = (edges * 1_000) as u16;
            bank.update(now, &words(edges, edge, 0)).unwrap();
        }
        assert!((bank.speeds()[0] - 1_000.0).abs() < 1e-9, "{}", bank.speeds()[0]);
        // It stands: the bound falls with the time since the last edge.
        for reading in 40..60u16 {
            bank.update(reading.wrapping_mul(2_500), &words(97, (97_000_i32) as u16, 0)).unwrap();
        }
        assert!(bank.speeds()[0] > 0.0 && bank.speeds()[0] < 25.0, "{}", bank.speeds()[0]);
    }

    #[test]
    fn pulses_are_seen_first_as_an_event_and_then_by_their_latch() {
        let mut bank = EncoderBank::new(1, 16_384, true);
        let latched = |latch: u16, control: u32| (u32::from(latch) << 16) | control;
        bank.update(0, &words(40_000, 0, latched(0, FIRST_PULSE_CONTROL))).unwrap();
        assert_eq!(bank.pulses()[0], None);
        let seen = FIRST_PULSE_CONTROL & !LATCH_ON_INDEX;
        bank.update(1, &words(40_500, 0, latched(40_100, seen))).unwrap();
        let count = bank.counts()[0].0;
        assert_eq!(bank.pulses()[0], Some(Counts(count - 400)));
        assert_eq!(bank.channel_to_rearm(), Some(0));
        bank.update(2, &words(40_600, 0, latched(40_100, EVERY_PULSE_CONTROL))).unwrap();
        assert_eq!(bank.channel_to_rearm(), None);
        bank.update(3, &words(44_200, 0, latched(44_100, EVERY_PULSE_CONTROL))).unwrap();
        assert_eq!(bank.pulses()[0], Some(Counts(bank.counts()[0].0 - 100)));
    }
}
