//! The enumeration of faults: one code each, with the reaction it calls for. Inside a job faults
//! are numbers; their texts are for reports.

mod explanation;

pub use explanation::{Explanation, table};

/// How strongly the machine reacts. Ordered: a later class wins over an earlier one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Class {
    /// Counted and recorded; motion goes on.
    Note,
    /// Hold the last good value, drop to position hold or reduced speed.
    Degrade,
    /// Controlled stop (category 1): decelerate on the servo, then drive power off.
    ControlledStop,
    /// Drive off now (category 0): D/A at its safe value, drive disabled, brakes on.
    DriveOff,
}

macro_rules! faults {
    ($($(#[$meta:meta])* $name:ident = $code:literal, $class:ident, $text:literal;)*) => {
        /// What went wrong. Codes are stable: they stand in logs.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u16)]
        pub enum FaultCode { $($(#[$meta])* $name = $code),* }

        impl FaultCode {
            /// Every fault, in order of its code.
            pub const ALL: &'static [FaultCode] = &[$(FaultCode::$name),*];

            /// The reaction that this fault calls for.
            #[must_use]
            pub const fn class(self) -> Class {
                match self { $(FaultCode::$name => Class::$class),* }
            }

            /// A plain sentence for people.
            #[must_use]
            pub const fn text(self) -> &'static str {
                match self { $(FaultCode::$name => $text),* }
            }
        }
    };
}

faults! {
    /// Several counts further than the fastest joint can move in a tick.
    EncoderJump = 1, DriveOff, "an encoder moved further in one tick than the joint can";
    /// The encoder board does not answer.
    EncoderLost = 2, DriveOff, "the encoder board does not answer";
    /// A D/A word could not be written.
    AnalogOutLost = 3, DriveOff, "the D/A board does not answer";
    /// A digital line could not be written or read.
    DigitalLost = 4, DriveOff, "the digital board does not answer";
    /// The tactile board does not answer.
    TactileLost = 5, Degrade, "the tactile board does not answer";
    /// No new tactile frame for longer than the limit.
    TactileStale = 6, Degrade, "no new tactile frame arrived in time";
    /// A frame failed its checks and was dropped.
    TactileGarbled = 7, Note, "a tactile frame failed its checks";
    /// The joint is further from its desired place than the speed-scaled window.
    FollowingError = 8, ControlledStop, "a joint is too far from its desired position";
    /// A desired joint angle lies outside its limits.
    SoftLimit = 9, ControlledStop, "a desired joint angle is outside its limits";
    /// A desired joint angle steps further than the servo may be asked to follow.
    SetpointJump = 10, ControlledStop, "the desired joint angles jump";
    /// A task wrote NaN or infinity; the last good value was kept.
    NotFinite = 11, ControlledStop, "a task wrote a value that is not finite";
    /// A task panicked and was taken out of the lane until the program starts anew.
    TaskPanicked = 12, DriveOff, "a task panicked";
    /// One job finished after its deadline.
    Overrun = 13, Note, "a job finished after its deadline";
    /// Misses filled the leaky bucket.
    OverrunStorm = 14, ControlledStop, "too many jobs finished after their deadline";
    /// Drive power went away while torque was wanted.
    DrivePowerLost = 15, DriveOff, "drive power is off";
    /// A channel of the emergency stop opened.
    EmergencyStop = 16, DriveOff, "the emergency stop is open";
    /// The two channels of the emergency stop disagree.
    EmergencyStopDisagrees = 17, DriveOff, "the two emergency stop channels disagree";
    /// Inverse kinematics has no solution within the limits near the present joints.
    Unreachable = 18, ControlledStop, "the goal cannot be reached within the joint limits";
    /// The arm is too near a singularity for the law to act.
    Singular = 19, ControlledStop, "the arm is too close to a singularity";
    /// The first command of a source does not match the measured state.
    NotBumpless = 20, ControlledStop, "a source of motion does not start where the arm is";
    /// A move was refused before it started.
    MoveRefused = 21, Note, "a move was refused before it started";
    /// The heartbeat of a lane stood still.
    LaneSilent = 22, DriveOff, "a lane stopped answering";
    /// A job of a lane that may not miss ended after its deadline, or was left out.
    DeadlineMissed = 23, ControlledStop, "a lane that may not miss a deadline missed one";
    /// A task wrote a value that its output was declared not to take; the last good one was kept.
    OutOfRange = 24, ControlledStop, "a task wrote a value out of its output's range";
    /// The force/torque sensor does not answer.
    WristLost = 25, Degrade, "the force/torque sensor does not answer";
    /// The load on the array stayed far above its set point: the arm is not where it says.
    Overload = 26, DriveOff, "the finger is pressed far too hard";
    /// Calibration was asked for before every joint had passed an index pulse.
    IndexMissing = 27, Note, "calibration refused: a joint has passed no index pulse yet";
    /// Calibration was asked for where the index pulses say that the home pose is not.
    IndexFar = 28, Note, "calibration refused: the index pulses say that this is not the home pose";
    /// The A/D board does not answer.
    AnalogLost = 29, Degrade, "the A/D board does not answer";
    /// The heartbeat of a thread that feeds the watchdog or hears the operator stood still.
    MonitorSilent = 31, ControlledStop, "a thread that watches the machine stands still";
    /// A gauge of the force/torque sensor stayed at an end of its converter's range.
    WristOverRange = 34, Degrade, "a gauge of the force/torque sensor is out of its range";
    /// The force that a law controls in contact is not known any more.
    ForceUnknown = 35, ControlledStop, "the force in contact is beyond what the sensor measures";
    /// A motor departs from its desired angle ever faster against its torque: wrong polarity.
    Runaway = 36, DriveOff, "a motor runs away against its torque: motor or encoder is reversed";
    /// An encoder does not count although its motor is driven to move.
    StuckEncoder = 37, DriveOff, "an encoder does not count although its motor is driven";
    /// A measured joint angle lies beyond its limits by more than a margin.
    JointLimit = 38, ControlledStop, "a measured joint angle is beyond its limits";
    /// The speed does not fall during a controlled stop.
    StopFailed = 39, DriveOff, "the speed does not fall in a controlled stop";
    /// A drive that closes a loop itself reports a fault of its own.
    DriveFault = 40, DriveOff, "a drive reports a fault";
    /// The drives do not answer, or one of them does not follow although it was asked to.
    DriveLost = 41, DriveOff, "a drive does not answer, or does not follow";
}

impl FaultCode {
    /// The fault with this code.
    #[must_use]
    pub fn from_code(code: u16) -> Option<FaultCode> {
        FaultCode::ALL.iter().copied().find(|fault| *fault as u16 == code)
    }
}

/// A set of faults as one word: bit n stands for code n.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct FaultSet(pub u64);

impl FaultSet {
    /// No fault.
    pub const NONE: FaultSet = FaultSet(0);

    /// Adds a fault.
    pub fn insert(&mut self, fault: FaultCode) {
        self.0 |= 1 << (fault as u16);
    }

    /// Whether a fault is in the set.
    #[must_use]
    pub const fn contains(self, fault: FaultCode) -> bool {
        self.0 & (1 << (fault as u16)) != 0
    }

    /// Both sets together.
    #[must_use]
    pub const fn union(self, other: FaultSet) -> FaultSet {
        FaultSet(self.0 | other.0)
    }

    /// True when nothing is wrong.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The members in order of their code.
    pub fn iter(self) -> impl Iterator<Item = FaultCode> {
        FaultCode::ALL.iter().copied().filter(move |fault| self.contains(*fault))
    }

    /// The strongest reaction that a member calls for.
    #[must_use]
    pub fn worst(self) -> Option<Class> {
        self.iter().map(FaultCode::class).max()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_unique_fit_the_set_and_read_back() {
        let mut all = FaultSet::NONE;
        for fault in FaultCode::ALL {
            let code = *fault as u16;
            assert!((1..64).contains(&code), "{fault:?} does not fit a 64-bit set");
            assert!(!all.contains(*fault), "{fault:?} shares a code");
            all.insert(*fault);
            assert_eq!(FaultCode::from_code(code), Some(*fault));
            assert!(!fault.text().is_empty());
            let told = fault.explanation();
            for text in [told.cause, told.evidence, told.clearing] {
                assert!(text.len() > 5 && !text.contains(['|', '\n']), "{fault:?}: {text}");
            }
        }
        assert_eq!(all.iter().count(), FaultCode::ALL.len());
        assert_eq!(FaultCode::from_code(0), None);
    }

    #[test]
    fn the_worst_member_decides() {
        let mut set = FaultSet::NONE;
        assert_eq!(set.worst(), None);
        set.insert(FaultCode::Overrun);
        assert_eq!(set.worst(), Some(Class::Note));
        set.insert(FaultCode::EmergencyStop);
        set.insert(FaultCode::FollowingError);
        assert_eq!(set.worst(), Some(Class::DriveOff));
    }
}
