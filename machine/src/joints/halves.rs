//! The encoders and converters of a board as the joints see them: each joint by its own channel,
//! direction and scale.

use taktil_hal::{
    AnalogOut, CHANNELS, Counts, DacCode, Encoders, Error, ErrorKind, IndexPulses, Nanos, Reading,
};
use taktil_rtcore::Invalid;

/// Where one output of [`ConnectedEncoders`] comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct EncoderChannel {
    pub(super) channel: usize,
    /// Counts that are shown for one of the channel's; 0 for an encoder that stands still.
    pub(super) scale: f64,
    /// Counts between two index pulses where the disc turns otherwise than that of the channel,
    /// whose pulses then do not count: every multiple of this, shifted by half of it, is a pulse.
    pub(super) disc_counts: Option<i64>,
}

/// Encoders in another order, direction and scale. A count that wraps at the ends of 32 bits is
/// followed, so that a scale of any size shows no jump there.
pub(super) struct ConnectedEncoders {
    half: Box<dyn Encoders>,
    from: [EncoderChannel; CHANNELS],
    joints: usize,
    /// The newest count of each channel of the board, as it is and as if it never wrapped.
    latest: Option<[Counts; CHANNELS]>,
    unwrapped: [i64; CHANNELS],
    /// Whole turns of each output's own disc, and its newest pulse.
    turns: [Option<i64>; CHANNELS],
    own_pulses: IndexPulses,
}

impl ConnectedEncoders {
    /// # Errors
    /// A channel that the board does not have.
    pub(super) fn new(
        half: Box<dyn Encoders>,
        all: &[EncoderChannel],
    ) -> Result<ConnectedEncoders, Invalid> {
        let wired = half.joints();
        if let Some(i) = all.iter().position(|from| from.channel >= wired) {
            let what = format!("the board has {wired} encoders, none of number {}", all[i].channel);
            let place = format!("encoder_channel[{i}]");
            return Err(Invalid::new(place, what, format!("give 0 to {}", wired.max(1) - 1)));
        }
        let unused = EncoderChannel { channel: 0, scale: 0.0, disc_counts: None };
        let from = core::array::from_fn(|i| all.get(i).copied().unwrap_or(unused));
        Ok(ConnectedEncoders {
            half,
            from,
            joints: all.len().min(CHANNELS),
            latest: None,
            unwrapped: [0; CHANNELS],
            turns: [None; CHANNELS],
            own_pulses: [None; CHANNELS],
        })
    }

    /// Follows the counts of the board through their wraps.
    fn follow(&mut self, counts: &[Counts; CHANNELS]) {
        for (i, Counts(count)) in counts.iter().enumerate() {
            self.unwrapped[i] = match &self.latest {
                None => i64::from(*count),
                Some(latest) => {
                    self.unwrapped[i].saturating_add(i64::from(count.wrapping_sub(latest[i].0)))
                }
            };
        }
        self.latest = Some(*counts);
    }

    /// Latches the pulses of discs that turn otherwise than the board's.
    fn latch_own_pulses(&mut self) {
        for (i, from) in self.from.iter().enumerate().take(self.joints) {
            let Some(disc) = from.disc_counts.filter(|disc| *disc > 0) else { continue };
            let now = scaled(self.unwrapped[from.channel], from.scale);
            let turns = (now - disc / 2).div_euclid(disc);
            let before = self.turns[i].replace(turns).unwrap_or(turns);
            if turns != before {
                // Upwards the pulse below was passed last, downwards the pulse above.
                let newest = if turns > before { turns } else { turns + 1 };
                self.own_pulses[i] = Some(wrapped(newest * disc + disc / 2));
            }
        }
    }
}

/// A count at another scale.
#[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "counts fit")]
fn scaled(count: i64, scale: f64) -> i64 {
    (count as f64 * scale).round() as i64
}

/// As counts wrap at the ends of 32 bits.
#[expect(clippy::cast_possible_truncation, reason = "wrapped on purpose, as counts wrap")]
fn wrapped(count: i64) -> Counts {
    Counts(count as i32)
}

impl Encoders for ConnectedEncoders {
    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn joints(&self) -> usize {
        self.joints
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        let reading = self.half.sample(release).map_err(|bad| self.of_joint(bad))?;
        self.follow(&reading.value);
        self.latch_own_pulses();
        let value = self.from.map(|from| wrapped(scaled(self.unwrapped[from.channel], from.scale)));
        Ok(Reading { value, acquired: reading.acquired })
    }

    fn has_index(&self) -> bool {
        self.half.has_index()
    }

    fn index_pulses(&self) -> IndexPulses {
        let mut out = [None; CHANNELS];
        let Some(latest) = &self.latest else { return out };
        let pulses = self.half.index_pulses();
        for (i, from) in self.from.iter().enumerate().take(self.joints) {
            let (now, channel) = (self.unwrapped[from.channel], from.channel);
            let shown = |Counts(pulse): Counts| {
                let back = i64::from(latest[channel].0.wrapping_sub(pulse));
                wrapped(scaled(now.saturating_sub(back), from.scale))
            };
            out[i] = match from.disc_counts {
                Some(_) => self.own_pulses[i].filter(|_| self.half.has_index()),
                None => pulses[channel].filter(|_| from.scale != 0.0).map(shown),
            };
        }
        out
    }

