//! What the bus asks of a drive, whatever it speaks: frames to send, and what a frame that came
//! tells.

use crate::frame::Frame;

/// What a frame was to the drive that it came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum DriveMessage {
    /// The answer of this cycle: the position (counts).
    Position(i32),
    /// Something that changes the drive's status, or nothing of interest.
    Status,
    /// An emergency message.
    Emergency,
    /// The drive has restarted and has forgotten how it was set up.
    Restarted,
    /// The drive no longer takes part in the exchange.
    Left,
}

/// How a drive is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct DriveStatus {
    /// The power stage has its voltage.
    pub(crate) has_power: bool,
    /// It follows torques.
    pub(crate) is_enabled: bool,
    /// A fault is under way or waits for its acknowledgement.
    pub(crate) has_fault: bool,
    /// The newest error by the drive's own numbers; 0 for none.
    pub(crate) error_code: u16,
}

/// What the lines want of the drives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Wish {
    pub(crate) enable: bool,
    pub(crate) lifts_brake: bool,
}

/// A drive on the bus.
pub(crate) trait Drive: Send {
    /// What it is, for messages.
    fn name(&self) -> String;

    /// The question of a cycle; `None` for a drive that answers to a SYNC.
    fn query(&self) -> Option<Frame>;

    /// Takes a frame; `None` for one of somebody else's.
    fn receive(&mut self, frame: &Frame) -> Option<DriveMessage>;

    /// How it is, by what it said last.
    fn status(&self) -> DriveStatus;

    /// The frame that asks for a torque of `code`, or for none as long as the drive is not wanted.
    fn torque(&self, code: i16) -> Frame;

    /// The frame that leads one step towards what is wanted.
    fn control(&mut self, wish: Wish) -> Option<Frame>;
}

/// What a latch asks of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Request {
    /// Torque off.
    Off,
    /// Torque off, and the fault acknowledged.
    Clear,
    /// Operation.
    On,
}

/// Keeps a drive without the states of CiA 402 from coming back by itself: after a fault the first
/// wish to enable only acknowledges it, and the next one enables. A drive that left operation by
/// itself takes a new wish, too.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Latch {
    needs_clear: bool,
    is_blocked: bool,
    was_wanted: bool,
    has_run: bool,
}

impl Latch {
    /// One step with what is wanted and how the drive is.
    pub(crate) fn step(&mut self, enable: bool, status: DriveStatus) -> Request {
        let is_new = enable && !self.was_wanted;
        self.was_wanted = enable;
        if !enable {
            (self.is_blocked, self.has_run) = (false, false);
        }
        // A fault takes a while to go; it counts anew when the wish that cleared it has ended.
        self.needs_clear |= status.has_fault && !self.is_blocked;
        if self.needs_clear {
            self.has_run = false;
            if !is_new {
                return Request::Off;
            }
            // This wish is used up by the acknowledgement, whatever comes of it.
            (self.needs_clear, self.is_blocked) = (false, true);
            return Request::Clear;
        }
        if self.has_run && !status.is_enabled {
            (self.is_blocked, self.has_run) = (true, false);
        }
        if !enable || self.is_blocked {
            return Request::Off;
        }
        self.has_run |= status.is_enabled;
        Request::On
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDLE: DriveStatus =
        DriveStatus { has_power: true, is_enabled: false, has_fault: false, error_code: 0 };
    const RUNNING: DriveStatus = DriveStatus { is_enabled: true, ..IDLE };
    const FAULTY: DriveStatus = DriveStatus { has_fault: true, ..IDLE };

    #[test]
    fn a_fault_takes_an_acknowledgement_and_a_new_wish() {
        let mut latch = Latch::default();
        assert_eq!(latch.step(true, IDLE), Request::On);
        assert_eq!(latch.step(true, RUNNING), Request::On);
        assert_eq!(
            [FAULTY, FAULTY, IDLE].map(|status| latch.step(true, status)),
            [Request::Off; 3]
        );
        assert_eq!(latch.step(false, FAULTY), Request::Off);
        assert_eq!(latch.step(true, FAULTY), Request::Clear);
        assert_eq!([FAULTY, IDLE].map(|status| latch.step(true, status)), [Request::Off; 2]);
        assert_eq!(latch.step(false, IDLE), Request::Off);
        assert_eq!([IDLE, RUNNING].map(|status| latch.step(true, status)), [Request::On; 2]);
    }

    #[test]
    fn a_drive_that_stops_by_itself_takes_a_new_wish() {
        let mut latch = Latch::default();
        assert_eq!([IDLE, IDLE, RUNNING].map(|status| latch.step(true, status)), [Request::On; 3]);
        assert_eq!([IDLE, RUNNING].map(|status| latch.step(true, status)), [Request::Off; 2]);
        assert_eq!(latch.step(false, IDLE), Request::Off);
        assert_eq!(latch.step(true, IDLE), Request::On);
    }

    #[test]
    fn a_fault_from_before_the_first_wish_is_acknowledged_first() {
        let mut latch = Latch::default();
        assert_eq!(latch.step(false, FAULTY), Request::Off);
        assert_eq!(latch.step(true, FAULTY), Request::Clear);
        assert_eq!(latch.step(true, FAULTY), Request::Off, "the cause is still there");
        assert_eq!(latch.step(false, FAULTY), Request::Off);
        assert_eq!(latch.step(true, FAULTY), Request::Clear);
    }
}
