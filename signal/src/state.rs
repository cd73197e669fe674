//! The states of the robot control program (figure 6.2 of the thesis) and the requests to it.

use taktil_rtcore::{Fold, Mode, StateHash, payload};

/// What the machine does. Which transitions exist is the supervisor's table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u32)]
pub enum State {
    /// Counts, desired counts and torques are zero; waiting for drive power.
    #[default]
    Start = 0,
    /// Holds where it is; joint zeros unknown.
    IdleUncalibrated = 1,
    /// Joint by joint jog to the home pose.
    ManualUncalibrated = 2,
    /// Holds where it is; joint zeros known.
    IdleCalibrated = 3,
    /// Jog in joint space.
    ManualJoint = 4,
    /// Jog in Cartesian space.
    ManualCartesian = 5,
    /// Carries out the queue of pre-programmed moves.
    Trajectory = 6,
    /// Carries out moves typed in on-line.
    TrajectoryUser = 7,
    /// Follows touch.
    TactileServo = 8,
}

impl State {
    /// Every state.
    pub const ALL: [State; 9] = [
        State::Start,
        State::IdleUncalibrated,
        State::ManualUncalibrated,
        State::IdleCalibrated,
        State::ManualJoint,
        State::ManualCartesian,
        State::Trajectory,
        State::TrajectoryUser,
        State::TactileServo,
    ];

    /// The state with this number.
    #[must_use]
    pub fn from_code(code: u32) -> Option<State> {
        State::ALL.get(code as usize).copied()
    }

    /// The name as the thesis writes it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            State::Start => "START",
            State::IdleUncalibrated => "IDLE/UNCALIBRATED",
            State::ManualUncalibrated => "MANUAL/UNCALIBRATED",
            State::IdleCalibrated => "IDLE/CALIBRATED",
            State::ManualJoint => "MANUAL/JOINT",
            State::ManualCartesian => "MANUAL/CARTESIAN",
            State::Trajectory => "TRAJECTORY",
            State::TrajectoryUser => "TRAJECTORY/USER",
            State::TactileServo => "TACTILE-SERVO",
        }
    }
}

impl Fold for State {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&(*self as u32));
    }
}

/// The requests of an operator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u32)]
pub enum Verb {
    /// Nothing.
    #[default]
    None = 0,
    /// Let the drives be checked and switched on: START to IDLE/UNCALIBRATED.
    Enable = 1,
    /// Declare that the arm stands in its home pose: the counts are initialised there.
    Calibrate = 2,
    /// Give back and hold: to IDLE.
    Idle = 3,
    /// Jog joint by joint without calibration.
    ManualUncalibrated = 4,
    /// Jog in joint space.
    ManualJoint = 5,
    /// Jog in Cartesian space.
    ManualCartesian = 6,
    /// Carry out the programmed moves.
    Trajectory = 7,
    /// Carry out moves typed in on-line.
    TrajectoryUser = 8,
    /// Follow touch.
    TactileServo = 9,
    /// Decelerate, then drives off.
    Stop = 10,
    /// Acknowledge a latched fault.
    Reset = 11,
}

impl Verb {
    /// Every verb.
    pub const ALL: [Verb; 12] = [
        Verb::None,
        Verb::Enable,
        Verb::Calibrate,
        Verb::Idle,
        Verb::ManualUncalibrated,
        Verb::ManualJoint,
        Verb::ManualCartesian,
        Verb::Trajectory,
        Verb::TrajectoryUser,
        Verb::TactileServo,
        Verb::Stop,
        Verb::Reset,
    ];

    /// The verb with this number.
    #[must_use]
    pub fn from_code(code: u32) -> Option<Verb> {
        Verb::ALL.get(code as usize).copied()
    }

    /// The name as it stands in a scene's script.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Verb::None => "none",
            Verb::Enable => "enable",
            Verb::Calibrate => "calibrate",
            Verb::Idle => "idle",
            Verb::ManualUncalibrated => "manual_uncalibrated",
            Verb::ManualJoint => "manual_joint",
            Verb::ManualCartesian => "manual_cartesian",
            Verb::Trajectory => "trajectory",
            Verb::TrajectoryUser => "trajectory_user",
            Verb::TactileServo => "tactile_servo",
            Verb::Stop => "stop",
            Verb::Reset => "reset",
        }
    }

    /// The verb with this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Verb> {
        Verb::ALL.iter().copied().find(|verb| verb.name() == name)
    }
}

payload! {
    /// A request by an operator or a script. Counts as one request while `sequence` stays the same.
    pub struct Request {
        /// A [`Verb`].
        pub verb: u32,
        /// Increases with every request.
        pub sequence: u32,
    }
}

