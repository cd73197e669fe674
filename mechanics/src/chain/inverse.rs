//! The inverse of any chain by damped steps from where the arm is, and from other starts when that
//! fails. Refuses to pretend: what was not reached is an error that says how far off the nearest
//! try was. Starts are a fixed sequence, steps and starts are counted, so that a call has a longest
//! time and the same call gives the same bits.
//!
//! Steps are those of Levenberg and Marquardt in the form of Sugihara (2011): the damping is half
//! the square of what is missed, so it vanishes towards a solution, and the last steps double the
//! digits. Being minimal in the joints, they leave a redundant arm near its start. Joints at their
//! limits are taken out of a step that would push them on.

use core::f64::consts::PI;
use core::fmt;

use super::{Chain, JointKind, MAX_JOINTS};
use crate::cholesky::solve_positive_definite;
use crate::puma260::inverse::is_bounded;
use crate::spatial::{Jacobian, JointVector, Pose, rotation_vector};
use glam::{DMat3, DVec3};
use nalgebra::{Matrix6, Vector6};

/// How much may be tried, and what is good enough.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchBudget {
    /// Starts, the one from the joints before included.
    pub starts: u32,
    /// Steps from each start.
    pub steps: u32,
    /// Distance of the tool point that counts as reached (m).
    pub position_tolerance_m: f64,
    /// Angle of the tool that counts as reached (rad).
    pub orientation_tolerance_rad: f64,
}

impl Default for SearchBudget {
    /// 64 starts of 40 steps, 1e-10 m, 1e-10 rad.
    fn default() -> SearchBudget {
        SearchBudget {
            starts: 64,
            steps: 40,
            position_tolerance_m: 1e-10,
            orientation_tolerance_rad: 1e-10,
        }
    }
}

impl SearchBudget {
    /// What a tick of following allows: one start of few steps.
    pub const TICK: SearchBudget = SearchBudget {
        starts: 1,
        steps: 12,
        position_tolerance_m: 1e-10,
        orientation_tolerance_rad: 1e-10,
    };
}

/// Joints that reach a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IkSolution<const N: usize> {
    /// Joint values inside the limits (rad or m).
    pub q: JointVector<N>,
    /// Which start led there, 1 for the joints before.
    pub starts: u32,
    /// Steps taken in all.
    pub steps: u32,
    /// Distance of the tool point left (m).
    pub position_error_m: f64,
    /// Angle of the tool left (rad).
    pub orientation_error_rad: f64,
}

/// No start reached the pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IkFailure<const N: usize> {
    /// The nearest joints that were seen inside the limits.
    pub q: JointVector<N>,
    /// Distance of their tool point (m); infinite where the pose or the joints before are not
    /// finite.
    pub position_error_m: f64,
    /// Angle of their tool (rad).
    pub orientation_error_rad: f64,
}

impl<const N: usize> fmt::Display for IkFailure<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the pose was not reached: the nearest try misses it by {:.3e} m and {:.3e} rad",
            self.position_error_m, self.orientation_error_rad
        )
    }
}

impl<const N: usize> std::error::Error for IkFailure<N> {}

/// No joint moves further in one step (rad, or mean links).
const STEP_MAX_RAD: f64 = 0.6;
/// Damping that is never gone below, relative to the squares of the Jacobian (about 1).
const DAMPING_MIN: f64 = 1e-14;
/// Times that joints at their limits are taken out of one step.
const LIMIT_ROUNDS_MAX: u32 = 3;
/// Steps after the goal was reached, as long as each still halves what is missed.
const REFINEMENT_STEPS_MAX: u32 = 3;
/// Squares of the miss below which rounding is all that is left.
const SQUARED_ERROR_MIN: f64 = 1e-31;

/// Fractions of the golden sequence in eight dimensions, `1/g^k` with `g^9 = g + 1` (Roberts 2018).
const LOW_DISCREPANCY_FRACTIONS: [f64; MAX_JOINTS] = [
    0.921_599_319_633_983,
    0.849_345_305_949_820_3,
    0.782_756_056_097_671_4,
    0.721_387_448_738_993_7,
    0.664_830_181_950_351_4,
    0.612_707_043_357_580_9,
    0.564_670_394_293_295_8,
    0.520_399_851_198_154_4,
];

