//! Drives that close a loop as the joints see them: each joint by its own channel, direction and
//! scale. Positions and velocities turn with the encoders, torques with the motors.

use taktil_hal::{
    CHANNELS, Counts, DriveActual, DriveCommand, DriveIn, DriveLoop, DriveOut, Error, ErrorKind,
    Nanos, Reading,
};
use taktil_rtcore::Invalid;

/// How one channel of the caller belongs to a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct DriveChannel {
    /// The caller's channel.
    pub(super) caller: usize,
    /// The drive's channel.
    pub(super) channel: usize,
    /// Counts of the drive for one of the caller's; not 0.
    pub(super) counts: f64,
    /// Torque codes of the drive for one of the caller's; not 0.
    pub(super) codes: f64,
    /// Largest torque code of the caller that is let through.
    pub(super) limit_codes: f64,
}

/// Refuses a channel that the drives do not have.
fn check(all: &[DriveChannel], wired: usize) -> Result<(), Invalid> {
    let Some(i) = all.iter().position(|one| one.channel >= wired) else { return Ok(()) };
    let what = format!("there are {wired} drives, none of number {}", all[i].channel);
    let remedy = format!("give 0 to {}", wired.max(1) - 1);
    Err(Invalid::new(format!("motor_channel[{i}]"), what, remedy))
}

/// How many channels the caller sees.
fn width(all: &[DriveChannel]) -> usize {
    1 + all.iter().map(|one| one.caller).max().unwrap_or(0)
}

/// An error of a drive's channel as one of the caller's.
fn of_caller(all: &[DriveChannel], bad: Error) -> Error {
    let caller = all.iter().find(|one| one.channel == usize::from(bad.channel));
    match caller.and_then(|one| u16::try_from(one.caller).ok()) {
        Some(channel) => Error { channel, ..bad },
        None => bad,
    }
}

/// The output half in another order, direction and scale, with a limit of the torque.
pub(super) struct ConnectedDriveOut {
    half: Box<dyn DriveOut>,
    all: Vec<DriveChannel>,
    range: (i32, i32),
}

#[expect(clippy::cast_possible_truncation, reason = "clamped to 32 bits")]
fn whole(x: f64) -> i32 {
    x.round().clamp(f64::from(i32::MIN), f64::from(i32::MAX)) as i32
}

impl ConnectedDriveOut {
    /// # Errors
    /// A channel that the drives do not have.
    pub(super) fn new(
        half: Box<dyn DriveOut>,
        all: Vec<DriveChannel>,
    ) -> Result<ConnectedDriveOut, Invalid> {
        check(&all, half.channels())?;
        let (low, high) = half.target_range();
        let is_torque = half.control_loop() == DriveLoop::Torque;
        // What every drive can take; a scale of -1 exchanges the ends.
        let (mut least, mut most) = (f64::NEG_INFINITY, f64::INFINITY);
        for one in &all {
            let scale = if is_torque { one.codes } else { one.counts };
            let ends = [f64::from(low) / scale, f64::from(high) / scale];
            least = least.max(ends[0].min(ends[1]));
            most = most.min(ends[0].max(ends[1]));
        }
        // A converter reaches one code farther down than up; a reversed motor clips that code.
        let clipped = i32::from(is_torque && all.iter().any(|one| one.codes < 0.0));
        let range = (whole(least).saturating_sub(clipped), whole(most));
        Ok(ConnectedDriveOut { half, all, range })
    }

    fn scaled(&self, one: &DriveChannel, target: i32) -> i32 {
        let (low, high) = self.half.target_range();
        let target = f64::from(target);
        let scaled = match self.half.control_loop() {
            DriveLoop::Torque => target.clamp(-one.limit_codes, one.limit_codes) * one.codes,
            DriveLoop::Velocity | DriveLoop::Position => target * one.counts,
        };
        whole(scaled).clamp(low, high)
    }
}

impl DriveOut for ConnectedDriveOut {
    fn channels(&self) -> usize {
        width(&self.all)
    }

    fn control_loop(&self) -> DriveLoop {
        self.half.control_loop()
    }

    fn target_range(&self) -> (i32, i32) {
        self.range
    }

    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn commit(&mut self, release: Nanos, command: &DriveCommand) -> Result<(), Error> {
        let mut targets = [0; CHANNELS];
        for one in &self.all {
            let target = command.targets[one.caller];
            if !(self.range.0..=self.range.1).contains(&target) {
                let channel = u16::try_from(one.caller).unwrap_or(Error::ALL_CHANNELS);
                return Err(Error::on_channel(ErrorKind::OutOfRange, "joints.drive_out", channel));
            }
            targets[one.channel] = self.scaled(one, target);
        }
        let committed = self.half.commit(release, &DriveCommand { targets, ..*command });
        committed.map_err(|bad| of_caller(&self.all, bad))
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.half.safe()
    }

    fn longest_silence(&self) -> Nanos {
        self.half.longest_silence()
    }
}

/// The input half in another order, direction and scale.
pub(super) struct ConnectedDriveIn {
    half: Box<dyn DriveIn>,
    all: Vec<DriveChannel>,
}

impl ConnectedDriveIn {
    /// # Errors
    /// A channel that the drives do not have.
    pub(super) fn new(
        half: Box<dyn DriveIn>,
        all: Vec<DriveChannel>,
    ) -> Result<ConnectedDriveIn, Invalid> {
        check(&all, half.channels())?;
        Ok(ConnectedDriveIn { half, all })
    }
}