/// The axes that a jog is along or about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u32)]
pub enum JogFrame {
    /// The joints, the first six of them.
    #[default]
    Joints = 0,
    /// The axes of the base, at the tool point: three translations, three turns.
    Base = 1,
    /// The axes of the tool.
    Tool = 2,
    /// The last six joints: of an arm of seven all but the first.
    Outer = 3,
}

impl JogFrame {
    /// Every frame.
    pub const ALL: [JogFrame; 4] =
        [JogFrame::Joints, JogFrame::Base, JogFrame::Tool, JogFrame::Outer];

    /// Whether the axes are joints; else they are the tool's.
    #[must_use]
    pub const fn is_joints(self) -> bool {
        matches!(self, JogFrame::Joints | JogFrame::Outer)
    }

    /// The frame with this number.
    #[must_use]
    pub fn from_code(code: u32) -> Option<JogFrame> {
        JogFrame::ALL.get(code as usize).copied()
    }

    /// The name as it stands in a scene's script.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            JogFrame::Joints => "joints",
            JogFrame::Base => "base",
            JogFrame::Tool => "tool",
            JogFrame::Outer => "outer",
        }
    }
}

payload! {
    /// The keys that an operator holds. Hold to run: the sender confirms repeatedly that they are
    /// held.
    pub struct JogCommand {
        /// How far each axis is pushed, -1 to 1; 0 is released.
        pub axes: [f64; 6],
        /// A [`JogFrame`].
        pub frame: u32,
        /// Increases as long as the keys are seen to be held; when it stands still the motion ends.
        pub sequence: u32,
    }
}

/// The reason why the arm does not follow an operator's command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u32)]
pub enum JogObstacle {
    /// Nothing is in the way, or nothing is pushed.
    #[default]
    None = 0,
    /// A joint is at its limit, or brakes before it.
    Limit = 1,
    /// The tool is at the edge of the arm's reach.
    Reach = 2,
    /// A joint is where the arm would have to change its branch: stretched, or with the wrist's
    /// centre beside the axis of joint 1.
    Branch = 3,
    /// Beside a singularity, where a joint cannot be as fast or brake as soon as the tool asks.
    Singular = 4,
    /// The tool would leave the line that is asked for.
    Line = 5,
    /// The axes pushed are not those of this state: joints in one, the tool in the other.
    Frame = 6,
    /// The hand has fallen silent with a key held.
    Silent = 7,
}

impl JogObstacle {
    /// Every reason.
    pub const ALL: [JogObstacle; 8] = [
        JogObstacle::None,
        JogObstacle::Limit,
        JogObstacle::Reach,
        JogObstacle::Branch,
        JogObstacle::Singular,
        JogObstacle::Line,
        JogObstacle::Frame,
        JogObstacle::Silent,
    ];

    /// The reason with this number.
    #[must_use]
    pub fn from_code(code: u32) -> Option<JogObstacle> {
        JogObstacle::ALL.get(code as usize).copied()
    }
}

payload! {
    /// What stands in the way of the operator's push, from `jog`; written once, and when
    /// it changes.
    pub struct JogState {
        /// A [`JogObstacle`].
        pub obstacle: u32,
        /// The joint at fault, 1 the first; 0 for none.
        pub joint: u32,
        /// 1 while the arm stands for it, 0 while it is slower than pushed.
        pub stopped: u32,
    }
}

payload! {
    /// What the supervisor decided.
    pub struct ControlState {
        /// Release at which this state was entered.
        pub entered_ns: i64,
        /// Latched faults, a [`taktil_rtcore::FaultSet`].
        pub faults: u64,
        /// A [`State`].
        pub state: u32,
        /// A [`Mode`].
        pub mode: u32,
        /// The first fault since the last reset, 0 when none.
        pub first_fault: u32,
        /// Sequence of the newest request that was looked at.
        pub request: u32,
        /// How many requests were refused because the tables do not allow them.
        pub refused: u32,
        /// 1 during the tick in which the joint counts are to be initialised at the home pose.
        pub calibrate: u32,
    }
}

impl ControlState {
    /// The mode; [`Mode::Fault`] when its number is none that is known.
    #[must_use]
    pub fn mode(&self) -> Mode {
        Mode::from_code_or_fault(self.mode)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_and_names_read_back() {
        for state in State::ALL {
            assert_eq!(State::from_code(state as u32), Some(state));
        }
        for verb in Verb::ALL {
            assert_eq!(Verb::from_code(verb as u32), Some(verb));
            assert_eq!(Verb::from_name(verb.name()), Some(verb));
        }
        for why in JogObstacle::ALL {
            assert_eq!(JogObstacle::from_code(why as u32), Some(why));
        }
        assert_eq!(JogObstacle::from_code(8), None);
        assert_eq!(State::from_code(9), None);
        assert_eq!(Verb::from_code(12), None);
        assert_eq!(Verb::from_name("fly"), None);
    }
}
