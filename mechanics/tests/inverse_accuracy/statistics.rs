//! Statistics of the closed-form inverse kinematics of the PUMA 260 over many poses. A test and an
//! example (`examples/inverse_accuracy.rs`) compare them with their bounds.

use core::f64::consts::{FRAC_PI_2, PI};
use taktil_mechanics::puma260::{Branches, Puma260};
use taktil_mechanics::spatial::{rotation_vector, wrap_angle};
use taktil_mechanics::{Joints, Pose};

/// Counts and largest errors over the poses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Statistics {
    /// Number of poses.
    pub(crate) poses: u32,
    /// Poses with fewer than eight branches.
    pub(crate) missing: u32,
    /// Pairs of branches that coincide.
    pub(crate) duplicates: u32,
    /// Poses whose own joints were not among the branches, to the tolerance of the reference data.
    pub(crate) not_found: u32,
    /// Numbers that are not finite.
    pub(crate) not_finite: u32,
    /// Worst distance of a branch's wrist centre from the pose (m).
    pub(crate) position_error_m: f64,
    /// Worst angle of a branch to the pose (rad).
    pub(crate) orientation_error_rad: f64,
    /// Worst ratio of the distance from the pose's own joints to its tolerance.
    pub(crate) ratio: f64,
}

/// A linear congruential generator, constants of Knuth's MMIX.
struct Lcg(u64);

impl Lcg {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        #[expect(clippy::cast_precision_loss, reason = "53 bits fit")]
        let unit = (self.0 >> 11) as f64 / 9_007_199_254_740_992.0;
        low + (high - low) * unit
    }

    fn joints(&mut self, arm: &Puma260) -> Joints {
        Joints::from_fn(|i, _| self.between(arm.q_min_rad[i], arm.q_max_rad[i]))
    }

    /// Joints with every factor of the determinant at least 0.2 in size.
    fn regular(&mut self, arm: &Puma260) -> Joints {
        loop {
            let q = self.joints(arm);
            if arm.singularity_distance(&q).smallest() > 0.2 {
                return q;
            }
        }
    }

    /// A number of either sign whose absolute value lies between ten to the power of `least` and
    /// 0.1, with a uniform logarithm; 0 once in twenty times where `least` is below -6.
    fn small(&mut self, least: f64) -> f64 {
        let size = libm::pow(10.0, self.between(least, -1.0));
        match self.between(0.0, 20.0) {
            x if x < 1.0 && least < -6.0 => 0.0,
            x if x < 10.0 => -size,
            _ => size,
        }
    }
}

fn joint_distance(a: &Joints, b: &Joints) -> f64 {
    (a - b).map(wrap_angle).amax()
}

impl Statistics {
    fn add_errors(&mut self, arm: &Puma260, pose: &Pose, branches: &Branches) {
        self.poses += 1;
        self.missing += u32::from(branches.len() < 8);
        for branch in branches {
            let got = arm.wrist_pose(&branch.q);
            let off = (got.translation - pose.translation).length();
            let turn = rotation_vector(&pose.rotation, &got.rotation).length();
            self.not_finite += u32::from(!(off.is_finite() && turn.is_finite()));
            (self.position_error_m, self.orientation_error_rad) =
                (self.position_error_m.max(off), self.orientation_error_rad.max(turn));
        }
    }

    /// Pairs nearer than `least` (rad).
    fn count_duplicates(&mut self, branches: &Branches, least: f64) {
        for (index, a) in branches.iter().enumerate() {
            for b in branches.iter().skip(index + 1) {
                self.duplicates += u32::from(joint_distance(&a.q, &b.q) < least);
            }
        }
    }

    fn check_own_joints(&mut self, branches: &Branches, q: &Joints, tolerance: f64) {
        let nearest =
            branches.iter().map(|b| joint_distance(&b.q, q)).fold(f64::INFINITY, f64::min);
        self.not_found += u32::from(nearest.is_nan() || nearest > tolerance);
        self.ratio = self.ratio.max(nearest / tolerance);
    }
}