/// How far a try is from its goal.
#[derive(Clone, Copy)]
struct PoseError {
    /// Position over the mean link, rotation vector; base frame.
    scaled: Vector6<f64>,
    position_error_m: f64,
    orientation_error_rad: f64,
}

impl PoseError {
    fn half_squared_norm(&self) -> f64 {
        0.5 * self.scaled.norm_squared()
    }
}

impl<const N: usize> Chain<N> {
    /// Joints whose tool pose is `tool` (base frame, orthonormal rotation), inside the limits:
    /// first from `previous`, which leads to the solution nearest to it where the motion is small,
    /// then from other starts.
    ///
    /// # Errors
    /// [`IkFailure`]; a pose that is out of reach is one, so is one that holds a number that is not
    /// finite.
    pub fn inverse_kinematics(
        &self,
        tool: &Pose,
        previous: &JointVector<N>,
        effort: &SearchBudget,
    ) -> Result<IkSolution<N>, IkFailure<N>> {
        let mut best = IkFailure {
            q: *previous,
            position_error_m: f64::INFINITY,
            orientation_error_rad: f64::INFINITY,
        };
        if !(is_bounded(tool, 1e9) && previous.iter().all(|x| x.abs() <= 1e9)) {
            return Err(best);
        }
        let mut steps = 0;
        let mut least = f64::INFINITY;
        for start in 0..effort.starts {
            let from =
                if start == 0 { self.clamp_to_limits(previous) } else { self.start_point(start) };
            let (q, miss) = self.iterate(tool, &from, effort, &mut steps);
            let reached = miss.position_error_m <= effort.position_tolerance_m
                && miss.orientation_error_rad <= effort.orientation_tolerance_rad;
            let Some((q, _)) = self.nearest_equivalent(&q, previous) else { continue };
            if reached {
                let (off_m, off_rad) = (miss.position_error_m, miss.orientation_error_rad);
                return Ok(IkSolution {
                    q,
                    starts: start + 1,
                    steps,
                    position_error_m: off_m,
                    orientation_error_rad: off_rad,
                });
            }
            if miss.half_squared_norm() < least {
                least = miss.half_squared_norm();
                best = IkFailure {
                    q,
                    position_error_m: miss.position_error_m,
                    orientation_error_rad: miss.orientation_error_rad,
                };
            }
        }
        Err(best)
    }

    /// Joints clamped into their limits.
    fn clamp_to_limits(&self, q: &JointVector<N>) -> JointVector<N> {
        JointVector::<N>::from_fn(|i, _| q[i].clamp(self.limits.q_min[i], self.limits.q_max[i]))
    }

    /// Start number `n` of the sequence that spreads over the limits, one turn of them at most.
    fn start_point(&self, n: u32) -> JointVector<N> {
        JointVector::<N>::from_fn(|i, _| {
            let (low, high) = (self.limits.q_min[i], self.limits.q_max[i]);
            let middle = 0.5 * (low + high);
            let half = match self.links[i].kind {
                JointKind::Revolute => (0.5 * (high - low)).min(PI),
                JointKind::Prismatic => 0.5 * (high - low),
            };
            let x = f64::from(n) * LOW_DISCREPANCY_FRACTIONS[i] + 0.5;
            middle + half * (2.0 * (x - x.floor()) - 1.0)
        })
    }

    fn pose_error(&self, goal: &Pose, at: &Pose) -> PoseError {
        let p = goal.translation - at.translation;
        let r = at.rotation * rotation_vector(&at.rotation, &goal.rotation);
        let s = p / self.mean_link_m;
        PoseError {
            scaled: Vector6::new(s.x, s.y, s.z, r.x, r.y, r.z),
            position_error_m: p.length(),
            orientation_error_rad: r.length(),
        }
    }

