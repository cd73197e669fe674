//! Any chain as planning and leading see an arm: poses are reached by damped steps from where the
//! arm is, tick by tick. Refuses a path that it cannot follow to a tenth of a nanometre, unless the
//! miss is small: then the miss is told, and whoever leads decides.
//!
//! A redundant arm takes the shortest way in its joints from tick to tick; where it stands after a
//! closed path of the tool depends on that path.

use super::{Chain, SearchBudget};
use crate::arm::{Arm, ArmDynamics, FollowError, FollowerStep, PathFollower};
use crate::spatial::{JointMatrix, JointVector, Pose};

/// What a lane may spend on one pose: a few starts, about half a millisecond when all of them fail.
const LANE_BUDGET: SearchBudget = SearchBudget {
    starts: 4,
    steps: 40,
    position_tolerance_m: 1e-10,
    orientation_tolerance_rad: 1e-10,
};
/// Rounding that a limit forgives, relative.
const LIMIT_ROUNDING: f64 = 1e-9;
/// A miss beyond these is no path any more (m, rad).
const LARGEST_MISS: (f64, f64) = (0.05, 0.3);

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
        #[expect(clippy::cast_precision_loss, reason = "at most eight")]
        let longest = self.mean_link_m * N as f64;
        let slides: f64 = (0..N).map(|i| self.links[i].travel_bound_m(&self.limits, i)).sum();
        tool.is_finite() && tool.translation.length() <= (longest + slides) * (1.0 + LIMIT_ROUNDING)
    }

    fn is_reachable(&self, tool: &Pose) -> bool {
        let middle = (self.limits.q_min + self.limits.q_max) * 0.5;
        self.inverse_kinematics(tool, &middle, &SearchBudget::default()).is_ok()
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

/// Follows a path of tool poses from where it was last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Follower<const N: usize> {
    arm: Chain<N>,
    q: JointVector<N>,
}

impl<const N: usize> Follower<N> {
    /// Where a pose that was not reached leaves the arm: at a limit, out of reach, or near enough.
    fn check_miss(&self, near: &super::IkFailure<N>) -> Result<(), FollowError> {
        let limits = &self.arm.limits;
        let at_limit = |i: &usize| {
            let rounding = LIMIT_ROUNDING * (1.0 + near.q[*i].abs());
            near.q[*i] <= limits.q_min[*i] + rounding || near.q[*i] >= limits.q_max[*i] - rounding
        };
        if let Some(joint) = (0..N).find(at_limit) {
            return Err(FollowError::JointLimit { joint });
        }
        // A NaN is not below.
        let small =
            near.position_error_m < LARGEST_MISS.0 && near.orientation_error_rad < LARGEST_MISS.1;
        if small { Ok(()) } else { Err(FollowError::OutOfReach) }
    }
}

impl<const N: usize> PathFollower<N> for Follower<N> {
    fn joints(&self) -> &JointVector<N> {
        &self.q
    }

    fn step(&mut self, tool: &Pose, dt_s: f64) -> Result<FollowerStep<N>, FollowError> {
        let got = match self.arm.inverse_kinematics(tool, &self.q, &SearchBudget::TICK) {
            Ok(found) => FollowerStep {
                q: found.q,
                position_error_m: found.position_error_m,
                orientation_error_rad: found.orientation_error_rad,
            },
            Err(near) => {
                self.check_miss(&near)?;
                FollowerStep {
                    q: near.q,
                    position_error_m: near.position_error_m,
                    orientation_error_rad: near.orientation_error_rad,
                }
            }
        };
        let mut worst = (0, 0.0);
        for joint in 0..N {
            let way = (got.q[joint] - self.q[joint]).abs();
            let ratio = way / (self.arm.limits.speed_max[joint] * dt_s);
            if ratio > worst.1 {
                worst = (joint, ratio);
            }
        }
        if worst.1 > 1.0 + LIMIT_ROUNDING {
            return Err(FollowError::SpeedLimit { joint: worst.0, ratio: worst.1 });
        }
        self.q = got.q;
        Ok(got)
    }
}