/// Random joints inside the limits: residuals, eight different branches, the joints found again.
/// Their tolerance is that of the reference data: 6.4e-14 over the factors of the determinant,
/// 1e-6 at a double root.
pub(crate) fn random(count: u32, seed: u64) -> Statistics {
    let arm = Puma260::reference();
    let mut lcg = Lcg(seed);
    let mut statistics = Statistics::default();
    for _ in 0..count {
        let q = lcg.joints(&arm);
        let pose = arm.wrist_pose(&q);
        let branches = arm.inverse_kinematics(&pose, Some(&q));
        statistics.add_errors(&arm, &pose, &branches);
        let d = arm.singularity_distance(&q);
        let product = (d.shoulder * d.elbow * d.wrist).abs();
        statistics.check_own_joints(&branches, &q, (6.4e-14 / product).clamp(1e-12, 1e-6));
        // Two branches may come close only near a double root.
        statistics.count_duplicates(&branches, 0.1 * d.shoulder.abs().min(d.elbow.abs()));
    }
    statistics
}

/// Joints at and beside one singularity, 1e-12 to 0.1 away or in it, or two, 1e-6 to 0.1 away, with
/// the joints given as the ones before. The tolerance is that of the reference data for the kind
/// and the distance.
pub(crate) fn near_singular(count: u32, seed: u64) -> Statistics {
    let arm = Puma260::reference();
    let mut lcg = Lcg(seed);
    let mut statistics = Statistics::default();
    for n in 0..count {
        let mut q = lcg.regular(&arm);
        let kind = n % 5;
        // Nearer to two singularities at once only the pose is determined: the rounding of the
        // double root rotates the singular wrist arbitrarily.
        let eps = if kind < 3 { lcg.small(-12.0) } else { lcg.small(-6.0) };
        if kind == 0 || kind >= 3 {
            q[4] = eps;
        }
        if kind == 1 || kind == 3 {
            q[2] = -FRAC_PI_2 + eps;
        }
        if kind == 2 || kind == 4 {
            // Joint 2 where the reach is eps: a2 c2 - d4 s23 rotates with joint 2 as a whole.
            let (s3, c3) = libm::sincos(q[2]);
            let (x, y) = (arm.a2_m - arm.d4_m * s3, arm.d4_m * c3);
            q[1] = libm::atan2(x, y) + eps;
        }
        let pose = arm.wrist_pose(&q);
        let branches = arm.inverse_kinematics(&pose, Some(&q));
        statistics.add_errors(&arm, &pose, &branches);
        let size = eps.abs();
        let tolerance = match kind {
            0 if size < 1e-11 => 1e-9,
            0 => 4e-15 / size,
            1 => 1.6e-14 / size,
            2 => 3.2e-14 / size,
            _ => 6.4e-14 / (size * size),
        };
        let most = if kind < 3 { 1e-6_f64.max(if kind == 0 { 1e-2 } else { 0.0 }) } else { 0.064 };
        statistics.check_own_joints(&branches, &q, tolerance.clamp(1e-11, most));
    }
    statistics
}

/// Joint 5 from 1e-3 to 0 in `steps` and through to the other side, the joints of each step given
/// to the next: every step has eight branches, no two of them one, and the way back to the joints
/// that made it.
pub(crate) fn through_the_wrist(starts: u32, steps: u32, seed: u64) -> Statistics {
    let arm = Puma260::reference();
    let mut lcg = Lcg(seed);
    let mut statistics = Statistics::default();
    for _ in 0..starts {
        let mut q = lcg.regular(&arm);
        q[3] = lcg.between(-PI, PI);
        q[4] = 1e-3;
        let mut before = q;
        for n in 0..=steps {
            let share = f64::from(n) / f64::from(steps);
            q[4] = if n == steps { 0.0 } else { 1e-3 * libm::pow(10.0, -12.0 * share) };
            let pose = arm.wrist_pose(&q);
            let branches = arm.inverse_kinematics(&pose, Some(&before));
            statistics.add_errors(&arm, &pose, &branches);
            statistics.count_duplicates(&branches, 1e-2);
            let tolerance = if q[4] < 1e-11 { 1e-9 } else { 1e-9 + 4e-15 / q[4] };
            // Joints 4 and 6 are determined only to this tolerance, and each step starts from the
            // last one.
            match arm.nearest_branch(&branches, &before) {
                Some((_, near)) => {
                    let off = joint_distance(&near, &q);
                    statistics.not_found += u32::from(off > 2.0 * tolerance);
                    statistics.ratio = statistics.ratio.max(off / (2.0 * tolerance));
                }
                None => statistics.not_found += 1,
            }
            before = q;
        }
    }
    statistics
}
