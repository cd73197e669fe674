//! The iterative inverse kinematics of any chain, from given joints and, where that fails, from
//! other starting points. A pose that is not reached is an error with the nearest joints and their
//! error. Starting points are a fixed sequence, and steps and starts are counted, so that a call
//! has a bounded time and the same call gives the same bits.
//!
//! Steps are those of Levenberg and Marquardt in the form of Sugihara (2011): the damping is half
//! the square of the error, so that it vanishes towards a solution and convergence becomes
//! quadratic. The steps have the smallest norm, so that a redundant arm stays near its start. A
//! joint at its limit is taken out of a step that would push it beyond.

use core::f64::consts::PI;
use core::fmt;

use super::{Chain, JointKind, MAX_JOINTS};
use crate::cholesky::solve_positive_definite;
use crate::puma260::inverse::is_bounded;
use crate::spatial::{Jacobian, JointVector, Pose, rotation_vector};
use glam::{DMat3, DVec3};
use nalgebra::{Matrix6, Vector6};

/// The bounds of the work and the tolerances of the inverse kinematics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchBudget {
    /// Number of starting points, including the previous joints.
    pub starts: u32,
    /// Largest number of steps from each starting point.
    pub steps: u32,
    /// Distance of the tool point at which the pose counts as reached (m).
    pub position_tolerance_m: f64,
    /// Angle of the tool at which the pose counts as reached (rad).
    pub orientation_tolerance_rad: f64,
}

impl Default for SearchBudget {
    /// 64 starting points of 40 steps, tolerances of 1e-10 m and 1e-10 rad.
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
    /// The budget of one tick of a follower: one starting point and few steps.
    pub const TICK: SearchBudget = SearchBudget {
        starts: 1,
        steps: 12,
        position_tolerance_m: 1e-10,
        orientation_tolerance_rad: 1e-10,
    };
}

/// A solution of the inverse kinematics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IkSolution<const N: usize> {
    /// Joint values inside the limits (rad or m).
    pub q: JointVector<N>,
    /// Number of starting points used; 1 where the previous joints led to the solution.
    pub starts: u32,
    /// Number of steps over all starting points.
    pub steps: u32,
    /// Remaining distance of the tool point (m).
    pub position_error_m: f64,
    /// Remaining angle of the tool (rad).
    pub orientation_error_rad: f64,
}

/// The pose was not reached from any starting point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IkFailure<const N: usize> {
    /// The nearest joints found inside the limits (rad or m).
    pub q: JointVector<N>,
    /// Distance of their tool point (m); infinite where the pose or the previous joints are not
    /// finite.
    pub position_error_m: f64,
    /// Angle of their tool (rad); infinite in the same case.
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

/// Largest change of a joint in one step (rad; for prismatic joints mean link lengths).
const STEP_MAX_RAD: f64 = 0.6;
/// Smallest damping lambda^2 (1, where the elements of the scaled Jacobian are about 1).
const DAMPING_MIN: f64 = 1e-14;
/// How often joints at their limits are taken out of one step.
const LIMIT_ROUNDS_MAX: u32 = 3;
/// Largest number of steps after the tolerances are met, as long as each at least halves the error.
const REFINEMENT_STEPS_MAX: u32 = 3;
/// Half the square of the scaled error below which only rounding is left (rad^2).
const SQUARED_ERROR_MIN: f64 = 1e-31;

/// Increments of a low-discrepancy sequence in eight dimensions, `1/g^k` with `g^9 = g + 1`
/// (Roberts 2018); the ninth is the fraction of the square root of two, which no sum of whole
/// multiples of the others gives.
const LOW_DISCREPANCY_FRACTIONS: [f64; MAX_JOINTS] = [
    0.921_599_319_633_983,
    0.849_345_305_949_820_3,
    0.782_756_056_097_671_4,
    0.721_387_448_738_993_7,
    0.664_830_181_950_351_4,
    0.612_707_043_357_580_9,
    0.564_670_394_293_295_8,
    0.520_399_851_198_154_4,
    0.414_213_562_373_095_03,
];

