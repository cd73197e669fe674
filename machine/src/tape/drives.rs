//! The tapes of drives that close a loop: the entries of their reports and of the words to them,
//! halves that record, and halves that are played.

use taktil_hal::{
    CHANNELS, Counts, DriveActual, DriveCommand, DriveIn, DriveLoop, DriveOut, DriveRequest,
    DriveState, Error, ErrorKind, Nanos, Reading,
};
use taktil_rtcore::{Ports, payload};

use super::entry::{NARROW_CHANNELS, Outcome, first, widened};
use super::playback::Player;
use super::{RecordingHalf, name, recording_half};

payload! {
    /// An answer of the input half of drives.
    pub struct DriveEntry<const N: usize = 8> {
        /// When the drives latched it.
        pub acquired_ns: i64,
        /// Position of each drive (counts).
        pub position: [i32; N],
        /// Velocity of each drive (counts/s).
        pub velocity: [i32; N],
        /// Torque of each drive, in its codes.
        pub torque: [i32; N],
        /// State of each power section, by its place in [`DriveState::ALL`].
        pub state: [u16; N],
        /// Code of each drive's fault.
        pub fault_code: [u16; N],
        /// [`Outcome::code`].
        pub outcome: u16,
        /// [`Outcome::channel`].
        pub channel: u16,
    }
}

payload! {
    /// A word to drives, and their answer.
    pub struct DriveWord<const N: usize = 8> {
        /// Target of each drive.
        pub targets: [i32; N],
        /// What is wanted, by its place in [`DriveRequest::ALL`].
        pub request: u16,
        /// 1 when faults are to be reset.
        pub reset: u16,
        /// [`Outcome::code`].
        pub outcome: u16,
        /// [`Outcome::channel`].
        pub channel: u16,
    }
}

impl<const N: usize> DriveEntry<N> {
    /// The same entry with all channels that a half can have.
    #[must_use]
    pub fn widened(self) -> DriveEntry<CHANNELS> {
        let DriveEntry {
            acquired_ns,
            position,
            velocity,
            torque,
            state,
            fault_code,
            outcome,
            channel,
        } = self;
        DriveEntry {
            acquired_ns,
            position: widened(&position),
            velocity: widened(&velocity),
            torque: widened(&torque),
            state: widened(&state),
            fault_code: widened(&fault_code),
            outcome,
            channel,
        }
    }

    /// The entry for an answer.
    #[must_use]
    pub fn of(answer: &Result<Reading<[DriveActual; CHANNELS]>, Error>) -> DriveEntry<N> {
        let Outcome { code: outcome, channel } = Outcome::of(answer);
        let Ok(reading) = answer else {
            return DriveEntry { outcome, channel, ..DriveEntry::default() };
        };
        let drives = first::<N, _>(&reading.value);
        DriveEntry {
            acquired_ns: reading.acquired.0,
            position: drives.map(|drive| drive.position.0),
            velocity: drives.map(|drive| drive.velocity_counts_s),
            torque: drives.map(|drive| drive.torque_code),
            state: drives.map(|drive| drive.state as u16),
            fault_code: drives.map(|drive| drive.fault_code),
            outcome,
            channel,
        }
    }

    /// The recorded answer; a state that nobody knows reads as a fault.
    ///
    /// # Errors
    /// The recorded one.
    pub fn answer(&self, device: &'static str) -> Result<Reading<[DriveActual; CHANNELS]>, Error> {
        Outcome { code: self.outcome, channel: self.channel }.answer(device)?;
        let drives: [DriveActual; N] = core::array::from_fn(|i| DriveActual {
            position: Counts(self.position[i]),
            velocity_counts_s: self.velocity[i],
            torque_code: self.torque[i],
            state: *DriveState::ALL.get(usize::from(self.state[i])).unwrap_or(&DriveState::Fault),
            fault_code: self.fault_code[i],
        });
        Ok(Reading { value: widened(&drives), acquired: Nanos(self.acquired_ns) })
    }
}

impl<const N: usize> DriveWord<N> {
    /// The same entry with all channels that a half can have.
    #[must_use]
    pub fn widened(self) -> DriveWord<CHANNELS> {
        let DriveWord { targets, request, reset, outcome, channel } = self;
        DriveWord { targets: widened(&targets), request, reset, outcome, channel }
    }

    /// The entry for a command and its answer.
    #[must_use]
    pub fn of(command: &DriveCommand, answer: &Result<(), Error>) -> DriveWord<N> {
        let Outcome { code: outcome, channel } = Outcome::of(answer);
        DriveWord {
            targets: first::<N, _>(&command.targets),
            request: command.request as u16,
            reset: u16::from(command.reset),
            outcome,
            channel,
        }
    }

    /// The recorded command; a request that nobody knows asks for no torque.
    #[must_use]
    pub fn command(&self) -> DriveCommand {
        let request = DriveRequest::ALL.get(usize::from(self.request)).copied();
        DriveCommand {
            targets: widened(&self.targets),
            request: request.unwrap_or_default(),
            reset: self.reset == 1,
        }
    }

    /// The recorded answer.
    #[must_use]
    pub fn outcome(&self) -> Outcome {
        Outcome { code: self.outcome, channel: self.channel }
    }
}

