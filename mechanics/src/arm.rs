//! What the planning and leading of motion has to know of an arm, whatever solves its kinematics:
//! limits, tool pose, joints for a pose, distance from singularities, a follower of tool paths, and
//! the torques of its links. Refuses to say how: the PUMA 260 does it in closed form
//! ([`Puma260`](crate::puma260::Puma260)), any other chain by damped steps
//! ([`Chain`](crate::chain::Chain)).
//!
//! Dispatch is settled when the code is compiled: what runs for the PUMA 260 is what would run if
//! there were no other arm.

use core::fmt::{self, Debug};

use crate::spatial::{JointMatrix, JointVector, Pose};

/// An arm of `N` joints.
pub trait Arm<const N: usize>: Copy + Debug + PartialEq + Send + 'static {
    /// Leads the arm along a tool path.
    type Follower: PathFollower<N>;
    /// The arm's masses.
    type Dynamics: ArmDynamics<N>;

    /// Lower joint limits (rad or m).
    fn q_min(&self) -> &JointVector<N>;
    /// Upper joint limits (rad or m).
    fn q_max(&self) -> &JointVector<N>;
    /// Largest joint speeds (rad/s or m/s).
    fn speed_max(&self) -> &JointVector<N>;
    /// Largest joint accelerations for planning (rad/s^2 or m/s^2).
    fn acceleration_max(&self) -> &JointVector<N>;
    /// The same arm with other largest speeds.
    #[must_use]
    fn with_speed_max(&self, speed_max: &JointVector<N>) -> Self;

    /// The tool frame in the base frame.
    fn tool_pose(&self, q: &JointVector<N>) -> Pose;
    /// The joints that reach a tool pose within the limits nearest to `before`, as far as they are
    /// found; the work is bounded, for a lane.
    fn inverse_kinematics_near(
        &self,
        tool: &Pose,
        before: &JointVector<N>,
    ) -> Option<JointVector<N>>;
    /// False for a tool pose that cannot be reached at all; true may be a pose that cannot either.
    fn is_within_reach_bound(&self, tool: &Pose) -> bool;
    /// Whether some joints within the limits reach a tool pose; searched with patience, not for a
    /// lane.
    fn is_reachable(&self, tool: &Pose) -> bool;
    /// Scaled distances from singularities, in size: of shoulder, elbow and wrist where the arm has
    /// these names; else the smallest singular value of the Jacobian, lengths counted in mean
    /// links, in all three places.
    fn singularity_distances(&self, q: &JointVector<N>) -> [f64; 3];
    /// Starts to follow tool paths from rest at `q`.
    fn follower(&self, q: &JointVector<N>) -> Self::Follower;

    /// Whether every joint lies inside its limits as it stands; NaN does not.
    fn within_limits(&self, q: &JointVector<N>) -> bool {
        (0..N).all(|i| self.q_min()[i] <= q[i] && q[i] <= self.q_max()[i])
    }

    /// How far `joint` may go from `here` on the way to `to` (rad or m): to its limit, or to where
    /// a tool that is led straight cannot come back from.
    fn remaining_travel(&self, joint: usize, here: &JointVector<N>, to: &JointVector<N>) -> f64 {
        self.travel_to_limit(joint, here, to).max(0.0)
    }

    /// How far `joint` may go from `here` on the way to `to` until its limit; negative beyond it.
    fn travel_to_limit(&self, joint: usize, here: &JointVector<N>, to: &JointVector<N>) -> f64 {
        if to[joint] > here[joint] {
            self.q_max()[joint] - here[joint]
        } else {
            here[joint] - self.q_min()[joint]
        }
    }
}

/// The masses of an arm of `N` joints, motors included, friction not.
pub trait ArmDynamics<const N: usize>: Clone + Debug + Send + 'static {
    /// The mass matrix (kg m^2).
    fn mass_matrix(&self, q: &JointVector<N>) -> JointMatrix<N>;
    /// Coriolis, centrifugal and gravity torques (N m).
    fn bias_torque(&self, q: &JointVector<N>, qd: &JointVector<N>) -> JointVector<N>;
    /// Torques that hold the arm against gravity (N m).
    fn gravity_torque(&self, q: &JointVector<N>) -> JointVector<N>;
}

/// Follows a path of tool poses tick by tick from where it was started.
pub trait PathFollower<const N: usize>: Copy + Debug + PartialEq + Send + 'static {
    /// The joints of the last tick (rad).
    fn joints(&self) -> &JointVector<N>;

    /// The joints for tool pose `tool` (base frame) one tick of `dt_s` (s) after the last.
    ///
    /// # Errors
    /// [`FollowError`]; the joints stay as they were.
    fn step(&mut self, tool: &Pose, dt_s: f64) -> Result<FollowerStep<N>, FollowError>;
}

/// The joints of one tick, and what they miss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowerStep<const N: usize = 6> {
    /// Joint angles (rad).
    pub q: JointVector<N>,
    /// Distance of the tool point from its path (m).
    pub position_error_m: f64,
    /// Angle between the tool's orientation and the one wanted (rad).
    pub orientation_error_rad: f64,
}

/// Why a path cannot be followed any further.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum FollowError {
    /// The pose is out of reach, or holds a number that is not finite.
    OutOfReach,
    /// This joint (0 is the first) would have to leave its limits.
    JointLimit {
        /// Index of the joint.
        joint: usize,
    },
    /// This joint (0 is the first) would have to be faster than its limit by this ratio.
    SpeedLimit {
        /// Index of the joint.
        joint: usize,
        /// Speed wanted over the speed allowed, above 1.
        ratio: f64,
    },
    /// The path has ended, and this joint (0 is the first) did not catch up with it in time.
    NotSettled {
        /// Index of the joint.
        joint: usize,
    },
}

impl fmt::Display for FollowError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            FollowError::OutOfReach => write!(f, "the tool pose is out of the arm's reach"),
            FollowError::JointLimit { joint } => {
                write!(f, "joint {} would leave its limits", joint + 1)
            }
            FollowError::SpeedLimit { joint, ratio } => {
                write!(f, "joint {} would need {ratio:.2} times its speed", joint + 1)
            }
            FollowError::NotSettled { joint } => {
                write!(f, "joint {} would still be short of the goal", joint + 1)
            }
        }
    }
}
