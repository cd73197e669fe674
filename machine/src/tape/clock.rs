//! The tape of a board's clock: the entry of its answers, a half that records, and one that is
//! played.

use taktil_hal::{BoardClock, Error, Nanos, Reading};
use taktil_rtcore::{Ports, payload};

use super::entry::Outcome;
use super::playback::Player;
use super::{RecordingHalf, name, recording_half};

payload! {
    /// An answer of a board's clock.
    pub struct ClockEntry {
        /// When the phase was measured.
        pub acquired_ns: i64,
        /// How much later than its place in the board's cycle the job was.
        pub phase_ns: i64,
        /// [`Outcome::code`].
        pub outcome: u16,
        /// [`Outcome::channel`].
        pub channel: u16,
    }
}

impl ClockEntry {
    /// The entry for an answer.
    #[must_use]
    pub fn of(answer: &Result<Reading<Nanos>, Error>) -> ClockEntry {
        let Outcome { code: outcome, channel } = Outcome::of(answer);
        let (acquired_ns, phase_ns) =
            answer.map_or((0, 0), |reading| (reading.acquired.0, reading.value.0));
        ClockEntry { acquired_ns, phase_ns, outcome, channel }
    }

    /// The recorded answer.
    ///
    /// # Errors
    /// The recorded one.
    pub fn answer(&self, device: &'static str) -> Result<Reading<Nanos>, Error> {
        Outcome { code: self.outcome, channel: self.channel }.answer(device)?;
        Ok(Reading { value: Nanos(self.phase_ns), acquired: Nanos(self.acquired_ns) })
    }
}

/// A board's clock that is recorded, for the task that declares `ports`.
#[must_use]
pub fn board_clock(half: Box<dyn BoardClock>, ports: &mut Ports) -> Box<dyn BoardClock> {
    Box::new(recording_half::<_, ClockEntry>(half, name::BOARD_CLOCK, ports))
}

impl BoardClock for RecordingHalf<dyn BoardClock, ClockEntry> {
    fn cycle(&self) -> Nanos {
        self.half.cycle()
    }

    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<Nanos>, Error> {
        let answer = self.half.sample(release);
        self.tape.append(release, ClockEntry::of(&answer));
        answer
    }
}

/// A board's clock that reads a tape.
pub(super) struct BoardClockPlayer {
    pub(super) player: Player<ClockEntry>,
    pub(super) cycle: Nanos,
}

impl BoardClock for BoardClockPlayer {
    fn cycle(&self) -> Nanos {
        self.cycle
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<Nanos>, Error> {
        self.player.next(release)?.answer(self.player.device)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_hal::ErrorKind;

    #[test]
    fn an_answer_comes_back_as_it_was() {
        let reading = Reading { value: Nanos(-499_999), acquired: Nanos(7_000_000) };
        assert_eq!(ClockEntry::of(&Ok(reading)).answer("player"), Ok(reading));
        for kind in [ErrorKind::Transient, ErrorKind::Stale, ErrorKind::Lost] {
            let failed = ClockEntry::of(&Err(Error::whole(kind, "board"))).answer("player");
            assert_eq!(failed, Err(Error::whole(kind, "player")));
        }
    }
}
