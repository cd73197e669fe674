//! Any chain as an [`Arm`]: its iterative inverse kinematics behind the traits of planning and
//! tracking. A pose that is not reached exactly, but with a small error, is reported with that
//! error, and the caller decides; with a larger error the path is not followed.
//!
//! From tick to tick a redundant arm takes the joints nearest to the last ones. Its joints after a
//! closed path of the tool therefore depend on that path.

use super::{Chain, SearchBudget};
use crate::arm::{Arm, ArmDynamics, FollowError, FollowerStep, PathFollower};
use crate::spatial::{JointMatrix, JointVector, Joints, Pose};

/// The search budget of a lane for one pose: a few starts, about half a millisecond where all of
/// them fail.
const LANE_BUDGET: SearchBudget = SearchBudget {
    starts: 4,
    steps: 40,
    position_tolerance_m: 1e-10,
    orientation_tolerance_rad: 1e-10,
};
/// Relative excess over a limit that counts as rounding.
const LIMIT_ROUNDING: f64 = 1e-9;
/// Largest error of the position with which a path counts as followed (m).
const POSITION_ERROR_MAX_M: f64 = 0.05;
/// Largest error of the orientation with which a path counts as followed (rad).
const ORIENTATION_ERROR_MAX_RAD: f64 = 0.3;

impl<const N: usize> Arm<N> for Chain<N> {
    type Follower = Follower<N>;
    type Dynamics = Chain<N>;

    fn q_min(&self) -> &JointVector<N> {
        &self.limits.q_min
    }

    fn q_max(&self) -> &JointVector<N> {
        &self.limits.q_max
    }

    fn speed_max(&self) -> &JointVector<N> {
        &self.limits.speed_max
    }

    fn acceleration_max(&self) -> &JointVector<N> {
        &self.limits.acceleration_max
    }

    fn with_speed_max(&self, speed_max: &JointVector<N>) -> Chain<N> {
        let mut other = *self;
        other.limits.speed_max = *speed_max;
        other
    }

    fn tool_pose(&self, q: &JointVector<N>) -> Pose {
        Chain::tool_pose(self, q)
    }

    fn inverse_kinematics_near(
        &self,
        tool: &Pose,
        before: &JointVector<N>,
    ) -> Option<JointVector<N>> {
        self.inverse_kinematics(tool, before, &LANE_BUDGET).ok().map(|found| found.q)
    }

    fn is_within_reach_bound(&self, tool: &Pose) -> bool {
        #[expect(clippy::cast_precision_loss, reason = "at most nine")]
        let links_m = self.mean_link_m * N as f64;
        let travel_m: f64 = (0..N).map(|i| self.links[i].travel_bound_m(&self.limits, i)).sum();
        tool.is_finite()
            && (tool.translation - self.base_m).length()
                <= (links_m + travel_m) * (1.0 + LIMIT_ROUNDING)
    }

    fn is_reachable(&self, tool: &Pose) -> bool {
        let middle = (self.limits.q_min + self.limits.q_max) * 0.5;
        self.inverse_kinematics(tool, &middle, &SearchBudget::default()).is_ok()
    }

    fn tool_step(
        &self,
        q: &JointVector<N>,
        motion: &Joints,
        wish: &JointVector<N>,
        distance_min: f64,
    ) -> Option<JointVector<N>> {
        Chain::tool_step(self, q, motion, wish, distance_min)
    }

    fn singularity_distances(&self, q: &JointVector<N>) -> [f64; 3] {
        let Some(wrist) = &self.wrist else { return [self.singular_values(q)[5]; 3] };
        let six = crate::spatial::Joints::from_fn(|i, _| q[i]);
        let distance = wrist.singularity_distance(&six);
        [distance.shoulder.abs(), distance.elbow.abs(), distance.wrist.abs()]
    }

    fn follower(&self, q: &JointVector<N>) -> Follower<N> {
        Follower { arm: *self, q: *q }
    }
}

impl<const N: usize> ArmDynamics<N> for Chain<N> {
    fn mass_matrix(&self, q: &JointVector<N>) -> JointMatrix<N> {
        Chain::mass_matrix(self, q)
    }

    fn bias_torque(&self, q: &JointVector<N>, qd: &JointVector<N>) -> JointVector<N> {
        Chain::bias_torque(self, q, qd)
    }

    fn gravity_torque(&self, q: &JointVector<N>) -> JointVector<N> {
        Chain::gravity_torque(self, q)
    }
}

/// The state of a follower of tool poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Follower<const N: usize> {
    arm: Chain<N>,
    q: JointVector<N>,
}

impl<const N: usize> Follower<N> {
    /// The reason why a pose was not reached, from the nearest joints: a joint at its limit, or out
    /// of reach. `Ok` where the error is small enough to follow.
    fn check_miss(&self, nearest: &super::IkFailure<N>) -> Result<(), FollowError> {
        let limits = &self.arm.limits;
        let at_limit = |i: &usize| {
            let rounding = LIMIT_ROUNDING * (1.0 + nearest.q[*i].abs());
            nearest.q[*i] <= limits.q_min[*i] + rounding
                || nearest.q[*i] >= limits.q_max[*i] - rounding
        };
        if let Some(joint) = (0..N).find(at_limit) {
            return Err(FollowError::JointLimit { joint });
        }
        // NaN is not small.
        let is_small = nearest.position_error_m < POSITION_ERROR_MAX_M
            && nearest.orientation_error_rad < ORIENTATION_ERROR_MAX_RAD;
        if is_small { Ok(()) } else { Err(FollowError::OutOfReach) }
    }
}

impl<const N: usize> PathFollower<N> for Follower<N> {
    fn joints(&self) -> &JointVector<N> {
        &self.q
    }

    fn step(&mut self, tool: &Pose, dt_s: f64) -> Result<FollowerStep<N>, FollowError> {
        let followed = match self.arm.inverse_kinematics(tool, &self.q, &SearchBudget::TICK) {
            Ok(found) => FollowerStep {
                q: found.q,
                position_error_m: found.position_error_m,
                orientation_error_rad: found.orientation_error_rad,
            },
            Err(nearest) => {
                self.check_miss(&nearest)?;
                FollowerStep {
                    q: nearest.q,
                    position_error_m: nearest.position_error_m,
                    orientation_error_rad: nearest.orientation_error_rad,
                }
            }
        };
        let (mut fastest, mut largest) = (0, 0.0);
        for joint in 0..N {
            let distance = (followed.q[joint] - self.q[joint]).abs();
            let ratio = distance / (self.arm.limits.speed_max[joint] * dt_s);
            if ratio > largest {
                (fastest, largest) = (joint, ratio);
            }
        }
        if largest > 1.0 + LIMIT_ROUNDING {
            return Err(FollowError::SpeedLimit { joint: fastest, ratio: largest });
        }
        self.q = followed.q;
        Ok(followed)
    }
}