    /// Damped steps from one start; the best place that was passed.
    fn iterate(
        &self,
        goal: &Pose,
        from: &JointVector<N>,
        effort: &SearchBudget,
        steps: &mut u32,
    ) -> (JointVector<N>, PoseError) {
        let mut q = *from;
        let mut frames = self.frames(&q);
        let mut miss = self.pose_error(goal, &frames.tool);
        let mut best = (q, miss);
        let mut polished = 0;
        for _ in 0..effort.steps {
            let square = miss.half_squared_norm();
            if square <= SQUARED_ERROR_MIN {
                break;
            }
            *steps += 1;
            let j = self.jacobian_from_frames(&frames, &DMat3::IDENTITY);
            let step = self.step_within_limits(&q, &j, &miss.scaled, square + DAMPING_MIN);
            q = self.clamp_to_limits(&(q + self.limit_step(&step)));
            frames = self.frames(&q);
            miss = self.pose_error(goal, &frames.tool);
            let better = miss.half_squared_norm() < 0.25 * best.1.half_squared_norm();
            if miss.half_squared_norm() < best.1.half_squared_norm() {
                best = (q, miss);
            }
            if best.1.position_error_m <= effort.position_tolerance_m
                && best.1.orientation_error_rad <= effort.orientation_tolerance_rad
            {
                polished += 1;
                if !better || polished > REFINEMENT_STEPS_MAX {
                    break;
                }
            }
        }
        best
    }

    /// The damped step of the joints that can make it: one that stands at a limit and would leave
    /// it is taken out, and the others make the step without it. Clamped afterwards instead, the
    /// step would point elsewhere and stall along the limit.
    fn step_within_limits(
        &self,
        q: &JointVector<N>,
        jacobian: &Jacobian<N>,
        error: &Vector6<f64>,
        damping: f64,
    ) -> JointVector<N> {
        let (mut j, mut free) = (*jacobian, [true; N]);
        let mut step = self.damped_step(&j, error, damping);
        for _ in 0..LIMIT_ROUNDS_MAX {
            let leaves = |i: usize| {
                (q[i] <= self.limits.q_min[i] && step[i] < 0.0)
                    || (q[i] >= self.limits.q_max[i] && step[i] > 0.0)
            };
            let held: [bool; N] = core::array::from_fn(|i| free[i] && leaves(i));
            if !held.contains(&true) {
                break;
            }
            for i in (0..N).filter(|i| held[*i]) {
                free[i] = false;
                j.column_mut(i).fill(0.0);
            }
            step = self.damped_step(&j, error, damping);
        }
        step
    }

    /// `J^T (J J^T + damping I)^-1 error` with positions counted in mean links; rest where a
    /// number is not finite.
    fn damped_step(
        &self,
        jacobian: &Jacobian<N>,
        error: &Vector6<f64>,
        damping: f64,
    ) -> JointVector<N> {
        let mut j = *jacobian;
        for column in 0..N {
            for row in 0..3 {
                j[(row, column)] /= self.mean_link_m;
            }
        }
        let mut square = Matrix6::zeros();
        for a in 0..6 {
            for b in 0..=a {
                let mut sum = if a == b { damping } else { 0.0 };
                for k in 0..N {
                    sum += j[(a, k)] * j[(b, k)];
                }
                square[(a, b)] = sum;
                square[(b, a)] = sum;
            }
        }
        let mut x = *error;
        solve_positive_definite(&mut square, &mut x);
        let step = j.tr_mul(&x);
        if step.iter().all(|x| x.is_finite()) { step } else { JointVector::zeros() }
    }

    /// A step shortened as a whole to the longest one.
    fn limit_step(&self, step: &JointVector<N>) -> JointVector<N> {
        let most = (0..N).fold(0.0_f64, |most, i| {
            let size = match self.links[i].kind {
                JointKind::Revolute => step[i].abs(),
                JointKind::Prismatic => step[i].abs() / self.mean_link_m,
            };
            most.max(size)
        });
        if most > STEP_MAX_RAD { step * (STEP_MAX_RAD / most) } else { *step }
    }

    /// Joint rates for a twist of the tool point `[v; w]` (base frame), damped least squares with
    /// positions counted in mean links; `damping` is lambda^2 in that measure. What the rates miss
    /// of the twist comes beside them. Numbers that are not finite, or too large to square, give
    /// rest.
    #[must_use]
    pub fn resolved_rates(
        &self,
        q: &JointVector<N>,
        twist: &Vector6<f64>,
        damping: f64,
    ) -> (JointVector<N>, Vector6<f64>) {
        let j = self.jacobian_base(q);
        let mut scaled = *twist;
        let linear = DVec3::new(twist[0], twist[1], twist[2]) / self.mean_link_m;
        scaled.fixed_rows_mut::<3>(0).copy_from_slice(&linear.to_array());
        let damping = damping.abs().clamp(DAMPING_MIN, 1e100);
        let rates = self.damped_step(&j, &scaled, damping);
        (rates, twist - j * rates)
    }
}