    fn index_pulse_reach(&self) -> i32 {
        let scales = self.from[..self.joints].iter().map(|from| from.scale.abs());
        let least = scales.filter(|scale| *scale > 0.0).fold(1.0, f64::min);
        #[expect(clippy::cast_possible_truncation, reason = "at most the board's own reach")]
        let reach = (f64::from(self.half.index_pulse_reach()) * least) as i32;
        reach
    }
}

impl ConnectedEncoders {
    /// An error of a channel as one of the joint that it belongs to.
    fn of_joint(&self, bad: Error) -> Error {
        let joint =
            self.from[..self.joints].iter().position(|f| f.channel == usize::from(bad.channel));
        match joint.and_then(|joint| u16::try_from(joint).ok()) {
            Some(joint) => Error { channel: joint, ..bad },
            None => bad,
        }
    }
}

/// Where the code of one joint goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OutputChannel {
    pub(super) channel: usize,
    /// Codes of the channel for one of the joint's.
    pub(super) scale: f64,
    /// Largest code of the joint that is let through, in its own codes.
    pub(super) limit_codes: f64,
}

/// Converters in another order, direction and scale, with a limit.
pub(super) struct ConnectedAnalogOut {
    half: Box<dyn AnalogOut>,
    to: [OutputChannel; CHANNELS],
    joints: usize,
    range: (DacCode, DacCode),
    /// Which of the caller's codes belongs to each joint; the joint's own number by default.
    reads: [usize; CHANNELS],
    channels: usize,
}

impl ConnectedAnalogOut {
    /// # Errors
    /// A channel that the board does not have.
    pub(super) fn new(
        half: Box<dyn AnalogOut>,
        all: &[OutputChannel],
    ) -> Result<ConnectedAnalogOut, Invalid> {
        let wired = half.channels();
        if let Some(i) = all.iter().position(|to| to.channel >= wired) {
            let what = format!("the board has {wired} outputs, none of number {}", all[i].channel);
            let place = format!("motor_channel[{i}]");
            return Err(Invalid::new(place, what, format!("give 0 to {}", wired.max(1) - 1)));
        }
        let (low, high) = half.code_range();
        // What every joint can take; a scale of -1 exchanges the ends.
        let (mut least, mut most) = (f64::NEG_INFINITY, f64::INFINITY);
        for to in all {
            let ends = [f64::from(low.0) / to.scale, f64::from(high.0) / to.scale];
            least = least.max(ends[0].min(ends[1]));
            most = most.min(ends[0].max(ends[1]));
        }
        // A converter reaches one code farther down than up; a reversed motor clips that code.
        let whole = |x: f64| x.round().clamp(f64::from(i32::MIN), f64::from(i32::MAX));
        let clipped = i32::from(all.iter().any(|to| to.scale < 0.0));
        #[expect(clippy::cast_possible_truncation, reason = "clamped to 32 bits")]
        let range = (DacCode(whole(least) as i32 - clipped), DacCode(whole(most) as i32));
        let unused = OutputChannel { channel: 0, scale: 0.0, limit_codes: 0.0 };
        let to = core::array::from_fn(|i| all.get(i).copied().unwrap_or(unused));
        let joints = all.len().min(CHANNELS);
        let reads = core::array::from_fn(|i| i);
        Ok(ConnectedAnalogOut { half, to, joints, range, reads, channels: joints })
    }

    /// The same with joint i taking the caller's code `channels[i]`, over the board's own range:
    /// an amplifier that is asked for more than it has saturates.
    pub(super) fn reading(mut self, channels: &[usize]) -> ConnectedAnalogOut {
        self.range = self.half.code_range();
        for (reads, channel) in self.reads.iter_mut().zip(channels) {
            *reads = *channel;
        }
        self.channels = (1 + channels.iter().copied().max().unwrap_or(0)).max(self.joints);
        self
    }
}

impl AnalogOut for ConnectedAnalogOut {
    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn channels(&self) -> usize {
        self.channels
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        self.range
    }

    #[expect(clippy::cast_possible_truncation, reason = "clamped to the codes of the board")]
    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let (low, high) = self.half.code_range();
        let mut out = [self.half.safe_value(); CHANNELS];
        for (i, to) in self.to.iter().enumerate().take(self.joints) {
            let code = codes[self.reads[i]];
            if code < self.range.0 || code > self.range.1 {
                let channel = u16::try_from(self.reads[i]).unwrap_or(Error::ALL_CHANNELS);
                return Err(Error::on_channel(ErrorKind::OutOfRange, "joints.analog_out", channel));
            }
            let limited = f64::from(code.0).clamp(-to.limit_codes, to.limit_codes);
            let scaled = (limited * to.scale).round() as i32;
            out[to.channel] = DacCode(scaled.clamp(low.0, high.0));
        }
        self.half.commit(release, &out).map_err(|bad| self.of_joint(bad))
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.half.safe()
    }

    fn safe_value(&self) -> DacCode {
        self.half.safe_value()
    }

    fn longest_silence(&self) -> Nanos {
        self.half.longest_silence()
    }
}

impl ConnectedAnalogOut {
    /// An error of a channel of the board as one of the caller's channel that drives it.
    fn of_joint(&self, bad: Error) -> Error {
        let joint =
            self.to[..self.joints].iter().position(|to| to.channel == usize::from(bad.channel));
        match joint.and_then(|joint| u16::try_from(self.reads[joint]).ok()) {
            Some(joint) => Error { channel: joint, ..bad },
            None => bad,
        }
    }
}

#[cfg(test)]
mod tests;
