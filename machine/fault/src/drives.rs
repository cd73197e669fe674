//! Drives that close a loop, with faults: words that are lost or stand still, reports that are
//! displaced, old or missing, and drives that report a fault of their own.

use taktil_hal::fault::FaultKind;
use taktil_hal::{
    CHANNELS, DriveActual, DriveCommand, DriveIn, DriveLoop, DriveOut, DriveRequest, DriveState,
    Error, ErrorKind, Nanos, Reading,
};

use crate::target_faults::{Answer, TargetFaults};

/// The kinds that can befall the words to drives.
pub const DRIVE_OUT_KINDS: [FaultKind; 5] =
    [FaultKind::Failing, FaultKind::Frozen, FaultKind::Loss, FaultKind::Jump, FaultKind::Unplugged];

/// The kinds that can befall the reports of drives; a dead one reports a fault of its own.
pub const DRIVE_IN_KINDS: [FaultKind; 6] = [
    FaultKind::Dead,
    FaultKind::Frozen,
    FaultKind::Jump,
    FaultKind::Failing,
    FaultKind::Silence,
    FaultKind::Unplugged,
];

const OUTPUT_DEVICE: &str = "fault.drive_out";
const INPUT_DEVICE: &str = "fault.drive_in";
/// The code that a dead drive reports: the first of those that belong to makers.
const DEAD_DRIVE_CODE: u16 = 0xff00;

/// The output half behind faults.
pub(crate) struct FaultyDriveOut {
    half: Box<dyn DriveOut>,
    faults: TargetFaults,
    /// The word that was handed to the drives last.
    put: DriveCommand,
    now: Nanos,
}

impl FaultyDriveOut {
    pub(crate) fn new(half: Box<dyn DriveOut>, faults: TargetFaults) -> FaultyDriveOut {
        FaultyDriveOut { half, faults, put: DriveCommand::SAFE, now: Nanos(i64::MIN) }
    }

    fn target(&self, channel: usize, target: i32, now: Nanos) -> i32 {
        let (low, high) = self.half.target_range();
        if self.faults.has(FaultKind::Frozen, channel, now) {
            return self.put.targets[channel];
        }
        match self.faults.strength(FaultKind::Jump, channel, now) {
            Some(jump) => target.saturating_add(jump as i32).clamp(low, high),
            None => target,
        }
    }
}

impl DriveOut for FaultyDriveOut {
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
        self.now = release;
        let (low, high) = self.half.target_range();
        let wired = &command.targets[..self.half.channels().min(CHANNELS)];
        if let Some(bad) = wired.iter().position(|target| !(low..=high).contains(target)) {
            return Err(Error::on_channel(ErrorKind::OutOfRange, OUTPUT_DEVICE, bad as u16));
        }
        if self.faults.is_active(FaultKind::Unplugged, release) {
            return Err(Error::whole(ErrorKind::Lost, OUTPUT_DEVICE));
        }
        if self.faults.happens(FaultKind::Failing, release) {
            return Err(Error::whole(ErrorKind::Transient, OUTPUT_DEVICE));
        }
        if self.faults.happens(FaultKind::Loss, release) {
            return Ok(());
        }
        let mut word = *command;
        for channel in 0..self.half.channels().min(CHANNELS) {
            word.targets[channel] = self.target(channel, command.targets[channel], release);
        }
        self.put = word;
        self.half.commit(release, &word)
    }

    fn safe(&mut self) -> Result<(), Error> {
        if self.faults.is_active(FaultKind::Unplugged, self.now) {
            return Err(Error::whole(ErrorKind::Lost, OUTPUT_DEVICE));
        }
        self.put = DriveCommand { request: DriveRequest::Off, ..self.put };
        self.half.safe()
    }

    fn longest_silence(&self) -> Nanos {
        self.half.longest_silence()
    }
}

/// The input half behind faults.
pub(crate) struct FaultyDriveIn {
    half: Box<dyn DriveIn>,
    faults: TargetFaults,
    answered: Option<(Nanos, Answer<[DriveActual; CHANNELS]>)>,
    /// What was handed out last.
    shown: [DriveActual; CHANNELS],
}

impl FaultyDriveIn {
    pub(crate) fn new(half: Box<dyn DriveIn>, faults: TargetFaults) -> FaultyDriveIn {
        let shown = [DriveActual::default(); CHANNELS];
        FaultyDriveIn { half, faults, answered: None, shown }
    }

    fn answer(&mut self, release: Nanos) -> Answer<[DriveActual; CHANNELS]> {
        let reading = self.half.sample(release);
        if self.faults.is_active(FaultKind::Unplugged, release) {
            return Err(Error::whole(ErrorKind::Lost, INPUT_DEVICE));
        }
        if self.faults.is_active(FaultKind::Silence, release) {
            return Err(Error::whole(ErrorKind::Stale, INPUT_DEVICE));
        }
        if self.faults.happens(FaultKind::Failing, release) {
            return Err(Error::whole(ErrorKind::Transient, INPUT_DEVICE));
        }
        let mut reading = reading?;
        for channel in 0..self.half.channels().min(CHANNELS) {
            let drive = &mut reading.value[channel];
            if self.faults.has(FaultKind::Frozen, channel, release) {
                *drive = self.shown[channel];
            }
            if let Some(jump) = self.faults.strength(FaultKind::Jump, channel, release) {
                drive.position.0 = drive.position.0.wrapping_add(jump as i32);
            }
            if self.faults.has(FaultKind::Dead, channel, release) {
                (drive.velocity_counts_s, drive.torque_code) = (0, 0);
                (drive.state, drive.fault_code) = (DriveState::Fault, DEAD_DRIVE_CODE);
            }
            self.shown[channel] = *drive;
        }
        Ok(reading)
    }
}

impl DriveIn for FaultyDriveIn {
    fn channels(&self) -> usize {
        self.half.channels()
    }

    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[DriveActual; CHANNELS]>, Error> {
        if let Some((at, answer)) = self.answered
            && at == release
        {
            return answer;
        }
        let answer = self.answer(release);
        self.answered = Some((release, answer));
        answer
    }
}
