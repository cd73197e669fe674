//! The payloads of the core itself: the mode, the health of a lane, and the pace of the machine.

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
    /// By how much the releases of the machine are moved to keep their place in the cycle of a
    /// board, written by the task that reads the board's clock ([`crate::phase_lock`]). It is the
    /// decision by which a live run moves its releases.
    pub struct PaceStatus {
        /// What is added to logical time for releases from the next one on (ns).
        pub correction_ns: i64,
        /// How much later than its place the newest job whose phase could be read was (ns).
        pub phase_ns: i64,
        /// 1 while the phases stay within their window.
        pub locked: u32,
        /// Slips: how often the jobs came to keep the place of a neighbouring cycle.
        pub slips: u32,
        /// 1 when the largest step acted in this job.
        pub clamped: u32,
        /// Jobs whose phase could not be read.
        pub missing: u32,
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
