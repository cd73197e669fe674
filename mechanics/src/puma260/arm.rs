//! The PUMA 260 as an [`Arm`]: its closed forms behind the traits of planning and tracking.

use super::Puma260;
use super::dynamics::Dynamics;
use super::follower::Follower;
use crate::arm::{Arm, ArmDynamics, FollowError, FollowerStep, PathFollower};
use crate::spatial::{Joints, Matrix6, Pose, wrap_angle};

/// Angle from a singularity at which joints 1 and 3 are stopped when an operator jogs the arm
/// (rad). At the singularity itself no motion of the tool is slow enough for them to come back.
const SINGULARITY_MARGIN_RAD: f64 = 0.01;

impl Arm<6> for Puma260 {
    type Follower = Follower;
    type Dynamics = Dynamics;

    fn q_min(&self) -> &Joints {
        &self.q_min_rad
    }

    fn q_max(&self) -> &Joints {
        &self.q_max_rad
    }

    fn speed_max(&self) -> &Joints {
        &self.speed_max_rad_s
    }

    fn acceleration_max(&self) -> &Joints {
        &self.acceleration_max_rad_s2
    }

    fn with_speed_max(&self, speed_max: &Joints) -> Puma260 {
        Puma260 { speed_max_rad_s: *speed_max, ..*self }
    }

    fn tool_pose(&self, q: &Joints) -> Pose {
        Puma260::tool_pose(self, q)
    }

    fn inverse_kinematics_near(&self, tool: &Pose, before: &Joints) -> Option<Joints> {
        let branches = self.inverse_kinematics(&self.tool_to_wrist(tool), Some(before));
        Some(self.nearest_branch(&branches, before)?.1)
    }

    fn is_within_reach_bound(&self, tool: &Pose) -> bool {
        !self.inverse_kinematics(&self.tool_to_wrist(tool), None).is_empty()
    }

    fn is_reachable(&self, tool: &Pose) -> bool {
        let branches = self.inverse_kinematics(&self.tool_to_wrist(tool), None);
        branches.iter().any(|branch| branch.in_limits)
    }

    /// The Jacobian is square: nothing is left of the wish.
    fn tool_step(
        &self,
        q: &Joints,
        motion: &Joints,
        _wish: &Joints,
        distance_min: f64,
    ) -> Option<Joints> {
        let distance = self.singularity_distance(q).smallest();
        if distance.is_nan() || distance < distance_min {
            return None;
        }
        let step = self.jacobian_tool(q).lu().solve(motion)?;
        step.iter().all(|x| x.is_finite()).then_some(step)
    }

    fn singularity_distances(&self, q: &Joints) -> [f64; 3] {
        let distance = self.singularity_distance(q);
        [distance.shoulder.abs(), distance.elbow.abs(), distance.wrist.abs()]
    }

    fn follower(&self, q: &Joints) -> Follower {
        Follower::new(self, q)
    }

    /// Beside its limit, joint 1 stops before the shoulder singularity, and joint 3 before the
    /// elbow singularity, where the arm is stretched.
    fn remaining_travel(&self, joint: usize, here: &Joints, to: &Joints) -> f64 {
        let limit = self.travel_to_limit(joint, here, to);
        let reach = |q: &Joints| self.singularity_distance(q).shoulder.abs();
        let opening = |q: &Joints| wrap_angle(q[2] + core::f64::consts::FRAC_PI_2).abs();
        let singular = match joint {
            0 if reach(to) < reach(here) => {
                libm::atan2(reach(here) * (self.a2_m + self.d4_m), self.d3_m.abs())
                    - SINGULARITY_MARGIN_RAD
            }
            2 if opening(to) < opening(here) => opening(here) - SINGULARITY_MARGIN_RAD,
            _ => f64::INFINITY,
        };
        limit.min(singular).max(0.0)
    }
}

impl PathFollower<6> for Follower {
    fn joints(&self) -> &Joints {
        Follower::joints(self)
    }

    fn step(&mut self, tool: &Pose, dt_s: f64) -> Result<FollowerStep, FollowError> {
        Follower::step(self, tool, dt_s)
    }
}

impl ArmDynamics<6> for Dynamics {
    fn mass_matrix(&self, q: &Joints) -> Matrix6 {
        Dynamics::mass_matrix(self, q)
    }

    fn bias_torque(&self, q: &Joints, qd: &Joints) -> Joints {
        Dynamics::bias_torque(self, q, qd)
    }

    fn gravity_torque(&self, q: &Joints) -> Joints {
        Dynamics::gravity_torque(self, q)
    }
}
