//! Converts displacements of the sensor to desired joints: it applies the inverse of the
//! manipulator Jacobian, integrates the *desired* angles, and spreads each step evenly over the
//! jobs until the next image. Steps near a singularity are refused, and steps that would lead the
//! arm further than the bound are shortened.
//!
//! The thesis adds the step to the current angles. Added to the measured ones, the position servo
//! would never see an error and the arm would sink under its own weight; so the angles integrated
//! here are the desired ones, and their lead over the measured ones is bounded.

use taktil_mechanics::Joints;
use taktil_mechanics::arm::Arm;
use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{FaultCode, Fold, StateHash};

/// Fastest motion of a joint towards the posture at which the law took over (rad/s).
const POSTURE_SPEED_MAX_RAD_S: f64 = 0.2;

/// The joint step `J_tool(q)^-1 motion` (rad) for a small motion of the tool frame (m, rad). Where
/// the arm has more joints than the tool has motions it is the shortest such step, and `wish` (rad)
/// is made as far as it leaves the tool where it is.
///
/// # Errors
/// [`FaultCode::Singular`] when `q` is nearer to a singularity than `distance_min`, or when the
/// step is not finite.
pub fn joint_step<const N: usize, A: Arm<N>>(
    arm: &A,
    q: &JointVector<N>,
    motion: &Joints,
    wish: &JointVector<N>,
    distance_min: f64,
) -> Result<JointVector<N>, FaultCode> {
    arm.tool_step(q, motion, wish, distance_min).ok_or(FaultCode::Singular)
}

/// The step (rad) from `q` towards `posture` (rad) that a span of `span_s` allows, at `rate_per_s`
/// of the way left and at most 0.2 rad/s.
#[must_use]
pub fn posture_wish<const N: usize>(
    q: &JointVector<N>,
    posture: &JointVector<N>,
    rate_per_s: f64,
    span_s: f64,
) -> JointVector<N> {
    let most = POSTURE_SPEED_MAX_RAD_S * span_s;
    let wish = (posture - q) * (rate_per_s * span_s).clamp(0.0, 1.0);
    let largest = wish.amax();
    if largest > most { wish * (most / largest) } else { wish }
}

/// The part of `step` that keeps `|target + step - measured|` of every joint within `lead_max`
/// (rad).
///
/// The steps of all joints are shortened by the same factor, so that the finger keeps its
/// direction. If a joint is ahead by more already, a step that takes it further becomes zero, and a
/// step that brings it back is not shortened. The result is zero when a number is not finite.
#[must_use]
pub fn lead_limited_step<const N: usize>(
    target: &JointVector<N>,
    measured: &JointVector<N>,
    step: &JointVector<N>,
    lead_max: f64,
) -> JointVector<N> {
    let mut share: f64 = 1.0;
    for i in 0..N {
        let lead = target[i] - measured[i];
        let after = lead + step[i];
        if !after.is_finite() {
            return JointVector::zeros();
        }
        if after.abs() > lead_max && after.abs() > lead.abs() {
            let room = (lead_max - lead * step[i].signum()).max(0.0);
            share = share.min(room / step[i].abs());
        }
    }
    step * share.clamp(0.0, 1.0)
}

/// The integrated desired joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointIntegrator<const N: usize = 6> {
    /// Where the steps so far lead to (rad).
    target: JointVector<N>,
    /// The goal that was published last (rad).
    goal: JointVector<N>,
    /// The joints at the start (rad).
    posture: JointVector<N>,
    /// Jobs until the goal is at the target.
    jobs_left: u32,
}

impl<const N: usize> Fold for JointIntegrator<N> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(self.target.as_slice()).add(self.goal.as_slice()).add(&self.jobs_left);
        if N > 6 {
            hash.add(self.posture.as_slice());
        }
    }
}

impl<const N: usize> JointIntegrator<N> {
    /// Starts at the joints that are desired now.
    #[must_use]
    pub fn new(desired: &JointVector<N>) -> JointIntegrator<N> {
        JointIntegrator { target: *desired, goal: *desired, posture: *desired, jobs_left: 0 }
    }

    /// The joints at the start (rad).
    #[must_use]
    pub fn posture(&self) -> &JointVector<N> {
        &self.posture
    }

    /// Where the steps so far lead to (rad).
    #[must_use]
    pub fn target(&self) -> &JointVector<N> {
        &self.target
    }

    /// Adds a step (rad), to be carried out within the next `jobs` jobs (at least 1) together with
    /// the rest of the step before.
    pub fn add(&mut self, step: &JointVector<N>, jobs: u32) {
        self.target += step;
        self.jobs_left = jobs.max(1);
    }

