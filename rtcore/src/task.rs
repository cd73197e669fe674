//! The trait of a task and its arguments. Time, mode and values all arrive as arguments: a task
//! does not query its surroundings.

use taktil_hal::Nanos;

use crate::fault::FaultCode;
use crate::mode::Mode;
use crate::port::Io;
use crate::state::StateHash;

/// The arguments of one job of a task besides its ports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cycle {
    /// Number of the job: 0, 1, 2 ... A skipped job leaves a gap.
    pub tick: u64,
    /// Logical time of the job: phase + tick * period.
    pub release: Nanos,
    /// The lane's period.
    pub dt: Nanos,
    /// Whether torque is allowed, as last decided.
    pub mode: Mode,
}

/// One unit of work in a lane. Created (may allocate, may fail) by a constructor that declares its
/// ports on [`crate::Ports`].
pub trait Task: Send {
    /// Called once before the first job, outside real time.
    ///
    /// # Errors
    /// A fault refuses the start of the whole machine.
    fn start(&mut self) -> Result<(), FaultCode> {
        Ok(())
    }

    /// One job. Must not allocate, lock, log, format, block or touch new memory.
    ///
    /// # Errors
    /// A fault is latched in the lane's health and reaches the supervisor at the next tick; the
    /// task goes on being called.
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode>;

    /// Folds everything that the next steps depend on besides inputs and configuration, so that two
    /// runs can be compared task by task. Called after each step; must be as cheap as it is
    /// complete: a few ns a number. The default folds nothing: such a task is compared by its
    /// outputs alone.
    fn fold(&self, _hash: &mut StateHash) {}

    /// Called after the last job, also after a fault, when a task refused to start, and at once
    /// when this task panicked: leave outputs at their safe value. It may be called twice.
    fn stop(&mut self) {}
}
