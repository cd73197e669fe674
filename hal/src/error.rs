//! The error that a device half returns instead of a value. It is `Copy` and holds no text that
//! would have to be allocated: a cycle decides by its [`ErrorKind`], and a report prints the rest.
//! Causes that only one board knows are not part of it.

use core::fmt;

/// What the caller can do about it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ErrorKind {
    /// This exchange failed, the next may succeed: a torn frame, a checksum, a busy converter. The
    /// device has used up its own bounded retries. Due at most now and then: the caller counts.
    Transient,
    /// The device answers, but has had nothing new for longer than it promises; the old value is
    /// withheld so that nobody can take it for a new one.
    Stale,
    /// A value is outside what the device can represent. Outputs: nothing was changed, not even
    /// the channels that were in range. Inputs: the device delivered a value it cannot mean.
    OutOfRange,
    /// The device is gone: unplugged, powered down, or answering as another device would. It stays
    /// gone until it is opened anew; every later call on this half says so too.
    Lost,
}

impl ErrorKind {
    /// One word or two for reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            ErrorKind::Transient => "transient fault",
            ErrorKind::Stale => "stale",
            ErrorKind::OutOfRange => "out of range",
            ErrorKind::Lost => "lost",
        }
    }
}

/// A refusal or a failure of one device half.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Error {
    /// What the caller can do about it.
    pub kind: ErrorKind,
    /// Which half, by a fixed name such as `"regmap.analog_out"`; never empty.
    pub device: &'static str,
    /// Which channel, counted from 0; [`Error::ALL_CHANNELS`] when it is the half as a whole.
    pub channel: u16,
}

impl Error {
    /// Stands for "no single channel".
    pub const ALL_CHANNELS: u16 = u16::MAX;

    /// A failure of one channel.
    #[must_use]
    pub const fn on_channel(kind: ErrorKind, device: &'static str, channel: u16) -> Error {
        Error { kind, device, channel }
    }

    /// A failure of the half as a whole.
    #[must_use]
    pub const fn whole(kind: ErrorKind, device: &'static str) -> Error {
        Error { kind, device, channel: Error::ALL_CHANNELS }
    }

    /// What the caller can do about it.
    #[must_use]
    pub const fn kind(&self) -> ErrorKind {
        self.kind
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.channel == Error::ALL_CHANNELS {
            write!(f, "{}: {}", self.device, self.kind.name())
        } else {
            write!(f, "{} channel {}: {}", self.device, self.channel, self.kind.name())
        }
    }
}

impl std::error::Error for Error {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_device_channel_and_cause() {
        let one = Error::on_channel(ErrorKind::OutOfRange, "board.analog_out", 3);
        assert_eq!(one.to_string(), "board.analog_out channel 3: out of range");
        assert_eq!(one.kind(), ErrorKind::OutOfRange);
        let all = Error::whole(ErrorKind::Lost, "board.encoders");
        assert_eq!(all.to_string(), "board.encoders: lost");
    }
}