    /// The goal of the next job (rad), and its difference from the one before.
    pub fn advance(&mut self) -> (JointVector<N>, JointVector<N>) {
        let before = self.goal;
        match self.jobs_left {
            0 => {}
            1 => self.goal = self.target,
            jobs => self.goal += (self.target - self.goal) / f64::from(jobs),
        }
        self.jobs_left = self.jobs_left.saturating_sub(1);
        (self.goal, self.goal - before)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::puma260::Puma260;
    use taktil_mechanics::spatial::linear_and_angular;

    fn rolling() -> Joints {
        Joints::from([0.0, 40.2, -153.4, -180.0, 66.8, 180.0].map(f64::to_radians))
    }

    #[test]
    fn a_joint_step_moves_the_tool_as_asked_in_its_own_frame() {
        let arm = Puma260::reference();
        let motion = Joints::new(1e-6, 0.0, -2e-6, 3e-6, 0.0, 4e-6);
        let q = rolling();
        let step = joint_step(&arm, &q, &motion, &Joints::zeros(), 0.05).unwrap();
        let (before, after) = (arm.tool_pose(&q), arm.tool_pose(&(q + step)));
        let moved = before.rotation.transpose() * (after.translation - before.translation);
        let (linear, angular) = linear_and_angular(&motion);
        assert!((moved - linear).length() < 1e-10, "{moved}");
        let turned = before.rotation.transpose() * after.rotation;
        assert!((turned.y_axis.z - angular.x).abs() < 1e-10);
        assert!((turned.z_axis.x - angular.y).abs() < 1e-10);
        assert!((turned.x_axis.y - angular.z).abs() < 1e-10);
    }

    #[test]
    fn near_a_singularity_and_for_nan_there_is_no_step() {
        let arm = Puma260::reference();
        let motion = Joints::new(1e-4, 0.0, 0.0, 0.0, 0.0, 0.0);
        let mut q = rolling();
        let distance = arm.singularity_distance(&q).smallest();
        assert!(
            joint_step(&arm, &q, &motion, &Joints::zeros(), distance).is_ok(),
            "the limit itself is far enough"
        );
        assert_eq!(
            joint_step(&arm, &q, &motion, &Joints::zeros(), distance * 1.000_001),
            Err(FaultCode::Singular)
        );
        q[4] = 0.02;
        assert_eq!(joint_step(&arm, &q, &motion, &Joints::zeros(), 0.05), Err(FaultCode::Singular));
        q[4] = f64::NAN;
        assert_eq!(joint_step(&arm, &q, &motion, &Joints::zeros(), 0.05), Err(FaultCode::Singular));
        let nan = Joints::repeat(f64::NAN);
        assert_eq!(
            joint_step(&arm, &rolling(), &nan, &Joints::zeros(), 0.05),
            Err(FaultCode::Singular)
        );
        assert_eq!(
            joint_step(&arm, &Joints::zeros(), &motion, &Joints::zeros(), 0.05),
            Err(FaultCode::Singular)
        );
    }

    #[test]
    fn the_lead_is_bounded_and_may_shrink_freely() {
        let measured = Joints::zeros();
        let ahead = |x: f64| Joints::new(x, 0.0, 0.0, 0.0, 0.0, 0.0);
        let step = Joints::new(0.02, 0.01, 0.0, 0.0, 0.0, 0.0);
        let all =
            |target: f64, step: &Joints| lead_limited_step(&ahead(target), &measured, step, 0.05);
        assert_eq!(all(0.0, &step), step);
        assert_eq!(all(0.05, &step), Joints::zeros(), "frozen as a whole");
        let half = all(0.04, &step);
        assert!((half[0] - 0.01).abs() < 1e-15 && (half[1] - 0.005).abs() < 1e-15);
        assert_eq!(all(0.05, &-step), -step);
        assert_eq!(all(0.9, &-step), -step, "already beyond: back is free");
        assert_eq!(all(0.9, &step), Joints::zeros());
        assert_eq!(all(-0.9, &-step), Joints::zeros());
        assert_eq!(all(-0.9, &step), step);
        let across = Joints::new(-0.2, 0.0, 0.0, 0.0, 0.0, 0.0);
        assert!((all(0.05, &across)[0] + 0.1).abs() < 1e-15, "through to the other bound");
        for bad in [f64::NAN, f64::INFINITY] {
            assert_eq!(lead_limited_step(&ahead(bad), &measured, &step, 0.05), Joints::zeros());
            assert_eq!(lead_limited_step(&measured, &ahead(bad), &step, 0.05), Joints::zeros());
            assert_eq!(lead_limited_step(&measured, &measured, &ahead(bad), 0.05), Joints::zeros());
        }
    }

    #[test]
    fn steps_are_spread_evenly_and_none_of_them_is_lost() {
        let start = rolling();
        let mut follower = JointIntegrator::new(&start);
        assert_eq!(follower.advance(), (start, Joints::zeros()), "bumpless");
        let step = Joints::repeat(1e-3);
        follower.add(&step, 2);
        let (first, moved) = follower.advance();
        assert!((moved - step * 0.5).amax() < 1e-15);
        assert!((first - start - step * 0.5).amax() < 1e-15);
        assert_eq!(follower.advance().0, start + step, "to the bit");
        assert_eq!(follower.advance(), (start + step, Joints::zeros()));
    }

    #[test]
    fn an_early_or_a_late_image_changes_no_total() {
        let start = Joints::zeros();
        let mut follower = JointIntegrator::new(&start);
        let mut total = Joints::zeros();
        for jobs in [1, 2, 1, 3, 2, 5, 1, 1] {
            let step = Joints::repeat(0.001 * f64::from(jobs));
            follower.add(&step, 2);
            total += step;
            for _ in 0..jobs {
                follower.advance();
            }
        }
        follower.advance();
        assert_eq!(follower.advance(), (total, Joints::zeros()));
        assert_eq!(follower.target(), &total);
        let mut follower = JointIntegrator::new(&start);
        follower.add(&total, 0);
        assert_eq!(follower.advance().0, total, "no jobs counts as one");
    }
}
