//! What the motors are driven by: converters before amplifiers, or drives that close a loop
//! themselves. Both take one word for each motor in each job.

use core::ops::RangeInclusive;

use taktil_hal::{AnalogOut, CHANNELS, DacCode, DriveLoop, DriveOut, Error, ErrorKind, Nanos};
use taktil_mechanics::transmission::Drive;
use taktil_rtcore::{FaultCode, Fold, Invalid, Mode, StateHash};

use crate::config::LoopName;
use crate::drive_stage::{DriveStage, Wanted};

/// The output half of the motors.
pub enum Motors {
    /// Converters before amplifiers.
    Converters(Box<dyn AnalogOut>),
    /// Drives that close a loop themselves.
    Drives(Box<dyn DriveOut>),
}

impl Motors {
    /// The word at which no torque is asked for.
    pub(crate) fn safe_word(&self) -> i32 {
        match self {
            Motors::Converters(half) => half.safe_value().0,
            Motors::Drives(_) => 0,
        }
    }

    /// Refuses a half with fewer channels than joints, with a narrower range than the drives'
    /// codes, and with another loop than the configuration names.
    pub(crate) fn check<const N: usize>(
        &self,
        drive: &Drive<N>,
        named: Option<LoopName>,
    ) -> Result<(), Invalid> {
        let (channels, what) = match self {
            Motors::Converters(half) => (half.channels(), "D/A board"),
            Motors::Drives(half) => (half.channels(), "output half of the drives"),
        };
        if channels < N {
            let what = format!("the {what} has {channels} channels");
            return Err(Invalid::new("", what, format!("wire a board with {N} outputs")));
        }
        match self {
            Motors::Converters(half) => {
                let (DacCode(low), DacCode(high)) = half.code_range();
                check_range(low..=high, drive, "D/A board takes")
            }
            Motors::Drives(half) => check_loop(half.as_ref(), drive, named),
        }
    }
}

fn check_range<const N: usize>(
    range: RangeInclusive<i32>,
    drive: &Drive<N>,
    who: &str,
) -> Result<(), Invalid> {
    let (drive_low, drive_high) = drive.code_range();
    if *range.start() > drive_low || *range.end() < drive_high {
        let what = format!("the {who} {range:?}, the drives need {drive_low}..={drive_high}");
        return Err(Invalid::new("", what, "wire a board of at least the drives' width"));
    }
    Ok(())
}

fn check_loop<const N: usize>(
    half: &dyn DriveOut,
    drive: &Drive<N>,
    named: Option<LoopName>,
) -> Result<(), Invalid> {
    let own = half.control_loop();
    if let Some(named) = named.map(LoopName::drive_loop).filter(|named| *named != own) {
        let what =
            format!("is `{}`, but the drives close that of the {}", named.name(), own.name());
        let remedy = format!("give `{}`, or set the drives up for the other", own.name());
        return Err(Invalid::new("drive_loop", what, remedy));
    }
    let (low, high) = half.target_range();
    if own == DriveLoop::Torque {
        return check_range(low..=high, drive, "drives' half takes");
    }
    if low >= 0 || high <= 0 {
        let what = format!("the drives take targets from {low} to {high} only");
        return Err(Invalid::new("", what, "wire drives that turn both ways"));
    }
    Ok(())
}

/// Counts failed writes in a row and decides whether the board is lost. Only transient failures are
/// tolerated: unlike a failed read, a failed write may leave an old torque on the drives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WriteFailurePolicy {
    pub(crate) allowed: u32,
    pub(crate) failed: u32,
}

impl WriteFailurePolicy {
    /// False when the board counts as lost.
    pub(crate) fn tolerates(&mut self, written: Result<(), Error>) -> bool {
        match written {
            Ok(()) => {
                self.failed = 0;
                true
            }
            Err(error) => {
                self.failed = self.failed.saturating_add(1);
                error.kind == ErrorKind::Transient && self.failed <= self.allowed
            }
        }
    }
}

/// The motors in their jobs.
pub(crate) enum MotorStage<const N: usize> {
    Converters(Box<dyn AnalogOut>),
    Drives(DriveStage<N>),
}

impl<const N: usize> Fold for MotorStage<N> {
    fn fold(&self, hash: &mut StateHash) {
        if let MotorStage::Drives(stage) = self {
            hash.add(stage);
        }
    }
}

impl<const N: usize> MotorStage<N> {
    /// Puts one word out for each motor.
    pub(crate) fn commit(
        &mut self,
        release: Nanos,
        words: &[i32; N],
        wanted: Wanted,
    ) -> Result<(), Error> {
        match self {
            MotorStage::Converters(half) => {
                let mut codes = [half.safe_value(); CHANNELS];
                for (channel, word) in codes.iter_mut().zip(words) {
                    *channel = DacCode(*word);
                }
                half.commit(release, &codes)
            }
            MotorStage::Drives(stage) => stage.commit(release, words, wanted),
        }
    }

    /// No torque, at once.
    pub(crate) fn safe(&mut self) {
        // A board that does not answer any more has its own watchdog.
        let _ = match self {
            MotorStage::Converters(half) => half.safe(),
            MotorStage::Drives(stage) => stage.safe(),
        };
    }

    /// The fault of a half that does not take words any more.
    pub(crate) const fn lost(&self) -> FaultCode {
        match self {
            MotorStage::Converters(_) => FaultCode::AnalogOutLost,
            MotorStage::Drives(_) => FaultCode::DriveLost,
        }
    }

    pub(crate) fn note_mode(&mut self, mode: Mode) {
        if let MotorStage::Drives(stage) = self {
            stage.note_mode(mode);
        }
    }

    /// Forgets what belongs to torque that is not allowed any more.
    pub(crate) fn forget(&mut self) {
        if let MotorStage::Drives(stage) = self {
            stage.forget();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_transient_failure_is_borne_and_nothing_else() {
        let mut policy = WriteFailurePolicy { allowed: 1, failed: 0 };
        let transient = Err(Error::whole(ErrorKind::Transient, "test"));
        assert!(policy.tolerates(transient) && policy.tolerates(Ok(())));
        assert!(policy.tolerates(transient) && !policy.tolerates(transient));
        for kind in [ErrorKind::Lost, ErrorKind::OutOfRange, ErrorKind::Stale] {
            let mut policy = WriteFailurePolicy { allowed: 1, failed: 0 };
            assert!(!policy.tolerates(Err(Error::whole(kind, "test"))), "{kind:?}");
        }
    }
}
