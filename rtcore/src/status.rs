//! The two payloads of the core itself: the mode, and the health of a lane.

use crate::mode::Mode;
use crate::payload;

payload! {
    /// The mode machine's word, written by the supervisor and read by every lane before each task.
    pub struct ModeStatus {
        /// Latched faults, a [`crate::FaultSet`].
        pub faults: u64,
        /// A [`crate::Mode`].
        pub mode: u32,
        /// The action in force, as [`crate::mode::Action`] in order: 0 none, 1 degrade, 2
        /// controlled stop, 3 drive off.
        pub action: u32,
    }
}

impl ModeStatus {
    /// The mode; [`Mode::Fault`] when its number is unknown.
    #[must_use]
    pub fn mode(&self) -> Mode {
        Mode::from_code_or_fault(self.mode)
    }
}

payload! {
    /// The report of a lane after each job: the signal `lane.health`.
    pub struct LaneHealth {
        /// Jobs run so far.
        pub jobs: u64,
        /// Faults raised by tasks of this lane in this job and by the schedule since the job
        /// before, a [`crate::FaultSet`]; kept long enough that no reader of this signal can miss
        /// them.
        pub faults: u64,
        /// Position in the lane of the first task that raised one of them, plus 1; 0 when none did.
        pub faulty_task: u32,
        /// Tasks taken out of the lane after a panic, one bit each.
        pub disabled: u32,
        /// Jobs that missed their deadline or were left out so far; always 0 where the world waits.
        pub missed: u32,
        /// Other lanes that stand still, one bit each in the machine's order.
        pub silent: u32,
    }
}
