//! The description of a robot: kinematics and limits, dynamics, transmission, amplifiers and
//! friction. Tasks copy what they need of it when they are built; it does not change while they
//! run.

use crate::arm::Arm;
use crate::chain::Chain;
use crate::friction::Friction;
use crate::puma260::Puma260;
use crate::puma260::dynamics::Dynamics;
use crate::spatial::JointVector;
use crate::transmission::{Drive, Transmission};

/// The parameters of a robot with an arm of `N` joints, as the tasks and the simulator know them.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot<const N: usize = 6, A: Arm<N> = Puma260> {
    /// Kinematics and limits.
    pub arm: A,
    /// Rigid-body dynamics, with the inertia of the motors.
    pub dynamics: A::Dynamics,
    /// Gears and encoders.
    pub gears: Transmission<N>,
    /// Amplifiers and converters.
    pub drive: Drive<N>,
    /// Friction of the joints.
    pub friction: Friction<N>,
    /// Joints of the home pose, at which the encoder counts are initialised (rad).
    pub home_rad: JointVector<N>,
    /// Nominal working configuration, for which the gains of the servo are computed (rad).
    pub nominal_rad: JointVector<N>,
    /// Largest torques at the joints (N m).
    pub torque_max_nm: JointVector<N>,
    /// Names of the joints for messages. A joint beyond the end of the list has only its number.
    pub joint_names: Vec<String>,
}

impl Robot<6, Puma260> {
    /// The reference PUMA 260 with its motors.
    #[must_use]
    pub fn puma260() -> Robot<6, Puma260> {
        let (gears, drive) = (Transmission::reference(), Drive::reference());
        let radians = |degrees: [f64; 6]| JointVector::from(degrees.map(f64::to_radians));
        Robot {
            arm: Puma260::reference(),
            dynamics: Dynamics::reference(),
            torque_max_nm: drive.peak_joint_torque(&gears),
            gears,
            drive,
            friction: Friction::reference(),
            home_rad: radians([0.0, 0.0, -180.0, 0.0, 90.0, 0.0]),
            nominal_rad: radians([0.0, 40.0, -153.0, -180.0, 67.0, 180.0]),
            joint_names: Vec::new(),
        }
    }
}

/// A robot whose arm is a general serial chain.
pub type ChainRobot<const N: usize> = Robot<N, Chain<N>>;

impl<const N: usize, A: Arm<N>> Robot<N, A> {
    /// The label of a joint in messages, where 0 is the first: its number counted from 1, and its
    /// name where it has one.
    #[must_use]
    pub fn joint_label(&self, index: usize) -> String {
        match self.joint_names.get(index) {
            Some(name) => format!("joint {} (`{name}`)", index + 1),
            None => format!("joint {}", index + 1),
        }
    }
}