impl DriveIn for ConnectedDriveIn {
    fn channels(&self) -> usize {
        width(&self.all)
    }

    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    #[expect(clippy::cast_possible_truncation, reason = "wrapped on purpose, as counts wrap")]
    fn sample(&mut self, release: Nanos) -> Result<Reading<[DriveActual; CHANNELS]>, Error> {
        let reading = self.half.sample(release).map_err(|bad| of_caller(&self.all, bad))?;
        let mut value = [DriveActual::default(); CHANNELS];
        for one in &self.all {
            let drive = reading.value[one.channel];
            let counts = (f64::from(drive.position.0) / one.counts).round() as i64;
            value[one.caller] = DriveActual {
                position: Counts(counts as i32),
                velocity_counts_s: whole(f64::from(drive.velocity_counts_s) / one.counts),
                torque_code: whole(f64::from(drive.torque_code) / one.codes),
                ..drive
            };
        }
        Ok(Reading { value, acquired: reading.acquired })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_hal::link::{Receiver, Sender, link};
    use taktil_hal::{DriveRequest, DriveState};

    struct Drives(Sender<DriveCommand>, DriveLoop);

    impl DriveOut for Drives {
        fn channels(&self) -> usize {
            2
        }
        fn control_loop(&self) -> DriveLoop {
            self.1
        }
        fn target_range(&self) -> (i32, i32) {
            (-1000, 1000)
        }
        fn commit(&mut self, release: Nanos, command: &DriveCommand) -> Result<(), Error> {
            let _ = self.0.send(*command, release, release);
            Err(Error::on_channel(ErrorKind::Transient, "drives", 1))
        }
        fn safe(&mut self) -> Result<(), Error> {
            Ok(())
        }
        fn longest_silence(&self) -> Nanos {
            Nanos::from_millis(10)
        }
    }

    impl DriveIn for Drives {
        fn channels(&self) -> usize {
            2
        }
        fn sample(&mut self, release: Nanos) -> Result<Reading<[DriveActual; CHANNELS]>, Error> {
            let mut value = [DriveActual::default(); CHANNELS];
            value[1] = DriveActual {
                position: Counts(i32::MIN),
                velocity_counts_s: 40,
                torque_code: 250,
                state: DriveState::Following,
                fault_code: 0,
            };
            Ok(Reading { value, acquired: release })
        }
    }

    /// Two joints on exchanged channels; the first turns the other way and has codes of a fourth.
    fn crossed() -> Vec<DriveChannel> {
        let plain =
            DriveChannel { caller: 1, channel: 0, counts: 1.0, codes: 1.0, limit_codes: 1e9 };
        let turned =
            DriveChannel { caller: 0, channel: 1, counts: -1.0, codes: -0.25, limit_codes: 2000.0 };
        vec![turned, plain]
    }

    fn pair(of: DriveLoop) -> (ConnectedDriveOut, Receiver<DriveCommand>) {
        let (to, from) = link(8);
        (ConnectedDriveOut::new(Box::new(Drives(to, of)), crossed()).unwrap(), from)
    }

    #[test]
    fn targets_go_to_their_drives_in_the_drives_units() {
        for (of, due) in [(DriveLoop::Torque, [300, -200]), (DriveLoop::Position, [300, -800])] {
            let (mut half, mut from) = pair(of);
            let mut command = DriveCommand { request: DriveRequest::Follow, ..DriveCommand::SAFE };
            (command.targets[0], command.targets[1]) = (800, 300);
            let bad = half.commit(Nanos(1), &command).unwrap_err();
            assert_eq!(bad.channel, 0, "the drive of channel 1 is that of the first joint");
            let got = from.newest(Nanos::MAX).unwrap().value;
            assert_eq!(
                (&got.targets[..2], got.request),
                (&due[..], DriveRequest::Follow),
                "{of:?}"
            );
        }
        let (mut half, _from) = pair(DriveLoop::Torque);
        assert_eq!(half.target_range(), (-1001, 1000), "what both can take");
        let mut command = DriveCommand::SAFE;
        command.targets[1] = 1001;
        assert_eq!(half.commit(Nanos(1), &command).unwrap_err().channel, 1);
    }

    #[test]
    fn reports_come_from_their_drives_in_the_joints_units() {
        let (to, _from) = link(8);
        let drives = Box::new(Drives(to, DriveLoop::Torque));
        let mut half = ConnectedDriveIn::new(drives, crossed()).unwrap();
        let value = half.sample(Nanos(1)).unwrap().value;
        let first = value[0];
        assert_eq!((first.position.0, first.velocity_counts_s), (i32::MIN, -40), "it wraps");
        assert_eq!((first.torque_code, first.state), (-1000, DriveState::Following));
        assert_eq!(value[1], DriveActual::default());
    }

    #[test]
    fn a_drive_that_is_not_there_is_refused() {
        let (to, _from) = link(8);
        let far = DriveChannel { channel: 2, ..crossed()[0] };
        let drives = Box::new(Drives(to, DriveLoop::Torque));
        let bad = ConnectedDriveIn::new(drives, vec![far]).err().unwrap();
        assert_eq!((bad.place.as_str(), bad.remedy.as_str()), ("motor_channel[0]", "give 0 to 1"));
    }
}