/// Drives whose reports are recorded.
#[must_use]
pub fn drive_in(half: Box<dyn DriveIn>, ports: &mut Ports) -> Box<dyn DriveIn> {
    if half.channels() <= NARROW_CHANNELS {
        Box::new(recording_half::<_, DriveEntry>(half, name::DRIVE_IN, ports))
    } else {
        Box::new(recording_half::<_, DriveEntry<CHANNELS>>(half, name::DRIVE_IN, ports))
    }
}

/// Drives the words to which are recorded.
#[must_use]
pub fn drive_out(half: Box<dyn DriveOut>, ports: &mut Ports) -> Box<dyn DriveOut> {
    if half.channels() <= NARROW_CHANNELS {
        Box::new(recording_half::<_, DriveWord>(half, name::DRIVE_OUT, ports))
    } else {
        Box::new(recording_half::<_, DriveWord<CHANNELS>>(half, name::DRIVE_OUT, ports))
    }
}

impl<const N: usize> DriveIn for RecordingHalf<dyn DriveIn, DriveEntry<N>> {
    fn channels(&self) -> usize {
        self.half.channels()
    }

    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[DriveActual; CHANNELS]>, Error> {
        let answer = self.half.sample(release);
        self.tape.append(release, DriveEntry::of(&answer));
        answer
    }
}

impl<const N: usize> DriveOut for RecordingHalf<dyn DriveOut, DriveWord<N>> {
    fn channels(&self) -> usize {
        self.half.channels()
    }

    fn control_loop(&self) -> DriveLoop {
        self.half.control_loop()
    }

    fn target_range(&self) -> (i32, i32) {
        self.half.target_range()
    }

    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn commit(&mut self, release: Nanos, command: &DriveCommand) -> Result<(), Error> {
        let answer = self.half.commit(release, command);
        self.tape.append(release, DriveWord::of(command, &answer));
        answer
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.half.safe()
    }

    fn longest_silence(&self) -> Nanos {
        self.half.longest_silence()
    }
}

/// Reports that are read from a tape.
pub(super) struct DriveInPlayer {
    pub(super) player: Player<DriveEntry<CHANNELS>>,
    pub(super) channels: usize,
}

impl DriveIn for DriveInPlayer {
    fn channels(&self) -> usize {
        self.channels
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[DriveActual; CHANNELS]>, Error> {
        self.player.next(release)?.answer(self.player.device)
    }
}

/// Drives that answer from a tape.
pub(super) struct DriveOutPlayer {
    pub(super) player: Player<DriveWord<CHANNELS>>,
    pub(super) channels: usize,
    pub(super) control_loop: DriveLoop,
    pub(super) targets: (i32, i32),
    pub(super) silence: Nanos,
}

impl DriveOut for DriveOutPlayer {
    fn channels(&self) -> usize {
        self.channels
    }

    fn control_loop(&self) -> DriveLoop {
        self.control_loop
    }

    fn target_range(&self) -> (i32, i32) {
        self.targets
    }

    fn commit(&mut self, release: Nanos, command: &DriveCommand) -> Result<(), Error> {
        let entry = self.player.next(release)?;
        let (low, high) = self.target_range();
        let mut wired = command.targets.iter().take(self.channels);
        if let Some(channel) = wired.position(|target| !(low..=high).contains(target)) {
            let channel = u16::try_from(channel).unwrap_or(Error::ALL_CHANNELS);
            return Err(Error::on_channel(ErrorKind::OutOfRange, self.player.device, channel));
        }
        entry.outcome().answer(self.player.device)
    }

    fn safe(&mut self) -> Result<(), Error> {
        Ok(())
    }

    fn longest_silence(&self) -> Nanos {
        self.silence
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_and_words_come_back_with_their_errors() {
        let mut value = [DriveActual::default(); CHANNELS];
        for (i, drive) in value.iter_mut().enumerate().take(7) {
            let number = i as i32;
            *drive = DriveActual {
                position: Counts(-number),
                velocity_counts_s: 100 * number,
                torque_code: 7 - number,
                state: DriveState::ALL[i % DriveState::ALL.len()],
                fault_code: if i % 5 == 4 { 0x8611 } else { 0 },
            };
        }
        let answer = Ok(Reading { value, acquired: Nanos(9) });
        let entry = DriveEntry::<NARROW_CHANNELS>::of(&answer);
        assert_eq!(entry.answer("drives"), answer);
        assert_eq!(entry.widened().answer("drives"), answer);
        let lost = Err(Error::on_channel(ErrorKind::Lost, "drives", 2));
        assert_eq!(DriveEntry::<NARROW_CHANNELS>::of(&lost).answer("drives"), lost);
        let mut command =
            DriveCommand { request: DriveRequest::QuickStop, reset: true, ..DriveCommand::SAFE };
        command.targets[2] = i32::MIN;
        let refused = Err(Error::on_channel(ErrorKind::Transient, "drives", 1));
        let word = DriveWord::<NARROW_CHANNELS>::of(&command, &refused);
        assert_eq!((word.command(), word.outcome().answer("drives")), (command, refused));
        assert_eq!(word.widened().command(), command);
        let unknown = DriveWord::<NARROW_CHANNELS> { request: 9, ..word };
        assert_eq!(unknown.command().request, DriveRequest::Off);
    }
}
