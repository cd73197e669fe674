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
    /// Counts that are shown for one of the channel's.
    pub(super) scale: f64,
}

/// Encoders in another order, direction and scale.
pub(super) struct ConnectedEncoders {
    half: Box<dyn Encoders>,
    from: [EncoderChannel; CHANNELS],
    joints: usize,
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
        let unused = EncoderChannel { channel: 0, scale: 0.0 };
        let from = core::array::from_fn(|i| all.get(i).copied().unwrap_or(unused));
        Ok(ConnectedEncoders { half, from, joints: all.len().min(CHANNELS) })
    }
}

/// A count at another scale; whole scales are exact and wrap at the ends of 32 bits as counts do.
#[expect(clippy::cast_possible_truncation, reason = "wrapped on purpose, as counts wrap")]
fn scaled(Counts(count): Counts, scale: f64) -> Counts {
    Counts((f64::from(count) * scale).round() as i64 as i32)
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
        let value = self.from.map(|from| scaled(reading.value[from.channel], from.scale));
        Ok(Reading { value, acquired: reading.acquired })
    }

    fn has_index(&self) -> bool {
        self.half.has_index()
    }

    fn index_pulses(&self) -> IndexPulses {
        let pulses = self.half.index_pulses();
        let mut out = [None; CHANNELS];
        for (out, from) in out.iter_mut().zip(&self.from).take(self.joints) {
            *out =
                pulses[from.channel].filter(|_| from.scale != 0.0).map(|c| scaled(c, from.scale));
        }
        out
    }

    fn index_pulse_reach(&self) -> i32 {
        self.half.index_pulse_reach()
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
        // A converter reaches one code farther down than up; a reversed motor clips that one code.
        let whole = |x: f64| x.round().clamp(f64::from(i32::MIN), f64::from(i32::MAX));
        let clipped = i32::from(all.iter().any(|to| to.scale < 0.0));
        #[expect(clippy::cast_possible_truncation, reason = "clamped to 32 bits")]
        let range = (DacCode(whole(least) as i32 - clipped), DacCode(whole(most) as i32 + clipped));
        let unused = OutputChannel { channel: 0, scale: 0.0, limit_codes: 0.0 };
        let to = core::array::from_fn(|i| all.get(i).copied().unwrap_or(unused));
        let joints = all.len().min(CHANNELS);
        let reads = core::array::from_fn(|i| i);
        Ok(ConnectedAnalogOut { half, to, joints, range, reads, channels: joints })
    }

    /// The same with joint i taking the caller's code `channels[i]`.
    pub(super) fn reading(mut self, channels: &[usize]) -> ConnectedAnalogOut {
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
        self.half.commit(release, &out)
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
