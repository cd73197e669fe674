//! How a half answers when the exchange that it shares has failed.

use taktil_hal::{Error, ErrorKind};

/// Why an exchange gave a half nothing, before it is known which half it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Failure {
    /// What kind of failure it is.
    pub kind: ErrorKind,
    /// The channel that failed, or [`Error::ALL_CHANNELS`].
    pub channel: u16,
}

impl Failure {
    /// What is shared is gone for good.
    pub const LOST: Failure = Failure::whole(ErrorKind::Lost);

    /// A failure of all channels.
    #[must_use]
    pub const fn whole(kind: ErrorKind) -> Failure {
        Failure { kind, channel: Error::ALL_CHANNELS }
    }

    /// A failure of one channel; a number that no half has stands for all of them.
    #[must_use]
    pub fn on_channel(kind: ErrorKind, channel: usize) -> Failure {
        Failure { kind, channel: u16::try_from(channel).unwrap_or(Error::ALL_CHANNELS) }
    }

    /// The same as the answer of the half that is called `device`.
    #[must_use]
    pub const fn of(self, device: &'static str) -> Error {
        Error { kind: self.kind, device, channel: self.channel }
    }
}

impl From<ErrorKind> for Failure {
    fn from(kind: ErrorKind) -> Failure {
        Failure::whole(kind)
    }
}

/// Keeps the first of a half's failures that is final: what is lost stays lost.
#[derive(Clone, Copy, Debug, Default)]
pub struct Presence {
    lost: bool,
}

impl Presence {
    /// The answer of the half that is called `device`; `None`: somebody else was in what is shared,
    /// and this time there is nothing.
    ///
    /// # Errors
    /// The failure; [`ErrorKind::Lost`] from the first one of that kind on.
    pub fn answer<T, F: Into<Failure>>(
        &mut self,
        device: &'static str,
        outcome: Option<Result<T, F>>,
    ) -> Result<T, Error> {
        let outcome = outcome.map(|outcome| outcome.map_err(Into::into));
        let outcome = outcome.unwrap_or(Err(Failure::whole(ErrorKind::Transient)));
        outcome.map_err(|failure| {
            self.lost |= failure.kind == ErrorKind::Lost;
            if self.lost { Error::whole(ErrorKind::Lost, device) } else { failure.of(device) }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_lost_stays_lost_and_a_taken_board_answers_transiently() {
        let mut presence = Presence::default();
        let kind = |answer: Result<(), Error>| answer.map_err(|error| error.kind);
        let taken: Option<Result<(), Failure>> = None;
        assert_eq!(kind(presence.answer("board", taken)), Err(ErrorKind::Transient));
        let channel = Failure::on_channel(ErrorKind::Transient, 3);
        let error = presence.answer::<(), _>("board", Some(Err(channel))).unwrap_err();
        assert_eq!((error.kind, error.channel), (ErrorKind::Transient, 3));
        assert_eq!(presence.answer::<_, Failure>("board", Some(Ok(5))), Ok(5));
        let lost = presence.answer::<(), _>("board", Some(Err(ErrorKind::Lost)));
        assert_eq!(kind(lost), Err(ErrorKind::Lost));
        let after = presence.answer::<(), _>("board", Some(Err(channel)));
        assert_eq!(after, Err(Error::whole(ErrorKind::Lost, "board")));
    }
}