/// The error of a tool pose.
#[derive(Clone, Copy)]
struct PoseError {
    /// Position error over the mean link length, and rotation vector (rad), in the base frame.
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
    /// Joints inside the limits whose tool pose is `tool` (base frame, orthonormal rotation). The
    /// search starts at `previous` (rad or m), which leads to the nearest solution where the motion
    /// is small, and then at other points of the joint space.
    ///
    /// # Errors
    /// [`IkFailure`] where the pose is out of reach or not found within the budget, and where a
    /// number is not finite.
    pub fn inverse_kinematics(
        &self,
        tool: &Pose,
        previous: &JointVector<N>,
        budget: &SearchBudget,
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
        for start in 0..budget.starts {
            let from =
                if start == 0 { self.clamp_to_limits(previous) } else { self.start_point(start) };
            let (q, error) = self.iterate(tool, &from, budget, &mut steps);
            let is_reached = error.position_error_m <= budget.position_tolerance_m
                && error.orientation_error_rad <= budget.orientation_tolerance_rad;
            let Some((q, _)) = self.nearest_equivalent(&q, previous) else { continue };
            if is_reached {
                return Ok(IkSolution {
                    q,
                    starts: start + 1,
                    steps,
                    position_error_m: error.position_error_m,
                    orientation_error_rad: error.orientation_error_rad,
                });
            }
            if error.half_squared_norm() < least {
                least = error.half_squared_norm();
                best = IkFailure {
                    q,
                    position_error_m: error.position_error_m,
                    orientation_error_rad: error.orientation_error_rad,
                };
            }
        }
        Err(best)
    }

    /// The joints `q` clamped to their limits.
    fn clamp_to_limits(&self, q: &JointVector<N>) -> JointVector<N> {
        JointVector::<N>::from_fn(|i, _| q[i].clamp(self.limits.q_min[i], self.limits.q_max[i]))
    }

    /// Starting point number `n`, of a sequence that spreads over the limits, but over at most one
    /// turn.
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

    /// The error of the pose `at` from `goal`.
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

    /// Damped steps from one starting point. Returns the joints with the smallest error on the way,
    /// and their error. `steps` is increased by the number of steps.
    fn iterate(
        &self,
        goal: &Pose,
        from: &JointVector<N>,
        budget: &SearchBudget,
        steps: &mut u32,
    ) -> (JointVector<N>, PoseError) {
        let mut q = *from;
        let mut frames = self.frames(&q);
        let mut error = self.pose_error(goal, &frames.tool);
        let mut best = (q, error);
        let mut refinements = 0;
        for _ in 0..budget.steps {
            let half_square = error.half_squared_norm();
            if half_square <= SQUARED_ERROR_MIN {
                break;
            }
            *steps += 1;
            let j = self.jacobian_from_frames(&frames, &DMat3::IDENTITY);
            let step = self.step_within_limits(&q, &j, &error.scaled, half_square + DAMPING_MIN);
            q = self.clamp_to_limits(&(q + self.limit_step(&step)));
            frames = self.frames(&q);
            error = self.pose_error(goal, &frames.tool);
            let is_halved = error.half_squared_norm() < 0.25 * best.1.half_squared_norm();
            if error.half_squared_norm() < best.1.half_squared_norm() {
                best = (q, error);
            }
            if best.1.position_error_m <= budget.position_tolerance_m
                && best.1.orientation_error_rad <= budget.orientation_tolerance_rad
            {
                refinements += 1;
                if !is_halved || refinements > REFINEMENT_STEPS_MAX {
                    break;
                }
            }
        }
        best
    }

    /// The damped step without the joints that stand at a limit and would move beyond it. The other
    /// joints make the step without them. If the full step were clamped instead, it would change
    /// its direction and the iteration would stall along the limit.
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
            let leaves_limits = |i: usize| {
                (q[i] <= self.limits.q_min[i] && step[i] < 0.0)
                    || (q[i] >= self.limits.q_max[i] && step[i] > 0.0)
            };
            let blocked: [bool; N] = core::array::from_fn(|i| free[i] && leaves_limits(i));
            if !blocked.contains(&true) {
                break;
            }
            for i in (0..N).filter(|i| blocked[*i]) {
                free[i] = false;
                j.column_mut(i).fill(0.0);
            }
            step = self.damped_step(&j, error, damping);
        }
        step
    }

    /// The damped least-squares step `J^T (J J^T + damping I)^-1 error`, with positions divided by
    /// the mean link length. It is zero where a number is not finite.
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

    /// `step` times a common factor, so that no joint changes by more than [`STEP_MAX_RAD`].
    fn limit_step(&self, step: &JointVector<N>) -> JointVector<N> {
        let largest = (0..N).fold(0.0_f64, |largest, i| {
            let size = match self.links[i].kind {
                JointKind::Revolute => step[i].abs(),
                JointKind::Prismatic => step[i].abs() / self.mean_link_m,
            };
            largest.max(size)
        });
        if largest > STEP_MAX_RAD { step * (STEP_MAX_RAD / largest) } else { *step }
    }

    /// Resolved-rate motion: the joint rates (rad/s or m/s) at `q` (rad or m) for the twist `[v;
    /// w]` of the tool point (base frame; m/s, rad/s), by damped least squares with positions
    /// divided by the mean link length, and the part of the twist that the rates leave. `damping`
    /// is lambda^2. Numbers that are not finite, or too large to square, give rates of zero.
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
