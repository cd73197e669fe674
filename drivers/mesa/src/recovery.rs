//! The way of the outputs from power-up, and back after a bite of the FPGA's watchdog or of a
//! remote's: zeros and directions first, then the status, then smart serial stopped and started,
//! then an exchange of zeros. Only then are values put out again.

use crate::cycle::Status;
use crate::link::Diagnostics;
use crate::modules::sserial::RESTART_MASK;

/// Where the outputs are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// Values are put out.
    Running,
    /// Zeros and directions were written; the status is to be clear.
    Rearmed,
    /// Smart serial is stopping.
    Stopping,
    /// Smart serial is starting.
    Starting,
    /// Zeros are being exchanged.
    Zeroing,
}

/// What to send next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    Nothing,
    /// Zeros, directions, status of the watchdog.
    Rearm,
    /// A sign of life, while nothing but zeros is put out.
    Feed,
    Stop,
    Start,
    /// Zeros with an exchange.
    Zero,
}

impl Phase {
    /// Moves on by an answer and says what to send. `masks` has a bit for each channel of smart
    /// serial in use, `armed` says that the watchdog runs, `waits` that an exchange is under way.
    pub(crate) fn next(
        &mut self,
        status: &Status,
        masks: u32,
        armed: bool,
        waits: bool,
        seen: &mut Diagnostics,
    ) -> Step {
        if status.bitten && armed {
            seen.bites += u64::from(*self != Phase::Rearmed);
            *self = Phase::Rearmed;
            return Step::Rearm;
        }
        let idle = status.command == 0;
        let faulty = masks != 0 && idle && !waits && status.remotes & RESTART_MASK != 0;
        match *self {
            Phase::Running if faulty => {
                seen.remote_faults += 1;
                *self = Phase::Stopping;
                Step::Stop
            }
            Phase::Running => Step::Nothing,
            Phase::Rearmed if masks == 0 => {
                *self = Phase::Running;
                Step::Feed
            }
            Phase::Rearmed => {
                *self = Phase::Stopping;
                Step::Stop
            }
            Phase::Stopping if idle => {
                *self = Phase::Starting;
                Step::Start
            }
            Phase::Starting if idle && status.remotes & RESTART_MASK == 0 => {
                *self = Phase::Zeroing;
                Step::Zero
            }
            Phase::Starting | Phase::Zeroing if faulty => {
                *self = Phase::Stopping;
                Step::Stop
            }
            Phase::Zeroing if idle => {
                *self = Phase::Running;
                Step::Nothing
            }
            Phase::Stopping | Phase::Starting | Phase::Zeroing => Step::Feed,
        }
    }
}
