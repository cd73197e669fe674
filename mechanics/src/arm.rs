//! The interface between an arm and the code that plans and tracks its motion: limits, tool pose,
//! inverse kinematics, distance from singularities, a follower of tool paths, and the rigid-body
//! dynamics. The PUMA 260 implements it in closed form ([`Puma260`](crate::puma260::Puma260)), any
//! other chain by damped least-squares steps ([`Chain`](crate::chain::Chain)).
//!
//! The traits are resolved at compile time: the code that runs for the PUMA 260 is the code that
//! would run if there were no other arm.

use core::fmt::{self, Debug};

use crate::spatial::{JointMatrix, JointVector, Joints, Pose};

/// An arm of `N` joints.
pub trait Arm<const N: usize>: Copy + Debug + PartialEq + Send + 'static {
    /// Finds the joints for one pose of a tool path after another.
    type Follower: PathFollower<N>;
    /// The rigid-body dynamics of the arm.
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
    /// Joints inside the limits that reach the tool pose `tool` (base frame), near `before` (rad or
    /// m). `None` where none are found. The work is bounded, so that a lane may call it.
    fn inverse_kinematics_near(
        &self,
        tool: &Pose,
        before: &JointVector<N>,
    ) -> Option<JointVector<N>>;
    /// A necessary condition of reachability at little cost: false only for a tool pose (base
    /// frame) that no joints reach. A pose for which it is true may be out of reach nevertheless.
    fn is_within_reach_bound(&self, tool: &Pose) -> bool;
    /// Whether some joints inside the limits reach the tool pose `tool` (base frame). It searches
    /// from many starts and takes too long for a lane.
    fn is_reachable(&self, tool: &Pose) -> bool;
    /// The joint step (rad or m) for the small motion `motion` of the tool in its own axes,
    /// `[v; w]` (m, rad), at `q` (rad or m). An arm with more joints than the tool has motions also
    /// makes as much of the step `wish` (rad or m) as leaves the tool where it is. `None` nearer to
    /// a singularity than `distance_min`, and where the step is not finite.
    fn tool_step(
        &self,
        q: &JointVector<N>,
        motion: &Joints,
        wish: &JointVector<N>,
        distance_min: f64,
    ) -> Option<JointVector<N>>;
    /// Absolute values of the scaled distances from the singularities of shoulder, elbow and wrist,
    /// between 0 and 1. An arm without these singularities returns three times the smallest
    /// singular value of its Jacobian, with lengths divided by its mean link length.
    fn singularity_distances(&self, q: &JointVector<N>) -> [f64; 3];
    /// A follower of tool paths that starts from rest at `q` (rad or m).
    fn follower(&self, q: &JointVector<N>) -> Self::Follower;

    /// Lever about the axis of `joint` at which what the arm touches can hold it (m): how far the
    /// tool point moves per angle, from a small turn of the joint at `q` (rad or m). An arm with
    /// several tools takes the one that the joint moves.
    fn touch_lever_m(&self, joint: usize, q: &JointVector<N>) -> f64 {
        const TURN_RAD: f64 = 1e-3;
        let mut turned = *q;
        turned[joint] += TURN_RAD;
        let [from, to] = [q, &turned].map(|q| self.tool_pose(q).translation);
        (to - from).length() / TURN_RAD
    }

    /// Whether every joint of `q` (rad or m), without any shift by whole turns, lies inside its
    /// limits. NaN does not.
    fn within_limits(&self, q: &JointVector<N>) -> bool {
        (0..N).all(|i| self.q_min()[i] <= q[i] && q[i] <= self.q_max()[i])
    }

    /// How far `joint` may move from `here` in the direction of `to` (rad or m, not negative): up
    /// to its limit, or up to a singularity beyond which a straight motion of the tool cannot
    /// return.
    fn remaining_travel(&self, joint: usize, here: &JointVector<N>, to: &JointVector<N>) -> f64 {
        self.travel_to_limit(joint, here, to).max(0.0)
    }

    /// How far `joint` may move from `here` in the direction of `to` until its limit (rad or m);
    /// negative where `here` is beyond the limit.
    fn travel_to_limit(&self, joint: usize, here: &JointVector<N>, to: &JointVector<N>) -> f64 {
        if to[joint] > here[joint] {
            self.q_max()[joint] - here[joint]
        } else {
            here[joint] - self.q_min()[joint]
        }
    }
}

/// The rigid-body dynamics of an arm of `N` joints. The inertia of the motors is included, friction
/// is not. Torques of prismatic joints are forces (N).
pub trait ArmDynamics<const N: usize>: Clone + Debug + Send + 'static {
    /// The mass matrix at `q` (kg m^2), symmetric and positive definite.
    fn mass_matrix(&self, q: &JointVector<N>) -> JointMatrix<N>;
    /// Coriolis, centrifugal and gravity torques at `q` (rad) and `qd` (rad/s) (N m).
    fn bias_torque(&self, q: &JointVector<N>, qd: &JointVector<N>) -> JointVector<N>;
    /// The torques that hold the arm at rest at `q` (rad) against gravity (N m).
    fn gravity_torque(&self, q: &JointVector<N>) -> JointVector<N>;
}

/// Finds the joints along a path of tool poses, tick by tick, from the joints where it started.
pub trait PathFollower<const N: usize>: Copy + Debug + PartialEq + Send + 'static {
    /// The joints of the last tick (rad or m).
    fn joints(&self) -> &JointVector<N>;

    /// The joints for the tool pose `tool` (base frame), one tick of `dt_s` (s) after the last one.
    ///
    /// # Errors
    /// [`FollowError`] where the arm cannot follow; the joints of the last tick are kept.
    fn step(&mut self, tool: &Pose, dt_s: f64) -> Result<FollowerStep<N>, FollowError>;
}

/// The joints of one tick and the error of the tool pose that they leave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowerStep<const N: usize = 6> {
    /// Joint values (rad or m).
    pub q: JointVector<N>,
    /// Distance of the tool point from its path (m).
    pub position_error_m: f64,
    /// Angle between the tool's orientation and that of the path (rad).
    pub orientation_error_rad: f64,
}

/// The reason why a path cannot be followed any further.
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
    /// This joint (0 is the first) would have to move faster than its limit.
    SpeedLimit {
        /// Index of the joint.
        joint: usize,
        /// Required speed over the largest speed, above 1.
        ratio: f64,
    },
    /// The path has ended, and this joint (0 is the first) did not settle at the goal in time.
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
